//! Places of oriented handles in a frame, and how far the body stays from them.

use super::fading::{Fade, Passage, SLOWING};
use crate::binding::driven::Place;
use crate::deform::{Grip, OrientedHandle, Placement};
use crate::linalg::{SparseRow, nearest_rotation};
use glam::{DMat3, DQuat, DVec3};

/// The oriented handles of a run from frame to frame; a frame allocates nothing.
pub(super) struct OrientedTargets {
    carried: Vec<Carried>,
    placements: Vec<Placement>,
}

/// The points that a handle carries, and how far it is on its way out or back.
struct Carried {
    rows: Vec<SparseRow>,
    /// From the handle to each of them, at rest.
    offsets: Vec<DVec3>,
    /// Whether they are where it puts them: such a handle cannot let go by and by.
    exact: bool,
    fade: Fade,
    /// From its place to where the body had it when it returned.
    offset: (DVec3, DQuat),
    /// Its way in a frame besides that of the body.
    own: DVec3,
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
            let exact = matches!(handle.grip, Grip::Exact { .. });
            Carried { rows, offsets, exact, fade: Fade::default(), offset: (DVec3::ZERO, DQuat::IDENTITY), own: DVec3::ZERO }
        });
        let at_rest = |h: &OrientedHandle| Placement { position: h.rest, orientation: DQuat::IDENTITY, presence: 0.0 };
        Self { carried: carried.collect(), placements: handles.iter().map(at_rest).collect() }
    }

    /// The placements of a frame. `pose`: the proxy after the frame before.
    ///
    /// A handle that returns comes back from where the body has taken it.
    pub(super) fn place(&mut self, places: &[Option<Place>], pose: &[DVec3], passage: Passage) -> &[Placement] {
        let along = if passage.cut { DVec3::ZERO } else { passage.drift.unwrap_or_else(|| self.drift(places)) };
        for ((placement, place), carried) in self.placements.iter_mut().zip(places).zip(&mut self.carried) {
            match place {
                Some(place) => {
                    if passage.cut {
                        carried.fade.cut(true);
                    } else if carried.fade.presence() < 1.0 {
                        carried.take_hold(place, pose);
                    }
                    let left = carried.fade.left();
                    let position = place.position + carried.offset.0 * left;
                    carried.own = if passage.cut { DVec3::ZERO } else { position - placement.position - along };
                    placement.position = position;
                    placement.orientation =
                        if left > 0.0 { DQuat::IDENTITY.slerp(carried.offset.1, left) * place.turn } else { place.turn };
                }
                None if passage.cut || carried.exact => carried.fade.cut(false),
                None if carried.fade.presence() > 0.0 => {
                    let vanishes = carried.fade.presence() == 1.0;
                    carried.fade.let_go(if vanishes { 0.0 } else { carried.slip(placement, pose) });
                    let (position, turn) = carried.place(pose);
                    placement.position = position + along + carried.own;
                    placement.orientation = turn;
                    carried.own *= SLOWING;
                }
                None => {}
            }
            placement.presence = carried.fade.presence();
        }
        &self.placements
    }

    /// Mean move of the settled handles to their places.
    fn drift(&self, places: &[Option<Place>]) -> DVec3 {
        let all = self.carried.iter().zip(&self.placements).zip(places);
        let settled = all.filter_map(|((c, placement), place)| {
            Some(place.as_ref().filter(|_| c.fade.is_settled())?.position - placement.position)
        });
        let (sum, count) = settled.fold((DVec3::ZERO, 0.0), |(sum, count), step| (sum + step, count + 1.0));
        if count > 0.0 { sum / count } else { DVec3::ZERO }
    }

    /// Where the body has each handle, and where that should be if it has a place. In the unit of `pose`.
    pub(super) fn places<'a>(&'a self, pose: &'a [DVec3]) -> impl Iterator<Item = (DVec3, Option<DVec3>)> + 'a {
        let handles = self.placements.iter().zip(&self.carried);
        handles.map(|(placement, carried)| (carried.place(pose).0, (placement.presence == 1.0).then_some(placement.position)))
    }

    /// Mean distance of what each handle with a place carries from where it puts that, and its number. In the unit of `pose`.
    pub(super) fn distances<'a>(&'a self, pose: &'a [DVec3]) -> impl Iterator<Item = (usize, f64)> + 'a {
        let present = self.placements.iter().zip(&self.carried).enumerate().filter(|(_, (p, _))| p.presence == 1.0);
        present.map(|(h, (placement, carried))| (h, carried.distances(placement, pose).sum::<f64>() / carried.rows.len() as f64))
    }
}

