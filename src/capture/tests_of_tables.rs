//! Promises about tables of markers: every dialect of real files, the values that an independent reader found in them.
#![allow(clippy::unwrap_used)]

use super::tests::real;
use super::*;
use crate::error::Kind;
use crate::space::Unit;

/// A real file, uncleaned.
fn found(file: &str) -> Option<Capture> {
    let path = real(file)?;
    Some(read(&path, &ReadOptions { as_found: true, ..ReadOptions::default() }).unwrap())
}

/// A real file with all its columns, before any choice of markers.
fn table_of(file: &str) -> Option<(head::Head, MarkerTake)> {
    let bytes = source::load(&real(file)?).unwrap();
    let table = trc::read(&bytes, &ReadOptions::default()).unwrap();
    let columns: Vec<usize> = (0..table.head.labels.len()).collect();
    let labels = table.head.labels.clone();
    let (points, origin) = table.grid.dense(&columns).unwrap();
    Some((table.head, MarkerTake { labels, points, origin }))
}

fn at(capture: &Capture, frame: usize, label: &str) -> Option<DVec3> {
    let take = capture.motion.points();
    take.point(frame, take.labels.iter().position(|l| l == label).unwrap())
}

fn near(a: DVec3, b: [f64; 3], tolerance: f64) -> bool {
    a.distance(DVec3::from_array(b)) < tolerance
}

fn notes(capture: &Capture) -> Vec<&str> {
    capture.notes.iter().collect()
}

fn trc(text: &str) -> Result<Capture> {
    read_bytes(text.as_bytes().to_vec(), Path::new("a.trc"), &ReadOptions { as_found: true, ..ReadOptions::default() })
}

#[test]
fn trc_files_have_their_counts() {
    // Named markers, all markers, rows, number of the first frame, rate, cells of named markers without a position.
    for (file, named, all, frames, first, rate, missing) in [
        ("anto_wheelchair.trc", 34, 34, 128, 1, 100.0, None),
        ("kaydara_knee_spaces_in_names.trc.gz", 71, 71, 200, 1, 200.0, Some(3462)),
        ("mac_gait_empty_cells.trc.gz", 33, 105, 487, 1, 100.0, None),
        ("motek_ballet_reduced.trc", 41, 41, 100, 1, 30.0, Some(0)),
        ("motek_tpose.trc", 41, 41, 89, 1, 30.0, Some(0)),
        ("opensim_arm26.trc", 3, 3, 121, 1, 120.0, Some(0)),
        ("opensim_gait2354_static.trc.gz", 49, 49, 300, 1, 60.0, None),
        ("opensim_gait2354_walk1.trc", 41, 41, 151, 1, 60.0, None),
        ("opensim_leg39_negative_time.trc", 41, 41, 14, 1, 60.0, None),
        ("opensim_rajagopal_run_frame23.trc.gz", 42, 42, 510, 23, 100.0, None),
        ("opensim_rajagopal_static2_doubletabs.trc", 41, 41, 153, 1, 100.0, None),
        ("opensim_rajagopal_walk_doubletabs.trc", 41, 41, 238, 1, 100.0, None),
        ("unnamed_0markers_ragged.trc", 0, 10, 882, 1, 400.0, None),
    ] {
        let Some((head, take)) = table_of(&format!("trc/{file}")) else { continue };
        let unnamed = take.labels.iter().filter(|l| l.is_empty() || (l.starts_with('*') && all != named)).count();
        assert_eq!((take.markers() - unnamed, take.markers(), take.frames()), (named, all, frames), "{file}");
        assert_eq!((head.first_frame, head.rate), (first, rate), "{file}: {:?}", head.notes);
        assert_eq!(head.space.unit.unwrap().value, Unit::Millimetre, "{file}");
        if let Some(missing) = missing {
            assert_eq!(take.points.iter().filter(|p| p[0].is_nan()).count(), missing, "{file}");
        }
    }
}

