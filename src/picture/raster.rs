//! Triangles → pixels: a depth buffer, several samples per pixel, soft light from the eye's side.

use super::camera::Camera;
use super::shading::{Paint, Shaded};
use glam::{Vec3, Vec4};
use rayon::prelude::*;

/// Samples per pixel in each direction.
const SAMPLES: usize = 3;
/// Rows of pixels that are drawn together.
const BAND: usize = 16;
/// Radius in which depths are compared to darken what lies behind, in pixels.
const HALO: usize = 7;
/// How fast that grows with the depth, per diagonal of the surface, and its limit.
const HALO_SLOPE: f32 = 9.0;
const HALO_MOST: f32 = 0.42;

/// A pixel of a view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    /// Linear light, already multiplied by `cover`.
    pub(super) color: [f32; 3],
    /// Share of the pixel that the surface covers.
    pub(super) cover: f32,
    /// Distance of the nearest sample towards the eye; minus infinity without any.
    depth: f32,
}

/// A picture of surfaces.
pub(super) struct Plane {
    pub(super) width: usize,
    height: usize,
    pub(super) pixels: Vec<Pixel>,
}

/// A sample of a pixel.
#[derive(Clone, Copy)]
struct Sample {
    depth: f32,
    color: Vec3,
}

impl Plane {
    pub(super) fn new(width: usize, height: usize) -> Self {
        let empty = Pixel { color: [0.0; 3], cover: 0.0, depth: f32::NEG_INFINITY };
        Self { width, height, pixels: vec![empty; width * height] }
    }

    /// Depth of the surface at a place; `None` where there is none.
    pub(super) fn nearest(&self, x: f32, y: f32) -> Option<f32> {
        let inside = x >= 0.0 && y >= 0.0 && (x as usize) < self.width && (y as usize) < self.height;
        let depth = if inside { self.pixels[y as usize * self.width + x as usize].depth } else { f32::NEG_INFINITY };
        depth.is_finite().then_some(depth)
    }

    /// Draws surfaces, over nothing.
    pub(super) fn draw(&mut self, surfaces: &[Shaded<'_>], camera: &Camera, diagonal: f64) {
        let screens: Vec<Vec<[f32; 3]>> =
            surfaces.iter().map(|s| s.points.par_iter().map(|p| camera.project(*p)).collect()).collect();
        let bands = self.height.div_ceil(BAND);
        let mut of_band: Vec<Vec<(u32, u32)>> = vec![Vec::new(); bands];
        for (s, (surface, screen)) in surfaces.iter().zip(&screens).enumerate() {
            for (t, corners) in surface.triangles.iter().enumerate() {
                let y = corners.map(|v| screen[v as usize][1]);
                if corners.iter().any(|&v| !screen[v as usize].iter().all(|x| x.is_finite())) {
                    continue;
                }
                let lo = (y[0].min(y[1]).min(y[2]).max(0.0) as usize) / BAND;
                let hi = (y[0].max(y[1]).max(y[2]).max(0.0) as usize) / BAND;
                for band in of_band.iter_mut().take(hi + 1).skip(lo) {
                    band.push((s as u32, t as u32));
                }
            }
        }
        let width = self.width;
        let chunks = self.pixels.par_chunks_mut(width * BAND).zip(&of_band).enumerate();
        chunks.for_each(|(b, (pixels, triangles))| {
            let (columns, rows) = (width * SAMPLES, pixels.len() / width * SAMPLES);
            let mut samples = vec![Sample { depth: f32::NEG_INFINITY, color: Vec3::ZERO }; columns * rows];
            for &(s, t) in triangles {
                let (surface, t) = (&surfaces[s as usize], t as usize);
                let corners = surface.triangles[t].map(|v| {
                    let [x, y, depth] = screens[s as usize][v as usize];
                    Vec3::new(x * SAMPLES as f32, (y - (b * BAND) as f32) * SAMPLES as f32, depth)
                });
                let normals = surface.normals(t).map(|n| camera.turn(n));
                triangle(&mut samples, columns, rows, corners, normals, &surface.paint(t));
            }
            for (i, pixel) in pixels.iter_mut().enumerate() {
                *pixel = resolve(&samples, columns, i % width, i / width);
            }
        });
        self.darken_behind(diagonal as f32);
    }

    /// Darkens the surface where nearer surface is beside it, so that limbs stand out from what is behind them.
    ///
    /// After Luft, Colditz, Deussen 2006: the depth buffer is compared with itself blurred.
    fn darken_behind(&mut self, diagonal: f32) {
        let (width, height) = (self.width, self.height);
        let of = |p: &Pixel| if p.depth.is_finite() { [p.depth, 1.0] } else { [0.0; 2] };
        let mut depths: Vec<[f32; 2]> = self.pixels.iter().map(of).collect();
        for _ in 0..2 {
            depths = transposed(&blurred_rows(&depths, width), width, height);
            depths = transposed(&blurred_rows(&depths, height), height, width);
        }
        self.pixels.par_iter_mut().zip(&depths).filter(|(p, _)| p.depth.is_finite()).for_each(|(pixel, [sum, weight])| {
            let behind = (sum / weight.max(1e-6) - pixel.depth) / diagonal;
            let light = 1.0 - (behind * HALO_SLOPE).clamp(0.0, HALO_MOST);
            pixel.color = pixel.color.map(|c| c * light);
        });
    }
}

/// Mean over windows of each row.
fn blurred_rows(values: &[[f32; 2]], width: usize) -> Vec<[f32; 2]> {
    let mut out = vec![[0.0; 2]; values.len()];
    out.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| {
        // Double precision: what leaves the window takes away exactly what it brought, to what a picture shows.
        let mut sum = [0.0f64; 2];
        let add = |sum: &mut [f64; 2], v: [f32; 2], sign: f64| (0..2).for_each(|k| sum[k] += sign * f64::from(v[k]));
        row.iter().take(HALO).for_each(|v| add(&mut sum, *v, 1.0));
        for x in 0..row.len() {
            if let Some(v) = row.get(x + HALO) {
                add(&mut sum, *v, 1.0);
            }
            if x > HALO {
                add(&mut sum, row[x - HALO - 1], -1.0);
            }
            out[x] = sum.map(|s| (s / (2 * HALO + 1) as f64) as f32);
        }
    });
    out
}

