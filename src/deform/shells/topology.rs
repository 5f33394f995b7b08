//! Edges, hinges and holes of a triangle mesh.

use crate::error::Error;

/// What two triangles share: edge x₁x₂, x₃ in the triangle left of it, x₄ in the one right of it.
pub(super) type Hinge = [u32; 4];

/// The edges of a mesh of triangles that are seen from outside counter-clockwise.
#[derive(Clone, Debug)]
pub(super) struct Topology {
    /// Ends of each edge; edges rise by their lower, then their upper end.
    pub edges: Vec<[u32; 2]>,
    /// The triangles of each edge: left and right, or [`NONE`].
    pub sides: Vec<[u32; 2]>,
    /// One per edge with two triangles.
    pub hinges: Vec<Hinge>,
    /// Edge of each hinge.
    pub hinge_edges: Vec<u32>,
    /// Holes: their vertices in the order in which triangles that close them run.
    pub holes: Vec<Vec<u32>>,
}

/// Why triangles are no surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flaw {
    /// A triangle names a vertex twice.
    Twice { triangle: usize, vertex: u32 },
    /// The triangles at an edge are seen from different sides.
    Turned([u32; 2]),
    /// An edge has too many triangles.
    Crowded([u32; 2], usize),
}

impl Flaw {
    /// In the words of the user; `number`: what a vertex is called.
    pub fn error(self, number: impl Fn(u32) -> u32) -> Error {
        let edge = |[a, b]: [u32; 2]| format!("the edge between vertices {} and {}", number(a), number(b));
        match self {
            Self::Twice { triangle, vertex } => {
                Error::refused(format!("triangle {} names vertex {} twice", triangle + 1, number(vertex)))
            }
            Self::Turned(ends) => Error::refused(format!("the triangles at {} are seen from different sides", edge(ends)))
                .expected("triangles that are all seen counter-clockwise from outside"),
            Self::Crowded(ends, count) => Error::refused(format!("{} has {count} triangles", edge(ends)))
                .expected("at most two at each edge, as a surface has"),
        }
    }
}

/// No triangle.
pub(super) const NONE: u32 = u32::MAX;

impl Topology {
    /// Finds the edges.
    ///
    /// # Errors
    /// The first flaw.
    pub fn of(vertices: usize, faces: &[[u32; 3]]) -> Result<Self, Flaw> {
        // Lower and upper end, whether the half-edge rises, triangle, opposite vertex.
        let mut halves = Vec::with_capacity(3 * faces.len());
        for (t, face) in faces.iter().enumerate() {
            for k in 0..3 {
                let (a, b, opposite) = (face[k], face[(k + 1) % 3], face[(k + 2) % 3]);
                if a == b {
                    return Err(Flaw::Twice { triangle: t, vertex: a });
                }
                halves.push((a.min(b), a.max(b), a > b, t as u32, opposite));
            }
        }
        halves.sort_unstable();
        let mut result =
            Self { edges: Vec::new(), sides: Vec::new(), hinges: Vec::new(), hinge_edges: Vec::new(), holes: Vec::new() };
        let mut rest = halves.as_slice();
        while let Some(&(a, b, falls, left, opposite)) = rest.first() {
            let count = rest.iter().take_while(|h| (h.0, h.1) == (a, b)).count();
            match (count, rest.get(1)) {
                (1, _) => {
                    result.edges.push(if falls { [b, a] } else { [a, b] });
                    result.sides.push([left, NONE]);
                }
                (2, Some(&(_, _, true, right, other))) if !falls => {
                    result.hinge_edges.push(result.edges.len() as u32);
                    result.hinges.push([a, b, opposite, other]);
                    result.edges.push([a, b]);
                    result.sides.push([left, right]);
                }
                (2, _) => return Err(Flaw::Turned([a, b])),
                _ => return Err(Flaw::Crowded([a, b], count)),
            }
            rest = &rest[count..];
        }
        result.holes = result.find_holes(vertices);
        Ok(result)
    }

    /// Loops of edges with one triangle. Where holes touch in a vertex, each is left by the edge that comes first.
    fn find_holes(&self, vertices: usize) -> Vec<Vec<u32>> {
        let mut next: Vec<Vec<u32>> = vec![Vec::new(); vertices];
        for ([a, b], _) in self.edges.iter().zip(&self.sides).filter(|(_, sides)| sides[1] == NONE) {
            next[*b as usize].push(*a);
        }
        next.iter_mut().for_each(|all| all.reverse());
        let mut holes = Vec::new();
        for start in 0..vertices as u32 {
            while let Some(mut at) = next[start as usize].pop() {
                let mut hole = vec![start];
                while at != start {
                    hole.push(at);
                    match next[at as usize].pop() {
                        Some(further) => at = further,
                        None => break,
                    }
                }
                holes.push(hole);
            }
        }
        holes
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_has_six_hinges_and_without_a_face_one_hole() {
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let closed = Topology::of(4, &faces).unwrap();
        assert_eq!((closed.edges.len(), closed.hinges.len(), closed.holes.len()), (6, 6, 0));
        assert_eq!(closed.hinges[0], [0, 1, 3, 2]);
        let open = Topology::of(4, &faces[..3]).unwrap();
        assert_eq!((open.edges.len(), open.hinges.len()), (6, 3));
        // The hole runs as the missing face does.
        assert_eq!(open.holes, [vec![0, 3, 2]]);
    }

    #[test]
    fn what_is_no_surface_is_refused_with_the_edge() {
        let text = |faces: &[[u32; 3]]| Topology::of(5, faces).unwrap_err().error(|v| v + 10).to_string();
        assert!(text(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).contains("vertices 10 and 11 has 3 triangles"));
        assert!(text(&[[0, 1, 2], [0, 1, 3]]).contains("vertices 10 and 11 are seen from different sides"));
        assert!(text(&[[0, 1, 1]]).contains("names vertex 11 twice"));
    }
}