#[test]
fn trc_files_have_the_values_that_an_independent_reader_found() {
    for (file, frame, label, truth) in [
        ("motek_tpose.trc", 0, "LSHO", [-159.08, 1392.64, 144.32]),
        ("motek_tpose.trc", 0, "LWRA", [-296.54, 1406.35, 676.45]),
        ("opensim_gait2354_walk1.trc", 0, "R.ASIS", [617.247620, 1055.275020, 170.781980]),
        ("opensim_leg39_negative_time.trc", 0, "R.ASIS", [-26.416, -31.413, 132.176]),
        ("opensim_rajagopal_run_frame23.trc.gz", 1, "LPSI", [874.005784, 1061.878162, -435.403032]),
        ("opensim_rajagopal_walk_doubletabs.trc", 1, "R.Shoulder", [-641.082, 1531.254, -94.682]),
        ("kaydara_knee_spaces_in_names.trc.gz", 0, "genou1_ NewMarker", [256.84422, 113.24970, 121.77992]),
        ("kaydara_knee_spaces_in_names.trc.gz", 0, "genou1_NewMarker3", [253.71635, 111.17779, 105.28433]),
        ("anto_wheelchair.trc", 1, "R.Poignee", [-200.96349, -116.51160, 721.66266]),
    ] {
        let Some(capture) = found(&format!("trc/{file}")) else { continue };
        let p = at(&capture, frame, label).unwrap();
        assert!(near(p, truth, 0.01), "{file} {label}: {p}");
    }
    // The take as it was processed into a C3D file: the same markers, smoothed, off by up to 8.4 mm.
    let (Some((_, raw)), Some(done)) = (table_of("trc/mac_gait_empty_cells.trc.gz"), found("c3d/mac_gait_dec.c3d")) else {
        return;
    };
    let done = done.motion.points();
    let apart = |frame: usize, m: usize| Some(raw.point(frame, m)?.distance(done.point(frame, m)?));
    let mut off: Vec<f64> = (0..487).flat_map(|f| (0..33).filter_map(move |m| apart(f, m))).collect();
    off.sort_by(f64::total_cmp);
    assert_eq!(off.len(), 5515);
    assert!(off[5514] < 8.5 && off[2757] < 1.0, "{} {}", off[5514], off[2757]);
    assert!((0..159).all(|f| (0..33).all(|m| raw.point(f, m).is_none())), "no named marker before row 160");
}

#[test]
fn variants_of_one_table_are_equal() {
    let Some(control) = found("broken/trc_ok_6frames.trc") else { return };
    let take = control.motion.points();
    assert_eq!((take.markers(), take.frames(), control.rate, notes(&control)), (12, 6, 30.0, Vec::new()));
    for (file, scale, said) in [
        ("trc_no_blank_line", 1.0, None),
        ("trc_units_m", 1000.0, None),
        ("trc_spaces", 1.0, None),
        ("trc_commas", 1.0, None),
        ("trc_decimal_commas", 1.0, None),
        ("trc_counts_lie", 1.0, Some("announces 41 markers, the line of names has 12")),
        ("trc_frame_numbers_restart", 1.0, Some("the frames are counted on from 1")),
    ] {
        let Some(capture) = found(&format!("broken/{file}.trc")) else { return };
        let other = capture.motion.points();
        assert_eq!((&other.labels, other.frames(), capture.rate), (&take.labels, 6, 30.0), "{file}");
        for i in 0..72 {
            let (p, q) = (other.point(i / 12, i % 12).unwrap() * scale, take.point(i / 12, i % 12).unwrap());
            assert!(p.distance(q) < 1e-3, "{file} {i}: {p} {q}");
        }
        let notes = notes(&capture);
        assert_eq!(said.is_some(), !notes.is_empty(), "{file}: {notes:?}");
        assert!(said.is_none_or(|s| notes.iter().any(|n| n.contains(s))), "{file}: {notes:?}");
    }
}

