//! The figures and tables of Fröhlich and Botsch 2011 as laws, with what they print beside what comes out here (`-- --nocapture`).
//!
//! Shapes are made here; those of real animals and people are put through the same where they are present. `scripts/shells.sh` prints the table;
//! with RETARGET_KEEP=FOLDER the poses of figures 1 and 8 are drawn into it.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;

use common::shared;
use glam::{DMat3, DQuat, DVec3};
use retarget::deform::shells::{Body, Interpolator, Material, Options, Shells, SurfaceRows};
use retarget::deform::{Deformer, FrameStats, Grip, Handle, OrientedHandle, Placement, Targets};
use retarget::error::Notes;
use retarget::picture;
use retarget::scan::{self, Scan, UnitBox};
use retarget::surface::SurfaceMap;
use std::time::Instant;

fn say(figure: &str, what: &str, theirs: &str, ours: String) {
    eprintln!("{figure:<10} {what:<58} paper {theirs:<16} here {ours}");
}

/// A round bar along z, closed by fans.
fn cylinder(length: f64, radius: f64, rings: usize, segments: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    for ring in 0..rings {
        for segment in 0..segments {
            let angle = std::f64::consts::TAU * segment as f64 / segments as f64;
            points.push(DVec3::new(radius * angle.cos(), radius * angle.sin(), length * ring as f64 / (rings - 1) as f64));
        }
    }
    let at = |ring: usize, segment: usize| (ring * segments + segment % segments) as u32;
    let mut faces = Vec::new();
    for ring in 0..rings - 1 {
        for segment in 0..segments {
            let (p, q, u, v) = (at(ring, segment), at(ring, segment + 1), at(ring + 1, segment), at(ring + 1, segment + 1));
            faces.extend(if (ring + segment) % 2 == 0 { [[p, q, u], [q, v, u]] } else { [[p, q, v], [p, v, u]] });
        }
    }
    let end = points.len() as u32;
    points.extend([DVec3::ZERO, DVec3::Z * length]);
    for segment in 0..segments {
        faces.push([at(0, segment + 1), at(0, segment), end]);
        faces.push([at(rings - 1, segment), at(rings - 1, segment + 1), end + 1]);
    }
    (points, faces)
}

/// The skin of unit cubes, closed where they hang together by their sides; `rounds` of smoothing.
fn cubes(size: [i32; 3], rounds: usize, inside: impl Fn([i32; 3]) -> bool) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let solid = |at: [i32; 3]| (0..3).all(|k| (0..size[k]).contains(&at[k])) && inside(at);
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    let mut number = std::collections::HashMap::new();
    for cell in (0..size[2]).flat_map(|z| (0..size[1]).flat_map(move |y| (0..size[0]).map(move |x| [x, y, z]))) {
        for (axis, out) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]).filter(|_| solid(cell)) {
            let mut beside = cell;
            beside[axis] += 2 * out - 1;
            if solid(beside) {
                continue;
            }
            let mut corner = |u: i32, v: i32| {
                let mut at = cell;
                at[axis] += out;
                at[(axis + 1) % 3] += u;
                at[(axis + 2) % 3] += v;
                *number.entry(at).or_insert_with(|| {
                    points.push(DVec3::from_array(at.map(f64::from)));
                    points.len() as u32 - 1
                })
            };
            let [p, q, r, s] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            faces.extend(if out == 1 { [[p, q, r], [p, r, s]] } else { [[p, r, q], [p, s, r]] });
        }
    }
    for _ in 0..rounds {
        let mut sums = vec![(DVec3::ZERO, 0.0); points.len()];
        for t in &faces {
            for k in 0..3 {
                let (own, next) = (t[k] as usize, points[t[(k + 1) % 3] as usize]);
                sums[own] = (sums[own].0 + next, sums[own].1 + 1.0);
            }
        }
        points = sums.iter().map(|(sum, count)| *sum / *count).collect();
    }
    (points, faces)
}

/// What `near` holds stays, what `far` holds is turned about `pivot` and shifted, both exactly.
fn ends(
    (points, faces): (&[DVec3], &[[u32; 3]]),
    (near, far): (impl Fn(DVec3) -> bool, impl Fn(DVec3) -> bool),
    material: Material,
    pivot: DVec3,
    (turn, to): (DQuat, DVec3),
) -> (Vec<DVec3>, FrameStats) {
    let body = Body::build(points, faces, &[], 100_000, &|| Ok(())).unwrap().numbered_as_scan();
    let hold = |name: &str, rest: DVec3, keep: &dyn Fn(DVec3) -> bool| OrientedHandle {
        name: name.into(),
        rest,
        grip: Grip::Exact { vertices: (0..body.vertices() as u32).filter(|v| keep(body.proxy.rest[*v as usize])).collect() },
    };
    let oriented = [hold("near", DVec3::ZERO, &near), hold("far", pivot, &far)];
    let options = Options { material, steps: 200, decrease: 1e-10, still: 0.0, ..Options::for_examples(0) };
    let mut shells = Shells::new(&body, &[], &oriented, &options).unwrap();
    let place = |position, orientation| Placement { position, orientation, presence: 1.0 };
    let mut stats = FrameStats::default();
    // In one jump, then until nothing moves.
    for frame in 0..8 {
        shells.place(&[place(DVec3::ZERO, DQuat::IDENTITY), place(to, turn)]).unwrap();
        stats = if frame == 0 { shells.start(&Targets::default()).unwrap() } else { shells.step(&Targets::default()).unwrap() };
    }
    (shells.pose()[..body.vertices()].to_vec(), stats)
}

