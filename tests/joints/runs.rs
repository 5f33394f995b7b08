//! Laws of whole runs with things made of parts, as `tests/laws` has them for bodies, and golden frames; `scripts/bless.sh` makes these anew.

use crate::arm::{self, View};
use crate::common::{read_pc2, read_ply_points, retarget_ok};
use glam::{DQuat, DVec3};
use retarget::glam;
use std::path::{Path, PathBuf};

type Frames = Vec<Vec<DVec3>>;

const FRAMES: usize = 24;
/// Sizes are those of the unit box: the arm is 2 long. Caches hold f32, tables what was printed.
const ROUNDING: f64 = 1e-6;
/// A frame ends when no step moves anything by more than 2e-5 diagonals: two ways to it are about this far apart.
const SOLVED: f64 = 4e-4;
/// Joints that few handles tell are slowed down: at 30 frames a second and 7° a frame the tip of the arm, which is 2 long, lags by so much …
const DRAGGED: f64 = 4.5e-2;
/// … and the whole, which feels a hundredth of it, by so much at 5° a frame.
const LAG: f64 = 2.5e-3;
/// A vertex moves farther in a frame where handles vanish and return than where they stay by no more than this: they are led by 0.008 diagonals of the
/// arm, and two of them that turn the hand are a third of its length apart.
const JUMP: f64 = 0.05;

/// Runs a table on the arm; the cache and its bytes.
fn run(view: &View, soft: bool, table: &[Vec<DVec3>], more: &[&str]) -> (Frames, Vec<u8>) {
    let work = tempfile::tempdir().expect("a folder");
    arm::write(work.path(), view, soft);
    arm::write_table(&work.path().join("take.csv"), view, table);
    let fixed = ["arm.obj", "take.csv", "--rig", "rig.toml", "-o", "out.pc2"];
    retarget_ok(work.path(), fixed.iter().chain(more));
    let bytes = std::fs::read(work.path().join("out.pc2")).expect("a cache");
    let point = |p: [f32; 3]| DVec3::from(p.map(f64::from));
    (read_pc2(&work.path().join("out.pc2")).into_iter().map(|f| f.into_iter().map(point).collect()).collect(), bytes)
}

fn apart(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(p, q)| p.distance(*q)).fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m })
}

/// The worst figure of a law, said, and judged.
struct Law(&'static str, f64, f64);

impl Law {
    fn new(law: &'static str, limit: f64) -> Self {
        Self(law, limit, 0.0)
    }

    fn note(&mut self, what: &str, figure: f64) {
        assert!(figure <= self.1, "{}: {figure:.1e} of {:.0e} ({what})", self.0, self.1);
        self.2 = self.2.max(figure);
    }
}

impl Drop for Law {
    fn drop(&mut self) {
        eprintln!("{:<70} worst {:.1e} of {:.0e}", self.0, self.2, self.1);
    }
}

#[test]
fn rest_and_rigid_motions_come_through() {
    let mut still = Law::new("parts: rest in, rest out", ROUNDING);
    let mut rigid = Law::new("parts: rigid in, rigid out", LAG);
    let rest: Vec<DVec3> = arm::rest().into_iter().map(|r| r.1).collect();
    let spots: Vec<DVec3> = arm::spots().into_iter().map(|s| s.1).collect();
    let motion = |f: usize, p: DVec3| {
        let t = f as f64 / FRAMES as f64;
        DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 2.0 * t) * p + DVec3::new(0.7, -0.3, 2.0) * t
    };
    let moving: Frames = (0..FRAMES).map(|f| spots.iter().map(|&p| motion(f, p)).collect()).collect();
    for soft in [false, true] {
        for frame in &run(&View::PLAIN, soft, &vec![spots.clone(); 4], &[]).0 {
            still.note(&format!("soft {soft}"), apart(frame, &rest));
        }
        for (f, frame) in run(&View::PLAIN, soft, &moving, &[]).0.iter().enumerate() {
            let there: Vec<DVec3> = rest.iter().map(|&p| motion(f, p)).collect();
            rigid.note(&format!("soft {soft}, frame {f}"), apart(frame, &there));
        }
    }
}

#[test]
fn a_take_that_the_joints_allow_is_met_vertex_by_vertex() {
    let mut law = Law::new("parts: a motion of the joints comes back", DRAGGED);
    let [(_, within), _] = arm::takes(FRAMES);
    for (f, frame) in run(&View::PLAIN, false, &within, &[]).0.iter().enumerate() {
        let t = 0.12 * f as f64;
        let joints = [0.5 * t.sin(), 0.7 - 0.7 * t.cos(), 0.06 * (2.0 * t).sin()];
        let there: Vec<DVec3> = arm::rest().into_iter().map(|(part, p)| arm::bent(part, p, joints)).collect();
        // The elbow has one handle: what turns the upper arm about itself is told by the hinge.
        law.note(&format!("frame {f}"), apart(frame, &there));
    }
}

