//! Rigid parts and stiffness: what is said of parts of the scan, brought onto the tetrahedra of the proxy.

use super::select::{self, ROUND_JOINTS, Selector, Stiffness, What};
use super::{Binding, Limbs, Segment};
use crate::error::{Error, Kind, Result};
use crate::proxy::Proxy;
use crate::scan::{NONE, Scan, UnitBox};
use crate::spatial::{PointTree, TriangleTree};
use glam::DVec3;

/// What is asked of parts of the scan, in the order in which it applies: where parts overlap, the later rule wins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rules(Vec<Rule>);

#[derive(Clone, Debug, PartialEq)]
struct Rule {
    what: Selector,
    /// How stiff; `None`: a rigid body.
    factor: Option<f64>,
    /// Whether it is left out where it selects nothing.
    may_be_empty: bool,
}

/// Ends of limbs with more markers than this are measured well enough to bend.
const TELLS_BENDS: usize = 5;
/// Limbs with fewer markers of their own than this bow between the joints.
const TELLS_BOWS: usize = 2;
/// Stiffness of the shafts of such upper arms. They bow most, where the scan holds the arms out and the actor does not.
const UPPER_ARM: f64 = 10.0;
/// The same of forearms, thighs and shanks: stiffer ones crease the joints between them.
const SHAFT: f64 = 3.0;

impl Rules {
    /// What holds for bodies, as far as the markers do not tell better: heads, hands and feet are rigid, shafts of limbs that have next to no marker
    /// are stiffer. Nothing where parts are not known or markers do not belong to parts.
    pub fn of_body(binding: &Binding) -> Self {
        use Segment::*;
        let mut rules = Self::default();
        let bound = &binding.handles[..binding.decisions.bound.min(binding.handles.len())];
        let markers = |s: Segment| bound.iter().filter(|h| h.segment == Some(s)).count();
        let named = Segment::ALL.into_iter().any(|s| markers(s) > 0);
        if !named || binding.segments.is_empty() || binding.decisions.scan_height.is_none() {
            return rules;
        }
        let shaft = |s: &Segment| markers(*s) < TELLS_BOWS;
        let upper_arms: Vec<Segment> = [LeftUpperArm, RightUpperArm].into_iter().filter(shaft).collect();
        let limbs = [LeftForearm, RightForearm, LeftThigh, RightThigh, LeftShank, RightShank];
        let ends = [Head, LeftHand, RightHand, LeftFoot, RightFoot];
        for (segments, factor) in [
            (upper_arms, Some(UPPER_ARM)),
            (limbs.into_iter().filter(shaft).collect(), Some(SHAFT)),
            (ends.into_iter().filter(|s| markers(*s) <= TELLS_BENDS).collect(), None),
        ] {
            let rule = |what| Rule { what, factor, may_be_empty: true };
            rules.0.extend(Selector::of_segments(segments).into_iter().map(rule));
        }
        rules
    }

    /// Adds a part that moves like a rigid body; pieces of it that do not touch turn as one.
    pub fn rigid(&mut self, what: Selector) {
        self.0.push(Rule { what, factor: None, may_be_empty: false });
    }

    /// Adds a part that is stiffer or softer than the body.
    pub fn stiffness(&mut self, rule: Stiffness) {
        self.0.push(Rule { what: rule.what, factor: Some(rule.factor), may_be_empty: false });
    }

    /// Whether nothing is asked for.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Parts of the proxy.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Regions {
    /// Stiffness of each tetrahedron, 1 in rigid parts; empty where nothing was asked for.
    pub stiffness: Vec<f64>,
    /// Tetrahedra of each rigid part, rising.
    pub rigid: Vec<Vec<u32>>,
    /// What was asked for, the stiffness (`None` where it is rigid), and how many tetrahedra it took.
    pub counts: Vec<(String, Option<f64>, usize)>,
}