/// The same for a bar along z.
fn bar_ends(mesh: (&[DVec3], &[[u32; 3]]), length: f64, material: Material, turn: DQuat, to: DVec3) -> (Vec<DVec3>, FrameStats) {
    ends(mesh, (|p| p.z < 1e-9, |p| p.z > length - 1e-9), material, DVec3::Z * length, (turn, to))
}

#[test]
fn figures_1_and_4_ends_that_are_turned_and_pulled() {
    let plain = Material { by_area: false, ..Material::WITH_EXAMPLES };
    // Fig. 4: a cylinder pulled to one and a half times its length.
    let (points, faces) = cylinder(4.0, 1.0, 25, 24);
    let edges = faces.len() as f64 * 1.5;
    for (volume, name, theirs, limit) in
        [(0.0, "without a volume term", "42 %", 0.40), (10.0 * 100.0 * edges, "with one of 10 lambda m", "0.007 %", 0.0015)]
    {
        let material = Material { stretching: 100.0, volume, ..plain };
        let (pose, _) = bar_ends((&points, &faces), 4.0, material, DQuat::IDENTITY, DVec3::Z * 6.0);
        let error = volume_of(&pose, &faces) / volume_of(&points, &faces) - 1.0;
        say("Fig. 4", &format!("volume of a stretched cylinder {name}"), theirs, format!("{:.3} %", 100.0 * error));
        assert!(error.abs() < limit && (volume > 0.0 || error > 0.3), "{error}");
    }
    // Fig. 1: bent by 120° and twisted by 135°, in one jump from rest.
    let soft = Material { stretching: 1.0, volume: 10.0 * edges, ..plain };
    let (points, faces) = cylinder(6.0, 0.6, 49, 24);
    let angle = 120_f64.to_radians();
    let radius = 6.0 / angle;
    let to = DVec3::new(radius * (1.0 - angle.cos()), 0.0, radius * angle.sin());
    for (name, turn, to) in [
        ("a cylinder bent by 120\u{b0}", DQuat::from_rotation_y(angle), to),
        ("a cylinder twisted by 135\u{b0}", DQuat::from_rotation_z(135_f64.to_radians()), DVec3::Z * 6.0),
    ] {
        let (pose, stats) = bar_ends((&points, &faces), 6.0, soft, turn, to);
        let ratio = volume_of(&pose, &faces) / volume_of(&points, &faces);
        let sections: Vec<f64> = (1..48).map(|ring| roundness(&pose[ring * 24..(ring + 1) * 24])).collect();
        let flattest = sections.iter().copied().fold(1.0, f64::min);
        say(
            "Fig. 1",
            name,
            "smooth",
            format!("volume {:.2} %, flattest section {flattest:.3}, {} steps in the end", 100.0 * ratio, stats.passes),
        );
        assert!((ratio - 1.0).abs() < 0.02 && flattest > 0.85, "{ratio} {flattest}");
        keep(&format!("figure 1 {name}"), &[&points, &pose], &faces);
    }
    // Fig. 2: the same bend where one of the two stiffnesses dominates.
    let strain = |pose: &[DVec3]| {
        let edges = faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let strains = edges.map(|(a, b)| {
            let [a, b] = [a, b].map(|v| v as usize);
            (pose[a].distance(pose[b]) / points[a].distance(points[b]) - 1.0).powi(2)
        });
        (strains.sum::<f64>() / (3 * faces.len()) as f64).sqrt()
    };
    let turn = DQuat::from_rotation_y(angle);
    let [bending, stretching] = [(1.0, 100.0), (100.0, 1.0)].map(|(stretching, bending)| {
        let material = Material { stretching, bending, volume: 0.0, ..plain };
        let (pose, _) = bar_ends((&points, &faces), 6.0, material, turn, to);
        let flattest = (1..48).map(|ring| roundness(&pose[ring * 24..(ring + 1) * 24])).fold(1.0, f64::min);
        (strain(&pose), flattest)
    });
    let words =
        |(strain, flattest): (f64, f64)| format!("edges strained by {:.2} % rms, flattest section {flattest:.2}", 100.0 * strain);
    say("Fig. 2", "the bend with dominating bending stiffness", "sections kept", words(bending));
    say("Fig. 2", "the bend with dominating stretching stiffness", "edges kept", words(stretching));
    assert!(stretching.0 < 0.5 * bending.0 && stretching.1 < bending.1, "{bending:?} {stretching:?}");
}

