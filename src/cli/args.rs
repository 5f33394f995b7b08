//! The arguments as typed: strings checked and turned into values, nothing opened yet.

use super::shells::{ExampleScale, MaterialArgs, ShellArgs};
pub(super) use super::values::{Align, EncodeArg, Map, Plant, QualityArg, Reference, StyleArg, Weights};
use super::values::{
    parse_finite, parse_frames, parse_percent, parse_positive, parse_rate, parse_reach, parse_reference, parse_weights,
};
use crate::binding::select::{Hold, Selector, Stiffness};
use crate::space::{Axis, Unit};
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// The version and, built from a working copy, the commit.
pub(super) const VERSION: &str = env!("RETARGET_VERSION");

/// Makes a scan move like the person that was captured.
#[derive(Debug, Parser)]
#[command(
    name = "retarget",
    version = VERSION,
    about = "Make a scan move like what was captured: no rig, no skinning, no hand work",
    after_help = "Example: retarget scan.obj walk.c3d -o walk.glb\nParts (WHAT): group:NAME (OBJ groups and objects; * and ?), color:#rrggbb[~TOLERANCE] (vertex colours), sphere:X,Y,Z,R (scan's unit), near:HANDLE[,HANDLE...], or a part of a body: ends (head, hands and feet), head, hands, feet, upper_arms, left_hand, ...\nA file that is called like a subcommand is written ./inspect",
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    arg_required_else_help = true
)]
pub struct Cli {
    /// Subcommands beside the main job.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// The main job.
    #[command(flatten)]
    pub animate: Option<Animate>,
    /// More options of the main job: arguments that may be missing altogether cannot be nested.
    #[command(flatten)]
    pub shells: ShellArgs,
}

impl Cli {
    /// The main job with all its options.
    pub fn main_job(self) -> Option<Animate> {
        self.animate.map(|animate| Animate { shells: self.shells, ..animate })
    }
}

/// What else the program does.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Say what is in scans, captures and outputs, without writing anything
    Inspect(Inspect),
    /// Interpolate and exaggerate example poses of a mesh by weights
    Blend(Blend),
    /// Find the joints of a thing made of parts in its shape, and write them as a rig file to be edited
    Joints(Joints),
    /// Do many takes: a table of scans, captures, outputs and options
    Batch(Batch),
    /// Print the completions of a shell, to be put where it looks for them
    Completions(Completions),
    /// Print the manual page, for example: retarget man >~/.local/share/man/man1/retarget.1
    Man(Man),
}

/// Arguments of `retarget completions`.
#[derive(Debug, Args)]
pub struct Completions {
    /// Which shell
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Arguments of `retarget man`.
#[derive(Debug, Args)]
pub struct Man {
    /// The page of a subcommand, instead of the main job's
    #[arg(value_name = "SUBCOMMAND")]
    pub of: Option<String>,
}

/// Arguments of `retarget joints`.
#[derive(Debug, Args)]
pub struct Joints {
    /// The mesh: objects or groups are its parts, or the pieces that hang together. Decimate it afterwards: coarse meshes have lost their contacts
    pub model: PathBuf,
    /// The rig file: parts, joints with axes and ranges, doubtful ones first
    #[arg(short, long, value_name = "RIG.toml")]
    pub out: PathBuf,
    /// Draw the parts with the joints
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Replace outputs that exist
    #[arg(long)]
    pub force: bool,
    /// What kind of thing it is
    #[arg(long, value_enum, default_value_t = StyleArg::Mechanism)]
    pub style: StyleArg,
    /// Surfaces touch that are no farther apart, in per cent of the model's diagonal
    #[arg(long, value_name = "PCT", default_value_t = 0.4, value_parser = parse_reach)]
    pub reach: f64,
}

/// Arguments of `retarget blend`.
#[derive(Debug, Args)]
pub struct Blend {
    /// The mesh at rest: OBJ, PLY, OFF, glTF or GLB (also .gz and .zip)
    pub rest: PathBuf,
    /// Its examples: meshes with the same vertices and faces in other poses, folders of such, or glTF with morph targets
    #[arg(required = true, value_name = "POSE")]
    pub examples: Vec<PathBuf>,
    /// A weight for each example, -20 to 20, for one frame; below 0 and above 1 exaggerates (repeatable)
    #[arg(long, value_name = "W,...", value_parser = parse_weights, allow_hyphen_values = true, required_unless_present = "weights")]
    pub at: Vec<Weights>,
    /// A table of weights: a line per frame, a number per example, separated by commas; a first line of names is skipped
    #[arg(long, value_name = "FILE.csv", conflicts_with = "at")]
    pub weights: Option<PathBuf>,
    /// What to write; the extension is the format: .ply or .obj (a run of # for the frame number where there are several frames), .glb, .abc, .usdc,
    /// .usda, .usdz, .pc2, .mdd, .html, .png, .apng (repeatable)
    #[arg(short, long = "out", value_name = "FILE", required = true)]
    pub out: Vec<PathBuf>,
    /// How far a .glb or .html may be from the poses at the worst vertex of the worst frame, in percent of the mesh's diagonal (default 0.25), and a fifth
    /// of it root mean square
    #[arg(long, value_name = "PCT", value_parser = parse_percent)]
    pub tolerance: Option<f64>,
    /// By what a .glb or .html holds the motion
    #[arg(long, value_enum, default_value_t = EncodeArg::Auto)]
    pub encode: EncodeArg,
    /// Replace outputs that exist
    #[arg(long)]
    pub force: bool,
    /// Frames per second of what is written
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = parse_rate)]
    pub fps: f64,
    /// Steps on the whole mesh after the coarse one is solved
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub refine: u32,
    /// Vertices of the coarse mesh, 100 to 100000 (default: 1000)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=100_000))]
    pub proxy_vertices: Option<u32>,
    /// Examples of another size: taken as they are (1, the default), or scaled so that their edges are as long as those of the mesh (auto)
    #[arg(long, value_enum)]
    pub example_scale: Option<ExampleScale>,
    #[command(flatten)]
    pub material: MaterialArgs,
    /// Print errors only
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Print the steps of each frame
    #[arg(short, long)]
    pub verbose: bool,
}

