//! Examples and the shell deformer: their options, and what follows from them.

use crate::binding::rig::shell::{Range, ShellSection};
use crate::deform::shells::{Body, Bounds, Material, Options, Shells};
use crate::error::{Error, Kind, Notes, Result};
use crate::pipeline::Outcome;
use crate::scan::{Pose, Scan, UnitBox, read_poses};
use clap::{Args, ValueEnum};
use glam::DVec3;
use std::path::PathBuf;

/// Vertices of the coarse mesh where nothing else is said.
const VERTICES: u32 = 1000;
/// What a frame with a fold is.
pub(super) const FOLDING: &str = "more than 10 edges of the shell are folded over there";
/// Share of the frames at a bound from which a weight is told of.
const OFTEN: f64 = 0.1;

/// Options of the shell deformer.
#[derive(Clone, Debug, Default, Args)]
pub struct ShellArgs {
    /// How frames are solved: auto takes shells where there are examples
    #[arg(long, value_enum, default_value_t = Method::Auto, help_heading = "Solve")]
    pub method: Method,
    /// Other poses of the scan, from which it learns how it bends: meshes with the same vertices and faces, folders of such, or glTF with morph
    /// targets. They may stand anywhere and be turned in any way
    #[arg(long, num_args = 1.., value_name = "FILE", help_heading = "Examples")]
    pub examples: Vec<PathBuf>,
    /// Examples of another size: taken as they are (1, the default), or scaled so that their edges are as long as those of the scan (auto)
    #[arg(long, hide_short_help = true, value_enum, help_heading = "Examples")]
    pub example_scale: Option<ExampleScale>,
    /// How far weights of examples may go: anywhere, -0.2 to 1.2 (box, the default), or 0 to 1
    #[arg(long, value_enum, help_heading = "Examples")]
    pub weight_range: Option<WeightRange>,
    #[command(flatten)]
    pub material: MaterialArgs,
}

/// Options of the shell's material.
#[derive(Clone, Debug, Default, Args)]
pub struct MaterialArgs {
    /// Thickness of the shell in per cent of the scan's diagonal (the thinner, the harder to stretch against bending)
    #[arg(long, hide_short_help = true, value_name = "PCT", value_parser = parse_positive, conflicts_with = "shell_weights", help_heading = "Examples")]
    pub thickness: Option<f64>,
    /// Weights of stretching, bending and volume; 'paper' is 100,1,1000 without regard to areas
    #[arg(long, hide_short_help = true, value_name = "L,M,N|paper", value_parser = parse_material, help_heading = "Examples")]
    pub shell_weights: Option<ShellWeights>,
    /// Softer where the examples change much
    #[arg(long, hide_short_help = true, help_heading = "Examples")]
    pub learn_stiffness: bool,
}

/// `--method`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Shells where there are examples, else volumetric
    #[default]
    Auto,
    /// Tetrahedra that keep their shape
    Volumetric,
    /// A surface that has learnt from examples
    Shells,
}

/// `--example-scale`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ExampleScale {
    /// As they are
    #[default]
    #[value(name = "1")]
    One,
    /// As large as the scan
    Auto,
}

/// `--weight-range`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum WeightRange {
    /// Anywhere
    Free,
    /// -0.2 to 1.2
    #[default]
    Box,
    /// 0 to 1
    Convex,
}

/// `--shell-weights`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ShellWeights {
    /// As published.
    Paper,
    /// Stretching, bending, volume.
    Given([f64; 3]),
}

impl WeightRange {
    fn bounds(self) -> Bounds {
        match self {
            Self::Free => Bounds::FREE,
            Self::Box => Bounds::BOX,
            Self::Convex => Bounds::CONVEX,
        }
    }
}

impl ShellArgs {
    /// Whether frames are solved by shells.
    ///
    /// # Errors
    /// [`Kind::Usage`] where examples are given to another method.
    pub(super) fn are_chosen(&self) -> Result<bool> {
        match (self.method, self.examples.is_empty()) {
            (Method::Volumetric, false) => Err(Error::new(Kind::Usage, "--examples with --method volumetric")
                .expected("--method shells, which learns from examples")
                .hint("leave out --method")),
            (Method::Shells, _) | (Method::Auto, false) => Ok(true),
            _ => Ok(false),
        }
    }

