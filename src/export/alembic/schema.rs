//! Objects, compounds and properties of Alembic as groups of the container, with the tables that name them.

use super::{Child, Ogawa, Times, digest};
use crate::error::Result;
use std::path::Path;

/// Version of the layout, and of the library whose layout it is.
const VERSIONS: [i32; 2] = [0, 10803];

/// Type of one element.
#[derive(Clone, Copy, Debug)]
pub(super) struct Type {
    /// Number of the plain type in Alembic's own list.
    pod: u32,
    /// How many of them.
    extent: u32,
    /// Bytes of an element.
    bytes: usize,
}

impl Type {
    pub(super) const BOOL: Self = Self { pod: 0, extent: 1, bytes: 1 };
    pub(super) const U32: Self = Self { pod: 5, extent: 1, bytes: 4 };
    pub(super) const I32: Self = Self { pod: 6, extent: 1, bytes: 4 };
    pub(super) const F2: Self = Self { pod: 10, extent: 2, bytes: 8 };
    pub(super) const F3: Self = Self { pod: 10, extent: 3, bytes: 12 };
    pub(super) const F4: Self = Self { pod: 10, extent: 4, bytes: 16 };
    pub(super) const BOX: Self = Self { pod: 11, extent: 6, bytes: 48 };
}

/// Whether samples are one element or arrays of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar = 1,
    Array = 2,
}

/// Samples of a property that are already in the file.
#[derive(Debug, Default)]
pub(super) struct Samples {
    data: Vec<Child>,
    /// Bytes of the last one.
    bytes: usize,
    /// Of all so far.
    digest: [u8; 16],
}

/// A property as the compound around it lists it.
#[derive(Debug)]
pub(super) struct Compound {
    entry: Vec<u8>,
    group: Child,
    digest: [u8; 16],
}

/// An object as the one around it lists it.
#[derive(Debug)]
pub(super) struct Object {
    entry: Vec<u8>,
    group: Child,
    digest: [u8; 16],
}

/// An archive that is being written.
#[derive(Debug)]
pub(super) struct Archive {
    file: Ogawa,
    versions: [Child; 2],
    /// Metadata that headers name by number, from 1.
    metadata: Vec<String>,
}

impl Archive {
    pub(super) fn create(path: &Path) -> Result<Self> {
        let mut file = Ogawa::create(path)?;
        let [layout, library] = VERSIONS.map(i32::to_le_bytes);
        let versions = [file.data(&[&layout])?, file.data(&[&library])?];
        Ok(Self { file, versions, metadata: Vec::new() })
    }

    /// Appends a sample, with its key before it.
    pub(super) fn sample(&mut self, samples: &mut Samples, bytes: &[u8]) -> Result<()> {
        let key = digest(bytes);
        samples.data.push(self.file.data(&[&key, bytes])?);
        samples.bytes = bytes.len();
        samples.digest = digest(&[samples.digest, key].concat());
        Ok(())
    }

    /// The one sample of a property that does not change.
    pub(super) fn constant(&mut self, bytes: &[u8]) -> Result<Samples> {
        let mut samples = Samples::default();
        self.sample(&mut samples, bytes)?;
        Ok(samples)
    }

    /// A property of so many samples at the times of a time sampling. Either each has its data, or all have those of the first.
    pub(super) fn property(
        &mut self,
        name: &str,
        of: Type,
        metadata: &str,
        (count, times): (u32, u32),
        kind: Kind,
        samples: Samples,
    ) -> Result<Compound> {
        assert!(samples.data.len() == 1 || samples.data.len() == count as usize, "one sample, or one for every time");
        let constant = samples.data.len() == 1;
        let children = samples.data.iter().flat_map(|&data| match kind {
            Kind::Scalar => vec![data],
            // The dimensions follow from the size.
            Kind::Array => vec![data, Child::EMPTY_DATA],
        });
        let group = self.file.group(&children.collect::<Vec<_>>())?;
        // Samples of one size; arrays of one element are told apart.
        let mut info = kind as u32 | of.pod << 4 | 0x400 | of.extent << 12;
        if kind == Kind::Array && samples.bytes == of.bytes {
            info |= 1;
        }
        if constant {
            info |= 0x800;
        }
        let mut numbers = vec![count];
        if times != 0 {
            info |= 0x100;
            numbers.push(times);
        }
        let entry = self.entry(name, info, &numbers, metadata);
        let digest = digest(&[&entry[..], &samples.digest].concat());
        Ok(Compound { entry, group, digest })
    }

    /// A compound of properties.
    pub(super) fn compound(&mut self, name: &str, metadata: &str, properties: Vec<Compound>) -> Result<Compound> {
        let (group, content) = self.properties(properties)?;
        let entry = self.entry(name, 0, &[], metadata);
        let digest = digest(&[&entry[..], &content].concat());
        Ok(Compound { entry, group, digest })
    }

