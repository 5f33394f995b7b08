//! A stage as text (`.usda`).
//!
//! All samples of an attribute stand together in this format, so those of the normals wait in a file without a name until the points are complete.

use super::Encoding;
use super::tree::{Content, Layer, Prim, Property, Track, Value};
use crate::beside::folder_of;
use crate::error::{Error, Result};
use crate::export::Cancel;
use crate::export::files::Pending;
use rayon::prelude::*;
use std::fmt::{Display, Write as _};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

/// Vertices that are turned into text by one thread at a time.
const PIECE: usize = 8192;

/// Bytes that are copied at a time.
const COPIED: usize = 1 << 20;

/// A part of the file.
#[derive(Clone, Debug, PartialEq)]
enum Part {
    Text(String),
    Samples(Track),
}

/// A text file that is being written.
#[derive(Debug)]
pub(super) struct Text {
    file: Pending,
    path: PathBuf,
    /// What stands behind the samples of the points.
    rest: Vec<Part>,
    normals: File,
    extents: String,
    pieces: Vec<String>,
}

impl Text {
    /// Writes all that stands before the samples of the points.
    pub(super) fn begin(mut file: Pending, layer: &Layer, path: &Path) -> Result<Self> {
        let normals = tempfile::tempfile_in(folder_of(path)).map_err(|e| Error::unwritable(path, &e))?;
        let mut parts = Parts(vec![Part::Text(head(layer))]);
        parts.prim(&layer.root, 0);
        let points = parts.0.iter().position(|p| *p == Part::Samples(Track::Points)).unwrap_or(0);
        let rest = parts.0.split_off(points + 1);
        for part in &parts.0 {
            if let Part::Text(text) = part {
                file.write(text.as_bytes())?;
            }
        }
        Ok(Self { file, path: path.to_owned(), rest, normals, extents: String::new(), pieces: Vec::new() })
    }

    fn copy_normals(&mut self, cancel: &Cancel) -> Result<()> {
        let failed = |e: std::io::Error| Error::unwritable(&self.path, &e);
        self.normals.seek(SeekFrom::Start(0)).map_err(failed)?;
        let mut buffer = vec![0; COPIED];
        loop {
            cancel.check()?;
            match self.normals.read(&mut buffer).map_err(failed)? {
                0 => return Ok(()),
                count => self.file.write(&buffer[..count])?,
            }
        }
    }
}

impl Encoding for Text {
    fn sample(&mut self, track: Track, code: i64, values: &[[f32; 3]]) -> Result<()> {
        let Self { file, path, normals, extents, pieces, .. } = self;
        pieces.resize(values.len().div_ceil(PIECE), String::new());
        pieces.par_iter_mut().zip(values.par_chunks(PIECE)).enumerate().for_each(|(piece, (out, values))| {
            out.clear();
            for (k, &value) in values.iter().enumerate() {
                let comma = if piece + k == 0 { "" } else { ", " };
                let _ = write!(out, "{comma}{}", Tuple(value));
            }
        });
        let begin = format!("            {code}: [");
        let mut texts = [begin.as_str()].into_iter().chain(pieces.iter().map(String::as_str)).chain(["],\n"]);
        match track {
            Track::Points => texts.try_for_each(|text| file.write(text.as_bytes())),
            Track::Normals => {
                texts.try_for_each(|text| normals.write_all(text.as_bytes())).map_err(|e| Error::unwritable(path, &e))
            }
            Track::Extent => {
                extents.extend(texts);
                Ok(())
            }
        }
    }

