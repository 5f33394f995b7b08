//! From a surface with examples to the coarse mesh that is posed, and its proxy for everything that comes after.

use super::decimate::decimate;
use super::geometry::{double_area, volume};
use super::newton::outwards;
use super::topology::Topology;
use crate::disjoint::DisjointSets;
use crate::error::{Error, Kind, Notes, Result};
use crate::proxy::Proxy;
use crate::proxy::canonical::Order;
use crate::words;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Share of the area from which a piece of the surface is part of the body; smaller ones follow it.
const BODY_AREA: f64 = 0.02;
/// The smallest number of vertices that still makes a body.
const LEAST_VERTICES: usize = 50;

/// A coarse mesh with its examples.
///
/// Its proxy has, besides the vertices, one point per triangle: from its centre outwards, as long as the root of twice its area. With it the triangle is
/// a tetrahedron whose affine map is that of (12) in Sumner and Popović 2004, so that rows and maps over tetrahedra are those of the surface.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Body {
    /// Vertices, then the points off the triangles; tetrahedron and boundary triangle `t` are triangle `t` of the mesh.
    pub proxy: Proxy,
    /// Positions of the vertices in each example.
    pub examples: Vec<Vec<DVec3>>,
    /// The vertex that a vertex of the scan is; [`Body::NONE`] where it was merged into another, or is not part of the body.
    pub places: Vec<u32>,
    /// The vertex into which a vertex of the scan was merged; [`Body::NONE`] where it is not part of the body.
    pub roots: Vec<u32>,
    /// What was doubtful.
    pub notes: Notes,
}

impl Body {
    /// No vertex.
    pub const NONE: u32 = u32::MAX;

    /// Merges the vertices of a surface, in all poses alike, until about `target` are left.
    ///
    /// Shapes: `points` and each example: n, in the unit box of the rest pose; `triangles`: counter-clockwise from outside, or all clockwise.
    /// Vertices that are one in every pose are one.
    ///
    /// # Errors
    /// A surface with edges of three and more triangles, or with triangles seen from different sides; one without triangles; what `cancel` returns.
    pub fn build(
        points: &[DVec3],
        triangles: &[[u32; 3]],
        examples: &[Vec<DVec3>],
        target: usize,
        cancel: &dyn Fn() -> Result<()>,
    ) -> Result<Self> {
        if target < LEAST_VERTICES {
            return Err(
                Error::new(Kind::Usage, format!("{target} proxy vertices")).expected(format!("at least {LEAST_VERTICES}"))
            );
        }
        let mut notes = Notes::default();
        let (one, faces) = selected(points, triangles, examples, &mut notes);
        if faces.is_empty() {
            return Err(Error::refused("the surface has no triangle with an extent").expected("a mesh with faces"));
        }
        let poses: Vec<&[DVec3]> = std::iter::once(points).chain(examples.iter().map(Vec::as_slice)).collect();
        let used = Used::of(&poses, &faces);
        let topology = Topology::of(used.vertices.len(), &used.faces).map_err(|flaw| {
            let error = flaw.error(|v| used.vertices[v as usize] + 1);
            error.hint("repair the mesh, or leave out --examples: the volumetric deformer takes any surface")
        })?;
        let mut faces = used.faces.clone();
        if volume(&used.poses[0], &faces, &topology.holes) < 0.0 {
            faces.iter_mut().for_each(|f| f.swap(1, 2));
        }
        let order = &used.order;
        order.enter_triangles(&mut faces);
        let entered: Vec<Vec<DVec3>> = used.poses.iter().map(|x| order.enter(x)).collect();
        let poses: Vec<&[DVec3]> = entered.iter().map(Vec::as_slice).collect();
        let mut coarse = decimate(&poses, &faces, target, cancel)?;
        order.leave_triangles(&mut coarse.faces);
        let of = |x: &[DVec3]| -> Vec<DVec3> { coarse.vertices.iter().map(|&v| x[v as usize]).collect() };
        let examples = used.poses[1..].iter().map(|x| of(x)).collect();
        let mut kept = vec![Self::NONE; points.len()];
        for (&v, place) in coarse.vertices.iter().zip(0..) {
            kept[used.vertices[v as usize] as usize] = place;
        }
        let places = one.iter().map(|&v| kept[v as usize]).collect();
        let mut merged = vec![Self::NONE; points.len()];
        for (&v, &root) in used.vertices.iter().zip(&coarse.roots) {
            merged[v as usize] = root;
        }
        let roots = one.iter().map(|&v| merged[v as usize]).collect();
        Ok(Self { proxy: proxy(of(&used.poses[0]), &coarse.faces), examples, places, roots, notes })
    }

