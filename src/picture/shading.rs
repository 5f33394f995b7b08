//! Normals and colours of a surface, ready to be drawn from any side.

use super::light::srgb_to_linear;
use super::{CLAY, Colors, Surface, Texture};
use crate::equal::first_in_place;
use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

/// Faces at a vertex shade into each other up to this cosine between their normals.
const SMOOTH: f32 = 0.5;

/// A surface with a normal and a colour at every corner of its triangles.
pub(super) struct Shaded<'a> {
    pub(super) points: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    normals: Vec<[Vec3; 3]>,
    colors: LinearColors<'a>,
}

enum LinearColors<'a> {
    One(Vec3),
    PerVertex(Vec<Vec3>),
    PerFace(Vec<Vec3>),
    Images { uvs: &'a [[[f32; 2]; 3]], images: &'a [Texture], of: &'a [u32] },
}

/// Colour of a triangle, linear light.
pub(super) enum Paint<'a> {
    /// Between those of its corners.
    Corners([Vec3; 3]),
    /// An image, and where its corners are on that.
    Image(&'a Texture, [[f32; 2]; 3]),
}

impl Paint<'_> {
    /// Colour and opacity at a point with the weights `w` of the corners.
    pub(super) fn at(&self, w: [f32; 3]) -> Vec4 {
        match self {
            Self::Corners(colors) => (colors[0] * w[0] + colors[1] * w[1] + colors[2] * w[2]).extend(1.0),
            Self::Image(image, uvs) => image.at([0, 1].map(|k| uvs[0][k] * w[0] + uvs[1][k] * w[1] + uvs[2][k] * w[2])),
        }
    }
}

impl<'a> Shaded<'a> {
    pub(super) fn new(surface: &Surface<'a>) -> Self {
        let table: Vec<f32> = (0..=255u8).map(|c| srgb_to_linear(f32::from(c) / 255.0)).collect();
        let linear = |c: &[u8; 3]| Vec3::from(c.map(|c| table[usize::from(c)]));
        let colors = match surface.colors {
            Colors::Plain => LinearColors::One(linear(&CLAY)),
            Colors::PerVertex(colors) => LinearColors::PerVertex(colors.iter().map(linear).collect()),
            Colors::PerFace(colors) => LinearColors::PerFace(colors.iter().map(linear).collect()),
            Colors::Images { uvs, images, of } => LinearColors::Images { uvs, images, of },
        };
        Self { points: surface.points, triangles: surface.triangles, normals: normals(surface), colors }
    }

    pub(super) fn normals(&self, t: usize) -> [Vec3; 3] {
        self.normals[t]
    }

    pub(super) fn paint(&self, t: usize) -> Paint<'_> {
        match &self.colors {
            LinearColors::One(color) => Paint::Corners([*color; 3]),
            LinearColors::PerVertex(colors) => Paint::Corners(self.triangles[t].map(|v| colors[v as usize])),
            LinearColors::PerFace(colors) => Paint::Corners([colors[t]; 3]),
            LinearColors::Images { uvs, images, of } => Paint::Image(&images[of[t] as usize], uvs[t]),
        }
    }
}

/// A normal for each corner: of all faces around it that are not turned too far from its own. Vertices in the same place count as one.
fn normals(surface: &Surface<'_>) -> Vec<[Vec3; 3]> {
    let (points, triangles) = (surface.points, surface.triangles);
    let places = first_in_place(points);
    let face = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| points[v as usize]);
        (b - a).cross(c - a)
    };
    let areas: Vec<Vec3> = triangles.par_iter().map(|t| face(t).as_vec3()).collect();
    let units: Vec<Vec3> = triangles.par_iter().map(|t| face(t).normalize_or_zero().as_vec3()).collect();
    // Faces around each place, one after the other.
    let mut starts = vec![0u32; points.len() + 1];
    triangles.iter().flatten().for_each(|&v| starts[places[v as usize] as usize + 1] += 1);
    for v in 0..points.len() {
        starts[v + 1] += starts[v];
    }
    let (mut next, mut faces) = (starts.clone(), vec![0u32; triangles.len() * 3]);
    for (t, corners) in triangles.iter().enumerate() {
        for &v in corners {
            let at = &mut next[places[v as usize] as usize];
            faces[*at as usize] = t as u32;
            *at += 1;
        }
    }
    let corner = |t: usize, v: u32| {
        let place = places[v as usize] as usize;
        let around = &faces[starts[place] as usize..starts[place + 1] as usize];
        let near = around.iter().map(|&f| f as usize).filter(|&f| units[f].dot(units[t]).abs() > SMOOTH);
        // Faces may be turned inside out.
        let sum: Vec3 = near.map(|f| if units[f].dot(units[t]) < 0.0 { -areas[f] } else { areas[f] }).sum();
        sum.try_normalize().unwrap_or(units[t])
    };
    triangles.par_iter().enumerate().map(|(t, corners)| corners.map(|v| corner(t, v))).collect()
}
