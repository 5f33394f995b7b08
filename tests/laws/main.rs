//! Laws that every deformer keeps, over several meshes.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

#[path = "../common/mod.rs"]
mod common;
mod shapes;

use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::deform::{Deformer, Handle, Targets};
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::proxy::{BuildOptions, Proxy, build};
use retarget::surface::SurfaceMap;
use shapes::Shape;
use std::sync::OnceLock;

/// Rest in, rest out: the rounding of f32 positions in the unit box, with room for the far corners of the rows.
const REST: f64 = 1e-6;
/// A rigid motion comes back through solve and map.
const RIGID: f64 = 1e-5;

/// A shape with its proxy, map and handles.
struct Case {
    shape: Shape,
    proxy: Proxy,
    map: SurfaceMap,
    handles: Vec<Handle>,
    rest: Vec<DVec3>,
}

impl Case {
    fn new(shape: Shape, kind: MapKind) -> Self {
        let options = BuildOptions { surface_vertices: 800 };
        let proxy = build(&shape.points, &shape.triangles, &options, &|| Ok(())).unwrap().proxy;
        let map = SurfaceMap::build(&proxy, &shape.points, kind).unwrap();
        let rows = HandleRows::new(&proxy, kind);
        let attachments = shape.spread(14);
        let handles =
            attachments.iter().enumerate().map(|(i, &p)| Handle { name: format!("h{i}"), row: rows.row(p), beta: 1.0 }).collect();
        Self { shape, proxy, map, handles, rest: attachments }
    }

    fn deformer(&self) -> Volumetric {
        Volumetric::new(&self.proxy, &self.handles, &Options::default()).unwrap()
    }

    fn targets(&self, motion: impl Fn(DVec3) -> DVec3) -> Targets {
        Targets { positions: self.rest.iter().map(|&p| motion(p)).collect(), presence: vec![1.0; self.rest.len()] }
    }

    fn surface(&self, pose: &[DVec3]) -> Vec<DVec3> {
        let mut out = vec![Vec::new()];
        self.map.apply(&[pose], &mut out);
        out[0].iter().map(|p| DVec3::from(p.map(f64::from))).collect()
    }

    /// Largest distance of the posed scan from the scan under a motion.
    fn error(&self, pose: &[DVec3], motion: impl Fn(DVec3) -> DVec3) -> f64 {
        let posed = self.surface(pose);
        posed.iter().zip(&self.shape.points).map(|(p, &q)| p.distance(motion(q))).fold(0.0, f64::max)
    }
}

fn cases() -> &'static [Case] {
    static CASES: OnceLock<Vec<Case>> = OnceLock::new();
    CASES.get_or_init(|| shapes::all().into_iter().map(|s| Case::new(s, MapKind::Ring)).collect())
}

#[test]
fn rest_in_gives_rest_out() {
    for case in cases() {
        let mut deformer = case.deformer();
        deformer.start(&case.targets(|p| p)).unwrap();
        deformer.step(&case.targets(|p| p)).unwrap();
        let error = case.error(deformer.pose(), |p| p);
        assert!(error < REST, "{}: {error:e} of the diagonal", case.shape.name);
    }
}

#[test]
fn rows_sum_to_one_and_reproduce_affine_maps() {
    let a = DMat3::from_cols(DVec3::new(1.1, 0.2, -0.1), DVec3::new(-0.3, 0.8, 0.1), DVec3::new(0.05, 0.2, 1.3));
    let affine = |p: DVec3| a * p + DVec3::new(0.2, -0.1, 0.3);
    for case in cases() {
        let posed: Vec<DVec3> = case.proxy.rest.iter().map(|&p| affine(p)).collect();
        let error = case.error(&posed, affine);
        assert!(error < 1e-6, "{}: affine maps to {error:e}", case.shape.name);
        for vertex in (0..case.map.len()).step_by(7) {
            let sum: f64 = case.map.row(vertex).values.iter().sum();
            assert!((sum - 1.0).abs() < 1e-6, "{}: row {vertex} sums to {sum}", case.shape.name);
        }
        for (handle, &p) in case.handles.iter().zip(&case.rest) {
            assert!(handle.row.apply(&posed).distance(affine(p)) < 1e-9, "{}: {}", case.shape.name, handle.name);
        }
    }
}

#[test]
fn the_map_of_the_paper_keeps_the_same_laws() {
    let case = Case::new(shapes::bar(), MapKind::Paper);
    let mut deformer = case.deformer();
    deformer.start(&case.targets(|p| p)).unwrap();
    assert!(case.error(deformer.pose(), |p| p) < REST);
    let shear = |p: DVec3| DVec3::new(p.x + 0.3 * p.y, p.y, p.z - 0.1 * p.x);
    let posed: Vec<DVec3> = case.proxy.rest.iter().map(|&p| shear(p)).collect();
    assert!(case.error(&posed, shear) < 1e-6);
}

#[test]
fn a_released_handle_pulls_no_more() {
    for case in cases() {
        let mut deformer = case.deformer();
        let mut targets = case.targets(|p| p);
        deformer.start(&targets).unwrap();
        targets.positions[3] += DVec3::new(0.2, 0.1, 0.0);
        targets.presence[3] = 0.0;
        deformer.step(&targets).unwrap();
        let error = case.error(deformer.pose(), |p| p);
        assert!(error < RIGID, "{}: moved by {error:e}", case.shape.name);
        targets.presence[3] = 1.0;
        deformer.step(&targets).unwrap();
        assert!(case.error(deformer.pose(), |p| p) > 1e-3, "{}: the handle is back and must pull", case.shape.name);
    }
}

#[test]
fn a_frame_does_not_depend_on_later_ones_and_repeats_bit_for_bit() {
    let case = &cases()[0];
    let motion = |k: usize| move |p: DVec3| DQuat::from_rotation_y(0.05 * k as f64 * (p.x + 0.5)) * p;
    let run = || {
        let mut deformer = case.deformer();
        deformer.start(&case.targets(motion(0))).unwrap();
        for k in 1..6 {
            deformer.step(&case.targets(motion(k))).unwrap();
        }
        deformer.pose().to_vec()
    };
    assert_eq!(run(), run());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_rigid_motion_of_all_targets_moves_the_scan_by_it(
        axis in prop::array::uniform3(-1.0f64..1.0), angle in -3.1f64..3.1, shift in prop::array::uniform3(-2.0f64..2.0),
    ) {
        let axis = DVec3::from(axis);
        prop_assume!(axis.length() > 0.1);
        let rotation = DQuat::from_axis_angle(axis.normalize(), angle);
        let motion = |p: DVec3| rotation * p + DVec3::from(shift);
        for case in cases() {
            let mut deformer = case.deformer();
            deformer.start(&case.targets(motion)).unwrap();
            let error = case.error(deformer.pose(), motion);
            prop_assert!(error < RIGID, "{}: {error:e} of the diagonal", case.shape.name);
        }
    }
}
