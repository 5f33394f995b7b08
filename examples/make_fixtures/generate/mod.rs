//! A generated human-like scan, and takes with a known answer: a walk and a squat by markers, a reach by handles that turn; what the recipes of the guide
//! need beside them.

pub mod body;
pub mod files;
pub mod markers;
pub mod motion;
pub mod reach;
pub mod recipes;

/// Size of a polygonization cell, metres: about twenty thousand vertices.
const CELL: f64 = 0.0109;

/// Frames whose true scan vertices are kept: rest, mid-step, end of the walk, deepest squat, end.
pub const TRUE_FRAMES: [usize; 5] = [0, 110, 200, 306, 371];

/// All fixtures: file name and bytes.
pub fn all() -> Vec<(String, Vec<u8>)> {
    let bones = body::bones();
    let body = body::build(CELL);
    let mut out = vec![
        ("scan.obj".to_owned(), files::obj(&body, &bones).into_bytes()),
        ("scan.mtl".to_owned(), files::mtl().as_bytes().to_vec()),
        ("scan_skin.png".to_owned(), files::png()),
        ("scan_dirty.ply".to_owned(), files::dirty_ply(&body)),
        ("walk.c3d".to_owned(), markers::c3d(&body, &bones)),
        ("reach.csv".to_owned(), reach::csv(&bones).into_bytes()),
        ("tall.c3d".to_owned(), recipes::tall_c3d(&body, &bones)),
        ("steps.bvh".to_owned(), recipes::bvh(&bones)),
        ("lamp.obj".to_owned(), recipes::lamp_obj()),
        ("lamp.csv".to_owned(), recipes::lamp_csv()),
        ("trunk.obj".to_owned(), recipes::trunk_obj(0.0)),
        ("trunk_bent.obj".to_owned(), recipes::trunk_obj(std::f64::consts::FRAC_PI_2)),
        ("trunk.csv".to_owned(), recipes::trunk_csv()),
    ];
    for frame in TRUE_FRAMES {
        out.push((format!("true_{:04}.ply", frame + 1), files::ply_points(&motion::skin(&body, &bones, frame))));
    }
    out
}
