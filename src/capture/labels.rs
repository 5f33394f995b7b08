//! What a label says of its point: a marker on a body, a ghost without a name, or a computed value; and whose body it is.

use super::Cleaning;
use crate::error::{Error, Kind, Notes, Result};
use std::collections::{BTreeMap, BTreeSet};

/// Stems of the axis triads that body models add to the points: origin O and the tips A, L, P of the three axes.
const TRIADS: [&str; 21] = [
    "HED", "LCL", "RCL", "LFE", "RFE", "LFO", "RFO", "LHN", "RHN", "LHU", "RHU", "LRA", "RRA", "LTI", "RTI", "LTO", "RTO", "PEL",
    "TRX", "SPI", "THO",
];

/// Endings of computed quantities that are stored as points.
const SUFFIXES: [&str; 11] =
    ["Angles", "AnglesV", "Angle", "Force", "Forces", "Moment", "Moments", "Power", "Powers", "GRF", "Pressure"];

/// Computed points by name: centres of mass and of joints, midpoints, and the virtual markers of Helen-Hayes sets.
const COMPUTED: [&str; 36] = [
    "centreofmass",
    "centreofmassfloor",
    "lefthipcenter",
    "righthipcenter",
    "lhjc",
    "rhjc",
    "lkjc",
    "rkjc",
    "lajc",
    "rajc",
    "lsjc",
    "rsjc",
    "lejc",
    "rejc",
    "lwjc",
    "rwjc",
    "midasis",
    "midpsis",
    "com",
    "cop",
    "vmid",
    "vpel",
    "vrhi",
    "vlhi",
    "vrkn",
    "vlkn",
    "vran",
    "vlan",
    "vrha",
    "vlha",
    "vrto",
    "vlto",
    "vrhe",
    "vlhe",
    "vsho",
    "v_head",
];

/// Words before a running number that systems give to points without a name.
const UNNAMED: [&str; 10] =
    ["u", "uname", "unlabeled", "unlabelled", "unnamed", "unidentified", "m", "marker", "ghost", "unknown"];

/// From this many named markers on, the nameless points are ghosts; below, they are the take.
const ENOUGH_NAMED: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Body,
    Ghost,
    Computed,
}

/// The points that are markers of the chosen subject.
pub(super) struct Selection {
    /// Columns of the file, rising.
    pub(super) columns: Vec<usize>,
    /// Their labels without the subject's prefix; not yet unique.
    pub(super) labels: Vec<String>,
    /// Prefix of the subject, where the file has prefixes.
    pub(super) subject: Option<String>,
}

/// Chooses the markers of one subject and counts what is dropped.
///
/// `labels`: one per point as written. `computed`: labels that the file lists as computed. `listed`: names of subjects in the file.
///
/// # Errors
/// [`Kind::Usage`] when `wanted` is no subject of the file; [`Kind::Unsupported`] when no marker is left.
pub(super) fn select(
    labels: &[String],
    computed: &[String],
    listed: &[String],
    wanted: Option<&str>,
    cleaning: &mut Cleaning,
    notes: &mut Notes,
) -> Result<Selection> {
    let split: Vec<(&str, &str)> = labels.iter().map(|l| l.rsplit_once(':').unwrap_or(("", l))).collect();
    let mut roles = roles(labels, &split, computed);
    if roles.iter().filter(|r| **r == Role::Body).count() < ENOUGH_NAMED {
        roles.iter_mut().filter(|r| **r == Role::Ghost).for_each(|r| *r = Role::Body);
    }

    let prefix = subject(&split, &roles, listed, wanted, notes)?;
    let mut selection = Selection { columns: Vec::new(), labels: Vec::new(), subject: None };
    let mut without_prefix = 0;
    for (column, ((owner, name), role)) in split.iter().zip(&roles).enumerate() {
        match role {
            Role::Ghost => cleaning.ghosts += 1,
            _ if *owner != prefix && owner.is_empty() => without_prefix += 1,
            _ if *owner != prefix => cleaning.other_subjects += 1,
            Role::Computed => cleaning.computed += 1,
            Role::Body => {
                selection.columns.push(column);
                selection.labels.push(name.trim().to_owned());
            }
        }
    }
    // Body models write their own points without the prefix that they put before the markers.
    cleaning.computed += without_prefix;
    if without_prefix > 0 {
        notes.warn(format!("{without_prefix} points lack the prefix '{prefix}:' of the subject: dropped as computed points"));
    }
    if selection.columns.is_empty() {
        return Err(Error::new(
            Kind::Unsupported,
            format!(
                "none of the {} points is a marker: {} ghosts, {} computed",
                labels.len(),
                cleaning.ghosts,
                cleaning.computed
            ),
        )
        .expected("labelled markers on a body"));
    }
    selection.subject = (!prefix.is_empty()).then(|| prefix.to_owned());
    Ok(selection)
}

