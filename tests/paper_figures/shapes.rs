//! The shapes: made here, and their larger equals where they are present.

use super::common;
use glam::DVec3;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// A named mesh in its own space.
pub struct Shape {
    pub name: &'static str,
    pub points: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)))
    }
}

/// One of the shared shapes.
pub fn real(name: &'static str) -> Option<Shape> {
    let mesh = retarget::scan::read(&common::shared()?.join("meshes/benchmark").join(name)).unwrap().mesh;
    let triangles = mesh.vertex_triangles();
    Some(Shape { name, points: mesh.positions, triangles })
}

/// A tube of closed rings along a line, with a fan over each end. `ring(t, angle)`: a point for t from 0 to 1.
fn tube(rings: usize, sides: usize, ring: impl Fn(f64, f64) -> DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    for i in 0..=rings {
        points.extend((0..sides).map(|s| ring(i as f64 / rings as f64, s as f64 / sides as f64 * TAU)));
    }
    let at = |i: usize, s: usize| (i * sides + s % sides) as u32;
    let mut triangles = Vec::new();
    for i in 0..rings {
        for s in 0..sides {
            triangles.push([at(i, s), at(i, s + 1), at(i + 1, s + 1)]);
            triangles.push([at(i, s), at(i + 1, s + 1), at(i + 1, s)]);
        }
    }
    for (i, flip) in [(0, true), (rings, false)] {
        let middle = points.len() as u32;
        points.push((0..sides).map(|s| points[at(i, s) as usize]).sum::<DVec3>() / sides as f64);
        for s in 0..sides {
            triangles.push(if flip { [middle, at(i, s + 1), at(i, s)] } else { [middle, at(i, s), at(i, s + 1)] });
        }
    }
    (points, triangles)
}

/// 1 × 1 × 6.
pub fn bar() -> Shape {
    let (points, triangles) = tube(48, 24, |t, angle| {
        let (s, c) = angle.sin_cos();
        DVec3::new(c, s, 0.0) * (0.5 / c.abs().max(s.abs())) + DVec3::Z * t * 6.0
    });
    Shape { name: "own bar", points, triangles }
}

/// Radius 0.75, length 8.
pub fn cylinder() -> Shape {
    let (points, triangles) = tube(56, 26, |t, angle| DVec3::new(0.75 * angle.cos(), 0.75 * angle.sin(), 8.0 * t));
    Shape { name: "own cylinder", points, triangles }
}

/// A ribbed trunk with two arms that run into it.
pub fn cactus() -> Shape {
    let blunt = |t: f64| (1.0 - (2.0 * t - 1.0).powi(8)).max(0.09).sqrt();
    let (mut points, mut triangles) = tube(60, 48, |t, angle| {
        let radius = 0.45 * (1.0 + 0.08 * (8.0 * angle).cos()) * blunt(0.5 + 0.5 * t);
        DVec3::new(radius * angle.cos(), radius * angle.sin(), 4.0 * t)
    });
    for (side, height) in [(1.0, 1.6), (-1.0, 2.1)] {
        // Out of the trunk, and up in a quarter of a circle.
        let (p, t) = tube(36, 20, |t, angle| {
            let along = t * 1.9;
            let bend = ((along - 0.5) / 0.6).clamp(0.0, TAU / 4.0);
            let (s, c) = bend.sin_cos();
            let straight = (along - 0.5 - bend * 0.6).min(0.0) + 0.5;
            let up = (along - 0.5 - bend * 0.6).max(0.0);
            let centre = DVec3::new(side * (straight + 0.6 * s), 0.0, height + 0.6 * (1.0 - c) + up);
            let across = DVec3::new(-side * s, 0.0, c);
            let radius = 0.22 * blunt(0.5 + 0.5 * t);
            centre + (across * angle.cos() + DVec3::Y * (-side * angle.sin())) * radius
        });
        let first = points.len() as u32;
        points.extend(p);
        triangles.extend(t.into_iter().map(|t| t.map(|v| v + first)));
    }
    Shape { name: "own cactus", points, triangles }
}

