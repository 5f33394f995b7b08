//! A stage as a crate (`.usdc`), version 0.8.0: values as they come, the tables that name them at the end.
//!
//! `PXR-USDC`, eight bytes of version, i64 place of the table of contents; then values, and the sections TOKENS, STRINGS, FIELDS, FIELDSETS, PATHS
//! and SPECS. A field names a value, a set lists fields, a spec gives a set to a path. The tables of integers and texts are compressed by LZ4; ours
//! are short, and are stored as the literals that every reader of LZ4 knows. Little endian. Source: pxr/usd/sdf/crateFile.cpp of OpenUSD 26.

use super::Encoding;
use super::tree::{Content, Layer, Prim, Property, Track, Value};
use crate::error::Result;
use crate::export::Cancel;
use crate::export::files::Pending;
use crate::export::single::bytes;
use std::collections::HashMap;

/// The oldest version that is not given up by today's readers.
const VERSION: [u8; 8] = [0, 8, 0, 0, 0, 0, 0, 0];

/// Bytes of the head: name, version, place of the table of contents, reserved.
const HEAD: u64 = 88;

/// Ends a set of fields.
const END_OF_SET: u32 = u32::MAX;

/// Types of values by number.
mod of {
    pub(super) const BOOL: u64 = 1;
    pub(super) const INT: u64 = 3;
    pub(super) const FLOAT: u64 = 8;
    pub(super) const DOUBLE: u64 = 9;
    pub(super) const STRING: u64 = 10;
    pub(super) const TOKEN: u64 = 11;
    pub(super) const ASSET: u64 = 12;
    pub(super) const VEC2F: u64 = 20;
    pub(super) const VEC3F: u64 = 24;
    pub(super) const VEC4F: u64 = 28;
    pub(super) const TOKEN_LIST: u64 = 32;
    pub(super) const PATH_LIST: u64 = 34;
    pub(super) const TOKENS: u64 = 41;
    pub(super) const SPECIFIER: u64 = 42;
    pub(super) const VARIABILITY: u64 = 44;
    pub(super) const TIME_SAMPLES: u64 = 46;
    pub(super) const DOUBLES: u64 = 48;
}

/// Kinds of specs by number.
const ATTRIBUTE: u32 = 1;
const PRIM: u32 = 6;
const ROOT: u32 = 7;
const RELATIONSHIP: u32 = 8;

/// A value: its type, and either its place in the file or itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Rep(u64);

impl Rep {
    fn placed(of: u64, place: u64) -> Self {
        Self(of << 48 | place)
    }

    fn inlined(of: u64, bits: u32) -> Self {
        Self(1 << 62 | of << 48 | u64::from(bits))
    }

    fn array(of: u64, place: u64) -> Self {
        Self(1 << 63 | of << 48 | place)
    }
}

/// A crate that is being written.
#[derive(Debug)]
pub(super) struct Crate {
    file: Pending,
    end: u64,
    layer: Layer,
    /// Time codes, and the values of each track at them.
    codes: Vec<f64>,
    points: Vec<Rep>,
    normals: Vec<Rep>,
    extents: Vec<Rep>,
    buffer: Vec<u8>,
    tables: Tables,
}

/// What the sections hold.
#[derive(Debug, Default)]
struct Tables {
    tokens: Vec<String>,
    known: HashMap<String, u32>,
    strings: Vec<u32>,
    fields: Vec<(u32, Rep)>,
    sets: Vec<u32>,
    /// Path, set, kind.
    specs: Vec<[u32; 3]>,
    paths: HashMap<String, u32>,
    /// Of the paths in the order of the tree: the last element, negative for a property, and the way to the next.
    elements: Vec<i32>,
    jumps: Vec<i32>,
}

impl Tables {
    fn token(&mut self, text: &str) -> u32 {
        if let Some(&known) = self.known.get(text) {
            return known;
        }
        let index = self.tokens.len() as u32;
        self.tokens.push(text.to_owned());
        self.known.insert(text.to_owned(), index);
        index
    }

    fn string(&mut self, text: &str) -> Rep {
        let token = self.token(text);
        self.strings.push(token);
        Rep::inlined(of::STRING, self.strings.len() as u32 - 1)
    }

    fn token_rep(&mut self, text: &str) -> Rep {
        Rep::inlined(of::TOKEN, self.token(text))
    }

