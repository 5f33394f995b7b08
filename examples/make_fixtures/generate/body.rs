//! A human-like body: rounded cones and ellipsoids blended into one implicit surface, polygonized by surface nets.

use glam::DVec3;
use std::collections::BTreeMap;

/// Metres; Y up, facing +Z, the left hand at +X. Arms 45 degrees below the horizontal.
pub struct Body {
    /// Vertices of the skin.
    pub points: Vec<DVec3>,
    /// Quads, counter-clockwise from outside.
    pub quads: Vec<[u32; 4]>,
    /// The bone nearest to each quad.
    pub quad_bones: Vec<usize>,
    /// Up to four bones and weights per vertex.
    pub weights: Vec<[(usize, f64); 4]>,
}

impl Body {
    /// Given vertices of a skin, without its quads, with their weights.
    pub fn on(bones: &[Bone], points: Vec<DVec3>) -> Self {
        let weights = points.iter().map(|&p| blend(bones, p)).collect();
        Self { points, quads: Vec::new(), quad_bones: Vec::new(), weights }
    }
}

/// A segment of the skeleton, from its joint to its end, with the joint that it hangs on.
pub struct Bone {
    pub parent: usize,
    pub from: DVec3,
    pub to: DVec3,
    pub radii: [f64; 2],
}

pub const PELVIS: usize = 0;
pub const CHEST: usize = 1;
pub const HEAD: usize = 2;
/// First bone of an arm: upper arm, forearm, hand follow. Left, right.
pub const ARM: [usize; 2] = [3, 6];
/// First bone of a leg: thigh, shank, foot follow. Left, right.
pub const LEG: [usize; 2] = [9, 12];

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// The skeleton at rest.
pub fn bones() -> Vec<Bone> {
    let mut bones = vec![
        Bone { parent: PELVIS, from: v(0.0, 0.95, 0.0), to: v(0.0, 1.12, 0.0), radii: [0.14, 0.12] },
        Bone { parent: PELVIS, from: v(0.0, 1.12, 0.0), to: v(0.0, 1.46, -0.01), radii: [0.13, 0.10] },
        Bone { parent: CHEST, from: v(0.0, 1.49, -0.005), to: v(0.0, 1.68, 0.02), radii: [0.055, 0.09] },
    ];
    for side in [1.0, -1.0] {
        let arm = v(side * 0.70, -0.70, 0.13).normalize();
        let shoulder = v(side * 0.175, 1.405, -0.015);
        let elbow = shoulder + arm * 0.30;
        let wrist = elbow + v(side * 0.70, -0.68, 0.22).normalize() * 0.26;
        let tip = wrist + v(side * 0.70, -0.70, 0.14).normalize() * 0.10;
        let first = bones.len();
        bones.push(Bone { parent: CHEST, from: shoulder, to: elbow, radii: [0.052, 0.040] });
        bones.push(Bone { parent: first, from: elbow, to: wrist, radii: [0.040, 0.027] });
        bones.push(Bone { parent: first + 1, from: wrist, to: tip, radii: [0.028, 0.030] });
    }
    for side in [1.0, -1.0] {
        let hip = v(side * 0.095, 0.90, 0.0);
        let knee = v(side * 0.13, 0.49, 0.012);
        let ankle = v(side * 0.155, 0.085, -0.025);
        let first = bones.len();
        bones.push(Bone { parent: PELVIS, from: hip, to: knee, radii: [0.085, 0.054] });
        bones.push(Bone { parent: first, from: knee, to: ankle, radii: [0.050, 0.036] });
        bones.push(Bone { parent: first + 1, from: ankle, to: v(side * 0.175, 0.03, 0.15), radii: [0.034, 0.026] });
    }
    bones
}

/// What the implicit surface is made of: shape, and how softly it joins the rest.
enum Shape {
    Cone { a: DVec3, b: DVec3, ra: f64, rb: f64 },
    Ellipsoid { centre: DVec3, radii: DVec3 },
}

