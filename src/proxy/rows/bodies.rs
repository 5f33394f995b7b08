//! Bodies for the unit tests.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use crate::proxy::Proxy;
use crate::splitmix::Sequence;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// A body of tetrahedra with its boundary; negative ones are turned.
pub(crate) fn body(rest: Vec<DVec3>, mut tets: Vec<[u32; 4]>) -> Proxy {
    for t in &mut tets {
        let [a, b, c, d] = t.map(|v| rest[v as usize]);
        if (b - a).cross(c - a).dot(d - a) < 0.0 {
            t.swap(0, 1);
        }
    }
    let mut faces: BTreeMap<[u32; 3], Vec<([u32; 3], u32)>> = BTreeMap::new();
    for (k, &[a, b, c, d]) in tets.iter().enumerate() {
        for face in [[b, c, d], [a, d, c], [a, b, d], [a, c, b]] {
            let mut key = face;
            key.sort_unstable();
            faces.entry(key).or_default().push((face, k as u32));
        }
    }
    let outer: Vec<_> = faces.into_values().filter(|f| f.len() == 1).map(|f| f[0]).collect();
    Proxy {
        components: vec![0; tets.len()],
        boundary: outer.iter().map(|f| f.0).collect(),
        boundary_tets: outer.iter().map(|f| f.1).collect(),
        rest,
        tets,
    }
}

/// A box of `n` cells, six tetrahedra each, with the corners shaken by `shake` cells.
pub(crate) fn bar(n: [usize; 3], size: DVec3, shake: f64) -> Proxy {
    let mut dice = Sequence(11);
    let cell = size / DVec3::new(n[0] as f64, n[1] as f64, n[2] as f64);
    let at = |i: usize, j: usize, k: usize| ((i * (n[1] + 1) + j) * (n[2] + 1) + k) as u32;
    let mut rest = Vec::new();
    for i in 0..=n[0] {
        for j in 0..=n[1] {
            for k in 0..=n[2] {
                rest.push(DVec3::new(i as f64, j as f64, k as f64) * cell - size * 0.5 + dice.point(shake) * cell);
            }
        }
    }
    let mut tets = Vec::new();
    for i in 0..n[0] {
        for j in 0..n[1] {
            for k in 0..n[2] {
                // Kuhn: one tetrahedron per order of the axes.
                for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
                    let mut c = [i, j, k];
                    let mut tet = [at(c[0], c[1], c[2]); 4];
                    for (step, axis) in order.into_iter().enumerate() {
                        c[axis] += 1;
                        tet[step + 1] = at(c[0], c[1], c[2]);
                    }
                    tets.push(tet);
                }
            }
        }
    }
    body(rest, tets)
}

/// An affine map that is far from a rotation.
pub(crate) fn affine(p: DVec3) -> DVec3 {
    DMat3::from_cols(DVec3::new(0.9, 0.25, 0.1), DVec3::new(-0.3, 1.1, 0.05), DVec3::new(0.1, -0.2, 0.95)) * p
        + DVec3::new(0.2, -0.1, 0.3)
}

/// A smooth map with bending and twist.
pub(crate) fn bend(p: DVec3) -> DVec3 {
    let (s, c) = (2.0 * p.x).sin_cos();
    DVec3::new(p.x + 0.2 * p.y * p.y, p.y * c - p.z * s, p.y * s + p.z * c + 0.3 * p.x * p.x)
}
