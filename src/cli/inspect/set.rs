use std::fmt::Write as _;

use meshmend::inspect::SetReport;

use super::bars::{Style, distribution, figure};
use super::offenders::point;

/// What was measured between the files of these names.
pub fn text(set: &SetReport, names: &[&str], intersections: bool, spacing: bool, style: Style) -> String {
    let mut text = format!("\nSet of {} files\n", names.len());
    let name = |i: u32| names.get(i as usize).copied().unwrap_or_default();
    // Writing to a string can't fail.
    match &set.intersections {
        Some(it) => {
            let more = if it.complete { "" } else { " or more: not all were counted" };
            let _ = writeln!(text, "  pairs of intersecting faces between files: {}{more}", it.total);
            for pair in &it.between {
                let more = if pair.complete { "" } else { " or more" };
                let [a, b] = pair.meshes;
                let _ = writeln!(text, "    {} and {}: {}{more}", name(a), name(b), pair.pairs);
            }
        }
        None if intersections => text.push_str("  intersections between files are not counted by this version\n"),
        None => {}
    }
    match &set.spacing {
        Some(it) => {
            if let Some(all) = &it.all {
                text.push_str(&distribution("distance from each vertex to the nearest other file", all, style));
            }
            for (i, of_mesh) in (0u32..).zip(&it.of_mesh) {
                if let Some(distances) = &of_mesh.distances {
                    text.push_str(&distribution(&format!("from {}", name(i)), distances, style));
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
            }
            if !it.complete {
                text.push_str("  not every vertex was measured\n");
            }
        }
        None if spacing => text.push_str("  the spacing of files is not measured by this version\n"),
        None => {}
    }
    text
}
