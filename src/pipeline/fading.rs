//! How markers that vanish let go, and how those that return take hold again: without a jump.

use crate::deform::{Handle, Targets};
use glam::DVec3;

/// Farthest that a marker which returns moves its handle out of its way in a frame, in diagonals, and the fewest frames that it takes.
const STRIDE: f64 = 0.008;
const FEWEST: u32 = 6;
/// What remains in each frame of the pull of a marker that has vanished, and the pull that is none any more. A free limb follows the faintest pull,
/// so that the pull has to fall by powers, and far.
const RELEASE: f64 = 0.6;
const FAINTEST: f64 = 1e-7;
/// What remains in each frame of the speed that the handle had then: how the limb goes on is not known.
const SLOWING: f64 = 0.7;
/// Mean distance of the targets, in the unit box, from where the last two frames lead, beyond which the take is cut: then nothing is faded.
const CUT: f64 = 0.1;

/// The pull of every handle.
pub(super) struct Fading {
    handles: Vec<Fade>,
    /// Frames seen so far, at most 2.
    frames: u32,
}

#[derive(Clone, Copy, Default)]
struct Fade {
    presence: f64,
    /// Where the handle was after the last frame, and in the frame before.
    place: DVec3,
    before: DVec3,
    /// Distance of the handle from its marker when that returned.
    offset: DVec3,
    /// Frames since then, and those that it takes.
    returned: u32,
    frames: u32,
    /// Way of the handle in a frame when its marker vanished.
    speed: DVec3,
}

impl Fade {
    /// Where the handle goes by its own motion.
    fn ahead(&self) -> DVec3 {
        self.place * 2.0 - self.before
    }

    fn is_settled(&self) -> bool {
        self.presence == 1.0 && self.returned >= self.frames
    }
}

impl Fading {
    pub(super) fn new(handles: usize) -> Self {
        Self { handles: vec![Fade::default(); handles], frames: 0 }
    }

    /// Sets the presence of the handles, and the targets of those that fade. `pose`: the body after the frame before; `present`: the handles whose
    /// markers are there, where `targets` has their positions.
    pub(super) fn follow(&mut self, handles: &[Handle], pose: &[DVec3], present: &[bool], targets: &mut Targets) {
        for (fade, handle) in self.handles.iter_mut().zip(handles) {
            let place = handle.row.apply(pose);
            fade.before = if self.frames < 2 { place } else { fade.place };
            fade.place = place;
        }
        let cut = self.frames == 0 || self.is_cut(present, &targets.positions);
        self.frames = if cut { 1 } else { 2 };
        let each = self.handles.iter_mut().zip(present).zip(&mut targets.positions).zip(&mut targets.presence);
        for (((fade, &present), target), presence) in each {
            if cut {
                fade.presence = f64::from(u8::from(present));
                fade.returned = fade.frames;
            } else if present {
                if fade.presence < 1.0 {
                    fade.presence = 1.0;
                    fade.offset = fade.ahead() - *target;
                    fade.returned = 0;
                    fade.frames = FEWEST.max((STEEPEST * fade.offset.length() / STRIDE).ceil() as u32);
                }
                if fade.returned < fade.frames {
                    fade.returned += 1;
                    *target += fade.offset * (1.0 - smooth(f64::from(fade.returned) / f64::from(fade.frames)));
                }
            } else if fade.presence > 0.0 {
                fade.speed = if fade.presence == 1.0 { fade.place - fade.before } else { fade.speed * SLOWING };
                fade.presence *= RELEASE;
                fade.presence = if fade.presence < FAINTEST { 0.0 } else { fade.presence };
                *target = fade.place + fade.speed;
            }
            *presence = fade.presence;
        }
    }

    fn is_cut(&self, present: &[bool], positions: &[DVec3]) -> bool {
        let settled =
            self.handles.iter().zip(present).zip(positions).filter(|((fade, present), _)| **present && fade.is_settled());
        let (sum, count) =
            settled.fold((0.0, 0), |(sum, count), ((fade, _), target)| (sum + fade.ahead().distance(*target), count + 1));
        sum > CUT * f64::from(count)
    }
}

/// Largest slope of [`smooth`].
const STEEPEST: f64 = 1.5;

/// From 0 to 1 without a corner.
fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
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
        for k in 0..45 {
            let at = DVec3::X + DVec3::Y * (0.01 * f64::from(k));
            let mut targets = targets([DVec3::ZERO, at]);
            fading.follow(&handles(), &[DVec3::ZERO, at - DVec3::Y * 0.01], &[true, k < 5], &mut targets);
            presences.push(targets.presence[1]);
            let pulls = targets.presence[1] > 0.0;
            assert!(!pulls || k > 5 || targets.positions[1].distance(at) < 1e-12);
            assert!(!pulls || targets.positions[1].distance(at) < 0.0101);
        }
        assert!(presences[4] == 1.0 && presences[5] == RELEASE && presences[44] == 0.0);
        assert!(presences[5..].windows(2).all(|w| w[1] <= w[0]));
    }

    #[test]
    fn nothing_fades_over_a_cut() {
        let mut fading = Fading::new(2);
        let pose = [DVec3::ZERO, DVec3::X];
        for _ in 0..3 {
            fading.follow(&handles(), &pose, &[true, true], &mut targets(pose));
        }
        let mut far = targets(pose.map(|p| p + DVec3::Z));
        fading.follow(&handles(), &pose, &[true, false], &mut far);
        assert_eq!(far.presence, [1.0, 0.0]);
    }
}
