//! All poses of a mesh made coarse together (Fröhlich & Botsch 2011, §7): vertices are merged into neighbours, so that those that stay are
//! where they were in every pose.

use super::geometry::{double_area, spread};
use super::newton::Goals;
use super::starts::Rigid;
use crate::error::Result;
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cosine of the largest turn of a triangle in any pose: 72°.
const LARGEST_TURN: f64 = 0.3;
/// Least of twice the area of a triangle over the square of its longest edge.
const THINNEST: f64 = 0.08;
/// Most neighbours of a vertex.
const NEIGHBOURS: usize = 12;
/// Neighbours that a vertex may be merged into, cheapest first.
const CHOICES: usize = 4;
/// Cost of the square of a length, so that edges in a plane go short ones first.
const OF_LENGTH: f64 = 1e-9;
/// Weight of the planes that hold the rims of holes.
const RIM: f64 = 10.0;
/// Steps of the grid of examples, in their spread.
const GRID: f64 = (1 << 30) as f64;
/// Merges between two looks at whether the user wants it to end.
const PATIENCE: usize = 1024;

/// Which vertices stay, rising, and what became of the mesh, in their numbering.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Coarse {
    pub vertices: Vec<u32>,
    pub faces: Vec<[u32; 3]>,
    /// The vertex into which each vertex was merged.
    pub roots: Vec<u32>,
}

/// Merges vertices until `target` are left, or none can be merged without a fold in some pose. Vertices of no triangle do not stay.
///
/// Shapes: each pose: n; `faces`: a surface (see [`super::topology::Topology`]).
pub(super) fn decimate(poses: &[&[DVec3]], faces: &[[u32; 3]], target: usize, cancel: &dyn Fn() -> Result<()>) -> Result<Coarse> {
    let mut mesh = Mesh::new(poses, faces);
    if mesh.alive <= target {
        return Ok(mesh.coarse());
    }
    let mut queue = BinaryHeap::new();
    for v in 0..mesh.around.len() as u32 {
        mesh.offer(v, &mut queue);
    }
    let (mut merges, mut ring) = (0, Vec::new());
    while mesh.alive > target {
        let Some(Reverse((_, from, into, stamp))) = queue.pop() else { break };
        if stamp != mesh.stamps[from as usize] || mesh.around[from as usize].is_empty() || mesh.around[into as usize].is_empty() {
            continue;
        }
        if !mesh.may_merge(from, into) {
            continue;
        }
        mesh.neighbours(from, &mut ring);
        mesh.merge(from, into);
        for &v in &ring {
            mesh.stamps[v as usize] += 1;
            mesh.offer(v, &mut queue);
        }
        merges += 1;
        if merges % PATIENCE == 0 {
            cancel()?;
        }
    }
    Ok(mesh.coarse())
}

/// From, into, and the state of `from` when it was measured, by cost as the bits of a positive number.
type Candidate = Reverse<(u64, u32, u32, u32)>;

struct Mesh {
    /// Poses with a spread of 1 each, which does not change with a turn.
    poses: Vec<Vec<DVec3>>,
    quadrics: Vec<Vec<Quadric>>,
    faces: Vec<[u32; 3]>,
    /// Living triangles at each vertex.
    around: Vec<Vec<u32>>,
    rim: Vec<bool>,
    stamps: Vec<u32>,
    into: Vec<u32>,
    alive: usize,
}

