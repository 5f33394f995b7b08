//! Laws of the whole program, from files to files.

use super::cases::{Case, Stuff, TAKES, Take, cases, largest};
use super::common::c3d_writer::C3dFile;
use super::common::{fixture, read_pc2, retarget_ok};
use super::tally::Tally;
use glam::{DQuat, DVec3};
use retarget::capture::{self, MarkerTake, Motion};
use std::fmt::Write as _;
use std::path::Path;

/// Meshes that are always there: the program is run on these, so that it takes seconds.
const OWN: usize = 9;
/// Frames of a take.
const FRAMES: usize = 12;

/// At quality `converged` a frame ends within about twenty tolerances of 1e-7 of the minimum; captures hold f32.
const SOLVED: f64 = 1e-5;
/// A surface that is its own mirror image has one proxy, which is not: the same markers, mirrored, are followed this nearly, in diagonals.
const OTHER_PROXY: f64 = 2e-3;

/// Largest extra move in a frame when markers vanish or return, in heights.
const JUMP: f64 = 0.02;

type Frames = Vec<Vec<DVec3>>;

fn obj(points: &[DVec3], triangles: &[[u32; 3]]) -> String {
    let mut text = String::new();
    for p in points {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for t in triangles {
        let _ = writeln!(text, "f {} {} {}", t[0] + 1, t[1] + 1, t[2] + 1);
    }
    text
}

/// A capture without unit and axes: in the space of the scan. What is not finite is missing; no gap of the laws is short enough to be filled.
fn capture(frames: &[Vec<DVec3>]) -> Vec<u8> {
    let labels = (0..frames[0].len()).map(|i| format!("M{i:02}")).collect();
    let points = frames.iter().flatten().map(|p| p.is_finite().then(|| p.to_array().map(|c| c as f32))).collect();
    C3dFile { labels, points, unit: String::new(), up: String::new(), right: String::new(), rate: 3.0, ..C3dFile::default() }
        .bytes()
}

/// The markers of a take on a mesh; the first frame is at rest.
fn markers(case: &Case, take: &Take, frames: usize) -> Frames {
    let time = |k: usize| 0.5 * k as f64 / FRAMES as f64;
    (0..frames).map(|k| case.rest.iter().map(|&p| (take.motion)(time(k), p)).collect()).collect()
}

/// A way to solve frames, by what a law is said to be of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Volumetric,
    ShellWithExamples,
    ShellAlone,
}

const KINDS: [Kind; 3] = [Kind::Volumetric, Kind::ShellWithExamples, Kind::ShellAlone];

impl Kind {
    fn stuff(self) -> Stuff {
        if self == Self::Volumetric { Stuff::Tetrahedra } else { Stuff::Shell }
    }

    fn what(self) -> &'static str {
        match self {
            Self::Volumetric => "program",
            Self::ShellWithExamples => "program with examples",
            Self::ShellAlone => "program, shells alone",
        }
    }

    /// Poses of a scan: at rest, and its examples.
    fn poses(self, case: &Case) -> Frames {
        let examples = if self == Self::ShellWithExamples { case.shape.examples() } else { Vec::new() };
        std::iter::once(case.shape.points.clone()).chain(examples).collect()
    }

    fn method(self) -> &'static str {
        if self == Self::Volumetric { "volumetric" } else { "shells" }
    }
}

/// Writes scan, examples and capture; the options that name method and examples to the program.
fn write_inputs(folder: &Path, kind: Kind, poses: &[Vec<DVec3>], triangles: &[[u32; 3]], markers: &[Vec<DVec3>]) -> Vec<String> {
    std::fs::write(folder.join("scan.obj"), obj(&poses[0], triangles)).unwrap();
    std::fs::write(folder.join("take.c3d"), capture(markers)).unwrap();
    let examples = poses[1..].iter().enumerate().map(|(i, pose)| {
        let name = format!("example{i}.obj");
        std::fs::write(folder.join(&name), obj(pose, triangles)).unwrap();
        folder.join(name).display().to_string()
    });
    let mut named: Vec<String> = examples.collect();
    if !named.is_empty() {
        named.insert(0, "--examples".into());
    }
    ["--method".into(), kind.method().into()].into_iter().chain(named).collect()
}

