//! Pictures of the result, drawn by the program itself: a sheet of chosen frames (`.png`), and the whole take as a small animation (`.apng`).
//!
//! Poses of the frames that are shown are kept on disk until the end, since only then it is known what has to be in view.

use super::encode::spool::Spool;
use super::files::{Pending, folder_of};
use super::{FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Error, Notes, Result};
use crate::picture::Axes;
use crate::picture::film::{Animation, Film, Floor, contact_sheet};
use crate::picture::{CLAY, Colors, Picture, Surface, Texture};
use crate::scan::{NONE, Scan};
use crate::words;
use glam::{DQuat, DVec3};
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::sync::Arc;

/// Pictures of a sheet.
const SHEET: usize = 12;
/// Longer side of each in pixels.
const SHEET_SIZE: usize = 360;
/// Pictures per second of an animation.
const FPS: f64 = 15.0;
/// Longer side in pixels.
const PREVIEW_SIZE: usize = 480;
/// Pictures of an animation at most: of more than 20 s there are fewer per second.
const MOST: usize = 300;
/// Frames that are mapped together.
const TOGETHER: usize = 8;
/// The camera stands where the whole way is in view if that is at most so many times larger than the way about the body, and follows the body otherwise.
const ROOM: f64 = 1.6;
/// From the front to where the camera stands, about the up axis and upwards, radians.
const TURN: f64 = 0.55;
const RISE: f64 = 0.2;
/// From line to line of the floor, in diagonals of the scan.
const CELL: f64 = 0.25;

/// Which pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Sheet,
    Preview,
}

/// Writes pictures.
#[derive(Debug)]
pub struct Stills {
    path: PathBuf,
    form: Form,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    header: Arc<Header>,
    /// Frames that are shown, counted from 0, ascending.
    chosen: Vec<usize>,
    /// Pictures per second.
    fps: f64,
    // Dropped in this order: the poses go before the folder.
    spool: Spool,
    file: Pending,
}

impl Stills {
    /// A sheet of evenly chosen frames, the first and the last among them.
    pub fn sheet(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), form: Form::Sheet, open: None }
    }

    /// The whole take at no more than 15 pictures per second.
    pub fn preview(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), form: Form::Preview, open: None }
    }
}

impl FrameSink for Stills {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        if !(header.rate.is_finite() && header.rate > 0.0) {
            return Err(Error::refused(format!("a frame rate of {}", header.rate)).file(&self.path));
        }
        let file = Pending::create(&self.path)?;
        let spool = Spool::new(folder_of(&self.path), header.proxy.rest.len()).map_err(|e| e.file(&self.path))?;
        let (chosen, fps) = match self.form {
            Form::Sheet => (spread(header.frames, SHEET), header.rate),
            Form::Preview => in_time(header.frames, header.rate),
        };
        self.open = Some(Open { header: header.clone(), chosen, fps, spool, file });
        Ok(())
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("a sink is begun before it gets frames");
        for (frame, pose) in (batch.first..).zip(batch.proxy) {
            if open.chosen.binary_search(&frame).is_ok() {
                open.spool.push(pose).map_err(|e| e.file(&self.path))?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        let path = self.path;
        let Some(open) = self.open.take().filter(|o| o.spool.frames() > 0) else {
            return Err(Error::refused("no frames").file(&path));
        };
        let Open { header, chosen, fps, spool, mut file } = open;
        let mut notes = Notes::default();
        let paint = Paint::of(&header.scan, &mut notes);
        let shot = Shot { header: &header, spool: &spool, paint: &paint };
        let out = BufWriter::with_capacity(1 << 20, file.file_mut());
        let encoding = match self.form {
            Form::Sheet => shot.sheet(out, &chosen),
            Form::Preview => shot.preview(out, fps),
        };
        let encoding = encoding.map_err(|e| e.file(&path))?;
        Ok(Written { bytes: file.finish()?, path, encoding, notes, ..Written::default() })
    }
}

/// At most so many frames as far from each other as can be, the first and the last among them.
fn spread(frames: usize, most: usize) -> Vec<usize> {
    let count = frames.min(most);
    (0..count).map(|i| (i * frames.saturating_sub(1) + count.saturating_sub(1) / 2) / count.saturating_sub(1).max(1)).collect()
}

/// Frames at equal steps of time from the first one on, and how many of them a second has.
fn in_time(frames: usize, rate: f64) -> (Vec<usize>, f64) {
    let seconds = frames as f64 / rate;
    let fps = rate.min(FPS).min((MOST as f64 / seconds).max(0.1));
    let chosen = (0..).map(|k| (f64::from(k) * rate / fps).round() as usize).take_while(|&f| f < frames).collect();
    (chosen, fps)
}

/// Colours of a scan as a picture has them.
enum Paint {
    Plain,
    Colors(Vec<[u8; 3]>),
    Images { uvs: Vec<[[f32; 2]; 3]>, images: Vec<Texture>, of: Vec<u32> },
}

impl Paint {
    fn of(scan: &Scan, notes: &mut Notes) -> Self {
        let look = &scan.look;
        if !look.colors.is_empty() {
            let byte = |c: f32| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
            return Self::Colors(look.colors.iter().map(|c| [byte(c[0]), byte(c[1]), byte(c[2])]).collect());
        }
        if look.materials.is_empty() {
            return Self::Plain;
        }
        let clay = Texture::srgb(CLAY);
        let mut images: Vec<Texture> = vec![clay.clone()];
        for material in &look.materials {
            let [r, g, b, _] = material.base_color;
            let bare = if material.base_color == [1.0; 4] { clay.clone() } else { Texture::plain([r, g, b]) };
            let image = material.base_color_texture.as_ref().filter(|_| !look.uvs.is_empty()).and_then(|image| {
                let decoded = image.read().map_err(|e| e.to_string());
                let decoded =
                    decoded.and_then(|bytes| Texture::decode(&bytes, [r, g, b], material.blend).map_err(|e| e.to_string()));
                decoded.map_err(|reason| notes.warn(format!("{}: not in the pictures: {reason}", image.name()))).ok()
            });
            images.push(image.unwrap_or(bare));
        }
        let triangles = scan.mesh.triangulate();
        let uv = |corner: u32| {
            let index = look.corner_uvs.get(corner as usize);
            index.and_then(|&i| look.uvs.get(i as usize)).copied().unwrap_or_default()
        };
        let of = triangles.faces.iter().map(|&f| match look.face_materials.get(f as usize) {
            Some(&m) if m != NONE && (m as usize) < look.materials.len() => m + 1,
            _ => 0,
        });
        Self::Images { of: of.collect(), uvs: triangles.corners.iter().map(|t| t.map(uv)).collect(), images }
    }