impl Mesh {
    fn new(poses: &[&[DVec3]], faces: &[[u32; 3]]) -> Self {
        let n = poses.first().map_or(0, |x| x.len());
        let mut around = vec![Vec::new(); n];
        for (t, face) in faces.iter().enumerate() {
            face.iter().for_each(|&v| around[v as usize].push(t as u32));
        }
        let poses = side_by_side(poses);
        let alive = around.iter().filter(|a| !a.is_empty()).count();
        let mut mesh = Self {
            poses,
            quadrics: Vec::new(),
            faces: faces.to_vec(),
            around,
            rim: vec![false; n],
            stamps: vec![0; n],
            into: (0..n as u32).collect(),
            alive,
        };
        let rims: Vec<(u32, u32, u32)> = (0..faces.len() as u32)
            .flat_map(|t| {
                let face = faces[t as usize];
                (0..3).map(move |k| (face[k], face[(k + 1) % 3], t))
            })
            .filter(|&(a, b, _)| mesh.common_triangles(a, b) == 1)
            .collect();
        for &(a, b, _) in &rims {
            mesh.rim[a as usize] = true;
            mesh.rim[b as usize] = true;
        }
        mesh.quadrics = mesh
            .poses
            .iter()
            .map(|x| {
                let mut quadrics = vec![Quadric::default(); n];
                for face in faces {
                    let normal = double_area(x, *face);
                    let area = normal.length();
                    if area > 0.0 {
                        let plane = Quadric::plane(normal / area, x[face[0] as usize], area);
                        face.iter().for_each(|&v| quadrics[v as usize].add(&plane));
                    }
                }
                for &(a, b, t) in &rims {
                    let along = x[b as usize] - x[a as usize];
                    if let Some(normal) = along.cross(double_area(x, faces[t as usize])).try_normalize() {
                        let plane = Quadric::plane(normal, x[a as usize], RIM * along.length_squared());
                        quadrics[a as usize].add(&plane);
                        quadrics[b as usize].add(&plane);
                    }
                }
                quadrics
            })
            .collect();
        mesh
    }

    fn common_triangles(&self, a: u32, b: u32) -> usize {
        self.around[a as usize].iter().filter(|&&t| self.faces[t as usize].contains(&b)).count()
    }

    /// Neighbours of a vertex, rising.
    fn neighbours(&self, v: u32, out: &mut Vec<u32>) {
        out.clear();
        out.extend(self.around[v as usize].iter().flat_map(|&t| self.faces[t as usize]).filter(|&w| w != v));
        out.sort_unstable();
        out.dedup();
    }

    fn cost(&self, from: u32, into: u32) -> f64 {
        let (u, v) = (from as usize, into as usize);
        let of = |(x, q): (&Vec<DVec3>, &Vec<Quadric>)| q[u].at(x[v]) + q[v].at(x[v]) + OF_LENGTH * x[u].distance_squared(x[v]);
        self.poses.iter().zip(&self.quadrics).map(of).sum()
    }

    /// Puts the cheapest merges of a vertex into the queue.
    fn offer(&self, from: u32, queue: &mut BinaryHeap<Candidate>) {
        let mut near = Vec::new();
        self.neighbours(from, &mut near);
        // The bits of a number that is not negative order like the number.
        let mut choices: Vec<(u64, u32)> = near.iter().map(|&into| (self.cost(from, into).max(0.0).to_bits(), into)).collect();
        choices.sort_unstable();
        let stamp = self.stamps[from as usize];
        queue.extend(choices.into_iter().take(CHOICES).map(|(cost, into)| Reverse((cost, from, into, stamp))));
    }

    fn may_merge(&self, from: u32, into: u32) -> bool {
        let (mut near, mut far) = (Vec::new(), Vec::new());
        self.neighbours(from, &mut near);
        self.neighbours(into, &mut far);
        let common = near.iter().filter(|v| far.binary_search(v).is_ok()).count();
        let shared = self.common_triangles(from, into);
        // The link condition; a vertex of a rim stays on it.
        if common != shared || shared != if self.rim[from as usize] { 1 } else { 2 } {
            return false;
        }
        if near.len() + far.len() > NEIGHBOURS + 2 + common {
            return false;
        }
        self.around[from as usize].iter().all(|&t| {
            let face = self.faces[t as usize];
            if face.contains(&into) {
                return true;
            }
            let moved = face.map(|v| if v == from { into } else { v });
            self.poses.iter().all(|x| {
                let (before, after) = (double_area(x, face), double_area(x, moved));
                let [p, q, r] = moved.map(|v| x[v as usize]);
                let longest = p.distance_squared(q).max(q.distance_squared(r)).max(r.distance_squared(p));
                let area = after.length();
                before.dot(after) >= LARGEST_TURN * before.length() * area && area >= THINNEST * longest
            })
        })
    }

