//! When output is as a page shows it: `...` in a line stands for any text of a line, a line of `...` alone for any number of lines, and numbers with
//! decimals may be off by 5 %, since processors and small changes of the solver move them.

/// Numbers with decimals may be off by so much of themselves, or by one in the last place that is shown.
const SLACK: f64 = 0.05;

/// Whether `lines` are as `shown`; else the number of the shown line that nothing is like, as far as matching came.
pub fn compare(shown: &[&str], lines: &[&str]) -> Result<(), usize> {
    fn from(shown: &[&str], lines: &[&str], at: usize, reached: &mut usize) -> bool {
        *reached = (*reached).max(at);
        match (shown.split_first(), lines.split_first()) {
            (None, rest) => rest.is_none(),
            (Some((&"...", others)), rest) => {
                from(others, lines, at + 1, reached) || rest.is_some_and(|(_, rest)| from(shown, rest, at, reached))
            }
            (Some((wanted, others)), Some((line, rest))) => is_like(wanted, line) && from(others, rest, at + 1, reached),
            (Some(_), None) => false,
        }
    }
    let mut reached = 0;
    if from(shown, lines, 0, &mut reached) { Ok(()) } else { Err(reached) }
}

/// Whether a line is as shown.
pub fn is_like(shown: &str, line: &str) -> bool {
    let (shown, line) = (shown.trim_end(), line.trim_end());
    if let Some(rest) = shown.strip_prefix("...") {
        return line.char_indices().map(|(i, _)| i).chain([line.len()]).any(|i| is_like(rest, &line[i..]));
    }
    let (a, b) = (number(shown), number(line));
    if a > 0 && b > 0 {
        return same_number(&shown[..a], &line[..b]) && is_like(&shown[a..], &line[b..]);
    }
    match (shown.chars().next(), line.chars().next()) {
        (None, None) => true,
        (Some(a), Some(b)) if a == b => is_like(&shown[a.len_utf8()..], &line[b.len_utf8()..]),
        _ => false,
    }
}

/// A line of the program with how long a run took as `... s`.
pub fn without_seconds(line: &str) -> String {
    if !line.starts_with("done ") && !line.starts_with("take ") {
        return line.to_owned();
    }
    let mut words: Vec<&str> = line.split(' ').collect();
    for k in 1..words.len() {
        if ["s", "ms", "s,"].contains(&words[k]) && words[k - 1].parse::<f64>().is_ok() {
            words[k - 1] = "...";
        }
    }
    words.join(" ")
}

/// Length of the number that a text begins with.
fn number(text: &str) -> usize {
    let digits = |from: usize| text[from..].bytes().take_while(u8::is_ascii_digit).count();
    let whole = digits(0);
    if whole == 0 || !text[whole..].starts_with('.') {
        return whole;
    }
    match digits(whole + 1) {
        0 => whole,
        places => whole + 1 + places,
    }
}

fn same_number(shown: &str, found: &str) -> bool {
    if shown == found {
        return true;
    }
    // Counts are counts.
    let Some((_, places)) = shown.split_once('.') else { return false };
    let (Ok(a), Ok(b)) = (shown.parse::<f64>(), found.parse::<f64>()) else { return false };
    (a - b).abs() <= (a.abs() * SLACK).max(1.01 * 0.1_f64.powi(places.len() as i32))
}

#[test]
fn what_is_like_is_told_from_what_is_not() {
    for (shown, line) in [
        ("done ... s · 41 of 41", "done 2.6 s · 41 of 41"),
        ("median 1.00 mm", "median 1.04 mm"),
        ("0.1 %", "0.2 %"),
        ("...", ""),
        ("f_0001.ply  ", "f_0001.ply"),
        ("1–372 …", "1–372 …"),
    ] {
        assert!(is_like(shown, line), "{shown} and {line}");
    }
    for (shown, line) in [
        ("41 of 41", "40 of 41"),
        ("median 1.00 mm", "median 1.07 mm"),
        ("a ... c", "a b"),
        ("a", "ab"),
        ("5", "5.0"),
        ("x 1.5", "x y"),
    ] {
        assert!(!is_like(shown, line), "{shown} and {line}");
    }
    assert_eq!(compare(&["a", "...", "d"], &["a", "b", "c", "d"]), Ok(()));
    assert_eq!(compare(&["a", "..."], &["a"]), Ok(()));
    assert_eq!(compare(&["a", "b"], &["a", "c"]), Err(1));
    assert_eq!(compare(&["a"], &["a", "b"]), Err(1));
    assert_eq!(compare(&[], &["a"]), Err(0));
}
