//! The signs that a repair destroyed something, and how much of a result's surface the input does not describe.

use glam::DVec3;

use super::options::{Nested, OpenSheets, Options, WindingRuleChoice};
use super::report::{RedFlag, RedFlagCode};
use crate::context::Context;
use crate::inspect::{Changes, LostPart, Measures, PartAccounting, Volume, percent};
use crate::math::Box3;
use crate::mesh::{BASE_SOURCE, Edges, NO_SOURCE, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, UnionFind, is_generated};

/// Share of the sound faces that must stand for parts to have been joined rather than lost; the rest are slivers that
/// rounding made degenerate.
const LEAST_STANDING: f64 = 0.98;

/// What rounding to f32 may move, as a share of the largest coordinate.
const ROUNDING: f64 = 2.0 / (1u64 << 23) as f64;

/// What of the input is in a result, whole or cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Standing {
    /// Faces of the file.
    pub faces: u64,
    /// Parts of which no face stands.
    pub parts_gone: u64,
    /// Vertices of faces of which some stands.
    pub vertices: u64,
    /// Vertices of the file, but those of parts that may go.
    pub vertices_before: u64,
    /// Faces of parts that were dropped as the options ask.
    pub faces_dropped: u64,
}

/// The input and a result, as the signs of destruction compare them.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    /// The measures of the input.
    pub before: &'a Measures,
    /// Its volume when its orientation is settled.
    pub settled: Volume,
    /// The measures of the result.
    pub after: &'a Measures,
    /// What changed between them.
    pub changes: &'a Changes,
    /// What of the input is in the result.
    pub standing: Standing,
}

/// The signs that a repair destroyed something. Degenerate, duplicate and non-finite faces of the input count as none:
/// they are gone with a reason.
///
/// Faces that were asked to go are no loss, nor are those that are inside the result now, since they were inner walls, nor those
/// of a model that was made anew: whether surface went with them the other flags say. Parts that became one are no bad sign
/// where all sound faces stand, since they were pieces of one surface along a crack, or where each part is accounted for,
/// since they overlapped and are one solid now. The volume of faces that intersect counts some of the space twice, so there
/// what is inside is compared instead. Elsewhere the input's volume is that when its orientation is `settled`, so that parts that
/// were inside out count like the others.
#[must_use]
pub fn red_flags(compared: &Compared<'_>, options: &Options) -> Vec<RedFlag> {
    let of_size = [compared.face_loss(options), compared.vertex_loss(options), compared.bounding_box_change(options)];
    let of_shape = [compared.volume_change(options), compared.surface_lost(options), compared.deviation(options)];
    let all = of_size.into_iter().chain(of_shape).chain([compared.parts_merged(options)]);
    all.flatten().filter(|flag| flag.value > flag.threshold).collect()
}

fn flag(code: RedFlagCode, value: f64, threshold: f64, detail: String) -> Option<RedFlag> {
    Some(RedFlag { code, value, threshold, detail, places: Vec::new() })
}

