//! Hinges that have turned inside out, and vertices that are put back to where their neighbours have them.
//!
//! Nothing in the energy forbids that a vertex goes through the skin: an angle that passes half a turn comes back with the other sign, and the pose is
//! in another valley, where the weights of the examples are others too. From frame to frame such folds come and go, and with them the weights leap.

use super::body::Body;
use super::newton::{Goals, Minimum, Newton, Settings};
use super::starts::Rigid;
use glam::DVec3;

/// Frames without another attempt after a vain one.
const WAIT: u32 = 8;
/// Most attempts where the targets do not move.
const ATTEMPTS: u32 = 8;
/// Most steps of an attempt, where a frame has not more.
const STEPS: u32 = 12;
/// Fewest neighbours that say where a vertex belongs.
const FEWEST: usize = 6;
/// Most rings around a vertex in which they are looked for.
const RINGS: usize = 5;

/// A frame that is solved: its pose, and what is asked of it.
pub(super) struct Frame<'a> {
    pub(super) newton: &'a mut Newton,
    pub(super) x: &'a mut [DVec3],
    pub(super) weights: &'a mut [f64],
    pub(super) goals: &'a Goals<'a>,
    pub(super) settings: &'a Settings,
}

/// Finds poses without folds, in memory of its own.
#[derive(Clone, Debug)]
pub(super) struct Unfold {
    /// Neighbours of each vertex, one after the other, and where those of each begin.
    neighbours: Vec<u32>,
    starts: Vec<u32>,
    /// Vertices at folds.
    folded: Vec<u32>,
    is_folded: Vec<bool>,
    held: Vec<bool>,
    /// Vertices around one, and for each vertex the last search that has seen it.
    around: Vec<u32>,
    seen: Vec<u64>,
    search: u64,
    /// Where those that are not folded are at rest and in the pose.
    from: Vec<DVec3>,
    to: Vec<DVec3>,
    even: Vec<f64>,
    x: Vec<DVec3>,
    weights: Vec<f64>,
    /// Frames that are still to wait, while there are no more folds than were `known`.
    waiting: u32,
    known: usize,
    /// Whether the body was held still in the frame before: then what could be done has been.
    was_still: bool,
}

impl Unfold {
    /// `held`: vertices that do not move by themselves.
    pub fn new(body: &Body, held: Vec<bool>) -> Self {
        let n = body.vertices();
        let mut pairs: Vec<(u32, u32)> =
            body.proxy.boundary.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0_u32; n + 1];
        pairs.iter().for_each(|(a, _)| starts[*a as usize + 1] += 1);
        (0..n).for_each(|v| starts[v + 1] += starts[v]);
        Self {
            neighbours: pairs.into_iter().map(|(_, b)| b).collect(),
            starts,
            // As they come, four of each hinge.
            folded: Vec::with_capacity(4 * body.proxy.boundary.len() * 3 / 2),
            is_folded: vec![false; n],
            held,
            around: Vec::with_capacity(n),
            seen: vec![0; n],
            search: 0,
            from: Vec::with_capacity(n),
            to: Vec::with_capacity(n),
            even: vec![1.0; n],
            x: vec![DVec3::ZERO; n],
            weights: vec![0.0; body.examples.len()],
            waiting: 0,
            known: 0,
            was_still: false,
        }
    }

    /// The next fold is a new one.
    pub fn forget(&mut self) {
        self.waiting = 0;
    }

    /// Looks for poses of less energy without the folds of this one, and leaves the last in `x` and `weights`. `still`: whether the targets do not
    /// move. Then all is done in one frame, and nothing in those after it.
    pub fn turn_back(&mut self, frame: &mut Frame<'_>, found: Minimum, still: bool) -> Minimum {
        let is_done = std::mem::replace(&mut self.was_still, still) && still;
        if is_done {
            return found;
        }
        if still {
            self.waiting = 0;
        }
        let mut found = found;
        for _ in 0..if still { ATTEMPTS } else { 1 } {
            let again = self.turn_once(frame, found);
            let is_better = again.energy() < found.energy();
            found = again;
            if !is_better {
                break;
            }
        }
        found
    }

    fn turn_once(&mut self, frame: &mut Frame<'_>, found: Minimum) -> Minimum {
        let Frame { newton, x, weights, goals, settings } = frame;
        self.folded.clear();
        self.folded.extend(newton.inside_out(x, weights).flatten());
        let count = self.folded.len() / 4;
        self.folded.sort_unstable();
        self.folded.dedup();
        self.waiting = self.waiting.saturating_sub(1);
        if count == 0 || self.waiting > 0 && count <= self.known {
            return found;
        }
        // Nothing keeps them as they are.
        newton.release();
        let before = newton.total(x, weights, goals, settings);
        self.x.copy_from_slice(x);
        self.weights.copy_from_slice(weights);
        self.put_back(&newton.shell.rest);
        let settings = Settings { steps: settings.steps.max(STEPS), ..**settings };
        let again = newton.minimize(&mut self.x, &mut self.weights, goals, &settings);
        let steps = found.steps + again.steps;
        if again.energy() < before {
            x.copy_from_slice(&self.x);
            weights.copy_from_slice(&self.weights);
            return Minimum { steps, ..again };
        }
        self.waiting = WAIT;
        self.known = count;
        Minimum { steps, ..found }
    }

    /// Moves the folded vertices to where the rest shape, moved rigidly onto what lies around them, has them.
    fn put_back(&mut self, rest: &[DVec3]) {
        self.folded.iter().for_each(|v| self.is_folded[*v as usize] = true);
        for k in 0..self.folded.len() {
            let v = self.folded[k];
            if self.held[v as usize] {
                continue;
            }
            self.gather(v);
            self.from.clear();
            self.to.clear();
            for &w in self.around.iter().filter(|w| !self.is_folded[**w as usize]) {
                self.from.push(rest[w as usize]);
                self.to.push(self.x[w as usize]);
            }
            if self.from.len() >= 3 {
                let goals = Goals { positions: &self.to, weights: &self.even[..self.to.len()] };
                self.x[v as usize] = Rigid::fit(&self.from, &goals).apply(rest[v as usize]);
            }
        }
        self.folded.iter().for_each(|v| self.is_folded[*v as usize] = false);
    }

    /// Rings around a vertex until enough of them are not folded.
    fn gather(&mut self, v: u32) {
        self.search += 1;
        self.around.clear();
        self.around.push(v);
        self.seen[v as usize] = self.search;
        let mut begin = 0;
        for ring in 0..RINGS {
            let end = self.around.len();
            for k in begin..end {
                let w = self.around[k] as usize;
                for &u in &self.neighbours[self.starts[w] as usize..self.starts[w + 1] as usize] {
                    if self.seen[u as usize] != self.search {
                        self.seen[u as usize] = self.search;
                        self.around.push(u);
                    }
                }
            }
            begin = end;
            let steady = self.around.iter().filter(|w| !self.is_folded[**w as usize]).count();
            if ring > 0 && steady >= FEWEST {
                break;
            }
        }
    }
}