    fn spec(&mut self, path: u32, kind: u32, fields: Vec<(&str, Rep)>) {
        self.specs.push([path, self.sets.len() as u32, kind]);
        for (name, rep) in fields {
            let name = self.token(name);
            self.sets.push(self.fields.len() as u32);
            self.fields.push((name, rep));
        }
        self.sets.push(END_OF_SET);
    }

    /// Numbers the path of a prim and those below it.
    fn number(&mut self, prim: &Prim, path: &str, last: bool) {
        let at = self.path(path, &prim.name, false);
        let below = prim.properties.len() + prim.children.len();
        for (k, property) in prim.properties.iter().enumerate() {
            let leaf = self.path(&format!("{path}.{}", property.name), &property.name, true);
            self.jumps[leaf] = if k + 1 == below { -2 } else { 0 };
        }
        for (k, child) in prim.children.iter().enumerate() {
            let last = prim.properties.len() + k + 1 == below;
            self.number(child, &format!("{path}/{}", child.name), last);
        }
        // To the sibling behind what is below, if there is both; -1: what is below follows alone; 0: the sibling; -2: nothing.
        self.jumps[at] = match (below > 0, last) {
            (true, false) => (self.jumps.len() - at) as i32,
            (true, true) => -1,
            (false, false) => 0,
            (false, true) => -2,
        };
    }

    fn path(&mut self, path: &str, element: &str, property: bool) -> usize {
        let at = self.jumps.len();
        self.paths.insert(path.to_owned(), at as u32);
        let token = self.token(element) as i32;
        self.elements.push(if property { -token } else { token });
        self.jumps.push(0);
        at
    }
}

impl Crate {
    pub(super) fn begin(mut file: Pending, layer: Layer) -> Result<Self> {
        file.write(&[0; HEAD as usize])?;
        let mut tables = Tables::default();
        // Number 0 has no sign, and so cannot be the name of a property.
        tables.token("");
        Ok(Self {
            file,
            end: HEAD,
            layer,
            codes: Vec::new(),
            points: Vec::new(),
            normals: Vec::new(),
            extents: Vec::new(),
            buffer: Vec::new(),
            tables,
        })
    }

    /// Appends bytes; returns their place.
    fn put(&mut self, bytes: &[u8]) -> Result<u64> {
        let place = self.end;
        self.file.write(bytes)?;
        self.end += bytes.len() as u64;
        Ok(place)
    }

    /// The file, for what wraps it up.
    pub(super) fn file_mut(&mut self) -> &mut std::fs::File {
        self.file.file_mut()
    }

    fn array<const N: usize>(&mut self, of: u64, values: &[[f32; N]]) -> Result<Rep> {
        let mut buffer = std::mem::take(&mut self.buffer);
        bytes(values, f32::to_le_bytes, &mut buffer);
        let rep = self.array_of(of, values.len(), &buffer);
        self.buffer = buffer;
        rep
    }

    fn array_of(&mut self, of: u64, count: usize, bytes: &[u8]) -> Result<Rep> {
        // A place of 0 means none.
        if count == 0 {
            return Ok(Rep::array(of, 0));
        }
        let place = self.put(&(count as u64).to_le_bytes())?;
        self.put(bytes)?;
        Ok(Rep::array(of, place))
    }

    fn value(&mut self, value: &Value) -> Result<Rep> {
        Ok(match value {
            Value::Token(text) => self.tables.token_rep(text),
            Value::Text(text) => self.tables.string(text),
            Value::Asset(path) => Rep::inlined(of::ASSET, self.tables.token(path)),
            Value::Bool(x) => Rep::inlined(of::BOOL, u32::from(*x)),
            Value::Float(x) => Rep::inlined(of::FLOAT, x.to_bits()),
            Value::Double(x) => Rep::placed(of::DOUBLE, self.put(&x.to_le_bytes())?),
            Value::Vector3(v) => Rep::placed(of::VEC3F, self.put(&v.map(f32::to_le_bytes).concat())?),
            Value::Vector4(v) => Rep::placed(of::VEC4F, self.put(&v.map(f32::to_le_bytes).concat())?),
            Value::Integers(list) => {
                let bytes: Vec<u8> = list.iter().flat_map(|x| x.to_le_bytes()).collect();
                self.array_of(of::INT, list.len(), &bytes)?
            }
            Value::Floats(list) => self.array(of::FLOAT, list.as_chunks::<1>().0)?,
            Value::Vectors2(list) => self.array(of::VEC2F, list)?,
            Value::Vectors3(list) => self.array(of::VEC3F, list)?,
        })
    }