/// Writes the inputs, runs the program as it is in the scan's space, and reads the cache.
fn run(kind: Kind, poses: &[Vec<DVec3>], triangles: &[[u32; 3]], markers: &[Vec<DVec3>], more: &[&str]) -> Frames {
    let work = tempfile::tempdir().unwrap();
    let named = write_inputs(work.path(), kind, poses, triangles, markers);
    let more: Vec<&str> = more.iter().copied().chain(named.iter().map(String::as_str)).collect();
    let fixed = ["scan.obj", "take.c3d", "--align", "none", "-o", "out.pc2"];
    let unless_given = [["--proxy-vertices", "500"], ["--quality", "converged"]].into_iter().filter(|d| !more.contains(&d[0]));
    retarget_ok(work.path(), fixed.into_iter().chain(unless_given.flatten()).chain(more.iter().copied()));
    wide(&read_pc2(&work.path().join("out.pc2")))
}

fn wide(frames: &[Vec<[f32; 3]>]) -> Frames {
    frames.iter().map(|f| f.iter().map(|p| DVec3::from(p.map(f64::from))).collect()).collect()
}

/// Largest distance between two runs.
fn apart(a: &Frames, b: &Frames) -> f64 {
    assert_eq!(a.len(), b.len());
    largest(a.iter().zip(b).map(|(a, b)| super::distance(a, b)))
}

/// How many of the cases are of meshes that are always there.
fn own(stuff: Stuff) -> usize {
    let all = super::shapes::own();
    assert_eq!(all.len(), OWN);
    all.iter().filter(|s| stuff == Stuff::Tetrahedra || s.is_surface).count()
}

/// Every own mesh with one of the takes, in each way.
fn pairs() -> impl Iterator<Item = (Kind, &'static Case, &'static Take)> {
    KINDS.iter().flat_map(|&kind| {
        let cases = &cases(kind.stuff())[..own(kind.stuff())];
        cases.iter().enumerate().map(move |(i, case)| (kind, case, &TAKES[i % TAKES.len()]))
    })
}

#[test]
fn a_rigid_motion_of_all_markers_moves_the_scan_by_it() {
    let mut tally = Tally::new("program: rigid in, rigid out (--align none)", SOLVED);
    let mut begun = Tally::new("program: the first frame of a scan that lies turned in it (--ref)", SOLVED);
    let motion = |k: usize| {
        let q = DQuat::from_axis_angle(DVec3::new(0.3, 1.0, -0.4).normalize(), 0.25 * k as f64);
        move |p: DVec3| q * p + DVec3::new(0.01, -0.004, 0.02) * k as f64
    };
    let last = FRAMES.to_string();
    for (kind, case, _) in pairs() {
        let frames: Frames = (0..FRAMES).map(|k| case.rest.iter().map(|&p| motion(k)(p)).collect()).collect();
        let error = |out: &[DVec3], k: usize| largest(out.iter().zip(&case.shape.points).map(|(p, &q)| p.distance(motion(k)(q))));
        let out = run(kind, &kind.poses(case), &case.shape.triangles, &frames, &[]);
        assert_eq!(out.len(), FRAMES);
        tally.note(case, None, kind.what(), largest((0..FRAMES).map(|k| error(&out[k], k))));
        // Backwards, no frame but the last is as the scan. The solver begins with the turn that the markers tell: no step towards it is left.
        let backwards: Frames = frames.into_iter().rev().collect();
        let out = run(kind, &kind.poses(case), &case.shape.triangles, &backwards, &["--ref", &last, "--quality", "draft"]);
        begun.note(case, None, kind.what(), error(&out[0], FRAMES - 1));
    }
    tally.close();
    begun.close();
}

/// A scan with its take, under maps of space and in other orders.
struct Variant<'a> {
    case: &'a Case,
    kind: Kind,
    markers: Frames,
}

impl Variant<'_> {
    /// Runs the program on the input under a map, with triangles as `turn` leaves them.
    fn run(&self, map: impl Fn(DVec3) -> DVec3, turn: impl Fn([u32; 3]) -> [u32; 3], more: &[&str]) -> Frames {
        let mapped = |all: &Frames| -> Frames { all.iter().map(|f| f.iter().map(|&p| map(p)).collect()).collect() };
        let triangles: Vec<[u32; 3]> = self.case.shape.triangles.iter().map(|&t| turn(t)).collect();
        let (poses, markers) = (mapped(&self.kind.poses(self.case)), mapped(&self.markers));
        run(self.kind, &poses, &triangles, &markers, more)
    }
}

