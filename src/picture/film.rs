//! Many pictures of one moving surface, all at one scale, and animations of them.

use super::camera::{Axes, Camera};
use super::canvas::Canvas;
use super::raster::Plane;
use super::shading::Shaded;
use super::{GAP, INK, MARGIN, PAPER, Picture, Surface, lettering, shortened};
use crate::error::{Error, Result};
use glam::DVec3;

/// Lines of the floor.
const FLOOR: [u8; 3] = [222, 222, 218];
/// Space between what is seen and the edge, as a fraction of the picture.
const EDGE: f64 = 0.02;
/// Lines of the floor on each side of its middle.
const FLOOR_LINES: i32 = 7;

/// A camera with a picture of a fixed size.
#[derive(Clone, Debug)]
pub struct Film {
    camera: Camera,
    width: usize,
    height: usize,
    floor: Option<Floor>,
}

/// A level grid.
#[derive(Clone, Copy, Debug)]
pub struct Floor {
    /// Direction up; of length 1.
    pub up: DVec3,
    /// Height along it.
    pub height: f64,
    /// From line to line.
    pub cell: f64,
    /// Around which the lines lie; it goes along with the camera.
    pub middle: DVec3,
}

impl Film {
    /// Sees the window `lo` to `hi` in a view's directions, in at most so many pixels per side.
    pub fn new(axes: Axes, lo: [f64; 2], hi: [f64; 2], most: usize, floor: Option<Floor>) -> Self {
        let extent = [0, 1].map(|k| (hi[k] - lo[k]).max(1e-9));
        let edge = (most as f64 * EDGE).ceil();
        let scale = (most as f64 - 2.0 * edge) / extent[0].max(extent[1]);
        let size = extent.map(|e| (e * scale + 2.0 * edge).ceil().min(most as f64).max(1.0));
        let centre = axes.right * ((lo[0] + hi[0]) / 2.0) + axes.up * ((lo[1] + hi[1]) / 2.0);
        let camera = Camera { right: axes.right, up: axes.up, toward: axes.toward, centre, scale, middle: size.map(|s| s / 2.0) };
        Self { camera, width: size[0] as usize, height: size[1] as usize, floor }
    }

    /// Pixels in a row, and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// The surface as it is now, the camera moved by `shift`. `diagonal`: size of the surface.
    pub fn picture(&self, surface: &Surface<'_>, shift: DVec3, diagonal: f64) -> Picture {
        let mut camera = self.camera.clone();
        camera.centre += shift;
        let mut canvas = Canvas::new(self.width, self.height, PAPER);
        if let Some(floor) = &self.floor {
            floor.draw(&camera, floor.middle + shift, &mut canvas);
        }
        let mut plane = Plane::new(self.width, self.height);
        plane.draw(&[Shaded::new(surface)], &camera, diagonal);
        canvas.paste(&plane, 0, 0);
        canvas.finish()
    }
}

impl Floor {
    /// Lines at whole multiples of the cell, those around `middle`: the floor stands still where the camera moves.
    fn draw(&self, camera: &Camera, middle: DVec3, canvas: &mut Canvas) {
        let across = camera.toward.cross(self.up);
        let Some(across) = across.try_normalize() else { return };
        let along = self.up.cross(across);
        for (a, b) in [(across, along), (along, across)] {
            let (first, centre) = ((middle.dot(a) / self.cell).round(), (middle.dot(b) / self.cell).round() * self.cell);
            for k in -FLOOR_LINES..=FLOOR_LINES {
                let base = a * ((first + f64::from(k)) * self.cell) + self.up * self.height;
                let end = |side: f64| {
                    let [x, y, _] = camera.project(base + b * (centre + side * f64::from(FLOOR_LINES) * self.cell));
                    [x, y]
                };
                canvas.line(end(-1.0), end(1.0), 1.0, FLOOR, 1.0);
            }
        }
    }
}

