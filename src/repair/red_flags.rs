//! The red flags: signs that a repair damaged the model, and how much of a result's surface is new.

use glam::DVec3;

use super::options::{Nested, OpenSheets, Options, WindingRuleChoice};
use super::report::{RedFlag, RedFlagCode};
use crate::context::Context;
use crate::inspect::{Changes, LostPart, Measures, PartAccounting, Volume, percent};
use crate::math::Box3;
use crate::mesh::{BASE_SOURCE, Edges, NO_SOURCE, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, UnionFind, is_generated};

/// Share of the sound faces that must be left for parts to count as joined rather than lost. The rest are slivers that rounding made
/// degenerate.
const MIN_SHARE_LEFT: f64 = 0.98;

/// The farthest that rounding to f32 may move a point, as a share of the largest coordinate.
const ROUNDING: f64 = 2.0 / (1u64 << 23) as f64;

/// Counts of the input's faces, vertices and parts that a result still has, whole or cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurvivingInput {
    /// Faces of the input file that are left.
    pub faces: u64,
    /// Parts of which no face is left.
    pub parts_gone: u64,
    /// Vertices at faces that are left.
    pub vertices: u64,
    /// Vertices of the input, without those of parts that may be missing.
    pub vertices_before: u64,
    /// Faces of parts that were dropped because of `min_part_volume_pct`.
    pub faces_dropped: u64,
}

/// The input and a result, as the red flags compare them.
#[derive(Debug, Clone, Copy)]
pub struct Comparison<'a> {
    /// The measures of the input.
    pub before: &'a Measures,
    /// Whether the input has openings.
    pub was_open: bool,
    /// The input's volume after its parts are oriented consistently.
    pub settled: Volume,
    /// The measures of the result.
    pub after: &'a Measures,
    /// The changes between the two.
    pub changes: &'a Changes,
    /// The faces, vertices and parts of the input that the result still has.
    pub surviving: SurvivingInput,
    /// Whether the interior was filled, so that the input's volume is no reference.
    pub is_interior_filled: bool,
}

/// The red flags of a result: signs that the repair damaged the model.
///
/// - Faces: degenerate, duplicate and non-finite faces of the input do not count. Neither do faces removed on request, internal faces now
///   inside the result, or faces of a remeshed model, for which the other flags detect lost surface.
/// - Parts: merged parts raise no flag if all sound faces are left (they were pieces of one surface along a crack), or if each part is
///   accounted for (they overlapped and are now one solid).
/// - Volume: where faces intersect, their volume counts space twice, so the enclosed spaces are compared instead. Elsewhere the input's
///   volume is `settled`, so that inverted parts count like the others.
#[must_use]
pub fn red_flags(comparison: &Comparison<'_>, options: &Options) -> Vec<RedFlag> {
    let of_size =
        [comparison.face_loss(options), comparison.vertex_loss(options), comparison.bounding_box_change(options)];
    let of_shape = [comparison.volume_change(options), comparison.surface_lost(options), comparison.deviation(options)];
    let all = of_size.into_iter().chain(of_shape).chain([comparison.parts_merged(options)]);
    all.flatten().filter(|flag| flag.value > flag.threshold).collect()
}

fn flag(code: RedFlagCode, value: f64, threshold: f64, detail: String) -> Option<RedFlag> {
    Some(RedFlag { code, value, threshold, detail, places: Vec::new() })
}

