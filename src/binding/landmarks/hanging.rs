//! Arms that hang along the trunk and touch it, or have grown together with it.
//!
//! Such an arm is no limb of the solid, but it still shows from the side: in a level section the outermost part of the body is the cap of
//! a circle of the arm's own width, much smaller than that of a hip or a thigh.

use super::axes::Line;
use super::frame::Frame;
use super::limbs::{self, Arm};
use super::medial::Section;
use super::voxels::Filled;
use crate::statistics::middle;
use glam::DVec3;

// Heights and lengths are shares of stature; MakeHuman bodies (thin to heavy) with arms 82 to 90 degrees down were measured.

/// Heights between which sections are made.
const HEIGHTS: [f64; 2] = [0.29, 0.82];
/// Sections to either side with which one is compared.
const AROUND: usize = 2;
/// Half of the width, and of the depth about the trunk's middle, in which the body is looked for.
const HALF_WIDTH: f64 = 0.30;
const HALF_DEPTH: f64 = 0.22;
/// Depth of the caps that are compared with circles.
const CAP: f64 = 0.08;
/// Cells at the edge that are too coarse to tell the radius.
const EDGE: usize = 3;
/// Where the shoulder joint is (0.79 to 0.80), and the heights at which the deltoid shows where it lies in the level.
const SHOULDER: f64 = 0.797;
const DELTOID: [f64; 2] = [0.75, 0.80];
const SHOULDER_ASIDE: [f64; 2] = [0.085, 0.135];
/// Where the upper arm ends in the shoulder.
const UPPER: f64 = 0.77;
/// Where the wrist may be, and where it is narrower than what is above and below.
const WRIST: [f64; 2] = [0.46, 0.575];
/// Where thigh shows below the hands, and where the finger tips may be.
const THIGH: [f64; 2] = [0.31, 0.39];
const TIPS: [f64; 2] = [0.36, 0.48];
/// Height of the wrist over the finger tips (0.10 to 0.11), and how far around it is looked for.
const HAND: f64 = 0.105;
const HAND_WITHIN: f64 = 0.025;
/// Half the width of fingers against that of the arm (0.5 to 0.7); hands that have grown together with the thigh have more (1.2 or more),
/// and show their tips too high.
const THIN: f64 = 0.85;
/// Largest angle between forearm and hand, in degrees; beyond, something else than the hand shows.
const HAND_BEND: f64 = 25.0;
/// Half the thickness of hands.
const HALF_HAND: f64 = 0.014;
/// Half the width of arms between wrist and shoulder (0.017 to 0.047).
const HALF_ARM: [f64; 2] = [0.008, 0.058];
/// Least ratio of the thigh's half width to the wrist's (1.9 to 3.6).
const THIGH_TO_WRIST: f64 = 1.5;
/// Most difference between the sides of the body, from the middle.
const UNEVEN: f64 = 0.05;
/// Largest angle between the arm from shoulder to wrist and the body's axis, in degrees.
const STEEPEST: f64 = 30.0;

/// A body in its own axes.
pub(super) struct Standing<'a> {
    pub(super) filled: &'a Filled,
    pub(super) frame: &'a Frame,
    /// Height of the soles along `up`.
    pub(super) soles: f64,
    pub(super) stature: f64,
    /// A place in the middle of the trunk.
    pub(super) middle: DVec3,
}

/// The outermost part of one side of a level section.
#[derive(Clone, Copy, Debug)]
struct Cap {
    height: f64,
    /// Distance of the edge from the middle.
    edge: f64,
    /// Half its width: the radius of the smallest circle through the edge that its depth allows.
    half: f64,
    /// Its depth at its middle.
    depth: f64,
    centre: DVec3,
}