/// A plate of 10 × 10 × 0.35 with 25 hemispheres on it.
pub fn bumpy_plane() -> Shape {
    let cells = 60;
    let side = cells + 1;
    let height = |x: f64, y: f64| {
        let from_middle = |v: f64| (v / 2.0).fract() * 2.0 - 1.0;
        let square = from_middle(x).powi(2) + from_middle(y).powi(2);
        (0.36 - square).max(0.0).sqrt()
    };
    let place = |i: usize| DVec3::new((i % side) as f64, (i / side) as f64, 0.0) * (10.0 / cells as f64);
    let top = (0..side * side).map(place).map(|p| p + DVec3::Z * height(p.x, p.y));
    let mut points: Vec<DVec3> = top.collect();
    points.extend((0..side * side).map(|i| place(i) - DVec3::Z * 0.35));
    let (under, at) = ((side * side) as u32, |x: usize, y: usize| (y * side + x) as u32);
    let mut triangles = Vec::new();
    for y in 0..cells {
        for x in 0..cells {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
            triangles.extend([[a, c, b], [a, d, c]].map(|t| t.map(|v| v + under)));
        }
    }
    let mut wall = |a: u32, b: u32| triangles.extend([[b, a, a + under], [b, a + under, b + under]]);
    for i in 0..cells {
        wall(at(i, 0), at(i + 1, 0));
        wall(at(i + 1, cells), at(i, cells));
        wall(at(0, i + 1), at(0, i));
        wall(at(cells, i), at(cells, i + 1));
    }
    Shape { name: "own bumpy plane", points, triangles }
}

/// An open sheet as the closed surface of a plate below it: its points, the same again as far down along their normals, and a wall along its border.
pub fn plate(sheet: &Shape, thickness: f64) -> Shape {
    let under = sheet.points.len() as u32;
    let mut normals = vec![DVec3::ZERO; sheet.points.len()];
    for t in &sheet.triangles {
        let [a, b, c] = t.map(|v| sheet.points[v as usize]);
        t.iter().for_each(|&v| normals[v as usize] += (b - a).cross(c - a));
    }
    let mut points = sheet.points.clone();
    points.extend(sheet.points.iter().zip(&normals).map(|(p, n)| *p - n.normalize() * thickness));
    let mut triangles = sheet.triangles.clone();
    triangles.extend(sheet.triangles.iter().map(|&[a, b, c]| [a, c, b].map(|v| v + under)));
    let sides = || sheet.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let all: BTreeSet<(u32, u32)> = sides().collect();
    for (a, b) in sides().filter(|&(a, b)| !all.contains(&(b, a))) {
        triangles.extend([[b, a, a + under], [b, a + under, b + under]]);
    }
    Shape { name: sheet.name, points, triangles }
}

/// The bumps in the free part of a plane: the middle of each, and its points.
pub fn bumps(shape: &Shape, radius: f64) -> Vec<(DVec3, Vec<u32>)> {
    let raised = |p: &DVec3| p.z > 0.05 * radius;
    let mut bumps = Vec::new();
    let mut taken = vec![false; shape.points.len()];
    let mut highest: Vec<u32> = (0..shape.points.len() as u32).filter(|&v| raised(&shape.points[v as usize])).collect();
    highest.sort_by(|&a, &b| shape.points[b as usize].z.total_cmp(&shape.points[a as usize].z));
    for &v in &highest {
        let top = shape.points[v as usize];
        if taken[v as usize] || top.z < 0.7 * radius {
            continue;
        }
        let near = |w: &u32| shape.points[*w as usize].truncate().distance(top.truncate()) < 1.2 * radius;
        let members: Vec<u32> = highest.iter().copied().filter(|w| !taken[*w as usize] && near(w)).collect();
        members.iter().for_each(|&w| taken[w as usize] = true);
        let (lo, hi) = members.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &w| {
            (lo.min(shape.points[w as usize]), hi.max(shape.points[w as usize]))
        });
        let centre = (lo + hi) * 0.5;
        if members.len() >= 8 && centre.x - radius > 0.3 && centre.x + radius < 9.7 {
            bumps.push((centre, members));
        }
    }
    bumps
}
