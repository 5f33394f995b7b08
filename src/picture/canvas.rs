//! The sheet that everything is drawn on.

use super::light::{linear_to_srgb, srgb_to_linear};
use super::raster::Plane;
use super::{Picture, Shape, lettering};
use rayon::prelude::*;

/// Radius of a dot in pixels.
const DOT: f32 = 4.2;
const WHITE: [u8; 3] = [255; 3];

pub(super) struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Canvas {
    pub(super) fn new(width: usize, height: usize, color: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![color.map(f32::from); width * height] }
    }

    fn blend(&mut self, x: i64, y: i64, color: [u8; 3], cover: f32) {
        if x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height {
            let pixel = &mut self.pixels[y as usize * self.width + x as usize];
            for (p, c) in pixel.iter_mut().zip(color) {
                *p += (f32::from(c) - *p) * cover;
            }
        }
    }

    /// Lays a view over the paper.
    pub(super) fn paste(&mut self, plane: &Plane, left: usize, top: usize) {
        let width = self.width;
        let rows = self.pixels.par_chunks_mut(width).skip(top).zip(plane.pixels.par_chunks(plane.width));
        rows.for_each(|(row, from)| {
            for (pixel, view) in row[left..].iter_mut().zip(from).filter(|(_, view)| view.cover > 0.0) {
                for (p, c) in pixel.iter_mut().zip(view.color) {
                    let paper = srgb_to_linear(*p / 255.0);
                    *p = linear_to_srgb(c + paper * (1.0 - view.cover)) * 255.0;
                }
            }
        });
    }

    /// Lays a picture over the paper.
    pub(super) fn copy(&mut self, picture: &Picture, left: usize, top: usize) {
        let rows = self.pixels.chunks_exact_mut(self.width).skip(top).zip(picture.pixels.chunks_exact(picture.width));
        for (row, from) in rows {
            row[left..].iter_mut().zip(from).for_each(|(pixel, p)| *pixel = p.map(f32::from));
        }
    }

    /// Blends all pixels near a box whose `cover` is not 0; `cover` gets the middle of a pixel.
    fn fill(&mut self, lo: [f32; 2], hi: [f32; 2], color: [u8; 3], cover: impl Fn([f32; 2]) -> f32) {
        let range = |a: f32, b: f32, most: usize| (a - 1.0).floor().max(0.0) as i64..=(b + 1.0).ceil().min(most as f32) as i64;
        for y in range(lo[1], hi[1], self.height) {
            for x in range(lo[0], hi[0], self.width) {
                let c = cover([x as f32 + 0.5, y as f32 + 0.5]);
                if c > 0.0 {
                    self.blend(x, y, color, c.min(1.0));
                }
            }
        }
    }

    pub(super) fn line(&mut self, a: [f32; 2], b: [f32; 2], width: f32, color: [u8; 3], opacity: f32) {
        let d = [b[0] - a[0], b[1] - a[1]];
        let square = (d[0] * d[0] + d[1] * d[1]).max(1e-9);
        let cover = |p: [f32; 2]| {
            let t = (((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / square).clamp(0.0, 1.0);
            let distance = (p[0] - a[0] - d[0] * t).hypot(p[1] - a[1] - d[1] * t);
            (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0) * opacity
        };
        let half = width / 2.0;
        self.fill([a[0].min(b[0]) - half, a[1].min(b[1]) - half], [a[0].max(b[0]) + half, a[1].max(b[1]) + half], color, cover);
    }

    pub(super) fn mark(&mut self, at: [f32; 2], shape: Shape, color: [u8; 3], opacity: f32) {
        let (lo, hi) = ([at[0] - DOT - 2.0, at[1] - DOT - 2.0], [at[0] + DOT + 2.0, at[1] + DOT + 2.0]);
        let round = |p: [f32; 2]| (p[0] - at[0]).hypot(p[1] - at[1]);
        let square = |p: [f32; 2]| (p[0] - at[0]).abs().max((p[1] - at[1]).abs());
        let disc = |distance: f32, radius: f32| (radius + 0.5 - distance).clamp(0.0, 1.0) * opacity;
        match shape {
            Shape::Dot => {
                self.fill(lo, hi, WHITE, |p| disc(round(p), DOT + 1.4));
                self.fill(lo, hi, color, |p| disc(round(p), DOT));
            }
            Shape::Square => {
                self.fill(lo, hi, WHITE, |p| disc(square(p), DOT - 0.4));
                self.fill(lo, hi, color, |p| disc(square(p), DOT - 1.4));
            }
            Shape::Ring => {
                self.fill(lo, hi, WHITE, |p| disc((round(p) - DOT).abs(), 1.5) * 0.7);
                self.fill(lo, hi, color, |p| disc((round(p) - DOT).abs(), 0.8));
            }
        }
    }

    pub(super) fn text(&mut self, x: f32, y: f32, text: &str, color: [u8; 3]) {
        lettering::write(x, y, text, |x, y, cover| self.blend(x, y, color, cover));
    }

    pub(super) fn finish(self) -> Picture {
        let pixels = self.pixels.iter().map(|p| p.map(|c| (c + 0.5) as u8)).collect();
        Picture { width: self.width, height: self.height, pixels }
    }
}
