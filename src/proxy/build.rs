//! From a scan's surface to its proxy, step by step.

use super::Proxy;
use super::canonical::Canonical;
use super::caps::{Caps, fan_caps};
use super::carve::{cut_air_gaps, drop_crumbs, finish, keep_inside, peel};
use super::contacts::Skin;
use super::decimate::decimate;
use super::delaunay::tetrahedralize;
use super::edges::{Edges, compact, double_area};
use super::ground::ground;
use super::lattice::inner_points;
use super::parting::{carry_inwards, part};
use super::pieces::orient;
use super::refine::refine;
use super::shell::shell;
use super::weld::weld;
use crate::error::{Error, Notes, Result};
use crate::spatial::TriangleTree;
use crate::words;
use glam::DVec3;
use rayon::prelude::*;

/// Vertices nearer than this are one; positions are in the unit box.
const WELD: f64 = 1e-6;
/// Air gaps wider than this share of the body's diagonal separate what lies on their sides.
const AIR_GAP: f64 = 0.0025;
/// Surfaces with fewer vertices than this share of the target are split.
const FEWEST: f64 = 2.0 / 3.0;
/// Depth below the surface at which it is asked whether there is a body, as a share of the body's diagonal.
const PROBE: f64 = 0.002;
/// Triangles that are asked.
const PROBES: usize = 4000;
/// Winding number below which a probe found no body.
const HOLLOW: f64 = 0.75;
/// Winding number above which a probe lies in more than one body.
const BURIED: f64 = 1.5;
/// Share of the area without a body below it from which the surface is a sheet.
const SHEET: f64 = 0.5;
/// Share of the area from which what has a volume is taken for the body; the rest may be a floor larger than it.
const BODY_AREA: f64 = 0.1;
/// Share of the area inside other parts from which the user is told.
const MUCH_BURIED: f64 = 0.05;
/// Share of the area that a piece must have to be coated where the surface is a sheet.
const COATED_AREA: f64 = 0.002;

/// A surface that keeps more than this multiple of the wanted vertices, since its edges have too many triangles, is not tetrahedralized.
const TOO_MANY: usize = 2;

/// What the user may choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BuildOptions {
    /// Vertices on the skin of the proxy; about a tenth is added inside.
    pub surface_vertices: usize,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { surface_vertices: 3000 }
    }
}

/// The smallest number of surface vertices that still makes a body.
const LEAST_SURFACE_VERTICES: usize = 50;

/// A proxy with what there is to say about it.
#[derive(Clone, Debug)]
pub struct Built {
    /// The proxy, in the space of the given points.
    pub proxy: Proxy,
    /// Counts.
    pub summary: Summary,
    /// Centroids of the tetrahedra that still join parts which only touch, in the space of the given points.
    pub joined: Vec<DVec3>,
    /// What was doubtful.
    pub notes: Notes,
}

/// How the proxy was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// Tetrahedra fill the surface.
    #[default]
    Body,
    /// Cubes coat a surface that encloses nothing.
    Coat,
    /// Cubes fill and coat the surface, since no tetrahedralization could be proven.
    Cubes,
}

/// Counts of what was built and left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// How the proxy was made.
    pub form: Form,
    /// Vertices of the proxy.
    pub vertices: usize,
    /// Tetrahedra of the proxy.
    pub tetrahedra: usize,
    /// Separate pieces of the proxy.
    pub pieces: usize,
    /// Tetrahedra removed across air gaps.
    pub across_air_gaps: usize,
    /// Slivers peeled off the skin.
    pub peeled: usize,
    /// Flat tetrahedra left out inside.
    pub flat: usize,
    /// Parts of the proxy dropped for their size.
    pub crumbs: usize,
    /// Pieces of the surface that make up the body.
    pub body_pieces: usize,
    /// Other pieces of the surface: they follow the body, but are not part of it.
    pub loose_pieces: usize,
    /// Share of the area of the other pieces.
    pub loose_area: f64,
    /// Share of the body's area that lies inside other parts of it.
    pub buried: f64,
    /// Vertices of the skin that touch, or lie inside, skin that is far away along the surface: an arm against the trunk.
    pub touching: usize,
    /// Longest way out of such an overlap, as a share of the body's diagonal.
    pub overlap: f64,
    /// Tetrahedra that still join such parts.
    pub joined: usize,
}

impl Summary {
    /// `3,512 vertices, 12,840 tetrahedra`.
    pub fn size(&self) -> String {
        format!("{} vertices, {} tetrahedra", words::count(self.vertices), words::count(self.tetrahedra))
    }

