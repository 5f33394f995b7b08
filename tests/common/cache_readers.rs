//! Minimal readers of MDD, USD (text and crates) and Alembic, written from the formats' descriptions and sharing nothing with the writers.

use std::collections::BTreeMap;

/// An MDD file: seconds of every frame, and its points.
pub fn read_mdd(bytes: &[u8]) -> (Vec<f32>, Vec<Vec<[f32; 3]>>) {
    let count = |at: usize| i32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let number = |at: usize| f32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    let (frames, points) = (count(0), count(4));
    let body = 8 + 4 * frames;
    assert_eq!(bytes.len(), body + frames * points * 12);
    let frame = |f: usize| (0..points).map(|p| [0, 1, 2].map(|c| number(body + ((f * points + p) * 3 + c) * 4))).collect();
    ((0..frames).map(|f| number(8 + 4 * f)).collect(), (0..frames).map(frame).collect())
}

/// A USD text file whose attributes stand one on a line, and time samples one per line.
pub struct Usda<'a>(pub &'a str);

impl Usda<'_> {
    /// What stands behind `name =` on its line; the name with its type, so that it is told from others. Panics if it is not there just once.
    pub fn value(&self, name: &str) -> &str {
        let begin = format!("{name} = ");
        let mut found = self.0.lines().filter_map(|l| l.trim_start().strip_prefix(begin.as_str()));
        let value = found.next().unwrap_or_else(|| panic!("no {name}"));
        assert!(found.next().is_none(), "{name} more than once");
        value
    }

    /// Whether the file has a line with this value.
    pub fn has(&self, name: &str) -> bool {
        self.0.lines().any(|l| l.trim_start().starts_with(&format!("{name} = ")))
    }

    /// The numbers of an attribute.
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        numbers(self.value(name))
    }

    /// Time samples: frame and numbers, as single precision rounds them from double, which is how USD reads them.
    pub fn samples(&self, name: &str) -> Vec<(i64, Vec<f32>)> {
        let head = format!("{name}.timeSamples = {{");
        let mut lines = self.0.lines().map(str::trim);
        assert!(lines.by_ref().any(|l| l == head), "no {name}");
        let samples = lines.take_while(|l| *l != "}");
        samples
            .map(|l| {
                let (code, values) = l.split_once(": ").unwrap();
                (code.parse().unwrap(), numbers(values).into_iter().map(|x| x as f32).collect())
            })
            .collect()
    }

    /// The body of a prim that is named `kind "name"`.
    pub fn prim(&self, kind: &str, name: &str) -> Usda<'_> {
        let begin = self.0.find(&format!("def {kind} \"{name}\"")).unwrap_or_else(|| panic!("no {kind} {name}"));
        let indent = begin - self.0[..begin].rfind('\n').unwrap() - 1;
        let end = self.0[begin..].find(&format!("\n{}}}", " ".repeat(indent))).unwrap();
        Usda(&self.0[begin..begin + end])
    }
}

fn numbers(text: &str) -> Vec<f64> {
    let separators = |c: char| "[](), ".contains(c);
    text.split(separators).filter(|w| !w.is_empty()).map(|w| w.parse().unwrap()).collect()
}

