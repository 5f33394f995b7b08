//! Pictures for people: shaded surfaces from several sides, with points and names, as PNG.
//!
//! Drawn by the program itself, so that they look the same everywhere; the same bytes for any number of threads.

mod camera;
mod canvas;
pub(crate) mod film;
mod labels;
mod lettering;
mod light;
mod raster;
mod shading;
mod texture;

use crate::error::{Error, Result};
pub(crate) use camera::Axes;
use camera::Camera;
use canvas::Canvas;
use glam::DVec3;
use labels::{Column, Slot};
use raster::Plane;
use shading::Shaded;

pub use texture::Texture;

/// Colour of surfaces that have none, sRGB.
pub const CLAY: [u8; 3] = [208, 202, 193];
/// The background, sRGB.
const PAPER: [u8; 3] = [246, 246, 244];
const INK: [u8; 3] = [52, 54, 58];
const LEADER: [u8; 3] = [150, 152, 156];
/// Space around everything, in pixels.
const MARGIN: usize = 24;
/// Space between a figure and the names beside it, in pixels.
const GAP: usize = 22;
/// Widest figure, as a multiple of the height of the sheet's views.
const WIDEST: f64 = 1.6;
/// Marks that lie behind the surface by more than this are hidden; in diagonals of the surface.
const BEHIND: f64 = 0.012;
/// Opacity of what is hidden.
const FAINT: f32 = 0.22;

/// Triangles with their colours.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Positions, in any unit.
    pub points: &'a [DVec3],
    /// Triangles over `points`; their orientation does not matter.
    pub triangles: &'a [[u32; 3]],
    /// Their colours.
    pub colors: Colors<'a>,
}

/// Colours of a surface, sRGB.
#[derive(Clone, Copy, Debug, Default)]
pub enum Colors<'a> {
    /// [`CLAY`].
    #[default]
    Plain,
    /// One for each point.
    PerVertex(&'a [[u8; 3]]),
    /// One for each triangle.
    PerFace(&'a [[u8; 3]]),
    /// Taken from images.
    Images {
        /// Texture coordinates of the corners of each triangle, origin at the lower left.
        uvs: &'a [[[f32; 2]; 3]],
        /// The images.
        images: &'a [Texture],
        /// Which of them each triangle has.
        of: &'a [u32],
    },
}

/// A side from which the surface is seen, without perspective.
#[derive(Clone, Debug)]
pub struct View {
    /// What is written under it.
    pub title: String,
    /// Direction from the surface to the eye; any length.
    pub toward: DVec3,
    /// Direction that is up in the picture; any length, not along `toward`.
    pub up: DVec3,
}

/// A point on a surface or in it.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Where it is.
    pub at: DVec3,
    /// Its name; empty: none is written. Long ones are cut.
    pub name: String,
    /// sRGB.
    pub color: [u8; 3],
    /// How it is drawn.
    pub shape: Shape,
    /// Whether it shines through the surface. Others are faint, and not named, where the surface hides them; what all views hide is named in the first.
    pub through: bool,
}

/// How a mark is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A filled disc.
    Dot,
    /// A circle.
    Ring,
    /// A small square.
    Square,
}

/// A straight line in space; it shines through the surface.
#[derive(Clone, Copy, Debug)]
pub struct Stroke {
    /// Where it begins.
    pub from: DVec3,
    /// Where it ends.
    pub to: DVec3,
    /// sRGB.
    pub color: [u8; 3],
    /// Width in pixels.
    pub width: f32,
    /// 0 to 1.
    pub opacity: f32,
}

/// What a picture shows: each view shows everything.
#[derive(Clone, Debug)]
pub struct Sheet<'a> {
    /// The surfaces.
    pub surfaces: Vec<Surface<'a>>,
    /// The views, side by side from left to right.
    pub views: Vec<View>,
    /// Points.
    pub marks: Vec<Mark>,
    /// Lines.
    pub strokes: Vec<Stroke>,
    /// Lines of text above the views; what is too long for the sheet is cut.
    pub heading: Vec<String>,
    /// Words with a mark in front of them, below the views.
    pub legend: Vec<(Shape, [u8; 3], String)>,
    /// Height of the views in pixels, at least 32.
    pub height: usize,
}

impl Default for Sheet<'_> {
    fn default() -> Self {
        Self {
            surfaces: Vec::new(),
            views: Vec::new(),
            marks: Vec::new(),
            strokes: Vec::new(),
            heading: Vec::new(),
            legend: Vec::new(),
            height: 1000,
        }
    }
}