    fn merge(&mut self, from: u32, into: u32) {
        for t in std::mem::take(&mut self.around[from as usize]) {
            let face = self.faces[t as usize];
            if face.contains(&into) {
                for v in face.into_iter().filter(|&v| v != from) {
                    self.around[v as usize].retain(|&other| other != t);
                }
            } else {
                self.faces[t as usize] = face.map(|v| if v == from { into } else { v });
                self.around[into as usize].push(t);
            }
        }
        for quadrics in &mut self.quadrics {
            let quadric = quadrics[from as usize];
            quadrics[into as usize].add(&quadric);
        }
        self.into[from as usize] = into;
        self.alive -= 1;
    }

    fn coarse(&self) -> Coarse {
        let mut places = vec![u32::MAX; self.around.len()];
        let mut vertices = Vec::with_capacity(self.alive);
        for (v, place) in places.iter_mut().enumerate().filter(|(v, _)| !self.around[*v].is_empty()) {
            *place = vertices.len() as u32;
            vertices.push(v as u32);
        }
        let mut living: Vec<u32> = self.around.iter().flatten().copied().collect();
        living.sort_unstable();
        living.dedup();
        let faces = living.into_iter().map(|t| self.faces[t as usize].map(|v| places[v as usize])).collect();
        let root = |mut v: u32| {
            while self.into[v as usize] != v {
                v = self.into[v as usize];
            }
            places[v as usize]
        };
        Coarse { vertices, faces, roots: (0..self.into.len() as u32).map(root).collect() }
    }
}

/// Poses with a spread of 1, all but the first laid upon the first and rounded far below any detail: however an example is turned, it is nearly always the same
/// numbers here. Ties, of which a body that is alike on both sides has many, are broken by the last bits, and another coarse mesh may choose another crease.
fn side_by_side(poses: &[&[DVec3]]) -> Vec<Vec<DVec3>> {
    let alike = |x: &[DVec3]| -> Vec<DVec3> {
        let scale = 1.0 / spread(x).max(f64::MIN_POSITIVE);
        x.iter().map(|p| *p * scale).collect()
    };
    let Some((rest, others)) = poses.split_first() else { return Vec::new() };
    let rest = alike(rest);
    let weights = vec![1.0; rest.len()];
    let goals = Goals { positions: &rest, weights: &weights };
    let others: Vec<Vec<DVec3>> = others
        .iter()
        .map(|x| {
            let x = alike(x);
            let laid = Rigid::fit(&x, &goals);
            x.iter().map(|p| (laid.apply(*p) * GRID).round() / GRID).collect()
        })
        .collect();
    std::iter::once(rest).chain(others).collect()
}

/// The quadratic form of a sum of weighted squared distances from planes: upper triangle of a symmetric matrix, linear part, constant.
#[derive(Clone, Copy, Debug, Default)]
struct Quadric([f64; 10]);

impl Quadric {
    fn plane(n: DVec3, on: DVec3, weight: f64) -> Self {
        let d = -n.dot(on);
        Self(
            [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z, n.x * d, n.y * d, n.z * d, d * d]
                .map(|q| weight * q),
        )
    }

    fn add(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }

