//! Scans that have grown together with the floor, or with themselves: what is left out of them, and what is cut.

use super::args::{Animate, Map};
use crate::binding::grown::{self, Cuts};
use crate::binding::landmarks::{Body, Floor};
use crate::error::Notes;
use crate::scan::{Scan, UnitBox};
use crate::words;
use glam::DVec3;

/// A scan that was cut.
pub(super) struct Recut {
    pub(super) scan: Scan,
    /// How far each vertex moves for its parts to be apart, in the unit box.
    pub(super) shift: Option<Vec<DVec3>>,
}

/// The scan without its floor and with its limbs apart; `None` where it stays as it is. `points`: its vertices in the unit box.
pub(super) fn recut(
    args: &Animate,
    scan: &Scan,
    unit_box: UnitBox,
    points: &[DVec3],
    body: &Body,
    notes: &mut Notes,
) -> Option<Recut> {
    let without = body.floor.map(|floor| without_floor(scan, unit_box, &floor, notes));
    // A proxy of the user's own is made for the scan as it is, shells are not cut, and the paper's map knows nothing of parts that are held apart.
    let own = args.proxy.is_some() || args.map == Map::Paper || args.shells.are_chosen().unwrap_or(true);
    let standing = without.as_ref().unwrap_or(scan);
    let cuts = if own { None } else { grown::cut(body, points, &standing.mesh.faces) };
    match cuts {
        Some(cuts) => {
            let scan = along(standing, &cuts, notes);
            Some(Recut { scan, shift: Some(cuts.shift) })
        }
        None => without.map(|scan| Recut { scan, shift: None }),
    }
}

pub(super) fn moved(points: &[DVec3], shift: &[DVec3]) -> Vec<DVec3> {
    points.iter().zip(shift).map(|(p, shift)| *p + *shift).collect()
}

/// The scan without the floor that has grown together with the feet: it would move and tear with them.
fn without_floor(scan: &Scan, unit_box: UnitBox, floor: &Floor, notes: &mut Notes) -> Scan {
    let without =
        scan.with_faces(|corners| !floor.holds(unit_box.enter(corners.iter().sum::<DVec3>() / corners.len().max(1) as f64)));
    notes.warn(format!(
        "the feet have grown together with a flat floor: its {} are left out, and what is written has no floor",
        words::plural(scan.mesh.faces.len() - without.mesh.faces.len(), "face")
    ));
    without
}

/// The scan cut along its seams.
fn along(scan: &Scan, cuts: &Cuts, notes: &mut Notes) -> Scan {
    let kept: Vec<usize> = (0..cuts.keep.len()).filter(|&f| cuts.keep[f]).collect();
    let cut = cuts.keep.len() - kept.len();
    notes.warn(format!(
        "{} grown together with what is beside: cut apart where the joints tell, {} left out and {} in the cuts",
        match &cuts.limbs[..] {
            [one] if *one != "legs" => format!("the {one} has"),
            all => format!("{} have", all.join(", ")),
        },
        words::plural(cut, "face"),
        words::plural(cuts.added.len(), "new triangle")
    ));
    scan.recut(&kept, &cuts.added)
}
