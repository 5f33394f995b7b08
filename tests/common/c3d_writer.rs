//! A small C3D writer for tests and fixtures: labelled points in any of the six encodings, with optional analog words.
//!
//! Self-contained: included with `#[path]` where it is needed.
#![allow(dead_code, missing_docs)]

/// Byte order and floats of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    Intel,
    Dec,
    Mips,
}

/// All processors.
pub const PROCESSORS: [Processor; 3] = [Processor::Intel, Processor::Dec, Processor::Mips];

/// How a take is written.
#[derive(Clone, Debug)]
pub struct C3dFile {
    /// One label per point; more than 255 go on in LABELS2, LABELS3, …
    pub labels: Vec<String>,
    /// Frame-major positions, `frames × labels`; `None` is written as zeros with a fourth value of −1.
    pub points: Vec<Option<[f32; 3]>>,
    pub rate: f32,
    pub first_frame: u32,
    /// POINT:UNITS; empty leaves the parameter out.
    pub unit: String,
    /// POINT:Y_SCREEN and X_SCREEN; empty leaves them out.
    pub up: String,
    pub right: String,
    pub processor: Processor,
    /// `Some(scale)` writes 16-bit integers in steps of `scale`, `None` floats.
    pub integers: Option<f32>,
    /// Lists of computed points: ("ANGLES", labels), …
    pub lists: Vec<(String, Vec<String>)>,
    /// SUBJECTS:NAMES.
    pub subjects: Vec<String>,
    /// Analog words behind the points of each frame; their values count up.
    pub analog: u16,
}

impl Default for C3dFile {
    fn default() -> Self {
        Self {
            labels: Vec::new(),
            points: Vec::new(),
            rate: 100.0,
            first_frame: 1,
            unit: "mm".into(),
            up: "+Z".into(),
            right: "+X".into(),
            processor: Processor::Intel,
            integers: None,
            lists: Vec::new(),
            subjects: Vec::new(),
            analog: 0,
        }
    }
}

const BLOCK: usize = 512;

impl C3dFile {
    pub fn frames(&self) -> usize {
        if self.labels.is_empty() { 0 } else { self.points.len() / self.labels.len() }
    }

    /// The bytes of the file.
    pub fn bytes(&self) -> Vec<u8> {
        let frames = self.frames();
        let first = u64::from(self.first_frame);
        let last = first + frames.max(1) as u64 - 1;
        let scale = self.integers.unwrap_or(-1.0);
        // The section's length does not depend on the number of the data block that it holds.
        let blocks = (self.parameters(0).len() + 4).div_ceil(BLOCK);
        let data_block = blocks + 2;

        let mut out = vec![0; BLOCK];
        out[0] = 2;
        out[1] = 0x50;
        let saturated = |n: u64| n.min(65_535) as u16;
        for (word, value) in [
            (2, self.labels.len() as u16),
            (3, self.analog),
            (4, saturated(first)),
            (5, saturated(last)),
            (6, 10),
            (9, data_block as u16),
            (10, u16::from(self.analog > 0)),
        ] {
            out[2 * word - 2..2 * word].copy_from_slice(&self.u16(value));
        }
        out[12..16].copy_from_slice(&self.f32(scale));
        out[20..24].copy_from_slice(&self.f32(self.rate));

        let code = match self.processor {
            Processor::Intel => 84,
            Processor::Dec => 85,
            Processor::Mips => 86,
        };
        out.extend([1, 0x50, blocks as u8, code]);
        out.extend(self.parameters(data_block as u16));
        out.resize(BLOCK * (1 + blocks), 0);

        for (i, point) in self.points.iter().enumerate() {
            self.point(&mut out, *point);
            if (i + 1) % self.labels.len() == 0 {
                for n in 0..self.analog {
                    self.value(&mut out, f32::from(n % 100));
                }
            }
        }
        out.resize(out.len().div_ceil(BLOCK) * BLOCK, 0);
        out
    }

    fn point(&self, out: &mut Vec<u8>, point: Option<[f32; 3]>) {
        let (p, mark) = point.map_or(([0.0; 3], -1.0), |p| (p, 1.0));
        let scale = self.integers.unwrap_or(1.0);
        for c in p {
            self.value(out, c / scale);
        }
        self.value(out, mark);
    }