#[test]
fn missing_positions_are_told_in_many_ways() {
    for (file, frames, said) in [
        ("trc_nan_spellings", vec![0, 1, 2, 3, 4, 5], None),
        ("trc_gap_numbers", vec![0, 1, 2, 3, 4, 5], Some("3 positions are numbers such as 9999999")),
    ] {
        let Some(capture) = found(&format!("broken/{file}.trc")) else { return };
        let take = capture.motion.points();
        let lost: Vec<usize> = (0..72).filter(|i| take.point(i / 12, i % 12).is_none()).collect();
        let head = take.labels.iter().position(|l| l == "LBHD").unwrap();
        assert_eq!(lost, frames.iter().map(|f| f * 12 + head).collect::<Vec<_>>(), "{file}");
        assert!(said.is_none_or(|s| notes(&capture).iter().any(|n| n.contains(s))), "{:?}", notes(&capture));
    }
    let (Some(control), Some(short)) = (found("broken/trc_ok_6frames.trc"), found("broken/trc_trailing_gap_cells_dropped.trc"))
    else {
        return;
    };
    let (whole, short) = (control.motion.points(), short.motion.points());
    let lost: Vec<usize> = (0..72).filter(|i| short.points[*i][0].is_nan()).collect();
    assert!(!lost.is_empty() && lost.iter().all(|i| i % 12 >= 9), "{lost:?}");
    assert!((0..72).filter(|i| !lost.contains(i)).all(|i| short.points[i] == whole.points[i]));
}

const HEADER: &str = "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n50\t50\t3\t2\tcm\n";

#[test]
fn frames_that_are_left_out_become_gaps() {
    let rows = "Frame#\tTime\tC7\t\t\tT10\n\tX1\tY1\tZ1\n\n-2\t-.04\t1\t2\t3\t4\t5\t6\n-1\t-.02\t1\t2\t4\n1\t.02\t7\t8\t9\n";
    let capture = trc(&format!("{HEADER}{rows}")).unwrap();
    let take = capture.motion.points();
    assert_eq!((capture.first_frame, take.frames(), capture.rate), (-2, 4, 50.0));
    assert_eq!(take.point(3, 0), Some(DVec3::new(7.0, 8.0, 9.0)));
    assert_eq!((take.point(2, 0), take.point(1, 1)), (None, None));
    assert!(notes(&capture).iter().any(|n| n.starts_with("1 frame left out")), "{:?}", notes(&capture));
}

#[test]
fn times_are_believed_before_the_rate_of_the_header() {
    let names = "Frame#\tTime\tC7\t\t\tT10\n";
    let rows: String = (0..100).map(|f| format!("{f}\t{:.3}\t1\t2\t{f}\t4\t5\t6\n", f64::from(f) / 120.0)).collect();
    let capture = trc(&format!("{HEADER}{names}{rows}")).unwrap();
    assert!((capture.rate - 120.0).abs() < 0.2, "{}", capture.rate);
    assert!(notes(&capture).iter().any(|n| n.contains("the header says 50 Hz, the times 120 Hz")), "{:?}", notes(&capture));
    // Rounded times do not contradict.
    let rows: String = (0..100).map(|f| format!("{f}\t{:.3}\t1\t2\t{f}\t4\t5\t6\n", f64::from(f) / 50.0 + 0.0004)).collect();
    assert_eq!(trc(&format!("{HEADER}{names}{rows}")).unwrap().rate, 50.0);
}

#[test]
fn a_rate_of_zero_is_that_of_the_cameras_and_columns_without_any_name_are_numbered() {
    let header = HEADER.replace("\n50\t50\t", "\n0\t50\t");
    let rows = "1\t\t1\t2\t3\t4\t5\t6\n2\t\t1\t2\t3\t4\t5\t7\n";
    assert_eq!(trc(&format!("{header}Frame#\tTime\tC7\t\t\tT10\n{rows}")).unwrap().rate, 50.0);
    // Doubled separators between the names of the header only.
    let padded = HEADER.replace("CameraRate\tNumFrames", "CameraRate\t\tNumFrames");
    let capture = trc(&format!("{padded}Frame#\tTime\tC7\t\t\tT10\n{rows}")).unwrap();
    assert_eq!(capture.space.unit.map(|known| known.value), Some(crate::space::Unit::Centimetre), "{:?}", notes(&capture));
    let bare = trc(&format!("{HEADER}Frame#\tTime\n{rows}")).unwrap();
    assert_eq!(bare.motion.points().labels, ["M001", "M002"]);
    assert!(notes(&bare).contains(&"the file has no labels: its 2 points are numbered"), "{:?}", notes(&bare));
}

