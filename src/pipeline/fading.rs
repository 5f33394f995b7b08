//! How handles let go whose targets vanish, and how they take hold again when those return: without a jump.
//!
//! A handle that is let go holds what it holds where it is, but for the motion of the body, and weaker from frame to frame: it drags. How fast it may
//! weaken is told by how far the body slips away from it. A handle that is taken hold of is led from where it is to its target.

use crate::deform::{Handle, Targets};
use glam::DVec3;

/// How far a handle goes out of its way in a frame for that, in diagonals: a target that returns leads it no farther, and one from which the body slips
/// away by so much hardly lets go any more.
pub(super) const STRIDE: f64 = 0.008;
/// The fewest frames that a return takes.
const FEWEST: u32 = 6;
/// What remains in a frame of the pull of a handle that is let go, where nothing slips and where much does. A free limb follows the faintest pull, so
/// that the pull has to fall by powers, and far: to the one that is none any more.
const RELEASE: f64 = 0.6;
const SLOWEST: f64 = 0.9;
const FAINTEST: f64 = 1e-7;
/// What remains in each frame of the motion that the handle then had besides that of the body: how the limb goes on is not known.
pub(super) const SLOWING: f64 = 0.7;
/// Mean distance of the targets, in the unit box, from where the last two frames lead, beyond which the take is cut: then nothing is faded.
const CUT: f64 = 0.1;

/// How far a handle is on its way out or back.
#[derive(Clone, Copy, Default)]
pub(super) struct Fade {
    presence: f64,
    /// Frames since the target returned, and those that the return takes.
    returned: u32,
    frames: u32,
}

impl Fade {
    /// Its part of the full pull.
    pub(super) fn presence(self) -> f64 {
        self.presence
    }

    /// Whether it is held as if its target had always been there.
    pub(super) fn is_settled(self) -> bool {
        self.presence == 1.0 && self.returned >= self.frames
    }

    /// Without fading: from now on it is held or not.
    pub(super) fn cut(&mut self, present: bool) {
        *self = Self { presence: f64::from(u8::from(present)), ..Self::default() };
    }

    /// Its target is gone. `slip`: how far the body slipped from where it was held in the frame before, in the unit box.
    pub(super) fn let_go(&mut self, slip: f64) {
        let haste = (1.0 - slip / STRIDE).max(0.0);
        self.presence *= SLOWEST + (RELEASE - SLOWEST) * haste;
        if self.presence < FAINTEST {
            self.presence = 0.0;
        }
    }

    /// Its target is back, so far from it.
    pub(super) fn take_hold(&mut self, distance: f64) {
        *self = Self { presence: 1.0, returned: 0, frames: FEWEST.max((STEEPEST * distance / STRIDE).ceil() as u32) };
    }

    /// One frame on the way back: the part of the way that is left.
    pub(super) fn left(&mut self) -> f64 {
        if self.returned >= self.frames {
            return 0.0;
        }
        self.returned += 1;
        1.0 - smooth(f64::from(self.returned) / f64::from(self.frames))
    }
}

/// Largest slope of [`smooth`].
const STEEPEST: f64 = 1.5;

/// From 0 to 1 without a corner.
fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

/// What a frame is to those before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Passage {
    /// Whether it has nothing to do with them.
    pub(super) cut: bool,
    /// How far the body moves to it, as the settled targets say; unknown without any.
    pub(super) drift: Option<DVec3>,
}

/// The handles that are points, from frame to frame.
pub(super) struct Fading {
    handles: Vec<Point>,
    /// Frames seen so far, at most 2.
    frames: u32,
}

#[derive(Clone, Copy, Default)]
struct Point {
    fade: Fade,
    /// Where the handle was after the last frame, and in the frame before.
    place: DVec3,
    before: DVec3,
    /// Its last target.
    target: DVec3,
    /// Distance of the handle from its target when that returned.
    offset: DVec3,
    /// Way of the handle in a frame besides that of the body when its target vanished.
    own: DVec3,
}

impl Point {
    /// Where the handle goes by its own motion.
    fn ahead(&self) -> DVec3 {
        self.place * 2.0 - self.before
    }
}

impl Fading {
    pub(super) fn new(handles: usize) -> Self {
        Self { handles: vec![Point::default(); handles], frames: 0 }
    }

    /// Sets the presence of the handles, and the targets of those that fade. `pose`: the body after the frame before; `present`: the handles whose
    /// markers are there, where `targets` has their positions.
    pub(super) fn follow(&mut self, handles: &[Handle], pose: &[DVec3], present: &[bool], targets: &mut Targets) -> Passage {
        for (point, handle) in self.handles.iter_mut().zip(handles) {
            let place = handle.row.apply(pose);
            point.before = if self.frames < 2 { place } else { point.place };
            point.place = place;
        }
        let cut = self.frames == 0 || self.mean(present, &targets.positions, |p, t| t.distance(p.ahead())) > Some(CUT);
        let drift = if cut { None } else { self.mean(present, &targets.positions, |p, t| t - p.place) };
        self.frames = if cut { 1 } else { 2 };
        let along = drift.unwrap_or_default();
        let each = self.handles.iter_mut().zip(present).zip(&mut targets.positions).zip(&mut targets.presence);
        for (((point, &present), target), presence) in each {
            if cut {
                point.fade.cut(present);
            } else if present {
                if point.fade.presence < 1.0 {
                    point.offset = point.ahead() - *target;
                    point.fade.take_hold(point.offset.length());
                }
                *target += point.offset * point.fade.left();
            } else if point.fade.presence > 0.0 {
                let vanishes = point.fade.presence == 1.0;
                point.own = if vanishes { point.place - point.before - along } else { point.own * SLOWING };
                point.fade.let_go(if vanishes { 0.0 } else { point.place.distance(point.target) });
                *target = point.place + along + point.own;
            }
            point.target = *target;
            *presence = point.fade.presence;
        }
        Passage { cut, drift }
    }