impl Regions {
    /// Brings rules onto the proxy.
    ///
    /// # Errors
    /// As [`Subject::select`].
    pub fn new(subject: &Subject<'_>, rules: &Rules) -> Result<Self> {
        if rules.is_empty() {
            return Ok(Self::default());
        }
        let tets = subject.proxy.tets.len();
        let mut stiffness = vec![1.0; tets];
        let mut part_of = vec![None; tets];
        let mut counts = Vec::new();
        let mut parts = 0;
        for rule in &rules.0 {
            let sets = match subject.select(&rule.what) {
                Err(_) if rule.may_be_empty => continue,
                sets => sets?,
            };
            for set in &sets {
                for &t in set {
                    stiffness[t as usize] = rule.factor.unwrap_or(1.0);
                    part_of[t as usize] = rule.factor.is_none().then_some(parts);
                }
                parts += usize::from(rule.factor.is_none());
            }
            counts.push((rule.what.to_string(), rule.factor, sets.iter().map(Vec::len).sum()));
        }
        let mut rigid = vec![Vec::new(); parts];
        for (t, part) in (0u32..).zip(&part_of) {
            if let Some(part) = part {
                rigid[*part].push(t);
            }
        }
        rigid.retain(|part| !part.is_empty());
        Ok(Self { stiffness, rigid, counts })
    }

    /// Whether the tetrahedron nearest to each place belongs to a rigid part. `places` in the unit box.
    pub fn on_rigid(&self, proxy: &Proxy, places: impl Iterator<Item = DVec3>) -> Vec<bool> {
        if self.rigid.is_empty() {
            return places.map(|_| false).collect();
        }
        let mut rigid = vec![false; proxy.tets.len()];
        self.rigid.iter().flatten().for_each(|&t| rigid[t as usize] = true);
        let tree = PointTree::new(&centroids(proxy));
        let mut found = Vec::new();
        places
            .map(|p| {
                tree.nearest(p, 1, &mut found);
                found.first().is_some_and(|n| rigid[n.point])
            })
            .collect()
    }

    /// `head rigid: 213 · upper_arms × 10: 96 tetrahedra`; empty where nothing was asked for.
    pub fn words(&self) -> String {
        let how = |factor: &Option<f64>| factor.map_or("rigid".to_owned(), |f| format!("× {f}"));
        let parts: Vec<String> =
            self.counts.iter().map(|(what, factor, tets)| format!("{what} {}: {tets}", how(factor))).collect();
        if parts.is_empty() { String::new() } else { parts.join(" · ") + " tetrahedra" }
    }
}

fn centroids(proxy: &Proxy) -> Vec<DVec3> {
    proxy.tets.iter().map(|t| t.iter().map(|&v| proxy.rest[v as usize]).sum::<DVec3>() * 0.25).collect()
}

/// A scan with its proxy and its binding, of which parts are selected.
#[derive(Clone, Debug)]
pub struct Subject<'a> {
    scan: &'a Scan,
    points: &'a [DVec3],
    unit_box: UnitBox,
    proxy: &'a Proxy,
    binding: &'a Binding,
    /// Where limbs touch: what belongs to which.
    limbs: Option<&'a Limbs>,
    centroids: Vec<DVec3>,
}

impl<'a> Subject<'a> {
    /// `points`: the scan's vertices in the unit box.
    pub fn new(scan: &'a Scan, points: &'a [DVec3], unit_box: UnitBox, proxy: &'a Proxy, binding: &'a Binding) -> Self {
        Self { scan, points, unit_box, proxy, binding, limbs: None, centroids: centroids(proxy) }
    }

    /// The same, with limbs that touch told apart.
    #[must_use]
    pub fn with_limbs(self, limbs: Option<&'a Limbs>) -> Self {
        Self { limbs, ..self }
    }