#[test]
fn a_take_far_away_loses_nothing() {
    let far = DVec3::new(3e7, -3e7, 6e7);
    let place = |f: i32, m: i32| DVec3::new(f64::from(f) * 0.125, f64::from(m) * 0.25, f64::from(f * m) * 0.0625) + far;
    let names = "Frame#\tTime\tC7\t\t\tT10\t\t\tCLAV\n";
    let rows: String = (0..600)
        .map(|f| {
            let cells: String = (0..3).map(|m| place(f, m)).map(|p| format!("\t{}\t{}\t{}", p.x, p.y, p.z)).collect();
            format!("{f}\t{}{cells}\n", f64::from(f) / 50.0)
        })
        .collect();
    let capture = trc(&format!("{HEADER}{names}{rows}")).unwrap();
    let take = capture.motion.points();
    assert_ne!(take.origin, DVec3::ZERO);
    for (f, m) in (0..600).flat_map(|f| (0..3).map(move |m| (f, m))) {
        assert_eq!(take.point(f as usize, m as usize).unwrap(), place(f, m));
    }
}

#[test]
fn broken_tables_are_refused_with_the_place() {
    for (text, said) in [
        (format!("{HEADER}Frame#\tTime\tC7\n1\t0\t1\tx2\t3\n"), "cell 4 is 'x2' (line 5)"),
        (format!("{HEADER}Frame#\tTime\tC7\n1.5\t0\t1\t2\t3\n"), "frame '1.5' (line 5)"),
        (format!("{HEADER}Frame#\tTime\tC7\n\tX1\tY1\tZ1\n"), "no row below the header"),
        (format!("{HEADER}Frame#\tTime\n1\t0\n2\t0\n"), "no row has a position"),
        ("PathFileType 4\nDataRate Units\n50 mm\nFrame# Time C7 T10\n1 0 1 2 3 4 5\n".into(), "7 cells (line 5)"),
    ] {
        let error = trc(&text).unwrap_err();
        assert_eq!(error.kind, Kind::Malformed, "{error}");
        assert!(error.to_string().contains(said), "{error}");
    }
    // A row that the file ends in is left out.
    let cut = trc(&format!("{HEADER}Frame#\tTime\tC7\t\t\tT10\n1\t0\t1\t2\t3\t4\t5\t6\n2\t.02\t1\t2\t3\t4\t5")).unwrap();
    assert_eq!(cut.motion.points().frames(), 1);
    assert!(notes(&cut).iter().any(|n| n.contains("cut short")));
}

const MOTIVE: &str = "csv/optitrack_motive_763_excerpt.csv";

#[test]
fn a_motive_export_has_its_counts_and_values() {
    let Some(capture) = found(MOTIVE) else { return };
    let take = capture.motion.points();
    assert_eq!((take.markers(), take.frames(), capture.first_frame, capture.rate), (54, 32, 0, 120.0));
    assert_eq!((capture.name.as_str(), capture.cleaning.ghosts), ("763", 28));
    assert_eq!(capture.space.unit.unwrap().value, Unit::Millimetre);
    assert!(near(at(&capture, 0, "LWristOut").unwrap(), [763.681274, 1014.0755, 109.466774], 1e-4));
    let said = notes(&capture).join("\n");
    assert!(
        said.contains("51 segments with turns left aside") && said.contains("announces 17263 frames, 32 are there"),
        "{said}"
    );

    let motive_csv::Export::Markers(table) =
        motive_csv::read(&source::load(&capture.source).unwrap(), &ReadOptions::default()).unwrap()
    else {
        panic!("no markers");
    };
    let measured = table.head.labels.len();
    let (points, _) = table.grid.dense(&(0..measured).collect::<Vec<_>>()).unwrap();
    // 82 measured markers in 32 rows, of which 2784 cells of three are empty, or 928 positions.
    let there = points.chunks_exact(measured).map(|row| row.iter().filter(|p| !p[0].is_nan()).count()).sum::<usize>();
    assert_eq!((measured, 82 * 32 - there), (82, 928));
}