impl Comparison<'_> {
    /// Whether lost faces and vertices are a sign of damage: not if faces were removed on request, nor after a remesh.
    fn counts_losses(&self, options: &Options) -> bool {
        !options.asks_for_fewer_faces() && self.surviving.faces != 0
    }

    /// The number of input faces that are neither degenerate, duplicate nor non-finite, nor of parts dropped on request.
    fn sound_faces(&self) -> u64 {
        let before = self.before;
        let unsound = before.degenerate_faces + before.duplicate_faces + before.non_finite_faces;
        before.faces.saturating_sub(unsound + self.surviving.faces_dropped)
    }

    fn face_loss(&self, options: &Options) -> Option<RedFlag> {
        let Self { before, after, changes, .. } = self;
        let sound = self.sound_faces();
        // A missing face with the result's solid on both sides was an internal face.
        let gone = before.faces as f64 * (100.0 - changes.faces_kept_pct) / 100.0;
        let buried = gone * changes.enclosed_faces_pct.unwrap_or(0.0) / 100.0;
        let lost = percent(sound as f64 - buried - after.faces as f64, sound as f64).unwrap_or(0.0).max(0.0);
        let detail = format!(
            "{lost:.1} % of the faces were lost: {sound} sound faces before, {buried:.0} of them now inside the result; {} after",
            after.faces
        );
        let value = if self.counts_losses(options) { lost } else { 0.0 };
        flag(RedFlagCode::FaceLoss, value, options.max_face_loss_pct, detail)
    }

    fn vertex_loss(&self, options: &Options) -> Option<RedFlag> {
        let surviving = self.surviving;
        let lost = vertices_lost_pct(self.after, self.changes, surviving);
        let detail = format!(
            "{lost:.1} % of the vertices were lost: {} before, {} of them at faces that are left",
            surviving.vertices_before, surviving.vertices
        );
        let value = if self.counts_losses(options) { lost } else { 0.0 };
        flag(RedFlagCode::VertexLoss, value, options.max_vertex_loss_pct, detail)
    }

    fn bounding_box_change(&self, options: &Options) -> Option<RedFlag> {
        let moved = self.changes.bounding_box_change_pct.unwrap_or(0.0);
        let detail = format!("a side of the bounding box moved by {moved:.1} % of its diagonal");
        flag(RedFlagCode::BoundingBoxChange, moved, options.max_bounding_box_change_pct, detail)
    }

    fn volume_change(&self, options: &Options) -> Option<RedFlag> {
        let &Self { was_open, settled, after, changes, .. } = self;
        // If the options redefine what is solid, the input's volume is no reference.
        let is_redefined = self.is_interior_filled
            || options.nested == Nested::Alternate
            || options.winding_rule != WindingRuleChoice::Auto;
        // A request to make sheets solid changes the volume on purpose.
        let asked_for_shell = matches!(options.open_sheets, OpenSheets::Thicken | OpenSheets::Base) && was_open;
        let (value, detail) = match changes.volume_overlap_pct.filter(|_| !is_redefined) {
            Some(_) if asked_for_shell => return None,
            Some(overlap) if was_open => (
                100.0 - overlap,
                format!(
                    "only {overlap:.1} % of the space inside the open surface, by winding number, is inside the result"
                ),
            ),
            Some(overlap) => {
                (100.0 - overlap, format!("only {overlap:.1} % of the enclosed space is the same before and after"))
            }
            None => {
                let change = changes.volume_change_pct.filter(|_| !is_redefined).map_or(0.0, f64::abs);
                // Flipping a solid of unclear orientation changes only the sign of its volume.
                let size = percent(after.volume.value.abs() - settled.value.abs(), settled.value).map_or(0.0, f64::abs);
                let value = change.min(size);
                let [was, is] = [settled.value, after.volume.value];
                (value, format!("the volume changed by {value:.1} %: {was} before, {is} after"))
            }
        };
        flag(RedFlagCode::VolumeChange, value, options.max_volume_change_pct, detail)
    }

    fn surface_lost(&self, options: &Options) -> Option<RedFlag> {
        // Sheets thickened on request move away from the input's surface on both sides.
        let thickens = options.open_sheets == OpenSheets::Thicken && options.thickness.is_some();
        let is_offset = thickens && self.before.boundary_edges > 0;
        let lost = self.changes.surface_lost_pct.filter(|_| !is_offset).unwrap_or(0.0);
        let detail =
            format!("{lost:.1} % of the surface visible from outside is missing from the result or lies inside it");
        flag(RedFlagCode::SurfaceLost, lost, options.max_surface_lost_pct, detail)
    }

    fn deviation(&self, options: &Options) -> Option<RedFlag> {
        let (most, moved) = (options.max_deviation?, self.changes.moved?);
        let farthest = moved.distance.max;
        let detail =
            format!("surface outside hole patches is up to {farthest} from the input; `max_deviation` is {most}");
        flag(RedFlagCode::Deviation, farthest, most + ROUNDING * largest_coordinate(self.before), detail)
    }

    fn parts_merged(&self, options: &Options) -> Option<RedFlag> {
        let Self { before, after, surviving, .. } = self;
        // After faces were reduced on request, the faces that are left say nothing about merged parts.
        let is_united = surviving.parts_gone == 0 || options.asks_for_fewer_faces();
        let are_faces_left = surviving.faces as f64 >= MIN_SHARE_LEFT * self.sound_faces() as f64;
        if before.parts <= 1 || after.parts != 1 || is_united || are_faces_left {
            return None;
        }
        let detail = format!("{} parts were merged into one", before.parts);
        flag(RedFlagCode::PartsMerged, before.parts as f64, 1.0, detail)
    }
}