/// A picture, from the top row down.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// sRGB; one per pixel.
    pub pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// This picture with another to its right, both from the top.
    pub fn beside(self, right: &Picture) -> Picture {
        let (width, height) = (self.width + right.width, self.height.max(right.height));
        let mut pixels = vec![PAPER; width * height];
        for (picture, left) in [(&self, 0), (right, self.width)] {
            for (row, from) in picture.pixels.chunks_exact(picture.width.max(1)).enumerate() {
                pixels[row * width + left..][..picture.width].copy_from_slice(from);
            }
        }
        Picture { width, height, pixels }
    }

    /// The bytes of a PNG file.
    ///
    /// Errors: a picture without pixels, or larger than PNG allows.
    pub fn png(&self) -> Result<Vec<u8>> {
        let fail = |e: png::EncodingError| Error::refused(format!("a picture of {} × {} pixels: {e}", self.width, self.height));
        let size = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size(self.width), size(self.height));
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header().map_err(fail)?;
        writer.write_image_data(self.pixels.as_flattened()).map_err(fail)?;
        writer.finish().map_err(fail)?;
        Ok(bytes)
    }
}

/// Draws a sheet.
///
/// Surfaces with points that are not finite are drawn without the triangles there; marks and strokes at such points are left out.
/// Panics when a triangle names a point that is not there, or when there are fewer colours than points or triangles.
pub fn draw(sheet: &Sheet<'_>) -> Picture {
    let height = sheet.height.max(32);
    let shaded: Vec<Shaded> = sheet.surfaces.iter().map(Shaded::new).collect();
    let bounds = Bounds::of(sheet);
    let planes: Vec<Panel> = sheet.views.iter().map(|view| Panel::render(&shaded, view, &bounds, height)).collect();
    let hidden = bounds.diagonal * BEHIND;
    let marks: Vec<&Mark> = sheet.marks.iter().filter(|m| m.at.is_finite()).collect();
    let seen: Vec<Vec<bool>> = planes.iter().map(|p| marks.iter().map(|m| m.through || p.sees(m.at, hidden)).collect()).collect();
    let named = |view: usize, mark: usize| {
        let nowhere = || seen.iter().all(|view| !view[mark]);
        !marks[mark].name.is_empty() && (seen[view][mark] || view == 0 && nowhere())
    };

    let line = lettering::LINE;
    let top = MARGIN + sheet.heading.len() * line + if sheet.heading.is_empty() { 0 } else { GAP / 2 };
    let bottom = GAP / 2 + line + if sheet.legend.is_empty() { 0 } else { line + GAP / 2 } + MARGIN;
    let mut layouts = Vec::new();
    let mut left = MARGIN;
    for (v, panel) in planes.iter().enumerate() {
        let names = (0..marks.len()).filter(|&m| named(v, m));
        let dots = names.map(|m| (m, panel.camera.project(marks[m].at))).map(|(m, [x, y, _])| (m, [x, y]));
        let (before, behind) = labels::columns(dots, &|m: usize| lettering::width(cut(&marks[m].name)), height, panel.middle());
        let figure = left + before.width() + if before.slots.is_empty() { 0 } else { GAP };
        let after = figure + panel.plane.width + if behind.slots.is_empty() { 0 } else { GAP };
        let end = after + behind.width();
        layouts.push(Layout { figure, before: (before, left), behind: (behind, after) });
        left = end + 2 * GAP;
    }
    let legend: usize = sheet.legend.iter().map(|(_, _, words)| lettering::width(words) + 44).sum();
    let width = left.saturating_sub(2 * GAP).max(legend + MARGIN) + MARGIN;
    let mut canvas = Canvas::new(width, top + height + bottom, PAPER);

    for (i, text) in sheet.heading.iter().enumerate() {
        let fits = (width - 2 * MARGIN) / lettering::ADVANCE;
        canvas.text(MARGIN as f32, (MARGIN + i * line) as f32, &shortened(text, fits), INK);
    }
    for ((v, panel), layout) in planes.iter().enumerate().zip(&layouts) {
        canvas.paste(&panel.plane, layout.figure, top);
        let place = |p: DVec3| {
            let [x, y, _] = panel.camera.project(p);
            [x + layout.figure as f32, y + top as f32]
        };
        for s in sheet.strokes.iter().filter(|s| s.from.is_finite() && s.to.is_finite()) {
            canvas.line(place(s.from), place(s.to), s.width, s.color, s.opacity);
        }
        for (column, x, inner) in [
            (&layout.before.0, layout.before.1, layout.before.1 + layout.before.0.width()),
            (&layout.behind.0, layout.behind.1, layout.behind.1),
        ] {
            for Slot { item, y, .. } in &column.slots {
                let to = place(marks[*item].at);
                let opacity = if seen[v][*item] { 0.9 } else { 2.0 * FAINT };
                let (y, name) = (*y + top as f32, cut(&marks[*item].name));
                let start = if x == inner { inner as f32 - 4.0 } else { inner as f32 + 4.0 };
                canvas.line([start, y], to, 1.0, LEADER, opacity);
                let from = if x == inner { x } else { inner - lettering::width(name) };
                canvas.text(from as f32, y - lettering::MIDDLE, name, marks[*item].color.map(|c| c / 4 * 3));
            }
        }
        // What is hidden first: what is seen lies over it.
        for pass in [false, true] {
            for (mark, _) in marks.iter().zip(&seen[v]).filter(|(_, seen)| **seen == pass) {
                canvas.mark(place(mark.at), mark.shape, mark.color, if pass { 1.0 } else { FAINT });
            }
        }
        let title = &sheet.views[v].title;
        let x = (layout.figure + panel.plane.width / 2).saturating_sub(lettering::width(title) / 2);
        canvas.text(x as f32, (top + height + GAP / 2) as f32, title, INK);
    }
    let y = (top + height + GAP + line) as f32;
    let mut x = MARGIN as f32;
    for (shape, color, words) in &sheet.legend {
        canvas.mark([x + 6.0, y + lettering::MIDDLE], *shape, *color, 1.0);
        canvas.text(x + 18.0, y, words, INK);
        x += (lettering::width(words) + 44) as f32;
    }
    canvas.finish()
}

