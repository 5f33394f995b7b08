//! Time against size: vertices of the scan, vertices of the proxy, frames, handles. Slopes are those of least squares in logarithms: 1 is linear.

use super::body;
use super::core_time::seconds_on_core;
use super::map::slices;
use super::milliseconds;
use glam::DVec3;
use retarget::deform::Deformer;
use retarget::deform::volumetric::Volumetric;
use retarget::proxy::Proxy;
use retarget::proxy::rows::MapKind;
use retarget::surface::{BATCH, Fans, NormalVertices, SurfaceMap};

const REPEATS: usize = 7;
const RATE: f64 = 100.0;

pub fn run(path: Option<&String>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        let scan = body::scan(path);
        let points = body::points(&scan.mesh);
        let proxy = body::proxy(&points, &scan.mesh, 3000);
        vertices(&scan, &proxy);
        proxies(&scan, &points);
        frames(&proxy);
        handles(&proxy);
    });
}

/// Sizes and times of one quantity, printed as they come.
struct Table {
    sizes: Vec<f64>,
    columns: Vec<(&'static str, Vec<f64>)>,
}

impl Table {
    fn new(what: &str, names: &[&'static str]) -> Self {
        print!("\n{what:>12}");
        names.iter().for_each(|n| print!(" {n:>16}"));
        println!();
        Self { sizes: Vec::new(), columns: names.iter().map(|n| (*n, Vec::new())).collect() }
    }

    fn row(&mut self, size: usize, values: &[f64]) {
        print!("{size:>12}");
        values.iter().for_each(|v| print!(" {v:>16.2}"));
        println!();
        self.sizes.push(size as f64);
        self.columns.iter_mut().zip(values).for_each(|((_, column), v)| column.push(*v));
    }

    fn finish(self) {
        print!("{:>12}", "slope");
        for (_, column) in &self.columns {
            print!(" {:>16.2}", slope(&self.sizes, column));
        }
        println!();
    }
}

fn slope(x: &[f64], y: &[f64]) -> f64 {
    let (x, y): (Vec<f64>, Vec<f64>) = (x.iter().map(|x| x.ln()).collect(), y.iter().map(|y| y.ln()).collect());
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mx, my) = (mean(&x), mean(&y));
    let along: f64 = x.iter().zip(&y).map(|(x, y)| (x - mx) * (y - my)).sum();
    along / x.iter().map(|x| (x - mx) * (x - mx)).sum::<f64>()
}

fn vertices(scan: &retarget::scan::Scan, proxy: &Proxy) {
    let handles = body::handles(proxy, 40);
    let poses = solved(proxy, &handles, BATCH).0;
    let batch: Vec<&[DVec3]> = poses.iter().map(|p| &p[..]).collect();
    let mut table = Table::new("vertices", &["proxy ms", "map set-up ms", "map ms/frame", "normals ms/frame"]);
    let mut scan = scan.clone();
    for _ in 0..4 {
        let points = body::points(&scan.mesh);
        let build = milliseconds(1, || _ = body::proxy(&points, &scan.mesh, 3000));
        let mut map = None;
        let bind = milliseconds(1, || {
            map = Some(SurfaceMap::build_by_pieces(proxy, &points, &scan.mesh.faces, MapKind::Ring).unwrap());
        });
        let map = map.unwrap();
        let (mut out, mut normals) = (vec![Vec::new(); BATCH], vec![Vec::new(); BATCH]);
        let fans = Fans::new(&scan, &NormalVertices::of(&scan));
        map.apply(&batch, &mut out);
        fans.compute(&slices(&out), &mut normals);
        let apply = milliseconds(REPEATS, || map.apply(&batch, &mut out)) / BATCH as f64;
        let normal = milliseconds(REPEATS, || fans.compute(&slices(&out), &mut normals)) / BATCH as f64;
        table.row(points.len(), &[build, bind, apply, normal]);
        scan.mesh = body::subdivided(&scan.mesh);
    }
    table.finish();
}

/// Poses, milliseconds of set-up and milliseconds per frame.
fn solved(proxy: &Proxy, handles: &[retarget::deform::Handle], frames: usize) -> (Vec<Vec<DVec3>>, f64, f64, f64) {
    let start = seconds_on_core();
    let mut deformer = Volumetric::new(proxy, handles, &Default::default()).unwrap();
    let set_up = (seconds_on_core() - start) * 1e3;
    deformer.start(&body::targets(proxy, handles, 0.0)).unwrap();
    let mut poses = Vec::new();
    let (mut time, mut passes) = (0.0, 0);
    for frame in 0..frames {
        let targets = body::targets(proxy, handles, (frame + 1) as f64 / RATE);
        let start = seconds_on_core();
        passes += deformer.step(&targets).unwrap().passes;
        time += (seconds_on_core() - start) * 1e3;
        if poses.len() < BATCH {
            poses.push(deformer.pose().to_vec());
        }
    }
    (poses, set_up, time, f64::from(passes))
}

fn proxies(scan: &retarget::scan::Scan, points: &[DVec3]) {
    let mut table = Table::new("proxy", &["tetrahedra", "set-up ms", "ms/frame", "ms/pass"]);
    for wanted in [1300, 2000, 2700, 4400, 6300] {
        let proxy = body::proxy(points, &scan.mesh, wanted);
        let (_, set_up, time, passes) = solved(&proxy, &body::handles(&proxy, 40), 60);
        table.row(proxy.rest.len(), &[proxy.tets.len() as f64, set_up, time / 60.0, time / passes]);
    }
    table.finish();
}

fn frames(proxy: &Proxy) {
    let mut table = Table::new("frames", &["ms", "ms/frame"]);
    let handles = body::handles(proxy, 40);
    for frames in [100, 200, 400, 800, 1600] {
        let (.., time, _) = solved(proxy, &handles, frames);
        table.row(frames, &[time, time / frames as f64]);
    }
    table.finish();
}

fn handles(proxy: &Proxy) {
    let mut table = Table::new("handles", &["set-up ms", "ms/frame", "ms/pass"]);
    for count in [20, 36, 63, 112, 200] {
        let (_, set_up, time, passes) = solved(proxy, &body::handles(proxy, count), 100);
        table.row(count, &[set_up, time / 100.0, time / passes]);
    }
    table.finish();
}