    fn colors(&self) -> Colors<'_> {
        match self {
            Self::Plain => Colors::Plain,
            Self::Colors(colors) => Colors::PerVertex(colors),
            Self::Images { uvs, images, of } => Colors::Images { uvs, images, of },
        }
    }
}

/// The poses that are shown, and all that it takes to draw them.
struct Shot<'a> {
    header: &'a Header,
    spool: &'a Spool,
    paint: &'a Paint,
}

/// What is in view.
struct Scene {
    film: Film,
    /// Of the camera, for each picture.
    shifts: Vec<DVec3>,
}

impl Shot<'_> {
    fn sheet(&self, mut out: impl Write, chosen: &[usize]) -> Result<String> {
        let scene = self.scene(SHEET_SIZE, true)?;
        let mut pictures = Vec::new();
        self.draw(&scene, |picture| {
            let frame = self.header.first_frame + chosen[pictures.len()] as i64;
            pictures.push((picture, format!("frame {frame}")));
            Ok(())
        })?;
        let header = self.header;
        let scan = header.scan.source.file_name().unwrap_or_default().to_string_lossy();
        let names: Vec<&str> = [scan.as_ref(), &header.take].into_iter().filter(|s| !s.is_empty()).collect();
        let rate = (header.rate * 1e3).round() / 1e3;
        let heading = format!("{} · {} at {rate} fps", names.join(" · "), words::plural(header.frames, "frame"));
        let sheet = contact_sheet(&pictures, columns(pictures.len(), scene.film.size()), &[heading]);
        let bytes = sheet.png()?;
        let unwritable = |e: std::io::Error| Error::new(crate::error::Kind::Unwritable, e.to_string());
        out.write_all(&bytes).and_then(|()| out.flush()).map_err(unwritable)?;
        Ok(format!("{}, {} × {} pixels", words::plural(pictures.len(), "picture"), sheet.width, sheet.height))
    }

    fn preview(&self, out: impl Write, fps: f64) -> Result<String> {
        let scene = self.scene(PREVIEW_SIZE, false)?;
        let [width, height] = scene.film.size();
        let count = self.spool.frames();
        let mut animation = Animation::begin(out, [width, height], count, fps)?;
        self.draw(&scene, |picture| animation.push(picture))?;
        animation.finish()?;
        Ok(format!("{} at {} fps, {width} × {height} pixels", words::plural(count, "picture"), words::digits(fps)))
    }

    fn draw(&self, scene: &Scene, mut take: impl FnMut(Picture) -> Result<()>) -> Result<()> {
        let triangles = self.header.scan.mesh.vertex_triangles();
        let mut mapped: Vec<Vec<[f32; 3]>> = Vec::new();
        for (first, shifts) in (0..).step_by(TOGETHER).zip(scene.shifts.chunks(TOGETHER)) {
            let poses = self.spool.read(first, shifts.len())?;
            mapped.resize_with(poses.len(), Vec::new);
            self.header.map.apply(&poses.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut mapped);
            for (points, &shift) in mapped.iter().zip(shifts) {
                self.header.cancel.check()?;
                let points: Vec<DVec3> = points.iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
                let surface = Surface { points: &points, triangles: &triangles, colors: self.paint.colors() };
                take(scene.film.picture(&surface, shift, 1.0))?;
            }
        }
        Ok(())
    }

    /// Finds a place for the camera. `near`: it follows the body always, and there is no floor.
    fn scene(&self, size: usize, near: bool) -> Result<Scene> {
        let space = &self.header.scan.space;
        let up = self.header.up.or(space.up.map(|up| up.value.vector())).unwrap_or(DVec3::Y).normalize_or(DVec3::Y);
        let usual = if up.y.abs() > 0.7 { DVec3::Z } else { -DVec3::Y };
        let front = space.forward.map_or(usual, |f| f.value);
        let front = (front - up * front.dot(up)).try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
        let level = DQuat::from_axis_angle(up, TURN) * front;
        let axes = Axes::new(level * RISE.cos() + up * RISE.sin(), up);
        // Windows of the whole way and of the way about a camera that goes along, but not up and down.
        let (mut whole, mut beside) = (Window::default(), Window::default());
        let (mut floor, mut shifts) = (f64::INFINITY, Vec::new());
        for frame in 0..self.spool.frames() {
            let pose = self.spool.read_one(frame)?;
            let middle = pose.iter().sum::<DVec3>() / pose.len().max(1) as f64;
            let shift = middle - up * middle.dot(up);
            for &p in &pose {
                whole.add(axes.place(p));
                beside.add(axes.place(p - shift));
                floor = floor.min(p.dot(up));
            }
            shifts.push(shift);
        }
        // The scan may stand out from its proxy.
        let (mut scan, mut proxy) = (Window::default(), Window::default());
        self.header.scan.mesh.positions.iter().for_each(|&p| scan.add(axes.place(self.header.unit_box.enter(p))));
        self.header.proxy.rest.iter().for_each(|&p| proxy.add(axes.place(p)));
        let out = [0, 1].map(|k| (proxy.lo[k] - scan.lo[k]).max(scan.hi[k] - proxy.hi[k]).max(0.0));
        let follows = near || whole.largest() > ROOM * beside.largest();
        let window = if follows { beside } else { whole };
        let middle = shifts.iter().sum::<DVec3>() / shifts.len().max(1) as f64;
        let middle = if follows { DVec3::ZERO } else { middle };
        let floor = (!near).then_some(Floor { up, height: floor, cell: CELL, middle });
        let lo = [0, 1].map(|k| window.lo[k] - out[k]);
        let hi = [0, 1].map(|k| window.hi[k] + out[k]);
        let film = Film::new(axes, lo, hi, size, floor);
        if !follows {
            shifts.fill(DVec3::ZERO);
        }
        Ok(Scene { film, shifts })
    }
}

#[derive(Clone, Copy)]
struct Window {
    lo: [f64; 2],
    hi: [f64; 2],
}

impl Default for Window {
    fn default() -> Self {
        Self { lo: [f64::INFINITY; 2], hi: [f64::NEG_INFINITY; 2] }
    }
}

impl Window {
    fn add(&mut self, p: [f64; 2]) {
        self.lo = [self.lo[0].min(p[0]), self.lo[1].min(p[1])];
        self.hi = [self.hi[0].max(p[0]), self.hi[1].max(p[1])];
    }

    fn largest(&self) -> f64 {
        (self.hi[0] - self.lo[0]).max(self.hi[1] - self.lo[1])
    }
}

/// Columns that make a sheet about twice as wide as high, without a row that is much shorter than the others.
fn columns(count: usize, [width, height]: [usize; 2]) -> usize {
    let cost = |columns: usize| {
        let rows = count.div_ceil(columns);
        let shape = ((columns * width) as f64 / (rows * (height + 40)) as f64 / 2.0).ln().abs();
        shape + (rows * columns - count) as f64 / columns as f64
    };
    (1..=count.max(1)).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(1)
}

#[cfg(test)]
mod tests;