/// The other shapes of the benchmark (Botsch, Sorkine 2008): a square bar twisted by 135°, a cactus bent by 70°, a bump that is lifted out of a plane.
#[test]
fn figure_1_a_bar_a_cactus_and_a_bump() {
    let plain = Material { by_area: false, stretching: 1.0, ..Material::WITH_EXAMPLES };
    let solid = |faces: &[[u32; 3]]| Material { volume: 10.0 * 1.5 * faces.len() as f64, ..plain };
    let kept = |pose: &[DVec3], rest: &[DVec3], faces: &[[u32; 3]]| volume_of(pose, faces) / volume_of(rest, faces);

    let (points, faces) = cubes([8, 8, 40], 0, |_| true);
    let turn = DQuat::from_rotation_z(135_f64.to_radians());
    let centre = DVec3::new(4.0, 4.0, 0.0);
    let to = DVec3::Z * 40.0 + centre - turn * centre;
    let (pose, stats) = bar_ends((&points, &faces), 40.0, solid(&faces), turn, to);
    let ratio = kept(&pose, &points, &faces);
    // Each layer of the sides turns by its share of the twist.
    let turned = |p: DVec3, q: DVec3| {
        let (p, q) = ((p - centre).truncate(), (q - centre).truncate());
        p.angle_to(q).rem_euclid(std::f64::consts::TAU).to_degrees()
    };
    let uneven = points.iter().zip(&pose).filter(|(p, _)| (*p - centre).truncate().length() > 5.0);
    let uneven = uneven.map(|(p, q)| (turned(*p, *q) - 135.0 * q.z / 40.0).abs()).fold(0.0, f64::max);
    let words = format!(
        "volume {:.2} %, layers within {uneven:.1}\u{b0} of their share, {} edges inside out",
        100.0 * ratio,
        stats.inverted
    );
    say("Fig. 1", "a square bar twisted by 135\u{b0}", "smooth", words);
    assert!((ratio - 1.0).abs() < 0.02 && stats.inverted == 0 && uneven < 10.0, "{ratio} {stats:?} {uneven}");
    keep("figure 1 bar", &[&points, &pose], &faces);

    // A trunk with an arm to each side.
    let arm = |x: i32, z: i32, side: [i32; 2], upright: [i32; 2], low: i32, high: i32| {
        (side[0]..side[1]).contains(&x) && (low..low + 4).contains(&z)
            || (upright[0]..upright[1]).contains(&x) && (low..high).contains(&z)
    };
    let (points, faces) = cubes([22, 6, 36], 12, |[x, y, z]| {
        let arms = arm(x, z, [0, 8], [0, 4], 12, 26) || arm(x, z, [14, 22], [18, 22], 16, 30);
        (8..14).contains(&x) || (1..5).contains(&y) && arms
    });
    let turn = DQuat::from_rotation_y(70_f64.to_radians());
    let pivot = DVec3::new(11.0, 3.0, 34.0);
    // The top of a trunk that bends to an arc of its own length.
    let radius = 34.0 / 70_f64.to_radians();
    let to = DVec3::new(11.0 + radius * (1.0 - 70_f64.to_radians().cos()), 3.0, radius * 70_f64.to_radians().sin());
    let (pose, stats) = ends((&points, &faces), (|p| p.z < 2.0, |p| p.z > 33.0), solid(&faces), pivot, (turn, to));
    let ratio = kept(&pose, &points, &faces);
    let words = format!("volume {:.2} %, {} edges inside out", 100.0 * ratio, stats.inverted);
    say("Fig. 1", "a cactus bent by 70\u{b0}", "smooth", words);
    assert!((ratio - 1.0).abs() < 0.03 && stats.inverted == 0, "{ratio} {stats:?}");
    keep("figure 1 cactus", &[&points, &pose], &faces);

    let (side, cells) = (20.0, 40_u32);
    let from_middle = |p: DVec3| (p.truncate() - glam::DVec2::splat(0.5 * side)).length();
    let points: Vec<DVec3> = (0..=cells)
        .flat_map(|j| (0..=cells).map(move |i| DVec3::new(f64::from(i), f64::from(j), 0.0) * side / f64::from(cells)))
        .map(|p| p + DVec3::Z * 2.0 * (-(from_middle(p) / 3.0).powi(2)).exp())
        .collect();
    let at = |i: u32, j: u32| j * (cells + 1) + i;
    let faces: Vec<[u32; 3]> = (0..cells)
        .flat_map(|j| (0..cells).map(move |i| (i, j)))
        .flat_map(|(i, j)| [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]])
        .collect();
    let edge = |p: DVec3| p.x < 1e-9 || p.y < 1e-9 || p.x > side - 1e-9 || p.y > side - 1e-9;
    let open = Material { volume: 0.0, ..plain };
    let lift = DVec3::Z * 4.0;
    let top = DVec3::new(10.0, 10.0, 2.0);
    let (pose, stats) = ends((&points, &faces), (edge, |p| from_middle(p) < 2.0), open, top, (DQuat::IDENTITY, top + lift));
    // Between the bump and the edge it climbs everywhere: no dent, no overshoot.
    let lifts: Vec<f64> = points.iter().zip(&pose).map(|(p, q)| (*q - *p).z / lift.z).collect();
    let (least, most) = lifts.iter().fold((f64::MAX, f64::MIN), |(lo, hi), l| (lo.min(*l), hi.max(*l)));
    let words = format!("lifts from {least:.3} to {most:.3} of the handle's, {} edges inside out", stats.inverted);
    say("Fig. 1", "a bump lifted out of a plane", "smooth", words);
    assert!(least > -0.05 && most < 1.05 && stats.inverted == 0, "{least} {most} {stats:?}");
    keep("figure 1 bump", &[&points, &pose], &faces);
}