    /// Number of vertices of the mesh.
    pub fn vertices(&self) -> usize {
        self.proxy.rest.len() - self.proxy.tets.len()
    }

    /// Length of an edge if the surface had 1,000 vertices: the measure of [`Material::with_thickness`](super::Material::with_thickness).
    pub fn edge_of_a_thousand(&self) -> f64 {
        let area = |f: &[u32; 3]| 0.5 * double_area(&self.proxy.rest, *f).length();
        (self.proxy.boundary.iter().map(area).sum::<f64>() / (0.866 * 1000.0)).sqrt()
    }

    /// The same with vertices in the order of those of the scan that they are: for whom the scan's numbers mean something.
    #[must_use]
    pub fn numbered_as_scan(&self) -> Self {
        let mut firsts = vec![u32::MAX; self.vertices()];
        for (v, place) in self.places.iter().enumerate().rev().filter(|(_, place)| **place != Self::NONE) {
            firsts[*place as usize] = v as u32;
        }
        let mut order: Vec<u32> = (0..self.vertices() as u32).collect();
        order.sort_by_key(|&p| firsts[p as usize]);
        let mut numbers: Vec<u32> = (0..self.proxy.rest.len() as u32).collect();
        order.iter().zip(0..).for_each(|(&p, number)| numbers[p as usize] = number);
        let number = |p: u32| numbers.get(p as usize).copied().unwrap_or(Self::NONE);
        let of = |x: &[DVec3]| -> Vec<DVec3> { order.iter().map(|&p| x[p as usize]).collect() };
        let mut all = self.clone();
        all.proxy.rest[..order.len()].copy_from_slice(&of(&self.proxy.rest));
        all.proxy.tets.iter_mut().for_each(|t| *t = t.map(number));
        all.proxy.boundary.iter_mut().for_each(|t| *t = t.map(number));
        all.examples = self.examples.iter().map(|x| of(x)).collect();
        all.places.iter_mut().chain(&mut all.roots).for_each(|p| *p = number(*p));
        all
    }

    /// Positions of the vertices as a pose of the proxy.
    pub fn posed(&self, x: &[DVec3]) -> Vec<DVec3> {
        x.iter().copied().chain(self.proxy.boundary.iter().map(|f| tip(x, *f))).collect()
    }

    /// The components that `keep` says yes to, as [`Proxy::with_components`].
    #[must_use]
    pub fn with_components(&self, keep: impl Fn(u32) -> bool) -> Self {
        let mut kept = vec![false; self.vertices()];
        for (face, _) in self.proxy.boundary.iter().zip(&self.proxy.components).filter(|(_, c)| keep(**c)) {
            face.iter().for_each(|&v| kept[v as usize] = true);
        }
        let of = |x: &Vec<DVec3>| x.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(p, _)| *p).collect();
        let mut next = 0..;
        let numbers: Vec<u32> =
            kept.iter().map(|kept| if *kept { next.next().unwrap_or(Self::NONE) } else { Self::NONE }).collect();
        let renumbered = |all: &[u32]| all.iter().map(|&p| numbers.get(p as usize).copied().unwrap_or(Self::NONE)).collect();
        Self {
            proxy: self.proxy.with_components(keep),
            examples: self.examples.iter().map(of).collect(),
            places: renumbered(&self.places),
            roots: renumbered(&self.roots),
            notes: self.notes.clone(),
        }
    }

    /// `1,000 vertices, 1,996 triangles, 7 examples`.
    pub fn words(&self) -> String {
        let size = format!("{} vertices, {} triangles", words::count(self.vertices()), words::count(self.proxy.tets.len()));
        if self.examples.is_empty() { size } else { format!("{size} · {}", words::plural(self.examples.len(), "example")) }
    }
}

/// The proxy of a mesh.
fn proxy(rest: Vec<DVec3>, faces: &[[u32; 3]]) -> Proxy {
    let n = rest.len() as u32;
    let tips: Vec<DVec3> = faces.iter().map(|f| tip(&rest, *f)).collect();
    let labels = components(rest.len(), faces);
    Proxy {
        rest: rest.into_iter().chain(tips).collect(),
        tets: faces.iter().zip(n..).map(|(f, tip)| [f[0], f[1], f[2], tip]).collect(),
        boundary: faces.to_vec(),
        boundary_tets: (0..faces.len() as u32).collect(),
        components: faces.iter().map(|f| labels[f[0] as usize]).collect(),
    }
}