#[test]
fn scaled_turned_longer_repeated_and_threaded_runs_are_the_same() {
    let mut scaled = Law::new("parts: a thousandfold in, a thousandfold out", SOLVED);
    let mut turned = Law::new("parts: other axes in, other axes out", SOLVED);
    let mut longer = Law::new("parts: extra later frames leave the earlier ones alone", 0.0);
    let mut again = Law::new("parts: a repeated run is equal byte by byte", 0.0);
    let mut threads = Law::new("parts: 1, 2 and 3 threads are equal byte by byte", 0.0);
    let large = View { scale: 1e3, ..View::PLAIN };
    let axes = View { turn: DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2), shift: DVec3::new(3.0, -1.0, 0.5), scale: 1.0 };
    for soft in [false, true] {
        for (name, table) in arm::takes(FRAMES) {
            let what = format!("{name}, soft {soft}");
            let (base, bytes) = run(&View::PLAIN, soft, &table, &["--threads", "2"]);
            for (view, law) in [(large, &mut scaled), (axes, &mut turned)] {
                for (there, here) in run(&view, soft, &table, &[]).0.iter().zip(&base) {
                    let seen: Vec<DVec3> = here.iter().map(|&p| view.see(p)).collect();
                    law.note(&what, apart(there, &seen) / view.scale);
                }
            }
            let twice = &arm::takes(2 * FRAMES)[usize::from(name == "beyond")].1;
            let (long, _) = run(&View::PLAIN, soft, twice, &[]);
            longer.note(
                &what,
                long.iter().zip(&base).map(|(a, b)| apart(a, b)).fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m }),
            );
            let same = |more: &[&str]| f64::from(u8::from(run(&View::PLAIN, soft, &table, more).1 != bytes));
            again.note(&what, same(&["--threads", "2"]));
            threads.note(&what, same(&["--threads", "1"]).max(same(&["--threads", "3"])));
        }
    }
}

#[test]
fn handles_that_vanish_and_return_make_no_jump() {
    let mut law = Law::new("parts: extra move in a frame when handles vanish and return", JUMP);
    for soft in [false, true] {
        for (name, table) in arm::takes(2 * FRAMES) {
            let mut gaps = table.clone();
            // The elbow, and two of the hand, so that it may turn.
            for places in &mut gaps[15..27] {
                [3, 5, 6].iter().for_each(|&k| places[k] = DVec3::NAN);
            }
            let (whole, _) = run(&View::PLAIN, soft, &table, &[]);
            let (with, _) = run(&View::PLAIN, soft, &gaps, &[]);
            // Later the arm, whose free joints are turned otherwise by then, goes its own way where more is asked than it can do.
            for f in 15..36 {
                let move_of = |frames: &Frames, v: usize| frames[f][v].distance(frames[f - 1][v]);
                let extra = (0..whole[0].len())
                    .map(|v| move_of(&with, v) - move_of(&whole, v))
                    .fold(0.0, |m: f64, x| if x > m || x.is_nan() { x } else { m });
                law.note(&format!("{name}, soft {soft}, frame {f}"), extra);
            }
            if name == "beyond" {
                // What cannot be met is missed in more than one way.
                continue;
            }
            // The parts that their handles tell are back; how the free ones between them are turned is another matter.
            let told = |frame: &[DVec3]| -> Vec<DVec3> {
                frame.iter().zip(arm::rest()).filter(|(_, (part, _))| [0, 3].contains(part)).map(|(p, _)| *p).collect()
            };
            let last = whole.len() - 1;
            let off = apart(&told(&with[last]), &told(&whole[last]));
            assert!(off < DRAGGED, "{name}, soft {soft}: {off} at the end");
        }
    }
}

/// What may differ between processors, in diagonals of the arm; the rest is the rounding of f32.
const GOLDEN: f64 = 5e-5;
const CHOSEN: [usize; 3] = [6, 14, 23];

fn golden(name: &str, frame: usize) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/joints/golden/{name}_{frame:04}.ply"))
}

#[test]
fn golden_frames_of_the_arm_are_as_blessed() {
    let bless = std::env::var_os("RETARGET_BLESS").is_some();
    for soft in [false, true] {
        for (take, table) in arm::takes(FRAMES) {
            let name = format!("{take}_{}", if soft { "soft" } else { "rigid" });
            let (frames, _) = run(&View::PLAIN, soft, &table, &["--quality", "converged"]);
            for frame in CHOSEN {
                let path = golden(&name, frame);
                let moved = path.is_file().then(|| apart(&frames[frame], &read_ply_points(&path)) / 2.0);
                if bless {
                    eprintln!("{name} {frame}: moved by {:.2e} diagonals", moved.unwrap_or(f64::NAN));
                    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
                    write_points(&path, &frames[frame]);
                } else {
                    let moved = moved.expect("a golden");
                    assert!(moved < GOLDEN, "{name} {frame} moved by {moved:.2e} diagonals; scripts/bless.sh if it should");
                }
            }
        }
    }
}

fn write_points(path: &Path, points: &[DVec3]) {
    let count = points.len();
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    .into_bytes();
    points.iter().flat_map(|p| p.to_array()).for_each(|c| bytes.extend((c as f32).to_le_bytes()));
    std::fs::write(path, bytes).expect("a golden");
}
