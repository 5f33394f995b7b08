//! Pieces of a surface: consistent orientation, and which of them make up the body.

use super::caps::fan_caps;
use super::edges::{Edges, double_area, side};
use glam::DVec3;

/// A part of a surface that is connected across edges of exactly two triangles.
#[derive(Clone, Debug, Default)]
pub(super) struct Piece {
    /// Surface area.
    pub(super) area: f64,
    /// Volume with its holes closed by fans.
    pub(super) volume: f64,
    /// Whether it has open or non-manifold edges.
    pub(super) open: bool,
}

/// The pieces of a surface.
pub(super) struct Pieces {
    /// Piece of each triangle.
    pub(super) of: Vec<u32>,
    /// The pieces, in the order of their first triangle.
    pub(super) list: Vec<Piece>,
}

/// Share of the volume of all pieces above which a piece belongs to the body.
const BODY_VOLUME_SHARE: f64 = 0.002;
/// Mean thickness 2 V / A above which a piece belongs to the body, as a share of the diagonal.
const BODY_THICKNESS: f64 = 0.001;
/// Open pieces whose |volume| / area^1.5 is less are sheets: their sign says nothing.
const SIGNIFICANT_VOLUME: f64 = 1e-3;

impl Pieces {
    /// Which pieces are thick and large enough to make up the body; the rest is debris, lashes, hair.
    pub(super) fn body(&self, diagonal: f64) -> Vec<bool> {
        let total: f64 = self.list.iter().map(|p| p.volume.max(0.0)).sum();
        let enters = |p: &Piece| p.volume > BODY_VOLUME_SHARE * total && 2.0 * p.volume > BODY_THICKNESS * diagonal * p.area;
        self.list.iter().map(enters).collect()
    }
}

/// Turns the triangles so that neighbours agree and every piece encloses a positive volume.
///
/// Scans come with any share of their faces flipped, so the sign of a piece is that of its own volume, holes closed by fans.
pub(super) fn orient(points: &[DVec3], triangles: &mut [[u32; 3]]) -> Pieces {
    let edges = Edges::of(triangles, points.len());
    let mut neighbours = vec![u32::MAX; 3 * triangles.len()];
    for (_, corners) in edges.iter() {
        if let &[a, b] = corners {
            neighbours[a as usize] = b;
            neighbours[b as usize] = a;
        }
    }
    let agreed = agree(triangles, &neighbours);
    let count = agreed.of.iter().max().map_or(0, |&last| last as usize + 1);
    let mut members = vec![Vec::new(); count];
    for (t, &piece) in agreed.of.iter().enumerate() {
        members[piece as usize].push(t);
    }
    let mut list = Vec::with_capacity(count);
    for members in &members {
        let (piece, flip) = measure(points, triangles, &neighbours, &agreed.turned, members);
        list.push(piece);
        for &t in members.iter().filter(|&&t| agreed.turned[t] != flip) {
            triangles[t].swap(1, 2);
        }
    }
    Pieces { of: agreed.of, list }
}

/// Piece of each triangle, and whether it has to be turned to agree with the first triangle of its piece.
struct Agreement {
    of: Vec<u32>,
    turned: Vec<bool>,
}

fn agree(triangles: &[[u32; 3]], neighbours: &[u32]) -> Agreement {
    let mut of = vec![u32::MAX; triangles.len()];
    let mut turned = vec![false; triangles.len()];
    let mut count = 0;
    let mut queue = Vec::new();
    for seed in 0..triangles.len() {
        if of[seed] != u32::MAX {
            continue;
        }
        of[seed] = count;
        queue.push(seed);
        while let Some(t) = queue.pop() {
            for (k, &across) in neighbours[3 * t..3 * t + 3].iter().enumerate() {
                let n = across as usize / 3;
                if across == u32::MAX || of[n] != u32::MAX {
                    continue;
                }
                // Two triangles agree when they run along their common edge in opposite directions.
                turned[n] = turned[t] ^ (side(triangles, (3 * t + k) as u32) == side(triangles, across));
                of[n] = count;
                queue.push(n);
            }
        }
        count += 1;
    }
    Agreement { of, turned }
}

/// Measures one piece; the flag says whether it has to be flipped as a whole to enclose a positive volume.
fn measure(points: &[DVec3], triangles: &[[u32; 3]], neighbours: &[u32], turned: &[bool], members: &[usize]) -> (Piece, bool) {
    let origin = points[triangles[members[0]][0] as usize];
    let mut piece = Piece::default();
    let mut borders = Vec::new();
    for &t in members {
        piece.area += 0.5 * double_area(points, triangles[t]).length();
        let volume = cone_volume(triangles[t].map(|v| points[v as usize]), origin);
        piece.volume += if turned[t] { -volume } else { volume };
        for corner in (3 * t..3 * t + 3).filter(|&corner| neighbours[corner] == u32::MAX) {
            let [a, b] = side(triangles, corner as u32);
            borders.push(if turned[t] { [b, a] } else { [a, b] });
        }
    }
    piece.open = !borders.is_empty();
    if piece.open {
        let caps = fan_caps(points, &once(borders));
        let at = |v: u32| points.get(v as usize).copied().unwrap_or_else(|| caps.centres[v as usize - points.len()]);
        piece.volume += caps.triangles.iter().map(|t| cone_volume(t.map(at), origin)).sum::<f64>();
    }
    let significant = !piece.open || piece.volume.abs() > SIGNIFICANT_VOLUME * piece.area.powf(1.5);
    let flip = if significant { piece.volume < 0.0 } else { members.iter().filter(|&&t| turned[t]).count() * 2 > members.len() };
    if flip {
        piece.volume = -piece.volume;
    }
    (piece, flip)
}

/// The sides that occur once; at a non-manifold edge a piece may meet itself.
fn once(mut sides: Vec<[u32; 2]>) -> Vec<[u32; 2]> {
    let key = |s: &[u32; 2]| [s[0].min(s[1]), s[0].max(s[1])];
    sides.sort_unstable_by_key(|s| (key(s), s[0]));
    let groups = sides.chunk_by(|a, b| key(a) == key(b));
    groups.filter(|group| group.len() == 1).map(|group| group[0]).collect()
}

/// Signed volume between a triangle and `origin`.
fn cone_volume([a, b, c]: [DVec3; 3], origin: DVec3) -> f64 {
    (a - origin).dot((b - origin).cross(c - origin)) / 6.0
}
