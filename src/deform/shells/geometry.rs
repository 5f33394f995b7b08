//! Edge lengths, dihedral angles and the enclosed volume, with their gradients (Fröhlich & Botsch 2011, (4) and Appendix B).

use super::topology::Hinge;
use glam::DVec3;

/// Angle between the normals of the triangles of a hinge: 0 where they lie in one plane, positive over a convex edge, in (−π, π].
pub(super) fn dihedral(x: &[DVec3], hinge: Hinge) -> f64 {
    let [x1, x2, x3, x4] = hinge.map(|v| x[v as usize]);
    let (edge, n1, n2) = (x2 - x1, (x3 - x2).cross(x3 - x1), (x4 - x1).cross(x4 - x2));
    let length = edge.length().max(f64::MIN_POSITIVE);
    (n1.cross(n2).dot(edge) / length).atan2(n1.dot(n2))
}

/// The same with its gradient with respect to the four corners.
///
/// `floor`: least square of the length of a normal, so that flat triangles get no endless gradients. Appendix B prints those of x₁ and x₃; those
/// of x₂ and x₄ are their mirror images.
pub(super) fn dihedral_gradient(x: &[DVec3], hinge: Hinge, floor: f64) -> (f64, [DVec3; 4]) {
    let [x1, x2, x3, x4] = hinge.map(|v| x[v as usize]);
    let (edge, n1, n2) = (x2 - x1, (x3 - x2).cross(x3 - x1), (x4 - x1).cross(x4 - x2));
    let length = edge.length().max(1e-150);
    let angle = (n1.cross(n2).dot(edge) / length).atan2(n1.dot(n2));
    let m1 = n1 / (length * n1.length_squared().max(floor));
    let m2 = n2 / (length * n2.length_squared().max(floor));
    let gradients = [
        (x3 - x2).dot(edge) * m1 + (x4 - x2).dot(edge) * m2,
        -((x3 - x1).dot(edge) * m1 + (x4 - x1).dot(edge) * m2),
        length * length * m1,
        length * length * m2,
    ];
    (angle, gradients)
}

/// An angle, in (−π, π].
pub(super) fn wrapped(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}

/// Volume inside of triangles and of fans from the centre of each hole to its edges (4).
///
/// Measured from the mean of the points, so that it does not suffer where the mesh is far from the origin.
pub(super) fn volume(x: &[DVec3], faces: &[[u32; 3]], holes: &[Vec<u32>]) -> f64 {
    let origin = mean(x);
    let of = |v: u32| x[v as usize] - origin;
    let closed: f64 = faces.iter().map(|f| of(f[0]).cross(of(f[1])).dot(of(f[2]))).sum();
    let fans: f64 = holes
        .iter()
        .map(|hole| {
            let centre = hole.iter().map(|&v| of(v)).sum::<DVec3>() / hole.len() as f64;
            around(hole).map(|(a, b)| of(a).cross(of(b)).dot(centre)).sum::<f64>()
        })
        .sum();
    (closed + fans) / 6.0
}

/// Gradient of [`volume`], into `gradient`. (Appendix B prints it without the sixth.)
pub(super) fn volume_gradient(x: &[DVec3], faces: &[[u32; 3]], holes: &[Vec<u32>], gradient: &mut [DVec3]) {
    let origin = mean(x);
    let of = |v: u32| x[v as usize] - origin;
    gradient.fill(DVec3::ZERO);
    for face in faces {
        let [a, b, c] = face.map(of);
        gradient[face[0] as usize] += b.cross(c);
        gradient[face[1] as usize] += c.cross(a);
        gradient[face[2] as usize] += a.cross(b);
    }
    for hole in holes {
        let centre = hole.iter().map(|&v| of(v)).sum::<DVec3>() / hole.len() as f64;
        let mut of_centre = DVec3::ZERO;
        for (v, w) in around(hole) {
            let (a, b) = (of(v), of(w));
            gradient[v as usize] += b.cross(centre);
            gradient[w as usize] += centre.cross(a);
            of_centre += a.cross(b);
        }
        let share = of_centre / hole.len() as f64;
        hole.iter().for_each(|&v| gradient[v as usize] += share);
    }
    let rounding = mean(gradient);
    gradient.iter_mut().for_each(|g| *g = (*g - rounding) / 6.0);
}

fn around(hole: &[u32]) -> impl Iterator<Item = (u32, u32)> + '_ {
    hole.iter().zip(hole.iter().cycle().skip(1)).map(|(a, b)| (*a, *b))
}

fn mean(x: &[DVec3]) -> DVec3 {
    x.iter().sum::<DVec3>() / x.len().max(1) as f64
}

/// Radii of gyration of a surface that are as long as the diagonal of the box around it: of people and animals 3.8 to 4.6, of a rod and a ball 3.5.
const RADII: f64 = 4.15;

/// Length of a surface, about the diagonal of the box around it, that neither a turn nor a mirror changes: of the second moments about its centre.
pub(super) fn size(x: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    let area = |f: &[u32; 3]| double_area(x, *f).length();
    let total: f64 = faces.iter().map(area).sum();
    if total <= 0.0 {
        return RADII * spread(x);
    }
    let corners = |f: &[u32; 3]| f.map(|v| x[v as usize]);
    let centre = faces.iter().map(|f| corners(f).iter().sum::<DVec3>() * (area(f) / 3.0)).sum::<DVec3>() / total;
    // The mean of |p|² over a triangle.
    let square = |f: &[u32; 3]| {
        let [a, b, c] = corners(f).map(|p| p - centre);
        (a.length_squared() + b.length_squared() + c.length_squared() + (a + b + c).length_squared()) / 12.0
    };
    RADII * (faces.iter().map(|f| area(f) * square(f)).sum::<f64>() / total).sqrt()
}

/// Length of the diagonal of the box around points.
#[cfg(test)]
pub(super) fn diagonal(x: &[DVec3]) -> f64 {
    let (lo, hi) = x.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    (hi - lo).length()
}

/// Root of the mean square of the distances from their centre.
pub(super) fn spread(x: &[DVec3]) -> f64 {
    let centre = mean(x);
    (x.iter().map(|p| p.distance_squared(centre)).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// Twice the area of a triangle as a vector that points outwards.
pub(super) fn double_area(x: &[DVec3], face: [u32; 3]) -> DVec3 {
    let [a, b, c] = face.map(|v| x[v as usize]);
    (b - a).cross(c - a)
}
