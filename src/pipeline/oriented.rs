//! Places of oriented handles in a frame, and how far the body stays from them.

use super::faded;
use crate::binding::driven::Place;
use crate::deform::{Grip, OrientedHandle, Placement};
use crate::linalg::{SparseRow, nearest_rotation};
use glam::{DMat3, DQuat, DVec3};

/// The oriented handles of a run from frame to frame; a frame allocates nothing.
pub(super) struct OrientedTargets {
    carried: Vec<Carried>,
    placements: Vec<Placement>,
}

/// The points that a handle carries.
struct Carried {
    rows: Vec<SparseRow>,
    /// From the handle to each of them, at rest.
    offsets: Vec<DVec3>,
}

impl OrientedTargets {
    /// `rest`: the proxy at rest.
    pub(super) fn new(handles: &[OrientedHandle], rest: &[DVec3]) -> Self {
        let carried = handles.iter().map(|handle| {
            let rows: Vec<SparseRow> = match &handle.grip {
                Grip::Frame { rows, .. } => rows.to_vec(),
                Grip::Region { vertices, .. } | Grip::Exact { vertices } => {
                    vertices.iter().map(|&v| SparseRow { indices: vec![v], values: vec![1.0] }).collect()
                }
            };
            let offsets = rows.iter().map(|row| row.apply(rest) - handle.rest).collect();
            Carried { rows, offsets }
        });
        let at_rest = |h: &OrientedHandle| Placement { position: h.rest, orientation: DQuat::IDENTITY, presence: 0.0 };
        Self { carried: carried.collect(), placements: handles.iter().map(at_rest).collect() }
    }

    /// The placements of a frame. `pose`: the proxy after the frame before; `cold`: there was none.
    ///
    /// A handle that returns comes back from where the body has taken it.
    pub(super) fn place(&mut self, places: &[Option<Place>], pose: &[DVec3], cold: bool) -> &[Placement] {
        for ((placement, place), carried) in self.placements.iter_mut().zip(places).zip(&self.carried) {
            placement.presence =
                if cold { f64::from(u8::from(place.is_some())) } else { faded(placement.presence, place.is_some()) };
            let Some(place) = place else { continue };
            (placement.position, placement.orientation) = (place.position, place.turn);
            if placement.presence < 1.0 {
                let (position, turn) = carried.place(pose);
                placement.position = position.lerp(place.position, placement.presence);
                placement.orientation = turn.slerp(place.turn, placement.presence);
            }
        }
        &self.placements
    }

    /// Mean distance of what each present handle carries from where it puts that, and its number. In the unit of `pose`.
    pub(super) fn distances<'a>(&'a self, pose: &'a [DVec3]) -> impl Iterator<Item = (usize, f64)> + 'a {
        let present = self.placements.iter().zip(&self.carried).enumerate().filter(|(_, (p, _))| p.presence > 0.0);
        present.map(|(h, (placement, carried))| {
            let off = |(row, offset): (&SparseRow, &DVec3)| {
                row.apply(pose).distance(placement.position + placement.orientation * *offset)
            };
            let sum: f64 = carried.rows.iter().zip(&carried.offsets).map(off).sum();
            (h, sum / carried.rows.len() as f64)
        })
    }
}

impl Carried {
    /// Where the body has taken the handle, and how far it has turned it: the rigid motion that brings the points nearest to where they are.
    fn place(&self, pose: &[DVec3]) -> (DVec3, DQuat) {
        let count = self.rows.len() as f64;
        let centre = self.rows.iter().map(|row| row.apply(pose)).sum::<DVec3>() / count;
        let rest = self.offsets.iter().sum::<DVec3>() / count;
        let mut covariance = DMat3::ZERO;
        for (row, offset) in self.rows.iter().zip(&self.offsets) {
            let (a, t) = (*offset - rest, row.apply(pose) - centre);
            covariance += DMat3::from_cols(t * a.x, t * a.y, t * a.z);
        }
        let turn = DQuat::from_mat3(&nearest_rotation(covariance, DMat3::IDENTITY)).normalize();
        (centre - turn * rest, turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn handle() -> (OrientedHandle, Vec<DVec3>) {
        let rest = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE];
        let grip = Grip::Region { vertices: vec![0, 1, 3, 4], beta: 1.0 };
        (OrientedHandle { name: "h".into(), rest: DVec3::new(0.2, 3.0, 0.0), grip }, rest)
    }

    #[test]
    fn a_handle_lets_go_at_once_and_comes_back_from_where_the_body_took_it() {
        let (handle, rest) = handle();
        let mut targets = OrientedTargets::new(std::slice::from_ref(&handle), &rest);
        let far = Place { position: DVec3::new(1.0, 2.0, 3.0), turn: DQuat::from_rotation_y(1.0) };
        let placed = targets.place(&[Some(far)], &rest, true)[0];
        assert!(placed.presence == 1.0 && placed.position == far.position, "{placed:?}");
        assert_eq!(targets.place(&[None], &rest, false)[0].presence, 0.0);
        assert_eq!(targets.distances(&rest).count(), 0);
        // Meanwhile the body has moved.
        let (turn, shift) = (DQuat::from_rotation_z(0.7), DVec3::new(0.0, -1.0, 0.5));
        let pose: Vec<DVec3> = rest.iter().map(|p| turn * *p + shift).collect();
        let carried = turn * handle.rest + shift;
        let back = targets.place(&[Some(far)], &pose, false)[0];
        assert!(back.presence > 0.0 && back.presence < 0.5, "{back:?}");
        assert!(back.position.distance(carried.lerp(far.position, back.presence)) < 1e-12, "{back:?}");
        assert!(back.orientation.angle_between(turn.slerp(far.turn, back.presence)) < 1e-6, "{back:?}");
        for _ in 0..5 {
            targets.place(&[Some(far)], &pose, false);
        }
        assert_eq!(targets.placements[0], placed);
    }

    #[test]
    fn distances_count_turns_too() {
        let (handle, rest) = handle();
        let mut targets = OrientedTargets::new(std::slice::from_ref(&handle), &rest);
        let turned = Place { position: handle.rest, turn: DQuat::from_rotation_z(0.5) };
        targets.place(&[Some(turned)], &rest, true);
        let found: Vec<(usize, f64)> = targets.distances(&rest).collect();
        let chord = |v: usize| 2.0 * (0.25_f64).sin() * (rest[v] - handle.rest).truncate().length();
        let expected = [0, 1, 3, 4].into_iter().map(chord).sum::<f64>() / 4.0;
        assert!(found.len() == 1 && (found[0].1 - expected).abs() < 1e-12, "{found:?} {expected}");
    }
}
