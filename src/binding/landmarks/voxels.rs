//! The solid inside a mesh as a graph of voxels: seams, small holes, several shells and inner cavities do not matter.

use super::axes::principal_axes;
use glam::{DMat3, DVec3};

/// Voxels along the longest side of the body. 80 to 160 give the same joints, 60 is too coarse for wrists and necks.
const RESOLUTION: f64 = 110.0;
/// Empty cells around the shape; closing must not reach the border.
const PAD: i32 = 4;
/// A shell whose filling adds less than this share of itself has leaked.
const LEAK: f64 = 0.35;
/// More samples than this are no surface of a body but a cloud of crossing sheets.
const MOST_SAMPLES: f64 = 2e8;
/// Marks a missing neighbour.
pub(super) const NONE: u32 = u32::MAX;

/// The 26 steps to neighbouring cells; the first six are those across faces, step `i` opposite to step `5 - i`.
pub(super) const STEPS: [[i32; 3]; 26] = steps();

const fn steps() -> [[i32; 3]; 26] {
    let mut out = [[0_i32; 3]; 26];
    let mut n = 0;
    let mut corners = 1;
    while corners <= 3 {
        let mut code = 0;
        while code < 27 {
            let d: [i32; 3] = [code / 9 - 1, code / 3 % 3 - 1, code % 3 - 1];
            if d[0].abs() + d[1].abs() + d[2].abs() == corners {
                out[n] = d;
                n += 1;
            }
            code += 1;
        }
        corners += 1;
    }
    out
}

/// The largest connected solid of a mesh.
pub(super) struct Solid {
    /// Edge of a voxel.
    pub(super) pitch: f64,
    /// Centre of each voxel, in the mesh's own axes.
    pub(super) centres: Vec<DVec3>,
    /// Voxel behind each of [`STEPS`], or [`NONE`].
    pub(super) neighbours: Vec<[u32; 26]>,
    grid: Grid,
    /// Voxel of each cell, or [`NONE`].
    voxel_of_cell: Vec<u32>,
}

impl Solid {
    /// Fills the mesh; `None` when there is no surface of measurable extent.
    ///
    /// The grid lies along the principal axes of the surface, so that a turned mesh gives the same voxels, turned.
    pub(super) fn of(points: &[DVec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let corners = |t: &[u32; 3]| -> Option<[DVec3; 3]> {
            let p = [*points.get(t[0] as usize)?, *points.get(t[1] as usize)?, *points.get(t[2] as usize)?];
            p.iter().all(|p| p.is_finite()).then_some(p)
        };
        let grid = Grid::around(triangles.iter().filter_map(corners))?;
        let shell = grid.shell(triangles.iter().filter_map(corners))?;
        let inside = grid.filled(&shell);
        let body = grid.largest_part(&inside);
        let mut voxel_of_cell = vec![NONE; body.len()];
        let mut cells = Vec::new();
        for (cell, _) in body.iter().enumerate().filter(|(_, inside)| **inside) {
            voxel_of_cell[cell] = cells.len() as u32;
            cells.push(cell);
        }
        let offsets = STEPS.map(|d| grid.offset(d));
        let neighbours = cells.iter().map(|&cell| offsets.map(|o| voxel_of_cell[cell.wrapping_add_signed(o)])).collect();
        let centres = cells.iter().map(|&cell| grid.centre(cell)).collect();
        Some(Self { pitch: grid.pitch, centres, neighbours, grid, voxel_of_cell })
    }

    /// Number of voxels.
    pub(super) fn len(&self) -> usize {
        self.centres.len()
    }

    /// The voxel that holds a point.
    pub(super) fn voxel_at(&self, p: DVec3) -> Option<usize> {
        let voxel = self.voxel_of_cell[self.grid.cell(self.grid.along.transpose() * p)?];
        (voxel != NONE).then_some(voxel as usize)
    }
}

/// A regular grid of cells along rotated axes.
struct Grid {
    /// Columns: the grid's axes in the mesh's space.
    along: DMat3,
    /// Corner of cell 0 in the grid's axes.
    origin: DVec3,
    pitch: f64,
    size: [i32; 3],
}

impl Grid {
    fn around(triangles: impl Iterator<Item = [DVec3; 3]> + Clone) -> Option<Self> {
        let mut area = 0.0;
        let mut mean = DVec3::ZERO;
        for [a, b, c] in triangles.clone() {
            let weight = (b - a).cross(c - a).length();
            area += weight;
            mean += (a + b + c) * (weight / 3.0);
        }
        if area.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
            return None;
        }
        mean /= area;
        let mut spread = DMat3::ZERO;
        for [a, b, c] in triangles.clone() {
            let weight = (b - a).cross(c - a).length() / (12.0 * area);
            let (a, b, c) = (a - mean, b - mean, c - mean);
            for d in [a, b, c, a + b + c] {
                spread += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * weight;
            }
        }
        let along = principal_axes(spread);
        let turn = along.transpose();
        let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for p in triangles.flatten() {
            lo = lo.min(turn * p);
            hi = hi.max(turn * p);
        }
        let extent = hi - lo;
        let pitch = extent.max_element() / RESOLUTION;
        if !(pitch.is_finite() && pitch > 0.0) {
            return None;
        }
        // Centred, so that the sign of an axis does not move the cells.
        let size = extent.to_array().map(|e| (e / pitch).ceil() as i32 + 1 + 2 * PAD);
        let origin = (lo + hi) * 0.5 - DVec3::from_array(size.map(f64::from)) * (0.5 * pitch);
        Some(Self { along, origin, pitch, size })
    }

