//! Manifests in TOML: `[[take]]` for each row, `[all]` for what holds for every one of them.

use super::{Row, Values};
use crate::error::{Error, Kind, Result};
use toml::{Table, Value};

pub(super) fn rows(text: &str) -> Result<Vec<Row>> {
    let file: Table = text.parse().map_err(|error: toml::de::Error| {
        let line = error.span().map_or(1, |span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        Error::malformed(error.message().to_owned()).at(format!("line {line}"))
    })?;
    let (mut all, mut takes) = (Values::new(), Vec::new());
    for (key, value) in file {
        match (key.as_str(), value) {
            ("all", Value::Table(table)) => all = values(&table, "[all]")?,
            ("take", Value::Array(array)) if array.iter().all(Value::is_table) => takes = array,
            (key, _) => {
                return Err(
                    Error::new(Kind::Usage, format!("unknown section '{key}'")).expected("[[take]] for each take, [all] for all")
                );
            }
        }
    }
    let row = |(n, take): (usize, &Value)| {
        let place = format!("[[take]] {}", n + 1);
        let mut row = all.clone();
        if let Value::Table(table) = take {
            row.extend(values(table, &place)?);
            // What a take says no to, it does not have from all.
            table.iter().filter(|(_, v)| v.as_bool() == Some(false)).for_each(|(key, _)| drop(row.remove(&name(key))));
        }
        Ok(Row { place, values: row })
    };
    takes.iter().enumerate().map(row).collect()
}

fn name(key: &str) -> String {
    key.replace('_', "-")
}

fn values(table: &Table, place: &str) -> Result<Values> {
    let mut all = Values::new();
    for (key, value) in table {
        let one = |value: &Value| match value {
            Value::String(text) => Ok(text.clone()),
            Value::Integer(number) => Ok(number.to_string()),
            Value::Float(number) => Ok(number.to_string()),
            other => Err(Error::new(Kind::Usage, format!("'{key}' is a value of type {}", other.type_str()))
                .at(place)
                .expected("a text, a number, true or false, or a list of texts or numbers")),
        };
        let values = match value {
            Value::Boolean(false) => continue,
            Value::Boolean(true) => vec![String::new()],
            Value::Array(array) => array.iter().map(one).collect::<Result<_>>()?,
            value => vec![one(value)?],
        };
        all.insert(name(key), values);
    }
    Ok(all)
}