/// Share of the lost vertices, in percent: vertices at no face that is left, limited by how many fewer vertices the result has.
/// Vertices now inside the result were on internal faces and do not count; neither do merged vertices.
fn vertices_lost_pct(after: &Measures, changes: &Changes, surviving: SurvivingInput) -> f64 {
    let before = surviving.vertices_before as f64;
    let gone = before - surviving.vertices as f64;
    let internal = gone * changes.enclosed_faces_pct.unwrap_or(0.0) / 100.0;
    let lost = (gone - internal).min(before - internal - after.vertices as f64);
    percent(lost, before).unwrap_or(0.0).max(0.0)
}

/// The red flag for parts that are missing without an accepted reason. It is a program error, so the log records it too.
pub(super) fn part_lost(part_accounting: &PartAccounting, context: &Context<'_>) -> Option<RedFlag> {
    let first = part_accounting.lost_parts.first()?;
    let LostPart { part, first_face, faces, .. } = first;
    let detail = format!(
        "{} of {} parts are missing without a reason: none is a duplicate, without volume, or inside another part. The first is part \
         {part}, with {faces} faces starting at face {first_face}",
        part_accounting.lost, part_accounting.parts
    );
    context.log(&format!("part lost: {detail}"));
    Some(RedFlag {
        code: RedFlagCode::PartLost,
        value: part_accounting.lost as f64,
        threshold: 0.0,
        detail,
        places: Vec::new(),
    })
}

fn largest_coordinate(measures: &Measures) -> f64 {
    let largest = |side: [f64; 3]| side.into_iter().map(f64::abs).fold(0.0, f64::max);
    measures.bounding_box.map_or(0.0, |bounds| largest(bounds.min).max(largest(bounds.max)))
}

/// Share of the surface above which the patch of a hole is large.
const LARGE_PATCH: f64 = 0.02;
/// A patch up to this share of the surface closes a pinhole, through which no interior is meant to be seen.
const PINHOLE: f64 = 0.005;
/// Most places on thickened sheets and bases that are recorded.
const MAX_PLACES: usize = 5;

/// The patch of one hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Patch {
    /// Area in square units.
    pub area: f64,
    /// Diagonal of the patch's bounding box.
    pub extent: f64,
    /// A point on the patch.
    pub at: DVec3,
}

/// The new surface of a result: faces without a counterpart in the input. Areas are in square units.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct AddedSurface {
    /// The area of the whole result.
    pub area: f64,
    /// The area of second sides and rims of thickened sheets.
    pub skins: f64,
    /// The area of second sides and rims around regions that were left open.
    pub opened_skins: f64,
    /// The area of walls and bottoms of bases.
    pub bases: f64,
    /// Points on thickened sheets and bases.
    pub places: Vec<DVec3>,
    /// The patches that each exceed 2 % of the surface, the largest first.
    pub patches: Vec<Patch>,
}

impl AddedSurface {
    /// Sums the areas of a surface's new faces. Linear time except for sorting.
    pub fn of(surface: &Surface) -> Self {
        let areas = face_areas(surface);
        let mut added = Self { area: areas.iter().sum(), ..Self::default() };
        for ((f, &area), &source) in areas.iter().enumerate().zip(&surface.source) {
            let sum = match source {
                SKIN_SOURCE => &mut added.skins,
                OPENED_SKIN_SOURCE => &mut added.opened_skins,
                BASE_SOURCE => &mut added.bases,
                _ => continue,
            };
            if *sum == 0.0 && added.places.len() < MAX_PLACES {
                added.places.push(surface.corners(f).iter().sum::<DVec3>() / 3.0);
            }
            *sum += area;
        }
        if surface.source.iter().any(|&source| is_generated(source)) {
            (added.patches, _) = patches(surface, &areas);
            let least = LARGE_PATCH * added.area;
            added.patches.retain(|patch| patch.area > least);
            added.patches.sort_by(|a, b| b.area.total_cmp(&a.area));
        }
        added
    }

    /// The surface added before a remesh, related to the remeshed result of this area.
    pub fn in_remesh(&self, area: f64) -> Self {
        Self { area, ..self.clone() }
    }

    /// The area of all large patches.
    pub fn patch_area(&self) -> f64 {
        self.patches.iter().map(|patch| patch.area).sum()
    }

