//! Units, axes, and where the knowledge of them comes from.

use glam::DVec3;
use std::fmt;
use std::str::FromStr;

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// 0.001 m
    Millimetre,
    /// 0.01 m
    Centimetre,
    /// 0.1 m
    Decimetre,
    /// 1 m
    Metre,
    /// 0.0254 m
    Inch,
    /// 0.3048 m
    Foot,
    /// Any other length, as the files of some programs have it.
    Other {
        /// The length.
        nanometres: u64,
    },
}

impl Unit {
    /// Length of the unit in metres.
    pub fn metres(self) -> f64 {
        match self {
            Unit::Millimetre => 0.001,
            Unit::Centimetre => 0.01,
            Unit::Decimetre => 0.1,
            Unit::Metre => 1.0,
            Unit::Inch => 0.0254,
            Unit::Foot => 0.3048,
            Unit::Other { nanometres } => nanometres as f64 * 1e-9,
        }
    }

    /// The unit of this length, `None` for lengths below a micrometre and above a thousand kilometres.
    pub fn of_metres(metres: f64) -> Option<Self> {
        let named = [Unit::Millimetre, Unit::Centimetre, Unit::Decimetre, Unit::Metre, Unit::Inch, Unit::Foot];
        let named = named.into_iter().find(|u| (metres / u.metres() - 1.0).abs() < 1e-6);
        named.or_else(|| (1e-6..1e6).contains(&metres).then(|| Unit::Other { nanometres: (metres * 1e9).round() as u64 }))
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Unit::Other { nanometres } => return write!(f, "units of {} mm", (*nanometres as f64 * 1e-3).round() * 1e-3),
            Unit::Millimetre => "mm",
            Unit::Centimetre => "cm",
            Unit::Decimetre => "dm",
            Unit::Metre => "m",
            Unit::Inch => "in",
            Unit::Foot => "ft",
        })
    }
}

impl FromStr for Unit {
    type Err = String;

    /// Accepts the abbreviations, English names, a beginning of a name of at least four letters (`mete` is written by some systems), and
    /// the words for any other length.
    fn from_str(text: &str) -> Result<Self, String> {
        let word = text.trim().trim_end_matches('\0').to_ascii_lowercase();
        let length = word.strip_prefix("units of ").and_then(|rest| rest.strip_suffix(" mm")?.trim().parse::<f64>().ok());
        if let Some(unit) = length.and_then(|millimetres| Unit::of_metres(millimetres * 1e-3)) {
            return Ok(unit);
        }
        let names = [
            (Unit::Millimetre, ["mm", "millimetres", "millimeters"]),
            (Unit::Centimetre, ["cm", "centimetres", "centimeters"]),
            (Unit::Decimetre, ["dm", "decimetres", "decimeters"]),
            (Unit::Metre, ["m", "metres", "meters"]),
            (Unit::Inch, ["in", "inches", "inch"]),
            (Unit::Foot, ["ft", "feet", "foot"]),
        ];
        names
            .iter()
            .find(|(_, names)| names.iter().any(|n| *n == word || (word.len() >= 4 && n.starts_with(&word))))
            .map(|(unit, _)| *unit)
            .ok_or_else(|| format!("unknown unit '{}': expected mm, cm, dm, m, in or ft", text.trim()))
    }
}

/// A signed coordinate axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// 0, 1, 2 for x, y, z.
    pub index: usize,
    /// Whether it points to the negative side.
    pub negative: bool,
}

impl Axis {
    /// The unit vector along the axis.
    pub fn vector(self) -> DVec3 {
        let mut v = DVec3::ZERO;
        v[self.index] = if self.negative { -1.0 } else { 1.0 };
        v
    }

    /// The signed axis nearest to a direction; ties go to the lower index.
    pub fn nearest(direction: DVec3) -> Self {
        let mut index = 0;
        for i in 1..3 {
            if direction[i].abs() > direction[index].abs() {
                index = i;
            }
        }
        Self { index, negative: direction[index] < 0.0 }
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", if self.negative { '\u{2212}' } else { '+' }, ['X', 'Y', 'Z'][self.index])
    }
}

impl FromStr for Axis {
    type Err = String;

    /// Accepts `+Z`, `-y`, `x`, and the typographic minus.
    fn from_str(text: &str) -> Result<Self, String> {
        let word = text.trim().trim_end_matches('\0').trim();
        let (negative, letter) = match word.strip_prefix(['-', '\u{2212}']) {
            Some(rest) => (true, rest),
            None => (false, word.strip_prefix('+').unwrap_or(word)),
        };
        let index = match letter {
            "X" | "x" => 0,
            "Y" | "y" => 1,
            "Z" | "z" => 2,
            _ => return Err(format!("unknown axis '{word}': expected +X, -X, +Y, -Y, +Z or -Z")),
        };
        Ok(Self { index, negative })
    }
}

/// What a decision about the input rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// The file says so.
    File,
    /// Read off the shape or the motion.
    Shape,
    /// Names of parts say so.
    Names,
    /// From the size of the thing.
    Size,
    /// The user said so.
    User,
    /// A rig file says so.
    Rig,
    /// Nothing says so; a convention was used.
    Default,
}

impl fmt::Display for Evidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Evidence::File => "file",
            Evidence::Shape => "shape",
            Evidence::Names => "names",
            Evidence::Size => "size",
            Evidence::User => "you",
            Evidence::Rig => "rig file",
            Evidence::Default => "assumed",
        })
    }
}

/// A value with the evidence for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known<T> {
    /// The value.
    pub value: T,
    /// What it rests on.
    pub how: Evidence,
}

impl<T> Known<T> {
    /// A value with its evidence.
    pub fn new(value: T, how: Evidence) -> Self {
        Self { value, how }
    }
}

/// Unit and axes of a file; `None` where nothing is known yet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Space {
    /// Unit of length.
    pub unit: Option<Known<Unit>>,
    /// The axis that points up.
    pub up: Option<Known<Axis>>,
    /// The direction that the body faces, a unit vector across `up`.
    pub forward: Option<Known<DVec3>>,
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_words_for_a_unit_are_read_back() {
        for metres in [0.001, 0.01, 0.1, 1.0, 0.0254, 0.3048, 0.056_444, 0.75, 1234.5] {
            let unit = Unit::of_metres(metres).unwrap();
            assert_eq!(unit.to_string().parse(), Ok(unit), "{unit}");
        }
        assert!("units of 0 mm".parse::<Unit>().is_err() && "units of NaN mm".parse::<Unit>().is_err());
    }
}
