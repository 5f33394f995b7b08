//! First joints: clusters of points that move rigidly together, split where they do not.

use super::motion::FitPoints;
use super::rigid::Rigid;
use super::sample::{JointPlanes, Sample};
use crate::error::Result;
use crate::export::Cancel;
use glam::DVec3;
use rayon::prelude::*;

/// Smallest cluster that is split.
const SPLITTABLE: usize = 12;

/// Splits one cluster until there are `most` joints, or until every point stays within `tolerated` (root mean square over the frames).
///
/// A split founds a joint on the neighbours of the member that is far out and badly carried; three rounds of assignment and fit (Lloyd) follow.
pub fn split(points: &FitPoints, sample: &Sample, most: usize, tolerated: f64, cancel: &Cancel) -> Result<JointPlanes> {
    let rest = &points.rest;
    let everybody: Vec<u32> = (0..rest.len() as u32).collect();
    let mut joints = fit_groups(rest, sample, &[everybody], None);
    let enough = tolerated * tolerated * sample.len() as f64;
    while joints.joints() < most {
        cancel.check()?;
        let nearest = joints.nearest_joints(rest, sample);
        let clusters = gather(&nearest, joints.joints());
        let cost = |members: &[u32]| members.iter().map(|&i| nearest[i as usize].1).sum::<f64>();
        let mut order: Vec<usize> = (0..clusters.len()).collect();
        let costs: Vec<f64> = clusters.iter().map(|m| cost(m)).collect();
        order.sort_by(|&a, &b| costs[b].total_cmp(&costs[a]).then(a.cmp(&b)));
        let seeds: Vec<Vec<u32>> = order
            .iter()
            .take(most - joints.joints())
            .filter(|&&k| clusters[k].len() >= SPLITTABLE && clusters[k].iter().any(|&i| nearest[i as usize].1 > enough))
            .map(|&k| founders(rest, &clusters[k], &nearest))
            .collect();
        if seeds.is_empty() {
            break;
        }
        joints.extend(&fit_groups(rest, sample, &seeds, None));
        for _ in 0..3 {
            let clusters = gather(&joints.nearest_joints(rest, sample), joints.joints());
            joints = fit_groups(rest, sample, &clusters, Some(&joints));
        }
    }
    Ok(joints)
}

/// Members of each cluster.
fn gather(nearest: &[(usize, f64)], joints: usize) -> Vec<Vec<u32>> {
    let mut clusters = vec![Vec::new(); joints];
    for (i, &(k, _)) in nearest.iter().enumerate() {
        clusters[k].push(i as u32);
    }
    clusters
}

/// The neighbours, a sixth of the cluster, of its worst outlying member.
fn founders(rest: &[DVec3], members: &[u32], nearest: &[(usize, f64)]) -> Vec<u32> {
    let centre = members.iter().map(|&i| rest[i as usize]).sum::<DVec3>() / members.len() as f64;
    let merit = |i: u32| nearest[i as usize].1 * (rest[i as usize] - centre).length_squared();
    let seed = members.iter().fold(members[0], |best, &i| if merit(i) > merit(best) { i } else { best });
    nearest_to(rest, members.to_vec(), rest[seed as usize], (members.len() / 6).max(6))
}

/// The `count` of `among` nearest to a place; ties go to the lower index.
pub fn nearest_to(rest: &[DVec3], mut among: Vec<u32>, place: DVec3, count: usize) -> Vec<u32> {
    let distance = |i: &u32| (rest[*i as usize] - place).length_squared();
    among.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
    among.truncate(count);
    among
}

/// Rigid fit of each group in each frame; groups that are too small keep the joints of `before`.
fn fit_groups(rest: &[DVec3], sample: &Sample, groups: &[Vec<u32>], before: Option<&JointPlanes>) -> JointPlanes {
    let frames: Vec<Vec<Rigid>> = (0..sample.len())
        .into_par_iter()
        .map(|f| {
            let pose = sample.pose(f);
            let fallback = |k| before.map_or(Rigid::IDENTITY, |b| b.get(k, f));
            groups.iter().enumerate().map(|(k, g)| Rigid::fit_some(rest, &pose, g).unwrap_or_else(|| fallback(k))).collect()
        })
        .collect();
    JointPlanes::new(sample.len(), groups.len(), |k, f| frames[f][k])
}