/// Both arms, left first; `None` where what hangs at the sides is not like arms.
pub(super) fn arms(body: &Standing<'_>) -> Option<[Arm; 2]> {
    let sides = [1.0, -1.0].map(|side| caps(body, side));
    let [left, right] = &sides;
    let edge = |caps: &[Cap]| {
        let (sum, n) = caps.iter().filter(|c| c.height > WRIST[0]).fold((0.0, 0.0), |(s, n), c| (s + c.edge, n + 1.0));
        sum / n
    };
    if (edge(left) - edge(right)).abs() > UNEVEN * body.stature {
        return None;
    }
    let [left, right] = [(left, 1.0), (right, -1.0)].map(|(caps, side)| arm(body, caps, side));
    Some([left?, right?])
}

/// The caps of one side from the top down.
fn caps(body: &Standing<'_>, side: f64) -> Vec<Cap> {
    let step = body.filled.pitch() / body.stature;
    let count = ((HEIGHTS[1] - HEIGHTS[0]) / step) as usize;
    let caps: Vec<Cap> = (0..=count).filter_map(|i| cap(body, side, HEIGHTS[1] - i as f64 * step)).collect();
    // Specks beside the body and holes in it show in single sections.
    let typical = |i: usize| {
        let mut around: Vec<Cap> = caps[i.saturating_sub(AROUND)..(i + AROUND + 1).min(caps.len())].to_vec();
        around.sort_by(|a, b| a.half.total_cmp(&b.half));
        let (own, typical) = (caps[i].height, around[around.len() / 2]);
        let centre = typical.centre + body.frame.up * ((own - typical.height) * body.stature);
        Cap { height: own, centre, ..typical }
    };
    (0..caps.len()).map(typical).collect()
}

fn cap(body: &Standing<'_>, side: f64, height: f64) -> Option<Cap> {
    let Standing { filled, frame, soles, stature, middle } = *body;
    let h = filled.pitch();
    let at = middle + frame.up * (soles + height * stature - middle.dot(frame.up));
    let columns = (HALF_WIDTH * stature / h) as i32;
    let half_depth = (HALF_DEPTH * stature / h) as i32;
    // Number of cells, first and last of each column from the outside in.
    let column = |out: i32| {
        let foot = at + frame.left * (side * f64::from(out) * h);
        let inside = (-half_depth..=half_depth).filter(|&d| filled.holds(foot + frame.forward * (f64::from(d) * h)));
        inside.fold((0, i32::MAX, i32::MIN), |(n, first, last), d| (n + 1, first.min(d), last.max(d)))
    };
    let outermost = (0..=columns).rev().find(|&out| column(out).0 > 0)?;
    let deep = ((CAP * stature / h) as i32).min(outermost);
    let cap: Vec<_> = (0..=deep).map(|i| column(outermost - i)).collect();
    let radius = |i: usize| {
        let (x, y) = (i as f64 + 0.5, 0.5 * f64::from(cap[i].0));
        (x * x + y * y) / (2.0 * x)
    };
    let half = (EDGE..cap.len()).map(radius).min_by(f64::total_cmp)?;
    let within = &cap[..(half as usize).clamp(2, cap.len())];
    let (first, last) = within.iter().fold((i32::MAX, i32::MIN), |(a, b), c| (a.min(c.1), b.max(c.2)));
    let edge = f64::from(outermost) + 0.5;
    let centre = at + frame.left * (side * (edge - half) * h) + frame.forward * (0.5 * f64::from(first + last) * h);
    let depth = f64::from(within.iter().map(|c| c.0).max().unwrap_or(0)) * h;
    Some(Cap { height, edge: edge * h, half: half * h, depth, centre })
}