#[test]
fn bones_of_a_motive_export_are_segments_with_turns() {
    let Some(path) = real(MOTIVE) else { return };
    let capture = read(&path, &ReadOptions { bodies: true, ..ReadOptions::default() }).unwrap();
    let Motion::Skeleton(take) = &capture.motion else { panic!("no skeleton") };
    assert_eq!((take.joints.len(), take.origins.frames(), take.rotations.len()), (51, 32, 51 * 32));
    assert!(near(at(&capture, 0, "763").unwrap(), [285.756531, 858.265198, 20.016041], 1e-4));
    let q = take.rotations[0];
    let truth = [0.048067, -0.026826, -0.001448, 0.998483];
    assert!((0..4).all(|i| (f64::from(q[i]) - truth[i]).abs() < 2e-6), "{q:?}");
    let parent = |name: &str| {
        let joint = take.joints.iter().find(|j| j.name == name).unwrap();
        joint.parent.map(|p| take.joints[p].name.as_str())
    };
    assert_eq!(
        [parent("763"), parent("Ab"), parent("Head"), parent("LUArm")],
        [None, Some("763"), Some("Neck"), Some("LShoulder")]
    );
}

#[test]
fn a_motive_body_whose_quaternion_is_none_is_missing() {
    let turned = |first: &str| {
        let text = format!(
            "Format Version,1.23,Export Frame Rate,100,Length Units,Meters,Coordinate Space,Global\n\n,Type{}\n,Name{}\n,ID{}\n\
             ,,{}\nFrame,Time,X,Y,Z,W,X,Y,Z\n0,0,{first},1,2,3\n1,0.01,0,0,0,1,1,2,4\n",
            ",Rigid Body".repeat(7),
            ",Stick".repeat(7),
            ",7".repeat(7),
            ["Rotation"; 4].iter().chain(&["Position"; 3]).copied().collect::<Vec<_>>().join(",")
        );
        read_bytes(text.into_bytes(), Path::new("a.csv"), &ReadOptions { as_found: true, ..ReadOptions::default() }).unwrap()
    };
    let place = |first| turned(first).motion.points().point(0, 0);
    assert_eq!(place("0,0,0.6,0.8"), Some(DVec3::new(1.0, 2.0, 3.0)));
    // Rounded digits are no reason, but a quarter of a quaternion says nothing.
    assert_eq!(place("0,0,0.59,0.81"), Some(DVec3::new(1.0, 2.0, 3.0)));
    assert_eq!((place("0,0,0.15,0.2"), place("0,0,0,0")), (None, None));
}

#[test]
fn motive_files_with_a_doubtful_header_are_read_with_a_warning() {
    let Some(control) = found("broken/motive_markers_only.csv") else { return };
    let take = control.motion.points();
    assert_eq!((take.markers(), take.frames(), control.rate), (5, 4, 120.0));
    assert!(near(at(&control, 3, "ChestTop").unwrap(), [275.070404, 1337.911621, 169.859375], 1e-4));
    for (file, said) in
        [("motive_rate_zero", "a frame rate of 0: ignored"), ("motive_metres_flag_mm_values", "the unit is doubtful")]
    {
        let other = found(&format!("broken/{file}.csv")).unwrap();
        assert_eq!((&other.motion.points().points, other.rate), (&take.points, 120.0), "{file}");
        assert!(notes(&other).iter().any(|n| n.contains(said)), "{file}: {:?}", notes(&other));
    }
}

fn csv(text: &str) -> Result<Capture> {
    read_bytes(text.as_bytes().to_vec(), Path::new("a.csv"), &ReadOptions { as_found: true, ..ReadOptions::default() })
}