/// Points of a flat list.
pub fn triples(flat: &[f32]) -> Vec<[f32; 3]> {
    flat.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

/// An Alembic file in the Ogawa container.
pub struct Abc {
    bytes: Vec<u8>,
    /// Metadata by number.
    metadata: Vec<String>,
    /// Of the archive itself.
    pub description: String,
    /// Seconds between samples and of the first, by the number of the time sampling.
    pub times: Vec<(f64, f64)>,
    top: u64,
}

/// An object of an archive.
#[derive(Debug)]
pub struct AbcObject {
    pub metadata: String,
    pub properties: BTreeMap<String, AbcProperty>,
    pub children: BTreeMap<String, AbcObject>,
}

/// A property.
#[derive(Debug)]
pub struct AbcProperty {
    pub metadata: String,
    /// Plain type, how many of it an element has, number of samples, of the time sampling.
    pub pod: u32,
    pub extent: u32,
    pub samples: u32,
    pub times: u32,
    /// Whether all samples are the first one.
    pub constant: bool,
    /// Bytes of the samples that are stored.
    pub data: Vec<Vec<u8>>,
    /// Of a compound.
    pub properties: BTreeMap<String, AbcProperty>,
}

impl AbcProperty {
    /// Bytes of a sample.
    pub fn sample(&self, index: usize) -> &[u8] {
        assert!(index < self.samples as usize);
        &self.data[if self.constant { 0 } else { index }]
    }

    pub fn floats(&self, index: usize) -> Vec<f32> {
        self.sample(index).chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    }

    pub fn doubles(&self, index: usize) -> Vec<f64> {
        self.sample(index).chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
    }

    pub fn integers(&self, index: usize) -> Vec<u32> {
        self.sample(index).chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect()
    }
}

/// A child of a group.
enum Child {
    Group(Option<u64>),
    Data(Vec<u8>),
}

impl Abc {
    pub fn read(bytes: Vec<u8>) -> Self {
        assert_eq!(&bytes[..8], b"Ogawa\xFF\0\x01", "a finished file");
        let mut abc = Self { bytes, metadata: vec![String::new()], description: String::new(), times: Vec::new(), top: 0 };
        let root = abc.children(abc.u64(8));
        let [
            Child::Data(layout),
            Child::Data(_),
            Child::Group(Some(top)),
            Child::Data(description),
            Child::Data(times),
            Child::Data(table),
        ] = &root[..]
        else {
            panic!("a root of version, version, top, metadata, times and table")
        };
        assert_eq!(layout, &[0; 4]);
        abc.top = *top;
        abc.description = String::from_utf8(description.clone()).unwrap();
        let mut rest = &table[..];
        while let [length, tail @ ..] = rest {
            let (text, tail) = tail.split_at(usize::from(*length));
            abc.metadata.push(String::from_utf8(text.to_vec()).unwrap());
            rest = tail;
        }
        // u32 samples, f64 period, u32 times per cycle, which is 1, f64 the time.
        for sampling in times.chunks_exact(24) {
            assert_eq!(sampling[12..16], [1, 0, 0, 0]);
            let number = |at: usize| f64::from_le_bytes(sampling[at..at + 8].try_into().unwrap());
            abc.times.push((number(4), number(16)));
        }
        abc
    }

    pub fn top(&self) -> AbcObject {
        self.object(self.top, String::new())
    }

    fn u64(&self, at: u64) -> u64 {
        let at = at as usize;
        u64::from_le_bytes(self.bytes[at..at + 8].try_into().unwrap())
    }

    fn children(&self, group: u64) -> Vec<Child> {
        let child = |k: u64| {
            let place = self.u64(group + 8 + 8 * k);
            let at = place & !(1 << 63);
            match (place == at, at) {
                (true, 0) => Child::Group(None),
                (true, at) => Child::Group(Some(at)),
                (false, 0) => Child::Data(Vec::new()),
                (false, at) => Child::Data(self.bytes[at as usize + 8..][..self.u64(at) as usize].to_vec()),
            }
        };
        (0..self.u64(group)).map(child).collect()
    }

    fn object(&self, group: u64, metadata: String) -> AbcObject {
        let mut children = self.children(group);
        let Some(Child::Data(table)) = children.pop() else { panic!("a table of objects") };
        let mut rest = &table[..table.len() - 32];
        let mut groups = children.into_iter();
        let properties = match groups.next() {
            Some(Child::Group(Some(group))) => self.properties(group),
            _ => BTreeMap::new(),
        };
        let mut objects = BTreeMap::new();
        for child in groups {
            let Child::Group(Some(group)) = child else { panic!("an object is a group") };
            let length = u32::from_le_bytes(rest[..4].try_into().unwrap()) as usize;
            let name = String::from_utf8(rest[4..4 + length].to_vec()).unwrap();
            let metadata = self.metadata[usize::from(rest[4 + length])].clone();
            rest = &rest[5 + length..];
            assert!(objects.insert(name, self.object(group, metadata)).is_none(), "two objects of one name");
        }
        assert!(rest.is_empty());
        AbcObject { metadata, properties, children: objects }
    }

    fn properties(&self, group: u64) -> BTreeMap<String, AbcProperty> {
        let mut children = self.children(group);
        let Some(Child::Data(table)) = children.pop() else { panic!("a table of properties") };
        let mut at = 0;
        let mut properties = BTreeMap::new();
        for child in children {
            let info = u32::from_le_bytes(table[at..at + 4].try_into().unwrap());
            at += 4;
            let width = [1, 2, 4][(info >> 2 & 3) as usize];
            let mut number = || {
                let mut word = [0; 4];
                word[..width].copy_from_slice(&table[at..at + width]);
                at += width;
                u32::from_le_bytes(word)
            };
            let kind = info & 3;
            let (samples, times) = if kind == 0 { (0, 0) } else { (number(), if info & 0x100 == 0 { 0 } else { number() }) };
            assert_eq!(info & 0x200, 0, "no ranges of change");
            let length = number() as usize;
            let name = String::from_utf8(table[at..at + length].to_vec()).unwrap();
            at += length;
            let metadata = self.metadata[(info >> 20 & 0xFF) as usize].clone();
            let content = match child {
                Child::Group(Some(group)) => group,
                _ => panic!("{name} is empty"),
            };
            let constant = info & 0x800 != 0;
            let mut property = AbcProperty {
                metadata,
                pod: info >> 4 & 0xF,
                extent: info >> 12 & 0xFF,
                samples,
                times,
                constant,
                data: Vec::new(),
                properties: BTreeMap::new(),
            };
            if kind == 0 {
                property.properties = self.properties(content);
            } else {
                // Arrays have a second child for the dimensions, which is empty where the size tells.
                let step = if kind == 1 { 1 } else { 2 };
                for (k, child) in self.children(content).into_iter().enumerate() {
                    let Child::Data(data) = child else { panic!("{name}: a sample is data") };
                    if k % step == 0 {
                        // The key of the sample comes first.
                        property.data.push(data[16..].to_vec());
                    } else {
                        assert!(data.is_empty());
                    }
                }
                assert_eq!(property.data.len(), if constant { 1 } else { samples as usize }, "{name}");
            }
            assert!(properties.insert(name, property).is_none());
        }
        assert_eq!(at, table.len());
        properties
    }
}

/// A USD crate: the fields of every path.
pub struct Usdc {
    bytes: Vec<u8>,
    tokens: Vec<String>,
    strings: Vec<u32>,
    paths: Vec<String>,
    pub specs: BTreeMap<String, BTreeMap<String, u64>>,
}

impl Usdc {
    pub fn read(bytes: Vec<u8>) -> Self {
        assert_eq!(&bytes[..8], b"PXR-USDC");
        let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
        let contents = u64_at(16);
        let sections: BTreeMap<String, &[u8]> = (0..u64_at(contents))
            .map(|k| {
                let at = contents + 8 + 32 * k;
                let name = String::from_utf8(bytes[at..at + 16].to_vec()).unwrap().trim_end_matches('\0').to_owned();
                (name, &bytes[u64_at(at + 16)..][..u64_at(at + 24)])
            })
            .collect();
        let mut section = Section(sections["TOKENS"]);
        let (count, size) = (section.u64(), section.u64());
        let texts = section.unpacked();
        assert_eq!(texts.len(), size);
        let tokens: Vec<String> = texts.split(|b| *b == 0).map(|t| String::from_utf8(t.to_vec()).unwrap()).take(count).collect();
        let strings = sections["STRINGS"][8..].chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
        let mut section = Section(sections["FIELDS"]);
        let count = section.u64();
        let names = section.integers(count);
        let reps = section.unpacked();
        let field = |k: usize| {
            let rep = u64::from_le_bytes(reps[8 * k..8 * k + 8].try_into().unwrap());
            (tokens[names[k] as usize].clone(), rep)
        };
        let mut section = Section(sections["FIELDSETS"]);
        let count = section.u64();
        let sets = section.integers(count);
        let mut section = Section(sections["PATHS"]);
        let (count, _) = (section.u64(), section.u64());
        let [indices, elements, jumps] = [(); 3].map(|()| section.integers(count));
        let mut paths = vec![String::new(); count];
        // Places in the tree that are still to be walked, each with the path above it.
        let mut open = vec![(0, None::<String>)];
        while let Some((k, above)) = open.pop() {
            let element = &tokens[elements[k].unsigned_abs() as usize];
            let path = match &above {
                None => "/".to_owned(),
                Some(above) if elements[k] < 0 => format!("{above}.{element}"),
                Some(above) => format!("{}/{element}", above.trim_end_matches('/')),
            };
            paths[indices[k] as usize] = path.clone();
            match jumps[k] {
                -2 => {}
                -1 => open.push((k + 1, Some(path))),
                0 => open.push((k + 1, above)),
                jump => {
                    open.push((k + jump as usize, above));
                    open.push((k + 1, Some(path)));
                }
            }
        }
        let mut section = Section(sections["SPECS"]);
        let count = section.u64();
        let [of_path, of_set, _] = [(); 3].map(|()| section.integers(count));
        let mut specs = BTreeMap::new();
        for (path, set) in of_path.iter().zip(of_set) {
            let fields = sets[set as usize..].iter().take_while(|f| **f != -1).map(|&f| field(f as usize)).collect();
            assert!(specs.insert(paths[*path as usize].clone(), fields).is_none());
        }
        Self { tokens, strings, paths, specs, bytes }
    }

    fn rep(&self, path: &str, field: &str) -> u64 {
        *self.specs.get(path).and_then(|s| s.get(field)).unwrap_or_else(|| panic!("no {field} of {path}"))
    }

    fn u64_at(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.bytes[at..at + 8].try_into().unwrap())
    }

    /// Token, text or asset.
    pub fn text(&self, path: &str, field: &str) -> &str {
        let rep = self.rep(path, field);
        assert_eq!(rep >> 62, 1, "inlined");
        match rep >> 48 & 0xFF {
            10 => &self.tokens[self.strings[rep as u32 as usize] as usize],
            11 | 12 => &self.tokens[rep as u32 as usize],
            other => panic!("{path} {field} is of type {other}"),
        }
    }

    pub fn double(&self, path: &str, field: &str) -> f64 {
        let rep = self.rep(path, field);
        assert_eq!(rep >> 48, 9);
        f64::from_bits(self.u64_at((rep & 0xFFFF_FFFF_FFFF) as usize))
    }

    /// Bytes of the elements of an array.
    fn array(&self, rep: u64, of: u64, width: usize) -> &[u8] {
        assert_eq!(rep >> 48, 1 << 15 | of);
        let at = (rep & 0xFFFF_FFFF_FFFF) as usize;
        &self.bytes[at + 8..][..width * self.u64_at(at) as usize]
    }

    pub fn integers(&self, path: &str) -> Vec<u32> {
        let values = self.array(self.rep(path, "default"), 3, 4);
        values.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect()
    }

    /// Time codes and points of an attribute.
    pub fn samples(&self, path: &str) -> Vec<(f64, Vec<[f32; 3]>)> {
        let rep = self.rep(path, "timeSamples");
        assert_eq!(rep >> 48, 46);
        let at = (rep & 0xFFFF_FFFF_FFFF) as usize;
        let times_at = at + self.u64_at(at) as usize;
        let times = self.u64_at(times_at);
        assert_eq!(times >> 48, 48);
        let times = (times & 0xFFFF_FFFF_FFFF) as usize;
        let values = times_at + 8 + self.u64_at(times_at + 8) as usize;
        assert_eq!(self.u64_at(times), self.u64_at(values));
        let sample = |k: usize| {
            let flat = self.array(self.u64_at(values + 8 + 8 * k), 24, 12);
            let flat: Vec<f32> = flat.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
            (f64::from_bits(self.u64_at(times + 8 + 8 * k)), triples(&flat))
        };
        (0..self.u64_at(times) as usize).map(sample).collect()
    }

    /// The one path that a list of paths holds.
    pub fn target(&self, path: &str, field: &str) -> &str {
        let rep = self.rep(path, field);
        assert_eq!(rep >> 48, 34);
        let at = (rep & 0xFFFF_FFFF_FFFF) as usize;
        assert_eq!((self.bytes[at], self.u64_at(at + 1)), (3, 1));
        &self.paths[u32::from_le_bytes(self.bytes[at + 9..at + 13].try_into().unwrap()) as usize]
    }
}

