//! Bodies, handles and motions that the laws of solid bodies are tried on.
#![allow(clippy::unwrap_used)]

use super::{Options, Volumetric};
use crate::deform::{Deformer, Handle, Targets};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use glam::{DQuat, DVec3};

/// A block of `cells` cubes, each cut into six tetrahedra round its diagonal, bent a little by `wobble` so that no two are alike.
pub(super) fn block(cells: [u32; 3], wobble: f64) -> Proxy {
    let [nx, ny, nz] = cells;
    let id = |x: u32, y: u32, z: u32| (z * (ny + 1) + y) * (nx + 1) + x;
    let mut proxy = Proxy::default();
    for (z, y, x) in grid([nx + 1, ny + 1, nz + 1]) {
        let p = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
        let shift = DVec3::new((3.1 * p.y + p.z).sin(), (2.3 * p.x - p.z).cos(), (1.7 * p.x + 2.9 * p.y).sin());
        proxy.rest.push(p + shift * wobble);
    }
    for (z, y, x) in grid(cells) {
        for path in [[1, 2, 4], [1, 4, 2], [2, 1, 4], [2, 4, 1], [4, 1, 2], [4, 2, 1]] {
            let corner = |bits: u32| id(x + (bits & 1), y + (bits >> 1 & 1), z + (bits >> 2));
            let mut tet = [corner(0), corner(path[0]), corner(path[0] | path[1]), corner(7)];
            let [a, b, c, d] = tet.map(|v| proxy.rest[v as usize]);
            if (b - a).cross(c - a).dot(d - a) < 0.0 {
                tet.swap(1, 2);
            }
            proxy.tets.push(tet);
        }
    }
    let scale = 1.0 / DVec3::new(f64::from(nx), f64::from(ny), f64::from(nz)).length();
    proxy.rest.iter_mut().for_each(|p| *p *= scale);
    proxy
}

fn grid([nx, ny, nz]: [u32; 3]) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| (z, y, x))))
}

/// A bar, a plate and a lump.
pub(super) fn shapes() -> [Proxy; 3] {
    [block([10, 2, 2], 0.1), block([6, 6, 1], 0.15), block([4, 4, 4], 0.2)]
}

pub(super) fn on_vertex(v: usize, beta: f64) -> Handle {
    Handle { name: format!("v{v}"), row: SparseRow { indices: vec![v as u32], values: vec![1.0] }, beta }
}

/// Handles on every seventh vertex, every third of them between two vertices.
pub(super) fn handles(proxy: &Proxy, beta: f64) -> Vec<Handle> {
    (0..proxy.rest.len())
        .step_by(7)
        .map(|v| {
            let mut handle = on_vertex(v, beta);
            if v % 3 == 0 && v + 1 < proxy.rest.len() {
                handle.row = SparseRow { indices: vec![v as u32, v as u32 + 1], values: vec![1.25, -0.25] };
            }
            handle
        })
        .collect()
}

pub(super) fn targets_of(proxy: &Proxy, handles: &[Handle], motion: impl Fn(DVec3) -> DVec3) -> Targets {
    let positions: Vec<DVec3> = handles.iter().map(|h| motion(h.row.apply(&proxy.rest))).collect();
    Targets { presence: vec![1.0; positions.len()], positions }
}

/// Twist about x by `angle` from end to end, with a bend.
pub(super) fn twisted(angle: f64) -> impl Fn(DVec3) -> DVec3 {
    move |p| DQuat::from_rotation_x(angle * p.x) * p + DVec3::Z * (0.3 * angle * p.x * p.x)
}

pub(super) fn rigid() -> (DQuat, DVec3) {
    (DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 1.0), DVec3::new(0.7, -0.3, 2.0))
}

pub(super) fn plain(iterations: u32) -> Options {
    Options { iterations: Some(iterations), ..Default::default() }
}

pub(super) fn to_the_end() -> Options {
    Options { tolerance: 1e-10, ..Default::default() }
}

pub(super) fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).fold(0.0, |m, (a, b)| if a.distance(*b) <= m { m } else { a.distance(*b) })
}

/// Poses of a growing twist, started at rest.
pub(super) fn twist(
    proxy: &Proxy,
    handles: &[Handle],
    options: &Options,
    frames: u32,
    around: impl Fn(DVec3) -> DVec3,
) -> Volumetric {
    let mut deformer = Volumetric::new(proxy, handles, options).unwrap();
    deformer.start(&targets_of(proxy, handles, |p| p)).unwrap();
    for frame in 1..=frames {
        let motion = twisted(0.25 * f64::from(frame));
        deformer.step(&targets_of(proxy, handles, |p| around(motion(p)))).unwrap();
    }
    deformer
}

/// Numbers in −1..1 from a fixed linear congruence.
pub(super) fn noise() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}
