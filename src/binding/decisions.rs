//! What the binding decided, as values and in words.

use super::Align;
use crate::space::{Axis, Known, Unit};
use crate::words;
use glam::DVec3;

/// What the moving points of a skeleton are called.
const JOINT: &str = "joint";
/// Length ratios farther from 1 than this are named.
const OTHER_LENGTH: f64 = 0.05;

/// The decisions of a binding.
#[derive(Clone, Debug)]
pub struct Decisions {
    /// How the capture was brought onto the scan; never `Auto`.
    pub align: Align,
    /// What a moving point of the capture is called: marker, joint, vertex.
    pub noun: &'static str,
    /// Whether the markers were laid on the skin itself: the scan is the actor's own, in the pose of the reference frame.
    pub on_skin: bool,
    /// The reference frame in the numbering of its capture.
    pub reference_frame: i64,
    /// First and last frame of the capture that holds the reference frame.
    pub reference_range: (i64, i64),
    /// Name of that capture where it is not the take itself.
    pub reference_capture: Option<String>,
    /// Whether turns are read against the rest pose of the capture's file; the reference frame tells the place only then.
    pub reference_rest: bool,
    /// Size of the scan against the actor, units converted.
    pub scale: f64,
    /// Turn of the capture about the scan's up axis, in degrees.
    pub yaw: f64,
    /// Unit of the scan.
    pub scan_unit: Option<Known<Unit>>,
    /// Up axis of the scan, or its direction where it is no axis.
    pub scan_up: Option<Known<DVec3>>,
    /// Direction that the scan faces.
    pub scan_forward: Option<Known<DVec3>>,
    /// Height of the body in the scan, in the scan's unit.
    pub scan_height: Option<f64>,
    /// Unit of the capture.
    pub capture_unit: Option<Known<Unit>>,
    /// Up axis of the capture.
    pub capture_up: Option<Known<Axis>>,
    /// Height of the actor in the capture's unit.
    pub actor_height: Option<f64>,
    /// Marker set that the labels belong to.
    pub set: Option<&'static str>,
    /// Markers that the dictionary names.
    pub named: usize,
    /// Markers in the take.
    pub markers: usize,
    /// Markers bound.
    pub bound: usize,
    /// Median and largest distance of the attachments from the skin in the scan's unit, and the marker of the largest.
    pub off_surface: Option<(f64, f64, String)>,
    /// Median and 90th percentile of the distance between the markers and their landmarks after the fit, in per cent of stature.
    pub residual: Option<(f64, f64)>,
    /// Length ratios, actor to scan, at the actor's overall size.
    pub proportions: Vec<(&'static str, f64)>,
    /// Median and 95th percentile of the change of distance between neighbouring handles over the take, in per cent.
    pub strain: Option<(f64, f64)>,
    /// How far resting feet slid on the scan before they were held, and after, in the scan's unit.
    pub feet: Option<Slip>,
}

/// Sliding of feet that rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Times that a heel or ball rested on the floor.
    pub contacts: usize,
    /// Way of the point that rests, median and worst over the contacts, of the joints as they come.
    pub before: (f64, f64),
    /// The same of what the scan follows.
    pub after: (f64, f64),
}

impl Decisions {
    /// Height, unit, up and facing of the scan.
    pub fn scan_words(&self) -> String {
        let mut words = Vec::new();
        if let Some(height) = self.scan_height {
            words.push(match self.scan_unit {
                Some(unit) => format!("{:.2} m tall", height * unit.value.metres()),
                None => format!("height {height:.2} (unit?)"),
            });
        }
        if let Some(unit) = self.scan_unit {
            words.push(unit.value.to_string());
        }
        if let Some(up) = self.scan_up {
            let facing = self.scan_forward.map_or(String::new(), |f| format!(", facing {}", direction(f.value)));
            let how = self.scan_forward.map_or(up.how, |f| f.how);
            words.push(format!("{} up{facing} ({how})", direction(up.value)));
        }
        words.join(" · ")
    }

