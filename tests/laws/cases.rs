//! Meshes with proxy, map and handles; takes; and the deformers that are put through the laws.

use super::shapes::{self, Shape};
use glam::{DQuat, DVec3};
use retarget::deform::shells::{self, Body, Shells, SurfaceRows};
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::deform::{Deformer, Handle, Targets};
use retarget::linalg::SparseRow;
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::proxy::{BuildOptions, Proxy, build};
use retarget::scan::Faces;
use retarget::surface::SurfaceMap;
use std::sync::OnceLock;

/// A deformer that shows its energy after every step of the last frame.
pub trait Watched: Deformer {
    fn energies(&self) -> &[f64];
}

impl Watched for Volumetric {
    fn energies(&self) -> &[f64] {
        Volumetric::energies(self)
    }
}

impl Watched for Shells {
    fn energies(&self) -> &[f64] {
        Shells::energies(self)
    }
}

/// What a body is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stuff {
    Tetrahedra,
    Shell,
}

/// A way to make a deformer for a body with handles.
#[derive(Clone, Copy)]
pub struct Maker {
    pub name: &'static str,
    pub stuff: Stuff,
    make: fn(&Posable, &[Handle]) -> Box<dyn Watched>,
}

impl Maker {
    pub fn make(&self, body: &Posable, handles: &[Handle]) -> Box<dyn Watched> {
        (self.make)(body, handles)
    }
}

/// All deformers under the laws: a new one is one more entry.
pub const MAKERS: [Maker; 3] = [
    Maker { name: "volumetric", stuff: Stuff::Tetrahedra, make: |b, h| volumetric(b, h, Options::default()) },
    Maker {
        name: "volumetric without bulk",
        stuff: Stuff::Tetrahedra,
        make: |b, h| volumetric(b, h, Options { bulk: 0.0, ..Options::default() }),
    },
    Maker { name: "shells with examples", stuff: Stuff::Shell, make: |b, h| shell(b, h, |_| ()) },
];

/// Those that do not end before a frame is solved almost to rounding: for poses that are reached by two ways.
pub const EXACT: [Maker; 2] = [
    Maker {
        name: "volumetric, converged",
        stuff: Stuff::Tetrahedra,
        make: |b, h| volumetric(b, h, Options { tolerance: Options::CONVERGED, ..Options::default() }),
    },
    Maker {
        name: "shells with examples, converged",
        stuff: Stuff::Shell,
        make: |b, h| shell(b, h, |o| (o.steps, o.decrease, o.still) = (60, 1e-10, 1e-8)),
    },
];

fn volumetric(body: &Posable, handles: &[Handle], options: Options) -> Box<dyn Watched> {
    Box::new(Volumetric::new(&body.proxy, handles, &options).unwrap())
}

fn shell(body: &Posable, handles: &[Handle], change: fn(&mut shells::Options)) -> Box<dyn Watched> {
    let mut options = shells::Options::for_examples(body.examples.len());
    change(&mut options);
    let body = Body { proxy: body.proxy.clone(), examples: body.examples.clone(), ..Body::default() };
    Box::new(Shells::new(&body, handles, &[], &options).unwrap())
}

/// What a deformer is made for.
#[derive(Clone)]
pub struct Posable {
    pub proxy: Proxy,
    /// Of a shell: positions of its vertices in other poses.
    pub examples: Vec<Vec<DVec3>>,
    /// Vertices, without the points off the triangles that a shell's proxy has after them.
    pub vertices: usize,
}

/// A motion of space that drags the handles along.
pub struct Take {
    pub name: &'static str,
    /// Where a point at rest is at a time from 0, when everything is at rest, to 1.
    pub motion: fn(f64, DVec3) -> DVec3,
}

/// The takes of the laws.
pub const TAKES: [Take; 3] = [
    Take { name: "twist", motion: |t, p| DQuat::from_rotation_y(2.4 * t * p.y) * p },
    Take { name: "bend", motion: |t, p| DQuat::from_rotation_z(1.2 * t * p.y) * p + DVec3::X * (0.2 * t * p.y * p.y) },
    Take {
        name: "wave",
        motion: |t, p| {
            let wave =
                DVec3::new(0.0, (7.0 * p.x + 5.0 * t).sin() - (7.0 * p.x).sin(), (6.0 * p.y - 4.0 * t).cos() - (6.0 * p.y).cos());
            DQuat::from_rotation_y(0.7 * t) * (p + wave * 0.02) + DVec3::new(0.6 * t, 0.1 * t, 0.0)
        },
    },
];

/// Handles of a case, on the farthest points of the shape.
const HANDLES: usize = 16;
/// Vertices of the surface of a body.
const VERTICES: usize = 500;

/// A shape with its body, map and handles.
pub struct Case {
    pub shape: Shape,
    pub body: Posable,
    pub map: SurfaceMap,
    pub handles: Vec<Handle>,
    /// Attachment of each handle.
    pub rest: Vec<DVec3>,
}

