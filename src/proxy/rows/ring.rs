//! One affine map per boundary face, from the ring of tetrahedra around it.

use super::{Proxy, gradients_by_volume};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Per boundary face: its centre, and the volume-weighted mean of the gradient operators of all tetrahedra that touch the face.
///
/// A pose p gives the face the affine map x ↦ c′ + A (x − c) with c′ the posed centre and A = Σ pᵥ gᵥᵀ. Gradients sum to zero.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RingMaps {
    centres: Vec<DVec3>,
    starts: Vec<u32>,
    vertices: Vec<u32>,
    gradients: Vec<DVec3>,
}

impl RingMaps {
    /// Averages the gradients. Cost: a few milliseconds for 6,000 faces.
    pub fn new(proxy: &Proxy) -> Self {
        let touching = Touching::new(proxy);
        let operators: Vec<_> = proxy.tets.iter().map(|tet| gradients_by_volume(&proxy.rest, tet)).collect();
        let mut maps = Self {
            centres: proxy.boundary.iter().map(|face| centre(&proxy.rest, face)).collect(),
            starts: vec![0],
            vertices: Vec::new(),
            gradients: Vec::new(),
        };
        let mut ring = Vec::new();
        let mut slot_of = vec![u32::MAX; proxy.rest.len()];
        for face in &proxy.boundary {
            ring.clear();
            ring.extend(face.iter().flat_map(|&v| touching.tets(v)));
            ring.sort_unstable();
            ring.dedup();
            let first = maps.vertices.len();
            let mut volume = 0.0;
            for &tet in &ring {
                let (gradients, v) = &operators[tet as usize];
                volume += v.abs();
                for (&vertex, gradient) in proxy.tets[tet as usize].iter().zip(gradients) {
                    let slot = &mut slot_of[vertex as usize];
                    if *slot == u32::MAX {
                        *slot = maps.vertices.len() as u32;
                        maps.vertices.push(vertex);
                        maps.gradients.push(DVec3::ZERO);
                    }
                    maps.gradients[*slot as usize] += *gradient * v.signum();
                }
            }
            // A ring without volume only carries the face's translation.
            let scale = if volume > 0.0 { 1.0 / volume } else { 0.0 };
            maps.gradients[first..].iter_mut().for_each(|g| *g *= scale);
            maps.vertices[first..].iter().for_each(|&v| slot_of[v as usize] = u32::MAX);
            maps.starts.push(maps.vertices.len() as u32);
        }
        maps
    }

    /// Number of faces.
    pub fn len(&self) -> usize {
        self.centres.len()
    }

    /// Whether there is no face.
    pub fn is_empty(&self) -> bool {
        self.centres.is_empty()
    }

    /// Centre of each face in the rest pose.
    pub fn centres(&self) -> &[DVec3] {
        &self.centres
    }

    /// Vertices of the ring of a face and their gradients.
    pub fn ring(&self, face: usize) -> (&[u32], &[DVec3]) {
        let range = self.starts[face] as usize..self.starts[face + 1] as usize;
        (&self.vertices[range.clone()], &self.gradients[range])
    }

    /// Coefficients that move a point of the face by `offset`; they sum to zero.
    pub fn along(&self, face: usize, offset: DVec3) -> impl Iterator<Item = (u32, f64)> + '_ {
        let (vertices, gradients) = self.ring(face);
        vertices.iter().zip(gradients).map(move |(&v, g)| (v, g.dot(offset)))
    }
}

/// The volume-weighted mean of the gradient operators of the tetrahedra at each vertex: blended by barycentric coordinates they vary
/// continuously along the boundary. A point off a convex edge has its foot on the edge, where rounding says which face is nearest: with one
/// operator per face that would decide how the point follows.
#[derive(Clone, Debug)]
pub(super) struct VertexMaps {
    touching: Touching,
    tets: Vec<[u32; 4]>,
    operators: Vec<([DVec3; 4], f64)>,
}

impl VertexMaps {
    pub(super) fn new(proxy: &Proxy) -> Self {
        Self {
            touching: Touching::new(proxy),
            tets: proxy.tets.clone(),
            operators: proxy.tets.iter().map(|tet| gradients_by_volume(&proxy.rest, tet)).collect(),
        }
    }

    /// Coefficients that move the vertex by `offset`; they sum to zero. A vertex may come several times. None without volume.
    pub(super) fn along(&self, vertex: u32, offset: DVec3) -> impl Iterator<Item = (u32, f64)> + '_ {
        let around = move || self.touching.tets(vertex).map(|t| (&self.tets[t as usize], &self.operators[t as usize]));
        let volume: f64 = around().map(|(_, (_, volume))| volume.abs()).sum();
        let offset = if volume > 0.0 { offset / volume } else { DVec3::ZERO };
        around().flat_map(move |(tet, (gradients, volume))| {
            tet.iter().zip(gradients).map(move |(&v, g)| (v, g.dot(offset) * volume.signum()))
        })
    }
}

pub(super) fn centre(rest: &[DVec3], face: &[u32; 3]) -> DVec3 {
    face.iter().map(|&v| rest[v as usize]).sum::<DVec3>() / 3.0
}

/// Tetrahedra at each vertex.
#[derive(Clone, Debug)]
struct Touching {
    starts: Vec<u32>,
    tets: Vec<u32>,
}

impl Touching {
    fn new(proxy: &Proxy) -> Self {
        let mut starts = vec![0u32; proxy.rest.len() + 1];
        for &v in proxy.tets.iter().flatten() {
            starts[v as usize + 1] += 1;
        }
        for v in 0..proxy.rest.len() {
            starts[v + 1] += starts[v];
        }
        let mut next = starts.clone();
        let mut tets = vec![0u32; 4 * proxy.tets.len()];
        for (t, tet) in proxy.tets.iter().enumerate() {
            for &v in tet {
                tets[next[v as usize] as usize] = t as u32;
                next[v as usize] += 1;
            }
        }
        Self { starts, tets }
    }

    fn tets(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        let range = self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
        self.tets[range].iter().copied()
    }
}