    fn at(&self, p: DVec3) -> f64 {
        let [xx, xy, xz, yy, yz, zz, x, y, z, c] = self.0;
        xx * p.x * p.x
            + yy * p.y * p.y
            + zz * p.z * p.z
            + 2.0 * (xy * p.x * p.y + xz * p.x * p.z + yz * p.y * p.z + x * p.x + y * p.y + z * p.z)
            + c
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::deform::shells::geometry::volume;
    use crate::deform::shells::shapes::{Bend, arm};
    use crate::deform::shells::topology::Topology;

    #[test]
    fn all_poses_keep_their_shape_and_vertices_their_places() {
        let of = |shoulder, elbow| arm(91, 24, Bend { shoulder, elbow, bulge: 0.2 });
        let (rest, faces) = of(0.0, 0.0);
        let poses = [rest.clone(), of(0.0, 100.0).0, of(70.0, 0.0).0];
        let views: Vec<&[DVec3]> = poses.iter().map(Vec::as_slice).collect();
        let coarse = decimate(&views, &faces, 400, &|| Ok(())).unwrap();
        assert_eq!(coarse.vertices.len(), 400);
        assert!(coarse.vertices.windows(2).all(|w| w[0] < w[1]));
        assert!(coarse.vertices.iter().zip(0..).all(|(v, place)| coarse.roots[*v as usize] == place));
        let topology = Topology::of(400, &coarse.faces).unwrap();
        assert!(topology.holes.is_empty() && coarse.faces.len() == 796);
        for pose in &poses {
            let small: Vec<DVec3> = coarse.vertices.iter().map(|v| pose[*v as usize]).collect();
            let ratio = volume(&small, &coarse.faces, &[]) / volume(pose, &faces, &[]);
            assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
            // No triangle looks the other way than the skin around its corners.
            let mut normals = vec![DVec3::ZERO; pose.len()];
            for face in &faces {
                face.iter().for_each(|&v| normals[v as usize] += double_area(pose, *face));
            }
            for face in &coarse.faces {
                let skin: DVec3 = face.iter().map(|&v| normals[coarse.vertices[v as usize] as usize].normalize()).sum();
                assert!(double_area(&small, *face).normalize().dot(skin) > 0.0, "{face:?}");
            }
        }
        // Merged vertices are near those that stand for them.
        let far = rest.iter().zip(&coarse.roots).map(|(p, r)| p.distance(rest[coarse.vertices[*r as usize] as usize]));
        let mean = far.sum::<f64>() / rest.len() as f64;
        assert!(mean < 0.15, "{mean}");
    }

    #[test]
    fn a_turned_example_makes_the_same_mesh() {
        let of = |shoulder, elbow| arm(61, 24, Bend { shoulder, elbow, bulge: 0.2 });
        let (rest, faces) = of(0.0, 0.0);
        let example = of(40.0, 90.0).0;
        let meshes = [0.0, 0.5, 1.0, 1.5].map(|turn| {
            let turn = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), turn * std::f64::consts::PI);
            let turned: Vec<DVec3> = example.iter().map(|p| turn * *p + DVec3::splat(7.0) * turn.x).collect();
            decimate(&[&rest, &turned], &faces, 300, &|| Ok(())).unwrap()
        });
        assert!(meshes.iter().all(|mesh| *mesh == meshes[0]));
    }

    #[test]
    fn rims_stay_where_they_are_and_holes_open() {
        let (rest, mut faces) = arm(61, 24, Bend::default());
        let last = rest.len() as u32 - 1;
        faces.retain(|f| !f.contains(&last));
        let coarse = decimate(&[&rest], &faces, 200, &|| Ok(())).unwrap();
        let small: Vec<DVec3> = coarse.vertices.iter().map(|v| rest[*v as usize]).collect();
        let topology = Topology::of(small.len(), &coarse.faces).unwrap();
        assert_eq!(topology.holes.len(), 1);
        assert!(topology.holes[0].iter().all(|&v| small[v as usize].x > 2.99));
    }

    #[test]
    fn it_ends_when_it_is_told_to() {
        let (rest, faces) = arm(91, 40, Bend::default());
        let stop = || Err(crate::error::Error::new(crate::error::Kind::Interrupted, "interrupted"));
        assert!(decimate(&[&rest], &faces, 100, &stop).is_err());
    }
}
