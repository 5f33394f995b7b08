//! A C3D file whose frames come again and again.

/// How the frames come again.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Again {
    /// From the first on: the body jumps back.
    FromTheStart,
    /// Backwards and forwards in turn, so that nothing jumps.
    ThereAndBack,
}

/// The frames of a little-endian capture `times` over: the data section repeated, the counts in header and parameters raised.
pub(crate) fn repeated(bytes: &[u8], times: usize, again: Again) -> Vec<u8> {
    let word = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
    let (points, analog, first, last, start) = (word(2), word(4), word(6), word(8), word(16));
    let real = f32::from_le_bytes(bytes[12..16].try_into().unwrap()) < 0.0;
    let frame = (points * 4 + analog) * if real { 4 } else { 2 };
    let frames = last - first + 1;
    let begin = (start - 1) * 512;

    let mut out = bytes[..begin].to_vec();
    let mut put = |at: usize, value: usize| out[at..at + 2].copy_from_slice(&(value as u16).to_le_bytes());
    put(8, first + frames * times - 1);
    for (name, value) in [(&b"FRAMES"[..], frames * times), (b"ACTUAL_END_FIELD", first + frames * times - 1)] {
        // Behind the name: the offset to the next entry, the type, the count of dimensions, the dimensions, the value.
        let at = bytes[..begin].windows(name.len()).position(|w| w == name).unwrap() + name.len();
        assert_eq!(bytes[at + 2], 2, "a 16-bit parameter");
        put(at + 4 + usize::from(bytes[at + 3]), value);
    }
    let data = &bytes[begin..begin + frames * frame];
    for time in 0..times {
        if again == Again::ThereAndBack && time % 2 == 1 {
            data.rchunks_exact(frame).for_each(|f| out.extend(f));
        } else {
            out.extend(data);
        }
    }
    out.resize(out.len().div_ceil(512) * 512, 0);
    out
}