fn roles(labels: &[String], split: &[(&str, &str)], computed: &[String]) -> Vec<Role> {
    let listed: BTreeSet<&str> = computed.iter().map(String::as_str).collect();
    let present: BTreeSet<(&str, &str)> = split.iter().copied().collect();
    labels
        .iter()
        .zip(split)
        .map(|(label, (owner, name))| {
            let has = |other: String| present.contains(&(*owner, other.as_str()));
            if nameless(name) {
                Role::Ghost
            } else if listed.contains(label.as_str()) || listed.contains(name) || computed_by_name(name) || axis_point(name, has)
            {
                Role::Computed
            } else {
                Role::Body
            }
        })
        .collect()
}

/// `*12`, an empty label, `U_3`, `M001`, `Unlabeled7`, `Marker_3`; not `M1`, a metatarsal head.
fn nameless(name: &str) -> bool {
    let name = name.trim();
    if name.is_empty() || name.starts_with('*') || name == "#" {
        return true;
    }
    let word = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let digits = name.len() - word.len();
    let stem = word.trim_end_matches(['_', '-', ' ']);
    let separated = stem.len() < word.len();
    digits > 0 && UNNAMED.iter().any(|u| u.eq_ignore_ascii_case(stem)) && (separated || digits >= 3 || stem.len() > 1)
}

fn computed_by_name(name: &str) -> bool {
    SUFFIXES.iter().any(|s| name.ends_with(s)) || COMPUTED.iter().any(|c| c.eq_ignore_ascii_case(name))
}

/// A point of an axis triad: `PELO PELA PELL PELP` of the known stems, or the tips `HEADY HEADZ` of an origin `HEAD`.
///
/// Most of the triad has to be there, since `LFOO` alone is a foot.
fn axis_point(name: &str, has: impl Fn(String) -> bool) -> bool {
    let Some((last, letter)) = name.char_indices().next_back() else { return false };
    let stem = &name[..last];
    let model = || {
        TRIADS.iter().any(|t| t.eq_ignore_ascii_case(stem)) && "OALP".chars().filter(|c| has(format!("{stem}{c}"))).count() >= 3
    };
    match letter {
        'O' | 'A' | 'L' | 'P' => model(),
        'Y' | 'Z' => !stem.is_empty() && has(stem.to_owned()) && has(format!("{stem}Y")) && has(format!("{stem}Z")),
        _ => false,
    }
}

