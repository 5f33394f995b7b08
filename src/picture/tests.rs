#![allow(clippy::unwrap_used)]

use super::*;
use crate::picture::labels::columns;

/// A square across z, `half` wide on each side of its centre.
fn square(centre: DVec3, half: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let corner = |x: f64, y: f64| centre + DVec3::new(x, y, 0.0) * half;
    (vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)], vec![[0, 1, 2], [0, 2, 3]])
}

fn ball(rings: usize, radius: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let sides = 2 * rings;
    let mut points = Vec::new();
    for i in 0..=rings {
        let (s, c) = (i as f64 / rings as f64 * std::f64::consts::PI).sin_cos();
        for k in 0..sides {
            let (sin, cos) = (k as f64 / sides as f64 * std::f64::consts::TAU).sin_cos();
            points.push(DVec3::new(s * cos, c, s * sin) * radius);
        }
    }
    let at = |i: usize, k: usize| (i * sides + k % sides) as u32;
    let cell = |i: usize, k: usize| [[at(i, k), at(i, k + 1), at(i + 1, k + 1)], [at(i, k), at(i + 1, k + 1), at(i + 1, k)]];
    (points, (0..rings).flat_map(|i| (0..sides).flat_map(move |k| cell(i, k))).collect())
}

fn front() -> View {
    View { title: "front".into(), toward: DVec3::Z, up: DVec3::Y }
}

fn sheet<'a>(points: &'a [DVec3], triangles: &'a [[u32; 3]]) -> Sheet<'a> {
    Sheet {
        surfaces: vec![Surface { points, triangles, colors: Colors::Plain }],
        views: vec![front()],
        height: 200,
        ..Sheet::default()
    }
}

fn named(name: &str, at: DVec3) -> Mark {
    Mark { at, name: name.into(), color: [0, 0, 200], shape: Shape::Dot, through: false }
}

fn plane_of(points: &[DVec3], triangles: &[[u32; 3]], height: usize) -> Panel {
    let sheet = sheet(points, triangles);
    let shaded: Vec<Shaded> = sheet.surfaces.iter().map(Shaded::new).collect();
    Panel::render(&shaded, &front(), &Bounds::of(&sheet), height)
}

/// Pixels in which two pictures differ.
fn differences(a: &Picture, b: &Picture) -> usize {
    assert_eq!((a.width, a.height), (b.width, b.height));
    a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a != b).count()
}

#[test]
fn a_disc_covers_its_area_to_fractions_of_pixels() {
    let (points, triangles) = ball(60, 3.0);
    let panel = plane_of(&points, &triangles, 300);
    let [x0, y0, _] = panel.camera.project(DVec3::ZERO);
    let [x1, y1, _] = panel.camera.project(DVec3::Y * 3.0);
    let radius = f64::from((x1 - x0).hypot(y1 - y0));
    let covered: f64 = panel.plane.pixels.iter().map(|p| f64::from(p.cover)).sum();
    assert!((covered / (std::f64::consts::PI * radius * radius) - 1.0).abs() < 0.003, "{covered} {radius}");
    let partly = panel.plane.pixels.iter().filter(|p| p.cover > 0.0 && p.cover < 1.0).count();
    assert!(partly > 400, "the edge is smooth: {partly}");
}

#[test]
fn the_nearer_surface_is_seen_in_any_order_and_orientation() {
    let (mut points, mut triangles) = square(DVec3::ZERO, 1.0);
    let (near, _) = square(DVec3::Z * 0.2, 0.4);
    points.extend(near);
    triangles.extend([[4, 5, 6], [4, 6, 7]]);
    let colors = [[255, 0, 0], [255, 0, 0], [0, 255, 0], [0, 255, 0]];
    let draw_with = |triangles: &[[u32; 3]], colors: &[[u8; 3]]| {
        let mut sheet = sheet(&points, triangles);
        sheet.surfaces[0].colors = Colors::PerFace(colors);
        draw(&sheet)
    };
    let picture = draw_with(&triangles, &colors);
    let pixel = |p: &Picture, x: f64, y: f64| p.pixels[(p.height as f64 * y) as usize * p.width + (p.width as f64 * x) as usize];
    let [r, g, _] = pixel(&picture, 0.5, 0.42);
    assert!(g > 150 && r == 0, "the near square is green in the middle: {r} {g}");
    let [r, g, _] = pixel(&picture, 0.3, 0.25);
    assert!(r > 100 && g == 0, "the far one is red beside it: {r} {g}");
    let turned: Vec<[u32; 3]> = triangles.iter().rev().map(|t| [t[0], t[2], t[1]]).collect();
    let reversed: Vec<[u8; 3]> = colors.iter().rev().copied().collect();
    assert_eq!(differences(&picture, &draw_with(&turned, &reversed)), 0);
}

