//! The map of a shell: affine maps of coarse triangles blended, with weights that give back the examples.

use super::SurfaceMap;
use super::paper::PaperMap;
use super::pieces::loose_pieces;
use crate::deform::shells::Body;
use crate::linalg::{DenseCholesky, SparseRow};
use crate::proxy::rows::{RowSum, wendland};
use crate::scan::Faces;
use crate::spatial::TriangleTree;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Radius of the weights, in lengths of an edge of the triangles around, and in distances of the nearest of their centres.
const RADIUS: f64 = 1.5;
/// Square of the distance, in diagonals, that is worth as much as a change of the weights by their own size.
const STIFFNESS: f64 = 3e-9;
/// Coefficients below this are left out.
const NOTHING: f64 = 1e-7;

impl SurfaceMap {
    /// The map of a shell's body.
    ///
    /// A vertex of the scan goes with the triangles around the coarse vertex into which it was merged, two rings of them and so never across a gap: the
    /// affine map of each (that of its tetrahedron in the proxy) counts by a Wendland function of its distance. Then the weights are changed, as
    /// little as may be, so that the examples, which are known on the whole scan, come out of their coarse meshes: what blended triangles cannot
    /// follow by themselves, a fold of the skin, they are taught so. The sum stays 1, so that affine maps come through. Vertices that were left
    /// out of the body go with the nearest one. A body of which no vertex was merged is the scan itself.
    ///
    /// Shapes: `points` and each of `examples`: those of the scan, in the unit box.
    pub fn build_for_shell(body: &Body, points: &[DVec3], faces: &Faces, examples: &[Vec<DVec3>]) -> Self {
        let coarse = Coarse::new(body);
        let roots = roots(body, points, faces);
        let size = body.proxy.rest.len();
        let row = |(memory, sum): &mut (Memory, RowSum), v: usize| coarse.row(v, roots[v], points, examples, memory, sum);
        let rows: Vec<SparseRow> =
            (0..points.len()).into_par_iter().with_min_len(64).map_init(|| (Memory::default(), RowSum::new(size)), row).collect();
        Self { kind: super::Kind::Paper(PaperMap::of_rows(size, rows)) }
    }
}

/// The coarse vertex that each vertex of the scan goes with.
fn roots(body: &Body, points: &[DVec3], faces: &Faces) -> Vec<u32> {
    let tree = TriangleTree::new(&body.proxy.rest, &body.proxy.boundary);
    let nearest = |p: DVec3| -> Option<(f64, u32)> {
        let foot = tree.closest(p)?;
        let corners = body.proxy.boundary[foot.triangle].into_iter().zip(foot.barycentric);
        let corner = corners.max_by(|a, b| a.1.total_cmp(&b.1))?.0;
        Some((foot.distance, corner))
    };
    let mut feet: Vec<Option<(f64, u32)>> = body
        .roots
        .par_iter()
        .zip(points)
        .map(|(root, p)| if *root == Body::NONE { nearest(*p) } else { Some((0.0, *root)) })
        .collect();
    for piece in loose_pieces(points, faces, |v| feet[v].map_or(f64::INFINITY, |f| f.0)) {
        let all = piece.iter().filter_map(|&v| feet[v as usize]);
        if let Some(nearest) = all.min_by(|a, b| a.0.total_cmp(&b.0)) {
            piece.iter().for_each(|&v| feet[v as usize] = Some(nearest));
        }
    }
    feet.into_iter().map(|foot| foot.map_or(0, |f| f.1)).collect()
}

/// The coarse triangles, at rest and in the examples.
struct Coarse<'a> {
    body: &'a Body,
    /// Whether no vertex was merged into another: then each is its own.
    is_whole: bool,
    /// Triangles at each vertex.
    around: Vec<Vec<u32>>,
    centres: Vec<DVec3>,
    /// Twice the area of each.
    areas: Vec<f64>,
    /// Of the two edges from the first corner and the normal, at rest.
    inverses: Vec<DMat3>,
    /// The affine map of each in each example: from its centre at rest to that in the example.
    maps: Vec<Vec<(DMat3, DVec3)>>,
}

/// What is needed for a vertex.
#[derive(Default)]
struct Memory {
    triangles: Vec<u32>,
    weights: Vec<f64>,
    /// By triangles: where each has the vertex, in all examples.
    columns: Vec<f64>,
    errors: Vec<f64>,
    changes: Vec<f64>,
    cholesky: DenseCholesky,
}