    fn complete(&mut self, cancel: &Cancel) -> Result<()> {
        for part in std::mem::take(&mut self.rest) {
            match part {
                Part::Text(text) => self.file.write(text.as_bytes())?,
                Part::Samples(Track::Normals) => self.copy_normals(cancel)?,
                Part::Samples(_) => self.file.write(self.extents.as_bytes())?,
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<u64> {
        self.file.finish()
    }
}

fn head(layer: &Layer) -> String {
    let mut text = String::from("#usda 1.0\n(\n");
    for (name, value) in &layer.metadata {
        let name = if *name == "documentation" { "doc" } else { name };
        let _ = writeln!(text, "    {name} = {value}");
    }
    text + ")\n\n"
}

/// The parts of a file in their order.
struct Parts(Vec<Part>);

impl Parts {
    fn text(&mut self, text: &str) {
        match self.0.last_mut() {
            Some(Part::Text(last)) => *last += text,
            _ => self.0.push(Part::Text(text.to_owned())),
        }
    }

    fn prim(&mut self, prim: &Prim, depth: usize) {
        let indent = "    ".repeat(depth);
        let api = format!(" (\n{indent}    prepend apiSchemas = [\"MaterialBindingAPI\"]\n{indent})");
        let api = if prim.binds { api.as_str() } else { "" };
        self.text(&format!("{indent}def {} \"{}\"{api}\n{indent}{{\n", prim.kind, prim.name));
        prim.properties.iter().for_each(|property| self.property(property, &format!("{indent}    ")));
        for (k, child) in prim.children.iter().enumerate() {
            if k > 0 || !prim.properties.is_empty() {
                self.text("\n");
            }
            self.prim(child, depth + 1);
        }
        self.text(&format!("{indent}}}\n"));
    }

    fn property(&mut self, property: &Property, indent: &str) {
        let Property { name, of, uniform, custom, interpolation, content } = property;
        let words = format!("{}{}", if *custom { "custom " } else { "" }, if *uniform { "uniform " } else { "" });
        let head = format!("{indent}{words}{of} {name}");
        let about = interpolation.map_or_else(String::new, |i| format!(" (\n{indent}    interpolation = \"{i}\"\n{indent})"));
        match content {
            Content::Nothing => self.text(&format!("{head}{about}\n")),
            Content::Value(value) => self.text(&format!("{head} = {value}{about}\n")),
            Content::Connection(path) => self.text(&format!("{head}.connect = <{path}>\n")),
            Content::Target(path) => self.text(&format!("{head} = <{path}>\n")),
            Content::Samples(track) => {
                let statement = if about.is_empty() { String::new() } else { format!("{head}{about}\n") };
                self.text(&format!("{statement}{head}.timeSamples = {{\n"));
                self.0.push(Part::Samples(*track));
                self.text(&format!("{indent}}}\n"));
            }
        }
    }
}

impl Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Value::Token(text) | Value::Text(text) => f.write_str(&quoted(text)),
            Value::Asset(path) if path.contains('@') => write!(f, "@@@{path}@@@"),
            Value::Asset(path) => write!(f, "@{path}@"),
            Value::Bool(x) => write!(f, "{}", u8::from(*x)),
            Value::Float(x) => write!(f, "{x}"),
            Value::Double(x) => write!(f, "{x}"),
            Value::Vector3(v) => write!(f, "{}", Tuple(*v)),
            Value::Vector4(v) => write!(f, "{}", Tuple(*v)),
            Value::Integers(list) => write_list(f, list.iter()),
            Value::Floats(list) => write_list(f, list.iter()),
            Value::Vectors2(list) => write_list(f, list.iter().copied().map(Tuple)),
            Value::Vectors3(list) => write_list(f, list.iter().copied().map(Tuple)),
        }
    }
}

/// `(x, y, z)`, with the digits that give the same number back.
struct Tuple<const N: usize>([f32; N]);

impl<const N: usize> Display for Tuple<N> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (k, x) in self.0.iter().enumerate() {
            write!(f, "{}{x}", if k == 0 { "(" } else { ", " })?;
        }
        f.write_str(")")
    }
}

fn write_list<T: Display>(f: &mut std::fmt::Formatter<'_>, values: impl Iterator<Item = T>) -> std::fmt::Result {
    f.write_str("[")?;
    for (k, value) in values.enumerate() {
        write!(f, "{}{value}", if k == 0 { "" } else { ", " })?;
    }
    f.write_str("]")
}

/// A text in quotes.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => out.push('_'),
            c => out.push(c),
        }
    }
    out + "\""
}