    fn len(&self) -> usize {
        self.size.iter().map(|&n| n as usize).product()
    }

    fn offset(&self, d: [i32; 3]) -> isize {
        (d[0] as isize * self.size[1] as isize + d[1] as isize) * self.size[2] as isize + d[2] as isize
    }

    fn cell(&self, turned: DVec3) -> Option<usize> {
        let c = ((turned - self.origin) / self.pitch).floor();
        let inside = (0..3).all(|i| c[i] >= 0.0 && c[i] < f64::from(self.size[i]));
        inside.then(|| self.offset([c.x as i32, c.y as i32, c.z as i32]) as usize)
    }

    fn centre(&self, cell: usize) -> DVec3 {
        let [_, ny, nz] = self.size.map(|n| n as usize);
        let at = DVec3::new((cell / (ny * nz)) as f64, (cell / nz % ny) as f64, (cell % nz) as f64);
        self.along * (self.origin + (at + 0.5) * self.pitch)
    }

    /// Cells that the surface passes through. No path across cell faces gets past a closed surface: samples lie at most half a cell
    /// apart, so within 0.29 cells of where such a path crosses it.
    fn shell(&self, triangles: impl Iterator<Item = [DVec3; 3]> + Clone) -> Option<Vec<bool>> {
        let turn = self.along.transpose();
        let parts = |[a, b, c]: &[DVec3; 3]| {
            let longest = a.distance(*b).max(b.distance(*c)).max(c.distance(*a));
            (longest / (0.5 * self.pitch)).ceil().max(1.0)
        };
        let samples: f64 = triangles.clone().map(|t| 0.5 * (parts(&t) + 1.0) * (parts(&t) + 2.0)).sum();
        if samples > MOST_SAMPLES {
            return None;
        }
        let mut shell = vec![false; self.len()];
        for t in triangles {
            let n = parts(&t) as u32;
            let [a, b, c] = t.map(|p| turn * p);
            let (u, v) = ((b - a) / f64::from(n), (c - a) / f64::from(n));
            for i in 0..=n {
                for j in 0..=n - i {
                    if let Some(cell) = self.cell(a + u * f64::from(i) + v * f64::from(j)) {
                        shell[cell] = true;
                    }
                }
            }
        }
        Some(shell)
    }