    /// Mean over the settled handles whose markers are there.
    fn mean<T: std::iter::Sum + std::ops::Div<f64, Output = T>>(
        &self,
        present: &[bool],
        positions: &[DVec3],
        of: impl Fn(&Point, DVec3) -> T,
    ) -> Option<T> {
        let settled = || {
            let all = self.handles.iter().zip(present).zip(positions);
            all.filter(|((point, present), _)| **present && point.fade.is_settled())
        };
        let count = settled().count();
        (count > 0).then(|| settled().map(|((point, _), target)| of(point, *target)).sum::<T>() / count as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::SparseRow;

    /// Two handles that are vertices of the body; the body goes wherever they pull it.
    fn handles() -> [Handle; 2] {
        [0, 1].map(|v| Handle { name: v.to_string(), row: SparseRow { indices: vec![v], values: vec![1.0] }, beta: 1.0 })
    }

    fn targets(positions: [DVec3; 2]) -> Targets {
        Targets { positions: positions.to_vec(), presence: vec![0.0; 2] }
    }

    #[test]
    fn a_marker_that_returns_is_reached_smoothly_and_exactly() {
        let mut fading = Fading::new(2);
        let mut pose = vec![DVec3::ZERO, DVec3::X];
        let mut moves = Vec::new();
        for k in 0..30 {
            // The second marker is gone for some frames; the limb hangs elsewhere then.
            let present = [true, !(3..10).contains(&k)];
            let mut targets = targets([DVec3::ZERO, DVec3::X]);
            fading.follow(&handles(), &pose, &present, &mut targets);
            let free = DVec3::X + DVec3::Y * 0.05;
            let next = if present[1] { targets.positions[1] } else { free };
            moves.push(next.distance(pose[1]));
            pose[1] = next;
            assert_eq!(targets.presence[0], 1.0);
        }
        assert_eq!(pose[1], DVec3::X);
        assert!(moves[10..].iter().all(|m| *m < 0.01), "{:?}", &moves[10..]);
        assert!(moves[25..].iter().all(|m| *m == 0.0));
    }

    #[test]
    fn a_marker_that_vanishes_lets_go_by_and_by_along_its_way() {
        let mut fading = Fading::new(2);
        let mut presences = Vec::new();
        let step = DVec3::Z * 0.02;
        let mut pose = vec![DVec3::ZERO, DVec3::X];
        for k in 0..45 {
            // The first marker says where the body goes; the second goes its own way besides, as long as it is there.
            let body = step * f64::from(k);
            let mut targets = targets([body, DVec3::X + body + DVec3::Y * (0.01 * f64::from(k))]);
            let before = pose[1];
            let passage = fading.follow(&handles(), &pose, &[true, k < 5], &mut targets);
            presences.push(targets.presence[1]);
            let pulls = targets.presence[1] > 0.0;
            if k > 1 && k < 5 {
                assert!(!passage.cut && passage.drift.is_some());
            } else if k >= 5 && pulls {
                let own = targets.positions[1] - before - step;
                let expected = DVec3::Y * (0.01 * SLOWING.powi(k - 5));
                // When it vanished the mean of both told the way of the body.
                assert!(k == 5 || passage.drift == Some(targets.positions[0] - pose[0]), "{passage:?}");
                assert!(own.distance(expected) < 1e-12, "{k}: {own} {expected}");
            }
            pose = if pulls { targets.positions.clone() } else { vec![body, pose[1] + step] };
        }
        assert!(presences[4] == 1.0 && (presences[5] - RELEASE).abs() < 1e-12 && presences[44] == 0.0, "{presences:?}");
        assert!(presences[5..].windows(2).all(|w| w[1] <= w[0]));
    }

    #[test]
    fn the_more_slips_the_slower_a_handle_lets_go() {
        let kept = |slip: f64| {
            let mut fade = Fade::default();
            fade.cut(true);
            fade.let_go(slip);
            fade.presence()
        };
        let kept = [0.0, 0.5 * STRIDE, STRIDE, 10.0 * STRIDE].map(kept);
        let expected = [RELEASE, 0.5 * (RELEASE + SLOWEST), SLOWEST, SLOWEST];
        assert!(kept.iter().zip(expected).all(|(k, e)| (k - e).abs() < 1e-12), "{kept:?}");
    }

    #[test]
    fn nothing_fades_over_a_cut() {
        let mut fading = Fading::new(2);
        let pose = [DVec3::ZERO, DVec3::X];
        for _ in 0..3 {
            fading.follow(&handles(), &pose, &[true, true], &mut targets(pose));
        }
        let mut far = targets(pose.map(|p| p + DVec3::Z));
        let passage = fading.follow(&handles(), &pose, &[true, false], &mut far);
        assert_eq!(passage, Passage { cut: true, drift: None });
        assert_eq!(far.presence, [1.0, 0.0]);
    }
}
