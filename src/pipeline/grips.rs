//! How handles that turn hold the proxy: by a part of the scan that is named, or by what surrounds them.

use crate::binding::driven::{Turning, TurningHandle};
use crate::binding::regions::Subject;
use crate::binding::select::{self, Hold};
use crate::deform::{Grip, OrientedHandle};
use crate::error::{Error, Kind, Notes, Result};
use crate::proxy::rows::Surroundings;
use crate::words;
use std::ops::Range;

/// Hardness of the four points by which a frame holds its surroundings: they stand for many vertices.
const FRAME: f64 = 100.0;
/// Hardness of each vertex of a part that is held softly.
const REGION: f64 = 100.0;

/// A handle that holds a part of the scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Holding {
    /// Which, and what.
    pub hold: Hold,
    /// Whether the part is exactly where the handle puts it, instead of being pulled there.
    pub exact: bool,
}

/// Brings turning handles onto the proxy, in their order.
///
/// # Errors
/// [`Kind::Usage`] when a part is given to a handle that is not there, or twice; as [`Subject::select`] for the parts; [`Kind::Refused`] when two
/// handles hold the same vertex exactly.
pub fn grips(subject: &Subject<'_>, handles: &[TurningHandle], holdings: &[Holding]) -> Result<Vec<OrientedHandle>> {
    for (i, Holding { hold, .. }) in holdings.iter().enumerate() {
        let known = || handles.iter().map(|h| h.name.as_str());
        if !known().any(|name| name == hold.handle) {
            let error = Error::new(Kind::Usage, format!("there is no handle {} to hold {}", hold.handle, hold.what));
            let error = match handles {
                [] => error.expected("a table of handles (--handles) with one of this name"),
                _ => error.expected(format!("one of {}", select::some_of(known().map(str::to_owned)))),
            };
            return Err(match select::nearest(&hold.handle, known()) {
                Some(near) => error.hint(format!("{near}={}", hold.what)),
                None => error,
            });
        }
        if let Some(other) = holdings[..i].iter().find(|other| other.hold.handle == hold.handle) {
            return Err(Error::new(Kind::Usage, format!("handle {} holds {} and {}", hold.handle, other.hold.what, hold.what))
                .expected("one part for each handle")
                .hint("a handle of its own for each part"));
        }
    }
    let surroundings = Surroundings::new(subject.proxy());
    let mut holders: Vec<Option<&str>> = vec![None; subject.proxy().rest.len()];
    let mut grips = Vec::with_capacity(handles.len());
    for TurningHandle { name, rest } in handles {
        let grip = match holdings.iter().find(|h| h.hold.handle == *name) {
            None => Grip::Frame { rows: surroundings.frame(*rest), beta: FRAME },
            Some(holding) => {
                let vertices = subject.vertices(&holding.hold.what)?;
                if holding.exact {
                    for &v in &vertices {
                        if let Some(other) = holders[v as usize].replace(name) {
                            return Err(Error::refused(format!(
                                "handles {other} and {name} hold the same vertices of the proxy exactly"
                            ))
                            .expected("parts that do not touch"));
                        }
                    }
                    Grip::Exact { vertices }
                } else {
                    Grip::Region { vertices, beta: REGION }
                }
            }
        };
        grips.push(OrientedHandle { name: name.clone(), rest: *rest, grip });
    }
    Ok(grips)
}

/// Warns of handles that hold a part exactly and are missing in some of the `frames`: what they hold cannot be let go.
pub fn missing(turning: &Turning, holdings: &[Holding], frames: Range<usize>) -> Notes {
    let mut notes = Notes::default();
    for (h, handle) in turning.handles.iter().enumerate() {
        let missing = frames.clone().filter(|&frame| turning.frame(frame)[h].is_none()).count();
        if missing > 0 && holdings.iter().any(|holding| holding.exact && holding.hold.handle == handle.name) {
            notes.warn(format!(
                "handle {} has no place in {}: what it holds exactly stays where it was there; --hold would let it go",
                handle.name,
                words::plural(missing, "frame")
            ));
        }
    }
    notes
}
