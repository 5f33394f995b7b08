#![allow(clippy::unwrap_used)]

use super::*;
use crate::export::glb::GlbSink;
use crate::export::glb::tests::{FRAMES, header, pose};
use crate::export::{FrameMeasure, Residual};

/// Where handle `h` holds the bar in a frame; it should be a tenth above, and is missing in frame 3.
fn hold(header: &Header, frame: usize, h: usize) -> DVec3 {
    pose(header, frame)[h * 100]
}

fn run(header: &Arc<Header>, mut sink: Box<dyn FrameSink>) -> Written {
    let names = ["A</script>".to_owned(), "B".to_owned()];
    let rest = [header.proxy.rest[0], header.proxy.rest[100]];
    sink.begin(header).unwrap();
    for frame in 0..FRAMES {
        let holds = [vec![hold(header, frame, 0), hold(header, frame, 1)]];
        let lifted = |p: &DVec3| if frame == 3 { DVec3::NAN } else { *p + DVec3::Y * 0.1 };
        let targets = [holds[0].iter().map(lifted).collect()];
        let residual = Residual { median: 1.0, max: frame as f64, worst: (frame != 3).then_some(1) };
        let mut measure = FrameMeasure { frame: 50 + frame as i64, residual, ..FrameMeasure::default() };
        measure.stats.volume_ratio = 1.0 + 0.01 * frame as f64;
        measure.stats.converged = frame != 5;
        measure.stats.inverted = if frame == 7 { 11 } else { 10 };
        let (frames, names, metres) = (&[measure][..], &names[..], Some(0.001));
        let (examples, weights) = (&["fist".to_owned()][..], &[vec![0.05 * frame as f64]][..]);
        let (rest, holds, targets) = (&rest[..], &holds[..], &targets[..]);
        sink.measured(&Measures { frames, names, examples, weights, rest, holds, targets, metres }).unwrap();
        sink.frames(&FrameBatch { first: frame, proxy: &[pose(header, frame)], points: &[], normals: &[] }).unwrap();
    }
    sink.finish().unwrap()
}

/// What stands in the element with an id.
fn element<'a>(page: &'a str, id: &str) -> &'a str {
    let (_, rest) = page.split_once(&format!(" id=\"{id}\">")).unwrap();
    rest.split_once("</script>").unwrap().0
}

/// Plain base 64 the other way round.
fn decoded(text: &str) -> Vec<u8> {
    let letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bits, mut count, mut out) = (0u32, 0, Vec::new());
    for c in text.trim_end_matches('=').chars() {
        bits = bits << 6 | letters.find(c).unwrap() as u32;
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push((bits >> count) as u8);
            bits &= (1 << count) - 1;
        }
    }
    out
}

#[test]
fn a_page_holds_the_glb_and_asks_for_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::new(5.0, 0.0, 0.0));
    let (glb, html) = (folder.path().join("a.glb"), folder.path().join("a.html"));
    let beside = run(&header, Box::new(GlbSink::new(&glb)));
    let written = run(&header, Box::new(PageSink::new(&html)));
    let page = std::fs::read_to_string(&html).unwrap();
    assert_eq!(written.bytes, page.len() as u64);
    assert_eq!((written.max_error, written.worst_frame), (beside.max_error, beside.worst_frame));
    assert!(decoded(element(&page, "glb")) == std::fs::read(&glb).unwrap(), "the GLB of the page is another one");
    for word in ["http:", "https:", "//cdn", "import ", "fetch(", "{{"] {
        assert!(!page.contains(word), "{word} in the page");
    }
    assert_eq!(page.matches("<script").count(), 3);
    assert_eq!(page.matches("</script>").count(), 3, "a name ends an element");
    assert!(page.contains("<title>bar · walk</title>"));
}

#[test]
fn a_page_tells_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    let html = folder.path().join("a.html");
    run(&header, Box::new(PageSink::new(&html)));
    let page = std::fs::read_to_string(&html).unwrap();
    let run: Value = serde_json::from_str(element(&page, "run")).unwrap();
    assert_eq!((&run["frames"], &run["first"], &run["rate"]), (&json!(FRAMES), &json!(50), &json!(120.0)));
    assert_eq!(run["handles"], json!(["A</script>", "B"]));
    assert_eq!((run["max"][9].as_f64(), run["volume"][9].as_f64()), (Some(9.0), Some(1.09)));
    assert_eq!((&run["examples"], run["weights"][0][8].as_f64()), (&json!(["fist"]), Some(0.4)));
    assert_eq!((run["weights"].as_array().unwrap().len(), run["weights"][0].as_array().unwrap().len()), (1, FRAMES));
    let flags: Vec<u64> = run["flags"].as_array().unwrap().iter().map(|f| f.as_u64().unwrap()).collect();
    let expected: Vec<u64> = (0..FRAMES).map(|f| [(3, 4), (5, 1), (7, 2)].iter().find(|x| x.0 == f).map_or(0, |x| x.1)).collect();
    assert_eq!(flags, expected);
    let summary = run["summary"][1].as_str().unwrap();
    assert!(
        summary.starts_with("24 frames at 120 fps · residual median 1 mm, largest 23 mm (B, frame 73) · skin, "),
        "{summary}"
    );
    // Places come back to half a step, in the coordinates of the GLB.
    let number = |key: &str, k: usize| run[key][k].as_f64().unwrap();
    let paths: Vec<u16> = decoded(run["paths"].as_str().unwrap()).chunks(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    assert_eq!(paths.len(), FRAMES * 2 * 2 * 3);
    let space = file_space(&header.unit_box).0;
    for frame in 0..FRAMES {
        for (place, what, h) in [(0, 0.0, 0), (1, 0.0, 1), (2, 0.1, 0), (3, 0.1, 1)] {
            let steps = &paths[(4 * frame + place) * 3..][..3];
            if frame == 3 && what > 0.0 {
                assert_eq!(steps, [MISSING; 3]);
                continue;
            }
            let exact = space.leave(hold(&header, frame, h) + DVec3::Y * what).to_array();
            for k in 0..3 {
                let back = number("low", k) + f64::from(steps[k]) * number("step", k);
                assert!((back - exact[k]).abs() <= 0.51 * number("step", k), "frame {frame}, place {place}, axis {k}");
            }
        }
    }
}

#[test]
fn a_page_is_whole_or_absent() {
    let folder = tempfile::tempdir().unwrap();
    let header = header(DVec3::ZERO);
    let mut sink = PageSink::new(folder.path().join("new/a.html"));
    sink.begin(&header).unwrap();
    sink.frames(&FrameBatch { first: 0, proxy: &[pose(&header, 0)], points: &[], normals: &[] }).unwrap();
    drop(sink);
    let mut empty: Box<dyn FrameSink> = Box::new(PageSink::new(folder.path().join("new/a.html")));
    empty.begin(&header).unwrap();
    assert!(empty.finish().unwrap_err().to_string().contains("no frames"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
