//! What can be wrong with a pair, and which warning has to tell of each kind: a warning of another kind excuses nothing.

use super::limbs;
use std::fmt;

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Up,
    Facing,
    Unit,
    /// The markers are far off their places on the body.
    Fit,
    /// A limb lies otherwise than captured: its number in [`limbs::NAMES`].
    Pose(usize),
    /// A limb is longer or shorter than at rest.
    Length(usize),
    /// Handles do not keep their distances along bones.
    Strain,
    /// A handle stays far from its target.
    Residual,
    /// A foot that stands slides.
    Slip,
    /// Neither done nor refused in words, or nothing to measure by.
    Broken,
}

impl Kind {
    /// Words of the warnings that tell of it. Each stands in that warning only.
    fn told_by(self) -> &'static [&'static str] {
        match self {
            Self::Up => &["not upright", "are believed", "what is up is not believed"],
            Self::Facing => &["facing of the scan from its feet is weak", "check the facing", "told by their places on the body"],
            Self::Unit => &["is believed (--capture-unit sets it)", "unit is not known"],
            Self::Fit => &["the markers do not fit this body well"],
            // Of arms along the trunk the joints are known less well, so that it is said of each of them.
            Self::Pose(limb) if limb % 4 < 2 => &[
                "the markers do not fit this body well",
                "shoulders may look square",
                "pull softly",
                "pulls softly",
                "the arms touch the body: their joints",
                "told by their places on the body",
            ],
            Self::Pose(_) => {
                &["the markers do not fit this body well", "pull softly", "pulls softly", "told by their places on the body"]
            }
            Self::Length(_) => &[
                "the scan's limbs are stretched to the actor's lengths",
                "distances along bones differ",
                "tetrahedra still join them",
                "cut apart where the joints tell",
                "from its target",
            ],
            Self::Strain => &["distances along bones differ", "actor and scan differ in build"],
            Self::Residual => &["from its target", "not solved to the tolerance"],
            Self::Slip => &["slide"],
            Self::Broken => &[],
        }
    }

    /// Its name without the limb.
    pub fn word(self) -> &'static str {
        match self {
            Self::Up => "up",
            Self::Facing => "facing",
            Self::Unit => "unit",
            Self::Fit => "fit",
            Self::Pose(_) => "pose",
            Self::Length(_) => "length",
            Self::Strain => "strain",
            Self::Residual => "residual",
            Self::Slip => "slip",
            Self::Broken => "broken",
        }
    }
}

/// One thing that is wrong, in words.
#[derive(Clone, Debug)]
pub struct Wrong {
    pub kind: Kind,
    pub words: String,
}

impl Wrong {
    pub fn new(kind: Kind, words: impl Into<String>) -> Self {
        Self { kind, words: words.into() }
    }

    pub fn is_told(&self, warnings: &[String]) -> bool {
        warnings.iter().any(|warning| self.kind.told_by().iter().any(|words| warning.contains(words)))
    }
}

impl fmt::Display for Wrong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words)
    }
}

/// Warnings of a scan by itself, which every take with it gets.
const OF_THE_SCAN: [&str; 2] = ["cut apart where the joints tell", "tetrahedra still join them"];

/// Warnings that tell of something wrong with the whole: kinds by which a right pair would be cried over.
pub fn alarms(warnings: &[String]) -> Vec<Kind> {
    use Kind::{Facing, Fit, Length, Residual, Slip, Strain, Unit, Up};
    let of_the_pair: Vec<String> =
        warnings.iter().filter(|warning| !OF_THE_SCAN.iter().any(|words| warning.contains(words))).cloned().collect();
    let all = [Up, Facing, Unit, Fit, Length(0), Strain, Residual, Slip];
    all.into_iter().filter(|&kind| Wrong::new(kind, "").is_told(&of_the_pair)).collect()
}

/// Whether a warning tells of markers, sides or a body that were taken for what they may not be.
pub fn doubts_who_is_who(warning: &str) -> bool {
    let words = ["told by their places on the body", "have left and right exchanged", "hardly a person", "--subject chooses"];
    words.iter().any(|words| warning.contains(words)) || !alarms(&[warning.to_owned()]).is_empty()
}

#[test]
fn a_warning_excuses_only_what_it_tells_of() {
    let warnings: Vec<String> = [
        "facing of the scan from its feet is weak (1.3): check the result, --flip turns it",
        "the take never shows the scan's pose (nearest frame 9.6 % of height away): attachment points go through the fitted pose",
        "the arms of the reference frame are 43° away from the scan's: shoulders may look square",
        "the feet have grown together with a flat floor: its 8,249 faces are left out, and what is written has no floor",
    ]
    .map(str::to_owned)
    .to_vec();
    let told = |kind: Kind| Wrong::new(kind, "").is_told(&warnings);
    let arm = limbs::NAMES.iter().position(|name| *name == "right forearm").unwrap();
    let leg = limbs::NAMES.iter().position(|name| *name == "left thigh").unwrap();
    assert!(told(Kind::Facing) && told(Kind::Pose(arm)));
    for kind in [
        Kind::Up,
        Kind::Unit,
        Kind::Fit,
        Kind::Pose(leg),
        Kind::Length(arm),
        Kind::Strain,
        Kind::Residual,
        Kind::Slip,
        Kind::Broken,
    ] {
        assert!(!told(kind), "{kind:?}");
    }
    assert_eq!(alarms(&warnings), [Kind::Facing]);
}