/// The prefix of the subject to take: the wanted one, else the one with most body markers, the first of equals.
fn subject<'a>(
    split: &[(&'a str, &str)],
    roles: &[Role],
    listed: &[String],
    wanted: Option<&str>,
    notes: &mut Notes,
) -> Result<&'a str> {
    let mut owners: Vec<(&str, usize)> = Vec::new();
    let mut place: BTreeMap<&str, usize> = BTreeMap::new();
    for ((owner, _), _) in split.iter().zip(roles).filter(|(_, role)| **role == Role::Body) {
        let at = *place.entry(owner).or_insert(owners.len());
        if at == owners.len() {
            owners.push((owner, 0));
        }
        owners[at].1 += 1;
    }
    let named: Vec<&(&str, usize)> = owners.iter().filter(|(o, _)| !o.is_empty()).collect();
    let list = named.iter().take(20).map(|(o, n)| format!("{o} ({n} markers)")).collect::<Vec<_>>().join(", ");
    if let Some(wanted) = wanted {
        let same = |name: &str| name.eq_ignore_ascii_case(wanted.trim().trim_end_matches(':'));
        if let Some((owner, _)) = named.iter().find(|(o, _)| same(o)) {
            return Ok(owner);
        }
        if named.is_empty() && listed.iter().any(|n| same(n)) {
            return Ok("");
        }
        let there = match (named.is_empty(), listed.is_empty()) {
            (false, _) => list,
            (true, false) => listed.join(", "),
            (true, true) => "none: the labels have no prefix, leave the option out".into(),
        };
        return Err(Error::new(Kind::Usage, format!("no subject '{wanted}' in the capture")).expected(there));
    }
    let mut best = ("", 0);
    for (owner, count) in &owners {
        if *count > best.1 {
            best = (owner, *count);
        }
    }
    if named.len() > 1 {
        notes.warn(format!("{} subjects: {list}; {} is taken, --subject chooses", named.len(), best.0));
    }
    Ok(best.0)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn of(labels: &[&str], computed: &[&str], wanted: Option<&str>) -> Result<(Vec<String>, Cleaning)> {
        let own = |l: &[&str]| l.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        let (mut cleaning, mut notes) = (Cleaning::default(), Notes::default());
        let s = select(&own(labels), &own(computed), &[], wanted, &mut cleaning, &mut notes)?;
        Ok((s.labels, cleaning))
    }

    #[test]
    fn ghosts_and_computed_points_are_told_from_markers() {
        let labels = [
            "LFHD",
            "C7",
            "T10",
            "M1",
            "*12",
            "",
            "U_3",
            "M001",
            "LHipAngles",
            "X",
            "CentreOfMass",
            "PELO",
            "PELA",
            "PELL",
            "PELP",
        ];
        let (kept, cleaning) = of(&labels, &["X"], None).unwrap();
        assert_eq!(kept, ["LFHD", "C7", "T10", "M1"]);
        assert_eq!((cleaning.ghosts, cleaning.computed), (4, 7));
    }

    #[test]
    fn a_foot_is_not_the_origin_of_a_triad() {
        let (kept, _) = of(&["LFOO", "RFOO", "LHAN", "C7"], &[], None).unwrap();
        assert_eq!(kept.len(), 4);
        let (kept, cleaning) = of(&["HEAD", "HEADY", "HEADZ", "C7"], &[], None).unwrap();
        assert_eq!((kept.as_slice(), cleaning.computed), (["HEAD".to_owned(), "C7".to_owned()].as_slice(), 2));
    }

    #[test]
    fn a_take_without_names_keeps_its_nameless_points() {
        assert_eq!(of(&["Marker_1", "Marker_2", "*3"], &[], None).unwrap().0.len(), 3);
    }

    #[test]
    fn the_subject_with_most_markers_is_taken_unless_another_is_wanted() {
        let labels = ["A:C7", "A:T10", "B:C7", "B:T10", "B:CLAV", "B:LHipAngles", "RS"];
        let (kept, cleaning) = of(&labels, &[], None).unwrap();
        assert_eq!(kept, ["C7", "T10", "CLAV"]);
        assert_eq!((cleaning.other_subjects, cleaning.computed), (2, 2));
        assert_eq!(of(&labels, &[], Some("a")).unwrap().0, ["C7", "T10"]);
        let refused = of(&labels, &[], Some("C")).unwrap_err();
        assert_eq!(refused.kind, Kind::Usage);
        assert!(refused.expected.unwrap().contains("A (2 markers), B (3 markers)"));
    }
}
