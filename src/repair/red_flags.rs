use super::operators::orient::Nested;
use super::{Changes, Context, InsideRule, Ledger, LostPart, OpenSheets, Options, RedFlag, RedFlagCode};
use crate::inspect::{Measures, Volume, percent};

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
pub fn red_flags(
    before: &Measures,
    settled: Volume,
    after: &Measures,
    changes: &Changes,
    standing: Standing,
    options: &Options,
) -> Vec<RedFlag> {
    let mut flags = Vec::new();
    let mut raise = |code, value: f64, threshold: f64, detail: String| {
        if value > threshold {
            flags.push(RedFlag { code, value, threshold, detail, places: Vec::new() });
        }
    };
    let unsound = before.degenerate_faces + before.duplicate_faces + before.nonfinite_faces;
    let sound = before.faces.saturating_sub(unsound + standing.faces_dropped);
    // What the result has not as it was, and has around itself on both sides, was an inner wall.
    let gone = before.faces as f64 * (100.0 - changes.faces_kept_pct) / 100.0;
    let buried = gone * changes.faces_buried_pct.unwrap_or(0.0) / 100.0;
    let lost = percent(sound as f64 - buried - after.faces as f64, sound as f64).unwrap_or(0.0).max(0.0);
    raise(
        RedFlagCode::FaceLoss,
        if options.asks_for_fewer_faces() || standing.faces == 0 { 0.0 } else { lost },
        options.max_face_loss_pct,
        format!(
            "{lost:.1} % of the faces were lost: {sound} sound faces before, {buried:.0} of them inside the result, {} after",
            after.faces
        ),
    );
    let vertices_lost = vertices_lost_pct(after, changes, standing);
    raise(
        RedFlagCode::VertexLoss,
        if options.asks_for_fewer_faces() || standing.faces == 0 { 0.0 } else { vertices_lost },
        options.max_vertex_loss_pct,
        format!(
            "{vertices_lost:.1} % of the vertices were lost: of {} before, {} are at faces that are left",
            standing.vertices_before, standing.vertices
        ),
    );
    let moved = changes.box_change_pct.unwrap_or(0.0);
    raise(
        RedFlagCode::BoxChange,
        moved,
        options.max_box_change_pct,
        format!("a side of the bounding box moved by {moved:.1} % of its diagonal"),
    );
    // Where the options say what is solid, the volume of the input as it is wound says nothing.
    let is_redefined = options.nested == Nested::Alternate || options.inside != InsideRule::Auto;
    let volume = changes.volume_change_pct.filter(|_| !is_redefined).map_or(0.0, f64::abs);
    // A solid whose orientation could not be told changes the sign of its volume and nothing else.
    let size = percent(after.volume.value.abs() - settled.value.abs(), settled.value).map_or(0.0, f64::abs);
    // Whoever asks for sheets to be made solid says what is to be inside.
    let asked_for_shell = matches!(options.open_sheets, OpenSheets::Thicken | OpenSheets::Base) && !before.closed;
    match changes.inside_overlap_pct.filter(|_| !is_redefined) {
        Some(_) if asked_for_shell => {}
        Some(overlap) if !before.closed => raise(
            RedFlagCode::VolumeChange,
            100.0 - overlap,
            options.max_volume_change_pct,
            format!("only {overlap:.1} % of what the open surface has inside, by winding number, is inside the result"),
        ),
        Some(overlap) => raise(
            RedFlagCode::VolumeChange,
            100.0 - overlap,
            options.max_volume_change_pct,
            format!("only {overlap:.1} % of what is inside the model before or after is so in both"),
        ),
        None => raise(
            RedFlagCode::VolumeChange,
            volume.min(size),
            options.max_volume_change_pct,
            format!(
                "the volume changed by {:.1} %: {} before, {} after",
                volume.min(size),
                settled.value,
                after.volume.value
            ),
        ),
    }
    // Sheets that are thickened to both sides as thick as was asked for are where nothing was before.
    let offset = options.open_sheets == OpenSheets::Thicken && options.thickness.is_some() && before.boundary_edges > 0;
    let lost = changes.surface_lost_pct.filter(|_| !offset).unwrap_or(0.0);
    raise(
        RedFlagCode::SurfaceLost,
        lost,
        options.max_surface_lost_pct,
        format!(
            "{lost:.1} % of the surface that can be seen from outside has no counterpart in the result or lies within it"
        ),
    );
    if let (Some(most), Some(moved)) = (options.max_deviation, changes.moved) {
        let farthest = moved.distance.max;
        raise(
            RedFlagCode::Deviation,
            farthest,
            most + ROUNDING * largest_coordinate(before),
            format!("surface other than hole patches is {farthest} from the input's, and max_deviation is {most}"),
        );
    }
    // Where faces were asked to go, those that stand tell nothing of what became of parts.
    let united = standing.parts_gone == 0 || options.asks_for_fewer_faces();
    if before.parts > 1 && after.parts == 1 && !united && (standing.faces as f64) < LEAST_STANDING * sound as f64 {
        raise(RedFlagCode::PartsMerged, before.parts as f64, 1.0, format!("{} parts became one", before.parts));
    }
    flags
}

/// Share of the vertices that no face of the result is left of, in percent, as far as the result has fewer vertices too. Those inside
/// the result now were on inner walls, and vertices that were merged are not lost.
fn vertices_lost_pct(after: &Measures, changes: &Changes, standing: Standing) -> f64 {
    let before = standing.vertices_before as f64;
    let gone = before - standing.vertices as f64;
    let sunk = gone * changes.faces_buried_pct.unwrap_or(0.0) / 100.0;
    let lost = (gone - sunk).min(before - sunk - after.vertices as f64);
    percent(lost, before).unwrap_or(0.0).max(0.0)
}

/// The flag for parts that are neither in the result nor certified, which the log tells too, since it is an error of the
/// program.
pub(super) fn part_lost(ledger: &Ledger, context: &Context<'_>) -> Option<RedFlag> {
    let first = ledger.lost_parts.first()?;
    let LostPart { part, first_face, faces, .. } = first;
    let detail = format!(
        "{} of {} parts are neither in the result nor duplicates, without volume, or inside another; the first is part {part} \
         of {faces} faces from face {first_face} on",
        ledger.lost, ledger.parts
    );
    context.log(&format!("part lost: {detail}"));
    Some(RedFlag { code: RedFlagCode::PartLost, value: ledger.lost as f64, threshold: 0.0, detail, places: Vec::new() })
}

fn largest_coordinate(measures: &Measures) -> f64 {
    let largest = |side: [f64; 3]| side.into_iter().map(f64::abs).fold(0.0, f64::max);
    measures.bounding_box.map_or(0.0, |it| largest(it.min).max(largest(it.max)))
}