impl Shape {
    fn distance(&self, p: DVec3) -> f64 {
        match self {
            Shape::Cone { a, b, ra, rb } => {
                let axis = *b - *a;
                let t = ((p - *a).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
                p.distance(*a + axis * t) - (ra + (rb - ra) * t)
            }
            Shape::Ellipsoid { centre, radii } => {
                let q = (p - *centre) / *radii;
                let (k0, k1) = (q.length(), (q / *radii).length());
                if k1 == 0.0 { -radii.min_element() } else { k0 * (k0 - 1.0) / k1 }
            }
        }
    }
}

/// The shapes with the width of their blend.
fn shapes(bones: &[Bone]) -> Vec<(Shape, f64)> {
    let ellipsoid = |centre, radii| Shape::Ellipsoid { centre, radii };
    let mut shapes = vec![
        (ellipsoid(v(0.0, 0.965, -0.005), v(0.165, 0.125, 0.112)), 0.03),
        (ellipsoid(v(0.0, 1.13, 0.005), v(0.135, 0.16, 0.098)), 0.03),
        (ellipsoid(v(0.0, 1.30, 0.0), v(0.160, 0.185, 0.112)), 0.03),
        (Shape::Cone { a: v(0.13, 1.415, -0.015), b: v(-0.13, 1.415, -0.015), ra: 0.060, rb: 0.060 }, 0.03),
        (Shape::Cone { a: v(0.0, 1.44, -0.015), b: v(0.0, 1.56, 0.005), ra: 0.056, rb: 0.052 }, 0.02),
        (ellipsoid(v(0.0, 1.645, 0.015), v(0.076, 0.112, 0.096)), 0.015),
        (ellipsoid(v(0.0, 1.575, 0.045), v(0.052, 0.048, 0.055)), 0.02),
        (Shape::Cone { a: v(0.0, 1.65, 0.10), b: v(0.0, 1.615, 0.118), ra: 0.010, rb: 0.013 }, 0.01),
    ];
    for (k, side) in [1.0, -1.0].into_iter().enumerate() {
        let cone = |bone: &Bone| Shape::Cone { a: bone.from, b: bone.to, ra: bone.radii[0], rb: bone.radii[1] };
        let [upper, fore, hand] = [&bones[ARM[k]], &bones[ARM[k] + 1], &bones[ARM[k] + 2]];
        let [thigh, shank, foot] = [&bones[LEG[k]], &bones[LEG[k] + 1], &bones[LEG[k] + 2]];
        shapes.push((cone(upper), 0.025));
        shapes.push((cone(fore), 0.012));
        let bulge = fore.from.lerp(fore.to, 0.25);
        shapes.push((ellipsoid(bulge, v(0.046, 0.050, 0.042)), 0.02));
        shapes.push((cone(thigh), 0.025));
        shapes.push((cone(shank), 0.012));
        let calf = shank.from.lerp(shank.to, 0.28) + v(0.0, 0.0, -0.018);
        shapes.push((ellipsoid(calf, v(0.048, 0.10, 0.050)), 0.025));
        let heel = foot.from + v(0.0, -0.045, -0.035);
        let ball = foot.to + v(0.0, 0.002, -0.04);
        shapes.push((Shape::Cone { a: heel, b: ball, ra: 0.037, rb: 0.034 }, 0.015));
        shapes.push((Shape::Cone { a: foot.from, b: ball, ra: 0.034, rb: 0.034 }, 0.015));
        shapes.push((
            Shape::Cone {
                a: ball + v(-side * 0.018, -0.003, 0.0),
                b: foot.to + v(-side * 0.022, -0.006, 0.035),
                ra: 0.028,
                rb: 0.022,
            },
            0.012,
        ));
        shapes.push((
            Shape::Cone {
                a: ball + v(side * 0.022, -0.004, -0.01),
                b: foot.to + v(side * 0.024, -0.009, 0.0),
                ra: 0.026,
                rb: 0.020,
            },
            0.012,
        ));
        // The palm lies in the plane of the arm and the facing direction; fingers fan out in it.
        let along = (hand.to - hand.from).normalize();
        let across = (v(0.0, 0.0, 1.0) - along * along.z).normalize();
        let knuckles = hand.from + along * 0.085;
        for finger in [-1.5, -0.5, 0.5, 1.5] {
            let root = knuckles + across * (finger * 0.023);
            shapes.push((Shape::Cone { a: hand.from + across * (finger * 0.010), b: root, ra: 0.017, rb: 0.0125 }, 0.008));
            let direction = (along + across * (finger * 0.16)).normalize();
            let length = if finger.abs() < 1.0 { 0.085 } else { 0.068 };
            shapes.push((Shape::Cone { a: root, b: root + direction * length, ra: 0.0115, rb: 0.0095 }, 0.004));
        }
        let thumb = hand.from + along * 0.028 + across * 0.018;
        shapes.push((
            Shape::Cone { a: thumb, b: thumb + (along * 0.7 + across * 0.8).normalize() * 0.075, ra: 0.0145, rb: 0.0105 },
            0.006,
        ));
    }
    shapes
}

/// Blended distance: the narrower of two blends joins them.
fn field(shapes: &[(Shape, f64)], p: DVec3) -> f64 {
    let mut d = f64::INFINITY;
    let mut width = 0.03;
    for (shape, k) in shapes {
        let e = shape.distance(p);
        let k = k.min(width);
        let h = ((k - (d - e).abs()) / k).max(0.0);
        width = if e < d { k } else { width };
        d = d.min(e) - if d.is_finite() { h * h * k * 0.25 } else { 0.0 };
    }
    d
}

/// Polygonizes the body with cells of the given size.
pub fn build(cell: f64) -> Body {
    let bones = bones();
    let shapes = shapes(&bones);
    let lo = v(-0.95, -0.04, -0.22);
    let n = [(1.90 / cell) as usize + 2, (1.86 / cell) as usize + 2, (0.62 / cell) as usize + 2];
    let at = |i: usize, j: usize, k: usize| (k * n[1] + j) * n[0] + i;
    let corner = |i: usize, j: usize, k: usize| lo + v(i as f64, j as f64, k as f64) * cell;
    let mut values = vec![0.0; n[0] * n[1] * n[2]];
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                values[at(i, j, k)] = field(&shapes, corner(i, j, k));
            }
        }
    }

    // One vertex per cell that the surface crosses, at the mean of its edge crossings.
    let mut vertex = BTreeMap::new();
    let mut points = Vec::new();
    for k in 0..n[2] - 1 {
        for j in 0..n[1] - 1 {
            for i in 0..n[0] - 1 {
                let corners: Vec<(DVec3, f64)> = (0..8)
                    .map(|c| (i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)))
                    .map(|(i, j, k)| (corner(i, j, k), values[at(i, j, k)]))
                    .collect();
                let (mut sum, mut count) = (DVec3::ZERO, 0.0);
                for (a, b) in [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)] {
                    let ((p, d), (q, e)) = (corners[a], corners[b]);
                    if (d < 0.0) != (e < 0.0) {
                        sum += p.lerp(q, d / (d - e));
                        count += 1.0;
                    }
                }
                if count > 0.0 {
                    vertex.insert((i, j, k), points.len() as u32);
                    points.push(sum / count);
                }
            }
        }
    }
    // A quad round every grid edge that the surface crosses.
    let mut quads = Vec::new();
    for k in 1..n[2] - 1 {
        for j in 1..n[1] - 1 {
            for i in 1..n[0] - 1 {
                let inside = values[at(i, j, k)] < 0.0;
                for axis in 0..3 {
                    let next = [at(i + 1, j, k), at(i, j + 1, k), at(i, j, k + 1)][axis];
                    if inside == (values[next] < 0.0) {
                        continue;
                    }
                    let around = |a: usize, b: usize| match axis {
                        0 => (i, j - a, k - b),
                        1 => (i - b, j, k - a),
                        _ => (i - a, j - b, k),
                    };
                    let mut quad = [around(1, 1), around(0, 1), around(0, 0), around(1, 0)].map(|c| vertex[&c]);
                    if !inside {
                        quad.reverse();
                    }
                    quads.push(quad);
                }
            }
        }
    }
    relax(&mut points, &quads, &shapes, cell);
    let quad_bones =
        quads.iter().map(|q| nearest_bone(&bones, q.iter().map(|&i| points[i as usize]).sum::<DVec3>() / 4.0)).collect();
    Body { quads, quad_bones, ..Body::on(&bones, points) }
}

