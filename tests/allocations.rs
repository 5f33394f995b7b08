//! Once everything is set up and warm, frames are solved and mapped without any allocation.

#![allow(clippy::unwrap_used)]

use glam::{DQuat, DVec3};
use retarget::deform::shells::{self, Shells};
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::deform::{Deformer, Grip, Handle, OrientedHandle, Placement, Targets};
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::proxy::{self, BuildOptions, Proxy};
use retarget::scan::{self, UnitBox};
use retarget::surface::{BATCH, Fans, NormalVertices, SurfaceMap};
use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The system's allocator, counted.
struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Frame at which the body is somewhere else.
const JUMP: usize = 25;

/// Handles on the skin, one of them oriented.
struct Body {
    proxy: Proxy,
    handles: Vec<Handle>,
    head: OrientedHandle,
}

impl Body {
    fn new(proxy: Proxy) -> Self {
        let rows = HandleRows::new(&proxy, MapKind::Ring);
        let skin = proxy.boundary.iter().step_by(proxy.boundary.len() / 40);
        let on_skin = skin.enumerate().map(|(k, face)| {
            let row = rows.row(proxy.rest[face[0] as usize]);
            Handle { name: format!("h{k}"), row, beta: 1.0 }
        });
        let handles = on_skin.collect();
        let top = proxy.rest.iter().copied().max_by(|a, b| a.y.total_cmp(&b.y)).unwrap();
        let near = |v: &u32| proxy.rest[*v as usize].distance(top) < 0.05;
        let vertices = (0..proxy.rest.len() as u32).filter(near).collect();
        let head = OrientedHandle { name: "head".into(), rest: top, grip: Grip::Region { vertices, beta: 1.0 } };
        Self { proxy, handles, head }
    }

    /// Sways; now and then a handle is gone.
    fn frame(&self, frame: usize, targets: &mut Targets, placements: &mut [Placement]) {
        let t = frame as f64 * 0.05;
        let jump = if frame >= JUMP { DVec3::Z } else { DVec3::ZERO };
        let sway = |p: DVec3| DQuat::from_rotation_y(0.6 * p.y * t.sin()) * p + DVec3::X * (0.05 * t.cos()) + jump;
        for (h, handle) in self.handles.iter().enumerate() {
            targets.positions[h] = sway(handle.row.apply(&self.proxy.rest));
            targets.presence[h] = f64::from(u8::from(!(frame / 3 + h).is_multiple_of(17)));
        }
        let orientation = DQuat::from_rotation_y(0.6 * self.head.rest.y * t.sin());
        placements[0] = Placement { position: sway(self.head.rest), orientation, presence: 1.0 };
    }
}

#[test]
fn a_warm_frame_allocates_nothing() {
    let scan = scan::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/scan.obj")).unwrap();
    let unit_box = UnitBox::of(&scan.mesh).unwrap();
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let options = BuildOptions { surface_vertices: 600 };
    let body = Body::new(proxy::build(&points, &scan.mesh.vertex_triangles(), &options, &|| Ok(())).unwrap().proxy);
    let map = SurfaceMap::build_by_pieces(&body.proxy, &points, &scan.mesh.faces, MapKind::Ring).unwrap();
    let fans = Fans::new(&scan, &NormalVertices::of(&scan));
    let mut deformer =
        Volumetric::with_oriented(&body.proxy, &body.handles, std::slice::from_ref(&body.head), &Options::default()).unwrap();

    warm_frames(&body, &map, &fans, &mut deformer);

    // A shell, which needs a surface: a bar with an example that is bent sideways.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bar.obj"), bar()).unwrap();
    let scan = scan::read(&folder.path().join("bar.obj")).unwrap();
    let unit_box = UnitBox::of(&scan.mesh).unwrap();
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let fans = Fans::new(&scan, &NormalVertices::of(&scan));
    let bent = |x: &[DVec3]| x.iter().map(|p| DQuat::from_rotation_z(0.8 * p.y) * *p).collect::<Vec<_>>();
    let examples = [bent(&points)];
    let shell = shells::Body::build(&points, &scan.mesh.vertex_triangles(), &examples, 300, &|| Ok(())).unwrap();
    let map = SurfaceMap::build_for_shell(&shell, &points, &scan.mesh.faces, &examples);
    let body = Body::new(shell.proxy.clone());
    let mut deformer =
        Shells::new(&shell, &body.handles, std::slice::from_ref(&body.head), &shells::Options::for_examples(1)).unwrap();
    warm_frames(&body, &map, &fans, &mut deformer);
}

/// An upright bar, open at its ends, as OBJ.
fn bar() -> String {
    const RINGS: usize = 40;
    const SIDES: usize = 16;
    let mut text = String::new();
    for i in 0..RINGS * SIDES {
        let (sin, cos) = (std::f64::consts::TAU * (i % SIDES) as f64 / SIDES as f64).sin_cos();
        text += &format!("v {} {} {}\n", 0.3 * cos, 0.1 * (i / SIDES) as f64, 0.3 * sin);
    }
    let at = |ring: usize, side: usize| ring * SIDES + side % SIDES + 1;
    for ring in 0..RINGS - 1 {
        for side in 0..SIDES {
            let corners = [at(ring, side), at(ring + 1, side), at(ring + 1, side + 1), at(ring, side + 1)];
            text += &format!("f {} {} {} {}\n", corners[0], corners[1], corners[2], corners[3]);
        }
    }
    text
}

/// Frames from a cold start on, the first batch of which may allocate. At [`JUMP`] a deformer that knows of cuts begins anew.
fn warm_frames(body: &Body, map: &SurfaceMap, fans: &Fans, deformer: &mut dyn Deformer) {
    let count = body.handles.len();
    let mut targets = Targets { positions: vec![DVec3::ZERO; count], presence: vec![1.0; count] };
    let still = Placement { position: DVec3::ZERO, orientation: DQuat::IDENTITY, presence: 0.0 };
    let mut placements = [still];
    let mut poses = vec![body.proxy.rest.clone(); BATCH];
    let (mut surfaces, mut normals) = (vec![Vec::new(); BATCH], vec![Vec::new(); BATCH]);
    let mut batch = |first: usize| {
        for (k, pose) in poses.iter_mut().enumerate() {
            let frame = first + k;
            body.frame(frame, &mut targets, &mut placements);
            deformer.place(&placements).unwrap();
            if frame == 0 { deformer.start(&targets) } else { deformer.step(&targets) }.unwrap();
            pose.copy_from_slice(deformer.pose());
        }
        let mut of_frames: [&[DVec3]; BATCH] = [&[]; BATCH];
        of_frames.iter_mut().zip(&poses).for_each(|(slot, pose)| *slot = pose);
        map.apply(&of_frames, &mut surfaces);
        let mut of_points: [&[[f32; 3]]; BATCH] = [&[]; BATCH];
        of_points.iter_mut().zip(&surfaces).for_each(|(slot, points)| *slot = points);
        fans.compute(&of_points, &mut normals);
    };
    // On one thread: how the threads of a pool share their work is theirs.
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(|| {
        batch(0);
        let before = COUNT.load(Ordering::Relaxed);
        (1..6).for_each(|k| batch(k * BATCH));
        assert_eq!(COUNT.load(Ordering::Relaxed) - before, 0, "allocations in five batches");
    });
}