    /// `one piece · 212 removed across air gaps`.
    pub fn remarks(&self) -> String {
        let mut words = vec![if self.pieces == 1 { "one piece".into() } else { format!("{} pieces", words::count(self.pieces)) }];
        match self.form {
            Form::Body => {}
            Form::Coat => words.push("a coat around a sheet".into()),
            Form::Cubes => words.push("cubes".into()),
        }
        if self.across_air_gaps > 0 {
            words.push(format!("{} removed across air gaps", words::count(self.across_air_gaps)));
        }
        if self.touching > 0 {
            words.push(format!("parts touch at {} vertices: held apart", words::count(self.touching)));
        }
        words.join(" · ")
    }
}

/// Builds the proxy of a surface.
///
/// Shapes: `points`: any number, in the unit box; `triangles`: indices into `points`, in any order and orientation, closed or not.
/// `cancel` is asked between the steps and ends the work with its error.
///
/// The proxy depends neither on the order of points and triangles nor on rounding, and the mirror image of a surface, or the same along other axes,
/// has the mirrored or turned proxy (unless the surface is its own mirror image).
///
/// Errors: an index without a point; nothing with an extent; fewer than 50 surface vertices asked for.
/// Source: after Stoll et al. 2007, §2.1, made to stand noise, holes, debris and flipped faces.
pub fn build(points: &[DVec3], triangles: &[[u32; 3]], options: &BuildOptions, cancel: &dyn Fn() -> Result<()>) -> Result<Built> {
    if options.surface_vertices < LEAST_SURFACE_VERTICES {
        return Err(Error::new(crate::error::Kind::Usage, format!("{} proxy vertices", options.surface_vertices))
            .expected(format!("at least {LEAST_SURFACE_VERTICES}")));
    }
    if let Some(v) = triangles.iter().flatten().find(|&&v| v as usize >= points.len()) {
        return Err(Error::malformed(format!("a triangle names vertex {v} of {}", points.len())));
    }
    let mut notes = Notes::default();
    let Canonical { frame, points, triangles, not_finite } = Canonical::of(points, triangles);
    if not_finite > 0 {
        notes.warn(format!("{not_finite} triangles have a coordinate that is not a number: left out of the proxy"));
    }
    let welded = weld(&points, &triangles, WELD);
    drop((points, triangles));
    if welded.triangles.is_empty() {
        return Err(Error::refused("the surface has no triangle with an extent").expected("a mesh with faces"));
    }
    cancel()?;
    let surface = Surface::select(welded.points, welded.triangles, &mut notes);
    cancel()?;
    let target = options.surface_vertices;
    let mut summary = surface.summary;
    let mut joined = Vec::new();
    let (mut proxy, flat) = match surface.summary.form {
        Form::Body => match fill(&surface, target, &mut summary, &mut joined, cancel)? {
            Ok(filled) => filled,
            Err(failure) => {
                summary.form = Form::Cubes;
                notes.warn(format!("the body could not be filled with tetrahedra ({failure}): built from cubes instead"));
                coat(&surface, target, &mut summary)
            }
        },
        _ => coat(&surface, target, &mut summary),
    };
    if proxy.tets.is_empty() {
        return Err(Error::refused("no body could be built from the surface")
            .hint("check the mesh, or give a tetrahedral mesh with --proxy FILE.mesh"));
    }
    frame.leave_with(&mut proxy);
    joined.iter_mut().for_each(|p| *p = frame.leave(*p));
    summary.flat = flat;
    summary.vertices = proxy.rest.len();
    summary.tetrahedra = proxy.tets.len();
    summary.pieces = proxy.components.iter().max().map_or(0, |&last| last as usize + 1);
    summary.joined = joined.len();
    if summary.buried > MUCH_BURIED && summary.touching == 0 {
        notes.warn(format!(
            "{:.0} % of the surface lies inside other parts of it: parts that overlap move as one",
            100.0 * summary.buried
        ));
    }
    if !joined.is_empty() {
        notes.warn(format!(
            "arms or other parts touch the body: {} tetrahedra still join them {}, and they move together there",
            words::count(joined.len()),
            place(&joined, surface.tree.bounds().map(|(lo, hi)| (frame.leave(lo), frame.leave(hi))))
        ));
    }
    if summary.pieces > 1 {
        notes.warn(format!(
            "the body is in {} pieces that do not hold on to each other: each needs markers of its own",
            summary.pieces
        ));
    }
    Ok(Built { proxy, summary, joined, notes })
}

