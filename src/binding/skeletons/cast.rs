//! Which joint of a skeleton plays which part in a human body.

use super::names::{self, Meaning, Role, Word};
use super::rig::Rig;
use crate::binding::segments::Side;
use std::collections::BTreeMap;

/// Joints of an arm, by index in the take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Arm {
    pub shoulder: usize,
    pub elbow: usize,
    pub wrist: usize,
    /// A joint or end towards the finger tips.
    pub hand: Option<usize>,
}

/// Joints of a leg.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Leg {
    pub hip: usize,
    pub knee: usize,
    pub ankle: usize,
    pub toe: Option<usize>,
}

/// The joints that carry a human body.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cast {
    /// From the pelvis to the joint that carries the chest, at least one.
    pub spine: Vec<usize>,
    pub neck: Option<usize>,
    pub head: Option<usize>,
    /// Left and right.
    pub arms: [Arm; 2],
    pub legs: [Leg; 2],
    /// Joints that the dictionary names, without the ends of bones.
    pub named: usize,
    /// Family of names.
    pub family: Option<&'static str>,
    /// Whether the form of the tree had to tell, since the names say nothing.
    pub by_form: bool,
}

impl Cast {
    pub(super) fn pelvis(&self) -> usize {
        self.spine[0]
    }

    pub(super) fn chest(&self) -> usize {
        self.spine[self.spine.len() - 1]
    }
}

/// The parts by the joints' names; what is missing, in words, where they do not make a body.
pub(super) fn by_names(rig: &Rig<'_>, swap: bool, roles: &BTreeMap<String, Role>) -> Result<Cast, Vec<String>> {
    let names: Vec<&str> = rig.take.joints.iter().map(|j| j.name.as_str()).collect();
    let meanings = names::read(&names, swap, roles);
    let named = rig.take.joints.iter().zip(&meanings).filter(|(joint, meaning)| !joint.end && meaning.is_some()).count();
    let book = Book { rig, meanings: &meanings };
    let mut missing = Vec::new();
    let sides = [Side::Left, Side::Right];
    let limbs = sides.map(|side| (book.arm(side, &mut missing), book.leg(side, &mut missing)));
    let [(Some(left_arm), Some(left_leg)), (Some(right_arm), Some(right_leg))] = limbs else { return Err(missing) };
    let (arms, legs) = ([left_arm, right_arm], [left_leg, right_leg]);
    let family = names::family(&names);
    with_spine(
        rig,
        arms,
        legs,
        &book,
        Cast { spine: Vec::new(), neck: None, head: None, arms, legs, named, family, by_form: false },
    )
    .map_err(|lack| vec![lack])
}

fn with_spine(rig: &Rig<'_>, arms: [Arm; 2], legs: [Leg; 2], book: &Book<'_>, mut cast: Cast) -> Result<Cast, String> {
    let pelvis = rig.common(legs[0].hip, legs[1].hip).or_else(|| book.first(Word::Pelvis));
    let chest = rig.common(arms[0].shoulder, arms[1].shoulder);
    let chest = chest.or_else(|| [Word::Chest, Word::SpineMid, Word::SpineLow].into_iter().find_map(|w| book.first(w)));
    let pelvis = pelvis.ok_or("pelvis")?;
    let chest = chest.ok_or("chest")?;
    cast.spine = rig.spine(pelvis, chest);
    let above = |&joint: &usize| joint != chest && !rig.is_above(joint, chest);
    cast.neck = book.all(Word::Neck, Side::Middle).find(above);
    cast.head = book.all(Word::Head, Side::Middle).filter(above).last();
    Ok(cast)
}

/// Joints by meaning.
struct Book<'a> {
    rig: &'a Rig<'a>,
    meanings: &'a [Option<Meaning>],
}