fn transposed(values: &[[f32; 2]], width: usize, height: usize) -> Vec<[f32; 2]> {
    let mut out = vec![[0.0; 2]; values.len()];
    out.par_chunks_mut(height).enumerate().for_each(|(x, column)| {
        column.iter_mut().enumerate().for_each(|(y, out)| *out = values[y * width + x]);
    });
    out
}

/// Draws a triangle; its corners are in samples.
fn triangle(samples: &mut [Sample], columns: usize, rows: usize, p: [Vec3; 3], normals: [Vec3; 3], paint: &Paint<'_>) {
    let cross = |a: Vec3, b: Vec3, x: f32, y: f32| (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
    let area = cross(p[0], p[1], p[2].x, p[2].y);
    if area == 0.0 {
        return;
    }
    let lo = |k: usize| (p[0][k].min(p[1][k]).min(p[2][k]) - 0.5).ceil().max(0.0) as usize;
    let hi = |k: usize, most: usize| ((p[0][k].max(p[1][k]).max(p[2][k]) + 0.5).max(0.0) as usize).min(most);
    for row in lo(1)..hi(1, rows) {
        for column in lo(0)..hi(0, columns) {
            let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
            let w = [cross(p[1], p[2], x, y) / area, cross(p[2], p[0], x, y) / area, cross(p[0], p[1], x, y) / area];
            if w.iter().any(|w| *w < 0.0) {
                continue;
            }
            let sample = &mut samples[row * columns + column];
            let depth = p[0].z * w[0] + p[1].z * w[1] + p[2].z * w[2];
            let color = if depth > sample.depth { paint.at(w) } else { Vec4::ZERO };
            // What is clear is cut out.
            if color.w >= 0.5 {
                let normal = normals[0] * w[0] + normals[1] * w[1] + normals[2] * w[2];
                *sample = Sample { depth, color: color.truncate() * light(normal) };
            }
        }
    }
}

/// Light on a surface of the given normal, seen from +z: a large soft lamp from above, a weak one from the right, a bright sky over a dim ground.
fn light(normal: Vec3) -> f32 {
    let n = normal.normalize_or_zero();
    let n = if n.z < 0.0 { -n } else { n };
    // Lamps with an extent reach round the edge.
    let lamp = |direction: Vec3, wrap: f32| ((n.dot(direction) + wrap) / (1.0 + wrap)).max(0.0);
    let key = lamp(Vec3::new(-0.42, 0.62, 0.66), 0.25);
    let fill = lamp(Vec3::new(0.80, 0.10, 0.59), 0.35);
    0.13 + 0.11 * n.y + 0.86 * key + 0.22 * fill
}

fn resolve(samples: &[Sample], columns: usize, x: usize, y: usize) -> Pixel {
    let (mut color, mut covered, mut depth) = (Vec3::ZERO, 0, f32::NEG_INFINITY);
    for row in y * SAMPLES..(y + 1) * SAMPLES {
        for sample in &samples[row * columns + x * SAMPLES..][..SAMPLES] {
            if sample.depth > f32::NEG_INFINITY {
                color += sample.color.min(Vec3::ONE);
                covered += 1;
                depth = depth.max(sample.depth);
            }
        }
    }
    let share = 1.0 / (SAMPLES * SAMPLES) as f32;
    Pixel { color: (color * share).to_array(), cover: covered as f32 * share, depth }
}