/// The point off a triangle.
pub(super) fn tip(x: &[DVec3], face: [u32; 3]) -> DVec3 {
    face.iter().map(|&v| x[v as usize]).sum::<DVec3>() / 3.0 + outwards(x, face)
}

/// Component of each vertex, numbered from 0 in the order of the triangles.
fn components(vertices: usize, faces: &[[u32; 3]]) -> Vec<u32> {
    let mut sets = DisjointSets::new(vertices);
    for &[a, b, c] in faces {
        sets.unite(a, b);
        sets.unite(a, c);
    }
    let mut numbers = vec![u32::MAX; vertices];
    let mut next = 0..;
    for face in faces {
        let r = sets.find(face[0]) as usize;
        if numbers[r] == u32::MAX {
            numbers[r] = next.next().unwrap_or_default();
        }
    }
    (0..vertices as u32).map(|v| numbers[sets.find(v) as usize]).collect()
}

/// The vertex that stands for each, where several are one in every pose, and the triangles of the body over those.
fn selected(points: &[DVec3], triangles: &[[u32; 3]], examples: &[Vec<DVec3>], notes: &mut Notes) -> (Vec<u32>, Vec<[u32; 3]>) {
    let bits = |p: DVec3| p.to_array().map(|x| (x + 0.0).to_bits());
    let mut firsts: HashMap<[u64; 3], Vec<u32>> = HashMap::with_capacity(points.len());
    let one: Vec<u32> = (0..points.len() as u32)
        .map(|v| {
            let same = firsts.entry(bits(points[v as usize])).or_default();
            let is_same = |&&other: &&u32| examples.iter().all(|x| bits(x[other as usize]) == bits(x[v as usize]));
            match same.iter().find(is_same) {
                Some(&first) => first,
                None => {
                    same.push(v);
                    v
                }
            }
        })
        .collect();
    let mut faces: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|v| one[v as usize])).collect();
    faces.retain(|[a, b, c]| a != b && b != c && c != a);
    let area = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| points[v as usize]);
        0.5 * (b - a).cross(c - a).length()
    };
    let labels = components(points.len(), &faces);
    let mut areas: Vec<f64> = Vec::new();
    for face in &faces {
        let c = labels[face[0] as usize] as usize;
        areas.resize(areas.len().max(c + 1), 0.0);
        areas[c] += area(face);
    }
    let least = BODY_AREA * areas.iter().sum::<f64>();
    let loose = areas.iter().filter(|a| **a < least).count();
    if loose > 0 && loose < areas.len() {
        notes.warn(format!("{} of the scan are left out of the shell and follow it", words::plural(loose, "small piece")));
        faces.retain(|f| areas[labels[f[0] as usize] as usize] >= least);
    }
    (one, faces)
}

/// The vertices that triangles use, in an order that does not depend on their numbers.
struct Used {
    /// In the numbering of the scan.
    vertices: Vec<u32>,
    poses: Vec<Vec<DVec3>>,
    faces: Vec<[u32; 3]>,
    order: Order,
}

