//! What a law has been tried on, and the worst figure seen.

use super::cases::{Case, Take};
use super::shapes::Kind;
use std::collections::{BTreeMap, BTreeSet};

/// Meshes and takes that every law has to be tried on.
const LEAST_MESHES: usize = 8;
const LEAST_TAKES: usize = 3;

/// The record of one law; [`Tally::close`] judges it.
pub struct Tally {
    law: &'static str,
    limit: f64,
    meshes: BTreeMap<&'static str, Kind>,
    takes: BTreeSet<&'static str>,
    /// The worst figure of each combination.
    figures: BTreeMap<String, f64>,
    worst: f64,
    at: String,
}

impl Tally {
    pub fn new(law: &'static str, limit: f64) -> Self {
        Self {
            law,
            limit,
            meshes: BTreeMap::new(),
            takes: BTreeSet::new(),
            figures: BTreeMap::new(),
            worst: f64::NEG_INFINITY,
            at: "nothing".into(),
        }
    }

    /// A figure of the law for a mesh and a take; `what` says of which deformer or variant.
    pub fn note(&mut self, case: &Case, take: Option<&Take>, what: &str, figure: f64) {
        let take = take.map_or("at rest", |t| t.name);
        self.meshes.insert(case.shape.name, case.shape.kind);
        self.takes.insert(take);
        let figure = if figure.is_nan() { f64::INFINITY } else { figure };
        let combination = format!("{what}, {}, {take}", case.shape.name);
        if figure > self.worst {
            self.worst = figure;
            self.at.clone_from(&combination);
        }
        let worst = self.figures.entry(combination).or_insert(figure);
        *worst = worst.max(figure);
    }

    /// Fails when a figure is beyond the limit, or when the law was tried on too little.
    pub fn close(self) {
        eprintln!(
            "{:<76} {:>3} combinations  worst {:.1e} of {:.0e}  ({})",
            self.law,
            self.figures.len(),
            self.worst,
            self.limit,
            self.at
        );
        if self.worst > self.limit {
            let mut beyond: Vec<_> = self.figures.iter().filter(|f| *f.1 > self.limit).collect();
            beyond.sort_by(|a, b| b.1.total_cmp(a.1));
            beyond.iter().for_each(|(name, figure)| eprintln!("    {name}: {figure:.1e}"));
        }
        assert!(self.worst <= self.limit, "{}: {:.3e} with {}", self.law, self.worst, self.at);
        let of = |kind: Kind| self.meshes.values().filter(|k| **k == kind).count();
        assert!(self.meshes.len() >= LEAST_MESHES, "{}: tried on {} meshes", self.law, self.meshes.len());
        assert!(of(Kind::WholeBody) >= 3, "{}: tried on {} whole bodies", self.law, of(Kind::WholeBody));
        for kind in [Kind::Quadruped, Kind::Thin, Kind::Parts] {
            assert!(of(kind) >= 1, "{}: not tried on {kind:?}", self.law);
        }
        let rest_only = self.takes.iter().eq(["at rest"].iter());
        assert!(rest_only || self.takes.len() >= LEAST_TAKES, "{}: tried on {} takes", self.law, self.takes.len());
    }
}