/// Evens out the vertices along the surface and puts them back onto it.
fn relax(points: &mut [DVec3], quads: &[[u32; 4]], shapes: &[(Shape, f64)], cell: f64) {
    for _ in 0..4 {
        let mut sums = vec![(DVec3::ZERO, 0.0); points.len()];
        for quad in quads {
            let centre = quad.iter().map(|&i| points[i as usize]).sum::<DVec3>() / 4.0;
            for &i in quad {
                sums[i as usize].0 += centre;
                sums[i as usize].1 += 1.0;
            }
        }
        for (p, (sum, count)) in points.iter_mut().zip(sums) {
            if count > 0.0 {
                *p = p.lerp(sum / count, 0.5);
            }
            for _ in 0..2 {
                let h = cell * 0.05;
                let d = field(shapes, *p);
                let gradient = v(
                    field(shapes, *p + v(h, 0.0, 0.0)) - d,
                    field(shapes, *p + v(0.0, h, 0.0)) - d,
                    field(shapes, *p + v(0.0, 0.0, h)) - d,
                ) / h;
                *p -= gradient * (d / gradient.length_squared().max(0.25)).clamp(-cell, cell);
            }
        }
    }
}

fn bone_distance(bone: &Bone, p: DVec3) -> f64 {
    let axis = bone.to - bone.from;
    let t = ((p - bone.from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
    let r = bone.radii[0] + (bone.radii[1] - bone.radii[0]) * t;
    p.distance(bone.from + axis * t) / r
}

fn nearest_bone(bones: &[Bone], p: DVec3) -> usize {
    (0..bones.len()).min_by(|&a, &b| bone_distance(&bones[a], p).total_cmp(&bone_distance(&bones[b], p))).unwrap_or(0)
}

/// Smooth weights among the nearest bone and its neighbours in the skeleton.
fn blend(bones: &[Bone], p: DVec3) -> [(usize, f64); 4] {
    let nearest = nearest_bone(bones, p);
    let neighbours = |a: usize, b: usize| a == b || bones[a].parent == b || bones[b].parent == a;
    let mut list: Vec<(usize, f64)> = (0..bones.len())
        .filter(|&b| neighbours(nearest, b))
        .map(|b| (b, bone_distance(&bones[b], p).max(0.05).powi(-6)))
        .collect();
    list.sort_by(|a, b| b.1.total_cmp(&a.1));
    list.truncate(4);
    let sum: f64 = list.iter().map(|w| w.1).sum();
    let mut weights = [(0, 0.0); 4];
    for (slot, (bone, w)) in weights.iter_mut().zip(list) {
        *slot = (bone, w / sum);
    }
    weights
}
