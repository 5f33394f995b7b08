//! Steps on the whole mesh after the coarse one is solved (Fröhlich & Botsch 2011, §7, without an end at the coarse mesh).

use super::Options;
use super::body::{Body, tip};
use super::geometry::volume;
use super::newton::{Newton, Settings};
use super::pulls::Pulls;
use super::shell::Shell;
use crate::deform::{Deformer, FrameStats, Handle, OrientedHandle, Placement, Targets};
use crate::error::{Error, Result};
use crate::linalg::SparseRow;
use glam::DVec3;

/// A shell that is solved on a coarse mesh and then by a few steps on the whole one.
///
/// Those start where the coarse mesh puts it, with its weights, in every frame: nothing but the coarse pose is carried on, so that what a frame is does
/// not depend on how far the steps before it came.
pub struct Refined {
    coarse: Box<dyn Deformer>,
    /// From the coarse proxy to each vertex of the whole mesh.
    rows: Vec<SparseRow>,
    newton: Newton,
    pulls: Pulls,
    settings: Settings,
    x: Vec<DVec3>,
    weights: Vec<f64>,
    pose: Vec<DVec3>,
}

impl Refined {
    /// `coarse`: the deformer of the coarse mesh; `rows`: from its proxy to each vertex of the whole mesh; `body`: the whole mesh, over whose proxy the
    /// handles are, in the order of those of the coarse one; `options`: as those of the coarse mesh, with stiffness and rigid parts by triangles of the whole one, and `steps` on it.
    ///
    /// # Errors
    /// Those of [`Shells::new`](super::Shells::new).
    pub fn new(
        coarse: Box<dyn Deformer>,
        rows: Vec<SparseRow>,
        body: &Body,
        handles: &[Handle],
        oriented: &[OrientedHandle],
        options: &Options,
    ) -> Result<Self> {
        crate::deform::volumetric::check_handles(&body.proxy, handles)?;
        let n = body.vertices();
        let faces = &body.proxy.boundary;
        let stiffness = options.stiffness(faces.len())?;
        let rest = &body.proxy.rest[..n];
        let shell = Shell::new(rest, faces, &body.examples, &options.material, &stiffness)?;
        let pulls = Pulls::new(&body.proxy, handles, oriented, options.hardness / shell.size.powi(2));
        Ok(Self {
            newton: Newton::new(shell, &pulls.held(n), pulls.grips()),
            weights: vec![0.0; body.examples.len()],
            coarse,
            rows,
            pulls,
            settings: options.settings(body.examples.len()),
            x: rest.to_vec(),
            pose: body.proxy.rest.clone(),
        })
    }

    fn refine(&mut self, targets: &Targets, found: FrameStats) -> Result<FrameStats> {
        self.pulls.take(targets)?;
        if !self.pulls.any() {
            return Ok(found);
        }
        self.x.iter_mut().zip(&self.rows).for_each(|(p, row)| *p = row.apply(self.coarse.pose()));
        self.weights.copy_from_slice(self.coarse.weights());
        self.pulls.settle(&mut self.x, None);
        let minimum = self.newton.minimize(&mut self.x, &mut self.weights, &self.pulls.goals(), &self.settings);
        if !minimum.energy().is_finite() || self.x.iter().any(|p| !p.is_finite()) {
            return Err(Error::refused("the pose of the whole mesh is not finite").expected("targets within reach of the body"));
        }
        let shell = &self.newton.shell;
        let n = self.x.len();
        self.pose[..n].copy_from_slice(&self.x);
        for (point, face) in self.pose[n..].iter_mut().zip(&shell.faces) {
            *point = tip(&self.x, *face);
        }
        let now = volume(&self.x, &shell.faces, &shell.topology.holes);
        Ok(FrameStats {
            passes: found.passes + minimum.steps,
            step: minimum.last.map_or(0.0, |moves| moves.most),
            // So few steps do not say how far the pose of the whole mesh is from solved.
            error: None,
            energy: minimum.energy(),
            volume_ratio: if shell.swell > 0.0 { now / shell.volume } else { 1.0 },
            ..found
        })
    }
}

impl Deformer for Refined {
    fn start(&mut self, targets: &Targets) -> Result<FrameStats> {
        let found = self.coarse.start(targets)?;
        self.refine(targets, found)
    }

    fn step(&mut self, targets: &Targets) -> Result<FrameStats> {
        let found = self.coarse.step(targets)?;
        self.refine(targets, found)
    }

    fn place(&mut self, placements: &[Placement]) -> Result<()> {
        self.coarse.place(placements)?;
        self.pulls.place(placements)
    }

    fn pose(&self) -> &[DVec3] {
        &self.pose
    }

    fn weights(&self) -> &[f64] {
        &self.weights
    }
}
