//! What an animation does to the nodes, at any time.

use crate::error::{Error, Result};
use crate::gltf::{Animation, Gltf, Interpolation, Turn};
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;
use std::rc::Rc;

/// Values over time of one property of a node.
struct Curve<const N: usize> {
    times: Rc<Vec<f64>>,
    /// One per time; for cubic splines three: in-tangent, value, out-tangent.
    values: Rc<Vec<[f64; N]>>,
    interpolation: Interpolation,
}

/// The curves of a node.
#[derive(Default)]
struct Node {
    translation: Option<Curve<3>>,
    rotation: Option<Curve<4>>,
    scale: Option<Curve<3>>,
}

/// The curves of an animation, by node.
#[derive(Default)]
pub(super) struct Curves {
    nodes: BTreeMap<u32, Node>,
}

/// Accessors that were read: many channels share their times, and a file may name one accessor, or the same bytes in many, as often as it
/// likes.
pub(super) struct Accessors<'a> {
    gltf: &'a Gltf,
    /// Numbers that may still be read.
    left: usize,
    times: BTreeMap<u32, Rc<Vec<f64>>>,
    vectors: BTreeMap<u32, Rc<Vec<[f64; 3]>>>,
    turns: BTreeMap<u32, Rc<Vec<[f64; 4]>>>,
}

impl<'a> Accessors<'a> {
    pub(super) fn new(gltf: &'a Gltf) -> Self {
        // A number takes at least one byte.
        let left = gltf.bytes().saturating_add(1 << 20);
        Self { gltf, left, times: BTreeMap::new(), vectors: BTreeMap::new(), turns: BTreeMap::new() }
    }

    /// Rows of an accessor that was not read yet.
    pub(super) fn rows<const N: usize>(&mut self, accessor: u32) -> Result<Vec<[f64; N]>> {
        let count = usize::try_from(self.gltf.accessor(accessor)?.count).unwrap_or(usize::MAX).saturating_mul(N);
        self.left = self.left.checked_sub(count).ok_or_else(|| {
            Error::refused(format!("accessor {accessor} and those before it hold more numbers than the file has bytes"))
                .expected("accessors that do not share their bytes")
        })?;
        self.gltf.floats::<N>(accessor)
    }

    /// Times of keys: they rise.
    pub(super) fn times(&mut self, accessor: u32) -> Result<Rc<Vec<f64>>> {
        if let Some(times) = self.times.get(&accessor) {
            return Ok(times.clone());
        }
        let times: Vec<f64> = self.rows::<1>(accessor)?.into_iter().map(|[t]| t).collect();
        if times.is_empty() || times.iter().any(|t| !t.is_finite()) || !times.is_sorted() {
            return Err(Error::malformed(format!("the times in accessor {accessor} do not rise")));
        }
        Ok(self.times.entry(accessor).or_insert(Rc::new(times)).clone())
    }

    fn vectors(&mut self, accessor: u32) -> Result<Rc<Vec<[f64; 3]>>> {
        if let Some(rows) = self.vectors.get(&accessor) {
            return Ok(rows.clone());
        }
        let rows = Rc::new(self.rows(accessor)?);
        Ok(self.vectors.entry(accessor).or_insert(rows).clone())
    }

    fn turns(&mut self, accessor: u32) -> Result<Rc<Vec<[f64; 4]>>> {
        if let Some(rows) = self.turns.get(&accessor) {
            return Ok(rows.clone());
        }
        let rows = Rc::new(self.rows(accessor)?);
        Ok(self.turns.entry(accessor).or_insert(rows).clone())
    }
}

impl Curves {
    /// Reads the channels of an animation that move one of the `wanted` nodes.
    ///
    /// # Errors
    /// Samplers, accessors or nodes that do not exist, times that do not rise, fewer values than times.
    pub(super) fn read(read: &mut Accessors<'_>, animation: &Animation, wanted: &dyn Fn(u32) -> bool) -> Result<Self> {
        let mut curves = Self::default();
        for (n, channel) in animation.channels.iter().enumerate() {
            let Some(node) = channel.target.node else { continue };
            let place = |e: Error| if e.place.is_none() { e.at(format!("channel {n}")) } else { e };
            Gltf::get(&read.gltf.document.nodes, node, "node").map_err(place)?;
            if !wanted(node) {
                continue;
            }
            let sampler = Gltf::get(&animation.samplers, channel.sampler, "sampler").map_err(place)?;
            let times = read.times(sampler.input).map_err(place)?;
            let of_node = curves.nodes.entry(node).or_default();
            let (output, how) = (sampler.output, sampler.interpolation);
            match &*channel.target.path {
                "translation" => {
                    let values = read.vectors(output).map_err(place)?;
                    of_node.translation = Some(Curve::new(times, values, how).map_err(place)?);
                }
                "rotation" => {
                    let values = read.turns(output).map_err(place)?;
                    of_node.rotation = Some(Curve::new(times, values, how).map_err(place)?);
                }
                "scale" => {
                    let values = read.vectors(output).map_err(place)?;
                    of_node.scale = Some(Curve::new(times, values, how).map_err(place)?);
                }
                _ => {}
            }
        }
        Ok(curves)
    }

    /// Times of all keys, each set of times once.
    pub(super) fn keys(&self) -> Vec<f64> {
        let mut sets: BTreeMap<*const Vec<f64>, &Vec<f64>> = BTreeMap::new();
        for node in self.nodes.values() {
            let of_node = [
                node.translation.as_ref().map(|c| &c.times),
                node.rotation.as_ref().map(|c| &c.times),
                node.scale.as_ref().map(|c| &c.times),
            ];
            of_node.into_iter().flatten().for_each(|times| _ = sets.insert(Rc::as_ptr(times), times));
        }
        sets.into_values().flatten().copied().collect()
    }