    /// What cannot be asked for together. `refined`: whether `--refine` is given; `others`: options of the volumetric deformer, whether they are given, and what shells have in their place.
    ///
    /// # Errors
    /// [`Kind::Usage`].
    pub(super) fn check(&self, refined: bool, others: &[(bool, &'static str, &'static str)]) -> Result<()> {
        let is_shell = self.are_chosen()?;
        if let Some((_, option, hint)) = others.iter().find(|o| is_shell && o.0) {
            return Err(Error::new(Kind::Usage, format!("{option} with shells"))
                .expected(format!("{option} for the volumetric deformer only"))
                .hint(*hint));
        }
        let of_examples = [
            (self.weight_range.is_some(), "--weight-range"),
            (self.example_scale.is_some(), "--example-scale"),
            (self.material.learn_stiffness, "--learn-stiffness"),
        ];
        let of_shells = [
            (self.material.thickness.is_some(), "--thickness"),
            (self.material.shell_weights.is_some(), "--shell-weights"),
            (refined, "--refine"),
        ];
        let given = |options: &[(bool, &'static str)]| options.iter().find(|o| o.0).map(|o| o.1);
        if let Some(option) = given(&of_shells).filter(|_| !is_shell) {
            return Err(Error::new(Kind::Usage, format!("{option} without shells"))
                .expected("the shell deformer, whose material it is")
                .hint("--method shells, or --examples FILE"));
        }
        if let Some(option) = given(&of_examples).filter(|_| self.examples.is_empty()) {
            return Err(Error::new(Kind::Usage, format!("{option} without examples"))
                .expected("other poses of the scan, for which it is")
                .hint("--examples FILE"));
        }
        Ok(())
    }

    /// Takes over what a rig file says and the command line does not, as far as this run has use for it.
    ///
    /// # Errors
    /// [`Kind::Usage`], as [`Self::are_chosen`].
    pub(super) fn take_from(&mut self, section: &ShellSection) -> Result<()> {
        if !self.are_chosen()? {
            return Ok(());
        }
        let material = &mut self.material;
        if material.thickness.is_none() && material.shell_weights.is_none() {
            material.thickness = section.thickness;
            material.shell_weights = match section.weights {
                Some(weights) => Some(ShellWeights::Given(weights)),
                None => section.paper.then_some(ShellWeights::Paper),
            };
        }
        if !self.examples.is_empty() {
            material.learn_stiffness |= section.learn_stiffness;
            self.weight_range = self.weight_range.or(section.weight_range.map(|range| match range {
                Range::Free => WeightRange::Free,
                Range::Box => WeightRange::Box,
                Range::Convex => WeightRange::Convex,
            }));
        }
        Ok(())
    }

    /// What a rig file is to say of it; what this run has no use for stays as it was in `file`.
    ///
    /// # Errors
    /// [`Kind::Usage`], as [`Self::are_chosen`].
    pub(super) fn section(&self, file: &ShellSection) -> Result<ShellSection> {
        if !self.are_chosen()? {
            return Ok(file.clone());
        }
        let learns = !self.examples.is_empty();
        Ok(ShellSection {
            weights: match self.material.shell_weights {
                Some(ShellWeights::Given(weights)) => Some(weights),
                _ => None,
            },
            paper: self.material.shell_weights == Some(ShellWeights::Paper),
            thickness: self.material.thickness,
            weight_range: match self.weight_range {
                _ if !learns => file.weight_range,
                None => None,
                Some(WeightRange::Free) => Some(Range::Free),
                Some(WeightRange::Box) => Some(Range::Box),
                Some(WeightRange::Convex) => Some(Range::Convex),
            },
            learn_stiffness: if learns { self.material.learn_stiffness } else { file.learn_stiffness },
        })
    }

    /// `-0.2 to 1.2`.
    pub(super) fn range_words(&self) -> &'static str {
        match self.weight_range.unwrap_or_default() {
            WeightRange::Free => "free",
            WeightRange::Box => "\u{2212}0.2 to 1.2",
            WeightRange::Convex => "0 to 1",
        }
    }

    /// How the shell is solved.
    pub(super) fn options(&self, body: &Body, stiffness: Vec<f64>, rigid: Vec<Vec<u32>>) -> Options {
        let count = body.examples.len();
        let material = self.material.material(body);
        Options {
            material,
            bounds: self.weight_range.unwrap_or_default().bounds(),
            stiffness,
            rigid,
            ..Options::for_examples(count)
        }
    }

    /// Warnings about weights that often were where they may go no farther.
    pub(super) fn weight_warnings(&self, outcome: &Outcome, names: &[String]) -> Vec<String> {
        let bounds = self.weight_range.unwrap_or_default().bounds();
        let often = |count: usize| count as f64 > OFTEN * outcome.frames as f64;
        let at = |range: &crate::pipeline::WeightRange| -> Option<(usize, f64)> {
            if often(range.at_most) && range.most >= bounds.most {
                Some((range.at_most, bounds.most))
            } else if often(range.at_least) && range.least <= bounds.least && bounds.least < 0.0 {
                Some((range.at_least, bounds.least))
            } else {
                None
            }
        };
        let stuck = outcome.weights.iter().zip(names).filter_map(|(range, name)| Some((at(range)?, name)));
        stuck
            .map(|((count, bound), name)| {
                format!(
                    "the weight of example {name} is {bound} in {} of {} frames and may go no farther: --weight-range free lets it, more handles or examples may need it less",
                    crate::words::count(count),
                    crate::words::count(outcome.frames)
                )
            })
            .collect()
    }
}

impl MaterialArgs {
    /// The material of a body.
    pub(super) fn material(&self, body: &Body) -> Material {
        let usual = if !body.examples.is_empty() { Material::WITH_EXAMPLES } else { Material::WITHOUT_EXAMPLES };
        let mut material = match self.shell_weights {
            Some(ShellWeights::Paper) => Material::PAPER,
            Some(ShellWeights::Given([stretching, bending, volume])) => Material { stretching, bending, volume, ..usual },
            None => usual,
        };
        if let Some(percent) = self.thickness {
            material = material.with_thickness(percent / 100.0 / body.edge_of_a_thousand());
        }
        material.from_examples = self.learn_stiffness;
        material
    }
}

/// The examples of a scan, in its unit box, with their names.
#[derive(Clone, Debug, Default)]
pub(super) struct Examples {
    pub names: Vec<String>,
    pub poses: Vec<Vec<DVec3>>,
}

impl Examples {
    /// Reads the files.
    pub(super) fn read(
        files: &[PathBuf],
        scale: Option<ExampleScale>,
        scan: &Scan,
        unit_box: UnitBox,
        notes: &mut Notes,
    ) -> Result<Self> {
        let scale = scale.unwrap_or_default();
        let mut own = Notes::default();
        let poses = read_poses(scan, files, scale == ExampleScale::Auto, &mut own)?;
        notes.extend(own);
        let mut examples = Self::default();
        for Pose { name, positions, scale: size } in poses {
            let factor = if scale == ExampleScale::Auto && size > 0.0 { 1.0 / size } else { 1.0 };
            examples.names.push(name);
            examples.poses.push(positions.iter().map(|p| unit_box.enter(*p) * factor).collect());
        }
        Ok(examples)
    }
}

/// The coarse mesh of a scan with its examples.
pub(super) fn body(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    examples: &Examples,
    vertices: Option<u32>,
    cancel: &dyn Fn() -> Result<()>,
) -> Result<Body> {
    Body::build(points, triangles, &examples.poses, vertices.unwrap_or(VERTICES) as usize, cancel)
}

/// The whole mesh, for steps after those on a coarse one.
///
/// # Errors
/// Those of the coarse mesh; [`Kind::Refused`] where that is the whole one.
pub(super) fn whole(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    examples: &Examples,
    coarse: &Body,
    cancel: &dyn Fn() -> Result<()>,
) -> Result<Body> {
    let all = body(points, triangles, examples, Some(u32::MAX), cancel)?;
    if all.vertices() <= coarse.vertices() {
        return Err(Error::refused(format!(
            "--refine with {} vertices, all of which are solved",
            crate::words::count(all.vertices())
        ))
        .expected("a coarse mesh of fewer vertices than the scan has")
        .hint("leave it out, or --proxy-vertices with a smaller number"));
    }
    Ok(all)
}

/// What is to be said of the bending that is left out.
pub(super) fn remarks(shells: &Shells) -> Option<String> {
    let (folded, thin) = shells.without_bending();
    let edges = |count: usize| crate::words::plural(count, "edge");
    match (folded, thin) {
        (0, 0) => None,
        (folded, 0) => {
            Some(format!("{} of the shell do not resist bending: an example turns them by more than 180\u{b0}", edges(folded)))
        }
        (0, thin) => Some(format!("{} of the shell do not resist bending: the triangles beside them have no area", edges(thin))),
        (folded, thin) => Some(format!(
            "{} of the shell do not resist bending: {folded} are turned by more than 180\u{b0} in an example, {thin} lie beside triangles without area",
            edges(folded + thin)
        )),
    }
}

fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("expected a positive number".into()),
    }
}