    /// An area as a share of the whole result, in percent.
    pub fn share_pct(&self, area: f64) -> f64 {
        percent(area, self.area).unwrap_or(0.0).min(100.0)
    }
}

/// For each face, whether it is part of a patch that closes a pinhole. None is if all of these together are more than a
/// small share of the surface. Empty without patches.
pub(super) fn pinhole_patches(surface: &Surface) -> Vec<bool> {
    if !surface.source.contains(&NO_SOURCE) {
        return Vec::new();
    }
    let areas = face_areas(surface);
    let whole: f64 = areas.iter().sum();
    let (patches, of_face) = patches(surface, &areas);
    let is_pinhole = |patch: &&Patch| patch.area <= PINHOLE * whole;
    let are_few = patches.iter().filter(is_pinhole).map(|patch| patch.area).sum::<f64>() <= LARGE_PATCH * whole;
    of_face.iter().map(|&at| are_few && patches.get(at).is_some_and(|patch| is_pinhole(&patch))).collect()
}

/// The area of each face.
fn face_areas(surface: &Surface) -> Vec<f64> {
    (0..surface.faces.len()).map(|f| surface.area_vector(f).length() / 2.0).collect()
}

/// The patches of holes: sets of faces without a source that share edges. Also for each face the index of its patch;
/// `usize::MAX` for all other faces.
fn patches(surface: &Surface, areas: &[f64]) -> (Vec<Patch>, Vec<usize>) {
    let listed: Vec<usize> = (0..surface.faces.len()).filter(|&f| surface.source[f] == NO_SOURCE).collect();
    let faces: Vec<[u32; 3]> = listed.iter().map(|&f| surface.faces[f]).collect();
    let mut sets = UnionFind::new(faces.len());
    for half_edges in Edges::new(&faces).iter() {
        half_edges.windows(2).for_each(|pair| sets.unite(pair[0] / 3, pair[1] / 3));
    }
    let roots = sets.into_roots();
    // The first face of a set is its root, so that it has a number before the others.
    let mut number = vec![usize::MAX; surface.faces.len()];
    let mut patch_sets: Vec<(Patch, Box3, f64)> = Vec::new();
    for (&f, root) in listed.iter().zip(roots) {
        let root = listed[root as usize];
        if number[root] == usize::MAX {
            number[root] = patch_sets.len();
            patch_sets.push((Patch { area: 0.0, extent: 0.0, at: DVec3::ZERO }, Box3::EMPTY, -1.0));
        }
        number[f] = number[root];
        let (patch, bounds, largest) = &mut patch_sets[number[f]];
        let corners = surface.corners(f);
        corners.iter().for_each(|&corner| bounds.extend(corner));
        patch.area += areas[f];
        if areas[f] > *largest {
            (*largest, patch.at) = (areas[f], corners.iter().sum::<DVec3>() / 3.0);
        }
    }
    let patches = patch_sets.into_iter().map(|(patch, bounds, _)| Patch { extent: bounds.diagonal(), ..patch });
    (patches.collect(), number)
}

/// The red flag for more new surface than the options allow. Thickness that the options ask for does not count, and neither do bases,
/// which are added only on request.
pub(super) fn surface_invented(added_surface: &AddedSurface, options: &Options) -> Option<RedFlag> {
    let asked = options.open_sheets == OpenSheets::Thicken;
    let skins = if asked { 0.0 } else { added_surface.skins + added_surface.opened_skins };
    let (skins, patches) = (added_surface.share_pct(skins), added_surface.share_pct(added_surface.patch_area()));
    let value = (skins + patches).min(100.0);
    let threshold = options.max_surface_added_pct;
    let parts: Vec<String> = [
        (skins > 0.0).then(|| format!("{skins:.1} % to thicken open sheets")),
        (patches > 0.0).then(|| format!("{patches:.1} % to close {} large holes", added_surface.patches.len())),
    ]
    .into_iter()
    .flatten()
    .collect();
    let detail = format!("{value:.1} % of the result's surface is new: {}", parts.join(", "));
    let places = added_surface.patches.iter().map(|patch| patch.at).chain(added_surface.places.iter().copied());
    (value > threshold).then(|| RedFlag {
        code: RedFlagCode::SurfaceInvented,
        value,
        threshold,
        detail,
        places: places.take(MAX_PLACES).map(|at| at.to_array()).collect(),
    })
}