    /// Whether a node moves under its parent.
    pub(super) fn moves(&self, node: u32) -> bool {
        self.nodes.contains_key(&node)
    }

    /// The placement of a node under its parent at a time; `rest` is what it has without the animation.
    pub(super) fn turn(&self, node: u32, time: f64, rest: Turn) -> Turn {
        let Some(curves) = self.nodes.get(&node) else { return rest };
        let vector = |curve: &Option<Curve<3>>, rest: DVec3| curve.as_ref().map_or(rest, |c| c.at(time, lerp).into());
        Turn {
            translation: vector(&curves.translation, rest.translation),
            rotation: curves.rotation.as_ref().map_or(rest.rotation, |c| unit(DQuat::from_array(c.at(time, slerp)))),
            scale: vector(&curves.scale, rest.scale),
        }
    }
}

impl<const N: usize> Curve<N> {
    fn new(times: Rc<Vec<f64>>, values: Rc<Vec<[f64; N]>>, interpolation: Interpolation) -> Result<Self> {
        let wanted = if interpolation == Interpolation::CubicSpline { 3 * times.len() } else { times.len() };
        if values.len() < wanted {
            return Err(Error::malformed(format!("{} values for {} times", values.len(), times.len()))
                .expected(format!("{wanted} values")));
        }
        Ok(Self { times, values, interpolation })
    }

    /// The value at a time; before the first and after the last time it stays.
    fn at(&self, time: f64, between: fn([f64; N], [f64; N], f64) -> [f64; N]) -> [f64; N] {
        let spline = self.interpolation == Interpolation::CubicSpline;
        let value = |k: usize| self.values[if spline { 3 * k + 1 } else { k }];
        let next = self.times.partition_point(|&t| t <= time);
        if next == 0 || next == self.times.len() {
            return value(next.saturating_sub(1));
        }
        let (k, span) = (next - 1, self.times[next] - self.times[next - 1]);
        let t = (time - self.times[k]) / span;
        if t == 0.0 {
            return value(k);
        }
        match self.interpolation {
            Interpolation::Step => value(k),
            Interpolation::Linear => between(value(k), value(next), t),
            Interpolation::CubicSpline => {
                let (out, into) = (self.values[3 * k + 2], self.values[3 * next]);
                let (t2, t3) = (t * t, t * t * t);
                let weights = [2.0 * t3 - 3.0 * t2 + 1.0, span * (t3 - 2.0 * t2 + t), 3.0 * t2 - 2.0 * t3, span * (t3 - t2)];
                std::array::from_fn(|c| {
                    weights[0] * value(k)[c] + weights[1] * out[c] + weights[2] * value(next)[c] + weights[3] * into[c]
                })
            }
        }
    }
}

fn lerp(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    DVec3::from(a).lerp(b.into(), t).to_array()
}

fn slerp(a: [f64; 4], b: [f64; 4], t: f64) -> [f64; 4] {
    unit(DQuat::from_array(a)).slerp(unit(DQuat::from_array(b)), t).to_array()
}

/// Of length 1; no turn for what has no length.
fn unit(q: DQuat) -> DQuat {
    let unit = q.normalize();
    if unit.is_finite() { unit } else { DQuat::IDENTITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve<const N: usize>(interpolation: Interpolation, values: &[[f64; N]]) -> Curve<N> {
        let times =
            [1.0, 3.0, 4.0][..if interpolation == Interpolation::CubicSpline { values.len() / 3 } else { values.len() }].to_vec();
        Curve { times: Rc::new(times), values: Rc::new(values.to_vec()), interpolation }
    }

    #[test]
    fn between_keys_curves_go_as_they_say() {
        let points = [[0.0, 0.0, 0.0], [4.0, 2.0, 0.0], [0.0, 0.0, 8.0]];
        let line = curve(Interpolation::Linear, &points);
        let step = curve(Interpolation::Step, &points);
        for (time, on_line, on_steps) in [
            (0.0, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
            (1.5, [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]),
            (3.0, [4.0, 2.0, 0.0], [4.0, 2.0, 0.0]),
            (3.75, [1.0, 0.5, 6.0], [4.0, 2.0, 0.0]),
            (9.0, [0.0, 0.0, 8.0], [0.0, 0.0, 8.0]),
        ] {
            assert_eq!((line.at(time, lerp), step.at(time, lerp)), (on_line, on_steps), "at {time}");
        }
        // A cubic is its own Hermite spline: x(t) = t³ − t has the slope 3t² − 1.
        let keys: Vec<[f64; 3]> =
            [1.0f64, 3.0].iter().flat_map(|t| [[3.0 * t * t - 1.0; 3], [t * t * t - t; 3], [3.0 * t * t - 1.0; 3]]).collect();
        let spline = curve(Interpolation::CubicSpline, &keys);
        for time in [1.0, 1.2, 2.0, 2.9, 3.0f64] {
            assert!((spline.at(time, lerp)[1] - (time.powi(3) - time)).abs() < 1e-12, "at {time}");
        }
    }

    #[test]
    fn turns_go_the_shorter_way_at_an_even_pace() {
        let [a, b] = [0.2f64, 1.4].map(DQuat::from_rotation_x);
        let turns = curve(Interpolation::Linear, &[a.to_array(), (-b).to_array()]);
        let found = DQuat::from_array(turns.at(1.5, slerp));
        assert!((found.dot(DQuat::from_rotation_x(0.5)).abs() - 1.0).abs() < 1e-12, "{found}");
    }
}