    /// The proxy of the scan.
    pub fn proxy(&self) -> &'a Proxy {
        self.proxy
    }

    /// The vertices of the proxy in a part, rising.
    ///
    /// # Errors
    /// As [`Self::select`].
    pub fn vertices(&self, selector: &Selector) -> Result<Vec<u32>> {
        let tets = self.select(selector)?;
        let mut vertices: Vec<u32> = tets.iter().flatten().flat_map(|&t| self.proxy.tets[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        Ok(vertices)
    }

    /// The tetrahedra of each part that a selector names.
    ///
    /// # Errors
    /// [`Kind::Usage`] for names that the scan or the binding does not know, with the nearest that they do; [`Kind::Refused`] for a part
    /// that is empty.
    pub fn select(&self, selector: &Selector) -> Result<Vec<Vec<u32>>> {
        let sets = match &selector.what {
            What::Group(pattern) => vec![self.group(selector, pattern)?],
            What::Color { rgb, tolerance } => vec![self.color(selector, *rgb, *tolerance)?],
            What::Sphere { centre, radius } => {
                vec![self.having(|c| self.unit_box.leave(c).distance(*centre) <= *radius)]
            }
            What::Near(names) => vec![self.near(selector, names)?],
            What::Part(parts) => parts.iter().map(|part| self.part(selector, part)).collect::<Result<_>>()?,
        };
        if sets.iter().all(Vec::is_empty) {
            return Err(self.empty(selector));
        }
        Ok(sets.into_iter().filter(|set| !set.is_empty()).collect())
    }

    fn having(&self, test: impl Fn(DVec3) -> bool) -> Vec<u32> {
        (0u32..).zip(&self.centroids).filter(|(_, c)| test(**c)).map(|(t, _)| t).collect()
    }

    /// By the face of the scan nearest to each centroid and the place on it.
    fn by_skin(&self, test: impl Fn(usize, [u32; 3], [f64; 3]) -> bool) -> Vec<u32> {
        let cut = self.scan.mesh.triangulate();
        let vertices: Vec<[u32; 3]> =
            cut.corners.iter().map(|t| t.map(|corner| self.scan.mesh.faces.corners[corner as usize])).collect();
        let tree = TriangleTree::new(self.points, &vertices);
        self.having(|c| {
            tree.closest(c).is_some_and(|near| test(cut.faces[near.triangle] as usize, vertices[near.triangle], near.barycentric))
        })
    }

    fn group(&self, selector: &Selector, pattern: &str) -> Result<Vec<u32>> {
        let look = &self.scan.look;
        let names = |g: usize| {
            let group = look.groups[g].group.iter().flat_map(|all| std::iter::once(all.as_str()).chain(all.split_whitespace()));
            look.groups[g].object.iter().map(String::as_str).chain(group)
        };
        let chosen: Vec<bool> = (0..look.groups.len()).map(|g| names(g).any(|name| select::matches(pattern, name))).collect();
        if !chosen.contains(&true) {
            let mut known: Vec<&str> = (0..look.groups.len()).flat_map(names).collect();
            known.sort_unstable();
            known.dedup();
            return Err(self.unknown(selector, "the scan has no such group or object", pattern, &known, "group:"));
        }
        Ok(self.by_skin(|face, _, _| {
            let group = look.face_groups.get(face).copied().unwrap_or(NONE);
            chosen.get(group as usize).copied().unwrap_or(false)
        }))
    }

    fn color(&self, selector: &Selector, rgb: [u8; 3], tolerance: f64) -> Result<Vec<u32>> {
        let colors = &self.scan.look.colors;
        if colors.is_empty() {
            return Err(Error::new(Kind::Usage, format!("{selector}: the scan has no vertex colours"))
                .file(&self.scan.source)
                .hint("group:NAME, sphere:X,Y,Z,R or a PLY file with colours"));
        }
        // Between two colours there would be a third one: the nearest corner decides.
        Ok(self.by_skin(|_, corners, weights| {
            let nearest = (0..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
            let color = colors.get(corners[nearest] as usize);
            color.is_some_and(|c| (0..3).all(|k| (f64::from(c[k]) * 255.0 - f64::from(rgb[k])).abs() <= tolerance + 0.5))
        }))
    }

    fn near(&self, selector: &Selector, names: &[String]) -> Result<Vec<u32>> {
        let points = self.binding.handles.iter().map(|h| (h.known_as(), h.attachment));
        let turning = self.binding.turning.handles.iter().map(|h| (h.name.as_str(), h.rest));
        let (known, places): (Vec<&str>, Vec<DVec3>) = points.chain(turning).unzip();
        for name in names {
            if !known.iter().any(|label| label.eq_ignore_ascii_case(name)) {
                let mut once = known.clone();
                once.dedup();
                return Err(self.unknown(selector, &format!("there is no handle {name}"), name, &once, "near:"));
            }
        }
        let chosen: Vec<bool> = known.iter().map(|label| names.iter().any(|n| label.eq_ignore_ascii_case(n))).collect();
        let tree = PointTree::new(&places);
        let mut found = Vec::new();
        let mut tets = Vec::new();
        for (t, &c) in (0u32..).zip(&self.centroids) {
            tree.nearest(c, 1, &mut found);
            if found.first().is_some_and(|n| chosen[n.point]) {
                tets.push(t);
            }
        }
        Ok(tets)
    }

    /// What is nearer to these segments than to others, without what surrounds the joints to others.
    fn part(&self, selector: &Selector, part: &[Segment]) -> Result<Vec<u32>> {
        let (segments, height) = (&self.binding.segments, self.binding.decisions.scan_height);
        let Some(height) = height.filter(|_| !segments.is_empty()) else {
            return Err(Error::new(Kind::Usage, format!("{selector}: the parts of this body are not known"))
                .file(&self.scan.source)
                .expected("a standing person with arms and legs apart")
                .hint("group:NAME, color:#rrggbb, sphere:X,Y,Z,R or near:HANDLE"));
        };
        let radius = ROUND_JOINTS * height / self.unit_box.diagonal;
        let place = |s: Segment| segments.iter().find(|p| p.segment == s);
        let joints: Vec<DVec3> = segments
            .iter()
            .filter(|p| p.segment.parent().is_some_and(|parent| part.contains(&parent) != part.contains(&p.segment)))
            .map(|p| p.from)
            .collect();
        let suits = |t: &[u32; 4], s: Segment| self.limbs.is_none_or(|limbs| t.iter().all(|&v| limbs.suits(v, s)));
        let tets = (0u32..).zip(self.proxy.tets.iter().zip(&self.centroids));
        let chosen = tets.filter(|(_, (tet, c))| {
            let c = **c;
            let mut nearest = (f64::INFINITY, None);
            for p in segments.iter().filter(|p| suits(tet, p.segment)) {
                // The pelvis is told from neck to hips; its own share ends where the trunk begins.
                let to = if p.segment == Segment::Pelvis { place(Segment::Trunk).map_or(p.to, |t| t.from) } else { p.to };
                let distance = from_line(c, p.from, to);
                if distance < nearest.0 {
                    nearest = (distance, Some(p.segment));
                }
            }
            nearest.1.is_some_and(|s| part.contains(&s)) && joints.iter().all(|j| j.distance(c) > radius)
        });
        Ok(chosen.map(|(t, _)| t).collect())
    }

    fn unknown(&self, selector: &Selector, found: &str, word: &str, known: &[&str], prefix: &str) -> Error {
        let error = Error::new(Kind::Usage, format!("{selector}: {found}")).file(&self.scan.source);
        let error = match known {
            [] => error,
            _ => error.expected(format!("one of {}", select::some_of(known.iter().map(|k| (*k).to_owned())))),
        };
        match select::nearest(word, known.iter().copied()) {
            Some(near) => error.hint(format!("{prefix}{near}")),
            None => error,
        }
    }

    fn empty(&self, selector: &Selector) -> Error {
        let lo = self.points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let hi = self.points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let error = Error::refused(format!("{selector}: selects nothing of the proxy")).file(&self.scan.source);
        let triple = |p: DVec3| format!("({:.3} {:.3} {:.3})", p.x, p.y, p.z);
        match selector.what {
            What::Sphere { .. } => error.expected(format!(
                "a ball that meets the scan, which lies within {} .. {}",
                triple(self.unit_box.leave(lo)),
                triple(self.unit_box.leave(hi))
            )),
            What::Color { .. } => error.hint("a larger tolerance after ~, or a finer proxy: --proxy-vertices"),
            _ => error.hint("a larger part, or a finer proxy: --proxy-vertices"),
        }
    }
}

fn from_line(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let axis = b - a;
    let along = ((p - a).dot(axis) / axis.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    p.distance(a + axis * along)
}
