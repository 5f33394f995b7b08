//! Material libraries of OBJ files.
//!
//! `Kd` and `Ke` are taken as linear light, as the usual OBJ to glTF converters do; the format itself does not say.

use super::beside::Beside;
use super::text::{Lines, Words, name, number};
use super::{Image, Material};
use crate::error::Notes;

/// Largest library in bytes that is read.
const LARGEST: usize = 64 << 20;

/// The material libraries that a mesh names.
#[derive(Default)]
pub(super) struct Libraries {
    /// One name per library, as the mesh writes it.
    pub(super) names: Vec<String>,
    materials: Vec<Material>,
}

impl Libraries {
    /// Reads the libraries of the `mtllib` lines. A missing one is noted; it is no error.
    pub(super) fn load(beside: &Beside, lines: &[String], notes: &mut Notes) -> Self {
        let mut libraries = Self::default();
        for file in lines.iter().flat_map(|line| names_in(beside, line)) {
            if libraries.names.contains(&file) {
                continue;
            }
            match beside.read(&file) {
                None => notes.warn(format!("material library '{file}' is missing: its materials are plain")),
                Some(Ok((bytes, _))) if bytes.len() > LARGEST => {
                    notes.warn(format!("material library '{file}' is larger than 64 MiB: its materials are plain"));
                }
                Some(Ok((bytes, around))) => libraries.materials.extend(parse(&bytes, &around, notes)),
                Some(Err(reason)) => notes.warn(format!("material library '{file}': {}", reason.found)),
            }
            libraries.names.push(file);
        }
        libraries
    }

    /// Gives the materials that the faces use their values. Names that no library knows stay plain; `expected`: whether that is worth a note.
    pub(super) fn fill(&self, materials: &mut [Material], expected: bool, notes: &mut Notes) {
        let mut unknown = Vec::new();
        for material in materials {
            match self.materials.iter().find(|m| m.name == material.name) {
                Some(found) => *material = found.clone(),
                None => unknown.push(format!("'{}'", material.name)),
            }
        }
        if expected && !self.materials.is_empty() && !unknown.is_empty() {
            let more = if unknown.len() > 5 { format!(" and {} more", unknown.len() - 5) } else { String::new() };
            unknown.truncate(5);
            notes.warn(format!("materials {}{more} are in no library: taken as plain", unknown.join(", ")));
        }
    }
}

/// The file names in one `mtllib` line: one with blanks in it, or several.
fn names_in(beside: &Beside, line: &str) -> Vec<String> {
    if line.is_empty() {
        return Vec::new();
    }
    if let Some(quoted) = line.strip_prefix('"') {
        return quoted.split('"').map(str::trim).filter(|n| !n.is_empty()).map(str::to_owned).collect();
    }
    if beside.has(line) {
        return vec![line.to_owned()];
    }
    // A name ends where a word ends in '.mtl'; what has no such end is one name.
    let mut names = vec![String::new()];
    for word in line.split_whitespace() {
        let last = names.len() - 1;
        let name = &mut names[last];
        if !name.is_empty() {
            name.push(' ');
        }
        name.push_str(word);
        if word.to_ascii_lowercase().ends_with(".mtl") {
            names.push(String::new());
        }
    }
    names.retain(|n| !n.is_empty());
    names
}

/// A name without quotation marks around it.
pub(super) fn unquoted(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\"").and_then(|b| b.strip_suffix(b"\"")).unwrap_or(bytes)
}

/// What a `newmtl` section says, before it is turned into a [`Material`].
#[derive(Default)]
struct Section {
    name: String,
    kd: Option<[f32; 3]>,
    ks: Option<[f32; 3]>,
    ke: Option<[f32; 3]>,
    ns: Option<f32>,
    opacity: Option<f32>,
    transparency: Option<f32>,
    metallic: Option<f32>,
    roughness: Option<f32>,
    map_kd: Option<String>,
    map_d: Option<String>,
    normal: Option<String>,
    moved_texture: bool,
}

/// The materials of a library. Textures are looked for `beside` it; missing ones are noted and left out.
pub(super) fn parse(bytes: &[u8], beside: &Beside, notes: &mut Notes) -> Vec<Material> {
    let mut sections: Vec<Section> = Vec::new();
    for line in Lines::new(bytes) {
        let mut words = Words::new(line);
        let Some(keyword) = words.next() else { continue };
        let keyword = keyword.to_ascii_lowercase();
        if keyword == b"newmtl" {
            sections.push(Section { name: name(unquoted(words.rest())), ..Section::default() });
        } else if let Some(section) = sections.last_mut() {
            section.statement(&keyword, words);
        }
    }
    let mut missing = Vec::new();
    let moved = sections.iter().filter(|s| s.moved_texture).count();
    let materials = sections.into_iter().map(|s| s.material(beside, &mut missing)).collect();
    if moved > 0 {
        notes.warn(format!("materials that move or scale their texture (-o, -s, -t), which is ignored: {moved}"));
    }
    missing.dedup();
    if !missing.is_empty() {
        let shown = missing.iter().take(5).map(|m| format!("'{m}'")).collect::<Vec<_>>().join(", ");
        let more = if missing.len() > 5 { format!(" and {} more", missing.len() - 5) } else { String::new() };
        notes.warn(format!("textures are missing: {shown}{more}"));
    }
    materials
}