#[test]
fn wide_and_long_tables_of_markers_are_equal() {
    let wide = "# unit: cm\n# up Z\nframe,time,C7_x,C7_y,C7_z,T10_x,T10_y,T10_z\n7,0.0,1,2,3,4,5,6\n8,0.02,1.5,2,3,,,\n9,0.04,2,2,3,4,5,8\n";
    let long = "\u{feff}#unit=cm\r\n#up = +Z\r\n#rate 50 Hz\r\nframe;marker;z;x;y;quality\r\n9;C7;3;2;2;1\r\n7;C7;3;1;2;1\r\n7;T10;6;4;5;1\r\n8;C7;3;1,5;2;0\r\n9;T10;8;4;5;0\r\n";
    let (wide, long) = (csv(wide).unwrap(), csv(long).unwrap());
    let (a, b) = (wide.motion.points(), long.motion.points());
    assert_eq!((&a.labels, a.frames(), wide.first_frame, wide.rate), (&b.labels, b.frames(), long.first_frame, long.rate));
    assert_eq!((a.labels.join(" "), a.frames(), wide.first_frame, wide.rate), ("C7 T10".into(), 3, 7, 50.0));
    for i in 0..6 {
        assert_eq!(a.point(i / 2, i % 2), b.point(i / 2, i % 2), "{i}");
    }
    assert_eq!((a.point(1, 0), a.point(1, 1)), (Some(DVec3::new(1.5, 2.0, 3.0)), None));
    assert_eq!(wide.space, long.space);
    assert_eq!((wide.space.unit.unwrap().value, wide.space.up.unwrap().value.to_string()), (Unit::Centimetre, "+Z".to_owned()));
    assert!(notes(&wide).is_empty(), "{:?}", notes(&wide));
    assert_eq!(notes(&long), ["1 columns are neither frame, time nor the coordinate of a marker: passed over"]);
    // A name that comes again is another marker; what is no coordinate is passed over.
    let twice = csv("frame,C7_x,C7_y,C7_z,C7_x,C7_y,C7_z,quality,T10_x\n1,1,2,3,4,5,6,9,9\n2,1,2,3,4,5,7,9,9\n").unwrap();
    let take = twice.motion.points();
    assert_eq!(
        (take.markers(), take.point(0, 0), take.point(1, 1)),
        (2, Some(DVec3::new(1.0, 2.0, 3.0)), Some(DVec3::new(4.0, 5.0, 7.0)))
    );
    assert!(notes(&twice).iter().any(|n| n.starts_with("2 columns are neither")), "{:?}", notes(&twice));
}

#[test]
fn names_are_treated_alike_in_every_format() {
    let names = ["Ann:LFHD", "Ann:C7", "Ann:T10", "Ann:CLAV", "Ann:LKneeAngles", "*12", "Bob:C7"];
    let cells = |f: i32, m: usize| [f, m as i32 + 1, 3];
    let header: String = names.iter().map(|n| format!("{n}_x,{n}_y,{n}_z,")).collect();
    let rows: String = (1..20)
        .map(|f| format!("{f},{}\n", (0..7).flat_map(|m| cells(f, m)).map(|c| c.to_string()).collect::<Vec<_>>().join(",")))
        .collect();
    let table = csv(&format!("frame,{}\n{rows}", header.trim_end_matches(','))).unwrap();
    let header: String = names.iter().map(|n| format!("\t{n}\t\t")).collect();
    let trc = trc(&format!(
        "{HEADER}Frame#\tTime{header}\n{}",
        rows.replace(',', "\t")
            .lines()
            .map(|l| {
                let (frame, rest) = l.split_once('\t').unwrap();
                format!("{frame}\t\t{rest}\n")
            })
            .collect::<String>()
    ))
    .unwrap();
    for capture in [&table, &trc] {
        assert_eq!(capture.motion.points().labels, ["LFHD", "C7", "T10", "CLAV"]);
        let c = &capture.cleaning;
        assert_eq!((capture.name.as_str(), c.ghosts, c.computed, c.other_subjects), ("Ann", 1, 1, 1));
    }
    assert_eq!(table.motion.points().points, trc.motion.points().points);
}