impl Compared<'_> {
    /// Whether loss of faces and vertices says something: not where faces were asked to go, nor of a surface that was made again.
    fn counts_losses(&self, options: &Options) -> bool {
        !options.asks_for_fewer_faces() && self.standing.faces != 0
    }

    /// Faces of the input that have an area and are there once, but for those of parts that were dropped as the options ask.
    fn sound_faces(&self) -> u64 {
        let before = self.before;
        let unsound = before.degenerate_faces + before.duplicate_faces + before.non_finite_faces;
        before.faces.saturating_sub(unsound + self.standing.faces_dropped)
    }

    fn face_loss(&self, options: &Options) -> Option<RedFlag> {
        let Self { before, after, changes, .. } = self;
        let sound = self.sound_faces();
        // What the result has not as it was, and has around itself on both sides, was an inner wall.
        let gone = before.faces as f64 * (100.0 - changes.faces_kept_pct) / 100.0;
        let buried = gone * changes.enclosed_faces_pct.unwrap_or(0.0) / 100.0;
        let lost = percent(sound as f64 - buried - after.faces as f64, sound as f64).unwrap_or(0.0).max(0.0);
        let detail = format!(
            "{lost:.1} % of the faces were lost: {sound} sound faces before, {buried:.0} of them inside the result, {} after",
            after.faces
        );
        let value = if self.counts_losses(options) { lost } else { 0.0 };
        flag(RedFlagCode::FaceLoss, value, options.max_face_loss_pct, detail)
    }

    fn vertex_loss(&self, options: &Options) -> Option<RedFlag> {
        let standing = self.standing;
        let lost = vertices_lost_pct(self.after, self.changes, standing);
        let detail = format!(
            "{lost:.1} % of the vertices were lost: of {} before, {} are at faces that are left",
            standing.vertices_before, standing.vertices
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
        let &Self { before, settled, after, changes, .. } = self;
        // Where the options say what is solid, the volume of the input as it is wound says nothing.
        let is_redefined = options.nested == Nested::Alternate || options.winding_rule != WindingRuleChoice::Auto;
        // Whoever asks for sheets to be made solid says what is to be inside.
        let asked_for_shell = matches!(options.open_sheets, OpenSheets::Thicken | OpenSheets::Base) && !before.closed;
        let (value, detail) = match changes.volume_overlap_pct.filter(|_| !is_redefined) {
            Some(_) if asked_for_shell => return None,
            Some(overlap) if !before.closed => (
                100.0 - overlap,
                format!(
                    "only {overlap:.1} % of what the open surface has inside, by winding number, is inside the result"
                ),
            ),
            Some(overlap) => (
                100.0 - overlap,
                format!("only {overlap:.1} % of what is inside the model before or after is so in both"),
            ),
            None => {
                let change = changes.volume_change_pct.filter(|_| !is_redefined).map_or(0.0, f64::abs);
                // A solid whose orientation could not be told changes the sign of its volume and nothing else.
                let size = percent(after.volume.value.abs() - settled.value.abs(), settled.value).map_or(0.0, f64::abs);
                let value = change.min(size);
                let [was, is] = [settled.value, after.volume.value];
                (value, format!("the volume changed by {value:.1} %: {was} before, {is} after"))
            }
        };
        flag(RedFlagCode::VolumeChange, value, options.max_volume_change_pct, detail)
    }

    fn surface_lost(&self, options: &Options) -> Option<RedFlag> {
        // Sheets that are thickened to both sides as thick as was asked for are where nothing was before.
        let thickens = options.open_sheets == OpenSheets::Thicken && options.thickness.is_some();
        let is_offset = thickens && self.before.boundary_edges > 0;
        let lost = self.changes.surface_lost_pct.filter(|_| !is_offset).unwrap_or(0.0);
        let detail = format!(
            "{lost:.1} % of the surface that can be seen from outside has no counterpart in the result or lies within it"
        );
        flag(RedFlagCode::SurfaceLost, lost, options.max_surface_lost_pct, detail)
    }

    fn deviation(&self, options: &Options) -> Option<RedFlag> {
        let (most, moved) = (options.max_deviation?, self.changes.moved?);
        let farthest = moved.distance.max;
        let detail =
            format!("surface other than hole patches is {farthest} from the input's, and max_deviation is {most}");
        flag(RedFlagCode::Deviation, farthest, most + ROUNDING * largest_coordinate(self.before), detail)
    }

    fn parts_merged(&self, options: &Options) -> Option<RedFlag> {
        let Self { before, after, standing, .. } = self;
        // Where faces were asked to go, those that stand tell nothing of what became of parts.
        let is_united = standing.parts_gone == 0 || options.asks_for_fewer_faces();
        let still_stand = standing.faces as f64 >= LEAST_STANDING * self.sound_faces() as f64;
        if before.parts <= 1 || after.parts != 1 || is_united || still_stand {
            return None;
        }
        let detail = format!("{} parts became one", before.parts);
        flag(RedFlagCode::PartsMerged, before.parts as f64, 1.0, detail)
    }
}

/// Share of the vertices that no face of the result is left of, in percent, as far as the result has fewer vertices too. Those inside
/// the result now were on inner walls, and vertices that were merged are not lost.
fn vertices_lost_pct(after: &Measures, changes: &Changes, standing: Standing) -> f64 {
    let before = standing.vertices_before as f64;
    let gone = before - standing.vertices as f64;
    let sunk = gone * changes.enclosed_faces_pct.unwrap_or(0.0) / 100.0;
    let lost = (gone - sunk).min(before - sunk - after.vertices as f64);
    percent(lost, before).unwrap_or(0.0).max(0.0)
}

/// The flag for parts that are neither in the result nor certified, which the log tells too, since it is an error of the
/// program.
pub(super) fn part_lost(part_accounting: &PartAccounting, context: &Context<'_>) -> Option<RedFlag> {
    let first = part_accounting.lost_parts.first()?;
    let LostPart { part, first_face, faces, .. } = first;
    let detail = format!(
        "{} of {} parts are neither in the result nor duplicates, without volume, or inside another; the first is part {part} \
         of {faces} faces from face {first_face} on",
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
    measures.bounding_box.map_or(0.0, |it| largest(it.min).max(largest(it.max)))
}

/// Share of the surface above which the patch of a hole is large.
const LARGE: f64 = 0.02;
/// Places of skins that are kept.
const MAX_PLACES: usize = 5;

/// The patch of one hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Patch {
    pub area: f64,
    /// Its extent.
    pub extent: f64,
    /// A point on it.
    pub at: DVec3,
}