fn parse_material(text: &str) -> Result<ShellWeights, String> {
    if text == "paper" {
        return Ok(ShellWeights::Paper);
    }
    let numbers: Vec<f64> = text.split(',').filter_map(|w| w.trim().parse().ok()).collect();
    match numbers[..] {
        [l, m, n] if l.is_finite() && l > 0.0 && m.is_finite() && m > 0.0 && n.is_finite() && n >= 0.0 => {
            Ok(ShellWeights::Given([l, m, n]))
        }
        _ => Err("expected 'paper' or three numbers: stretching and bending above 0, volume at least 0".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thickness_means_the_same_for_any_number_of_triangles() {
        let stretching = |rings: usize, segments: usize| {
            let (points, faces) = crate::deform::shells::shapes::straight(1.0, 0.1, rings, segments);
            let body = Body::build(&points, &faces, &[], 100_000, &|| Ok(())).expect("a tube");
            let args = MaterialArgs { thickness: Some(1.0), ..MaterialArgs::default() };
            args.material(&body).stretching
        };
        // λ = μ (3.7 h / t)² with the edge h of a mesh of 1,000 vertices.
        let edge = ((std::f64::consts::TAU * 0.1 * (1.0 + 0.1)) / 866.0).sqrt();
        for lambda in [stretching(30, 24), stretching(60, 60)] {
            assert!((lambda / (3.7 * edge / 0.01).powi(2) - 1.0).abs() < 0.02, "{lambda}");
        }
    }

    #[test]
    fn options_without_what_they_are_for_are_refused_by_name() {
        let refused = |args: &ShellArgs, option: &str| {
            let error = args.check(false, &[]).expect_err(option);
            assert!(error.kind == Kind::Usage && error.to_string().contains(option), "{error}");
        };
        let shells = || ShellArgs { method: Method::Shells, ..ShellArgs::default() };
        let examples = || ShellArgs { examples: vec!["a.obj".into()], ..ShellArgs::default() };
        let range = Some(WeightRange::Box);
        let scale = Some(ExampleScale::One);
        let learnt = MaterialArgs { learn_stiffness: true, ..MaterialArgs::default() };
        let thick = MaterialArgs { thickness: Some(1.0), ..MaterialArgs::default() };
        let weighted = MaterialArgs { shell_weights: Some(ShellWeights::Paper), ..MaterialArgs::default() };
        for args in [ShellArgs::default(), ShellArgs { method: Method::Volumetric, ..ShellArgs::default() }] {
            assert!(args.check(false, &[]).is_ok());
            refused(&ShellArgs { material: thick.clone(), ..args.clone() }, "--thickness");
            refused(&ShellArgs { material: weighted.clone(), ..args }, "--shell-weights");
        }
        for args in [ShellArgs::default(), shells()] {
            refused(&ShellArgs { weight_range: range, ..args.clone() }, "--weight-range");
            refused(&ShellArgs { example_scale: scale, ..args.clone() }, "--example-scale");
            refused(&ShellArgs { material: learnt.clone(), ..args }, "--learn-stiffness");
        }
        let others = [(false, "--proxy", ""), (true, "--map paper", "leave it out")];
        let error = shells().check(false, &others).expect_err("--map paper");
        assert!(error.kind == Kind::Usage && error.to_string().contains("--map paper with shells"), "{error}");
        assert!(ShellArgs::default().check(false, &others).is_ok());
        assert!(ShellArgs { material: thick, ..shells() }.check(false, &[]).is_ok());
        assert!(ShellArgs { material: weighted, ..shells() }.check(false, &[]).is_ok());
        let all = ShellArgs { weight_range: range, example_scale: scale, material: learnt, ..examples() };
        assert!(all.check(false, &[]).is_ok());
    }

    #[test]
    fn weights_of_the_material_are_checked() {
        assert_eq!(parse_material("paper"), Ok(ShellWeights::Paper));
        assert_eq!(parse_material("10, 1,500"), Ok(ShellWeights::Given([10.0, 1.0, 500.0])));
        for bad in ["", "1,2", "0,1,1", "1,1,-1", "1,nan,1", "a,b,c", "1,2,3,4"] {
            assert!(parse_material(bad).is_err(), "{bad}");
        }
    }
}