impl Used {
    fn of(poses: &[&[DVec3]], faces: &[[u32; 3]]) -> Self {
        let mut vertices: Vec<u32> = faces.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let place = |v: u32| vertices.binary_search(&v).unwrap_or_default() as u32;
        let faces: Vec<[u32; 3]> = faces.iter().map(|f| f.map(place)).collect();
        let of = |x: &[DVec3], order: &[u32]| -> Vec<DVec3> { order.iter().map(|&v| x[v as usize]).collect() };
        let order = Order::of(&of(poses[0], &vertices), &faces);
        // What is one at rest is told apart by the examples.
        let bits = |v: u32| poses.iter().skip(1).map(move |x| x[v as usize].to_array().map(f64::to_bits));
        let mut places: Vec<u32> = (0..vertices.len() as u32).collect();
        places.sort_by(|&a, &b| {
            let [v, w] = [a, b].map(|p| vertices[p as usize]);
            order.rank[a as usize].cmp(&order.rank[b as usize]).then_with(|| bits(v).cmp(bits(w)))
        });
        let mut numbers = vec![0_u32; vertices.len()];
        places.iter().zip(0..).for_each(|(&p, number)| numbers[p as usize] = number);
        let vertices: Vec<u32> = places.iter().map(|&p| vertices[p as usize]).collect();
        Self {
            poses: poses.iter().map(|x| of(x, &vertices)).collect(),
            faces: faces.iter().map(|f| f.map(|p| numbers[p as usize])).collect(),
            vertices,
            order,
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::deform::shells::shapes::{Bend, arm};

    const TARGET: usize = 150;

    fn build(points: &[DVec3], faces: &[[u32; 3]], examples: &[Vec<DVec3>]) -> Result<Body> {
        Body::build(points, faces, examples, TARGET, &|| Ok(()))
    }

    #[test]
    fn vertices_that_are_one_in_every_pose_are_one() {
        let of = |elbow| arm(31, 12, Bend { elbow, ..Bend::default() });
        let (rest, faces) = of(0.0);
        let bent = of(80.0).0;
        let whole = build(&rest, &faces, std::slice::from_ref(&bent)).unwrap();
        // Every triangle with corners of its own.
        let soup = |x: &[DVec3]| faces.iter().flatten().map(|v| x[*v as usize]).collect::<Vec<_>>();
        let corners: Vec<[u32; 3]> = (0..faces.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let welded = build(&soup(&rest), &corners, &[soup(&bent)]).unwrap();
        assert_eq!(whole.vertices(), TARGET);
        assert_eq!((welded.vertices(), welded.proxy.tets.len()), (whole.vertices(), whole.proxy.tets.len()));
        assert!(welded.roots.iter().all(|r| *r != Body::NONE));
        // Cut open in the example only, a seam stays a seam.
        let mut torn = soup(&bent);
        torn[0] += DVec3::X * 0.01;
        assert!(build(&soup(&rest), &corners, &[torn]).unwrap().proxy.components.iter().all(|c| *c == 0));
    }

    #[test]
    fn tips_make_tetrahedra_with_volume_and_faces_that_look_inwards_are_turned() {
        let (rest, faces) = arm(31, 12, Bend::default());
        let inwards: Vec<[u32; 3]> = faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
        let (body, turned) = (build(&rest, &faces, &[]).unwrap(), build(&rest, &inwards, &[]).unwrap());
        for body in [&body, &turned] {
            let n = body.vertices() as u32;
            for (t, (tet, face)) in body.proxy.tets.iter().zip(&body.proxy.boundary).enumerate() {
                let [a, b, c, d] = tet.map(|v| body.proxy.rest[v as usize]);
                assert!((b - a).cross(c - a).dot(d - a) > 0.0 && tet[3] == n + t as u32 && tet[..3] == face[..]);
            }
        }
        assert_eq!(volume(&turned.proxy.rest[..TARGET], &turned.proxy.boundary, &[]).signum(), 1.0);
    }

    #[test]
    fn components_go_with_their_examples() {
        let (rest, faces) = arm(31, 12, Bend::default());
        let n = rest.len() as u32;
        let twice = |x: &[DVec3]| x.iter().copied().chain(x.iter().map(|p| *p + DVec3::Y * 3.0)).collect::<Vec<_>>();
        let all: Vec<[u32; 3]> = faces.iter().copied().chain(faces.iter().map(|f| f.map(|v| v + n))).collect();
        let bent = arm(31, 12, Bend { elbow: 50.0, ..Bend::default() }).0;
        let body = build(&twice(&rest), &all, &[twice(&bent)]).unwrap();
        assert_eq!(body.proxy.components.iter().max(), Some(&1));
        let one = body.with_components(|c| c == 1);
        assert_eq!(one.examples[0].len(), one.vertices());
        assert!(one.proxy.rest.iter().all(|p| p.y > 2.0) && one.examples[0].iter().all(|p| p.y > 2.0));
        assert!(one.roots[..n as usize].iter().all(|r| *r == Body::NONE));
        assert!(one.roots[n as usize..].iter().all(|r| (*r as usize) < one.vertices()));
        let kept = one.places.iter().filter(|p| **p != Body::NONE).count();
        assert_eq!(kept, one.vertices());
    }

    #[test]
    fn small_pieces_follow_and_flaws_are_named() {
        let (mut rest, mut faces) = arm(31, 12, Bend::default());
        let n = rest.len() as u32;
        rest.extend([DVec3::Y, DVec3::Y * 1.01, DVec3::new(0.01, 1.0, 0.0)]);
        faces.push([n, n + 1, n + 2]);
        let body = build(&rest, &faces, &[]).unwrap();
        assert!(body.notes.iter().any(|t| t.contains("1 small piece")), "{:?}", body.notes);
        assert_eq!(body.roots[n as usize], Body::NONE);
        faces.push([faces[0][0], faces[0][1], 200]);
        let error = build(&rest, &faces, &[]).unwrap_err();
        assert!(error.found.contains("has 3 triangles") && error.hint.is_some(), "{error}");
        assert!(build(&rest, &[], &[]).is_err());
    }
}
