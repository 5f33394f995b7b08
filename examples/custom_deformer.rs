//! A deformer of one's own: vertices of the proxy go along with the handles, the nearer the more (D. Shepard, *A two-dimensional interpolation function
//! for irregularly-spaced data*, 1968). It keeps no shape, and shows what the trait asks for.
//!
//! `cargo run --release --example custom_deformer fixtures/trunk.obj`

#![allow(clippy::print_stdout)]

use retarget::deform::{Deformer, FrameStats, Handle, Targets};
use retarget::error::{Error, Result};
use retarget::glam::DVec3;
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::proxy::{self, Proxy};
use retarget::{scan, surface::SurfaceMap};
use std::path::Path;

/// Moves by the mean of the handles' moves, weighted by the inverse square of the distance at rest.
pub struct Shepard {
    rest: Vec<DVec3>,
    /// Where the handles are at rest.
    places: Vec<DVec3>,
    pose: Vec<DVec3>,
}

impl Shepard {
    /// Everything that frames have in common.
    pub fn new(proxy: &Proxy, handles: &[Handle]) -> Self {
        let places = handles.iter().map(|handle| handle.row.apply(&proxy.rest)).collect();
        Self { rest: proxy.rest.clone(), places, pose: proxy.rest.clone() }
    }
}

impl Deformer for Shepard {
    fn start(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.step(targets)
    }

    fn step(&mut self, targets: &Targets) -> Result<FrameStats> {
        if targets.positions.len() != self.places.len() || targets.presence.len() != self.places.len() {
            return Err(Error::refused(format!("{} targets", targets.positions.len()))
                .expected(format!("one for each of {} handles", self.places.len())));
        }
        for (pose, rest) in self.pose.iter_mut().zip(&self.rest) {
            let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
            for ((place, target), presence) in self.places.iter().zip(&targets.positions).zip(&targets.presence) {
                // A released handle has no weight, and no target that could be believed.
                if *presence > 0.0 {
                    let weight = presence / rest.distance_squared(*place).max(1e-12);
                    sum += (*target - *place) * weight;
                    weights += weight;
                }
            }
            *pose = *rest + if weights > 0.0 { sum / weights } else { DVec3::ZERO };
        }
        Ok(FrameStats { passes: 1, converged: true, volume_ratio: 1.0, ..FrameStats::default() })
    }

    fn pose(&self) -> &[DVec3] {
        &self.pose
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "fixtures/trunk.obj".to_owned());
    let [low, high] = lift(path.as_ref(), 0.1)?;
    println!("the lowest vertex went {low:.4} diagonals up, the highest {high:.4}");
    Ok(())
}

/// Holds the lowest vertex, lifts the highest by a part of the diagonal, and says how far both went.
pub fn lift(scan: &Path, by: f64) -> Result<[f64; 2], Box<dyn std::error::Error>> {
    let scan = scan::read(scan)?;
    let unit_box = scan::UnitBox::of(&scan.mesh).ok_or("an empty mesh")?;
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let proxy = proxy::build(&points, &scan.mesh.vertex_triangles(), &Default::default(), &|| Ok(()))?.proxy;
    let map = SurfaceMap::build_by_pieces(&proxy, &points, &scan.mesh.faces, MapKind::Ring)?;

    let ends = [false, true].map(|highest| {
        let height = |v: &usize| if highest { points[*v].z } else { -points[*v].z };
        (0..points.len()).max_by(|a, b| height(a).total_cmp(&height(b))).unwrap_or(0)
    });
    let rows = HandleRows::new(&proxy, MapKind::Ring);
    let handles = ends.map(|v| Handle { name: format!("vertex {v}"), row: rows.row(points[v]), beta: 1.0 });
    let mut body: Box<dyn Deformer> = Box::new(Shepard::new(&proxy, &handles));
    let [low, high] = ends.map(|v| points[v]);
    body.start(&Targets { positions: vec![low, high + DVec3::Z * by], presence: vec![1.0; 2] })?;

    let mut posed = vec![Vec::new()];
    map.apply(&[body.pose()], &mut posed);
    Ok(ends.map(|v| f64::from(posed[0][v][2]) - points[v].z))
}
