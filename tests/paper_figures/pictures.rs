//! Pictures of the figures, for people.

use super::shapes::Shape;
use glam::DVec3;
use retarget::picture::{self, Colors, Sheet, Surface, View};

/// Draws a shape in several poses side by side into the folder that RETARGET_KEEP names, if it does.
pub fn keep(name: &str, shape: &Shape, poses: &[(&str, &Vec<DVec3>)]) {
    let Some(folder) = std::env::var_os("RETARGET_KEEP") else { return };
    let mut shifted: Vec<Vec<DVec3>> = Vec::new();
    let mut right = 0.0;
    for (_, points) in poses {
        let (lo, hi) = points.iter().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p.x), hi.max(p.x)));
        shifted.push(points.iter().map(|p| *p + DVec3::X * (right - lo)).collect());
        right += (hi - lo) + 1.0;
    }
    // Stripes across the axis show how it turns and bends.
    let stripe = |t: &[u32; 3]| {
        let p = shape.points[t[0] as usize];
        let along = if shape.bounds().1.z > 2.0 { p.z } else { p.x };
        if (along * 2.0).rem_euclid(2.0) < 1.0 { [226, 196, 140] } else { [120, 150, 190] }
    };
    let colors: Vec<[u8; 3]> = shape.triangles.iter().map(stripe).collect();
    let surface = |points| Surface { points, triangles: &shape.triangles, colors: Colors::PerFace(&colors) };
    let view = |toward: DVec3| View { title: String::new(), toward, up: DVec3::Z };
    let sheet = Sheet {
        surfaces: shifted.iter().map(|p| surface(p)).collect(),
        views: vec![view(DVec3::new(-0.35, -1.0, 0.35))],
        heading: vec![format!("{}: {}", shape.name, poses.iter().map(|p| p.0).collect::<Vec<_>>().join(", "))],
        height: 700,
        ..Sheet::default()
    };
    let file = std::path::Path::new(&folder).join(format!("{name} {}.png", shape.name.replace('.', "_")));
    std::fs::write(file, picture::draw(&sheet).png().unwrap()).unwrap();
}