/// Pictures of one size with a title under each, side by side in so many columns, under a heading.
///
/// Panics without any picture.
pub fn contact_sheet(pictures: &[(Picture, String)], columns: usize, heading: &[String]) -> Picture {
    let [width, height] = [pictures[0].0.width, pictures[0].0.height];
    let line = lettering::LINE;
    let titles = pictures.iter().map(|(_, title)| lettering::width(title)).max().unwrap_or(0);
    let cell = [width.max(titles) + GAP / 2, height + line + GAP / 2];
    let top = MARGIN + heading.len() * line + GAP / 2;
    let total = [2 * MARGIN + columns * cell[0], top + pictures.len().div_ceil(columns) * cell[1] + MARGIN / 2];
    let mut canvas = Canvas::new(total[0], total[1], PAPER);
    for (i, text) in heading.iter().enumerate() {
        let fits = (total[0] - 2 * MARGIN) / lettering::ADVANCE;
        canvas.text(MARGIN as f32, (MARGIN + i * line) as f32, &shortened(text, fits), INK);
    }
    for (i, (picture, title)) in pictures.iter().enumerate() {
        let (left, top) = (MARGIN + i % columns * cell[0], top + i / columns * cell[1]);
        canvas.copy(picture, left + (cell[0] - width) / 2, top);
        let x = left + (cell[0] - lettering::width(title)) / 2;
        canvas.text(x as f32, (top + height + 4) as f32, title, INK);
    }
    canvas.finish()
}

/// Writes an animation that repeats for ever (APNG): of each picture what differs from the one before.
pub struct Animation<W: std::io::Write> {
    writer: png::Writer<W>,
    before: Option<Picture>,
}

impl<W: std::io::Write> Animation<W> {
    /// `pictures` of one size, `fps` per second.
    ///
    /// Errors, here and in the other functions: a file that cannot be written.
    pub fn begin(out: W, [width, height]: [usize; 2], pictures: usize, fps: f64) -> Result<Self> {
        let small = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let mut encoder = png::Encoder::new(out, small(width), small(height));
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_compression(png::Compression::High);
        encoder.set_animated(small(pictures), 0).map_err(failed)?;
        let (numerator, denominator) = if fps.fract() == 0.0 { (1, fps as u16) } else { ((1000.0 / fps).round() as u16, 1000) };
        encoder.set_frame_delay(numerator, denominator).map_err(failed)?;
        Ok(Self { writer: encoder.write_header().map_err(failed)?, before: None })
    }

    /// Adds a picture.
    pub fn push(&mut self, picture: Picture) -> Result<()> {
        let [x, y, width, height] = self.before.as_ref().map_or([0, 0, picture.width, picture.height], |b| changed(b, &picture));
        if self.before.is_some() {
            let small = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
            self.writer.reset_frame_position().map_err(failed)?;
            self.writer.set_frame_dimension(small(width), small(height)).map_err(failed)?;
            self.writer.set_frame_position(small(x), small(y)).map_err(failed)?;
        }
        let rows = picture.pixels.chunks_exact(picture.width).skip(y).take(height);
        let part: Vec<u8> = rows.flat_map(|row| row[x..x + width].as_flattened()).copied().collect();
        self.writer.write_image_data(&part).map_err(failed)?;
        self.before = Some(picture);
        Ok(())
    }

    /// Completes the file.
    pub fn finish(self) -> Result<()> {
        self.writer.finish().map_err(failed)
    }
}

fn failed(e: png::EncodingError) -> Error {
    match e {
        png::EncodingError::IoError(e) => Error::new(crate::error::Kind::Unwritable, e.to_string()),
        other => Error::refused(other.to_string()),
    }
}

/// Left, top, width and height of what differs; one pixel where nothing does.
fn changed(a: &Picture, b: &Picture) -> [usize; 4] {
    let rows = || a.pixels.chunks_exact(a.width).zip(b.pixels.chunks_exact(a.width));
    let differs = |(p, q): &(&[u8; 3], &[u8; 3])| p != q;
    let (mut lo, mut hi) = ([usize::MAX; 2], [0; 2]);
    for (y, (p, q)) in rows().enumerate().filter(|(_, (p, q))| p != q) {
        let first = p.iter().zip(q).position(|pair| differs(&pair)).unwrap_or(0);
        let last = p.iter().zip(q).rposition(|pair| differs(&pair)).unwrap_or(0);
        lo = [lo[0].min(first), lo[1].min(y)];
        hi = [hi[0].max(last), hi[1].max(y)];
    }
    if lo[1] == usize::MAX { [0, 0, 1, 1] } else { [lo[0], lo[1], hi[0] - lo[0] + 1, hi[1] - lo[1] + 1] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_changed_is_the_smallest_box() {
        let a = Picture { width: 5, height: 4, pixels: vec![[9; 3]; 20] };
        let mut b = a.clone();
        assert_eq!(changed(&a, &b), [0, 0, 1, 1]);
        (b.pixels[5 + 3], b.pixels[2 * 5 + 1]) = ([0; 3], [1; 3]);
        assert_eq!(changed(&a, &b), [1, 1, 3, 2]);
    }
}
