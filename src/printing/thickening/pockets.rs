//! Small parts and cavities, and the closed parts that added material leaves and that are filled or removed: pockets of air, and crumbs
//! of the material alone.

use crate::math::{Box3, Dipoles, Tree};
use crate::mesh::{Edges, Parts, Surface, position_key};
use glam::DVec3;
use rustc_hash::FxHashSet;

use super::outcome::Thickening;

/// The most cubes into which the box of a pocket is divided. A pocket that needs more stays open.
const MAX_CUBES: usize = 1 << 20;
/// A cube is not divided further once half of its diagonal is this share of the radius searched for.
const FINEST: f64 = 0.2;

/// What is added to a solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Added {
    /// A layer on the faces. A small solid without faces of the input is the rest of a layer, and is removed.
    Layer,
    /// Balls. Around a ball there can be a whole small solid of the input.
    Balls,
}

/// Removes the closed parts that the added material creates: pockets of air that are smaller than the cube of the least wall, or
/// nowhere wider than the least gap, and crumbs of the material alone. Large cavities of the model stay, however narrow they are.
/// Before the union, the surface was `before`; faces whose source is at least `first_added` are what was added. Returns the number of
/// large pockets that were filled: slits. Layers leave the gaps in front of them open, so only balls close slits.
pub fn fill(surface: &mut Surface, before: &Surface, (added, first_added): (Added, u32), settings: &Thickening) -> u64 {
    let most = small(settings);
    let parts = Parts::new(surface, &Edges::new(&surface.faces));
    let volume = volumes(surface, &parts);
    let mut has_added = vec![false; parts.count];
    let mut has_old = vec![false; parts.count];
    for (face, &part) in parts.of_face.iter().enumerate().filter(|(_, part)| **part != Parts::NONE) {
        let is_added = surface.source[face] >= first_added;
        has_added[part as usize] |= is_added;
        has_old[part as usize] |= !is_added;
    }
    // A ball alone that is around no point of the model touches the model nowhere.
    let is_apart = |part: usize| added == Added::Layer || !holds_point(surface, &parts, part, (before, first_added));
    let is_crumb = |part: usize| volume[part] > 0.0 && !has_old[part] && is_apart(part);
    let mut is_removed: Vec<bool> = (0..parts.count)
        .map(|part| volume[part].abs() < most && (volume[part] <= 0.0 && has_added[part] || is_crumb(part)))
        .collect();
    let is_large_pocket =
        |part: &usize| added == Added::Balls && has_added[*part] && is_large_cavity(volume[*part], settings);
    let large: Vec<usize> = (0..parts.count).filter(is_large_pocket).collect();
    let mut slits = 0;
    if !large.is_empty() {
        let of_part = parts.faces();
        let of_cavities = corners_of_cavities(before, first_added, settings);
        for part in large {
            let faces: Vec<[DVec3; 3]> = of_part[part].iter().map(|&face| surface.corners(face as usize)).collect();
            let is_new = faces.iter().flatten().all(|&corner| !of_cavities.contains(&position_key(corner)));
            is_removed[part] = is_new && Pocket::new(faces).is_narrower_than(settings.least_gap());
            slits += u64::from(is_removed[part]);
        }
    }
    if is_removed.contains(&true) {
        parts.remove(&is_removed, surface);
    }
    slits
}

/// The volume below which a solid or a cavity is small.
pub fn small(settings: &Thickening) -> f64 {
    settings.min_wall.powi(3)
}

/// Whether a part of a volume is a cavity that is not small.
pub fn is_large_cavity(volume: f64, settings: &Thickening) -> bool {
    volume <= -small(settings)
}

/// The enclosed volume of each part; negative for a cavity.
pub fn volumes(surface: &Surface, parts: &Parts) -> Vec<f64> {
    let origin = surface.bounds().centre();
    let mut volumes = vec![0.0; parts.count];
    for (face, &part) in parts.of_face.iter().enumerate().filter(|(_, part)| **part != Parts::NONE) {
        let [a, b, c] = surface.corners(face).map(|p| p - origin);
        volumes[part as usize] += a.dot(b.cross(c)) / 6.0;
    }
    volumes
}

