//! Filling of sealed voids: a void becomes material when the faces around it are removed.

use glam::DVec3;

use super::voids::{NO_REGION, Regions, SealedVoid};
use crate::mesh::Surface;

/// A void that became material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilledVoid {
    /// The index of the void among all voids.
    pub void: usize,
    /// A point that was inside the void.
    pub at: DVec3,
    /// Volume of the air that became material, in cubic model units.
    pub volume: f64,
    /// Number of solids inside the void that became part of the material around it.
    pub solids: usize,
}

/// A surface without the faces of some voids.
#[derive(Debug, Clone, PartialEq)]
pub struct Filled {
    /// The surface.
    pub surface: Surface,
    /// The voids that were filled. A void inside a solid inside a filled void is filled too.
    pub filled: Vec<FilledVoid>,
    /// Number of faces removed.
    pub faces_removed: u64,
}

/// Fills the voids for which `is_chosen` holds: removes the faces around each void and everything inside the void. All other faces
/// stay as they are, in their order. Only vertices that lose all their faces are removed.
///
/// `regions` and `voids` must belong to the surface.
#[must_use]
pub fn fill_voids(
    surface: &Surface,
    regions: &Regions,
    voids: &[SealedVoid],
    is_chosen: impl Fn(usize) -> bool,
) -> Filled {
    let mut fills = vec![false; regions.count()];
    for (at, void) in voids.iter().enumerate() {
        fills[void.region as usize] = is_chosen(at);
    }
    let enclosed = regions.enclosed_in(|region| fills[region as usize]);
    let is_filled = |region: u32| region != NO_REGION && (fills[region as usize] || enclosed[region as usize]);
    let keep: Vec<bool> =
        regions.of_side.chunks_exact(2).map(|sides| !sides.iter().any(|&side| is_filled(side))).collect();
    let filled = voids.iter().enumerate().filter(|(_, void)| is_filled(void.region)).map(|(at, void)| FilledVoid {
        void: at,
        at: void.at,
        volume: void.volume,
        solids: void.solids,
    });
    let filled = filled.collect();
    let mut surface = surface.clone();
    let faces_removed = surface.retain_faces(&keep);
    surface.drop_unreferenced();
    Filled { surface, filled, faces_removed }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::printing::shapes::*;
    use crate::printing::voids::{voids_in, voids_of};

    #[test]
    fn a_filled_void_takes_all_within_it_and_leaves_the_rest_bit_for_bit() {
        quietly(|context| {
            let outer = sphere(10.0, 2);
            let other = inverted(cuboid(DVec3::new(7.0, -0.5, -0.5), DVec3::new(8.0, 0.5, 0.5)));
            let model = joined(&[
                outer.clone(),
                inverted(turned(&sphere(6.0, 2), 1.0, DVec3::ZERO)),
                sphere(5.0, 2),
                inverted(sphere(3.0, 1)),
                other.clone(),
            ]);
            let regions = Regions::of_closed(&model, context);
            let voids = voids_of(&model, &regions, context).unwrap();
            assert_eq!(voids.len(), 3);
            let filled = fill_voids(&model, &regions, &voids, |void| void == 0);
            assert_eq!(filled.filled.iter().map(|f| f.void).collect::<Vec<_>>(), [0, 1]);
            assert_eq!(filled.filled[0].solids, 1);
            let expected = joined(&[outer.clone(), other.clone()]);
            assert_eq!(filled.surface.positions, expected.positions);
            assert_eq!(filled.surface.faces, expected.faces);
            assert_eq!(filled.faces_removed as usize, model.faces.len() - expected.faces.len());
            assert!((volume(&filled.surface) - volume(&outer) - volume(&other)).abs() < 1e-9);
            let inner = fill_voids(&model, &regions, &voids, |void| void == 1);
            assert_eq!(voids_in(&inner.surface, context).len(), 2);
            let none = fill_voids(&model, &regions, &voids, |_| false);
            assert_eq!((none.surface, none.faces_removed), (model, 0));
        });
    }
}