/// Longest name that is written whole.
const LONGEST: usize = 24;

fn cut(name: &str) -> &str {
    name.char_indices().nth(LONGEST).map_or(name, |(end, _)| &name[..end])
}

fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(3)).chain("...".chars()).collect()
}

/// Where the parts of a view are: the figure's left edge, and the names on both sides with the left edges of their columns.
struct Layout {
    figure: usize,
    before: (Column, usize),
    behind: (Column, usize),
}

/// The box of everything that is drawn.
struct Bounds {
    corners: [DVec3; 2],
    /// Of the surfaces.
    diagonal: f64,
}

impl Bounds {
    fn of(sheet: &Sheet<'_>) -> Self {
        let grow = |[lo, hi]: [DVec3; 2], p: DVec3| [lo.min(p), hi.max(p)];
        let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let used = |s: &Surface<'_>| {
            s.triangles
                .iter()
                .flatten()
                .map(|&v| s.points[v as usize])
                .fold(none, |b, p| if p.is_finite() { grow(b, p) } else { b })
        };
        let surfaces = sheet.surfaces.iter().map(used).fold(none, |b, s| grow(grow(b, s[0]), s[1]));
        let marks = sheet.marks.iter().map(|m| m.at).filter(|p| p.is_finite());
        let corners = marks.fold(surfaces, grow);
        let finite = |b: [DVec3; 2]| if b[0].is_finite() && b[1].is_finite() { b } else { [DVec3::ZERO, DVec3::ONE] };
        let [lo, hi] = finite(surfaces);
        Self { corners: finite(corners), diagonal: (hi - lo).length() }
    }
}

/// A view of the surfaces.
struct Panel {
    camera: Camera,
    plane: Plane,
}

impl Panel {
    fn render(shaded: &[Shaded], view: &View, bounds: &Bounds, height: usize) -> Self {
        let (camera, width) = Camera::new(view.toward, view.up, bounds.corners, height, WIDEST);
        let mut plane = Plane::new(width, height);
        plane.draw(shaded, &camera, bounds.diagonal);
        Self { camera, plane }
    }

    fn middle(&self) -> f32 {
        self.plane.width as f32 / 2.0
    }

    fn sees(&self, p: DVec3, tolerance: f64) -> bool {
        let [x, y, depth] = self.camera.project(p);
        self.plane.nearest(x, y).is_none_or(|nearest| f64::from(depth) > f64::from(nearest) - tolerance)
    }
}

#[cfg(test)]
mod tests;
