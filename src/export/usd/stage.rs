//! The stage as a tree of prims: one mesh with its materials, before it is text or a crate.

use super::material::{self, Textures};
use super::tree::{Content, Layer, Prim, Property, Track, Value};
use crate::error::Notes;
use crate::export::Header;
use crate::export::glb::{is_solid, linear};
use crate::export::parts::{self, Identifiers, Part};
use crate::scan::Scan;
use crate::space::Axis;
use crate::surface::NormalVertices;

/// The stage of a scan.
pub(super) fn layer(header: &Header, normals: &NormalVertices, textures: &mut Textures<'_>, notes: &mut Notes) -> Layer {
    let scan = &*header.scan;
    let mut identifiers = Identifiers::default();
    let materials: Vec<(String, Part)> = parts::materials(scan).into_iter().map(|m| (identifiers.of(&m.name), m)).collect();
    let mut children: Vec<Prim> = material::scope(scan, &materials, textures, notes).into_iter().collect();
    children.push(mesh(scan, normals, &materials, &mut identifiers));
    let root = Prim { name: "scan".to_owned(), kind: "Xform", children, ..Prim::default() };
    Layer { metadata: metadata(header, notes), root }
}

fn metadata(header: &Header, notes: &mut Notes) -> Vec<(&'static str, Value)> {
    let last = header.first_frame + header.frames as i64 - 1;
    let mut all = vec![
        ("defaultPrim", Value::token("scan")),
        ("documentation", Value::Text("written by retarget".to_owned())),
        ("endTimeCode", Value::Double(last as f64)),
        ("framesPerSecond", Value::Double(header.rate)),
    ];
    match header.metres {
        Some(metres) => all.push(("metersPerUnit", Value::Double(metres))),
        None => notes.warn("USD: the scan's unit is not known, so the file states none: readers take centimetres"),
    }
    all.push(("startTimeCode", Value::Double(header.first_frame as f64)));
    all.push(("timeCodesPerSecond", Value::Double(header.rate)));
    match header.up.map(Axis::nearest) {
        Some(Axis { index: index @ 1..=2, negative: false }) => all.push(("upAxis", Value::token(["X", "Y", "Z"][index]))),
        up => {
            let up = up.map_or("not known".to_owned(), |axis| axis.to_string());
            notes.warn(format!("USD: up is {up}, which the format cannot state: readers take Y"));
        }
    }
    all
}

/// Whether hard edges give vertices several normals; else the first ones are those of the vertices.
pub(super) fn split(scan: &Scan, normals: &NormalVertices) -> bool {
    normals.vertices.len() > scan.mesh.positions.len()
}

fn mesh(scan: &Scan, normals: &NormalVertices, materials: &[(String, Part)], identifiers: &mut Identifiers) -> Prim {
    let faces = &scan.mesh.faces;
    let mut all = vec![Property::value("token", "subdivisionScheme", Value::token("none")).uniform()];
    if !is_solid(scan) {
        all.push(Property::value("bool", "doubleSided", Value::Bool(true)).uniform());
    }
    let counts = faces.iter().map(|f| f.len() as u32).collect();
    all.push(Property::value("int[]", "faceVertexCounts", Value::Integers(counts)));
    all.push(Property::value("int[]", "faceVertexIndices", Value::Integers(faces.corners.clone())));
    if let Some((values, indices)) = parts::corner_uvs(scan) {
        all.push(Property::value("texCoord2f[]", "primvars:st", Value::Vectors2(values)).over("faceVarying"));
        all.push(Property::value("int[]", "primvars:st:indices", Value::Integers(indices)));
    }
    let colors = &scan.look.colors;
    if !colors.is_empty() {
        let values = colors.iter().map(|c| [c[0], c[1], c[2]].map(linear)).collect();
        all.push(Property::value("color3f[]", "primvars:displayColor", Value::Vectors3(values)).over("vertex"));
    }
    if scan.look.colors_have_alpha {
        let values = colors.iter().map(|c| c[3]).collect();
        all.push(Property::value("float[]", "primvars:displayOpacity", Value::Floats(values)).over("vertex"));
    }
    all.push(Property::new("point3f[]", "points", Content::Samples(Track::Points)));
    let samples = Content::Samples(Track::Normals);
    if split(scan, normals) {
        all.push(Property::value("int[]", "primvars:normals:indices", Value::Integers(normals.corners.clone())));
        all.push(Property::new("normal3f[]", "primvars:normals", samples).over("faceVarying"));
    } else {
        all.push(Property::new("normal3f[]", "normals", samples).over("vertex"));
    }
    all.push(Property::new("float3[]", "extent", Content::Samples(Track::Extent)));
    let mut children = Vec::new();
    let mut family = |name: &str| {
        let family = format!("subsetFamily:{name}:familyType");
        all.push(Property::value("token", family, Value::token("nonOverlapping")).uniform());
    };
    if !materials.is_empty() {
        family("materialBind");
    }
    for (identifier, part) in materials {
        let mut prim = subset(identifier.clone(), part, "materialBind");
        prim.binds = true;
        let target = Content::Target(format!("/scan/materials/{identifier}"));
        prim.properties.push(Property::new("rel", "material:binding", target));
        children.push(prim);
    }
    let groups = parts::groups(scan);
    if !groups.is_empty() {
        family("group");
    }
    children.extend(groups.iter().map(|part| subset(identifiers.of(&part.name), part, "group")));
    Prim { name: "mesh".to_owned(), kind: "Mesh", binds: !materials.is_empty(), properties: all, children }
}

/// Some of the faces.
fn subset(name: String, part: &Part, family: &str) -> Prim {
    let properties = vec![
        Property::name_in_the_scan(&part.name),
        Property::value("token", "elementType", Value::token("face")).uniform(),
        Property::value("token", "familyName", Value::token(family)).uniform(),
        Property::value("int[]", "indices", Value::Integers(part.faces.clone())),
    ];
    Prim { name, kind: "GeomSubset", properties, ..Prim::default() }
}
