//! `retarget` makes a laser scan (or any mesh) move like the person who was captured: no rig, no skinning, no handwork.
//!
//! The modules are the stations that data passes on its way, in order; nothing flows back.
//!
//! ```text
//!  SCAN file ──► scan::Scan ──► proxy::Proxy ──────────┐
//!                                                      ├──► binding::Binding ──► deform::Deformer ──► surface::SurfaceMap ──► export::FrameSink
//!  CAPTURE file ──► capture::Capture ──────────────────┘     (handles)           (proxy pose)         (scan pose)            (files)
//!                         └───────────── pipeline::run drives the right half once per frame ──────────────┘
//! ```
//!
//! Inside, lengths are those of the scan's unit box ([`scan::UnitBox`]): centre 0, diagonal 1.
//!
//! # Example
//!
//! Posing a mesh by two of its points, without any capture:
//!
//! ```no_run
//! use retarget::deform::{Deformer, Handle, Targets, volumetric::{Options, Volumetric}};
//! use retarget::proxy::rows::{HandleRows, MapKind};
//! use retarget::{proxy, scan, surface::SurfaceMap};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scan = scan::read("scan.obj".as_ref())?;
//! let unit_box = scan::UnitBox::of(&scan.mesh).ok_or("an empty mesh")?;
//! let points = unit_box.enter_all(&scan.mesh.positions);
//! let proxy = proxy::build(&points, &scan.mesh.vertex_triangles(), &Default::default(), &|| Ok(()))?.proxy;
//! let map = SurfaceMap::build_by_pieces(&proxy, &points, &scan.mesh.faces, MapKind::Ring)?;
//!
//! let rows = HandleRows::new(&proxy, MapKind::Ring);
//! let at = [points[0], points[points.len() / 2], points[points.len() - 1]];
//! let handles = at.map(|p| Handle { name: "pin".into(), row: rows.row(p), beta: 1.0 });
//! let mut body = Volumetric::new(&proxy, &handles, &Options::default())?;
//! let up = at[0] + retarget::glam::DVec3::Z * 0.1;
//! body.start(&Targets { positions: vec![up, at[1], at[2]], presence: vec![1.0; 3] })?;
//!
//! let mut posed = vec![Vec::new()];
//! map.apply(&[body.pose()], &mut posed);
//! println!("{:?}", unit_box.leave(retarget::glam::DVec3::from(posed[0][0].map(f64::from))));
//! # Ok(())
//! # }
//! ```

pub use glam;

// Files that tests and benches share name the library as programs do.
#[cfg(test)]
extern crate self as retarget;

mod batch;
mod beside;
pub mod binding;
mod cache;
pub mod capture;
pub mod cli;
pub mod deform;
mod disjoint;
mod equal;
pub mod error;
pub mod export;
#[cfg(any(test, fuzzing))]
pub mod fuzz;
mod gltf;
pub mod joints;
pub mod linalg;
mod opened;
mod packing;
pub mod picture;
pub mod pipeline;
pub mod proxy;
pub mod report;
pub mod scan;
pub mod space;
pub mod spatial;
mod splitmix;
mod statistics;
pub mod surface;
mod words;
