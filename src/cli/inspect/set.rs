use std::fmt::Write as _;

use meshmend::inspect::SetReport;

use super::bars::{Style, distribution, figure, figures};
use super::defects::point;

/// Pairs of files that are listed; JSON has all.
const MOST_PAIRS: usize = 20;

/// What was measured between the files of these names.
pub fn text(set: &SetReport, names: &[&str], style: Style) -> String {
    let mut text = format!("\nSet of {} files\n", names.len());
    let name = |i: u32| names.get(i as usize).copied().unwrap_or_default();
    // Writing to a string can't fail.
    if let Some(it) = &set.intersections {
        let more = if it.complete { "" } else { " or more: not all were counted" };
        let _ = writeln!(text, "  pairs of intersecting faces between files: {}{more}", it.total);
        for pair in it.between.iter().take(MOST_PAIRS) {
            let more = if pair.complete { "" } else { " or more" };
            let [a, b] = pair.meshes;
            let _ = writeln!(text, "    {} and {}: {}{more}", name(a), name(b), pair.pairs);
        }
        if it.between.len() > MOST_PAIRS {
            let _ = writeln!(text, "    and {} more pairs of files", it.between.len() - MOST_PAIRS);
        }
    }
    if let Some(it) = &set.spacing {
        match &it.all {
            Some(all) => text += &distribution("distance from each vertex to the nearest other file", all, style),
            None => text += "  distance from each vertex to the nearest other file: no two files have a face\n",
        }
        for (i, of_mesh) in (0u32..).zip(&it.of_mesh) {
            if let Some(distances) = &of_mesh.distances {
                text += &figures(&format!("from {}", name(i)), distances);
            }
            if let Some(nearest) = &of_mesh.nearest {
                let (from, to) = (point(nearest.from), point(nearest.to));
                let _ = writeln!(
                    text,
                    "    nearest: {} from {from} to {to} on {}, face {}",
                    figure(nearest.distance),
                    name(nearest.mesh),
                    nearest.face
                );
            }
            if !of_mesh.complete {
                text += "    not every vertex was measured\n";
            }
        }
    }
    text
}
