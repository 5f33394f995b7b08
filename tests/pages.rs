//! Pages and pictures of a run of the program.

#![allow(clippy::unwrap_used)]

mod common;

use common::{fixture, retarget_ok};
use std::fs;
use std::path::Path;

/// The short take in all of these formats, by so many threads.
fn run(work: &Path, threads: &str) -> [Vec<u8>; 3] {
    let pair = [fixture("scan.obj"), fixture("walk.c3d")].map(|p| p.to_string_lossy().into_owned());
    let more = ["--frames", "101..124", "--force", "--threads", threads, "-o", "a.html", "-o", "a.png", "-o", "a.apng"];
    retarget_ok(work, pair.into_iter().chain(more.map(String::from)).collect::<Vec<_>>());
    ["a.html", "a.png", "a.apng"].map(|name| fs::read(work.join(name)).unwrap())
}

fn json(page: &str) -> serde_json::Value {
    let (_, rest) = page.split_once("id=\"run\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_run_writes_pages_and_pictures_the_same_for_any_number_of_threads() {
    let work = tempfile::tempdir().unwrap();
    let files = run(work.path(), "1");
    assert!(files == run(work.path(), "2"), "threads change a byte");

    let page = String::from_utf8(files[0].clone()).unwrap();
    assert!(!page.contains("http:") && !page.contains("https:"));
    let told = json(&page);
    assert_eq!((&told["frames"], &told["first"], &told["unit"]), (&24.into(), &101.into(), &"mm".into()));
    assert_eq!(told["handles"].as_array().unwrap().len(), 41);
    let volumes = told["volume"].as_array().unwrap();
    assert!(volumes.len() == 24 && volumes.iter().all(|v| (v.as_f64().unwrap() - 1.0).abs() < 0.05));
    assert!(told["max"].as_array().unwrap().iter().any(|r| r.as_f64().unwrap() > 0.1), "residuals are not all 0");
    assert!(told["rest"][0].as_array().unwrap().iter().all(|x| x.as_f64().unwrap().abs() < 2.0), "in the scan's metres");

    for (bytes, count) in files[1..].iter().zip([1, 3]) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().map_or(1, |a| a.num_frames), count);
        let mut picture = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut picture).unwrap();
        // The shirt of the scan's texture.
        let blue = |p: &&[u8]| p[2] > p[0].saturating_add(40) && p[2] > p[1].saturating_add(15);
        assert!(picture.chunks(3).filter(blue).count() > 2000, "the texture is not in the picture");
    }
}

#[test]
fn a_page_or_a_picture_holds_the_whole_take() {
    let work = tempfile::tempdir().unwrap();
    for name in ["p_##.html", "p_##.png", "p_##.apng"] {
        let out = common::retarget(work.path(), ["scan.obj", "walk.c3d", "-o", name]);
        assert_eq!(out.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&out.stderr).contains("holds the whole take"), "{name}");
    }
}