/// The corners and the volume, which is negative, of each cavity that is not small.
pub fn large_cavities(surface: &Surface, settings: &Thickening) -> Vec<(Vec<DVec3>, f64)> {
    let parts = Parts::new(surface, &Edges::new(&surface.faces));
    let volumes = volumes(surface, &parts);
    let corners = |faces: &[u32]| faces.iter().flat_map(|&face| surface.corners(face as usize)).collect();
    let large = parts.faces().into_iter().zip(volumes).filter(|(_, volume)| is_large_cavity(*volume, settings));
    large.map(|(faces, volume)| (corners(&faces), volume)).collect()
}

/// Whether a corner of a face whose source is less than `first_added` lies in the box of a part.
fn holds_point(surface: &Surface, parts: &Parts, part: usize, (model, first_added): (&Surface, u32)) -> bool {
    let of_part = parts.of_face.iter().enumerate().filter(|(_, of_face)| **of_face as usize == part);
    let bounds = Box3::of(of_part.flat_map(|(face, _)| surface.corners(face)));
    let faces = model.faces.iter().zip(&model.source).filter(|(_, source)| **source < first_added);
    faces.flat_map(|(face, _)| face).any(|&v| bounds.holds(model.positions[v as usize]))
}

/// The keys of the corners of the model's own large cavities. The model's faces have a source of less than `first_added`.
fn corners_of_cavities(before: &Surface, first_added: u32, settings: &Thickening) -> FxHashSet<[u64; 3]> {
    let mut model = before.clone();
    model.retain_faces(&before.source.iter().map(|&source| source < first_added).collect::<Vec<_>>());
    large_cavities(&model, settings).into_iter().flat_map(|(corners, _)| corners).map(position_key).collect()
}

/// Air that faces enclose. Their normals point into it.
struct Pocket {
    faces: Vec<[DVec3; 3]>,
    tree: Tree,
    dipoles: Dipoles,
}

impl Pocket {
    fn new(faces: Vec<[DVec3; 3]>) -> Self {
        let numbers: Vec<[u32; 3]> = (0u32..).step_by(3).take(faces.len()).map(|v| [v, v + 1, v + 2]).collect();
        let tree = Tree::new(faces.as_flattened(), &numbers);
        let dipoles = tree.dipoles(|face| faces[face as usize]);
        Self { faces, tree, dipoles }
    }

    /// Whether no ball of the diameter `width` fits into the pocket. Searches cubes for the centre of one, and divides those that
    /// may hold it. False if that takes too long.
    fn is_narrower_than(&self, width: f64) -> bool {
        let (radius, bounds) = (width / 2.0, Box3::of(self.faces.iter().flatten().copied()));
        let mut open = vec![(bounds.centre(), (bounds.max - bounds.min).max_element() / 2.0)];
        for _ in 0..MAX_CUBES {
            let Some((centre, half)) = open.pop() else { return true };
            let reach = half * 3.0f64.sqrt();
            let corners = |face: u32| self.faces[face as usize];
            let nearest = self.tree.nearest(centre, f64::INFINITY, &mut u64::MAX.clone(), corners);
            let distance = nearest.map_or(0.0, |nearest| nearest.distance);
            if distance + reach < radius {
                continue;
            }
            // If the surface does not reach into the cube, its centre decides whether all of it is air.
            let is_air = || self.tree.winding(&self.dipoles, centre, &mut u64::MAX.clone(), corners) < -0.5;
            if distance > reach && !is_air() {
                continue;
            }
            if reach < FINEST * radius {
                return false;
            }
            let signs = [-0.5, 0.5].map(|sign| sign * half);
            let offsets = signs.into_iter().flat_map(|x| signs.map(|y| signs.map(|z| DVec3::new(x, y, z))));
            open.extend(offsets.flatten().map(|offset| (centre + offset, half / 2.0)));
        }
        false
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::math::Precision;
    use crate::mesh::Soup;
    use crate::printing::shapes::cuboid;
    use crate::printing::thickening::Growth;

    /// Tetrahedra, each with a corner and a size; a negative size turns it inside out.
    pub fn tetrahedra(of: &[(f64, f64)]) -> Surface {
        let mut soup = Soup { positions: Vec::new(), faces: Vec::new() };
        for (&(x, size), k) in of.iter().zip(0u32..) {
            let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * size.abs() + DVec3::splat(x));
            soup.positions.extend(corners);
            let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
            let turned = |[a, b, c]: [u32; 3]| if size < 0.0 { [a, c, b] } else { [a, b, c] };
            soup.faces.extend(faces.map(turned).map(|face| face.map(|v| v + 4 * k)));
        }
        Surface::from_soup(&soup).0
    }