    /// Shell and what it encloses. Where the shell leaks, a cell counts as enclosed when two of the three plane sections through it,
    /// with gaps of four cells closed, enclose it.
    fn filled(&self, shell: &[bool]) -> Vec<bool> {
        let count = |cells: &[bool]| cells.iter().filter(|c| **c).count() as f64;
        let filled = self.fill(shell, [true; 3]);
        if count(&filled) >= (1.0 + LEAK) * count(shell) {
            return filled;
        }
        let closed = self.closed(shell, 2);
        let sections = [[false, true, true], [true, false, true], [true, true, false]].map(|plane| self.fill(&closed, plane));
        let votes = |cell: usize| sections.iter().filter(|s| s[cell]).count();
        (0..shell.len()).map(|cell| filled[cell] || votes(cell) >= 2).collect()
    }

    /// Everything that cannot be reached from the border by steps across faces in the given directions.
    fn fill(&self, wall: &[bool], directions: [bool; 3]) -> Vec<bool> {
        let mut enclosed = vec![true; wall.len()];
        let mut queue = Vec::new();
        for cell in 0..wall.len() {
            let at = self.coordinates(cell);
            let border = (0..3).any(|i| directions[i] && (at[i] == 0 || at[i] == self.size[i] - 1));
            if border && !wall[cell] {
                enclosed[cell] = false;
                queue.push(cell);
            }
        }
        while let Some(cell) = queue.pop() {
            let at = self.coordinates(cell);
            for d in STEPS.iter().take(6) {
                let axis = (0..3).find(|&i| d[i] != 0).unwrap_or(0);
                let to = at[axis] + d[axis];
                if !directions[axis] || to < 0 || to >= self.size[axis] {
                    continue;
                }
                let next = cell.wrapping_add_signed(self.offset(*d));
                if enclosed[next] && !wall[next] {
                    enclosed[next] = false;
                    queue.push(next);
                }
            }
        }
        enclosed
    }

    fn coordinates(&self, cell: usize) -> [i32; 3] {
        let [_, ny, nz] = self.size.map(|n| n as usize);
        [(cell / (ny * nz)) as i32, (cell / nz % ny) as i32, (cell % nz) as i32]
    }

    /// Dilation and erosion by `rounds` steps across faces. The padding keeps both away from the border.
    fn closed(&self, cells: &[bool], rounds: usize) -> Vec<bool> {
        let offsets: Vec<isize> = STEPS.iter().take(6).map(|d| self.offset(*d)).collect();
        let mut now = cells.to_vec();
        for round in 0..2 * rounds {
            let grow = round < rounds;
            let mut next = now.clone();
            for (cell, out) in next.iter_mut().enumerate() {
                let at = self.coordinates(cell);
                let border = (0..3).any(|i| at[i] == 0 || at[i] == self.size[i] - 1);
                if !border && *out != grow && offsets.iter().any(|&o| now[cell.wrapping_add_signed(o)] == grow) {
                    *out = grow;
                }
            }
            now = next;
        }
        now
    }

    /// The part with most cells among those that hang together by faces, edges or corners.
    fn largest_part(&self, cells: &[bool]) -> Vec<bool> {
        let offsets = STEPS.map(|d| self.offset(d));
        let mut part = vec![0_u32; cells.len()];
        let (mut parts, mut largest, mut most) = (0, 0, 0);
        let mut queue = Vec::new();
        for first in (0..cells.len()).filter(|&c| cells[c]) {
            if part[first] != 0 {
                continue;
            }
            parts += 1;
            let mut count = 0;
            part[first] = parts;
            queue.push(first);
            while let Some(cell) = queue.pop() {
                count += 1;
                for o in offsets {
                    let next = cell.wrapping_add_signed(o);
                    if cells[next] && part[next] == 0 {
                        part[next] = parts;
                        queue.push(next);
                    }
                }
            }
            if count > most {
                (largest, most) = (parts, count);
            }
        }
        part.into_iter().map(|p| p != 0 && p == largest).collect()
    }
}