impl Book<'_> {
    /// Joints of a word and side; ends of bones have no turn to give.
    fn all(&self, word: Word, side: Side) -> impl Iterator<Item = usize> {
        let ends_too = matches!(word, Word::HandEnd | Word::Toe | Word::ToeEnd | Word::Wrist | Word::Ankle);
        self.meanings.iter().enumerate().filter_map(move |(i, meaning)| {
            let meaning = meaning.as_ref()?;
            let counts = ends_too || !self.rig.take.joints[i].end;
            (meaning.word == word && meaning.side == side && counts).then_some(i)
        })
    }

    fn first(&self, word: Word) -> Option<usize> {
        self.all(word, Side::Middle).next()
    }

    fn core(&self, joint: usize) -> &str {
        self.meanings[joint].as_ref().map_or("", |m| &m.core)
    }

    /// The first of `candidates` that hangs on `above`, or the first at all where nothing does.
    fn under(&self, above: Option<usize>, candidates: impl Iterator<Item = usize>) -> Option<usize> {
        let all: Vec<usize> = candidates.collect();
        let hanging = all.iter().copied().find(|&c| above.is_some_and(|a| self.rig.is_above(a, c)));
        hanging.or_else(|| if self.rig.is_flat() || above.is_none() { all.first().copied() } else { None })
    }

    fn arm(&self, side: Side, missing: &mut Vec<String>) -> Option<Arm> {
        // A sided "shoulder" is the joint only where no other name is.
        let elbow = self.all(Word::Elbow, side).next();
        let shoulder = self.all(Word::Shoulder, side).next();
        let shoulder = shoulder.or_else(|| {
            let words: Vec<usize> = self.all(Word::SomeShoulder, side).collect();
            let carries = |&s: &usize| elbow.is_none_or(|e| self.rig.is_above(s, e));
            words.iter().copied().rfind(carries).or(words.last().copied())
        });
        let elbow = self.under(shoulder, self.all(Word::Elbow, side)).or(elbow.filter(|_| shoulder.is_none()));
        let wrist = self.under(elbow, self.all(Word::Wrist, side));
        for (joint, word) in [(shoulder, "shoulder"), (elbow, "elbow"), (wrist, "wrist")] {
            if joint.is_none() {
                missing.push(lack(side, word));
            }
        }
        let (shoulder, elbow, wrist) = (shoulder?, elbow?, wrist?);
        let hand = self.all(Word::HandEnd, side).find(|&h| self.rig.is_above(wrist, h));
        Some(Arm { shoulder, elbow, wrist, hand })
    }

    fn leg(&self, side: Side, missing: &mut Vec<String>) -> Option<Leg> {
        // Where both sides begin in one point there is a link more.
        let apart = |&hip: &usize| !self.all(Word::Hip, side.other()).any(|other| self.rig.coincide(hip, other));
        let hips: Vec<usize> = self.all(Word::Hip, side).filter(apart).collect();
        let is_word = |&&h: &&usize| matches!(self.core(h), "hip" | "hips");
        let hip = hips.iter().find(|h| !is_word(h)).or(hips.first()).copied();
        let knee = self.under(hip, self.all(Word::Knee, side));
        // Beside an ankle, a "foot" is the joint of the toes.
        let feet: Vec<usize> = self.all(Word::Ankle, side).filter(|&f| self.core(f).contains("foot")).collect();
        let ankles: Vec<usize> = self.all(Word::Ankle, side).filter(|f| !feet.contains(f)).collect();
        let ankle = self.under(knee, ankles.iter().chain(&feet).copied());
        for (joint, word) in [(hip, "hip"), (knee, "knee"), (ankle, "ankle")] {
            if joint.is_none() {
                missing.push(lack(side, word));
            }
        }
        let (hip, knee, ankle) = (hip?, knee?, ankle?);
        let further = feet.into_iter().filter(|&f| f != ankle && !self.rig.is_above(f, ankle));
        let toes = self.all(Word::Toe, side).chain(further).chain(self.all(Word::ToeEnd, side));
        let toe = self.under(Some(ankle), toes);
        Some(Leg { hip, knee, ankle, toe })
    }
}

fn lack(side: Side, word: &str) -> String {
    format!("{} {word}", if side == Side::Right { "right" } else { "left" })
}
