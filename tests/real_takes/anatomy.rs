//! Which part of the body a marker belongs to: by its name, and by where the program put it.

use glam::DVec3;
use serde_json::Value;
use std::path::Path;

/// Names without their side, and their segment without its side, in the three sets of the real takes.
const PARTS: [(&str, &[&str]); 9] = [
    ("head", &["FHD", "BHD", "Head1", "Head2", "Head3"]),
    ("trunk", &["C7", "T10", "CLAV", "STRN", "BAK", "BAC", "SHO", "Chest1", "Chest2", "Chest3", "Shoulder1", "Shoulder2"]),
    ("pelvis", &["ASI", "PSI", "FWT", "BWT", "Hip1", "Hip2", "Hip3", "Hip4"]),
    ("upper arm", &["UPA", "ELB", "UArm1", "UArm2"]),
    ("forearm", &["FRM", "WRA", "WRB"]),
    ("hand", &["FIN", "Hand1"]),
    ("thigh", &["THI", "KNE", "Thigh1", "Thigh2"]),
    ("shank", &["TIB", "SHN", "ANK", "Shin1", "Shin2"]),
    ("foot", &["HEE", "TOE", "MT5", "Foot1", "Foot2"]),
];

/// Arena sticks its markers "Hand2" and "Hand3" on the wrist.
const ARENA_WRIST: [&str; 2] = ["Hand2", "Hand3"];

/// The segment that a label names, in the words of the report; `None` for a label of no known set.
pub(crate) fn segment_of(label: &str) -> Option<String> {
    let label = label.strip_prefix("Skeleton_").unwrap_or(label);
    let middle = ["head", "trunk", "pelvis"];
    let of = |core: &str| {
        if ARENA_WRIST.contains(&core) {
            return Some("forearm");
        }
        PARTS.iter().find(|(_, cores)| cores.contains(&core)).map(|(segment, _)| *segment)
    };
    if let Some(segment) = of(label).filter(|s| middle.contains(s)) {
        return Some(segment.into());
    }
    let side = match label.chars().next()? {
        'L' => "left",
        'R' => "right",
        _ => return None,
    };
    let segment = of(&label[1..])?;
    Some(if middle.contains(&segment) { segment.into() } else { format!("{side} {segment}") })
}

/// The true bones of the MakeHuman man: segment, and a line from head to tail.
pub(crate) struct Anatomy {
    bones: Vec<(String, DVec3, DVec3)>,
}

/// Beginnings of the names of bones, and their segments.
const BONES: [(&str, &[&str]); 9] = [
    ("head", &["neck02", "neck03", "head"]),
    ("trunk", &["spine01", "spine02", "spine03", "neck01", "clavicle", "shoulder01"]),
    ("pelvis", &["root", "pelvis", "spine05", "spine04"]),
    ("upper arm", &["upperarm"]),
    ("forearm", &["lowerarm"]),
    ("hand", &["wrist", "metacarpal", "finger"]),
    ("thigh", &["upperleg"]),
    ("shank", &["lowerleg"]),
    ("foot", &["foot", "toe"]),
];

/// Pairs of segments that meet in a joint, without sides.
const JOINTED: [(&str, &str); 9] = [
    ("head", "trunk"),
    ("trunk", "pelvis"),
    ("trunk", "upper arm"),
    ("upper arm", "forearm"),
    ("forearm", "hand"),
    ("pelvis", "thigh"),
    ("thigh", "shank"),
    ("shank", "foot"),
    ("trunk", "thigh"),
];

impl Anatomy {
    /// Reads bones from a file of truths: under `joints` or `joints_mm`.
    pub(crate) fn read(path: &Path) -> Self {
        let truth: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        let joints = truth.get("joints").or(truth.get("joints_mm")).unwrap().as_object().unwrap();
        let point = |v: &Value| DVec3::from(std::array::from_fn(|c| v[c].as_f64().unwrap()));
        let mut bones = Vec::new();
        for (name, bone) in joints {
            let Some((segment, _)) = BONES.iter().find(|(_, starts)| starts.iter().any(|s| name.starts_with(s))) else {
                continue;
            };
            let segment = match name.rsplit_once('.') {
                _ if ["trunk", "pelvis"].contains(segment) => (*segment).to_owned(),
                Some((_, "L")) => format!("left {segment}"),
                Some((_, "R")) => format!("right {segment}"),
                _ => (*segment).to_owned(),
            };
            bones.push((segment, point(&bone["head"]), point(&bone["tail"])));
        }
        assert!(bones.len() > 80, "{} bones in {}", bones.len(), path.display());
        Self { bones }
    }

    /// The bones brought into another space.
    pub(crate) fn mapped(mut self, to: impl Fn(DVec3) -> DVec3) -> Self {
        for (_, a, b) in &mut self.bones {
            (*a, *b) = (to(*a), to(*b));
        }
        self
    }

    fn distance(&self, segment: &str, p: DVec3) -> f64 {
        let bones = self.bones.iter().filter(|b| b.0 == segment);
        let distance = |a: DVec3, b: DVec3| {
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, t))
        };
        bones.map(|(_, a, b)| distance(*a, *b)).fold(f64::INFINITY, f64::min)
    }

    /// Whether a point lies on a segment: nearer to its bones, or to those of a neighbour at a joint, than to any other bone, and not far.
    /// `height` is the body's.
    pub(crate) fn on_segment(&self, segment: &str, p: DVec3, height: f64) -> Result<(), String> {
        let own = self.distance(segment, p);
        let nearest =
            self.bones.iter().map(|b| b.0.as_str()).min_by(|a, b| self.distance(a, p).total_cmp(&self.distance(b, p))).unwrap();
        if own > 0.12 * height {
            return Err(format!("{:.0} % of the height away from the {segment}, nearest to the {nearest}", own / height * 100.0));
        }
        if nearest == segment || jointed(nearest, segment) {
            Ok(())
        } else {
            Err(format!("on the {nearest}, not on the {segment}"))
        }
    }
}

fn jointed(a: &str, b: &str) -> bool {
    let parts = |s: &str| match s.split_once(' ') {
        Some((side @ ("left" | "right"), rest)) => (Some(side.to_owned()), rest.to_owned()),
        _ => (None, s.to_owned()),
    };
    let ((a_side, a), (b_side, b)) = (parts(a), parts(b));
    let one_body_side = a_side.is_none() || b_side.is_none() || a_side == b_side;
    one_body_side && JOINTED.iter().any(|&(x, y)| (x == a && y == b) || (x == b && y == a))
}
