//! The solid inside a mesh as a graph of voxels: seams, small holes, several shells and inner cavities do not matter.

use super::axes::principal_axes;
use glam::{DMat3, DVec3};

/// Voxels along the longest side of the body. 80 to 160 give the same joints, 60 is too coarse for wrists and necks.
pub(super) const RESOLUTION: f64 = 110.0;
/// Empty cells around the shape.
const PAD: i32 = 2;
/// A shell whose filling adds less than this share of itself leaks.
const LEAK: f64 = 0.35;
/// A cell that meets the shell in so many of 26 directions is inside, where the shell leaks and where it does not: there only parts
/// can be open.
const ENCLOSED: [u8; 2] = [21, 24];
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

/// The cells inside a mesh.
pub(super) struct Filled {
    grid: Grid,
    inside: Vec<bool>,
}

impl Filled {
    /// Fills the mesh, with so many cells along its longest side; `None` when there is no surface of measurable extent.
    ///
    /// The grid lies along the principal axes of the surface, so that a turned mesh gives the same cells, turned.
    pub(super) fn of(points: &[DVec3], triangles: &[[u32; 3]], resolution: f64) -> Option<Self> {
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
        let grid = Grid::around(triangles.iter().map(corners), resolution)?;
        let shell = grid.shell(triangles.iter().map(corners))?;
        let inside = grid.filled(&shell);
        Some(Self { grid, inside })
    }

    /// Edge of a cell.
    pub(super) fn pitch(&self) -> f64 {
        self.grid.pitch
    }

    /// Whether a point lies inside.
    pub(super) fn holds(&self, p: DVec3) -> bool {
        self.grid.cell(self.grid.along.transpose() * p).is_some_and(|cell| self.inside[cell])
    }

    /// Centres of the cells inside.
    pub(super) fn centres(&self) -> impl Iterator<Item = DVec3> {
        self.inside.iter().enumerate().filter(|(_, inside)| **inside).map(|(cell, _)| self.grid.centre(cell))
    }

    /// Leaves out the cells whose centres do not pass.
    pub(super) fn keep(&mut self, passes: impl Fn(DVec3) -> bool) {
        for (cell, inside) in self.inside.iter_mut().enumerate() {
            *inside = *inside && passes(self.grid.centre(cell));
        }
    }
}

impl Solid {
    /// What hangs together most of what is filled.
    pub(super) fn of(filled: &Filled) -> Self {
        let grid = filled.grid.clone();
        let body = grid.largest_part(&filled.inside);
        let mut voxel_of_cell = vec![NONE; body.len()];
        let mut cells = Vec::new();
        for (cell, _) in body.iter().enumerate().filter(|(_, inside)| **inside) {
            voxel_of_cell[cell] = cells.len() as u32;
            cells.push(cell);
        }
        let offsets = STEPS.map(|d| grid.offset(d));
        let neighbours = cells.iter().map(|&cell| offsets.map(|o| voxel_of_cell[cell.wrapping_add_signed(o)])).collect();
        let centres = cells.iter().map(|&cell| grid.centre(cell)).collect();
        Self { pitch: grid.pitch, centres, neighbours, grid, voxel_of_cell }
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
#[derive(Clone)]
struct Grid {
    /// Columns: the grid's axes in the mesh's space.
    along: DMat3,
    /// Corner of cell 0 in the grid's axes.
    origin: DVec3,
    pitch: f64,
    size: [i32; 3],
}

impl Grid {
    fn around(triangles: impl Iterator<Item = [DVec3; 3]> + Clone, resolution: f64) -> Option<Self> {
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
        let pitch = extent.max_element() / resolution;
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

    /// Shell and what it encloses: what cannot be reached from outside by steps across faces, and, since shells leak, what meets the
    /// shell in almost all directions. The space between two thighs meets it in 18 to 21.
    fn filled(&self, shell: &[bool]) -> Vec<bool> {
        let mut reached = vec![false; shell.len()];
        let mut queue = vec![0];
        reached[0] = true;
        while let Some(cell) = queue.pop() {
            let at = self.coordinates(cell);
            for d in STEPS.iter().take(6) {
                if (0..3).all(|i| (0..self.size[i]).contains(&(at[i] + d[i]))) {
                    let next = cell.wrapping_add_signed(self.offset(*d));
                    if !reached[next] && !shell[next] {
                        reached[next] = true;
                        queue.push(next);
                    }
                }
            }
        }
        let mut met = vec![0_u8; shell.len()];
        for d in STEPS {
            self.look(shell, d, &mut met);
        }
        let walls = shell.iter().filter(|s| **s).count() as f64;
        let added = reached.iter().filter(|r| !**r).count() as f64 - walls;
        let enclosed = ENCLOSED[usize::from(added >= LEAK * walls)];
        (0..shell.len()).map(|cell| !reached[cell] || met[cell] >= enclosed).collect()
    }

    /// Counts for every cell whether the shell lies somewhere in direction `d`.
    fn look(&self, shell: &[bool], d: [i32; 3], met: &mut [u8]) {
        let offset = self.offset(d);
        let mut ahead = vec![false; shell.len()];
        // From the far end in every direction, so that the next cell has been seen before.
        let order = |axis: usize, i: i32| if d[axis] > 0 { self.size[axis] - 2 - i } else { i + 1 };
        let rounds = self.size.map(|n| n - 2);
        for i in 0..rounds[0] {
            for j in 0..rounds[1] {
                for k in 0..rounds[2] {
                    let cell = self.offset([order(0, i), order(1, j), order(2, k)]) as usize;
                    let next = cell.wrapping_add_signed(offset);
                    ahead[cell] = shell[next] || ahead[next];
                    met[cell] += u8::from(ahead[cell]);
                }
            }
        }
    }

    fn coordinates(&self, cell: usize) -> [i32; 3] {
        let [_, ny, nz] = self.size.map(|n| n as usize);
        [(cell / (ny * nz)) as i32, (cell / nz % ny) as i32, (cell % nz) as i32]
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
