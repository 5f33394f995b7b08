//! Meshes with proxy, map and handles; takes; and the deformers that are put through the laws.

use super::shapes::{self, Shape};
use glam::{DQuat, DVec3};
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::deform::{Deformer, Handle, Targets};
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::proxy::{BuildOptions, Proxy, build};
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

/// A way to make a deformer for a body with handles.
#[derive(Clone, Copy)]
pub struct Maker {
    pub name: &'static str,
    pub make: fn(&Proxy, &[Handle]) -> Box<dyn Watched>,
}

/// All deformers under the laws: a new one is one more entry.
pub const MAKERS: [Maker; 2] = [
    Maker { name: "volumetric", make: |proxy, handles| volumetric(proxy, handles, Options::default()) },
    Maker {
        name: "volumetric without bulk",
        make: |proxy, handles| volumetric(proxy, handles, Options { bulk: 0.0, ..Options::default() }),
    },
];

/// One that does not end before a frame is solved almost to rounding: for poses that are reached by two ways.
pub const EXACT: Maker = Maker {
    name: "volumetric, converged",
    make: |proxy, handles| volumetric(proxy, handles, Options { tolerance: Options::CONVERGED, ..Options::default() }),
};

fn volumetric(proxy: &Proxy, handles: &[Handle], options: Options) -> Box<dyn Watched> {
    Box::new(Volumetric::new(proxy, handles, &options).unwrap())
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

/// A shape with its proxy, map and handles.
pub struct Case {
    pub shape: Shape,
    pub proxy: Proxy,
    pub map: SurfaceMap,
    pub handles: Vec<Handle>,
    /// Attachment of each handle.
    pub rest: Vec<DVec3>,
}

impl Case {
    pub fn new(shape: Shape, kind: MapKind) -> Self {
        let options = BuildOptions { surface_vertices: 500 };
        let proxy = build(&shape.points, &shape.triangles, &options, &|| Ok(())).unwrap().proxy;
        let map = SurfaceMap::build(&proxy, &shape.points, kind).unwrap();
        let rows = HandleRows::new(&proxy, kind);
        let rest = shape.spread(16);
        let handles =
            rest.iter().enumerate().map(|(i, &p)| Handle { name: format!("h{i}"), row: rows.row(p), beta: 1.0 }).collect();
        Self { shape, proxy, map, handles, rest }
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
        let mut deformer = (maker.make)(&self.proxy, &self.handles);
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

/// All meshes, made once.
pub fn cases() -> &'static [Case] {
    static CASES: OnceLock<Vec<Case>> = OnceLock::new();
    CASES.get_or_init(|| shapes::all().into_iter().map(|s| Case::new(s, MapKind::Ring)).collect())
}

/// A deformer with every mesh and every take.
pub fn with_all(maker: Maker) -> impl Iterator<Item = (Maker, &'static Case, &'static Take)> {
    cases().iter().flat_map(move |c| TAKES.iter().map(move |t| (maker, c, t)))
}

/// Every deformer with every mesh and every take.
pub fn combinations() -> impl Iterator<Item = (Maker, &'static Case, &'static Take)> {
    MAKERS.into_iter().flat_map(with_all)
}