#[test]
fn a_table_is_one_of_handles_or_of_markers_by_its_first_lines() {
    let folder = tempfile::tempdir().unwrap();
    for (text, handles) in [
        ("# mine\nframe,name,x,y,z\n0,a,1,2,3\n", true),
        ("frame,name,x,y\n", true),
        ("frame,marker,x,y,z\n0,a,1,2,3\n", false),
        ("# c\n\ntime,A_x,A_y,A_z\n0,1,2,3\n", false),
        ("Format Version,1.23,Take Name,x\n", false),
        ("PathFileType\t4\n", false),
    ] {
        let path = folder.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        assert_eq!(is_handle_table(&path), handles, "{text}");
    }
    assert!(is_handle_table(&folder.path().join("none.csv")) && !is_handle_table(&folder.path().join("none.c3d")));
    for (text, said) in [
        ("frame,A_x,A_y,A_z\n0,1,2,x3\n", "column 4 is 'x3' (line 2)"),
        ("frame,A_x,A_y,A_z\n0,1,2,3,4\n", "5 cells (line 2)"),
        ("frame,A_x,A_y,A_z\n", "no row below the header"),
        ("frame,marker,x,y,z\n0,a,1,2,3\n0,a,1,2,3\n", "marker a has a second place in the frame (line 3)"),
    ] {
        let error = csv(text).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
    }
}

#[test]
fn uneven_tables_take_no_more_memory_than_they_deserve() {
    // One long row among many short ones, and one marker more in every frame.
    let wide: String = (0..60_000).map(|_| "1,1,1,").collect();
    let rows: String = (2..20_000).map(|f| format!("{f},0\n")).collect();
    let text = format!("PathFileType,4\nDataRate,Units\n50,mm\nFrame#,Time\n1,0,{wide}\n{rows}");
    assert!(trc(&text).unwrap_err().to_string().contains("hardly any of which is there"));
    let long: String = (0..60_000).map(|f| format!("{f},m{f},1,2,3\n")).collect();
    assert!(csv(&format!("frame,marker,x,y,z\n{long}")).unwrap_err().to_string().contains("hardly any of which is there"));
}

#[test]
fn rotation_blocks_are_segments_with_turns() {
    let Some(path) = real("c3d/theia_rotations.c3d") else { return };
    let whole = read(&path, &ReadOptions { as_found: true, ..ReadOptions::default() }).unwrap();
    let Motion::Skeleton(take) = &whole.motion else { panic!("no skeleton") };
    assert_eq!((take.joints.len(), take.origins.frames(), whole.first_frame, whole.rate), (20, 340, 1, 85.0));
    assert!(take.joints.iter().all(|j| j.parent.is_none() && !j.name.ends_with("4X4")));
    assert!(near(at(&whole, 1, "pelvis").unwrap(), [-281.274, 689.076, 941.368], 1e-3));
    assert!(near(at(&whole, 1, "head").unwrap(), [-254.576, 723.303, 1645.460], 1e-3));
    let pelvis = take.origins.labels.iter().position(|l| l == "pelvis").unwrap();
    let turn = glam::DMat3::from_quat(DQuat::from_array(take.rotations[20 + pelvis].map(f64::from)));
    let rows = [[0.9982, 0.0552, 0.0237], [-0.0542, 0.9977, -0.0411], [-0.0260, 0.0398, 0.9989]];
    for (r, row) in rows.iter().enumerate() {
        assert!(near(turn.row(r), *row, 3e-4), "{turn}");
    }
    let missing = |frame: usize| take.rotations[frame * 20..(frame + 1) * 20].iter().filter(|q| q[0].is_nan()).count();
    assert_eq!([0, 1, 335, 336, 337, 338, 339].map(missing), [20, 0, 0, 9, 9, 20, 20]);
    // Empty frames at the ends are cut off, and their numbers are kept.
    let clean = read(&path, &ReadOptions::default()).unwrap();
    assert_eq!((clean.motion.points().frames(), clean.first_frame), (337, 2));
    assert!(clean.motion.points().point(0, pelvis).unwrap().distance(at(&whole, 1, "pelvis").unwrap()) == 0.0);
}

/// A file of so many samples of two segments and no points, as a marker-less system writes it.
pub(super) fn rotations(samples: u16) -> Vec<u8> {
    rotations_of(samples, &[2, 0, 2, 0, 0], &[2, 0, 3, 0, 0])
}

/// The same where ROTATION:USED and ROTATION:DATA_START are these floats.
pub(super) fn rotations_in_floats(samples: u16, used: f32, block: f32) -> Vec<u8> {
    let [used, block] = [used, block].map(|x| [[4, 0].as_slice(), &x.to_le_bytes(), &[0]].concat());
    rotations_of(samples, &used, &block)
}