#[test]
fn names_are_written_only_where_their_points_are_seen() {
    let (points, triangles) = ball(20, 1.0);
    let mut both = sheet(&points, &triangles);
    both.views.push(View { title: "back".into(), toward: -DVec3::Z, up: DVec3::Y });
    let alone = draw(&both);
    both.marks = vec![named("IN FRONT", DVec3::Z * 1.01)];
    let front_only = draw(&both);
    both.marks.push(named("BEHIND", -DVec3::Z * 1.01));
    let each_once = draw(&both);
    let column = |name: &str| lettering::width(name) + GAP;
    assert_eq!(front_only.width, alone.width + column("IN FRONT"));
    assert_eq!(each_once.width, front_only.width + column("BEHIND"));
    both.marks = vec![named("INSIDE", DVec3::ZERO)];
    assert_eq!(draw(&both).width, alone.width + column("INSIDE"), "what all views hide is named in the first");
    both.marks[0].through = true;
    assert_eq!(draw(&both).width, alone.width + 2 * column("INSIDE"));
}

#[test]
fn names_do_not_lie_over_each_other_and_their_lines_do_not_cross() {
    let mut state = 7u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    for count in [1, 5, 30, 60, 95, 300] {
        let (height, width) = (1000, 500.0);
        // Most of them in one corner.
        let dots: Vec<(usize, [f32; 2])> =
            (0..count).map(|i| (i, [random().powi(2) * width, random().powi(3) * height as f32])).collect();
        let (left, right) = columns(dots.iter().copied(), &|_| 50, height, width / 2.0);
        let mut items: Vec<usize> = left.slots.iter().chain(&right.slots).map(|s| s.item).collect();
        items.sort_unstable();
        assert_eq!(items, (0..count).collect::<Vec<_>>());
        for (column, edge) in [(&left, 0.0), (&right, width)] {
            let most = column.slots.len();
            let apart =
                if most * lettering::LINE <= height { lettering::LINE as f32 * 0.89 } else { height as f32 / most as f32 * 0.99 };
            for pair in column.slots.windows(2) {
                assert!(pair[1].y - pair[0].y >= apart, "{count}: {} {}", pair[0].y, pair[1].y);
                let ends = [0, 1].map(|k| (dots[pair[k].item].1, [edge, pair[k].y]));
                assert!(!labels::cross(ends[0].0, ends[0].1, ends[1].0, ends[1].1), "{count}");
            }
            assert!(column.slots.iter().all(|s| s.y > 0.0 && s.y < height as f32));
        }
    }
}

#[test]
fn a_picture_is_the_same_for_any_number_of_threads_and_survives_png() {
    let (points, triangles) = ball(40, 1.0);
    let mut sheet = sheet(&points, &triangles);
    sheet.heading = vec!["Hello °·–ß".into()];
    sheet.legend = vec![(Shape::Ring, [1, 2, 3], "ring".into())];
    sheet.marks = vec![named("A", DVec3::Z), named("B", DVec3::X)];
    sheet.strokes = vec![Stroke { from: DVec3::ZERO, to: DVec3::ONE, color: [9; 3], width: 2.0, opacity: 0.5 }];
    let with = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| draw(&sheet));
    let picture = with(1);
    assert!(with(2) == picture && with(4) == picture);
    let bytes = picture.png().unwrap();
    assert_eq!(bytes, with(3).png().unwrap());
    let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width as usize, info.height as usize), (picture.width, picture.height));
    assert_eq!(pixels, picture.pixels.as_flattened());
    assert!(Picture { width: 0, height: 0, pixels: Vec::new() }.png().is_err());
}

#[test]
fn broken_points_and_empty_sheets_are_drawn_without_them() {
    let (mut points, triangles) = ball(10, 1.0);
    points[7] = DVec3::NAN;
    points[12] = DVec3::new(f64::INFINITY, 0.0, 0.0);
    let mut sheet = sheet(&points, &triangles);
    sheet.marks = vec![named("NOWHERE", DVec3::NAN)];
    sheet.strokes = vec![Stroke { from: DVec3::NAN, to: DVec3::ONE, color: [9; 3], width: 2.0, opacity: 0.5 }];
    let picture = draw(&sheet);
    let clay = picture.pixels.iter().filter(|p| p[0] > p[2] + 4).count();
    assert!(clay > 10_000, "the rest of the ball is there: {clay}");
    assert!(draw(&Sheet { views: vec![front()], ..Sheet::default() }).pixels.iter().all(|p| p[2] < 250));
    assert!(!draw(&Sheet::default()).pixels.is_empty());
}

#[test]
fn every_letter_is_told_from_every_other() {
    let look = |letter: char| {
        let mut cells = std::collections::BTreeMap::new();
        lettering::write(0.0, 0.0, &letter.to_string(), |x, y, cover| {
            cells.insert((x, y), (cover * 255.0) as u8);
        });
        cells
    };
    let letters: Vec<char> = (' '..='~').chain(['°', '·', '–', 'ß']).collect();
    for (i, a) in letters.iter().enumerate() {
        assert!(*a == ' ' || !look(*a).is_empty());
        assert!(letters[..i].iter().all(|b| look(*a) != look(*b)), "{a}");
    }
}