fn arm(body: &Standing<'_>, caps: &[Cap], side: f64) -> Option<Arm> {
    let Standing { frame, stature, .. } = *body;
    let between = |[low, high]: [f64; 2]| caps.iter().filter(move |c| c.height > low && c.height < high);
    let thigh = between(THIGH).map(|c| c.half).max_by(f64::total_cmp)?;
    let usual = middle(&mut between([WRIST[0], UPPER]).map(|c| c.half).collect::<Vec<_>>())?;
    let tip = tip(body, caps, [usual, thigh], side);
    let [low, high] = tip.map_or(WRIST, |(height, _)| {
        let wrist = (height + HAND).clamp(WRIST[0], WRIST[1]);
        [wrist - HAND_WITHIN, wrist + HAND_WITHIN]
    });
    let (at_wrist, wrist) = narrowest(caps, [low, high])?;
    let fore = middle(&mut between([wrist.height - 0.01, wrist.height + 0.02]).map(|c| c.half).collect::<Vec<_>>())?;
    let (lean, fat) = (HALF_ARM[0] * stature, HALF_ARM[1] * stature);
    if !(lean..fat).contains(&fore) || !(lean..fat).contains(&usual) || thigh < THIGH_TO_WRIST * fore {
        return None;
    }
    let deltoid: Vec<DVec3> = between(DELTOID).map(|c| c.centre).collect();
    let mean = deltoid.iter().sum::<DVec3>() / deltoid.len().max(1) as f64;
    let out = (mean - body.middle).dot(frame.left) * side;
    let aside = out.clamp(SHOULDER_ASIDE[0] * stature, SHOULDER_ASIDE[1] * stature) - out;
    let rise = body.soles + SHOULDER * stature - mean.dot(frame.up);
    let shoulder = mean + frame.up * rise + frame.left * (side * aside);
    let lower: Vec<DVec3> = between([wrist.height, wrist.height + 0.09]).map(|c| c.centre).collect();
    let forearm = Line::through(&lower)?;
    if (wrist.centre - shoulder).angle_between(-frame.up).to_degrees() > STEEPEST {
        return None;
    }
    let sections: Vec<Section> = caps[..at_wrist]
        .iter()
        .rev()
        .filter(|c| c.height < UPPER)
        .map(|c| Section { level: wrist.height - c.height, area: c.half * c.depth, centre: c.centre })
        .collect();
    let elbow = limbs::hinge(&sections, wrist.centre, shoulder, limbs::ELBOW, 0.14, 0.6)?;
    let down = -forearm.direction * forearm.direction.dot(frame.up).signum();
    let straight = |tip: &DVec3| (*tip - wrist.centre).angle_between(down).to_degrees() < HAND_BEND;
    let tip = tip.map(|(_, tip)| tip).filter(straight).unwrap_or(wrist.centre + down * (HAND * stature));
    Some(Arm { tip, wrist: wrist.centre, elbow, shoulder })
}

/// Height and place of the lowest cap that is a hand and not a thigh, where it shows; `arm` and `thigh`: half their widths.
fn tip(body: &Standing<'_>, caps: &[Cap], [arm, thigh]: [f64; 2], side: f64) -> Option<(f64, DVec3)> {
    let from = caps.iter().position(|c| c.height < WRIST[1])?;
    let hand = caps[from..].iter().take_while(|c| c.half < 0.5 * (arm + thigh)).count();
    let (last, fingers) = (caps[(from + hand).checked_sub(1)?], caps[(from + hand).checked_sub(2 + AROUND)?]);
    let inwards = (last.half - HALF_HAND * body.stature).max(0.0);
    let shows = last.height > TIPS[0] && last.height < TIPS[1] && fingers.half < THIN * arm;
    shows.then(|| (last.height, last.centre + body.frame.left * (side * inwards)))
}

/// The cap of least area, over three, between two heights, and its index.
fn narrowest(caps: &[Cap], [low, high]: [f64; 2]) -> Option<(usize, Cap)> {
    let area = |i: usize| caps[i - 1..=i + 1].iter().map(|c| c.half * c.depth).sum::<f64>();
    let among = (1..caps.len().saturating_sub(1)).filter(|&i| caps[i].height > low && caps[i].height < high);
    among.min_by(|&i, &j| area(i).total_cmp(&area(j))).map(|i| (i, caps[i]))
}
