//! A measurement of a surface that was measured before it was changed in places.

use crate::context::{Cancelled, Context};
use crate::math::{Tree, centre_and_radius};
use crate::mesh::Surface;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::facing::Chord;
use super::places::OpposedPairs;
use super::prepared::Prepared;
use super::search::Thinnest;

/// A surface before a change, and what was measured there.
#[derive(Debug, Clone, Copy)]
pub struct Earlier<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// Its thin places, found with about the same limit.
    pub pairs: &'a OpposedPairs,
}

impl Earlier<'_> {
    /// The thinnest place of each face of the changed surface, if thinner than `below`. Only faces near a change are measured.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub(super) fn thinnest_after(
        &self,
        (changed, prepared): (&Surface, &Prepared<'_>),
        below: f64,
        context: &Context<'_>,
    ) -> Result<Vec<Thinnest>, Cancelled> {
        let known = self.known(changed, below, prepared.scale);
        prepared.thinnest_of(&known, below * prepared.scale, context)
    }

    /// For each face of the changed surface its thinnest place, if the change cannot have changed it: no face within
    /// `reach` of the face is new or gone. Faces at sharp edges have none, because more of the surroundings decides
    /// whether an edge is sharp. Lengths of the results are multiplied by `scale`.
    pub(super) fn known(&self, surface: &Surface, reach: f64, scale: f64) -> Vec<Option<Thinnest>> {
        let same = self.same_faces(surface);
        let is_kept = self.kept(surface, &same, reach);
        let mut now = vec![None; self.surface.faces.len()];
        (0u32..).zip(&same).for_each(|(face, same)| {
            if let Some(before) = same {
                now[*before as usize] = Some(face);
            }
        });
        let mut known: Vec<Option<Thinnest>> = is_kept.iter().map(|kept| kept.then(Thinnest::default)).collect();
        let open = self.pairs.tips.iter().map(|tip| tip.faces[0]).chain(self.pairs.undecided_faces.iter().copied());
        for face in open.filter_map(|before| now[before as usize]) {
            known[face as usize] = None;
        }
        for pair in &self.pairs.walls {
            let Some(face) = now[pair.faces[0] as usize] else { continue };
            let points = pair.points.map(|p| p * scale);
            let chord = Chord { points, thickness: pair.thickness * scale, inside: points[0].midpoint(points[1]) };
            let wall = now[pair.faces[1] as usize].map(|other| (other, chord));
            let known = &mut known[face as usize];
            *known = known.filter(|_| wall.is_some()).map(|thinnest| Thinnest { wall, ..thinnest });
        }
        known
    }

    /// For each face the face of the earlier surface with the same corners.
    fn same_faces(&self, surface: &Surface) -> Vec<Option<u32>> {
        let numbers = 0..self.surface.faces.len();
        let before: FxHashMap<_, u32> = numbers.map(|face| self.surface.face_key(face)).zip(0u32..).collect();
        (0..surface.faces.len()).into_par_iter().map(|face| before.get(&surface.face_key(face)).copied()).collect()
    }

    /// For each face whether it is in both surfaces and farther than `reach` from all faces that are in only one.
    fn kept(&self, surface: &Surface, same: &[Option<u32>], reach: f64) -> Vec<bool> {
        let mut is_gone = vec![true; self.surface.faces.len()];
        same.iter().flatten().for_each(|&before| is_gone[before as usize] = false);
        let gone = (0..is_gone.len()).filter(|&face| is_gone[face]).map(|face| self.surface.corners(face));
        let new = (0..same.len()).filter(|&face| same[face].is_none()).map(|face| surface.corners(face));
        let changed: Vec<[DVec3; 3]> = gone.chain(new).collect();
        let faces: Vec<[u32; 3]> = (0u32..).step_by(3).take(changed.len()).map(|v| [v, v + 1, v + 2]).collect();
        let tree = Tree::new(changed.as_flattened(), &faces);
        let is_kept = |(face, same): (usize, &Option<u32>)| {
            let corners = surface.corners(face);
            let (centre, radius) = centre_and_radius(corners);
            let is_near = || tree.nearest(centre, reach + radius, &mut u64::MAX.clone(), |f| changed[f as usize]);
            same.is_some() && is_near().is_none()
        };
        same.par_iter().enumerate().map(is_kept).collect()
    }
}
