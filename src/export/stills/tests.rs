#![allow(clippy::unwrap_used)]

use super::*;
use crate::export::glb::tests::{FRAMES, header, pose};
use crate::scan::{Image, Material};
use std::path::Path;

fn write(header: &Arc<Header>, mut sink: Box<dyn FrameSink>) -> Written {
    sink.begin(header).unwrap();
    for first in (0..FRAMES).step_by(8) {
        let poses: Vec<Vec<DVec3>> = (first..FRAMES.min(first + 8)).map(|f| pose(header, f)).collect();
        sink.frames(&FrameBatch { first, proxy: &poses, points: &[], normals: &[] }).unwrap();
    }
    sink.finish().unwrap()
}

/// The pictures of a file as a viewer shows them, and the seconds of each.
fn shown(path: &Path) -> (usize, Vec<Vec<u8>>, Vec<f64>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let count = reader.info().animation_control().map_or(1, |a| a.num_frames);
    let mut canvas = vec![0; width * height * 3];
    let (mut pictures, mut delays) = (Vec::new(), Vec::new());
    let mut part = vec![0; reader.output_buffer_size().unwrap()];
    for _ in 0..count {
        let info = reader.next_frame(&mut part).unwrap();
        let (mut left, mut top) = (0, 0);
        if let Some(control) = reader.info().frame_control() {
            (left, top) = (control.x_offset as usize, control.y_offset as usize);
            delays.push(f64::from(control.delay_num) / f64::from(control.delay_den));
        }
        let row = info.width as usize * 3;
        for y in 0..info.height as usize {
            canvas[((top + y) * width + left) * 3..][..row].copy_from_slice(&part[y * row..][..row]);
        }
        pictures.push(canvas.clone());
    }
    (width, pictures, delays)
}

#[test]
fn a_preview_shows_the_whole_take_in_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.apng");
    // 24 frames at 120 per second: every eighth.
    let written = write(&header(DVec3::ZERO), Box::new(Stills::preview(&path)));
    assert_eq!(written.bytes, std::fs::metadata(&path).unwrap().len());
    let (width, pictures, delays) = shown(&path);
    let height = pictures[0].len() / width / 3;
    assert_eq!(width.max(height), PREVIEW_SIZE);
    assert_eq!(written.encoding, format!("3 pictures at 15 fps, {width} × {height} pixels"));
    assert_eq!(delays, [1.0 / 15.0; 3]);
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2]);
    // Nothing but paper and floor at the edge: the whole way is in view.
    let red = |p: &[u8]| p[0] > p[2].saturating_add(40);
    for picture in &pictures {
        let edge = |x: usize, y: usize| red(&picture[(y * width + x) * 3..][..3]);
        assert!(!(0..width).any(|x| edge(x, 0) || edge(x, height - 1)), "cut off above or below");
        assert!(!(0..height).any(|y| edge(0, y) || edge(width - 1, y)), "cut off at a side");
        assert!(picture.chunks(3).filter(|p| red(p)).count() > 3000, "the bar is not in the picture");
    }
}

#[test]
fn a_sheet_has_the_size_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let written = write(&header(DVec3::ZERO), Box::new(Stills::sheet(&path)));
    let (width, pictures, _) = shown(&path);
    let height = pictures[0].len() / width / 3;
    assert_eq!(written.encoding, format!("12 pictures, {width} × {height} pixels"));
    assert_eq!(pictures.len(), 1);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn pictures_are_whole_or_absent() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    for form in [Stills::sheet, Stills::preview] {
        let mut sink = form(folder.path().join("new/a"));
        sink.begin(&header).unwrap();
        sink.frames(&FrameBatch { first: 0, proxy: &[pose(&header, 0)], points: &[], normals: &[] }).unwrap();
        drop(sink);
        let mut stopped: Box<dyn FrameSink> = Box::new(form(folder.path().join("new/a")));
        stopped.begin(&header).unwrap();
        stopped.frames(&FrameBatch { first: 0, proxy: &[pose(&header, 0)], points: &[], normals: &[] }).unwrap();
        header.cancel.cancel();
        assert_eq!(stopped.finish().unwrap_err().kind, crate::error::Kind::Interrupted);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn frames_are_chosen_evenly_from_first_to_last() {
    assert_eq!(spread(372, 12), [0, 34, 67, 101, 135, 169, 202, 236, 270, 304, 337, 371]);
    assert_eq!(spread(3, 12), [0, 1, 2]);
    assert_eq!((spread(1, 12), spread(0, 12)), (vec![0], vec![]));
    assert_eq!(in_time(5, 10.0), (vec![0, 1, 2, 3, 4], 10.0));
    assert_eq!(in_time(20, 120.0), (vec![0, 8, 16], 15.0));
    assert_eq!(in_time(5, 25.0), (vec![0, 2, 3], 15.0));
    let (long, fps) = in_time(120 * 100, 120.0);
    assert_eq!((long.len(), fps), (MOST, 3.0));
}

#[test]
fn threads_do_not_change_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    let bytes = |threads: usize, form: fn(PathBuf) -> Stills| {
        let path = folder.path().join("a");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write(&header, Box::new(form(path.clone()))));
        std::fs::read(&path).unwrap()
    };
    assert!(bytes(1, Stills::sheet) == bytes(2, Stills::sheet));
    assert!(bytes(1, Stills::preview) == bytes(2, Stills::preview));
}

#[test]
fn colours_come_from_vertices_or_from_images_and_materials() {
    let folder = tempfile::tempdir().unwrap();
    let mut scan = header(DVec3::ZERO).scan.as_ref().clone();
    let mut notes = Notes::default();
    assert!(matches!(Paint::of(&scan, &mut notes), Paint::Colors(c) if c[0] == [0, 128, 0]));
    scan.look.colors.clear();
    let png = folder.path().join("green.png");
    std::fs::write(&png, Picture { width: 1, height: 1, pixels: vec![[0, 255, 0]] }.png().unwrap()).unwrap();
    scan.look.materials = vec![
        Material { base_color_texture: Some(Image::File(png)), ..Material::default() },
        Material {
            base_color: [0.0, 0.0, 1.0, 1.0],
            base_color_texture: Some(Image::File("none.png".into())),
            ..Material::default()
        },
    ];
    let Paint::Images { uvs, images, of } = Paint::of(&scan, &mut notes) else { panic!("images") };
    assert_eq!(images, [Texture::srgb(CLAY), Texture::plain([0.0, 1.0, 0.0]), Texture::plain([0.0, 0.0, 1.0])]);
    assert_eq!(notes.iter().filter(|n| n.starts_with("none.png: not in the pictures: ")).count(), 1);
    let triangles = scan.mesh.triangulate();
    assert_eq!((of.len(), uvs.len()), (triangles.corners.len(), triangles.corners.len()));
    assert_eq!((of[0], *of.last().unwrap()), (2, 1), "as the faces have their materials");
    assert_eq!((uvs[0][0], uvs.last().unwrap()[2]), ([0.25, 0.75], [0.5, 0.5]));
    scan.look.materials.clear();
    assert!(matches!(Paint::of(&scan, &mut notes), Paint::Plain));
}
