//! A sparse symmetric matrix, kept as its lower triangle in columns.

/// A sparse symmetric matrix: lower triangle with diagonal, by columns, rows ascending.
#[derive(Clone, Debug, PartialEq)]
pub struct SymmetricMatrix {
    /// Where each column begins; one more entry than columns.
    pub(crate) starts: Vec<u32>,
    /// Row of each entry.
    pub(crate) rows: Vec<u32>,
    /// Value of each entry.
    pub(crate) values: Vec<f64>,
}

impl SymmetricMatrix {
    /// Sums entries `(i, j, value)` of the lower triangle (`i ≥ j`; an entry above the diagonal is taken as its mirror image).
    /// Entries at one place are added in the order given.
    pub fn assemble(size: usize, entries: &[(u32, u32, f64)]) -> Self {
        let mut starts = vec![0_u32; size + 1];
        for &(i, j, _) in entries {
            starts[i.min(j) as usize + 1] += 1;
        }
        for c in 0..size {
            starts[c + 1] += starts[c];
        }
        let mut next = starts.clone();
        let mut sorted = vec![(0_u32, 0.0_f64); entries.len()];
        for &(i, j, value) in entries {
            let slot = &mut next[i.min(j) as usize];
            sorted[*slot as usize] = (i.max(j), value);
            *slot += 1;
        }
        let mut matrix = Self { starts: vec![0], rows: Vec::new(), values: Vec::new() };
        for c in 0..size {
            let column = &mut sorted[starts[c] as usize..starts[c + 1] as usize];
            column.sort_by_key(|&(row, _)| row);
            let first = matrix.rows.len();
            for &(row, value) in column.iter() {
                if matrix.rows.len() > first && matrix.rows.last() == Some(&row) {
                    let last = matrix.values.len() - 1;
                    matrix.values[last] += value;
                } else {
                    matrix.rows.push(row);
                    matrix.values.push(value);
                }
            }
            matrix.starts.push(matrix.rows.len() as u32);
        }
        matrix
    }

    /// Number of rows and columns.
    pub fn size(&self) -> usize {
        self.starts.len() - 1
    }

    /// The entries on and below the diagonal: row, column, value.
    pub fn entries(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        (0..self.size()).flat_map(move |c| {
            let range = self.starts[c] as usize..self.starts[c + 1] as usize;
            self.rows[range.clone()].iter().zip(&self.values[range]).map(move |(&r, &v)| (r as usize, c, v))
        })
    }

    /// The diagonal.
    pub fn diagonal(&self) -> Vec<f64> {
        let mut diagonal = vec![0.0; self.size()];
        for (row, column, value) in self.entries() {
            if row == column {
                diagonal[row] = value;
            }
        }
        diagonal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_at_one_place_are_added_and_mirrored() {
        let m = SymmetricMatrix::assemble(3, &[(0, 0, 1.0), (2, 1, 5.0), (1, 2, 2.0), (2, 2, 4.0), (0, 0, 0.5)]);
        assert_eq!(m.entries().collect::<Vec<_>>(), [(0, 0, 1.5), (2, 1, 7.0), (2, 2, 4.0)]);
        assert_eq!(m.diagonal(), [1.5, 0.0, 4.0]);
    }
}