/// The part of the scan that the proxy stands for.
struct Surface {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// The triangles, and fans over the holes where it is a body.
    tree: TriangleTree,
    diagonal: f64,
    volume: f64,
    /// What is known so far.
    summary: Summary,
}

impl Surface {
    fn select(points: Vec<DVec3>, mut triangles: Vec<[u32; 3]>, notes: &mut Notes) -> Self {
        let pieces = orient(&points, &mut triangles);
        let total: f64 = pieces.list.iter().map(|p| p.area).sum();
        let body = pieces.body(1.0);
        let area: f64 = pieces.list.iter().zip(&body).filter(|(_, body)| **body).map(|(p, _)| p.area).sum();
        let volume = pieces.list.iter().zip(&body).filter(|(_, body)| **body).map(|(p, _)| p.volume).sum();
        if area > BODY_AREA * total {
            let mut surface = Self::of(&points, &triangles, |t| body[pieces.of[t] as usize], true);
            let (hollow, buried) = surface.probe();
            if hollow <= SHEET {
                surface.count(&body, 1.0 - area / total);
                surface.volume = volume;
                surface.summary.buried = buried;
                if let Some(ratio) = ground(&surface.points, &surface.triangles, &surface.tree, surface.diagonal) {
                    notes.warn(format!(
                        "a flat ground, {:.0} times as wide as what stands on it, has grown together with the body: it moves and tears \
                         with the feet; cut it off the scan",
                        ratio
                    ));
                }
                return surface;
            }
        }
        let coated: Vec<bool> = pieces.list.iter().map(|p| p.area > COATED_AREA * total).collect();
        let area: f64 = pieces.list.iter().zip(&coated).filter(|(_, coated)| **coated).map(|(p, _)| p.area).sum();
        let mut surface = Self::of(&points, &triangles, |t| coated[pieces.of[t] as usize], false);
        surface.count(&coated, 1.0 - area / total);
        surface.summary.form = Form::Coat;
        notes.warn("the surface encloses no body: a coat of cubes around it is used as proxy");
        surface
    }

    fn of(points: &[DVec3], triangles: &[[u32; 3]], belongs: impl Fn(usize) -> bool, capped: bool) -> Self {
        let mut triangles: Vec<[u32; 3]> = (0..triangles.len()).filter(|&t| belongs(t)).map(|t| triangles[t]).collect();
        let points = compact(points, &mut triangles);
        let (lo, hi) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let tree = if capped {
            capped_tree(&points, &triangles, &caps(&points, &triangles))
        } else {
            TriangleTree::new(&points, &triangles)
        };
        Self { points, triangles, tree, diagonal: (hi - lo).length(), volume: 0.0, summary: Summary::default() }
    }

    fn count(&mut self, chosen: &[bool], loose_area: f64) {
        self.summary.body_pieces = chosen.iter().filter(|c| **c).count();
        self.summary.loose_pieces = chosen.len() - self.summary.body_pieces;
        self.summary.loose_area = loose_area.max(0.0);
    }

    /// Shares of the area with no body right below it, and with more than one. The fans over the holes do not count as surface.
    fn probe(&self) -> (f64, f64) {
        let caps = caps(&self.points, &self.triangles);
        let all: Vec<DVec3> = self.points.iter().chain(&caps.centres).copied().collect();
        let fans = TriangleTree::new(&all, &caps.triangles);
        let step = self.triangles.len().div_ceil(PROBES);
        let winding = |&t: &[u32; 3]| {
            let normal = double_area(&self.points, t);
            let area = normal.length();
            let centroid = t.iter().map(|&v| self.points[v as usize]).sum::<DVec3>() / 3.0;
            let below = centroid - normal.normalize_or_zero() * (PROBE * self.diagonal);
            (area, self.tree.winding(below) - fans.winding(below))
        };
        let probes: Vec<(f64, f64)> = self.triangles.par_iter().step_by(step).map(winding).collect();
        let share = |found: &dyn Fn(f64) -> bool| {
            let area = |select: &dyn Fn(f64) -> bool| probes.iter().filter(|p| select(p.1)).map(|p| p.0).sum::<f64>();
            (area(found) / area(&|_| true)).max(0.0)
        };
        (share(&|w| w < HOLLOW), share(&|w| w > BURIED))
    }
}

