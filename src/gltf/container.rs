//! The GLB container, data URIs and external buffers.

use super::Files;
use super::document::BufferEntry;
use crate::error::{Error, Kind, Result};

const JSON: &[u8; 4] = b"JSON";
const BIN: &[u8; 4] = b"BIN\0";

/// The bytes of a buffer, or why they are not there.
#[derive(Debug)]
pub(super) enum Buffer {
    /// Its bytes.
    Loaded(Vec<u8>),
    /// The same bytes as an earlier buffer.
    Same(usize),
    /// Why it cannot be had.
    Missing(Error),
}

impl Buffer {
    /// Bytes that it holds itself.
    pub(super) fn len(&self) -> usize {
        match self {
            Buffer::Loaded(bytes) => bytes.len(),
            _ => 0,
        }
    }
}

/// Whether the file begins like a GLB file.
pub(crate) fn is_binary(bytes: &[u8]) -> bool {
    bytes.starts_with(b"glTF")
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

/// The JSON of the file and, for GLB, its binary chunk.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    if !is_binary(bytes) {
        return Ok((bytes, None));
    }
    let cut = || Error::malformed("the GLB file is cut short").expected("a complete file").hint("copy it again");
    let (Some(version), Some(length)) = (word(bytes, 4), word(bytes, 8)) else { return Err(cut()) };
    if version != 2 {
        return Err(Error::new(Kind::Unsupported, format!("is a GLB file of version {version}"))
            .expected("glTF 2.0")
            .hint("convert it with a current exporter"));
    }
    let length = length as usize;
    if length > bytes.len() {
        return Err(cut().at(format!("byte {}: the head announces {length}", bytes.len())));
    }
    // What follows the announced length belongs to no chunk.
    let bytes = &bytes[..length];
    let (mut json, mut binary) = (None, None);
    let mut at = 12;
    while let (Some(size), Some(kind)) = (word(bytes, at), bytes.get(at + 4..at + 8)) {
        let Some(chunk) = bytes[at + 8..].get(..size as usize) else {
            return Err(Error::malformed(format!("a chunk of {size} bytes, where {} are left", bytes.len() - at - 8))
                .at(format!("byte {at}"))
                .expected("a complete GLB file"));
        };
        match kind {
            kind if kind == JSON && json.is_none() => json = Some(chunk),
            kind if kind == BIN && binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        // Chunks begin at multiples of 4; some writers leave the padding out of the length.
        at += 8 + (size as usize).next_multiple_of(4);
    }
    let json = json.ok_or_else(|| Error::malformed("the GLB file has no JSON chunk").at("byte 12"))?;
    Ok((json, binary))
}

/// Loads all buffers; each file once.
pub(super) fn load(entries: &[BufferEntry], binary: Option<&[u8]>, files: &Files<'_>) -> Vec<Buffer> {
    let mut binary = binary;
    let mut known: std::collections::HashMap<String, usize> = std::collections::HashMap::new();
    let mut load = |(k, entry): (usize, &BufferEntry)| -> Result<Buffer> {
        let Some(uri) = entry.uri.as_deref() else {
            let bytes = if k == 0 { binary.take() } else { None };
            return bytes.map(|b| Buffer::Loaded(b.to_vec())).ok_or_else(|| Error::malformed(format!("buffer {k} has no data")));
        };
        if let Some(bytes) = data_uri(uri) {
            return Ok(Buffer::Loaded(bytes.map_err(|e| e.at(format!("buffer {k}")))?));
        }
        let file = relative(uri)?;
        if let Some(&first) = known.get(&file) {
            return Ok(Buffer::Same(first));
        }
        let bytes = files(&file)?;
        known.insert(file, k);
        Ok(Buffer::Loaded(bytes))
    };
    entries.iter().enumerate().map(|item| load(item).unwrap_or_else(Buffer::Missing)).collect()
}

/// The relative path that a URI means.
pub(super) fn relative(uri: &str) -> Result<String> {
    let has_scheme =
        uri.split_once(':').is_some_and(|(scheme, _)| scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphanumeric()));
    if has_scheme && !uri.starts_with("file:") {
        let shown: String = uri.chars().take(60).collect();
        return Err(Error::new(Kind::Unsupported, format!("'{}' is not a file beside the document", shown.escape_debug()))
            .hint("download it, or pack everything into a GLB file"));
    }
    let path = uri.strip_prefix("file://").or_else(|| uri.strip_prefix("file:")).unwrap_or(uri);
    Ok(String::from_utf8(unescape(path)).unwrap_or_else(|_| path.to_owned()))
}

/// Percent escapes decoded; a lone percent sign stays.
fn unescape(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let hex = bytes.get(at + 1..at + 3).filter(|h| bytes[at] == b'%' && h.iter().all(u8::is_ascii_hexdigit));
        let value = hex.and_then(|h| u8::from_str_radix(std::str::from_utf8(h).ok()?, 16).ok());
        out.push(value.unwrap_or(bytes[at]));
        at += if value.is_some() { 3 } else { 1 };
    }
    out
}

/// The bytes of a `data:` URI of any media type; `None` for any other URI.
pub(super) fn data_uri(uri: &str) -> Option<Result<Vec<u8>>> {
    let rest = uri.get(..5).filter(|s| s.eq_ignore_ascii_case("data:")).map(|_| &uri[5..])?;
    let Some((head, data)) = rest.split_once(',') else {
        return Some(Err(Error::malformed("a data URI without data")));
    };
    if !head.to_ascii_lowercase().ends_with(";base64") {
        return Some(Ok(unescape(data)));
    }
    Some(base64(data.as_bytes()).ok_or_else(|| Error::malformed("a data URI with damaged base64 data")))
}

/// Base64 (RFC 4648) in the common or the URL alphabet, with or without padding; white space is passed over.
fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut bits, mut count) = (0u32, 0);
    let mut ended = false;
    for &b in text {
        let value = match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => {
                ended = true;
                continue;
            }
            b' ' | b'\t' | b'\r' | b'\n' => continue,
            _ => return None,
        };
        if ended {
            return None;
        }
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push((bits >> count) as u8);
        }
    }
    // A single letter in the last group is no byte.
    (count != 6).then_some(out)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn base64_of_the_standard() {
        for (text, plain) in
            [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg", "foob"), ("Zm9v\r\nYmE=", "fooba")]
        {
            assert_eq!(base64(text.as_bytes()).unwrap(), plain.as_bytes());
        }
        assert_eq!(base64(b"-_+/").unwrap(), [0xfb, 0xff, 0xbf]);
        assert!(base64(b"Zg==Zg").is_none() && base64(b"Z").is_none() && base64(b"Zm9v*").is_none());
    }

    #[test]
    fn uris_are_data_or_files() {
        assert_eq!(data_uri("DATA:application/gltf-buffer;base64,Zm8=").unwrap().unwrap(), b"fo");
        assert_eq!(data_uri("data:,a%20b%fF%").unwrap().unwrap(), b"a b\xff%");
        assert!(data_uri("data:application/octet-stream;base64").unwrap().is_err());
        assert!(data_uri("file.bin").is_none());
        assert_eq!(relative("a%20b/c%C3%A4.bin").unwrap(), "a b/c\u{e4}.bin");
        assert_eq!(relative("100%.bin").unwrap(), "100%.bin");
        assert_eq!(relative("C:\\x.bin").unwrap(), "C:\\x.bin");
        assert_eq!(relative("https://a.b/c.bin").unwrap_err().kind, Kind::Unsupported);
    }
}
