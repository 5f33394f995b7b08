//! The first half of a BVH file: joints, offsets and channels.

use super::text::Text;
use crate::error::Result;
use glam::DVec3;

/// Longest name of a joint, in bytes; more is no name.
const LONGEST_NAME: usize = 255;

/// One column of numbers in the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    /// Place along an axis.
    Position(usize),
    /// Turn about an axis, in degrees.
    Rotation(usize),
    /// Size along an axis.
    Scale(usize),
}

/// A joint as the file has it.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) name: String,
    pub(super) parent: Option<usize>,
    pub(super) offset: DVec3,
    /// Its channels, in the order in which their numbers stand in a row.
    pub(super) channels: Vec<Channel>,
    /// The column of the first of them.
    pub(super) column: usize,
    /// Whether it is an end site.
    pub(super) end: bool,
}

/// The joints, parents before children, and the number of columns of a row.
#[derive(Debug)]
pub(super) struct Hierarchy {
    pub(super) nodes: Vec<Node>,
    pub(super) columns: usize,
}

/// A joint whose braces are open.
struct Open {
    node: usize,
    /// Whether its `{` was seen.
    entered: bool,
    offset: bool,
    channels: bool,
}

/// Reads up to the word `MOTION`.
///
/// # Errors
/// With the line: anything that is not BVH, braces that do not match, channels that do not match their count, offsets that are no numbers.
pub(super) fn read(text: &mut Text<'_>) -> Result<Hierarchy> {
    let mut nodes: Vec<Node> = Vec::new();
    let mut columns = 0;
    let mut open: Vec<Open> = Vec::new();
    loop {
        let Some(word) = text.word() else {
            let found = if nodes.is_empty() { "there is no joint" } else { "the hierarchy ends without the word MOTION" };
            return Err(text.error(found).expected("a BVH file: HIERARCHY, joints in braces, MOTION, rows of numbers"));
        };
        let keyword = word.to_ascii_uppercase();
        match (keyword.as_slice(), open.last_mut()) {
            (b"HIERARCHY", None) if nodes.is_empty() => {}
            (b"MOTION", None) if !nodes.is_empty() => return Ok(Hierarchy { nodes, columns }),
            (b"MOTION", Some(last)) => {
                let name = &nodes[last.node].name;
                return Err(text.error(format!("MOTION comes before joint '{name}' is closed")).expected("a } for every {"));
            }
            (b"{", Some(last)) if !last.entered => last.entered = true,
            (b"}", Some(last)) if last.entered => {
                if !last.offset {
                    let name = &nodes[last.node].name;
                    return Err(text.error(format!("joint '{name}' has no OFFSET")));
                }
                open.pop();
            }
            (b"ROOT", None) | (b"JOINT", _) | (b"END" | b"ENDSITE", Some(_)) => {
                if let Some(parent) = open.last().filter(|p| !p.entered || nodes[p.node].end) {
                    let name = &nodes[parent.node].name;
                    return Err(text.error(format!("a joint begins inside of '{name}', which is not open")));
                }
                let end = keyword.starts_with(b"END");
                let name = text.name();
                if name.len() > LONGEST_NAME {
                    return Err(text.error(format!("a name of {} bytes", name.len())));
                }
                let parent = open.last().map(|p| p.node);
                open.push(Open { node: nodes.len(), entered: false, offset: false, channels: false });
                nodes.push(Node { name, parent, offset: DVec3::ZERO, channels: Vec::new(), column: columns, end });
            }
            (b"OFFSET", Some(last)) if last.entered && !last.offset => {
                last.offset = true;
                nodes[last.node].offset = offset(text)?;
            }
            (b"CHANNELS", Some(last)) if last.entered && !last.channels => {
                last.channels = true;
                let node = &mut nodes[last.node];
                (node.channels, node.column) = (channels(text)?, columns);
                columns += node.channels.len();
            }
            _ => {
                return Err(text
                    .unexpected(word)
                    .expected("HIERARCHY, ROOT, JOINT, End Site, OFFSET, CHANNELS, braces or MOTION"));
            }
        }
    }
}

fn offset(text: &mut Text<'_>) -> Result<DVec3> {
    let mut offset = DVec3::ZERO;
    for axis in 0..3 {
        let word = text.word().unwrap_or_default();
        offset[axis] = super::number(word)
            .filter(|x| x.is_finite())
            .ok_or_else(|| text.unexpected(word).expected("the three numbers of an OFFSET"))?;
    }
    Ok(offset)
}

fn channels(text: &mut Text<'_>) -> Result<Vec<Channel>> {
    let word = text.word().unwrap_or_default();
    let wanted: usize = std::str::from_utf8(word)
        .ok()
        .and_then(|t| t.parse().ok())
        .ok_or_else(|| text.unexpected(word).expected("the number of CHANNELS"))?;
    let mut channels = Vec::new();
    while let Some(channel) = text.peek().and_then(channel) {
        text.word();
        channels.push(channel);
    }
    if channels.len() == wanted {
        return Ok(channels);
    }
    let next = text.peek().unwrap_or_default().to_owned();
    let found = format!("CHANNELS says {wanted}, {} are named", channels.len());
    let after = String::from_utf8_lossy(&next[..next.len().min(40)]).into_owned();
    Err(text.error(found).expected(format!("{wanted} names such as Xposition or Zrotation (then comes '{after}')")))
}

/// `Xposition`, `zrotation`, `Y_translation` …
fn channel(word: &[u8]) -> Option<Channel> {
    let lower = word.to_ascii_lowercase();
    let axis = usize::from(lower.first()?.checked_sub(b'x')?);
    let what = lower[1..].trim_ascii_start();
    let what = what.strip_prefix(b"_").unwrap_or(what);
    match what {
        _ if axis > 2 => None,
        b"position" | b"translation" | b"pos" => Some(Channel::Position(axis)),
        b"rotation" | b"rot" => Some(Channel::Rotation(axis)),
        b"scale" | b"scaling" => Some(Channel::Scale(axis)),
        _ => None,
    }
}
