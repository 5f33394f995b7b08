//! The surface map against plain reads of its matrix, and normals against the map; one thread.

use super::body;
use super::milliseconds;
use glam::DVec3;
use retarget::deform::Deformer;
use retarget::deform::volumetric::Volumetric;
use retarget::linalg::use_baseline;
use retarget::proxy::rows::MapKind;
use retarget::surface::{BATCH, Fans, NormalVertices, SurfaceMap};
use std::hint::black_box;

/// About this many vertices are mapped: the scan is subdivided until it has them.
const VERTICES: usize = 150_000;

const REPEATS: usize = 15;

pub fn slices(points: &[Vec<[f32; 3]>]) -> Vec<&[[f32; 3]]> {
    points.iter().map(|p| &p[..]).collect()
}

pub fn run(path: Option<&String>) {
    let mut scan = body::scan(path);
    while scan.mesh.positions.len() < VERTICES {
        scan.mesh = body::subdivided(&scan.mesh);
    }
    let points = body::points(&scan.mesh);
    let proxy = body::proxy(&points, &scan.mesh, 3000);
    let map = SurfaceMap::build_by_pieces(&proxy, &points, &scan.mesh.faces, MapKind::Ring).unwrap();
    let handles = body::handles(&proxy, 40);
    let mut deformer = Volumetric::new(&proxy, &handles, &Default::default()).unwrap();
    let poses: Vec<Vec<DVec3>> = (0..BATCH)
        .map(|k| {
            deformer.step(&body::targets(&proxy, &handles, k as f64 / 100.0)).unwrap();
            deformer.pose().to_vec()
        })
        .collect();
    let batch: Vec<&[DVec3]> = poses.iter().map(|p| &p[..]).collect();

    let vertices = points.len();
    let sample: Vec<usize> = (0..vertices).step_by(vertices / 2000 + 1).collect();
    let entries: usize = sample.iter().map(|&v| map.row(v).indices.len()).sum::<usize>() * vertices / sample.len();
    let rows = entries * 8;
    println!(
        "{vertices} vertices, {} proxy vertices; the map is {:.1} MB, as a matrix of {entries} entries {:.1} MB",
        proxy.rest.len(),
        map.bytes() as f64 / 1e6,
        rows as f64 / 1e6,
    );
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        let (compact, matrix) = (vec![1_u64; map.bytes() / 8], vec![1_u64; rows / 8]);
        let read = |data: &[u64]| black_box(black_box(data).iter().fold(0_u64, |sum, x| sum.wrapping_add(*x)));
        let mut out = vec![Vec::new(); BATCH];
        let mut normals = vec![Vec::new(); BATCH];
        let fans = Fans::new(&scan, &NormalVertices::of(&scan));
        map.apply(&batch, &mut out);
        fans.compute(&slices(&out), &mut normals);
        for baseline in [false, true] {
            use_baseline(baseline);
            let read_map = milliseconds(REPEATS, || _ = read(&compact));
            let read_matrix = milliseconds(REPEATS, || _ = read(&matrix));
            let eight = milliseconds(REPEATS, || map.apply(&batch, &mut out)) / BATCH as f64;
            let one = milliseconds(REPEATS, || map.apply(&batch[..1], &mut out[..1]));
            let normal = milliseconds(REPEATS, || fans.compute(&slices(&out), &mut normals)) / BATCH as f64;
            println!("{}", if baseline { "baseline" } else { "AVX2" });
            println!("  plain read: the map {read_map:.2} ms, the matrix {read_matrix:.2} ms");
            println!("  per frame: eight together {eight:.2} ms, one alone {one:.2} ms, normals {normal:.2} ms");
            println!(
                "  eight together over reads: {:.2} of the map, {:.2} of the matrix; normals over map: {:.2}",
                eight / read_map,
                eight / read_matrix,
                normal / eight
            );
        }
    });
    use_baseline(false);
}
