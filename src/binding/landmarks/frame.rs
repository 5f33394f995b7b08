//! The directions of a body.

use glam::DVec3;

/// Up, forward and left of a body.
pub(super) struct Frame {
    pub(super) up: DVec3,
    pub(super) forward: DVec3,
    pub(super) left: DVec3,
}

impl Frame {
    pub(super) fn new(up: DVec3, forward: DVec3) -> Option<Self> {
        let forward = forward.reject_from_normalized(up).try_normalize()?;
        Some(Self { up, forward, left: up.cross(forward) })
    }

    /// A vector given outwards, upwards and forwards; outwards is left for the left side and right for the right one.
    pub(super) fn vector(&self, side: f64, [out, up, forward]: [f64; 3]) -> DVec3 {
        self.left * (side * out) + self.up * up + self.forward * forward
    }
}