/// What was made without a counterpart in the input.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Invented {
    /// The area of the whole result.
    pub area: f64,
    /// The area of second skins and rims of sheets.
    pub skins: f64,
    /// The same around regions that were left open.
    pub opened_skins: f64,
    /// The area of skirts and bottoms of bases.
    pub bases: f64,
    /// Points on skins and bases.
    pub places: Vec<DVec3>,
    /// The patches that are larger than 2 % of the surface each, the largest first.
    pub patches: Vec<Patch>,
}

impl Invented {
    /// Adds the made faces up. Linear but for sorting.
    pub fn of(surface: &Surface) -> Self {
        let areas: Vec<f64> = (0..surface.faces.len()).map(|f| surface.area_vector(f).length() / 2.0).collect();
        let mut found = Self { area: areas.iter().sum(), ..Self::default() };
        for ((f, &area), &source) in areas.iter().enumerate().zip(&surface.source) {
            let sum = match source {
                SKIN_SOURCE => &mut found.skins,
                OPENED_SKIN_SOURCE => &mut found.opened_skins,
                BASE_SOURCE => &mut found.bases,
                _ => continue,
            };
            if *sum == 0.0 && found.places.len() < MAX_PLACES {
                found.places.push(surface.corners(f).iter().sum::<DVec3>() / 3.0);
            }
            *sum += area;
        }
        if surface.source.iter().any(|&source| is_generated(source)) {
            found.patches = patches(surface, &areas);
            let least = LARGE * found.area;
            found.patches.retain(|patch| patch.area > least);
            found.patches.sort_by(|a, b| b.area.total_cmp(&a.area));
        }
        found
    }

    /// What was invented before a remesh, in a result of this area.
    pub fn in_remesh(&self, area: f64) -> Self {
        Self { area, ..self.clone() }
    }

    /// The area of all large patches.
    pub fn patch_area(&self) -> f64 {
        self.patches.iter().map(|patch| patch.area).sum()
    }

    /// An area as a share of the whole, in percent.
    pub fn share_pct(&self, area: f64) -> f64 {
        percent(area, self.area).unwrap_or(0.0).min(100.0)
    }
}

/// The patches of holes: faces that were made for them, as far as edges connect them.
fn patches(surface: &Surface, areas: &[f64]) -> Vec<Patch> {
    let is_patch = |f: usize| surface.source[f] == NO_SOURCE;
    let mut sets = UnionFind::new(surface.faces.len());
    for half_edges in Edges::new(&surface.faces).iter() {
        let mut faces = half_edges.iter().map(|h| h / 3).filter(|&f| is_patch(f as usize));
        if let Some(first) = faces.next() {
            faces.for_each(|other| sets.unite(first, other));
        }
    }
    let roots = sets.into_roots();
    let mut number = vec![usize::MAX; surface.faces.len()];
    let mut found: Vec<(Patch, Box3, f64)> = Vec::new();
    for f in (0..surface.faces.len()).filter(|&f| is_patch(f)) {
        let slot = &mut number[roots[f] as usize];
        if *slot == usize::MAX {
            *slot = found.len();
            found.push((Patch { area: 0.0, extent: 0.0, at: DVec3::ZERO }, Box3::EMPTY, -1.0));
        }
        let (patch, bounds, largest) = &mut found[*slot];
        let corners = surface.corners(f);
        corners.iter().for_each(|&corner| bounds.extend(corner));
        patch.area += areas[f];
        if areas[f] > *largest {
            (*largest, patch.at) = (areas[f], corners.iter().sum::<DVec3>() / 3.0);
        }
    }
    found.into_iter().map(|(patch, bounds, _)| Patch { extent: bounds.diagonal(), ..patch }).collect()
}

/// The flag for more invented surface than the options allow. Skins that were asked for are not counted, and bases always are asked for.
pub(super) fn surface_invented(invented: &Invented, options: &Options) -> Option<RedFlag> {
    let asked = options.open_sheets == OpenSheets::Thicken;
    let skins = if asked { 0.0 } else { invented.skins + invented.opened_skins };
    let (skins, patches) = (invented.share_pct(skins), invented.share_pct(invented.patch_area()));
    let value = (skins + patches).min(100.0);
    let threshold = options.max_surface_added_pct;
    let parts: Vec<String> = [
        (skins > 0.0).then(|| format!("{skins:.1} % for the thickness of open sheets")),
        (patches > 0.0).then(|| format!("{patches:.1} % to close {} large holes", invented.patches.len())),
    ]
    .into_iter()
    .flatten()
    .collect();
    let detail = format!("{value:.1} % of the result's surface was invented: {}", parts.join(", "));
    let places = invented.patches.iter().map(|patch| patch.at).chain(invented.places.iter().copied());
    (value > threshold).then(|| RedFlag {
        code: RedFlagCode::SurfaceInvented,
        value,
        threshold,
        detail,
        places: places.take(MAX_PLACES).map(|at| at.to_array()).collect(),
    })
}
