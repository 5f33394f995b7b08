//! How arms and legs lie, read twice by nothing that the program uses for binding: in the capture between its own points, in what was
//! written between the ends of the skin's shafts.

use glam::{DMat3, DQuat, DVec3, DVec4};
use retarget::capture::MarkerTake;

/// Upper arm, forearm, thigh and shank, left and then right: the joints at their ends, among [`JOINTS`].
pub const LIMBS: [(usize, usize); 8] = [(0, 1), (1, 2), (3, 4), (4, 5), (6, 7), (7, 8), (9, 10), (10, 11)];
/// Words for them.
pub const NAMES: [&str; 8] = [
    "left upper arm",
    "left forearm",
    "left thigh",
    "left shank",
    "right upper arm",
    "right forearm",
    "right thigh",
    "right shank",
];
/// Shoulder, elbow, wrist, hip, knee and ankle, left and then right, among the joints that `inspect` lists.
pub const JOINTS: [usize; 12] = [4, 5, 6, 12, 13, 14, 8, 9, 10, 16, 17, 18];
/// The same in the rig of the made bodies whose joints are known.
pub const BONES: [&str; 12] = [
    "upperarm01.L",
    "lowerarm01.L",
    "wrist.L",
    "upperleg01.L",
    "lowerleg01.L",
    "foot.L",
    "upperarm01.R",
    "lowerarm01.R",
    "wrist.R",
    "upperleg01.R",
    "lowerleg01.R",
    "foot.R",
];

/// Least cosine between an arm that hangs and the trunk.
const HANGS: f64 = 0.95;
/// Hands are looked for so much farther than they were found to reach: finger tips that lie against a thigh are found to 6 % of stature.
const HAND: f64 = 1.6;

/// Points of a capture for the twelve joints: the mean of some of its points, `None` where the set has none.
pub struct Points(Vec<Vec<usize>>);

impl Points {
    /// `words`: six places of the left side such as `LSHO LELB LWRA+LWRB - LKNE LANK`, in which `mirror` changes words of the left into
    /// those of the right.
    pub fn new(take: &MarkerTake, words: &str, mirror: &str) -> Self {
        let find = |label: &str| {
            let found = take.labels.iter().position(|l| l.replace(' ', "_") == label);
            found.unwrap_or_else(|| panic!("no point {label} among {:?}", take.labels))
        };
        let right = |label: &str| {
            // A pair as `Left=Right`, or single letters in certain places as `l=r`: at the first place where the left word stands.
            let (from, to) = mirror.split_once('=').unwrap();
            label.replacen(from, to, 1)
        };
        let of = |words: &str, side: usize| -> Vec<usize> {
            let labels = words.split('+').filter(|word| *word != "-");
            labels.map(|l| if side == 0 { find(l) } else { find(&right(l)) }).collect()
        };
        Self((0..2).flat_map(|side| words.split_whitespace().map(move |w| of(w, side)).collect::<Vec<_>>()).collect())
    }

    /// Directions of the limbs in a frame.
    pub fn directions(&self, take: &MarkerTake, frame: usize) -> [Option<DVec3>; 8] {
        let at = |joint: usize| -> Option<DVec3> {
            let seen: Option<Vec<DVec3>> = self.0[joint].iter().map(|&m| take.point(frame, m)).collect();
            seen.filter(|s| !s.is_empty()).map(|s| s.iter().sum::<DVec3>() / s.len() as f64)
        };
        LIMBS.map(|(a, b)| (at(b)? - at(a)?).try_normalize())
    }
}

/// The skin about the shafts of the limbs at rest.
pub struct Shafts {
    joints: [DVec3; 12],
    /// Vertices of each limb.
    skin: [Vec<usize>; 8],
}

/// How the limbs of a written frame lie.
pub struct Posed {
    /// Zero where a limb has no skin to tell it by.
    pub directions: [DVec3; 8],
    /// Length of each shaft against rest; 1 without skin: a quotient of nothing would pass for the largest of the eight.
    pub stretch: [f64; 8],
}