/// Arguments of `retarget batch`.
#[derive(Debug, Args)]
pub struct Batch {
    /// The takes: CSV with the columns scan, capture, out and long options of the main job, or TOML with a table take for each. Patterns such as takes/*.c3d stand for
    /// all files that match, each scan with each capture; {scan} and {capture} in other values are the names of the two. Paths are seen from the
    /// manifest's folder
    pub manifest: PathBuf,
    /// Do only this take, counted from 1: what a queue calls
    #[arg(long, value_name = "N")]
    pub index: Option<usize>,
    /// Takes that are done at the same time (default: as many as there are cores); each is a process of its own
    #[arg(long, value_name = "N", conflicts_with = "index")]
    pub workers: Option<usize>,
    /// Threads of each take (default: the cores shared among the workers)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Do finished takes again, and replace outputs that no earlier run of the manifest has written
    #[arg(long)]
    pub force: bool,
    /// Keep what set-up computes of scans in this folder, as --cache of the main job
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Say what each take would need of time and memory, and whether it is done already; do nothing
    #[arg(long, conflicts_with_all = ["index", "workers", "force"])]
    pub estimate: bool,
    /// Print the table of results as JSON to standard output
    #[arg(long, conflicts_with = "index")]
    pub json: bool,
    /// Stop when standard input closes
    #[arg(long, hide = true)]
    pub until_input_closes: bool,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

/// The main job alone, as a manifest has it.
#[derive(Debug, Parser)]
#[command(name = "retarget", no_binary_name = true)]
pub struct Take {
    /// The main job.
    #[command(flatten)]
    pub animate: Animate,
    /// More options of the main job, see [`Cli::shells`].
    #[command(flatten)]
    pub shells: ShellArgs,
}

/// Arguments of `retarget inspect`.
#[derive(Debug, Args)]
pub struct Inspect {
    /// Scans (OBJ, PLY, STL, OFF, glTF, GLB, also .gz and .zip), captures (C3D, TRC, CSV, BVH, ASF/AMC, glTF, GLB, FBX), outputs (GLB, PC2, MDD)
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Print JSON, one object per file, for programs
    #[arg(long)]
    pub json: bool,
    /// Draw bars without block characters
    #[arg(long)]
    pub ascii: bool,
    /// Draw the first scan from four sides with its landmarks; with a capture among the files, as it is bound to the scan, or its markers with their
    /// numbers and names where it cannot be
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Replace a picture that exists
    #[arg(long, requires = "picture")]
    pub force: bool,
    /// Which animation, where a capture holds several (default: the longest)
    #[arg(long, value_name = "NAME")]
    pub clip: Option<String>,
    /// The skeleton of an AMC capture (default: found beside it)
    #[arg(long, value_name = "FILE.asf")]
    pub skeleton: Option<PathBuf>,
    /// Frames per second of a capture that does not say
    #[arg(long, value_name = "HZ", value_parser = parse_positive)]
    pub rate: Option<f64>,
}

/// Arguments of the main job.
#[derive(Clone, Debug, Args)]
pub struct Animate {
    /// The mesh to animate: OBJ, PLY, STL, OFF, glTF or GLB (also .gz and .zip)
    pub scan: PathBuf,
    /// The motion: markers in C3D, TRC or CSV; a skeleton in BVH, AMC, glTF, GLB or FBX (all also .gz); meshes that nodes move in glTF or GLB, or one
    /// of a sequence of meshes with running numbers; or a table of handles (see --handles) in a .csv file
    pub capture: PathBuf,
    /// What to write; the extension is the format: .glb, .abc, .usdc, .usda, .usdz, .pc2, .mdd, .html (a page that plays), .png (a sheet of frames), .apng (an
    /// animation), or .ply/.obj with a run of # for the frame number (repeatable)
    #[arg(short, long = "out", value_name = "FILE", required = true)]
    pub out: Vec<PathBuf>,
    /// How far a .glb or .html may be from the motion at the worst vertex of the worst frame, in percent of the scan's diagonal (default 0.25), and a fifth
    /// of it root mean square: as many joints are taken as that needs; where it cannot be met, that is an error
    #[arg(long, hide_short_help = true, value_name = "PCT", value_parser = parse_percent)]
    pub tolerance: Option<f64>,
    /// By what a .glb or .html holds the motion
    #[arg(long, hide_short_help = true, value_enum, default_value_t = EncodeArg::Auto)]
    pub encode: EncodeArg,
    /// Give the vertices of a .glb the number of the scan's vertex (from 0) that they are copies of, as the attribute _SOURCE_INDEX
    #[arg(long, hide_short_help = true)]
    pub source_index: bool,
    /// Replace outputs that exist
    #[arg(long)]
    pub force: bool,
    /// Write measures of every frame and all decisions as JSON
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Exit with 4 when a handle stays farther than this from its target in any frame, in mm (in the scan's unit where that is not known); the outputs
    /// are written all the same
    #[arg(long, value_name = "MM", value_parser = parse_positive)]
    pub fail_above: Option<f64>,
    /// Draw the scan from four sides with the attachment points, markers and joints and their names, before the frames are solved
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,

    /// Handles to pull the scan by, beside the markers: rows of frame,name,x,y,z and, if they turn, qx,qy,qz,qw in the scan's coordinates and unit,
    /// under a line with these names. A handle is fixed to the scan as it is in its first frame; without a row it is missing in that frame
    #[arg(long, hide_short_help = true, value_name = "FILE.csv")]
    pub handles: Option<PathBuf>,

    /// Let a handle of a table hold a part of the scan and prescribe its place and orientation, for example lid=group:lid; without, a handle that turns
    /// holds what surrounds it (repeatable)
    #[arg(long, hide_short_help = true, value_name = "NAME=WHAT")]
    pub hold: Vec<Hold>,

    /// The same, to rounding: the part is rigid and exactly where the handle puts it; where the handle has no row, it stays
    #[arg(long, hide_short_help = true, value_name = "NAME=WHAT")]
    pub hold_exact: Vec<Hold>,

    /// Only these frames, inclusive, in the capture's own numbering (for example 120..480)
    #[arg(long, value_name = "A..B", value_parser = parse_frames, help_heading = "Time", allow_hyphen_values = true)]
    pub frames: Option<(i64, i64)>,

    /// Write so many frames per second: positions are interpolated by cubics between the frames of the capture. Frames are counted on from the
    /// first one, which keeps its number; --frames and --ref stay in the capture's own numbering
    #[arg(long, value_name = "N", value_parser = parse_rate, help_heading = "Time")]
    pub fps: Option<f64>,
    /// Weaken motion of markers, joints or vertices faster than this, without a shift in time (6 to 12 Hz for a person; default: off)
    #[arg(long, value_name = "HZ", value_parser = parse_positive, help_heading = "Time")]
    pub smooth: Option<f64>,
    /// Frames per second where the capture does not say. Without: 30 for tables of handles and sequences of meshes, 100 for tables of markers,
    /// 120 for AMC
    #[arg(long, hide_short_help = true, value_name = "HZ", value_parser = parse_positive, help_heading = "Time")]
    pub rate: Option<f64>,

    /// How the capture is brought onto the scan
    #[arg(long, value_enum, default_value_t = Align::Auto, help_heading = "Placement")]
    pub align: Align,
    /// Reference frame, in which the body stands most like the scan: auto or a frame number
    #[arg(long = "ref", value_name = "auto|N", default_value = "auto", value_parser = parse_reference, help_heading = "Placement", allow_hyphen_values = true)]
    pub reference: Reference,
    /// A static trial of the same markers to take the reference frame from
    #[arg(long, value_name = "FILE.c3d", help_heading = "Placement")]
    pub ref_file: Option<PathBuf>,
    /// Take the bones or rigid bodies of a capture that holds markers too (Motive's CSV, rotations in C3D), or the nodes alone that move the meshes of
    /// a glTF
    #[arg(long, hide_short_help = true, help_heading = "Placement")]
    pub bodies: bool,
    /// Take the skinned meshes of a glTF as a captured surface, whose vertices become handles, instead of their joints
    #[arg(long, hide_short_help = true, conflicts_with = "bodies", help_heading = "Placement")]
    pub surface: bool,
    /// Which subject, where the capture holds several
    #[arg(long, hide_short_help = true, value_name = "NAME", help_heading = "Placement")]
    pub subject: Option<String>,
    /// Which animation, where the capture holds several (default: the longest)
    #[arg(long, hide_short_help = true, value_name = "NAME", help_heading = "Capture")]
    pub clip: Option<String>,
    /// The skeleton of an AMC capture (default: found beside it)
    #[arg(long, hide_short_help = true, value_name = "FILE.asf", help_heading = "Capture")]
    pub skeleton: Option<PathBuf>,
    /// What you say once and keep of a scan and its captures: units, axes, meanings of labels, joints of the scan, rigid parts, and the decisions
    /// that --save-rig wrote (TOML; the command line wins)
    #[arg(long, value_name = "FILE.toml", help_heading = "Placement")]
    pub rig: Option<PathBuf>,
    /// Write the file of --rig with the decisions of this run on placement and markers or joints, to be edited and fed back for this and other takes of the
    /// same actor
    #[arg(long, value_name = "FILE.toml", help_heading = "Placement")]
    pub save_rig: Option<PathBuf>,
    /// Size of the scan against the captured body, both in metres (1 = the same), instead of fitting it
    #[arg(long, hide_short_help = true, value_name = "X", value_parser = parse_positive, help_heading = "Placement")]
    pub scale: Option<f64>,
    /// Turn the capture about its up axis, degrees, instead of finding the facing
    #[arg(long, value_name = "DEG", value_parser = parse_finite, help_heading = "Placement", allow_hyphen_values = true)]
    pub yaw: Option<f64>,
    /// Turn the capture by half a turn about up
    #[arg(long, hide_short_help = true, help_heading = "Placement")]
    pub flip: bool,
    /// Mirror the capture (left becomes right)
    #[arg(long, hide_short_help = true, help_heading = "Placement")]
    pub mirror: bool,
    /// Exchange the L and R labels of the capture
    #[arg(long, hide_short_help = true, help_heading = "Placement")]
    pub swap_sides: bool,
    /// Unit of the scan: mm, cm, dm, m, in, ft
    #[arg(long, hide_short_help = true, value_name = "UNIT", help_heading = "Placement")]
    pub scan_unit: Option<Unit>,
    /// Axis of the scan that points up: +X, -X, +Y, ...
    #[arg(long, hide_short_help = true, value_name = "AXIS", help_heading = "Placement", allow_hyphen_values = true)]
    pub scan_up: Option<Axis>,
    /// Unit of the capture: mm, cm, dm, m, in, ft
    #[arg(long, hide_short_help = true, value_name = "UNIT", help_heading = "Placement")]
    pub capture_unit: Option<Unit>,
    /// Axis of the capture that points up: +X, -X, +Y, ...
    #[arg(long, hide_short_help = true, value_name = "AXIS", help_heading = "Placement", allow_hyphen_values = true)]
    pub capture_up: Option<Axis>,
    /// Feet that rest on the floor in a retargeted capture: held there on the scan (auto), or free to slide (off)
    #[arg(long, value_enum, default_value_t = Plant::Auto, help_heading = "Placement")]
    pub plant: Plant,
    /// Go on with a warning where the placement would be refused as doubtful
    #[arg(long, hide_short_help = true, help_heading = "Placement")]
    pub accept_doubtful: bool,

    /// Surface vertices of the proxy, 100 to 100000 (default: 3000, for shells 1000)
    #[arg(long, hide_short_help = true, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=100_000), help_heading = "Proxy")]
    pub proxy_vertices: Option<u32>,
    /// With shells: so many steps on the whole scan after the coarse mesh is solved, in every frame
    #[arg(long, hide_short_help = true, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Proxy")]
    pub refine: Option<u32>,
    /// Use this tetrahedral mesh (MEDIT, in the scan's coordinates) as the proxy
    #[arg(long, hide_short_help = true, value_name = "FILE.mesh", help_heading = "Proxy")]
    pub proxy: Option<PathBuf>,
    /// Write the proxy (MEDIT, in the scan's coordinates)
    #[arg(long, hide_short_help = true, value_name = "FILE.mesh", help_heading = "Proxy")]
    pub save_proxy: Option<PathBuf>,
    /// How scan vertices and handles follow the proxy: ring-averaged gradients, or the paper's formulas to the letter
    #[arg(long, hide_short_help = true, value_enum, default_value_t = Map::Ring, help_heading = "Proxy")]
    pub map: Map,
    /// Keep the shape of a part of the scan, for example group:armor_* (repeatable). Head, hands and feet of a person keep theirs where few markers are
    /// on them; --stiffness ends=1 lets them bend
    #[arg(long, value_name = "WHAT", help_heading = "Parts")]
    pub rigid: Vec<Selector>,
    /// Make a part of the scan stiffer (above 1) or softer, for example upper_arms=3 against arms that bow (repeatable, later ones win)
    #[arg(long, value_name = "WHAT=X", help_heading = "Parts")]
    pub stiffness: Vec<Stiffness>,

    /// The shell deformer and its examples: those of [`Cli::shells`], which [`Cli::main_job`] puts here.
    #[arg(skip)]
    pub shells: ShellArgs,
    /// How near to the minimum of its energy each frame is solved; --report tells the estimated error of every frame
    #[arg(long, hide_short_help = true, value_enum, default_value_t = QualityArg::Default, help_heading = "Solve")]
    pub quality: QualityArg,
    /// A fixed count of plain iterations per frame (the paper's mode) instead of solving to a tolerance
    #[arg(long, hide_short_help = true, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), help_heading = "Solve")]
    pub iterations: Option<u32>,
    /// Largest move of a vertex in the last step of a frame, in diagonals of the body, in place of the one that --quality stands for
    #[arg(long, hide = true, value_name = "DIAGONALS", value_parser = parse_positive, conflicts_with = "iterations", help_heading = "Solve")]
    pub solve_tolerance: Option<f64>,

    /// Keep what set-up computes of the scan in this folder, for other takes of the same scan; the outputs are the same bytes with and without
    #[arg(long, hide_short_help = true, value_name = "DIR", help_heading = "Machine")]
    pub cache: Option<PathBuf>,
    /// Megabytes that the folder of --cache may hold: what was not used for the longest time goes
    #[arg(long, hide_short_help = true, value_name = "MB", default_value_t = 4096, value_parser = clap::value_parser!(u64).range(1..=1 << 30), help_heading = "Machine")]
    pub cache_size: u64,
    /// Threads to use (default: all cores); the outputs are the same bytes for any number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Machine")]
    pub threads: Option<u16>,
    /// Print errors only
    #[arg(short, long, conflicts_with = "verbose", help_heading = "Machine")]
    pub quiet: bool,
    /// Print timings and every bound marker
    #[arg(short, long, help_heading = "Machine")]
    pub verbose: bool,
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definitions_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn the_main_job_and_a_subcommand_share_the_line() {
        let cli =
            Cli::try_parse_from(["retarget", "a.obj", "b.c3d", "-o", "c.glb", "-o", "d.pc2", "--frames", "-5..20"]).unwrap();
        let animate = cli.main_job().unwrap();
        assert_eq!(animate.out.len(), 2);
        assert_eq!(animate.frames, Some((-5, 20)));
        assert_eq!(animate.rate, None, "what is usual differs from format to format");
        assert!(!animate.shells.are_chosen().unwrap());
        let words = ["retarget", "a.obj", "b.c3d", "--examples", "c.obj", "d.obj", "-o", "c.glb", "--weight-range", "convex"];
        let animate = Cli::try_parse_from(words).unwrap().main_job().unwrap();
        assert!(animate.shells.examples.len() == 2 && animate.shells.are_chosen().unwrap());
        let cli = Cli::try_parse_from(["retarget", "inspect", "a.obj"]).unwrap();
        assert!(matches!(cli.command, Some(Command::Inspect(i)) if i.files.len() == 1));
        assert!(Cli::try_parse_from(["retarget", "a.obj", "b.c3d"]).is_err(), "an output is required");
    }
}
