//! Handles and regions on the body that is solved.

use super::args::Animate;
use super::rig::Rig;
use crate::binding::regions::Subject;
use crate::binding::select::Hold;
use crate::binding::{Binding, Limbs, Regions, Rules, Segment};
use crate::deform::shells::{Body, SurfaceRows};
use crate::deform::{Grip, Handle, OrientedHandle};
use crate::error::{Notes, Result};
use crate::pipeline::grips::{self, Holding};
use crate::proxy::Proxy;
use crate::proxy::rows::HandleRows;
use crate::scan::{Scan, UnitBox};
use crate::surface::Apart;
use crate::words;
use glam::DVec3;

/// What is fitted to a body.
pub(super) struct Fitting<'a> {
    pub(super) args: &'a Animate,
    pub(super) rig: &'a Rig,
    pub(super) scan: &'a Scan,
    pub(super) points: &'a [DVec3],
    pub(super) unit_box: UnitBox,
    pub(super) binding: &'a Binding,
}

/// A body without the parts that nothing holds, with its handles and regions.
pub(super) struct Fitted {
    pub(super) proxy: Proxy,
    /// The same as a shell, where frames are solved by one.
    pub(super) shell: Option<Body>,
    pub(super) handles: Vec<Handle>,
    pub(super) oriented: Vec<OrientedHandle>,
    pub(super) regions: Regions,
}

impl Fitting<'_> {
    /// Fits everything to a body; `joined`: where parts are joined that only touch, if they do. Says what is left out of the body.
    pub(super) fn fit(
        &self,
        proxy: Proxy,
        shell: Option<Body>,
        mut apart: Option<&mut Apart>,
        joined: Option<&[DVec3]>,
    ) -> Result<(Fitted, Notes)> {
        let Self { args, rig, scan, points, unit_box, binding } = *self;
        let (mut proxy, mut shell, mut notes) = (proxy, shell, Notes::default());
        let (mut handles, mut oriented, mut regions) = (Vec::new(), Vec::new(), Regions::default());
        for _ in 0..2 {
            let limbs = joined.and_then(|joined| Limbs::of(&proxy, binding, unit_box.diagonal, joined));
            let subject = Subject::new(scan, points, unit_box, &proxy, binding).with_limbs(limbs.as_ref());
            regions = Regions::new(&subject, &rules(args, rig, binding))?;
            handles = attach(&proxy, shell.as_ref(), binding, &regions, limbs.as_ref(), args);
            oriented = grips::grips(&subject, &binding.turning.handles, &holdings(args))?;
            let Some(held) = held_components(&proxy, &handles, &oriented) else { break };
            if let Some(apart) = &mut apart {
                apart.proxy = proxy.vertices_of(|c| held[c as usize]).into_iter().map(|v| apart.proxy[v as usize]).collect();
            }
            proxy = proxy.with_components(|c| held[c as usize]);
            shell = shell.map(|body| body.with_components(|c| held[c as usize]));
            let loose = words::plural(held.iter().filter(|h| !**h).count(), "separate part");
            notes.warn(format!("{loose} of the scan without a marker: the nearest part of the body takes it along"));
        }
        Ok((Fitted { proxy, shell, handles, oriented, regions }, notes))
    }
}

/// Hardness of handles on rigid parts against others: a part that cannot bend towards each of its handles leaves them farther away.
const GRIP: f64 = 4.0;

/// What handles of tables hold.
pub(super) fn holdings(args: &Animate) -> Vec<Holding> {
    let holdings =
        |holds: &[Hold], exact| holds.iter().map(move |hold| Holding { hold: hold.clone(), exact }).collect::<Vec<_>>();
    [holdings(&args.hold, false), holdings(&args.hold_exact, true)].concat()
}

/// What is rigid or stiffer. A fixed count of plain iterations is for the energy as it was published.
fn rules(args: &Animate, rig: &Rig, binding: &Binding) -> Rules {
    let mut rules = if args.iterations.is_some() { Rules::default() } else { Rules::of_body(binding) };
    rig.rules(&mut rules);
    args.stiffness.iter().for_each(|rule| rules.stiffness(rule.clone()));
    args.rigid.iter().for_each(|what| rules.rigid(what.clone()));
    rules
}

/// The handles of the bound markers.
fn attach(
    proxy: &Proxy,
    shell: Option<&Body>,
    binding: &Binding,
    regions: &Regions,
    limbs: Option<&Limbs>,
    args: &Animate,
) -> Vec<Handle> {
    let surface = shell.map(SurfaceRows::new);
    let rows = HandleRows::new(proxy, args.map.into());
    // Where limbs touch, each segment has rows on its own limb.
    let own: Vec<HandleRows> =
        limbs.iter().flat_map(|limbs| Segment::ALL.map(|s| rows.among(proxy, |v| limbs.suits(v, s)))).collect();
    let on_rigid = regions.on_rigid(proxy, binding.handles.iter().map(|h| h.attachment));
    let handles = binding.handles.iter().zip(on_rigid);
    handles
        .map(|(h, rigid)| {
            let beta = if rigid && h.beta >= 1.0 { h.beta * GRIP } else { h.beta };
            Handle {
                name: h.label.clone(),
                row: match &surface {
                    Some(surface) => surface.row(h.attachment),
                    None => h.segment.and_then(|s| own.get(s as usize)).unwrap_or(&rows).row(h.attachment),
                },
                beta,
            }
        })
        .collect()
}

/// Which components of the proxy a handle holds; `None` where all or none are held.
fn held_components(proxy: &Proxy, handles: &[Handle], oriented: &[OrientedHandle]) -> Option<Vec<bool>> {
    let mut of_vertex = vec![0; proxy.rest.len()];
    for (tet, &component) in proxy.tets.iter().zip(&proxy.components) {
        tet.iter().for_each(|&v| of_vertex[v as usize] = component);
    }
    let count = proxy.components.iter().max().map_or(0, |&last| last as usize + 1);
    let mut held = vec![false; count];
    let mut hold = |vertices: &[u32]| vertices.iter().for_each(|&v| held[of_vertex[v as usize] as usize] = true);
    handles.iter().for_each(|handle| hold(&handle.row.indices));
    for handle in oriented {
        match &handle.grip {
            Grip::Frame { rows, .. } => rows.iter().for_each(|row| hold(&row.indices)),
            Grip::Region { vertices, .. } | Grip::Exact { vertices } => hold(vertices),
        }
    }
    (held.contains(&true) && held.contains(&false)).then_some(held)
}