impl Carried {
    /// Distances of the points from where `placement` puts them.
    fn distances<'a>(&'a self, placement: &'a Placement, pose: &'a [DVec3]) -> impl Iterator<Item = f64> + 'a {
        let put = |offset: &DVec3| placement.position + placement.orientation * *offset;
        self.rows.iter().zip(&self.offsets).map(move |(row, offset)| row.apply(pose).distance(put(offset)))
    }

    /// The largest of them.
    fn slip(&self, placement: &Placement, pose: &[DVec3]) -> f64 {
        self.distances(placement, pose).fold(0.0, f64::max)
    }

    fn take_hold(&mut self, place: &Place, pose: &[DVec3]) {
        let (position, turn) = self.place(pose);
        self.offset = (position - place.position, turn * place.turn.inverse());
        let there = Placement { position: place.position, orientation: place.turn, presence: 1.0 };
        self.fade.take_hold(self.slip(&there, pose));
    }

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
    use super::super::fading::STRIDE;
    use super::*;

    fn handle() -> (OrientedHandle, Vec<DVec3>) {
        let rest = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE];
        let grip = Grip::Region { vertices: vec![0, 1, 3, 4], beta: 1.0 };
        (OrientedHandle { name: "h".into(), rest: DVec3::new(0.2, 3.0, 0.0), grip }, rest)
    }

    const CUT: Passage = Passage { cut: true, drift: None };
    const ON: Passage = Passage { cut: false, drift: None };

    #[test]
    fn a_handle_lets_go_by_and_by_and_comes_back_from_where_the_body_took_it() {
        let (handle, rest) = handle();
        let mut targets = OrientedTargets::new(std::slice::from_ref(&handle), &rest);
        let far = Place { position: DVec3::new(1.0, 2.0, 3.0), turn: DQuat::from_rotation_y(1.0) };
        let placed = targets.place(&[Some(far)], &rest, CUT)[0];
        assert!(placed.presence == 1.0 && placed.position == far.position, "{placed:?}");
        // The body is elsewhere: what the handle holds slips away from it.
        let (turn, shift) = (DQuat::from_rotation_z(0.7), DVec3::new(0.0, -1.0, 0.5));
        let pose: Vec<DVec3> = rest.iter().map(|p| turn * *p + shift).collect();
        let carried = turn * handle.rest + shift;
        let along = DVec3::X * 0.01;
        let (mut presence, mut pulls) = (1.0, 0);
        for frame in 0..200 {
            let gone = targets.place(&[None], &pose, Passage { drift: Some(along), ..ON })[0];
            assert!(gone.presence < presence || presence == 0.0, "{frame}: {gone:?}");
            presence = gone.presence;
            if presence > 0.0 {
                pulls += 1;
                assert!(gone.position.distance(carried + along) < 1e-12, "{frame}: {gone:?}");
                assert!(gone.orientation.angle_between(turn) < 1e-6, "{frame}: {gone:?}");
            }
        }
        assert!(presence == 0.0 && pulls > 100, "{pulls}");
        assert_eq!(targets.distances(&pose).count(), 0);
        let points = |p: &Placement| [0, 1, 3, 4].map(|v| p.position + p.orientation * (rest[v] - handle.rest));
        let mut last = [0, 1, 3, 4].map(|v| pose[v]);
        let mut frames = 0;
        while targets.placements[0] != placed {
            let back = targets.place(&[Some(far)], &pose, ON)[0];
            let now = points(&back);
            let step = now.iter().zip(last).map(|(a, b)| a.distance(b)).sum::<f64>() / 4.0;
            assert!(back.presence == 1.0 && step < 1.2 * STRIDE, "{frames}: {step}");
            (last, frames) = (now, frames + 1);
            assert!(frames < 2_000);
        }
        assert!(frames > 300, "{frames}");
    }

    #[test]
    fn what_is_held_exactly_is_let_go_at_once() {
        let (handle, rest) = handle();
        let handle = OrientedHandle { grip: Grip::Exact { vertices: vec![0, 1, 3, 4] }, ..handle };
        let mut targets = OrientedTargets::new(std::slice::from_ref(&handle), &rest);
        let place = Place { position: handle.rest, turn: DQuat::IDENTITY };
        targets.place(&[Some(place)], &rest, CUT);
        assert_eq!(targets.place(&[None], &rest, ON)[0].presence, 0.0);
    }

    #[test]
    fn distances_count_turns_too() {
        let (handle, rest) = handle();
        let mut targets = OrientedTargets::new(std::slice::from_ref(&handle), &rest);
        let turned = Place { position: handle.rest, turn: DQuat::from_rotation_z(0.5) };
        targets.place(&[Some(turned)], &rest, CUT);
        let found: Vec<(usize, f64)> = targets.distances(&rest).collect();
        let chord = |v: usize| 2.0 * (0.25_f64).sin() * (rest[v] - handle.rest).truncate().length();
        let expected = [0, 1, 3, 4].into_iter().map(chord).sum::<f64>() / 4.0;
        assert!(found.len() == 1 && (found[0].1 - expected).abs() < 1e-12, "{found:?} {expected}");
    }
}
