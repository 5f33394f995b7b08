//! From space to pixels.

use glam::{DVec3, Vec3};

/// Directions of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    /// To the right in the picture.
    pub right: DVec3,
    /// Up in the picture.
    pub up: DVec3,
    /// To the eye.
    pub toward: DVec3,
}

impl Axes {
    /// A view from `toward`; `up` may be any direction that is not along it.
    pub fn new(toward: DVec3, up: DVec3) -> Self {
        let toward = toward.try_normalize().unwrap_or(DVec3::Z);
        let right = up.cross(toward).try_normalize().unwrap_or_else(|| toward.any_orthonormal_vector());
        Self { right, up: toward.cross(right), toward }
    }

    /// Where a point is in the picture, in units of space.
    pub fn place(&self, p: DVec3) -> [f64; 2] {
        [p.dot(self.right), p.dot(self.up)]
    }
}

/// From space to pixels.
#[derive(Clone, Debug)]
pub(super) struct Camera {
    pub(super) right: DVec3,
    pub(super) up: DVec3,
    pub(super) toward: DVec3,
    /// What is in the middle of the picture.
    pub(super) centre: DVec3,
    /// Pixels per unit.
    pub(super) scale: f64,
    /// The middle of the picture, in pixels.
    pub(super) middle: [f64; 2],
}

impl Camera {
    /// A camera that sees the whole box in so many rows, and the width of its picture, at most `widest` times the height.
    pub(super) fn new(toward: DVec3, up: DVec3, corners: [DVec3; 2], height: usize, widest: f64) -> (Self, usize) {
        let Axes { right, up, toward } = Axes::new(toward, up);
        let [lo, hi] = corners;
        let half = (hi - lo) * 0.5;
        let extent = |axis: DVec3| (axis.abs().dot(half) * 2.0).max(f64::MIN_POSITIVE);
        // A little more than the box, for marks at its edge.
        let edge = 16.0_f64.min(height as f64 / 8.0);
        let fit = |pixels: f64, axis: DVec3| (pixels - 2.0 * edge) / extent(axis);
        let scale = fit(height as f64, up).min(fit(height as f64 * widest, right));
        let width = (extent(right) * scale + 2.0 * edge).ceil().max(1.0);
        let middle = [width * 0.5, height as f64 * 0.5];
        (Self { right, up, toward, centre: (lo + hi) * 0.5, scale, middle }, width as usize)
    }

    /// Pixels from the left and the top, and the distance towards the eye in units of space.
    pub(super) fn project(&self, p: DVec3) -> [f32; 3] {
        let d = p - self.centre;
        let x = self.middle[0] + d.dot(self.right) * self.scale;
        let y = self.middle[1] - d.dot(self.up) * self.scale;
        [x as f32, y as f32, d.dot(self.toward) as f32]
    }

    pub(super) fn turn(&self, n: Vec3) -> Vec3 {
        Vec3::new(n.dot(self.right.as_vec3()), n.dot(self.up.as_vec3()), n.dot(self.toward.as_vec3()))
    }
}
