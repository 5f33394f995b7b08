//! AMC: the numbers of every bone, frame by frame.

use super::asf::Bone;
use super::lines::lines;
use crate::capture::number;
use crate::error::{Error, Notes, Result};
use crate::words;
use std::collections::{BTreeSet, HashMap};

/// The motion as the file has it: nothing is filled in.
#[derive(Debug, Default)]
pub(super) struct Amc {
    /// Number of each frame, and its first entry.
    pub(super) frames: Vec<(i64, usize)>,
    /// Bone and its first value, in the order of the file.
    pub(super) entries: Vec<(usize, usize)>,
    /// Numbers of the bones; NaN where the file says so.
    pub(super) values: Vec<f64>,
    /// Whether angles are in radians, where the file says.
    pub(super) radians: Option<bool>,
    pub(super) notes: Notes,
}

impl Amc {
    /// The entries of a frame.
    pub(super) fn entries(&self, frame: usize) -> &[(usize, usize)] {
        let end = self.frames.get(frame + 1).map_or(self.entries.len(), |f| f.1);
        &self.entries[self.frames[frame].1..end]
    }
}

/// Reads a file for the bones of a skeleton.
///
/// # Errors
/// With the line: rows that are no frame number and no bone with its numbers, a bone twice in a frame.
pub(super) fn read(bytes: &[u8], bones: &[Bone]) -> Result<Amc> {
    let by_name: HashMap<&[u8], usize> = bones.iter().enumerate().map(|(n, b)| (b.name.as_bytes(), n)).collect();
    let mut amc = Amc::default();
    let mut unknown: BTreeSet<String> = BTreeSet::new();
    let mut seen = vec![usize::MAX; bones.len()];
    let mut cut = false;
    for line in lines(bytes) {
        let keyword = line.keyword();
        if keyword.starts_with(b":") {
            match keyword.as_slice() {
                b":degrees" => amc.radians = Some(false),
                b":radians" => amc.radians = Some(true),
                _ => {}
            }
            continue;
        }
        if line.words.len() == 1
            && let Some(frame) = std::str::from_utf8(line.words[0]).ok().and_then(|t| t.parse::<i64>().ok())
            && frame.unsigned_abs() <= number::LARGEST_FRAME
        {
            amc.frames.push((frame, amc.entries.len()));
            continue;
        }
        if amc.frames.is_empty() {
            return Err(line.error(format!("unexpected '{}'", line.shown())).expected("the number of the first frame"));
        }
        let frame = amc.frames.len() - 1;
        let Some(&bone) = by_name.get(line.words[0]) else {
            if line.words.len() > 1 && number::parse(line.words[0]).is_none() {
                // What is unknown is said once, and not all of it if there is much.
                if unknown.len() < 8 {
                    unknown.insert(line.text(0).chars().take(40).collect());
                }
                continue;
            }
            if line.open {
                cut = true;
                break;
            }
            return Err(line
                .error(format!("unexpected '{}'", line.shown()))
                .expected("a frame number, or a bone and its numbers"));
        };
        let wanted = bones[bone].freedoms.len();
        if line.words.len() - 1 != wanted {
            if line.open {
                cut = true;
                break;
            }
            let numbers = words::plural(line.words.len() - 1, "number");
            return Err(line
                .error(format!("bone '{}' has {numbers} in frame {}", bones[bone].name, amc.frames[frame].0))
                .expected(format!("{wanted}, one for every degree of freedom in the skeleton")));
        }
        if std::mem::replace(&mut seen[bone], frame) == frame {
            return Err(line.error(format!("bone '{}' is twice in frame {}", bones[bone].name, amc.frames[frame].0)));
        }
        amc.entries.push((bone, amc.values.len()));
        for word in &line.words[1..] {
            let value = number::parse(word)
                .ok_or_else(|| line.error(format!("unexpected '{}'", line.shown())).expected("a bone and its numbers"))?;
            amc.values.push(value);
        }
    }
    let Some(&(last, start)) = amc.frames.last() else {
        return Err(Error::malformed("there are no frames")
            .expected("an AMC motion: frame numbers, and under each the bones with their numbers"));
    };
    let usual = amc.entries(0).len();
    if amc.frames.len() > 1 && (cut || amc.entries.len() - start < usual / 2) {
        amc.notes.warn(format!("frame {last}, the last, is cut short: left out"));
        amc.entries.truncate(start);
        amc.frames.pop();
    }
    if !unknown.is_empty() {
        let names = unknown.into_iter().collect::<Vec<_>>().join(", ");
        amc.notes.warn(format!("bones that the skeleton does not have: {names}: left out"));
    }
    Ok(amc)
}
