//! Numbers, lengths and times as a person reads them.

use std::collections::{HashMap, HashSet};
use std::path::Path;

/// `214878` → `214,878`.
pub(crate) fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

/// `plural(1, "marker")` → `1 marker`, `plural(3, "marker")` → `3 markers`.
pub(crate) fn plural(n: usize, noun: &str) -> String {
    let tail = if n == 1 {
        ""
    } else if noun.ends_with('x') || noun.ends_with("sh") {
        "es"
    } else {
        "s"
    };
    let stem = if n != 1 && noun.ends_with("vertex") { noun.trim_end_matches("ex").to_owned() + "ic" } else { noun.to_owned() };
    format!("{} {stem}{tail}", count(n))
}

/// Three significant digits, no exponent: `0.412`, `9.06`, `123`.
pub(crate) fn digits(x: f64) -> String {
    let magnitude = if x == 0.0 { 0 } else { x.abs().log10().floor() as i32 };
    let decimals = (2 - magnitude).clamp(0, 6) as usize;
    let text = format!("{x:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A length in metres, in the unit that a person would say: `0.4 mm`, `31 mm`, `1.78 m`.
pub(crate) fn length(metres: f64) -> String {
    if metres.abs() < 1.0 { format!("{} mm", digits(metres * 1000.0)) } else { format!("{metres:.2} m") }
}

/// A duration: `4.9 s`, `2 min 05 s`.
pub(crate) fn seconds(s: f64) -> String {
    let whole = s.round() as u64;
    if s < 59.95 { format!("{s:.1} s") } else { format!("{} min {:02} s", whole / 60, whole % 60) }
}

/// A short duration: `8 ms`, `0.94 s`, `12.3 s`.
pub(crate) fn seconds_short(s: f64) -> String {
    if s < 0.1 { format!("{:.0} ms", s * 1000.0) } else { format!("{} s", digits(s)) }
}

/// A size in bytes: `11 MB`, `512 kB`.
pub(crate) fn bytes(n: u64) -> String {
    match n {
        0..1_000 => format!("{n} B"),
        1_000..1_000_000 => format!("{} kB", digits(n as f64 / 1e3)),
        1_000_000..1_000_000_000 => format!("{} MB", digits(n as f64 / 1e6)),
        _ => format!("{} GB", digits(n as f64 / 1e9)),
    }
}

/// Makes names unique: later ones of a kind get `#2`, `#3` …; empty ones become `noun 7`. Returns how many were changed.
pub(crate) fn unique<'a>(names: impl Iterator<Item = &'a mut String>, noun: &str) -> usize {
    let mut taken: HashSet<String> = HashSet::new();
    let mut next: HashMap<String, usize> = HashMap::new();
    let mut changed = 0;
    for (n, name) in names.enumerate() {
        if name.is_empty() {
            *name = format!("{noun} {}", n + 1);
        }
        if taken.insert(name.clone()) {
            continue;
        }
        let count = next.entry(name.clone()).or_insert(2);
        let free = loop {
            let tried = format!("{name}#{count}");
            *count += 1;
            if !taken.contains(&tried) {
                break tried;
            }
        };
        taken.insert(free.clone());
        *name = free;
        changed += 1;
    }
    changed
}

/// The last part of a path.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(count(7), "7");
        assert_eq!(count(214_878), "214,878");
        assert_eq!(count(1_000_000), "1,000,000");
        assert_eq!(plural(1, "vertex"), "1 vertex");
        assert_eq!(plural(3512, "vertex"), "3,512 vertices");
        assert_eq!(plural(2, "marker"), "2 markers");
        assert_eq!(digits(0.4123), "0.412");
        assert_eq!(digits(9.0), "9");
        assert_eq!(digits(1234.5), "1234");
        assert_eq!(length(0.0312), "31.2 mm");
        assert_eq!(length(1.776), "1.78 m");
        assert_eq!((seconds_short(0.0083), seconds_short(0.94)), ("8 ms".into(), "0.94 s".into()));
        assert_eq!(seconds(125.0), "2 min 05 s");
        assert_eq!(seconds(119.7), "2 min 00 s");
        assert_eq!(bytes(11_400_000), "11.4 MB");
    }

    #[test]
    fn names_become_unique() {
        let mut names = ["a", "b", "a", "a#2", "", "a", "b"].map(str::to_owned);
        assert_eq!(unique(names.iter_mut(), "joint"), 4);
        assert_eq!(names, ["a", "b", "a#2", "a#2#2", "joint 5", "a#3", "b#2"]);
    }
}
