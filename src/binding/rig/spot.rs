//! Places on a scan and meanings of labels, as a person writes them.

use glam::DVec3;
use serde::de::{self, Deserialize, Deserializer, SeqAccess, Visitor};
use serde::{Serialize, Serializer};
use std::fmt;

/// A place on the scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spot {
    /// A vertex, counted from 0 in the order of the file.
    Vertex(u64),
    /// A place in the scan's coordinates and unit.
    Place(DVec3),
}

/// What a marker is.
#[derive(Clone, Debug, PartialEq)]
pub enum Pin {
    /// It sits there.
    At(Spot),
    /// It is what this label of the dictionary says.
    As(String),
    /// It pulls nothing.
    Ignore,
}

/// In place of a label: the marker is left out.
const IGNORE: &str = "ignore";

impl Spot {
    fn of_sequence<'de, A: SeqAccess<'de>>(mut sequence: A) -> Result<Self, A::Error> {
        let mut place = [0.0; 3];
        for (i, x) in place.iter_mut().enumerate() {
            *x = sequence.next_element()?.ok_or_else(|| de::Error::invalid_length(i, &"three numbers"))?;
        }
        if sequence.next_element::<f64>()?.is_some() || place.iter().any(|x: &f64| !x.is_finite()) {
            return Err(de::Error::custom("expected three finite numbers"));
        }
        Ok(Spot::Place(DVec3::from(place)))
    }

    fn of_number<E: de::Error>(number: i64) -> Result<Self, E> {
        u64::try_from(number).map(Spot::Vertex).map_err(|_| E::custom(format!("{number} is no vertex: they are counted from 0")))
    }
}

impl<'de> Deserialize<'de> for Spot {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Spot;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a vertex of the scan or a place [x, y, z]")
            }
            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Spot, E> {
                Spot::of_number(number)
            }
            fn visit_seq<A: SeqAccess<'de>>(self, sequence: A) -> Result<Spot, A::Error> {
                Spot::of_sequence(sequence)
            }
        }
        deserializer.deserialize_any(Reader)
    }
}

impl Serialize for Spot {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Spot::Vertex(vertex) => serializer.serialize_u64(*vertex),
            Spot::Place(place) => place.to_array().serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Pin {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Pin;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a known label, \"ignore\", a vertex of the scan or a place [x, y, z]")
            }
            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Pin, E> {
                Spot::of_number(number).map(Pin::At)
            }
            fn visit_str<E: de::Error>(self, word: &str) -> Result<Pin, E> {
                if word == IGNORE {
                    return Ok(Pin::Ignore);
                }
                match crate::binding::labels::is_known(word) {
                    true => Ok(Pin::As(word.to_owned())),
                    false => Err(E::custom(format!("'{word}' is no label that the dictionary knows, as LASI, C7 or RightHeel"))),
                }
            }
            fn visit_seq<A: SeqAccess<'de>>(self, sequence: A) -> Result<Pin, A::Error> {
                Spot::of_sequence(sequence).map(Pin::At)
            }
        }
        deserializer.deserialize_any(Reader)
    }
}

impl Serialize for Pin {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Pin::At(spot) => spot.serialize(serializer),
            Pin::As(label) => serializer.serialize_str(label),
            Pin::Ignore => serializer.serialize_str(IGNORE),
        }
    }
}