    /// One word of the data section.
    fn value(&self, out: &mut Vec<u8>, value: f32) {
        if self.integers.is_some() {
            out.extend(self.u16(value.round() as i16 as u16));
        } else {
            out.extend(self.f32(value));
        }
    }

    fn parameters(&self, data_block: u16) -> Vec<u8> {
        let frames = self.frames();
        let last = u64::from(self.first_frame) + frames.max(1) as u64 - 1;
        let mut s = Section { file: self, bytes: Vec::new() };
        s.group(1, "POINT");
        s.integers(1, "USED", &[self.labels.len() as u16]);
        s.integers(1, "FRAMES", &[frames.min(65_535) as u16]);
        s.integers(1, "DATA_START", &[data_block]);
        s.real(1, "SCALE", self.integers.unwrap_or(-1.0));
        s.real(1, "RATE", self.rate);
        if frames > 65_535 {
            s.real(1, "LONG_FRAMES", frames as f32);
        }
        for (name, text) in [("UNITS", &self.unit), ("Y_SCREEN", &self.up), ("X_SCREEN", &self.right)] {
            if !text.is_empty() {
                s.texts(1, name, std::slice::from_ref(text));
            }
        }
        s.long_texts(1, "LABELS", &self.labels);
        for (name, labels) in &self.lists {
            s.long_texts(1, name, labels);
        }
        s.group(2, "TRIAL");
        let halves = |n: u64| [(n & 0xffff) as u16, (n >> 16) as u16];
        s.integers(2, "ACTUAL_START_FIELD", &halves(self.first_frame.into()));
        s.integers(2, "ACTUAL_END_FIELD", &halves(last));
        if !self.subjects.is_empty() {
            s.group(3, "SUBJECTS");
            s.integers(3, "USED", &[self.subjects.len() as u16]);
            s.texts(3, "NAMES", &self.subjects);
        }
        s.bytes.extend([0, 0]);
        s.bytes
    }

    fn u16(&self, value: u16) -> [u8; 2] {
        if self.processor == Processor::Mips { value.to_be_bytes() } else { value.to_le_bytes() }
    }

    fn f32(&self, value: f32) -> [u8; 4] {
        match self.processor {
            Processor::Intel => value.to_le_bytes(),
            Processor::Mips => value.to_be_bytes(),
            Processor::Dec => {
                // Exponent bias larger by 2, halves exchanged; zero has no exponent.
                let [a, b, c, d] = if value == 0.0 { [0; 4] } else { (value * 4.0).to_le_bytes() };
                [c, d, a, b]
            }
        }
    }
}

struct Section<'a> {
    file: &'a C3dFile,
    bytes: Vec<u8>,
}

impl Section<'_> {
    fn entry(&mut self, id: i8, name: &str, body: &[u8]) {
        self.bytes.push(name.len() as u8);
        self.bytes.push(id as u8);
        self.bytes.extend(name.as_bytes());
        // From the offset word itself to the next entry: the word, the body, the length of an empty description.
        let offset = self.file.u16((2 + body.len() + 1) as u16);
        self.bytes.extend(offset);
        self.bytes.extend(body);
        self.bytes.push(0);
    }

    fn group(&mut self, id: i8, name: &str) {
        self.entry(-id, name, &[]);
    }

    fn integers(&mut self, id: i8, name: &str, values: &[u16]) {
        let mut body = vec![2, u8::from(values.len() > 1)];
        if values.len() > 1 {
            body.push(values.len() as u8);
        }
        values.iter().for_each(|v| body.extend(self.file.u16(*v)));
        self.entry(id, name, &body);
    }

    fn real(&mut self, id: i8, name: &str, value: f32) {
        let mut body = vec![4, 0];
        body.extend(self.file.f32(value));
        self.entry(id, name, &body);
    }

    fn texts(&mut self, id: i8, name: &str, texts: &[String]) {
        let width = texts.iter().map(String::len).max().unwrap_or(0);
        let mut body = vec![-1i8 as u8, 2, width as u8, texts.len() as u8];
        for text in texts {
            body.extend(text.bytes());
            body.extend(std::iter::repeat_n(b' ', width - text.len()));
        }
        self.entry(id, name, &body);
    }

    fn long_texts(&mut self, id: i8, name: &str, texts: &[String]) {
        for (n, part) in texts.chunks(255).enumerate() {
            let name = if n == 0 { name.to_owned() } else { format!("{name}{}", n + 1) };
            self.texts(id, &name, part);
        }
    }
}