/// `at 41–52 % of its longest side`; `corners`: two opposite ones of the box.
fn place(places: &[DVec3], corners: Option<(DVec3, DVec3)>) -> String {
    let Some((a, b)) = corners else { return String::new() };
    let (lo, hi) = (a.min(b), a.max(b));
    let axis = (hi - lo).max_position();
    let percent = |p: &DVec3| 100.0 * (p[axis] - lo[axis]) / (hi - lo)[axis];
    let (from, to) = places.iter().map(percent).fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
    format!("at {from:.0}–{to:.0} % of its longest side")
}

fn caps(points: &[DVec3], triangles: &[[u32; 3]]) -> Caps {
    fan_caps(points, &Edges::of(triangles, points.len()).open_sides(triangles))
}

fn capped_tree(points: &[DVec3], triangles: &[[u32; 3]], caps: &Caps) -> TriangleTree {
    let points: Vec<DVec3> = points.iter().chain(&caps.centres).copied().collect();
    let triangles: Vec<[u32; 3]> = triangles.iter().chain(&caps.triangles).copied().collect();
    TriangleTree::new(&points, &triangles)
}

/// Fills the surface with tetrahedra; the inner error is a reason to fall back on cubes.
fn fill(
    surface: &Surface,
    target: usize,
    summary: &mut Summary,
    joined: &mut Vec<DVec3>,
    cancel: &dyn Fn() -> Result<()>,
) -> Result<Result<(Proxy, usize), String>> {
    let (mut points, mut triangles) = (surface.points.clone(), surface.triangles.clone());
    let fewest = (FEWEST * target as f64) as usize;
    if points.len() < fewest {
        refine(&mut points, &mut triangles, fewest);
    }
    decimate(&mut points, &mut triangles, target);
    if points.len() > TOO_MANY * target {
        return Ok(Err(format!("{} vertices are left where {target} were wanted", points.len())));
    }
    cancel()?;
    let closed = |points: &[DVec3]| capped_tree(points, &triangles, &caps(points, &triangles));
    let skin = Skin::new(&points, &triangles, surface.diagonal);
    let parted = part(&skin, &points, closed);
    if let Some(parted) = &parted {
        points.iter_mut().zip(&parted.shift).for_each(|(p, shift)| *p += *shift);
    }
    let coarse = closed(&points);
    // Where parts were moved, the scan's own surface no longer tells what is inside.
    let tree = if parted.is_some() { &coarse } else { &surface.tree };
    let inner = inner_points(&coarse, surface.volume, points.len());
    points.extend(inner);
    cancel()?;
    let mut tets = match tetrahedralize(&points) {
        Ok(tets) => tets,
        Err(failure) => return Ok(Err(failure.to_string())),
    };
    cancel()?;
    keep_inside(&points, &mut tets, tree);
    cancel()?;
    summary.across_air_gaps = cut_air_gaps(&points, &mut tets, tree, AIR_GAP * surface.diagonal);
    let mut bridging = Vec::new();
    if let Some(parted) = &parted {
        summary.touching = parted.contacts;
        summary.overlap = parted.depth / surface.diagonal;
        let found = skin.bridging(&points, &tets, tree);
        let (cut, kept): (Vec<_>, Vec<_>) = found.into_iter().partition(|(_, through_air)| *through_air);
        bridging = kept.iter().map(|&(i, _)| tets[i]).collect();
        let cut: Vec<[u32; 4]> = cut.iter().map(|&(i, _)| tets[i]).collect();
        tets.retain(|t| !cut.contains(t));
        summary.across_air_gaps += cut.len();
    }
    summary.peeled = peel(&points, &mut tets);
    summary.crumbs = drop_crumbs(&points, &mut tets);
    if tets.is_empty() {
        return Ok(Err("nothing is left inside".into()));
    }
    if let Some(parted) = &parted {
        let shift = carry_inwards(&parted.shift, points.len(), &tets);
        points.iter_mut().zip(shift).for_each(|(p, shift)| *p -= shift);
    }
    let centre = |t: &[u32; 4]| t.iter().map(|&v| points[v as usize]).sum::<DVec3>() * 0.25;
    *joined = bridging.iter().filter(|t| tets.contains(t)).map(centre).collect();
    Ok(Ok(finish(&points, tets)))
}

fn coat(surface: &Surface, target: usize, summary: &mut Summary) -> (Proxy, usize) {
    let filled = summary.form == Form::Cubes;
    let (points, mut tets) = shell(&surface.tree, &surface.points, &surface.triangles, filled, target);
    summary.crumbs = drop_crumbs(&points, &mut tets);
    finish(&points, tets)
}
