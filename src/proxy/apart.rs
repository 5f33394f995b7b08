//! A proxy that was made of a surface whose parts were held apart, brought back to where the surface is.

use super::Proxy;
use crate::spatial::TriangleTree;
use glam::DVec3;

/// Moves each vertex of the proxy back by as much as the surface nearest to it was moved; returns where they were.
///
/// Shapes: `points`: the surface with its parts apart; `triangles` over them; `shift`: by how much each of them was moved. A shift that
/// grows evenly from where the parts meet keeps tetrahedra in shape but for a shear.
pub fn carry_back(proxy: &mut Proxy, points: &[DVec3], triangles: &[[u32; 3]], shift: &[DVec3]) -> Vec<DVec3> {
    let tree = TriangleTree::new(points, triangles);
    let apart = proxy.rest.clone();
    for p in &mut proxy.rest {
        if let Some(near) = tree.closest(*p) {
            let corners = triangles[near.triangle];
            *p -= corners.iter().zip(near.barycentric).map(|(&v, w)| shift[v as usize] * w).sum::<DVec3>();
        }
    }
    apart
}