/// Draws poses side by side into the folder that RETARGET_KEEP names, if it does.
fn keep(name: &str, poses: &[&[DVec3]], triangles: &[[u32; 3]]) {
    let Some(folder) = std::env::var_os("RETARGET_KEEP") else { return };
    let mut right = 0.0;
    let shifted: Vec<Vec<DVec3>> = poses
        .iter()
        .map(|points| {
            let (lo, hi) = points.iter().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p.x), hi.max(p.x)));
            let moved = points.iter().map(|p| *p + DVec3::X * (right - lo)).collect();
            right += hi - lo + 0.6;
            moved
        })
        .collect();
    let colors = vec![[200, 180, 150]; triangles.len()];
    let surface = |points| picture::Surface { points, triangles, colors: picture::Colors::PerFace(&colors) };
    let sheet = picture::Sheet {
        surfaces: shifted.iter().map(|points| surface(points)).collect(),
        views: vec![picture::View { title: String::new(), toward: DVec3::new(-0.3, -1.0, 0.4), up: DVec3::Z }],
        heading: vec![name.to_owned()],
        height: 600,
        ..picture::Sheet::default()
    };
    let file = std::path::Path::new(&folder).join(format!("{}.png", name.replace([' ', '.', '\u{b0}'], "_")));
    std::fs::write(file, picture::draw(&sheet).png().unwrap()).unwrap();
}

/// A tube along the helix of this curvature and torsion, or along a line.
fn helix(curvature: f64, torsion: f64, length: f64, rings: usize, segments: usize) -> Vec<DVec3> {
    let twist = (curvature * curvature + torsion * torsion).sqrt();
    let (radius, rise) = if twist > 0.0 { (curvature / twist.powi(2), torsion / twist) } else { (0.0, 1.0) };
    let ring = |k: usize| {
        let s = length * k as f64 / (rings - 1) as f64;
        let (sin, cos) = (twist * s).sin_cos();
        let centre = DVec3::new(radius * cos, radius * sin, rise * s);
        let tangent = DVec3::new(-radius * twist * sin, radius * twist * cos, rise);
        // Twisted with its torsion, so that a share of the example is the helix of that share of both.
        let normal = DVec3::new(-cos, -sin, 0.0);
        (centre, [normal, tangent.normalize().cross(normal)])
    };
    let mut points: Vec<DVec3> = (0..rings * segments)
        .map(|i| {
            let (centre, [u, v]) = ring(i / segments);
            let angle = std::f64::consts::TAU * (i % segments) as f64 / segments as f64;
            centre + 0.2 * (u * angle.cos() + v * angle.sin())
        })
        .collect();
    points.extend([ring(0).0, ring(rings - 1).0]);
    points
}

/// One pose moved rigidly onto another.
fn aligned(x: &[DVec3], onto: &[DVec3]) -> Vec<DVec3> {
    let centre = |x: &[DVec3]| x.iter().sum::<DVec3>() / x.len() as f64;
    let (from, to) = (centre(x), centre(onto));
    let mut covariance = DMat3::ZERO;
    for (a, t) in x.iter().zip(onto) {
        let (a, t) = (*a - from, *t - to);
        covariance += DMat3::from_cols(t * a.x, t * a.y, t * a.z);
    }
    let turn = retarget::linalg::nearest_rotation(covariance, DMat3::IDENTITY);
    x.iter().map(|p| turn * (*p - from) + to).collect()
}

#[test]
fn figure_6_a_tube_winds_up_to_a_helix() {
    let (rings, segments, length) = (121, 10, 20.0);
    let turns = 4.0 * std::f64::consts::TAU;
    // Four turns of radius 0.7.
    let twist = turns / length;
    let curvature = 0.7 * twist * twist;
    let torsion = (twist * twist - curvature * curvature).sqrt();
    let of = |share: f64| helix(share * curvature, share * torsion, length, rings, segments);
    let (_, faces) = cylinder(1.0, 1.0, rings, segments);
    let body = Body::build(&of(0.0), &faces, &[of(1.0)], 100_000, &|| Ok(())).unwrap().numbered_as_scan();
    let mut solver = Interpolator::new(&body, &Material::PAPER).unwrap();
    // By small steps: the tube is a hundred times as long as thick.
    for step in 0..=20 {
        let share = f64::from(step) / 20.0;
        let stats = solver.solve(&[share]).unwrap();
        if step % 5 != 0 {
            continue;
        }
        let limit = if step % 20 == 0 { 1e-6 } else { 0.03 };
        let exact = of(share);
        let (lo, hi) = exact.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let found = aligned(&solver.pose()[..body.vertices()], &exact);
        let off = found.iter().zip(&exact).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / (hi - lo).length();
        let words = format!("{:.2} % of D from the helix of that curvature, {} steps", 100.0 * off, stats.passes);
        say("Fig. 6", &format!("a straight tube wound up, weight {share}"), "a helix", words);
        assert!(off < limit && stats.converged, "{share}: {off}");
    }
}