impl<'a> Coarse<'a> {
    fn new(body: &'a Body) -> Self {
        let (rest, faces) = (&body.proxy.rest, &body.proxy.boundary);
        let mut around = vec![Vec::new(); body.vertices()];
        for (t, face) in faces.iter().enumerate() {
            face.iter().for_each(|&v| around[v as usize].push(t as u32));
        }
        let centre = |x: &[DVec3], f: &[u32; 3]| f.iter().map(|&v| x[v as usize]).sum::<DVec3>() / 3.0;
        let frame = |x: &[DVec3], f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| x[v as usize]);
            let (e, g) = (b - a, c - a);
            let normal = e.cross(g);
            DMat3::from_cols(e, g, normal / normal.length().max(f64::MIN_POSITIVE).sqrt())
        };
        let inverses: Vec<DMat3> = faces
            .iter()
            .map(|f| {
                let inverse = frame(rest, f).inverse();
                // A triangle without an area only takes along.
                if inverse.is_finite() { inverse } else { DMat3::ZERO }
            })
            .collect();
        let map = |x: &Vec<DVec3>| {
            faces.iter().zip(&inverses).map(|(f, inverse)| (frame(x, f) * *inverse, centre(x, f))).collect::<Vec<_>>()
        };
        Self {
            around,
            centres: faces.iter().map(|f| centre(rest, f)).collect(),
            areas: faces.iter().map(|f| frame(rest, f).z_axis.length_squared()).collect(),
            maps: body.examples.iter().map(map).collect(),
            is_whole: body.roots.iter().zip(&body.places).all(|(root, place)| root == place),
            inverses,
            body,
        }
    }

    fn row(
        &self,
        vertex: usize,
        root: u32,
        points: &[DVec3],
        examples: &[Vec<DVec3>],
        memory: &mut Memory,
        sum: &mut RowSum,
    ) -> SparseRow {
        let point = points[vertex];
        if self.is_whole && self.body.places[vertex] != Body::NONE {
            return SparseRow { indices: vec![self.body.places[vertex]], values: vec![1.0] };
        }
        self.weigh(point, root, memory);
        if self.body.roots[vertex] != Body::NONE {
            self.fit(point, vertex, examples, memory);
        }
        for (&t, &weight) in memory.triangles.iter().zip(&memory.weights) {
            let t = t as usize;
            // x ↦ c′ + [b′ − a′, c′ − a′, tip′ − c′] F⁻¹ (x − c).
            let inside = self.inverses[t] * (point - self.centres[t]) * weight;
            let [a, b, c] = self.body.proxy.boundary[t];
            let third = (weight - inside.z) / 3.0;
            sum.add(a, third - inside.x - inside.y);
            sum.add(b, third + inside.x);
            sum.add(c, third + inside.y);
            sum.add(self.body.proxy.tets[t][3], inside.z);
        }
        let row = sum.take();
        let (indices, values) = row.indices.into_iter().zip(row.values).filter(|(_, c)| c.abs() > NOTHING).unzip();
        SparseRow { indices, values }
    }

    /// Triangles of two rings with Wendland weights, whose sum is 1.
    fn weigh(&self, point: DVec3, root: u32, memory: &mut Memory) {
        let Memory { triangles, weights, .. } = memory;
        triangles.clear();
        for &t in &self.around[root as usize] {
            let corners = self.body.proxy.boundary[t as usize];
            triangles.extend(corners.iter().flat_map(|&v| &self.around[v as usize]));
        }
        triangles.sort_unstable();
        triangles.dedup();
        let distance = |t: u32| self.centres[t as usize].distance(point);
        let area = triangles.iter().map(|&t| self.areas[t as usize]).sum::<f64>() / triangles.len().max(1) as f64;
        let nearest = triangles.iter().map(|&t| distance(t)).fold(f64::INFINITY, f64::min);
        let radius = RADIUS * area.sqrt().max(nearest);
        triangles.retain(|&t| distance(t) < radius);
        weights.clear();
        weights.extend(triangles.iter().map(|&t| wendland(distance(t) / radius)));
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
    }

    /// Changes the weights towards what the examples say.
    fn fit(&self, point: DVec3, vertex: usize, examples: &[Vec<DVec3>], memory: &mut Memory) {
        let Memory { triangles, weights, columns, errors, changes, cholesky } = memory;
        let (count, height) = (triangles.len(), 3 * examples.len());
        if height == 0 || count < 2 {
            return;
        }
        columns.clear();
        for &t in &*triangles {
            let from = point - self.centres[t as usize];
            for maps in &self.maps {
                let (linear, centre) = maps[t as usize];
                columns.extend((linear * from + centre).to_array());
            }
        }
        errors.clear();
        errors.extend(examples.iter().flat_map(|x| x[vertex].to_array()));
        // With the mean taken off, changes that weigh each triangle by its own weight sum to 0.
        for k in 0..height {
            let mean: f64 = (0..count).map(|t| weights[t] * columns[t * height + k]).sum();
            (0..count).for_each(|t| columns[t * height + k] -= mean);
            errors[k] -= mean;
        }
        let column = |t: usize| &columns[t * height..(t + 1) * height];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let matrix = cholesky.refill(count);
        for j in 0..count {
            for i in j..count {
                matrix[j * count + i] = dot(column(i), column(j));
            }
            matrix[j * count + j] += STIFFNESS * examples.len() as f64 / weights[j].max(1e-6);
        }
        changes.clear();
        changes.extend((0..count).map(|t| dot(column(t), errors)));
        if cholesky.factor() {
            cholesky.solve(changes);
            if changes.iter().all(|c| c.is_finite()) {
                weights.iter_mut().zip(&*changes).for_each(|(w, c)| *w += c);
                let total: f64 = weights.iter().sum();
                weights.iter_mut().for_each(|w| *w /= total);
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::deform::shells::shapes::{Bend, arm};
    use glam::DQuat;

    /// An arm with waves on its skin, at rest or bent, in a box of about 1.
    fn bent(shoulder: f64, elbow: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let (points, faces) = arm(91, 24, Bend { shoulder, elbow, bulge: 0.25 * elbow / 100.0 });
        (points.iter().map(|p| *p / 3.0).collect(), faces)
    }

    fn polygons(triangles: &[[u32; 3]]) -> Faces {
        let mut faces = Faces::default();
        triangles.iter().for_each(|t| faces.push(*t));
        faces
    }

    fn apply(map: &SurfaceMap, pose: &[DVec3]) -> Vec<DVec3> {
        let mut out = vec![Vec::new()];
        map.apply(&[pose], &mut out);
        out[0].iter().map(|p| DVec3::from(p.map(f64::from))).collect()
    }

    fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    }

    #[test]
    fn rest_and_rigid_motions_come_through_and_examples_come_back() {
        let (rest, triangles) = bent(0.0, 0.0);
        let examples = [bent(0.0, 100.0).0, bent(70.0, 0.0).0];
        let body = Body::build(&rest, &triangles, &examples, 400, &|| Ok(())).unwrap().numbered_as_scan();
        let fitted = SurfaceMap::build_for_shell(&body, &rest, &polygons(&triangles), &examples);
        let plain =
            SurfaceMap::build_for_shell(&Body { examples: Vec::new(), ..body.clone() }, &rest, &polygons(&triangles), &[]);
        for map in [&fitted, &plain] {
            for v in (0..rest.len()).step_by(7) {
                assert!((map.row(v).values.iter().sum::<f64>() - 1.0).abs() < 1e-6);
            }
            assert!(distance(&apply(map, &body.proxy.rest), &rest) < 1e-6);
            let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 2.0);
            let motion = |p: &DVec3| turn * *p + DVec3::new(0.3, 0.1, -0.2);
            let moved: Vec<DVec3> = body.proxy.rest.iter().map(motion).collect();
            let expected: Vec<DVec3> = rest.iter().map(motion).collect();
            assert!(distance(&apply(map, &moved), &expected) < 1e-6);
        }
        for (coarse, example) in body.examples.iter().zip(&examples) {
            let pose = body.posed(coarse);
            let (with, without) = (distance(&apply(&fitted, &pose), example), distance(&apply(&plain, &pose), example));
            assert!(with < 5e-3 && with < 0.5 * without && without < 0.02, "{with} fitted, {without} plain");
        }
        // A pose that neither shows.
        let (seen, _) = bent(35.0, 50.0);
        let pose = body.posed(&coarse_of(&body, &seen));
        let (with, without) = (distance(&apply(&fitted, &pose), &seen), distance(&apply(&plain, &pose), &seen));
        assert!(with < without, "{with} fitted, {without} plain");
    }

    fn coarse_of(body: &Body, x: &[DVec3]) -> Vec<DVec3> {
        let mut coarse = vec![DVec3::ZERO; body.vertices()];
        for (place, p) in body.places.iter().zip(x).filter(|(place, _)| **place != Body::NONE) {
            coarse[*place as usize] = *p;
        }
        coarse
    }

    #[test]
    fn a_whole_body_is_the_scan_and_what_is_loose_goes_with_what_is_near() {
        let (mut rest, mut triangles) = bent(0.0, 0.0);
        let n = rest.len();
        let button = DVec3::new(0.25, 0.13, 0.0);
        rest.extend([button, button + DVec3::X * 0.004, button + DVec3::Z * 0.004]);
        triangles.push([n as u32, n as u32 + 1, n as u32 + 2]);
        let body = Body::build(&rest, &triangles, &[], 100_000, &|| Ok(())).unwrap().numbered_as_scan();
        let map = SurfaceMap::build_for_shell(&body, &rest, &polygons(&triangles), &[]);
        let mut pose = body.proxy.rest.clone();
        pose[17] += DVec3::Y;
        let out = apply(&map, &pose);
        assert!(out[17].distance(rest[17] + DVec3::Y) < 1e-6 && out[18].distance(rest[18]) < 1e-6);
        let (turned, _) = bent(0.0, 80.0);
        let out = apply(&map, &body.posed(&turned));
        let edges = |x: &[DVec3]| [x[n].distance(x[n + 1]), x[n].distance(x[n + 2])];
        assert!(edges(&out).iter().all(|l| (l / 0.004 - 1.0).abs() < 0.1), "{:?}", edges(&out));
    }
}