#[test]
fn scaled_renumbered_turned_and_longer_inputs_give_the_same_animation() {
    let mut doubled = Tally::new("program: scan and take x 1024, output x 1024", 1e-6);
    let mut scaled = Tally::new("program: scan and take x 1000, output x 1000", 1e-6);
    let mut renumbered = Tally::new("program: renumbered scan, renumbered output", 0.0);
    let mut turned = Tally::new("program: scan and take along other axes, output along them", 1e-6);
    let mut longer = Tally::new("program: extra later frames leave the earlier ones alone", 0.0);
    for (kind, case, take) in pairs() {
        let (whole, triangles) = (kind.poses(case), &case.shape.triangles);
        let here = Variant { case, kind, markers: markers(case, take, FRAMES) };
        let base = here.run(|p| p, |t| t, &[]);
        assert!(apart(&vec![base[0].clone()], &vec![base[FRAMES - 1].clone()]) > 0.02, "{} must move", case.shape.name);

        for (factor, tally) in [(1024.0, &mut doubled), (1000.0, &mut scaled)] {
            let mut out = here.run(|p| p * factor, |t| t, &[]);
            out.iter_mut().flatten().for_each(|p| *p /= factor);
            tally.note(case, Some(take), kind.what(), apart(&out, &base));
        }

        // Backwards, and by large steps: neither is near the order of the file.
        let count = case.shape.points.len() as u32;
        let step = (count / 3..).find(|s| (2..=*s).all(|d| !s.is_multiple_of(d) || !count.is_multiple_of(d))).unwrap();
        for order in [
            (0..count).rev().collect::<Vec<u32>>(),
            (0..count).map(|v| (u64::from(v) * u64::from(step) % u64::from(count)) as u32).collect(),
        ] {
            let mut shuffled = vec![vec![DVec3::NAN; count as usize]; whole.len()];
            for (to, from) in shuffled.iter_mut().zip(&whole) {
                from.iter().zip(&order).for_each(|(p, &v)| to[v as usize] = *p);
            }
            let sides: Vec<[u32; 3]> = triangles.iter().rev().map(|&[a, b, c]| [b, c, a].map(|v| order[v as usize])).collect();
            let out = run(kind, &shuffled, &sides, &here.markers, &[]);
            let back: Frames = out.iter().map(|f| order.iter().map(|&v| f[v as usize]).collect()).collect();
            renumbered.note(case, Some(take), kind.what(), apart(&back, &base));
        }

        let mut out = here.run(|p| DVec3::new(p.y, p.z, p.x), |t| t, &[]);
        out.iter_mut().flatten().for_each(|p| *p = DVec3::new(p.z, p.x, p.y));
        turned.note(case, Some(take), kind.what(), apart(&out, &base));

        // The later frames run back to the start.
        let there_and_back: Frames = here.markers.iter().chain(here.markers.iter().rev()).cloned().collect();
        let out = run(kind, &whole, triangles, &there_and_back, &[]);
        longer.note(case, Some(take), kind.what(), apart(&out[..FRAMES].to_vec(), &base));
    }
    for tally in [doubled, scaled, renumbered, turned, longer] {
        tally.close();
    }
}

#[test]
fn a_mirrored_input_gives_the_mirrored_animation() {
    let mut mirrored = Tally::new("program: mirrored scan and take, mirrored output", OTHER_PROXY);
    for (kind, case, take) in pairs() {
        let here = Variant { case, kind, markers: markers(case, take, FRAMES) };
        let size = ["--proxy-vertices", "3000"];
        let base = here.run(|p| p, |t| t, &size);
        let mirror = |p: DVec3| DVec3::new(-p.x, p.y, p.z);
        let mut out = here.run(mirror, |[a, b, c]| [a, c, b], &size);
        out.iter_mut().flatten().for_each(|p| *p = mirror(*p));
        mirrored.note(case, Some(take), kind.what(), apart(&out, &base));
    }
    mirrored.close();
}

#[test]
fn markers_that_vanish_and_return_leave_no_jump_on_any_body() {
    let mut tally = Tally::new("program: markers that vanish and return, largest extra move in a frame", JUMP);
    // A limb of a shell that is let go may fold another way, and snap back when it is taken hold of: up to 9 % of the height here.
    for (kind, case, take) in pairs().filter(|pair| pair.0 == Kind::Volumetric) {
        let whole = markers(case, take, 2 * FRAMES + 16);
        let gone = FRAMES..FRAMES + 20;
        let mut holes = whole.clone();
        holes[gone.clone()].iter_mut().for_each(|f| f[6] = DVec3::NAN);
        let (bodies, triangles) = (kind.poses(case), &case.shape.triangles);
        let [with, without] = [&holes, &whole].map(|frames| run(kind, &bodies, triangles, frames, &[]));
        let worst = largest((gone.start..with.len()).map(|k| extra_move(&with, &without, k)));
        assert!(apart(&with, &without) > 0.0, "{}: a marker must be missing", case.shape.name);
        tally.note(case, Some(take), kind.what(), worst / case.shape.height());
    }
    tally.close();
}