    fn tokens(&mut self, texts: &[&str]) -> Result<Rep> {
        let numbers = texts.iter().flat_map(|text| self.tables.token(text).to_le_bytes()).collect::<Vec<u8>>();
        let place = self.put(&(texts.len() as u64).to_le_bytes())?;
        self.put(&numbers)?;
        Ok(Rep::placed(of::TOKENS, place))
    }

    /// A list with one path, which is all of it.
    fn path_list(&mut self, path: &str) -> Result<Rep> {
        let index = self.tables.paths[path];
        let place = self.put(&[&[0b11][..], &1u64.to_le_bytes(), &index.to_le_bytes()].concat())?;
        Ok(Rep::placed(of::PATH_LIST, place))
    }

    fn time_samples(&mut self, track: Track) -> Result<Rep> {
        let values = std::mem::take(match track {
            Track::Points => &mut self.points,
            Track::Normals => &mut self.normals,
            Track::Extent => &mut self.extents,
        });
        let mut codes = (self.codes.len() as u64).to_le_bytes().to_vec();
        codes.extend(self.codes.iter().flat_map(|c| c.to_le_bytes()));
        let codes = Rep::placed(of::DOUBLES, self.put(&codes)?);
        // Each time the distance to what follows, which is right behind.
        let mut body = [8u64, codes.0, 8, values.len() as u64].map(u64::to_le_bytes).concat();
        body.extend(values.iter().flat_map(|rep| rep.0.to_le_bytes()));
        Ok(Rep::placed(of::TIME_SAMPLES, self.put(&body)?))
    }

    fn prim(&mut self, prim: &Prim, path: &str) -> Result<()> {
        let mut fields = vec![("specifier", Rep::inlined(of::SPECIFIER, 0)), ("typeName", self.tables.token_rep(prim.kind))];
        if prim.binds {
            // One prepended token.
            let token = self.tables.token("MaterialBindingAPI");
            let place = self.put(&[&[0b10_0000][..], &1u64.to_le_bytes(), &token.to_le_bytes()].concat())?;
            fields.push(("apiSchemas", Rep::placed(of::TOKEN_LIST, place)));
        }
        if !prim.properties.is_empty() {
            let names: Vec<&str> = prim.properties.iter().map(|p| p.name.as_str()).collect();
            fields.push(("properties", self.tokens(&names)?));
        }
        if !prim.children.is_empty() {
            let names: Vec<&str> = prim.children.iter().map(|p| p.name.as_str()).collect();
            fields.push(("primChildren", self.tokens(&names)?));
        }
        self.tables.spec(self.tables.paths[path], PRIM, fields);
        prim.properties.iter().try_for_each(|p| self.property(p, &format!("{path}.{}", p.name)))?;
        prim.children.iter().try_for_each(|child| self.prim(child, &format!("{path}/{}", child.name)))
    }

    fn property(&mut self, property: &Property, path: &str) -> Result<()> {
        let relationship = property.of == "rel";
        let mut fields = Vec::new();
        if !relationship {
            fields.push(("typeName", self.tables.token_rep(property.of)));
        }
        if property.uniform || relationship {
            fields.push(("variability", Rep::inlined(of::VARIABILITY, 1)));
        }
        if property.custom {
            fields.push(("custom", Rep::inlined(of::BOOL, 1)));
        }
        if let Some(interpolation) = property.interpolation {
            fields.push(("interpolation", self.tables.token_rep(interpolation)));
        }
        match &property.content {
            Content::Nothing => {}
            Content::Value(value) => fields.push(("default", self.value(value)?)),
            Content::Samples(track) => fields.push(("timeSamples", self.time_samples(*track)?)),
            Content::Connection(to) => fields.push(("connectionPaths", self.path_list(to)?)),
            Content::Target(to) => fields.push(("targetPaths", self.path_list(to)?)),
        }
        self.tables.spec(self.tables.paths[path], if relationship { RELATIONSHIP } else { ATTRIBUTE }, fields);
        Ok(())
    }