    /// Unit, up axis and actor of the capture.
    pub fn capture_words(&self) -> String {
        let mut words = Vec::new();
        if let Some(unit) = self.capture_unit {
            words.push(format!("{} ({})", unit.value, unit.how));
        }
        if let Some(up) = self.capture_up {
            words.push(format!("{} up ({})", up.value, up.how));
        }
        if let (Some(height), Some(unit)) = (self.actor_height, self.capture_unit) {
            words.push(format!("actor {:.2} m", height * unit.value.metres()));
        }
        // Of joints the line about the binding says it.
        if self.named > 0 && self.noun != JOINT {
            let set = self.set.map_or(String::new(), |set| format!(" ({set})"));
            words.push(format!("{} of {} named{set}", self.named, words::plural(self.markers, self.noun)));
        }
        words.join(" · ")
    }

    /// How the joints were told.
    fn joint_words(&self) -> String {
        let joints = words::plural(self.markers, self.noun);
        match (self.align, self.named) {
            (Align::None, _) => format!("{joints} as they lie"),
            (_, 0) => format!("{joints} told by their form"),
            (_, named) => format!("{named} of {joints} named{}", self.set.map_or(String::new(), |set| format!(" ({set})"))),
        }
    }

    /// The line about the binding itself.
    pub fn bind_line(&self) -> String {
        let (first, last) = self.reference_range;
        let of = self.reference_capture.as_ref().map_or(String::new(), |name| format!(" of {name}"));
        let frame = format!("{}{of} ({first}\u{2013}{last})", self.reference_frame);
        let mut words = vec![
            format!("{}{}", self.align, if self.on_skin { " by the skin" } else { "" }),
            match (self.reference_rest, self.align) {
                (true, Align::None) => "reference the file's rest".to_owned(),
                (true, _) => format!("reference the file's rest, placed in frame {frame}"),
                (false, _) => format!("reference frame {frame}"),
            },
            format!("scale {:.3}", self.scale),
            format!("yaw {:.0}°", self.yaw.round() + 0.0),
        ];
        let mut bound = match self.align {
            _ if self.noun == JOINT => format!("{} \u{b7} {} points hold the body", self.joint_words(), self.bound),
            _ => format!("{} of {} bound", self.bound, words::plural(self.markers, self.noun)),
        };
        if let Some((median, worst, label)) = &self.off_surface {
            let length = |x: f64| match self.scan_unit {
                Some(unit) => format!("{:.0} mm", x * unit.value.metres() * 1000.0),
                None => format!("{x:.3}"),
            };
            bound += &format!(", median {} off the surface, worst {} ({label})", length(*median), length(*worst));
        }
        words.push(bound);
        let other: Vec<String> = self
            .proportions
            .iter()
            .filter(|(_, ratio)| self.align == Align::Retarget && self.noun != JOINT && (ratio - 1.0).abs() > OTHER_LENGTH)
            .map(|(name, ratio)| format!("{name} {ratio:.2}"))
            .collect();
        if !other.is_empty() {
            words.push(format!("actor against scan: {}", other.join(", ")));
        }
        if let Some((median, p90)) = self.residual {
            words.push(format!("fit median {median:.1} %, p90 {p90:.1} % of height"));
        }
        if let Some(feet) = &self.feet {
            let way = |x: f64| match self.scan_unit {
                Some(unit) => format!("{:.0}", x * unit.value.metres() * 1000.0),
                None => format!("{x:.3}"),
            };
            let unit = if self.scan_unit.is_some() { " mm" } else { "" };
            words.push(format!(
                "{} held, sliding median {} \u{2192} {}{unit}, worst {} \u{2192} {}{unit}",
                words::plural(feet.contacts, "footfall"),
                way(feet.before.0),
                way(feet.after.0),
                way(feet.before.1),
                way(feet.after.1),
            ));
        }
        if let Some((median, p95)) = self.strain {
            words.push(format!("strain median {median:.1} %, p95 {p95:.1} %"));
        }
        words.join(" · ")
    }
}

/// A direction as the nearest axis, with its angle where it is not that axis.
fn direction(v: DVec3) -> String {
    let axis = Axis::nearest(v);
    let angle = v.normalize_or_zero().dot(axis.vector()).clamp(-1.0, 1.0).acos().to_degrees();
    let sign = if axis.negative { "\u{2212}" } else { "" };
    let name = format!("{sign}{}", ['X', 'Y', 'Z'][axis.index]);
    if angle < 2.0 { name } else { format!("{name} ({angle:.0}° off)") }
}
