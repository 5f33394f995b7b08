//! A coat of cubes around a surface, for sheets that enclose nothing, and wherever a tetrahedralization cannot be proven.

use super::edges::double_area;
use super::tetrahedra::volume;
use crate::spatial::TriangleTree;
use glam::DVec3;

/// A cell is kept when its centre is this near to the surface, relative to its edge: just more than its circumscribed sphere, so that
/// the cell around any point of the surface is kept.
const REACH: f64 = 0.87;
/// Rounds of adapting the edge to the wanted number of vertices.
const ROUNDS: usize = 8;
/// The number of vertices may be off by this share.
const TOLERANCE: f64 = 0.08;
/// Finest grid: cells along the longest side of the box.
const FINEST: f64 = 1000.0;

/// Paths from one corner of a cube to the opposite one along its edges: six tetrahedra that fit those of the next cubes.
const PATHS: [[usize; 2]; 6] = [[1, 3], [1, 5], [2, 3], [2, 6], [4, 5], [4, 6]];

/// Points and positive tetrahedra around the triangles of `tree`; with `filled` also inside of them. About `target` points.
pub(super) fn shell(
    tree: &TriangleTree,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    filled: bool,
    target: usize,
) -> (Vec<DVec3>, Vec<[u32; 4]>) {
    let Some((lo, hi)) = tree.bounds() else { return (Vec::new(), Vec::new()) };
    let area: f64 = triangles.iter().map(|&t| 0.5 * double_area(points, t).length()).sum();
    let finest = (hi - lo).max_element() / FINEST;
    let mut edge = (area * 2.2 / target as f64).sqrt().max(finest);
    for round in 1.. {
        let grid = Grid { origin: (lo + hi) * 0.5, edge };
        let cells = grid.cells(tree, (hi - lo).max_element(), filled);
        let vertices = grid_vertices(&cells);
        let ratio = vertices.len() as f64 / target as f64;
        let done = (ratio - 1.0).abs() < TOLERANCE || round == ROUNDS || (edge <= finest && ratio < 1.0);
        if done {
            return grid.split(&cells, &vertices);
        }
        edge = (edge * ratio.sqrt().clamp(0.5, 2.0)).max(finest);
    }
    unreachable!("the last round returns")
}

/// Cubes by their place `[z, y, x]` on the grid, so that sorting them puts neighbours together.
type Place = [i32; 3];

struct Grid {
    origin: DVec3,
    edge: f64,
}

impl Grid {
    /// Kept cells in ascending order, found by halving a cube around everything.
    fn cells(&self, tree: &TriangleTree, extent: f64, filled: bool) -> Vec<Place> {
        let half = (extent * 0.5 / self.edge).ceil() as u32 + 1;
        let size = half.next_power_of_two() as i32;
        let mut found = Vec::new();
        self.descend(tree, [-size; 3], 2 * size, filled, &mut found);
        found.sort_unstable();
        found
    }

    fn descend(&self, tree: &TriangleTree, corner: Place, size: i32, filled: bool, found: &mut Vec<Place>) {
        let half_edge = 0.5 * f64::from(size) * self.edge;
        let centre = self.position(corner) + DVec3::splat(half_edge);
        // Centres of cells lie within this distance of the centre of the block.
        let spread = (half_edge - 0.5 * self.edge) * 3f64.sqrt();
        if tree.closest_within(centre, spread + REACH * self.edge).is_none() {
            if filled && tree.winding(centre) > 0.5 {
                let along = |k: usize| corner[k]..corner[k] + size;
                found.extend(along(0).flat_map(|z| along(1).flat_map(move |y| along(2).map(move |x| [z, y, x]))));
            }
        } else if size == 1 {
            found.push(corner);
        } else {
            for half in corners(corner, size / 2) {
                self.descend(tree, half, size / 2, filled, found);
            }
        }
    }

    fn position(&self, [z, y, x]: Place) -> DVec3 {
        self.origin + DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * self.edge
    }

    fn split(&self, cells: &[Place], vertices: &[Place]) -> (Vec<DVec3>, Vec<[u32; 4]>) {
        let points: Vec<DVec3> = vertices.iter().map(|&place| self.position(place)).collect();
        let mut tets = Vec::with_capacity(6 * cells.len());
        for &cell in cells {
            let corner = corners(cell, 1).map(|c| vertices.partition_point(|v| *v < c) as u32);
            for [a, b] in PATHS {
                let mut tet = [corner[0], corner[a], corner[b], corner[7]];
                if volume(&points, tet) < 0.0 {
                    tet.swap(0, 1);
                }
                tets.push(tet);
            }
        }
        (points, tets)
    }
}

/// The corners of a cube of `size` cells, x changing fastest.
fn corners([z, y, x]: Place, size: i32) -> [Place; 8] {
    std::array::from_fn(|k| [z + size * (k as i32 >> 2), y + size * (k as i32 >> 1 & 1), x + size * (k as i32 & 1)])
}

fn grid_vertices(cells: &[Place]) -> Vec<Place> {
    let mut vertices: Vec<Place> = cells.iter().flat_map(|&cell| corners(cell, 1)).collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}