#[test]
fn any_number_of_threads_writes_the_same_bytes_twice() {
    let mut tally = Tally::new("program: 1, 2, 3 and 4 threads, the same bytes, twice", 0.0);
    for (kind, case, take) in pairs() {
        let work = tempfile::tempdir().unwrap();
        let examples = write_inputs(work.path(), kind, &kind.poses(case), &case.shape.triangles, &markers(case, take, 5));
        let mut first: Option<Vec<Vec<u8>>> = None;
        for (n, threads) in ["1", "2", "3", "4", "1", "2", "3", "4"].into_iter().enumerate() {
            let folder = work.path().join(n.to_string());
            std::fs::create_dir(&folder).unwrap();
            let fixed = ["../scan.obj", "../take.c3d", "--align", "none", "--proxy-vertices", "500", "--threads", threads];
            let outputs = ["-o", "a.glb", "-o", "a.pc2", "-o", "f_#.ply", "-o", "g_#.obj"];
            let named = examples.iter().map(String::as_str);
            retarget_ok(&folder, fixed.into_iter().chain(outputs).chain(named));
            let bytes =
                ["a.glb", "a.pc2", "f_1.ply", "f_5.ply", "g_4.obj"].map(|f| std::fs::read(folder.join(f)).unwrap()).to_vec();
            let same = first.get_or_insert_with(|| bytes.clone()) == &bytes;
            tally.note(case, Some(take), &format!("{}, {threads}", kind.what()), if same { 0.0 } else { 1.0 });
        }
    }
    tally.close();
}

/// The fixture take as its file has it: millimetres, Z up.
fn walk() -> MarkerTake {
    let Motion::Markers(take) = capture::read(&fixture("walk.c3d"), &capture::ReadOptions::default()).unwrap().motion else {
        panic!("the fixture has markers")
    };
    take
}

/// Chosen frames of the fixture take, counted from 0, in another unit and with another axis up.
fn excerpt(frames: &[usize], rate: f32, unit: &str, up: &str, hidden: impl Fn(&str, usize) -> bool) -> Vec<u8> {
    let take = walk();
    let factor = match unit {
        "m" => 0.001,
        "cm" => 0.1,
        _ => 1.0,
    };
    let point = |f: usize, m: usize| {
        let p = take.point(f, m).filter(|_| !hidden(&take.labels[m], f))? * factor;
        Some(if up == "+Y" { DVec3::new(p.x, p.z, -p.y) } else { p }.to_array().map(|c| c as f32))
    };
    let points = frames.iter().flat_map(|&f| (0..take.markers()).map(move |m| (f, m))).map(|(f, m)| point(f, m)).collect();
    C3dFile { labels: take.labels.clone(), points, rate, unit: unit.into(), up: up.into(), ..C3dFile::default() }.bytes()
}

/// Runs the fixture scan with a capture; gives the cache in diagonals of the scan.
fn person(folder: &Path, bytes: &[u8]) -> Frames {
    person_of(folder, &fixture("scan.obj"), bytes)
}

fn person_of(folder: &Path, scan: &Path, bytes: &[u8]) -> Frames {
    std::fs::write(folder.join("take.c3d"), bytes).unwrap();
    let fixed =
        ["take.c3d", "--proxy-vertices", "800", "--quality", "converged", "--force", "-o", "out.pc2"].map(std::ffi::OsStr::new);
    retarget_ok(folder, [scan.as_os_str()].iter().chain(&fixed));
    let mut out = wide(&read_pc2(&folder.join("out.pc2")));
    out.iter_mut().flatten().for_each(|p| *p /= DIAGONAL);
    out
}

/// What a vertex moves at most in frame `k` beyond what it moves in another run.
fn extra_move(run: &Frames, other: &Frames, k: usize) -> f64 {
    let each = run[k].iter().zip(&run[k - 1]).zip(other[k].iter().zip(&other[k - 1]));
    largest(each.map(|((a, b), (c, d))| ((*a - *b) - (*c - *d)).length()))
}

/// Diagonal and height of the fixture scan, metres.
const DIAGONAL: f64 = 2.26;
const HEIGHT: f64 = 1.76;