impl Section {
    fn statement(&mut self, keyword: &[u8], words: Words<'_>) {
        let scalar = || words.clone().find_map(number).filter(|x| x.is_finite()).map(|x| x as f32);
        match keyword {
            b"kd" => self.kd = color(words),
            b"ks" => self.ks = color(words),
            b"ke" => self.ke = color(words),
            b"ns" => self.ns = scalar(),
            b"d" => self.opacity = scalar(),
            b"tr" => self.transparency = scalar(),
            b"pm" => self.metallic = scalar(),
            b"pr" => self.roughness = scalar(),
            b"map_kd" => {
                let (file, moved) = texture(words);
                self.map_kd = file;
                self.moved_texture = moved;
            }
            b"map_d" => self.map_d = texture(words).0,
            b"norm" | b"map_kn" => self.normal = texture(words).0.or(self.normal.take()),
            // A bump map may hold heights or normals. Exporters of today write normals; older height maps mostly say so in their name.
            b"map_bump" | b"bump" if self.normal.is_none() => {
                let heights = |file: &String| ["bump", "height", "disp"].iter().any(|w| file.to_ascii_lowercase().contains(w));
                self.normal = texture(words).0.filter(|file| !heights(file));
            }
            _ => {}
        }
    }

    fn material(self, beside: &Beside, missing: &mut Vec<String>) -> Material {
        let mut find = |file: &Option<String>| -> Option<Image> {
            let file = file.as_ref()?;
            let found = beside.image(file);
            if found.is_none() {
                missing.push(file.clone());
            }
            found
        };
        let base_color_texture = find(&self.map_kd);
        let normal_texture = find(&self.normal);
        // A texture replaces Kd, as in common modellers; many write Kd 0 0 0 beside it.
        let kd = if base_color_texture.is_some() { [1.0; 3] } else { self.kd.unwrap_or([1.0; 3]) };
        // `Tr` alone is transparency. An alpha of 0 is a common slip of exporters that mix up the two.
        let alpha = self.opacity.or(self.transparency.map(|t| 1.0 - t)).unwrap_or(1.0).clamp(0.0, 1.0);
        let alpha = if alpha == 0.0 { 1.0 } else { alpha };
        let alpha_in_texture = self.map_d.is_some() && self.map_d == self.map_kd && base_color_texture.is_some();
        let matt = self.ks.is_none_or(|ks| ks == [0.0; 3]);
        let roughness = match (self.roughness, self.ns) {
            (Some(roughness), _) => roughness,
            // The inverse of how Blender writes Ns.
            (None, Some(ns)) if !matt => 1.0 - (ns.clamp(0.0, 1000.0) / 1000.0).sqrt(),
            _ => 1.0,
        };
        Material {
            name: self.name,
            base_color: [kd[0], kd[1], kd[2], alpha],
            base_color_texture,
            normal_texture,
            emissive: self.ke.unwrap_or_default(),
            metallic: self.metallic.unwrap_or(0.0).clamp(0.0, 1.0),
            roughness: roughness.clamp(0.0, 1.0),
            blend: alpha < 1.0 || alpha_in_texture,
        }
    }
}

/// `r g b`, or one number for grey. Spectral curves and CIE XYZ are not read.
fn color(words: Words<'_>) -> Option<[f32; 3]> {
    let values: Vec<f32> = words.map_while(number).filter(|x| x.is_finite()).map(|x| x.clamp(0.0, 1.0) as f32).take(3).collect();
    match values[..] {
        [r, g, b] => Some([r, g, b]),
        [grey] => Some([grey; 3]),
        _ => None,
    }
}