impl Shafts {
    /// `joints`: the twelve, in the space of the scan; `tips` of the hands, left and right: hands that hang beside the thighs are no thighs.
    pub fn new(rest: &[DVec3], joints: [DVec3; 12], tips: [DVec3; 2], stature: f64) -> Self {
        let nearest = |p: DVec3, limb: usize| {
            let (a, b) = (joints[LIMBS[limb].0], joints[LIMBS[limb].1]);
            a.lerp(b, ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0))
        };
        let near = |p: DVec3, limb: usize| {
            let (a, b) = (joints[LIMBS[limb].0], joints[LIMBS[limb].1]);
            (to_line(p, a, b), (p - a).dot(b - a) / (b - a).length_squared())
        };
        // Of an arm along the trunk only what looks away from it is surely the arm's.
        let axis = (joints[0] + joints[6] - joints[3] - joints[9]).normalize();
        let outwards = [joints[0] - joints[6], joints[6] - joints[0]].map(|side| side.normalize());
        let hanging = [0, 6].map(|side| (joints[side] - joints[side + 2]).normalize().dot(axis) > HANGS);
        let mut skin: [Vec<usize>; 8] = Default::default();
        for (v, &p) in rest.iter().enumerate() {
            let all = [0, 1, 2, 3, 4, 5, 6, 7].map(|limb| near(p, limb));
            let limb = (0..8).min_by(|&a, &b| all[a].0.total_cmp(&all[b].0)).unwrap();
            let ends = (0..2).map(|side| (joints[6 * side + 2], tips[side]));
            let hand = ends.map(|(wrist, tip)| to_line(p, wrist, wrist.lerp(tip, HAND))).fold(f64::INFINITY, f64::min);
            let reach = if limb % 4 < 2 { 0.05 } else { 0.08 };
            if hanging[limb / 4] && limb % 4 < 2 && (p - nearest(p, limb)).dot(outwards[limb / 4]) < 0.0 {
                continue;
            }
            if hand > all[limb].0.min(0.06 * stature) && (0.25..0.75).contains(&all[limb].1) && all[limb].0 < reach * stature {
                skin[limb].push(v);
            }
        }
        Self { joints, skin }
    }

    pub fn posed(&self, rest: &[DVec3], pose: &[[f32; 3]]) -> Posed {
        let mut out = Posed { directions: [DVec3::ZERO; 8], stretch: [1.0; 8] };
        for (limb, skin) in self.skin.iter().enumerate() {
            let at = |v: usize| DVec3::from_array(pose[v].map(f64::from));
            if skin.is_empty() {
                continue;
            }
            let count = skin.len() as f64;
            let from = skin.iter().map(|&v| rest[v]).sum::<DVec3>() / count;
            let to = skin.iter().map(|&v| at(v)).sum::<DVec3>() / count;
            let pairs: Vec<(DVec3, DVec3)> = skin.iter().map(|&v| (rest[v] - from, at(v) - to)).collect();
            let turn = turn(&pairs);
            let before = (self.joints[LIMBS[limb].1] - self.joints[LIMBS[limb].0]).normalize();
            let squares: f64 = pairs.iter().map(|(x, _)| x.dot(before).powi(2)).sum();
            if squares <= 0.0 {
                continue;
            }
            let after = turn * before;
            out.directions[limb] = after;
            out.stretch[limb] = pairs.iter().map(|(x, y)| x.dot(before) * y.dot(after)).sum::<f64>() / squares;
        }
        out
    }
}

/// Distance of a point from the line between two others.
fn to_line(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    p.distance(a.lerp(b, ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0)))
}

/// The rotation that brings points nearest to others, both about their means (Horn 1987: the largest eigenvector of a 4 × 4 matrix).
fn turn(pairs: &[(DVec3, DVec3)]) -> DQuat {
    let mut s = [[0.0; 3]; 3];
    for (x, y) in pairs {
        let (x, y) = (x.to_array(), y.to_array());
        (0..9).for_each(|k| s[k / 3][k % 3] += x[k / 3] * y[k % 3]);
    }
    let n = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [s[1][2] - s[2][1], s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [s[2][0] - s[0][2], s[0][1] + s[1][0], s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]],
        [s[0][1] - s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1], s[2][2] - s[0][0] - s[1][1]],
    ];
    // Above the largest entry by rows, so that the largest eigenvalue is the one of largest amount.
    let shift = n.iter().map(|row| row.iter().map(|x: &f64| x.abs()).sum::<f64>()).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
    let mut q = DVec4::new(1.0, 0.3, 0.2, 0.1).normalize();
    for _ in 0..2000 {
        let product = n.map(|row| DVec4::from_array(row).dot(q));
        q = (DVec4::from_array(product) + q * shift).normalize();
    }
    DQuat::from_xyzw(q.y, q.z, q.w, q.x)
}

/// Angles in degrees between limbs as captured and as written, after the one turn about the up axes that brings the whole take together.
///
/// Shapes: one entry per frame; `up` of the capture and of the scan. `None` for a limb that either of them does not show.
pub fn errors(captured: &[[Option<DVec3>; 8]], written: &[[DVec3; 8]], up: (DVec3, DVec3)) -> Vec<[Option<f64>; 8]> {
    let axes = |up: DVec3| {
        let x = up.any_orthonormal_vector();
        DMat3::from_cols(x, up.cross(x), up).transpose()
    };
    let (a, b) = (axes(up.0), axes(up.1));
    let (mut along, mut across) = (0.0, 0.0);
    for (captured, written) in captured.iter().zip(written) {
        for (c, w) in captured.iter().zip(written) {
            let (Some(c), w) = (c.map(|c| a * c), b * *w) else { continue };
            along += c.x * w.x + c.y * w.y;
            across += c.x * w.y - c.y * w.x;
        }
    }
    let yaw = DMat3::from_rotation_z(f64::atan2(across, along));
    let angle =
        |c: Option<DVec3>, w: DVec3| c.filter(|_| w != DVec3::ZERO).map(|c| (yaw * (a * c)).angle_between(b * w).to_degrees());
    captured.iter().zip(written).map(|(c, w)| std::array::from_fn(|limb| angle(c[limb], w[limb]))).collect()
}
