//! Damaged captures of markers end in a take or an error, soon and within bounded memory.

#![allow(clippy::unwrap_used)]

use super::c3d_writer::{C3dFile, Processor};
use super::fuzz_tables::{c3d, csv, trc};
use crate::fuzz::mutants::run;
use std::path::Path;

fn points(frames: usize) -> Vec<Option<[f32; 3]>> {
    let place = |f: usize, m: usize| [f as f32 * 3.0 + (m as f32).sin() * 90.0, (m * m) as f32, 900.0 + 50.0 * m as f32];
    (0..frames).flat_map(|f| (0..6).map(move |m| ((f + m) % 7 > 0).then(|| place(f, m)))).collect()
}

fn c3d_samples() -> Vec<Vec<u8>> {
    let labels = ["A:C7", "A:T10", "A:CLAV", "A:STRN", "A:LKneeAngles", "*1"].map(str::to_owned).to_vec();
    let file = C3dFile { labels, points: points(12), subjects: vec!["A".into()], ..C3dFile::default() };
    let integers = C3dFile { processor: Processor::Mips, integers: Some(0.05), analog: 4, first_frame: 70_000, ..file.clone() };
    let in_floats = super::tests_of_tables::rotations_in_floats(8, 2.0, 3.0);
    vec![file.bytes(), integers.bytes(), super::tests_of_tables::rotations(8), in_floats]
}

fn trc_samples() -> Vec<Vec<u8>> {
    let header = "PathFileType\t4\t(X/Y/Z)\ta.trc\r\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\r\n50\t50\t9\t6\tmm\r\n";
    let mut tabs = format!("{header}Frame#\tTime\tC7\t\t\tT10\t\t\tCLAV\t\t\tSTRN\t\t\t\t\t\tLSHO\r\n\tX1\tY1\tZ1\r\n\r\n");
    let mut blanks = "PathFileType 4\nDataRate Units\n50 mm\nFrame# Time C7 T10 CLAV STRN LASI RASI\n".to_owned();
    for (f, row) in points(9).chunks_exact(6).enumerate() {
        tabs += &format!("{f}\t{:.3}", f as f64 / 50.0);
        blanks += &format!("{f} {:.3}", f as f64 / 50.0);
        for p in row {
            tabs += &p.map_or("\t\t\t".into(), |p| format!("\t{:.2}\t{:.2}\t{}", p[0], p[1], p[2]));
            blanks += &p.map_or(" nan nan nan".into(), |p| format!(" {:.2} {:.2} {}", p[0], p[1], p[2]));
        }
        tabs += "\t\r\n";
        blanks += "\n";
    }
    vec![tabs.into_bytes(), blanks.into_bytes()]
}

fn csv_samples() -> Vec<Vec<u8>> {
    let mut wide = "# rate 50\n# unit mm\nframe,time,C7_x,C7_y,C7_z,T10_x,T10_y,T10_z\n".to_owned();
    let mut long = "frame;marker;x;y;z\n".to_owned();
    let mut motive = "Format Version,1.23,Export Frame Rate,50,Length Units,Millimeters\n\n\
        ,Type,Marker,Marker,Marker,Bone,Bone,Bone,Bone,Bone,Bone,Bone\n,Name,A:C7,A:C7,A:C7,A:Hip,A:Hip,A:Hip,A:Hip,A:Hip,A:Hip,A:Hip\n\
        ,ID,1,1,1,2,2,2,2,2,2,2\n,Parent,,,,Root,Root,Root,Root,Root,Root,Root\n\
        ,,Position,Position,Position,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\n\
        Frame,Time (Seconds),X,Y,Z,X,Y,Z,W,X,Y,Z\n"
        .to_owned();
    for (f, row) in points(9).chunks_exact(6).enumerate() {
        let cells = |p: Option<[f32; 3]>, c: char| {
            p.map_or_else(|| format!("{c}{c}"), |p| format!("{:.2}{c}{:.2}{c}{:.2}", p[0], p[1], p[2]))
        };
        wide += &format!("{f},{:.2},{},{}\n", f as f64 / 50.0, cells(row[0], ','), cells(row[1], ','));
        long += &format!("{f};\"C7\";{}\n{f};T10;{}\n", cells(row[0], ';'), cells(row[1], ';'));
        motive += &format!("{f},{:.6},{},0,0.6,0,0.8,{}\n", f as f64 / 50.0, cells(row[0], ','), cells(row[1], ','));
    }
    vec![wide.into_bytes(), long.into_bytes(), motive.into_bytes()]
}

#[test]
fn damaged_c3d_files_do_no_harm() {
    run(11, "c3d", c3d, &c3d_samples());
}

#[test]
fn damaged_trc_tables_do_no_harm() {
    run(12, "trc", trc, &trc_samples());
}

#[test]
fn damaged_csv_tables_do_no_harm() {
    run(13, "csv", csv, &csv_samples());
}

#[test]
fn counts_of_two_to_the_31_are_not_believed() {
    let huge = 1u64 << 31;
    let header = |markers: u64, frames: u64| {
        format!(
            "PathFileType\t4\nDataRate\tNumFrames\tNumMarkers\tUnits\n50\t{frames}\t{markers}\tmm\nFrame#\tTime\tC7\t\t\tT10\n"
        )
    };
    assert!(trc(format!("{}1\t0\t1\t2\t3\t4\t5\t6\n", header(huge, huge)).as_bytes()));
    // Frame numbers that far apart do not make as many frames.
    assert!(trc(format!("{}1\t0\t1\t2\t3\n{huge}\t1\t1\t2\t3\n", header(2, 2)).as_bytes()));
    assert!(csv(format!("frame,a_x,a_y,a_z\n{huge},1,2,3\n-{huge},1,2,3\n").as_bytes()));
    assert!(csv(format!("Format Version,1.2,Total Exported Frames,{huge}\n,Type,Marker,Marker,Marker\n,Name,a,a,a\n,,Position,Position,Position\nFrame,Time,X,Y,Z\n0,0,1,2,3\n").as_bytes()));
    // The words of a C3D file are of 16 bits, those of its long counts of 32.
    for sample in c3d_samples() {
        for at in (2..24).step_by(2) {
            let mut bytes = sample.clone();
            bytes[at..at + 2].copy_from_slice(&[0xff, 0xff]);
            c3d(&bytes);
        }
    }
    for count in [2e8, 1e30, f32::INFINITY] {
        c3d(&super::tests_of_tables::rotations_in_floats(8, count, 3.0));
        c3d(&super::tests_of_tables::rotations_in_floats(8, 2.0, count));
    }
}

/// Puts the samples where the fuzzer looks for them; see `scripts/fuzz.sh`.
#[test]
fn seeds_of_the_fuzzer_of_tables() {
    let Some(folder) = std::env::var_os("RETARGET_FUZZ_SEEDS") else { return };
    for (name, samples) in [("c3d", c3d_samples()), ("trc", trc_samples()), ("csv", csv_samples())] {
        let folder = Path::new(&folder).join(format!("capture_{name}"));
        std::fs::create_dir_all(&folder).unwrap();
        for (k, sample) in samples.iter().enumerate() {
            std::fs::write(folder.join(format!("{k}")), sample).unwrap();
        }
    }
}
