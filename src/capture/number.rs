//! Decimal numbers in the text of captures, read exactly and fast.

/// Powers of ten that `f64` holds exactly.
const EXACT: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21,
    1e22,
];

/// Largest number of a frame, either way, that is one and not damage.
pub(super) const LARGEST_FRAME: u64 = 1_000_000_000_000;

/// The number that a word is: the `f64` nearest to it.
///
/// Accepts what people's files hold: `.5`, `5.`, `+5`, `1e-05`, `1.5E+003`, a decimal comma, and the spellings of "not a number" and
/// "infinite", which both give NaN. `None` for anything else.
///
/// Up to 19 digits and small exponents take a short way that is exact: a mantissa below 2⁵³ times or over a power of ten that `f64`
/// holds exactly is rounded once (Clinger 1990, "How to read floating point numbers accurately").
pub(super) fn parse(word: &[u8]) -> Option<f64> {
    let (negative, digits) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    };
    let (mut mantissa, mut places, mut seen, mut at) = (0u64, 0usize, 0usize, 0);
    while let Some(&[d @ b'0'..=b'9']) = digits.get(at..at + 1) {
        mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(d - b'0'));
        (seen, at) = (seen + 1, at + 1);
    }
    if digits.get(at) == Some(&b'.') {
        at += 1;
        let start = at;
        while let Some(&[d @ b'0'..=b'9']) = digits.get(at..at + 1) {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(d - b'0'));
            at += 1;
        }
        places = at - start;
        seen += places;
    }
    if at < digits.len() || seen == 0 || seen > 19 || mantissa >= 1 << 53 || places > 22 {
        return slowly(word);
    }
    let value = mantissa as f64 / EXACT[places];
    Some(if negative { -value } else { value })
}

#[cold]
fn slowly(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    let unsigned = text.trim_start_matches(['-', '+']);
    let lower = unsigned.to_ascii_lowercase();
    if ["nan", "inf", "1.#", "#"].iter().any(|s| lower.starts_with(s)) {
        return Some(f64::NAN);
    }
    if !unsigned.starts_with(|c: char| c.is_ascii_digit() || c == '.' || c == ',') {
        return None;
    }
    let number = match text.matches(',').count() {
        0 => text.parse().ok(),
        1 if !text.contains('.') => text.replace(',', ".").parse().ok(),
        _ => None,
    };
    // A number too large for `f64` is as good as none.
    number.map(|x: f64| if x.is_finite() { x } else { f64::NAN })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        let mut state = 1u64;
        for k in 0..20_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let value = ((state >> 11) as f64 / 2f64.powi(30) - 4e6) * 10f64.powi((k % 9) - 4);
            let text = match k % 4 {
                0 => format!("{value:.6}"),
                1 => format!("{value}"),
                2 => format!("{value:e}"),
                _ => format!("+{:.0}.", value.abs()),
            };
            assert_eq!(parse(text.as_bytes()).unwrap().to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
        }
        for text in [
            ".0083333",
            "5.",
            "-0",
            "1e-05",
            "9007199254740993",
            "0.00000000000000000000000123",
            "1.5E+003",
            "12345678901234567890",
        ] {
            assert_eq!(parse(text.as_bytes()).unwrap().to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
        }
    }

    #[test]
    fn other_spellings() {
        assert_eq!(parse(b"-0,1728"), Some(-0.1728));
        for text in ["nan", "-NaN", "1.#QNAN", "-1.#IND", "1.#INF", "inf", "-Infinity", "1e999"] {
            assert!(parse(text.as_bytes()).unwrap().is_nan(), "{text}");
        }
        for text in ["", "-", ".", "+-3", "1.2.3", "1,2,3", "12x", "e5", "0x10", "\u{fffd}", "1 2"] {
            assert_eq!(parse(text.as_bytes()), None, "{text}");
        }
    }
}
