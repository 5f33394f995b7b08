//! Manifests in CSV: a line of names, then a line for every take. Several values of an option are parted by `|`.

use super::{Row, Values};
use crate::error::{Error, Kind, Result};

/// Parts several values of one cell.
const BETWEEN: char = '|';

pub(super) fn rows(text: &str) -> Result<Vec<Row>> {
    // Spreadsheets of half the world part cells by semicolons.
    let heading = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#')).unwrap_or_default();
    let delimiter = if heading.contains(';') && !heading.contains(',') { b';' } else { b',' };
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(text.as_bytes());
    let names: Vec<String> = match reader.headers() {
        Ok(names) => names.iter().map(|name| name.to_ascii_lowercase().replace('_', "-")).collect(),
        Err(error) => return Err(broken(&error)),
    };
    if let Some((_, twice)) = names.iter().enumerate().find(|(n, name)| !name.is_empty() && names[..*n].contains(name)) {
        return Err(Error::malformed(format!("two columns are called '{twice}'")).at("line 1"));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| broken(&e))?;
        if record.iter().all(str::is_empty) {
            continue;
        }
        let place = format!("line {}", record.position().map_or(0, csv::Position::line));
        if record.len() != names.len() {
            return Err(Error::malformed(format!("{} cells", record.len())).at(place).expected(format!("{} cells", names.len())));
        }
        let mut values = Values::new();
        for (name, cell) in names.iter().zip(&record).filter(|(_, cell)| !cell.is_empty()) {
            if name.is_empty() {
                return Err(Error::new(Kind::Usage, format!("'{cell}' stands in a column without a name")).at(place));
            }
            match cell.to_ascii_lowercase().as_str() {
                "no" | "false" => {}
                "yes" | "true" => drop(values.insert(name.clone(), vec![String::new()])),
                _ => drop(values.insert(name.clone(), cell.split(BETWEEN).map(|v| v.trim().to_owned()).collect())),
            }
        }
        rows.push(Row { place, values });
    }
    Ok(rows)
}

fn broken(error: &csv::Error) -> Error {
    let place = error.position().map_or_else(|| "line 1".to_owned(), |p| format!("line {}", p.line()));
    Error::malformed(error.to_string()).at(place).expected("a table parted by commas or semicolons")
}