impl Case {
    /// A body of tetrahedra.
    pub fn new(shape: Shape, kind: MapKind) -> Self {
        let options = BuildOptions { surface_vertices: VERTICES };
        let proxy = build(&shape.points, &shape.triangles, &options, &|| Ok(())).unwrap().proxy;
        let map = SurfaceMap::build(&proxy, &shape.points, kind).unwrap();
        let rows = HandleRows::new(&proxy, kind);
        let rest = shape.spread(HANDLES);
        let handles = rest.iter().enumerate().map(|(i, &p)| handle(i, rows.row(p))).collect();
        let body = Posable { vertices: proxy.rest.len(), proxy, examples: Vec::new() };
        Self { shape, body, map, handles, rest }
    }

    /// A shell, with examples.
    pub fn shell(shape: Shape) -> Self {
        let examples = shape.examples();
        let body = Body::build(&shape.points, &shape.triangles, &examples, VERTICES, &|| Ok(())).unwrap();
        let mut faces = Faces::default();
        shape.triangles.iter().for_each(|t| faces.push(*t));
        let map = SurfaceMap::build_for_shell(&body, &shape.points, &faces, &examples);
        let rows = SurfaceRows::new(&body);
        let mut rest = shape.spread(HANDLES);
        // Surfaces that run into each other hold by handles of their own.
        let components = body.proxy.components.iter().max().map_or(0, |last| last + 1);
        if components > 1 {
            let corner = |t: usize| body.proxy.rest[body.proxy.boundary[t][0] as usize];
            for component in 0..components {
                let own: Vec<usize> = (0..body.proxy.boundary.len()).filter(|t| body.proxy.components[*t] == component).collect();
                rest.extend((0..4).map(|k| corner(own[k * (own.len() - 1) / 3])));
            }
        }
        let handles = rest.iter().enumerate().map(|(i, &p)| handle(i, rows.row(p))).collect();
        let vertices = body.vertices();
        Self { shape, body: Posable { proxy: body.proxy, examples: body.examples, vertices }, map, handles, rest }
    }

    /// A deformer for this case.
    pub fn make(&self, maker: Maker) -> Box<dyn Watched> {
        maker.make(&self.body, &self.handles)
    }

    pub fn targets(&self, motion: impl Fn(DVec3) -> DVec3) -> Targets {
        Targets { positions: self.rest.iter().map(|&p| motion(p)).collect(), presence: vec![1.0; self.rest.len()] }
    }

    /// Targets of a take at a time from 0 to 1.
    pub fn at(&self, take: &Take, t: f64) -> Targets {
        self.targets(|p| (take.motion)(t, p))
    }

    /// A deformer that has played `frames` frames of a take after its start at rest; `see` is called after each.
    pub fn play(&self, maker: Maker, take: &Take, frames: usize, mut see: impl FnMut(&dyn Watched)) -> Box<dyn Watched> {
        let mut deformer = self.make(maker);
        deformer.start(&self.at(take, 0.0)).unwrap();
        see(&*deformer);
        for k in 1..=frames {
            deformer.step(&self.at(take, k as f64 / frames as f64)).unwrap();
            see(&*deformer);
        }
        deformer
    }

    pub fn surface(&self, pose: &[DVec3]) -> Vec<DVec3> {
        let mut out = vec![Vec::new()];
        self.map.apply(&[pose], &mut out);
        out[0].iter().map(|p| DVec3::from(p.map(f64::from))).collect()
    }

    /// Largest distance of the posed scan from the scan under a motion.
    pub fn error(&self, pose: &[DVec3], motion: impl Fn(DVec3) -> DVec3) -> f64 {
        largest(self.surface(pose).iter().zip(&self.shape.points).map(|(p, &q)| p.distance(motion(q))))
    }
}

/// The largest of them; NaN if one is.
pub fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |m, x| if x <= m { m } else { x })
}

/// Largest distance of a point from its partner.
pub fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    largest(a.iter().zip(b).map(|(p, q)| p.distance(*q)))
}

fn handle(number: usize, row: SparseRow) -> Handle {
    Handle { name: format!("h{number}"), row, beta: 1.0 }
}

/// All meshes as bodies of this kind, made once.
pub fn cases(stuff: Stuff) -> &'static [Case] {
    static TETRAHEDRA: OnceLock<Vec<Case>> = OnceLock::new();
    static SHELLS: OnceLock<Vec<Case>> = OnceLock::new();
    match stuff {
        Stuff::Tetrahedra => TETRAHEDRA.get_or_init(|| shapes::all().into_iter().map(|s| Case::new(s, MapKind::Ring)).collect()),
        Stuff::Shell => SHELLS.get_or_init(|| shapes::all().into_iter().filter(|s| s.is_surface).map(Case::shell).collect()),
    }
}

/// The cases of every kind.
pub fn all_cases() -> impl Iterator<Item = &'static Case> {
    [Stuff::Tetrahedra, Stuff::Shell].into_iter().flat_map(cases)
}

/// A deformer with every mesh and every take.
pub fn with_all(maker: Maker) -> impl Iterator<Item = (Maker, &'static Case, &'static Take)> {
    cases(maker.stuff).iter().flat_map(move |c| TAKES.iter().map(move |t| (maker, c, t)))
}

/// Every deformer with every mesh and every take.
pub fn combinations() -> impl Iterator<Item = (Maker, &'static Case, &'static Take)> {
    MAKERS.into_iter().flat_map(with_all)
}