#[test]
fn units_and_axes_of_the_capture_do_not_matter() {
    let work = tempfile::tempdir().unwrap();
    let walk: Vec<usize> = (0..120).step_by(4).collect();
    let squat: Vec<usize> = (300..372).step_by(4).rev().collect();
    let stand: Vec<usize> = (0..12).collect();
    type Excerpt<'a> = (&'a [usize], f32, &'a [(&'static str, &'static str)]);
    let spaces: [Excerpt<'_>; 3] =
        [(&walk, 30.0, &[("m", "+Z"), ("cm", "+Y")]), (&squat, 30.0, &[("mm", "+Y")]), (&stand, 120.0, &[("m", "+Y")])];
    let (mut worst, mut placed) = (0.0f64, 0.0f64);
    for (frames, rate, others) in spaces {
        let seen = |_: &str, _: usize| false;
        let base = person(work.path(), &excerpt(frames, rate, "mm", "+Z", seen));
        assert_eq!(base.len(), frames.len());
        for (unit, up) in others {
            let out = person(work.path(), &excerpt(frames, rate, unit, up, seen));
            let (error, first) = (apart(&out, &base), super::distance(&out[0], &base[0]));
            eprintln!("{} frames in {unit}, {up} up: {error:.1e} of the diagonal apart, the first {first:.1e}", frames.len());
            (worst, placed) = (worst.max(error), placed.max(first));
        }
    }
    assert!(placed < SOLVED, "placed {placed:e} apart");
    assert!(worst < SOLVED, "{worst:e}");
}

#[test]
fn markers_that_vanish_and_return_leave_no_jump_on_a_person() {
    let work = tempfile::tempdir().unwrap();
    let arms: Vec<usize> = (0..160).collect();
    let sets: [&[&str]; 3] = [&["LWRA"], &["LFRM", "LWRA", "LWRB", "LFIN"], &["RANK", "RHEE", "RMT5", "RTOE", "RSHN"]];
    let whole = person(work.path(), &excerpt(&arms, 120.0, "mm", "+Z", |_, _| false));
    for set in sets {
        let gone = 40..120;
        let out = person(work.path(), &excerpt(&arms, 120.0, "mm", "+Z", |name, f| set.contains(&name) && gone.contains(&f)));
        assert_eq!(out.len(), whole.len());
        let jump = |k: usize| extra_move(&out, &whole, k) * DIAGONAL / HEIGHT;
        let missed = apart(&vec![out[gone.end - 1].clone()], &vec![whole[gone.end - 1].clone()]) * DIAGONAL / HEIGHT;
        let worst = |frames: std::ops::Range<usize>| frames.map(|k| (k, jump(k))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        for (what, (frame, worst)) in [("vanish", worst(gone.start..gone.end)), ("return", worst(gone.end..out.len()))] {
            eprintln!(
                "{set:?} gone for 80 frames: {:.2} % of height off at the end, {what}: jump {:.2} % in frame {frame}",
                missed * 100.0,
                worst * 100.0
            );
            assert!(worst < JUMP, "{set:?} {what}: jump of {:.2} % of height in frame {frame}", worst * 100.0);
        }
    }
}

#[test]
fn a_person_is_found_and_moves_the_same_however_the_scan_is_numbered() {
    let work = tempfile::tempdir().unwrap();
    let take = excerpt(&(0..120).step_by(6).collect::<Vec<_>>(), 20.0, "mm", "+Z", |_, _| false);
    let base = person(work.path(), &take);
    let mesh = retarget::scan::read(&fixture("scan.obj")).unwrap().mesh;
    let (count, step) = (mesh.positions.len(), 7919);
    assert!(count % step != 0);
    let order: Vec<usize> = (0..count).map(|v| v * step % count).collect();
    let mut positions = vec![DVec3::NAN; count];
    mesh.positions.iter().zip(&order).for_each(|(p, &v)| positions[v] = *p);
    let triangles: Vec<[u32; 3]> = mesh.vertex_triangles().iter().rev().map(|t| t.map(|v| order[v as usize] as u32)).collect();
    let scan = work.path().join("scan.obj");
    std::fs::write(&scan, obj(&positions, &triangles)).unwrap();
    let out = person_of(work.path(), &scan, &take);
    let back: Frames = out.iter().map(|f| order.iter().map(|&v| f[v]).collect()).collect();
    let error = apart(&back, &base);
    eprintln!("a person with renumbered vertices: {error:.1e} of the diagonal apart");
    assert!(error < 1e-6, "{error:e}");
}