    /// The group of properties, with the table of their headers at its end.
    fn properties(&mut self, properties: Vec<Compound>) -> Result<(Child, [u8; 16])> {
        let mut children: Vec<Child> = properties.iter().map(|p| p.group).collect();
        let table: Vec<u8> = properties.iter().flat_map(|p| p.entry.iter().copied()).collect();
        let digests: Vec<u8> = properties.iter().flat_map(|p| p.digest).collect();
        if !table.is_empty() {
            children.push(self.file.data(&[&table])?);
        }
        Ok((self.file.group(&children)?, digest(&digests)))
    }

    /// An object with its properties and the objects below it.
    pub(super) fn object(
        &mut self,
        name: &str,
        schema: &str,
        title: &str,
        properties: Vec<Compound>,
        below: Vec<Object>,
    ) -> Result<Object> {
        let (group, digest) = self.content(properties, below)?;
        let mut entry = (name.len() as u32).to_le_bytes().to_vec();
        entry.extend(name.bytes());
        entry.push(self.metadata(&format!("{schema};schemaObjTitle={title}")) as u8);
        Ok(Object { entry, group, digest })
    }

    /// The group of an object: properties, objects below, and the table of these with two digests.
    fn content(&mut self, properties: Vec<Compound>, below: Vec<Object>) -> Result<(Child, [u8; 16])> {
        let (properties, own) = self.properties(properties)?;
        let mut children = vec![properties];
        children.extend(below.iter().map(|o| o.group));
        let mut table: Vec<u8> = below.iter().flat_map(|o| o.entry.iter().copied()).collect();
        let digests: Vec<u8> = below.iter().flat_map(|o| [&o.entry[..], &o.digest].concat()).collect();
        let of_children = if below.is_empty() { [0; 16] } else { digest(&digests) };
        table.extend([own, of_children].concat());
        children.push(self.file.data(&[&table])?);
        Ok((self.file.group(&children)?, digest(&[own, of_children].concat())))
    }

    /// Header of a property. `info`: its bits but for sizes and metadata. `numbers` stand before the name.
    fn entry(&mut self, name: &str, info: u32, numbers: &[u32], metadata: &str) -> Vec<u8> {
        let largest = numbers.iter().copied().chain([name.len() as u32, metadata.len() as u32]).max().unwrap_or(0);
        let (hint, width) = match largest {
            0..=0xFF => (0, 1),
            0x100..=0xFFFF => (1, 2),
            _ => (2, 4),
        };
        let mut entry = (info | hint << 2 | self.metadata(metadata) << 20).to_le_bytes().to_vec();
        for number in numbers.iter().copied().chain([name.len() as u32]) {
            entry.extend(&number.to_le_bytes()[..width]);
        }
        entry.extend(name.bytes());
        entry
    }

    /// Number of a metadata text. All of ours are short and few, as the table demands.
    fn metadata(&mut self, text: &str) -> u32 {
        if text.is_empty() {
            return 0;
        }
        let known = self.metadata.iter().position(|known| known == text);
        let index = known.unwrap_or_else(|| {
            assert!(text.len() < 256 && self.metadata.len() < 254, "metadata that the table can hold");
            self.metadata.push(text.to_owned());
            self.metadata.len() - 1
        });
        index as u32 + 1
    }

    /// Writes the top object with the one below it, metadata, times and the table of metadata, and closes the container.
    pub(super) fn close(&mut self, description: &str, below: Object, times: Times) -> Result<()> {
        let (top, _) = self.content(Vec::new(), vec![below])?;
        let description = self.file.data(&[description.as_bytes()])?;
        // Of each time sampling: samples, seconds per cycle, times in a cycle, these.
        let mut samplings = Vec::new();
        for (samples, period, start) in [(1, 1.0, 0.0), (times.frames as u32, 1.0 / times.rate, times.first)] {
            samplings.extend(samples.to_le_bytes());
            samplings.extend(f64::to_le_bytes(period));
            samplings.extend(1u32.to_le_bytes());
            samplings.extend(f64::to_le_bytes(start));
        }
        let samplings = self.file.data(&[&samplings])?;
        let table: Vec<u8> = self.metadata.iter().flat_map(|m| [&[m.len() as u8][..], m.as_bytes()].concat()).collect();
        let table = self.file.data(&[&table])?;
        let [layout, library] = self.versions;
        let root = self.file.group(&[layout, library, top, description, samplings, table])?;
        self.file.close(root)
    }

    /// Puts the file in place of the target; returns its size in bytes.
    pub(super) fn finish(self) -> Result<u64> {
        self.file.finish()
    }
}