    /// Writes the sections and their table, and the head.
    fn close(&mut self) -> Result<()> {
        let tables = std::mem::take(&mut self.tables);
        let counted = |count: usize, rest: Vec<u8>| [&(count as u64).to_le_bytes()[..], &rest].concat();
        let texts: Vec<u8> = tables.tokens.iter().flat_map(|t| t.bytes().chain([0])).collect();
        let tokens = [(texts.len() as u64).to_le_bytes().to_vec(), sized(&stored(&texts))].concat();
        let strings = tables.strings.iter().flat_map(|s| s.to_le_bytes()).collect();
        let names = integers(tables.fields.iter().map(|f| f.0 as i32));
        let reps: Vec<u8> = tables.fields.iter().flat_map(|f| f.1.0.to_le_bytes()).collect();
        let fields = [names, sized(&stored(&reps))].concat();
        let sets = integers(tables.sets.iter().map(|&s| s as i32));
        let count = tables.jumps.len();
        let columns = [
            (count as u64).to_le_bytes().to_vec(),
            integers(0..count as i32),
            integers(tables.elements.iter().copied()),
            integers(tables.jumps.iter().copied()),
        ];
        let specs: Vec<u8> = (0..3).flat_map(|k| integers(tables.specs.iter().map(move |s| s[k] as i32))).collect();
        let sections = [
            ("TOKENS", counted(tables.tokens.len(), tokens)),
            ("STRINGS", counted(tables.strings.len(), strings)),
            ("FIELDS", counted(tables.fields.len(), fields)),
            ("FIELDSETS", counted(tables.sets.len(), sets)),
            ("PATHS", counted(count, columns.concat())),
            ("SPECS", counted(tables.specs.len(), specs)),
        ];
        let mut contents = (sections.len() as u64).to_le_bytes().to_vec();
        for (name, bytes) in &sections {
            let place = self.put(bytes)?;
            let mut padded = [0; 16];
            padded[..name.len()].copy_from_slice(name.as_bytes());
            contents.extend(padded);
            contents.extend(place.to_le_bytes());
            contents.extend((bytes.len() as u64).to_le_bytes());
        }
        let place = self.put(&contents)?;
        self.file.patch(0, &[&b"PXR-USDC"[..], &VERSION, &place.to_le_bytes()].concat())
    }
}

impl Encoding for Crate {
    fn sample(&mut self, track: Track, code: i64, values: &[[f32; 3]]) -> Result<()> {
        let rep = self.array(of::VEC3F, values)?;
        match track {
            Track::Points => {
                self.codes.push(code as f64);
                self.points.push(rep);
            }
            Track::Normals => self.normals.push(rep),
            Track::Extent => self.extents.push(rep),
        }
        Ok(())
    }

    fn complete(&mut self, _: &Cancel) -> Result<()> {
        let layer = self.layer.clone();
        let path = format!("/{}", layer.root.name);
        let root = self.tables.path("/", "", false);
        self.tables.jumps[root] = -1;
        self.tables.number(&layer.root, &path, true);
        let mut fields = Vec::new();
        for (name, value) in &layer.metadata {
            fields.push((*name, self.value(value)?));
        }
        fields.push(("primChildren", self.tokens(&[&layer.root.name])?));
        self.tables.spec(0, ROOT, fields);
        self.prim(&layer.root, &path)?;
        self.close()
    }

    fn finish(self: Box<Self>) -> Result<u64> {
        self.file.finish()
    }
}

/// Bytes with their number before them.
fn sized(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u64).to_le_bytes()[..], bytes].concat()
}

/// LZ4 in a single chunk, of literals alone: a token with their number, which goes on in bytes, and the literals.
fn stored(bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![0, (bytes.len().min(15) as u8) << 4];
    if let Some(more) = bytes.len().checked_sub(15) {
        out.extend(std::iter::repeat_n(255, more / 255));
        out.push((more % 255) as u8);
    }
    out.extend(bytes);
    out
}

/// Integers as differences to the one before: the commonest, which we have no use for, two bits for the width of each, here 32 bits, and these.
fn integers(values: impl Iterator<Item = i32>) -> Vec<u8> {
    let values: Vec<i32> = values.collect();
    let mut out = vec![0; 4];
    out.extend(std::iter::repeat_n(0xFF, values.len().div_ceil(4)));
    let before = std::iter::once(&0).chain(&values);
    out.extend(values.iter().zip(before).flat_map(|(value, before)| value.wrapping_sub(*before).to_le_bytes()));
    sized(&stored(&out))
}
