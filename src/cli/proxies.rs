//! The proxy of a scan and the map from it, from the cache where they are there.

use super::args::{Animate, Map};
use super::shells::{self, Examples};
use crate::cache::{Cache, Key};
use crate::deform::shells::Body;
use crate::error::{Kind, Notes, Result};
use crate::export::Cancel;
use crate::proxy::{self, BuildOptions, Proxy, medit};
use crate::scan::{Faces, Scan, UnitBox};
use crate::surface::{Apart, SurfaceMap};
use crate::words::{self, file_name};
use glam::DVec3;

/// A proxy, with the words of its line.
pub(super) struct Made {
    pub(super) proxy: Proxy,
    /// The same as a shell, where frames are solved by one.
    pub(super) shell: Option<Body>,
    pub(super) words: String,
    pub(super) notes: Notes,
    /// Where parts are joined that only touch.
    pub(super) joined: Vec<DVec3>,
    /// Whether parts touch.
    pub(super) touching: bool,
}

/// The map from the proxy to the scan, from the cache where it is there.
pub(super) fn map_of(
    args: &Animate,
    cache: Option<&Cache>,
    proxy: &Proxy,
    points: &[DVec3],
    faces: &Faces,
    apart: Option<&Apart>,
) -> Result<SurfaceMap> {
    let of_proxy = |key: Key| {
        key.plain(&proxy.rest).plain(&proxy.tets).plain(&proxy.boundary).plain(&proxy.boundary_tets).plain(&proxy.components)
    };
    let kind = if args.map == Map::Paper { "paper map" } else { "ring map" };
    let key = || {
        let key = of_proxy(Key::new(kind)).plain(points).plain(&faces.starts).plain(&faces.corners);
        apart.iter().fold(key, |key, apart| key.plain(&apart.proxy).plain(&apart.points))
    };
    let build = || match apart {
        Some(apart) => SurfaceMap::build_apart(proxy, points, faces, apart, args.map.into()),
        None => SurfaceMap::build_by_pieces(proxy, points, faces, args.map.into()),
    };
    let Some((cache, key)) = cache.map(|cache| (cache, key())) else {
        return build();
    };
    if let Some(map) = cache.get(&key) {
        return Ok(map);
    }
    let map = build()?;
    cache.keep(&key, &map);
    Ok(map)
}

/// The coarse mesh of a shell, from the cache where it is there.
fn shell_of(
    args: &Animate,
    cache: Option<&Cache>,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    examples: &Examples,
    cancel: &Cancel,
) -> Result<Body> {
    let key = Key::new("shell").plain(points).plain(triangles).plain(&[args.proxy_vertices.unwrap_or(0)]);
    let key = examples.poses.iter().fold(key, |key, pose| key.plain(pose));
    if let Some(body) = cache.and_then(|cache| cache.get(&key)) {
        return Ok(body);
    }
    let body = shells::body(points, triangles, examples, args.proxy_vertices, &|| cancel.check())?;
    if let Some(cache) = cache {
        cache.keep(&key, &body);
    }
    Ok(body)
}

/// The map from a shell to the scan, from the cache where it is there.
pub(super) fn map_of_shell(
    cache: Option<&Cache>,
    body: &Body,
    points: &[DVec3],
    faces: &Faces,
    examples: &Examples,
) -> SurfaceMap {
    let key = Key::new("shell map").plain(&body.proxy.rest).plain(&body.proxy.boundary).plain(&body.places).plain(&body.roots);
    let key = key.plain(points).plain(&faces.starts).plain(&faces.corners);
    let key = body.examples.iter().chain(&examples.poses).fold(key, |key, pose| key.plain(pose));
    if let Some(map) = cache.and_then(|cache| cache.get(&key)) {
        return map;
    }
    let map = SurfaceMap::build_for_shell(body, points, faces, &examples.poses);
    if let Some(cache) = cache {
        cache.keep(&key, &map);
    }
    map
}

/// The proxy: built from the scan, or read from `--proxy`, or from the cache where it is there.
#[allow(clippy::too_many_arguments)]
pub(super) fn body(
    args: &Animate,
    cache: Option<&Cache>,
    scan: &Scan,
    unit_box: UnitBox,
    points: &[DVec3],
    triangles: &[[u32; 3]],
    examples: &Examples,
    cancel: &Cancel,
) -> Result<Made> {
    if args.shells.are_chosen()? {
        let mut body = shell_of(args, cache, points, triangles, examples, cancel)
            .map_err(|e| if e.file.is_none() && e.kind != Kind::Interrupted { e.file(&scan.source) } else { e })?;
        let (proxy, notes) = (body.proxy.clone(), std::mem::take(&mut body.notes));
        let words = body.words();
        return Ok(Made { proxy, shell: Some(body), words, notes, joined: Vec::new(), touching: false });
    }
    if let Some(path) = &args.proxy {
        let (proxy, notes) = medit::read(path, &unit_box)?;
        let line = format!(
            "{}  {} vertices, {} tetrahedra",
            file_name(path),
            words::count(proxy.rest.len()),
            words::count(proxy.tets.len())
        );
        return Ok(Made { proxy, shell: None, words: line, notes, joined: Vec::new(), touching: false });
    }
    let options =
        BuildOptions { surface_vertices: args.proxy_vertices.map_or(BuildOptions::default().surface_vertices, |n| n as usize) };
    let key = Key::new("proxy").plain(points).plain(triangles).plain(&[options.surface_vertices]);
    if let Some((proxy, words, notes, joined, touching)) = cache.and_then(|cache| cache.get(&key)) {
        return Ok(Made { proxy, shell: None, words, notes, joined, touching });
    }
    let built = proxy::build(points, triangles, &options, &|| cancel.check())
        .map_err(|e| if e.file.is_none() && e.kind != Kind::Interrupted { e.file(&scan.source) } else { e })?;
    let words = format!("{} · {}", built.summary.size(), built.summary.remarks());
    let touching = built.summary.touching > 0;
    let made = Made { proxy: built.proxy, shell: None, words, notes: built.notes, joined: built.joined, touching };
    if let Some(cache) = cache {
        cache.keep(&key, &(&made.proxy, &made.words, &made.notes, &made.joined, made.touching));
    }
    Ok(made)
}