/// Smallest over largest distance of opposite points.
fn roundness(ring: &[DVec3]) -> f64 {
    let half = ring.len() / 2;
    let widths = (0..half).map(|k| ring[k].distance(ring[k + half]));
    let (lo, hi) = widths.fold((f64::INFINITY, 0.0_f64), |(lo, hi), w| (lo.min(w), hi.max(w)));
    lo / hi
}

fn volume_of(points: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    faces.iter().map(|f| f.map(|v| points[v as usize])).map(|[a, b, c]| a.cross(b).dot(c)).sum::<f64>() / 6.0
}

/// A set of poses: the scan, its points in the unit box, and its examples.
struct Set {
    scan: Scan,
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    names: Vec<String>,
    poses: Vec<Vec<DVec3>>,
}

fn set(name: &str, rest: &str) -> Option<Set> {
    let folder = shared()?.join("meshes/examples").join(name);
    let mut files: Vec<_> = std::fs::read_dir(&folder).ok()?.filter_map(|e| Some(e.ok()?.path())).collect();
    files.retain(|f| f.to_string_lossy().ends_with(".obj.gz"));
    files.sort();
    let at = files.iter().position(|f| f.to_string_lossy().contains(rest))?;
    let scan = scan::read(&files.remove(at)).unwrap();
    let unit = UnitBox::of(&scan.mesh).unwrap();
    let enter = |points: &[DVec3]| points.iter().map(|p| unit.enter(*p)).collect::<Vec<_>>();
    let poses = scan::read_poses(&scan, &files, false, &mut Notes::default()).unwrap();
    Some(Set {
        points: enter(&scan.mesh.positions),
        triangles: scan.mesh.vertex_triangles(),
        names: poses.iter().map(|p| p.name.clone()).collect(),
        poses: poses.iter().map(|p| enter(&p.positions)).collect(),
        scan,
    })
}

impl Set {
    fn body(&self, target: usize, examples: &[Vec<DVec3>]) -> Body {
        Body::build(&self.points, &self.triangles, examples, target, &|| Ok(())).unwrap().numbered_as_scan()
    }

    /// Vertices far from each other.
    fn spread(&self, count: usize) -> Vec<usize> {
        let mut chosen = vec![0];
        let mut distances: Vec<f64> = self.points.iter().map(|p| p.distance(self.points[0])).collect();
        while chosen.len() < count {
            let next = (0..distances.len()).max_by(|a, b| distances[*a].total_cmp(&distances[*b])).unwrap();
            chosen.push(next);
            distances.iter_mut().zip(&self.points).for_each(|(d, p)| *d = d.min(p.distance(self.points[next])));
        }
        chosen
    }
}

fn handles(rows: &SurfaceRows, points: &[DVec3], at: &[usize]) -> Vec<Handle> {
    at.iter().map(|&v| Handle { name: format!("v{v}"), row: rows.row(points[v]), beta: 1.0 }).collect()
}

fn targets(x: &[DVec3], at: &[usize]) -> Targets {
    Targets { positions: at.iter().map(|&v| x[v]).collect(), presence: vec![1.0; at.len()] }
}

fn apply(map: &SurfaceMap, pose: &[DVec3]) -> Vec<DVec3> {
    let mut out = vec![Vec::new()];
    map.apply(&[pose], &mut out);
    out[0].iter().map(|p| DVec3::from(p.map(f64::from))).collect()
}

/// Root mean square, that of 99 % and the largest of the distances.
fn spread_of(a: &[DVec3], b: &[DVec3]) -> [f64; 3] {
    let mut all: Vec<f64> = a.iter().zip(b).map(|(a, b)| a.distance(*b)).collect();
    all.sort_unstable_by(f64::total_cmp);
    let rms = (all.iter().map(|d| d * d).sum::<f64>() / all.len() as f64).sqrt();
    [rms, all[all.len() * 99 / 100], all[all.len() - 1]]
}

#[test]
fn figure_7_handles_of_a_turned_example_find_it() {
    let Some(lion) = set("lion_sumner", "reference") else { return };
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 2.3);
    let mut examples = lion.poses.clone();
    for p in &mut examples[1] {
        *p = turn * *p + DVec3::new(2.0, -1.0, 0.5);
    }
    let body = lion.body(1000, &examples);
    let map = SurfaceMap::build_for_shell(&body, &lion.points, &lion.scan.mesh.faces, &examples);
    let at = lion.spread(14);
    let handles = handles(&SurfaceRows::new(&body), &lion.points, &at);
    for (i, pose) in lion.poses.iter().enumerate() {
        let mut shells = Shells::new(&body, &handles, &[], &Options::for_examples(examples.len())).unwrap();
        shells.start(&targets(pose, &at)).unwrap();
        let weights = shells.weights();
        let [rms, most, _] = spread_of(&apply(&map, shells.pose()), pose);
        let words = format!("weight {:.4}, rms {:.3} %, 99 % {:.3} % of D", weights[i], 100.0 * rms, 100.0 * most);
        say(
            "Fig. 7",
            &format!("{} from 14 of its vertices{}", lion.names[i], if i == 1 { ", turned" } else { "" }),
            "found",
            words,
        );
        assert!((weights[i] - 1.0).abs() < 0.02 && most < 0.01 && rms < 0.002, "{weights:?}");
    }
}

