//! What a page shows made anew from what was printed: lines that are like the shown ones stay as they are, and `...` stays wherever the lines around it
//! tell its place.

use crate::likeness::{is_like, without_seconds};

/// The lines to show. A line of `...` alone goes on standing for what is printed between its neighbours.
pub fn renewed(shown: &[&str], printed: &[&str]) -> Vec<String> {
    let (mut out, mut from) = (Vec::new(), (0, 0));
    for pair in common(shown, printed).into_iter().chain([(shown.len(), printed.len())]) {
        between(&shown[from.0..pair.0], &printed[from.1..pair.1], &mut out);
        if let Some(line) = shown.get(pair.0) {
            out.push((*line).to_owned());
        }
        from = (pair.0 + 1, pair.1 + 1);
    }
    out
}

/// The longest sequence of shown lines that are like printed ones, as pairs of their numbers.
fn common(shown: &[&str], printed: &[&str]) -> Vec<(usize, usize)> {
    let like = |i: usize, k: usize| shown[i] != "..." && is_like(&without_seconds(shown[i]), &without_seconds(printed[k]));
    let mut longest = vec![vec![0; printed.len() + 1]; shown.len() + 1];
    for i in (0..shown.len()).rev() {
        for k in (0..printed.len()).rev() {
            let with = if like(i, k) { 1 + longest[i + 1][k + 1] } else { 0 };
            longest[i][k] = with.max(longest[i + 1][k]).max(longest[i][k + 1]);
        }
    }
    let (mut pairs, mut i, mut k) = (Vec::new(), 0, 0);
    while i < shown.len() && k < printed.len() {
        if like(i, k) && longest[i][k] == 1 + longest[i + 1][k + 1] {
            pairs.push((i, k));
            (i, k) = (i + 1, k + 1);
        } else if longest[i + 1][k] == longest[i][k] {
            i += 1;
        } else {
            k += 1;
        }
    }
    pairs
}

/// Shown lines of which none is like a printed one: as many as stand before `...` are the first printed ones, as many as stand after it the last.
fn between(shown: &[&str], printed: &[&str], out: &mut Vec<String>) {
    let dots = |line: &&str| *line == "...";
    let mut line = |old: Option<&&str>, new: &str| out.push(old.map_or_else(|| without_seconds(new), |old| with_dots(old, new)));
    let Some(head) = shown.iter().position(dots) else {
        printed.iter().enumerate().for_each(|(k, new)| line(shown.get(k), new));
        return;
    };
    let tail = shown.len() - 1 - shown.iter().rposition(dots).unwrap();
    let head = head.min(printed.len());
    let tail = tail.min(printed.len() - head);
    printed[..head].iter().zip(shown).for_each(|(new, old)| line(Some(old), new));
    line(None, "...");
    let last = |lines: &[&str]| lines.len() - tail;
    printed[last(printed)..].iter().zip(&shown[last(shown)..]).for_each(|(new, old)| line(Some(old), new));
}

/// A printed line, with the words between those that stand around `...` in the old one as `...` again.
fn with_dots(old: &str, new: &str) -> String {
    let new = without_seconds(new);
    let (old, new): (Vec<&str>, Vec<&str>) = (old.split(' ').collect(), new.split(' ').collect());
    let (mut out, mut at) = (Vec::new(), 0);
    for (k, (prefix, suffix)) in old.iter().enumerate().filter_map(|(k, word)| Some((k, word.split_once("...")?))) {
        let begin = match k.checked_sub(1) {
            None => Some(0),
            Some(before) => new[at..].iter().position(|word| *word == old[before]).map(|n| at + n + 1),
        };
        let end = begin.and_then(|begin| match old.get(k + 1) {
            None => Some(new.len()),
            Some(after) => new[begin..].iter().position(|word| word == after).map(|n| begin + n),
        });
        if let (Some(begin), Some(end)) = (begin, end)
            && begin < end
            && new[begin].starts_with(prefix)
            && new[end - 1].ends_with(suffix)
        {
            out.extend_from_slice(&new[at..begin]);
            out.push(old[k]);
            at = end;
        }
    }
    out.extend_from_slice(&new[at..]);
    out.join(" ")
}

#[test]
fn placeholders_outlive_a_change_of_the_lines_around_them() {
    let shown = ["scan  a.obj  5 vertices", "...", "write  a.glb", "done ... s · 41 of 41 · rms ..."];
    let printed = ["scan  a.obj  6 vertices", "bind  x", "solve  y", "write  a.glb", "done 2.6 s · 40 of 41 · rms 3 mm"];
    assert_eq!(renewed(&shown, &printed), ["scan  a.obj  6 vertices", "...", "write  a.glb", "done ... s · 40 of 41 · rms ..."]);
    // Lines that are as shown keep their own words, also where others come and go.
    assert_eq!(renewed(&["a 1.00", "b", "c ... d"], &["a 1.02", "new", "c x y d", "e"]), ["a 1.00", "new", "c ... d", "e"]);
    assert_eq!(
        renewed(&["worst 1 (LFWT, frame ...) of ..."], &["worst 2 (RTOE, frame 309) of 400"]),
        ["worst 2 (RTOE, frame ...) of ..."]
    );
    assert_eq!(renewed(&["a", "..."], &["b"]), ["b", "..."]);
    assert_eq!(renewed(&["..."], &["b", "c"]), ["..."]);
    assert_eq!(renewed(&[], &["done 2.6 s"]), ["done ... s"]);
}