/// File name of a texture statement, which may hold blanks, behind the options; and whether the options move or scale the texture.
fn texture(mut words: Words<'_>) -> (Option<String>, bool) {
    let mut moved = false;
    loop {
        let mut ahead = words.clone();
        let option = ahead.next().map(<[u8]>::to_ascii_lowercase).unwrap_or_default();
        let numbers = match option.as_slice() {
            b"-blendu" | b"-blendv" | b"-cc" | b"-clamp" | b"-imfchan" | b"-type" | b"-colorspace" => {
                ahead.next();
                0
            }
            b"-bm" | b"-boost" | b"-texres" => 1,
            b"-mm" => 2,
            b"-o" | b"-s" | b"-t" => 3,
            _ => break,
        };
        for _ in 0..numbers {
            let mut further = ahead.clone();
            let Some(value) = further.next().and_then(number) else { break };
            let neutral = if option == b"-s" { 1.0 } else { 0.0 };
            moved |= numbers == 3 && value != neutral;
            ahead = further;
        }
        words = ahead;
    }
    let file = name(words.rest());
    let file = file.trim_matches('"').trim();
    ((!file.is_empty()).then(|| file.to_owned()), moved)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;
    use std::path::Path;

    fn one(text: &str, folder: &Path) -> (Material, Notes) {
        let mut notes = Notes::default();
        (parse(text.as_bytes(), &Beside::Folder(folder.to_owned()), &mut notes).remove(0), notes)
    }

    #[test]
    fn values_become_those_of_gltf() {
        let text = "newmtl Haut hell\r\n Kd .8 .6 0.5 # tone\nd 0.25\nTr 0.1\nKe 1 2 0\nPm 0.5\nPr 0.75\nNs 20\nKs 1 1 1\n";
        let (m, _) = one(text, Path::new("."));
        assert_eq!(m.name, "Haut hell");
        assert_eq!(m.base_color, [0.8, 0.6, 0.5, 0.25]);
        assert_eq!((m.emissive, m.metallic, m.roughness, m.blend), ([1.0, 1.0, 0.0], 0.5, 0.75, true));
        let (m, _) = one("newmtl a\nKd 0.5\nTr 0.25\nNs 250\nKs 0.5 0.5 0.5", Path::new("."));
        assert_eq!((m.base_color, m.roughness), ([0.5, 0.5, 0.5, 0.75], 0.5));
        let (m, _) = one("newmtl a\nTr 1\nNs 250\nKs 0 0 0", Path::new("."));
        assert_eq!((m.base_color[3], m.roughness, m.blend), (1.0, 1.0, false));
    }

    #[test]
    fn texture_names_follow_the_options() {
        let file = |text: &str| texture(Words::new(text.as_bytes()));
        assert_eq!(file(" a b.png "), (Some("a b.png".into()), false));
        assert_eq!(file("-blendu off -mm 0 1 -bm 2.0 -s 1 1 1 x.png"), (Some("x.png".into()), false));
        assert_eq!(file("-s 2 2 -o 0 0 0 -imfchan r -clamp on sub\\x y.png"), (Some("sub\\x y.png".into()), true));
        assert_eq!(file("\"q r.png\""), (Some("q r.png".into()), false));
        assert_eq!(file("-bm 1"), (None, false));
    }

    #[test]
    fn textures_are_found_beside_and_in_other_case() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("tex")).unwrap();
        fs::write(dir.path().join("tex/Skin one.PNG"), b"").unwrap();
        fs::write(dir.path().join("n.png"), b"").unwrap();
        let text = "newmtl a\nKd 0 0 0\nmap_Kd tex\\skin one.png\nmap_d tex\\skin one.png\nmap_Bump -bm 1 C:\\old\\n.png\n";
        let (m, notes) = one(text, dir.path());
        assert_eq!(m.base_color_texture.unwrap(), Image::File(dir.path().join("tex/Skin one.PNG")));
        assert_eq!(m.normal_texture.unwrap(), Image::File(dir.path().join("n.png")));
        assert_eq!((m.base_color, m.blend), ([1.0; 4], true));
        assert!(notes.is_empty());
        let (m, notes) = one("newmtl a\nKd 0.5 0.5 0.5\nmap_Kd none.png\nbump height.png\n", dir.path());
        assert_eq!((m.base_color[0], m.base_color_texture, m.normal_texture), (0.5, None, None));
        assert_eq!(notes.iter().count(), 1);
    }

    #[test]
    fn library_lines_hold_one_name_or_several() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("a b.mtl"), b"newmtl x\nKd 0 1 0\n").unwrap();
        let here = Beside::Folder(dir.path().to_owned());
        assert_eq!(names_in(&here, "a b.mtl"), ["a b.mtl"]);
        assert_eq!(names_in(&here, "c.mtl two words.mtl"), ["c.mtl", "two words.mtl"]);
        assert_eq!(names_in(&here, "\"c d.mtl\" \"e.mtl\""), ["c d.mtl", "e.mtl"]);
        let mut notes = Notes::default();
        let libraries = Libraries::load(&here, &["a b.mtl".into(), "c.mtl".into()], &mut notes);
        assert_eq!(notes.iter().count(), 1);
        let mut materials = vec![Material { name: "x".into(), ..Material::default() }];
        libraries.fill(&mut materials, true, &mut notes);
        assert_eq!(materials[0].base_color, [0.0, 1.0, 0.0, 1.0]);
    }
}