/// What is left of a section.
struct Section<'a>(&'a [u8]);

impl Section<'_> {
    fn u64(&mut self) -> usize {
        let (number, rest) = self.0.split_at(8);
        self.0 = rest;
        u64::from_le_bytes(number.try_into().unwrap()) as usize
    }

    /// The next block, unpacked: LZ4 after a byte that counts the chunks, none for one.
    fn unpacked(&mut self) -> Vec<u8> {
        let packed = self.u64();
        let (block, rest) = self.0.split_at(packed);
        self.0 = rest;
        assert_eq!(block[0], 0);
        let mut out = Vec::new();
        let mut at = 1;
        let length = |at: &mut usize, nibble: u8| {
            let mut length = usize::from(nibble);
            while length >= 15 && block[*at] == 255 {
                length += 255;
                *at += 1;
            }
            if nibble == 15 {
                length += usize::from(block[*at]);
                *at += 1;
            }
            length
        };
        while at < block.len() {
            let token = block[at];
            at += 1;
            let literals = length(&mut at, token >> 4);
            out.extend(&block[at..at + literals]);
            at += literals;
            if at < block.len() {
                let back = usize::from(u16::from_le_bytes([block[at], block[at + 1]]));
                at += 2;
                for _ in 0..length(&mut at, token & 15) + 4 {
                    out.push(out[out.len() - back]);
                }
            }
        }
        out
    }

    fn integers(&mut self, count: usize) -> Vec<i32> {
        let mut block = self.unpacked();
        let widths = block.split_off(4);
        let common = i32::from_le_bytes(block.try_into().unwrap());
        let (widths, mut deltas) = widths.split_at(count.div_ceil(4));
        let mut value = 0i32;
        let integers = (0..count).map(|k| {
            let width = [0, 1, 2, 4][usize::from(widths[k / 4] >> (2 * (k % 4)) & 3)];
            let (delta, rest) = deltas.split_at(width);
            deltas = rest;
            value = value.wrapping_add(match *delta {
                [] => common,
                [a] => i32::from(a as i8),
                [a, b] => i32::from(i16::from_le_bytes([a, b])),
                _ => i32::from_le_bytes(delta.try_into().unwrap()),
            });
            value
        });
        integers.collect()
    }
}
