//! A scan with a proxy, handles and a made-up motion: what the sections that need no capture work on.

use glam::{DQuat, DVec3};
use retarget::deform::{Handle, Targets};
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::proxy::{self, BuildOptions, Proxy};
use retarget::scan::{self, Scan, SurfaceMesh, UnitBox};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The given scan, else that of `fixtures/`, in triangles.
pub fn scan(path: Option<&String>) -> Scan {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/scan.obj");
    let mut scan = scan::read(&path.map_or(fixture, PathBuf::from)).unwrap();
    let triangles = scan.mesh.vertex_triangles();
    scan.mesh.faces = Default::default();
    triangles.into_iter().for_each(|t| scan.mesh.faces.push(t));
    scan.look = Default::default();
    scan
}

/// Points in the unit box.
pub fn points(mesh: &SurfaceMesh) -> Vec<DVec3> {
    let unit_box = UnitBox::of(mesh).unwrap();
    mesh.positions.iter().map(|&p| unit_box.enter(p)).collect()
}

/// Every triangle in four.
pub fn subdivided(mesh: &SurfaceMesh) -> SurfaceMesh {
    let mut fine = SurfaceMesh { positions: mesh.positions.clone(), ..Default::default() };
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    for face in mesh.faces.iter() {
        let middle = std::array::from_fn::<u32, 3, _>(|k| {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                fine.positions.push((mesh.positions[a as usize] + mesh.positions[b as usize]) / 2.0);
                fine.positions.len() as u32 - 1
            })
        });
        for k in 0..3 {
            fine.faces.push([face[k], middle[k], middle[(k + 2) % 3]]);
        }
        fine.faces.push(middle);
    }
    fine
}

pub fn proxy(points: &[DVec3], mesh: &SurfaceMesh, surface_vertices: usize) -> Proxy {
    proxy::build(points, &mesh.vertex_triangles(), &BuildOptions { surface_vertices }, &|| Ok(())).unwrap().proxy
}

/// Handles on vertices far from each other.
pub fn handles(proxy: &Proxy, count: usize) -> Vec<Handle> {
    let rows = HandleRows::new(proxy, MapKind::Ring);
    let mut skin: Vec<u32> = proxy.boundary.iter().flatten().copied().collect();
    skin.sort_unstable();
    skin.dedup();
    let place = |v: u32| proxy.rest[v as usize];
    let mut nearest = vec![f64::INFINITY; skin.len()];
    let mut next = 0;
    (0..count)
        .map(|k| {
            let here = place(skin[next]);
            for (near, &v) in nearest.iter_mut().zip(&skin) {
                *near = near.min(place(v).distance(here));
            }
            next = (0..skin.len()).max_by(|&a, &b| nearest[a].total_cmp(&nearest[b])).unwrap();
            Handle { name: format!("h{k}"), row: rows.row(here), beta: 1.0 }
        })
        .collect()
}

/// Where the handles are after so many seconds: the body twists and bends about its longest axis like somebody who walks on the spot.
pub fn targets(proxy: &Proxy, handles: &[Handle], seconds: f64) -> Targets {
    let extent = proxy.rest.iter().fold(DVec3::ZERO, |m, p| m.max(p.abs()));
    let up = if extent.y >= extent.x.max(extent.z) { DVec3::Y } else { DVec3::Z };
    let phase = std::f64::consts::TAU * seconds;
    let positions = handles.iter().map(|h| {
        let p = h.row.apply(&proxy.rest);
        let height = p.dot(up);
        let turn = DQuat::from_axis_angle(up, 0.5 * height * phase.sin())
            * DQuat::from_axis_angle(DVec3::X, 0.4 * height * (0.7 * phase).sin());
        turn * p + DVec3::new(0.02 * phase.sin(), 0.01 * (2.0 * phase).cos(), 0.0)
    });
    Targets { positions: positions.collect(), presence: vec![1.0; handles.len()] }
}
