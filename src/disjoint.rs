//! Disjoint sets over `0..n`.

/// Union-find with path halving; the representative of a set is its smallest member.
pub(crate) struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    /// `n` sets of one member each.
    pub(crate) fn new(n: usize) -> Self {
        Self { parent: (0..n as u32).collect() }
    }

    /// Sets of which some members are known: each names another one of its set, or itself, that is not larger.
    pub(crate) fn of(parent: Vec<u32>) -> Self {
        Self { parent }
    }

    /// The smallest member of the set of `x`.
    pub(crate) fn find(&mut self, mut x: u32) -> u32 {
        while self.parent[x as usize] != x {
            let grandparent = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = grandparent;
            x = grandparent;
        }
        x
    }

    /// Makes one set of the sets of `a` and `b`.
    pub(crate) fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Number of the set of each member, counted from 0 in the order of smallest members, and how many sets there are.
    pub(crate) fn labels(&mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut labels = vec![0; self.parent.len()];
        for x in 0..labels.len() as u32 {
            let root = self.find(x);
            // The root is the smallest member, so it already has its number.
            labels[x as usize] = if root == x { count } else { labels[root as usize] };
            count += u32::from(root == x);
        }
        (labels, count as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_number_the_sets_by_their_smallest_member() {
        let mut sets = DisjointSets::new(6);
        sets.unite(5, 1);
        sets.unite(4, 2);
        sets.unite(4, 5);
        assert_eq!(sets.labels(), (vec![0, 1, 1, 2, 1, 1], 3));
    }
}
