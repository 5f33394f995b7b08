//! A proxy without some of its components.

use super::Proxy;

impl Proxy {
    /// The vertices that [`Proxy::with_components`] keeps, in their order.
    pub fn vertices_of(&self, keep: impl Fn(u32) -> bool) -> Vec<u32> {
        let mut kept = vec![false; self.rest.len()];
        for (t, &c) in self.tets.iter().zip(&self.components) {
            t.iter().for_each(|&v| kept[v as usize] = keep(c));
        }
        (0..self.rest.len() as u32).filter(|&v| kept[v as usize]).collect()
    }

    /// The components that `keep` says yes to, renumbered from 0; vertices, tetrahedra and faces stay in their order.
    ///
    /// A component without any handle cannot be posed: a chair beside a person. Left out, its part of the scan follows what is nearest.
    /// Rows and handles made for the whole proxy do not fit the result.
    pub fn with_components(&self, keep: impl Fn(u32) -> bool) -> Self {
        let count = self.components.iter().max().map_or(0, |&last| last + 1);
        let mut next = 0u32..;
        let component: Vec<Option<u32>> = (0..count).map(|c| if keep(c) { next.next() } else { None }).collect();
        let mut vertex = vec![None; self.rest.len()];
        let mut kept = Self::default();
        let mut tet = Vec::with_capacity(self.tets.len());
        for (t, &c) in self.tets.iter().zip(&self.components) {
            let number = component[c as usize];
            tet.push(number.map(|_| kept.components.len() as u32));
            kept.components.extend(number);
            t.iter().for_each(|&v| vertex[v as usize] = number.map(|_| 0));
        }
        for (n, &p) in vertex.iter_mut().zip(&self.rest).filter(|(n, _)| n.is_some()) {
            *n = Some(kept.rest.len() as u32);
            kept.rest.push(p);
        }
        let place = |v: u32| vertex[v as usize].unwrap_or_default();
        kept.tets = self.tets.iter().zip(&tet).filter(|(_, n)| n.is_some()).map(|(t, _)| t.map(place)).collect();
        for (face, &behind) in self.boundary.iter().zip(&self.boundary_tets) {
            if let Some(behind) = tet[behind as usize] {
                kept.boundary.push(face.map(place));
                kept.boundary_tets.push(behind);
            }
        }
        kept
    }
}
