//! Nested solids: those inside the material of other solids. Nothing of them is on the outside, so they are left as they are.

use crate::context::{Cancelled, Context};
use crate::inspect::{nesting, solids};
use crate::mesh::{Edges, Parts, Surface};

/// Divides a surface into what bounds its material, and the nested solids with their cavities. None if nothing is known to be nested.
/// A solid in a cavity is not nested.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn split(surface: &Surface, context: &Context<'_>) -> Result<Option<[Surface; 2]>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    if parts.count < 2 {
        return Ok(None);
    }
    let solids = solids(surface, &edges, &parts);
    let containers = nesting(surface, &parts, &solids, &vec![true; parts.count], context)?;
    let sign = |part: u32| if solids[part as usize].volume < 0.0 { -1 } else { 1 };
    let has_material_on_both_sides = |(part, containers): (u32, &Option<Vec<u32>>)| {
        containers.as_ref().is_some_and(|containers| {
            let winding: i64 = containers.iter().map(|&container| sign(container)).sum();
            winding.min(winding + sign(part)) > 0
        })
    };
    let is_nested: Vec<bool> = (0u32..).zip(&containers).map(has_material_on_both_sides).collect();
    if !is_nested.contains(&true) {
        return Ok(None);
    }
    let is_nested = |part: u32| part != Parts::NONE && is_nested[part as usize];
    Ok(Some([false, true].map(|nested| {
        let mut some = surface.clone();
        some.retain_faces(&parts.of_face.iter().map(|&part| is_nested(part) == nested).collect::<Vec<_>>());
        some.drop_unreferenced();
        some
    })))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::context::{NoProgress, monotonic_clock};
    use crate::printing::shapes::{cuboid, joined};
    use glam::DVec3;
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    fn split(surface: &Surface) -> Option<[Surface; 2]> {
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        super::split(surface, &Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60))).unwrap()
    }

    fn cube(size: f64) -> Surface {
        cuboid(DVec3::splat(-size), DVec3::splat(size))
    }

    fn cavity(size: f64) -> Surface {
        let mut cavity = cube(size);
        cavity.faces.iter_mut().for_each(|face| face.swap(1, 2));
        cavity
    }

    #[test]
    fn a_solid_in_material_is_nested_with_its_cavity_but_not_a_solid_in_a_cavity() {
        let nested = |shells: &[Surface]| split(&joined(shells)).map(|[_, nested]| nested.faces.len() / 12);
        assert_eq!(nested(&[cube(9.0), cube(8.0)]), Some(1));
        assert_eq!(nested(&[cube(9.0), cube(8.0), cavity(7.0)]), Some(2));
        assert_eq!(nested(&[cube(9.0), cube(8.0), cavity(7.0), cavity(6.0)]), Some(2), "the cavity of all");
        assert_eq!(nested(&[cube(9.0), cavity(8.0), cube(7.0)]), None);
        let beside = cuboid(DVec3::splat(20.0), DVec3::splat(21.0));
        assert_eq!(nested(&[cube(9.0), beside]), None);
    }

    #[test]
    fn a_surface_and_its_nested_solids_keep_their_faces_and_sources() {
        let all = Surface { source: (0..24).collect(), ..joined(&[cube(8.0), cube(9.0)]) };
        let [outer, nested] = split(&all).expect("a nested cube");
        assert_eq!((nested.bounds().max, nested.positions.len()), (DVec3::splat(8.0), 8));
        assert_eq!((outer.source, nested.source), ((12..24).collect(), (0..12).collect()));
    }
}