fn rotations_of(samples: u16, used: &[u8], block: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0u8; 1024];
    let mut word = |at: usize, value: u16| bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
    word(0, 0x5002);
    word(6, 1);
    word(8, samples);
    word(16, 3);
    bytes[12..16].copy_from_slice(&(-1.0f32).to_le_bytes());
    bytes[20..24].copy_from_slice(&50.0f32.to_le_bytes());
    let mut section = vec![1, 0x50, 1, 84];
    let entry = |name: &str, id: i8, body: &[u8]| {
        let mut entry = vec![name.len() as u8, id as u8];
        entry.extend(name.as_bytes());
        entry.extend((body.len() as u16 + 2).to_le_bytes());
        entry.extend(body);
        entry
    };
    section.extend(entry("ROTATION", -1, &[0]));
    section.extend(entry("USED", 1, used));
    section.extend(entry("DATA_START", 1, block));
    section.extend(entry("RATE", 1, &[[4, 0].as_slice(), &50.0f32.to_le_bytes(), &[0]].concat()));
    section.extend(entry("LABELS", 1, &[[255, 2, 10, 2].as_slice(), b"pelvis_4X4worldbody ", &[0]].concat()));
    bytes[512..512 + section.len()].copy_from_slice(&section);
    for k in 0..samples {
        for segment in 0..2 {
            let turn =
                glam::Mat4::from_rotation_translation(glam::Quat::from_rotation_z(f32::from(k) * 0.1), glam::Vec3::splat(9.0));
            let mark = if segment == 0 && k == 3 { -1.0f32 } else { 0.0 };
            turn.to_cols_array().iter().chain(&[mark]).for_each(|x| bytes.extend(x.to_le_bytes()));
        }
    }
    bytes
}

#[test]
fn a_segment_marked_as_missing_is_a_gap() {
    let capture = read_bytes(rotations(8), Path::new("a.c3d"), &ReadOptions::default()).unwrap();
    let Motion::Skeleton(take) = &capture.motion else { panic!("no skeleton") };
    assert_eq!((take.joints[0].name.as_str(), take.origins.frames(), capture.rate), ("pelvis", 8, 50.0));
    for k in 0..8u8 {
        let turn = DQuat::from_array(take.rotations[usize::from(k)].map(f64::from));
        let angle = DQuat::from_rotation_z(f64::from(k) * 0.1).angle_between(turn);
        assert!(if k == 3 { turn.x.is_nan() } else { angle < 1e-6 }, "{k}: {turn}");
    }
}

#[test]
fn counts_of_segments_that_no_file_can_hold_are_not_believed() {
    let read = |used, block| read_bytes(rotations_in_floats(8, used, block), Path::new("a.c3d"), &ReadOptions::default());
    assert_eq!(read(2.0, 3.0).unwrap().motion.points().labels, ["pelvis"]);
    // 68 bytes are a segment, 1,088 are there.
    assert_eq!(read(16.0, 3.0).unwrap().motion.points().frames(), 1);
    for (used, block) in [(17.0, 3.0), (1e30, 3.0), (2e8, 3.0), (70_000.0, 3.0), (2.5, 3.0), (-1.0, 3.0), (f32::NAN, 3.0)] {
        assert!(read(used, block).unwrap_err().found.contains("no points"), "{used} from block {block}");
    }
    for block in [1e30, 1.0, 0.0, 2.5, 9000.0, f32::INFINITY] {
        assert!(read(2.0, block).is_err(), "block {block}");
    }
}

#[test]
fn impossible_segments_beside_points_are_said_and_left_out() {
    let mut bytes = rotations_in_floats(60, 1e30, 3.0);
    // Two points per frame, over what were matrices.
    bytes[2..4].copy_from_slice(&2u16.to_le_bytes());
    let capture = read_bytes(bytes, Path::new("a.c3d"), &ReadOptions { as_found: true, ..ReadOptions::default() }).unwrap();
    assert!(matches!(capture.motion, Motion::Markers(_)));
    assert!(capture.notes.iter().any(|n| n.contains("no segments are read")), "{:?}", capture.notes);
}