    pub fn settings() -> Thickening {
        Thickening { min_wall: 0.5, growth: Growth::Both, min_gap: 0.25, precision: Precision::F32 }
    }

    #[test]
    fn a_small_solid_of_added_faces_is_a_crumb_unless_it_is_a_ball_around_a_solid() {
        let [alone, around] = [&[(0.0, 1.0)][..], &[(0.0, 1.0), (5.01, 0.05)]].map(tetrahedra).map(|mut before| {
            before.source = (0u32..).take(before.faces.len()).collect();
            before
        });
        for (added, before, faces) in
            [(Added::Layer, &around, 4), (Added::Balls, &around, 8), (Added::Balls, &alone, 4)]
        {
            let mut surface = tetrahedra(&[(0.0, 1.0), (5.0, 0.1)]);
            surface.source = vec![0, 1, 2, 3, 8, 8, 8, 8];
            fill(&mut surface, before, (added, 8), &settings());
            assert_eq!(surface.faces.len(), faces);
        }
    }

    /// A block of the model with an inverted block in it, of which so many faces were added.
    fn with_pocket(size: DVec3, added: usize) -> Surface {
        let mut surface = cuboid(DVec3::ZERO, DVec3::splat(10.0));
        surface.source.fill(0);
        let mut pocket = cuboid(DVec3::splat(3.0), DVec3::splat(3.0) + size);
        pocket.faces.iter_mut().for_each(|face| face.swap(0, 1));
        pocket.source = (0..pocket.faces.len()).map(|face| if face < added { 8 } else { 0 }).collect();
        surface.append(pocket);
        surface
    }

    #[test]
    fn a_new_pocket_is_filled_if_it_is_nowhere_wider_than_the_least_gap() {
        let solid = cuboid(DVec3::ZERO, DVec3::splat(10.0));
        let filled = |size: DVec3| {
            let mut surface = with_pocket(size, 1);
            let slits = fill(&mut surface, &solid, (Added::Balls, 8), &settings());
            (surface.faces.len() == solid.faces.len(), slits)
        };
        assert_eq!(
            filled(DVec3::new(4.0, 4.0, 0.2)),
            (true, 1),
            "a slit that is larger than the cube of the least wall"
        );
        assert_eq!(filled(DVec3::new(4.0, 4.0, 0.3)), (false, 0), "a wider slit");
        assert_eq!(filled(DVec3::new(4.0, 0.3, 0.3)), (false, 0), "a wider channel");
        assert_eq!(filled(DVec3::new(0.4, 0.4, 0.4)), (true, 0), "smaller than the cube of the least wall");
    }

    #[test]
    fn a_narrow_cavity_of_the_model_stays() {
        let size = DVec3::new(4.0, 4.0, 0.2);
        let (model, mut surface) = (with_pocket(size, 0), with_pocket(size, 1));
        fill(&mut surface, &model, (Added::Balls, 8), &settings());
        assert_eq!(surface.faces.len(), model.faces.len());
    }
}
