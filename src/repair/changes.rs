use super::{Cancelled, Changes, Context, Options, RedFlag, RedFlagCode};
use crate::inspect::{BoundingBox, Measures, surface_lost_pct};
use crate::mesh::Soup;

/// Share of the sound faces that must stand for parts to have been joined rather than lost; the rest are slivers that
/// rounding made degenerate.
const LEAST_STANDING: f64 = 0.98;

/// How the result differs from the input.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn compare(
    before: &Measures,
    after: &Measures,
    input: &Soup,
    output: &Soup,
    context: &Context<'_>,
) -> Result<Changes, Cancelled> {
    let volume = before.volume.reliable && after.volume.reliable;
    let standing = standing_faces(input, output);
    Ok(Changes {
        surface_lost_pct: surface_lost_pct(input, output, &standing, context)?,
        faces: difference(after.faces, before.faces),
        vertices: difference(after.vertices, before.vertices),
        parts: difference(after.parts, before.parts),
        face_loss_pct: percent(before.faces as f64 - after.faces as f64, before.faces as f64).unwrap_or(0.0),
        faces_kept_pct: kept_pct(&standing),
        box_change_pct: box_change_pct(before.bounding_box, after.bounding_box),
        area_change_pct: percent(after.area - before.area, before.area),
        volume_change_pct: percent(after.volume.value - before.volume.value, before.volume.value).filter(|_| volume),
    })
}

fn difference(after: u64, before: u64) -> i64 {
    after.cast_signed().saturating_sub(before.cast_signed())
}

fn percent(part: f64, whole: f64) -> Option<f64> {
    let value = part / whole.abs() * 100.0;
    (whole != 0.0 && value.is_finite()).then_some(value)
}

/// The largest move of a side of the box over its diagonal before, in percent.
fn box_change_pct(before: Option<BoundingBox>, after: Option<BoundingBox>) -> Option<f64> {
    let (b, a) = (before?, after?);
    let moved = (0..3).map(|k| (a.min[k] - b.min[k]).abs().max((a.max[k] - b.max[k]).abs())).fold(0.0, f64::max);
    percent(moved, b.diagonal())
}

/// Share of faces that stand, in percent. 100 where there is no face.
fn kept_pct(standing: &[bool]) -> f64 {
    let kept = standing.iter().filter(|&&stands| stands).count();
    percent(kept as f64, standing.len() as f64).unwrap_or(100.0)
}

/// Of each input face, whether it stands in the output at the same three positions as f32, whatever its direction.
fn standing_faces(input: &Soup, output: &Soup) -> Vec<bool> {
    let there = keys(output);
    let mut standing = vec![false; input.faces.len()];
    let mut at = 0;
    for (key, face) in keys(input) {
        while there.get(at).is_some_and(|(other, _)| *other < key) {
            at += 1;
        }
        standing[face] = there.get(at).is_some_and(|(other, _)| *other == key);
    }
    standing
}

/// The faces as sorted triples of f32 positions, sorted, each with its index.
#[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
fn keys(soup: &Soup) -> Vec<([[u32; 3]; 3], usize)> {
    let mut keys: Vec<_> = (0..soup.faces.len())
        .map(|f| {
            let mut key = soup.corners(f).map(|p| p.to_array().map(|x| (x as f32 + 0.0).to_bits()));
            key.sort_unstable();
            (key, f)
        })
        .collect();
    keys.sort_unstable();
    keys
}

/// The signs that a repair destroyed something. Degenerate, duplicate and non-finite faces of the input count as none:
/// they are gone with a reason.
///
/// `standing` is how many faces of the input are in the result, whole or cut. Parts that became one are no bad sign
/// where all sound faces are: they were pieces of one surface along a crack.
#[must_use]
pub fn red_flags(
    before: &Measures,
    after: &Measures,
    changes: &Changes,
    standing: u64,
    options: &Options,
) -> Vec<RedFlag> {
    let mut flags = Vec::new();
    let mut raise = |code, value: f64, threshold: f64, detail: String| {
        if value > threshold {
            flags.push(RedFlag { code, value, threshold, detail });
        }
    };
    let sound = before.faces.saturating_sub(before.degenerate_faces + before.duplicate_faces + before.nonfinite_faces);
    let lost = percent(sound as f64 - after.faces as f64, sound as f64).unwrap_or(0.0);
    raise(
        RedFlagCode::FaceLoss,
        lost,
        options.max_face_loss_pct,
        format!("{:.1} % of the faces were lost: {sound} sound faces before, {} after", lost, after.faces),
    );
    let moved = changes.box_change_pct.unwrap_or(0.0);
    raise(
        RedFlagCode::BoxChange,
        moved,
        options.max_box_change_pct,
        format!("a side of the bounding box moved by {moved:.1} % of its diagonal"),
    );
    let volume = changes.volume_change_pct.map_or(0.0, f64::abs);
    // An inside-out solid that was turned changes the sign of its volume and nothing else.
    let size = percent(after.volume.value.abs() - before.volume.value.abs(), before.volume.value).map_or(0.0, f64::abs);
    raise(
        RedFlagCode::VolumeChange,
        volume.min(size),
        options.max_volume_change_pct,
        format!(
            "the volume changed by {:.1} %: {} before, {} after",
            volume.min(size),
            before.volume.value,
            after.volume.value
        ),
    );
    let lost = changes.surface_lost_pct.unwrap_or(0.0);
    raise(
        RedFlagCode::SurfaceLost,
        lost,
        options.max_surface_lost_pct,
        format!("{lost:.1} % of the surface that can be seen from outside has no counterpart in the result"),
    );
    if before.parts > 1 && after.parts == 1 && (standing as f64) < LEAST_STANDING * sound as f64 {
        raise(RedFlagCode::PartsMerged, before.parts as f64, 1.0, format!("{} parts became one", before.parts));
    }
    flags
}