const RINGS: usize = 121;
const SEGMENTS: usize = 40;

/// An arm of length 3 along x with waves on its skin, shoulder and elbow bent by so many degrees; the muscle swells with the elbow.
fn arm(shoulder: f64, elbow: f64) -> Vec<DVec3> {
    let smooth = |s: f64, at: f64| {
        let t = ((s - at) / 0.8 + 0.5).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    let turn = |s: f64| DQuat::from_rotation_z((shoulder * smooth(s, 0.85) + elbow * smooth(s, 1.8)).to_radians());
    let (mut points, mut centre, mut before) = (Vec::new(), DVec3::ZERO, 0.0);
    for ring in 0..RINGS {
        let s = 3.0 * ring as f64 / (RINGS - 1) as f64;
        centre += (s - before) * 0.5 * (turn(s) * DVec3::X + turn(before) * DVec3::X);
        before = s;
        for segment in 0..SEGMENTS {
            let angle = std::f64::consts::TAU * segment as f64 / SEGMENTS as f64;
            let muscle = 0.0025 * elbow * (-((s - 1.25) / 0.25).powi(2)).exp() * angle.cos().max(0.0);
            let waves = 1.0 + 0.02 * (9.0 * angle).sin() * (20.0 * s).sin();
            let radius = (0.3 - 0.1 * smooth(s, 1.9)) * (1.0 + muscle) * waves;
            points.push(centre + radius * (turn(s) * (DVec3::Y * angle.cos() + DVec3::Z * angle.sin())));
        }
    }
    points.extend([DVec3::ZERO, centre]);
    points
}

/// The arm with its examples as a coarse body, and handles on its skin and in its joints.
struct Arm {
    body: Body,
    map: SurfaceMap,
    handles: Vec<Handle>,
}

/// Points of the skin, and rings whose centres are joints.
const SKIN: [(usize, usize); 10] = [(0, 0), (0, 13), (0, 26), (8, 7), (8, 27), (16, 20), (60, 7), (88, 12), (100, 30), (110, 0)];
const JOINTS: [usize; 2] = [72, 112];

/// Where an arm holds its handles.
fn places(x: &[DVec3]) -> Vec<DVec3> {
    let centre = |ring: usize| x[ring * SEGMENTS..(ring + 1) * SEGMENTS].iter().sum::<DVec3>() / SEGMENTS as f64;
    SKIN.iter().map(|&(ring, segment)| x[ring * SEGMENTS + segment]).chain(JOINTS.map(centre)).collect()
}

impl Arm {
    fn new() -> Self {
        let (_, faces) = cylinder(3.0, 1.0, RINGS, SEGMENTS);
        let (rest, examples) = (arm(0.0, 0.0), [arm(0.0, 100.0), arm(70.0, 0.0)]);
        let body = Body::build(&rest, &faces, &examples, 1000, &|| Ok(())).unwrap().numbered_as_scan();
        let mut polygons = retarget::scan::Faces::default();
        faces.iter().for_each(|f| polygons.push(*f));
        let map = SurfaceMap::build_for_shell(&body, &rest, &polygons, &examples);
        let rows = SurfaceRows::new(&body);
        let handles = places(&rest)
            .into_iter()
            .enumerate()
            .map(|(i, p)| Handle { name: format!("h{i}"), row: rows.row(p), beta: 1.0 })
            .collect();
        Self { body, map, handles }
    }

    fn shells(&self, options: &Options) -> Shells {
        Shells::new(&self.body, &self.handles, &[], options).unwrap()
    }

    fn targets(&self, x: &[DVec3]) -> Targets {
        Targets { positions: places(x), presence: vec![1.0; self.handles.len()] }
    }
}

#[test]
fn figures_8_9_and_10_combined_examples_what_lies_outside_and_a_bad_start() {
    let (arm_of, whole) = (Arm::new(), Options { steps: 60, decrease: 1e-9, still: 1e-8, ..Options::for_examples(2) });
    let (_, faces) = cylinder(3.0, 1.0, RINGS, SEGMENTS);
    let diagonal = 3.1;
    // Fig. 9: shoulder and elbow, each in an example of its own, together.
    let mut shells = arm_of.shells(&Options::for_examples(2));
    for t in 0..=20 {
        let t = f64::from(t) / 10.0;
        shells.step(&arm_of.targets(&arm(70.0 * t.min(1.0), 100.0 * (t - 1.0).max(0.0)))).unwrap();
    }
    let both = arm(70.0, 100.0);
    let [rms, most, largest] = spread_of(&apply(&arm_of.map, shells.pose()), &both).map(|d| 100.0 * d / diagonal);
    let weights = shells.weights().to_vec();
    let words = format!("weights {:.3} and {:.3}; rms {rms:.3} %, 99 % {most:.3} %, {largest:.3} % of D", weights[0], weights[1]);
    say("Fig. 9", "shoulder by 70\u{b0} and elbow by 100\u{b0}, from an example of each", "combined", words);
    assert!(weights.iter().all(|w| (w - 1.0).abs() < 0.05) && rms < 0.2 && largest < 1.0, "{weights:?} {rms} {largest}");
    // Fig. 10: to there in one jump from the shoulder's pose, as it was left.
    let mut jump = arm_of.shells(&whole);
    jump.start(&arm_of.targets(&arm(70.0, 0.0))).unwrap();
    let stats = jump.step(&arm_of.targets(&arm(70.0, 60.0))).unwrap();
    let [rms, _, off] = spread_of(&apply(&arm_of.map, jump.pose()), &arm(70.0, 60.0)).map(|d| 100.0 * d / diagonal);
    let words = format!("{} steps; rms {rms:.3} %, {off:.3} % of D", stats.passes);
    say("Fig. 10", "the elbow's handles by 60\u{b0} in one jump", "9 iterations", words);
    assert!(stats.converged && !stats.recovered && off < 1.0 && stats.passes <= 40, "{stats:?} {off}");
    // Fig. 8: across the plane in which all examples lie.
    let turned = |t: f64| -> Vec<DVec3> {
        let out = |p: DVec3| DQuat::from_rotation_y(-(35.0 * t).to_radians() * ((p.x - 0.85) / 0.8 + 0.5).clamp(0.0, 1.0));
        arm(0.0, 50.0 * t).iter().map(|p| DVec3::X * 0.85 + out(*p) * (*p - DVec3::X * 0.85)).collect()
    };
    // As thin as usual it kinks like a straw; ten times as thick it does not.
    let mut poses = vec![arm(0.0, 0.0), arm(0.0, 100.0), arm(70.0, 0.0)];
    for (thickness, stretching, least) in [("", 100.0, 0.2), (", ten times as thick", 1.0, 0.6)] {
        let material = Material { stretching, ..Material::WITH_EXAMPLES };
        let mut shells = arm_of.shells(&Options { material, ..Options::for_examples(2) });
        let mut stats = FrameStats::default();
        for t in 0..=20 {
            stats = shells.step(&arm_of.targets(&turned(f64::from(t) / 20.0))).unwrap();
        }
        let pose = apply(&arm_of.map, shells.pose());
        let outside = places(&turned(1.0));
        let residual = outside.iter().zip(&arm_of.handles).map(|(p, h)| h.row.apply(shells.pose()).distance(*p));
        let residual = 100.0 * residual.fold(0.0, f64::max) / diagonal;
        let sections = (8..RINGS - 8).map(|ring| roundness(&pose[ring * SEGMENTS..(ring + 1) * SEGMENTS]));
        let flattest = sections.fold(1.0, f64::min);
        let words = format!(
            "handles within {residual:.3} % of D, volume {:.1} %, flattest section {flattest:.2}, {} edges inside out",
            100.0 * stats.volume_ratio,
            stats.inverted
        );
        say("Fig. 8", &format!("the arm across the plane of its examples{thickness}"), "no shear", words);
        assert!(stats.inverted == 0 && residual < 0.5 && flattest > least, "{stats:?} {residual} {flattest}");
        poses.push(pose);
    }
    keep("figure 8", &poses.iter().map(Vec::as_slice).collect::<Vec<_>>(), &faces);
}

/// What holds creases back goes by seconds: twice as many frames at twice the rate pass through nearly the same poses.
#[test]
fn a_faster_camera_sees_the_same_creases() {
    let rest = arm(0.0, 0.0);
    let (_, faces) = cylinder(3.0, 1.0, RINGS, SEGMENTS);
    let body = Body::build(&rest, &faces, &[], 600, &|| Ok(())).unwrap();
    let rows = SurfaceRows::new(&body);
    let handle = |(i, p): (usize, &DVec3)| Handle { name: format!("h{i}"), row: rows.row(*p), beta: 1.0 };
    let handles: Vec<Handle> = places(&rest).iter().enumerate().map(handle).collect();
    let film = |frames: u32, rate: f64| -> Vec<Vec<DVec3>> {
        let mut shells = Shells::new(&body, &handles, &[], &Options { rate, ..Options::for_examples(0) }).unwrap();
        let pose = |f: u32| {
            let positions = places(&arm(0.0, 70.0 * f64::from(f) / f64::from(frames)));
            shells.step(&Targets { positions, presence: vec![1.0; handles.len()] }).unwrap();
            shells.pose().to_vec()
        };
        (0..=frames).map(pose).collect()
    };
    let slow = film(20, 100.0);
    let apart =
        |other: &[Vec<DVec3>]| slow.iter().zip(other.iter().step_by(2)).map(|(a, b)| spread_of(a, b)[0]).sum::<f64>() / 21.0;
    let (faster, slower) = (apart(&film(40, 200.0)), apart(&film(40, 100.0)));
    eprintln!("twice the frames at twice the rate: {faster:.6} apart; at the same rate, so half as fast: {slower:.6}");
    assert!(faster < 0.5 * slower, "{faster} {slower}");
}

#[test]
fn tables_1_and_2_time_and_distance_from_the_whole_mesh() {
    let (_, faces) = cylinder(3.0, 1.0, RINGS, SEGMENTS);
    let (rest, examples) = (arm(0.0, 0.0), [arm(0.0, 100.0), arm(70.0, 0.0)]);
    let diagonal = rest.iter().fold(DVec3::NEG_INFINITY, |m, p| m.max(*p)) - rest.iter().fold(DVec3::INFINITY, |m, p| m.min(*p));
    let build = |target| Body::build(&rest, &faces, &examples, target, &|| Ok(())).unwrap().numbered_as_scan();
    let (coarse, fine) = (build(1000), build(100_000));
    let mut polygons = retarget::scan::Faces::default();
    faces.iter().for_each(|f| polygons.push(*f));
    let map = SurfaceMap::build_for_shell(&coarse, &rest, &polygons, &examples);
    let solve = |body: &Body| -> (Vec<Vec<DVec3>>, f64) {
        let rows = SurfaceRows::new(body);
        let handles: Vec<Handle> = places(&rest)
            .into_iter()
            .enumerate()
            .map(|(i, p)| Handle { name: format!("h{i}"), row: rows.row(p), beta: 1.0 })
            .collect();
        let options = Options { steps: 60, decrease: 1e-9, still: 1e-8, ..Options::for_examples(2) };
        let mut shells = Shells::new(body, &handles, &[], &options).unwrap();
        let (mut poses, mut steps) = (Vec::new(), 0);
        let begin = Instant::now();
        for t in 0..=20 {
            let t = f64::from(t) / 10.0;
            let x = arm(70.0 * t.min(1.0), 100.0 * (t - 1.0).max(0.0));
            steps += shells.step(&Targets { positions: places(&x), presence: vec![1.0; handles.len()] }).unwrap().passes;
            if t == 0.5 || t == 1.0 || t == 1.5 || t == 2.0 {
                poses.push(shells.pose().to_vec());
            }
        }
        (poses, begin.elapsed().as_secs_f64() * 1e3 / f64::from(steps.max(1)))
    };
    let ((small, ms), (whole, fine_ms)) = (solve(&coarse), solve(&fine));
    say(
        "Table 1",
        "a step with 1,000 vertices",
        "30 ms (2011)",
        format!("{ms:.1} ms, {:.0} times as fast as all 4,842", fine_ms / ms),
    );
    say("Table 1", "a step with 4,842 vertices", "250 ms (5,000)", format!("{fine_ms:.0} ms"));
    let mut worst = [0.0_f64; 3];
    for (small, whole) in small.iter().zip(&whole) {
        let begin = Instant::now();
        let mapped = apply(&map, small);
        let map_ms = begin.elapsed().as_secs_f64() * 1e3;
        let these = spread_of(&mapped, &in_scan(&fine, whole)).map(|d| d / diagonal.length());
        worst.iter_mut().zip(these).for_each(|(w, t)| *w = w.max(t));
        say("Table 1", "4,842 vertices from them", "23 ms (5,000)", format!("{map_ms:.2} ms"));
    }
    let words = format!("rms {:.3} %, 99 % {:.3} %, {:.3} % of D", 100.0 * worst[0], 100.0 * worst[1], 100.0 * worst[2]);
    say("Table 2", "distance from the optimum on the whole mesh", "0.23 to 0.77 %", words);
    assert!(worst[2] < 0.01 && worst[0] < 0.002, "{worst:?}");
}

fn in_scan(body: &Body, pose: &[DVec3]) -> Vec<DVec3> {
    body.places.iter().map(|p| pose[*p as usize]).collect()
}

#[test]
fn an_example_comes_back_from_its_coarse_mesh() {
    for (name, rest) in [
        ("human_makehuman_male", "00_rest"),
        ("lion_sumner", "reference"),
        ("cat_sumner", "reference"),
        ("horse_sumner", "reference"),
    ] {
        let Some(set) = set(name, rest) else { return };
        let body = set.body(1000, &set.poses);
        let map = SurfaceMap::build_for_shell(&body, &set.points, &set.scan.mesh.faces, &set.poses);
        let mut solver = Interpolator::new(&body, &Material::WITH_EXAMPLES).unwrap();
        let mut worst = [0.0_f64; 3];
        for (i, pose) in set.poses.iter().enumerate() {
            let weights: Vec<f64> = (0..set.poses.len()).map(|k| f64::from(u8::from(k == i))).collect();
            solver.solve(&weights).unwrap();
            let these = spread_of(&apply(&map, solver.pose()), pose);
            worst.iter_mut().zip(these).for_each(|(w, t)| *w = w.max(t));
        }
        let words =
            format!("rms {:.3} %, 99 % {:.3} %, largest {:.3} % of D", 100.0 * worst[0], 100.0 * worst[1], 100.0 * worst[2]);
        say("Table 2", &format!("{name}: the worst of {} examples", set.poses.len()), "0.23 to 0.77 %", words);
        assert!(worst[0] < 0.001 && worst[1] < 0.003 && worst[2] < 0.01, "{worst:?}");
    }
}
