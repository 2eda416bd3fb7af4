use std::fmt::Write as _;

use meshmend::inspect::{Goodness, Lack, Shortfall, Thresholds};

use super::bars::figure;

/// Reads `ratio,angle,length`.
pub fn thresholds(text: &str) -> Result<Thresholds, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[aspect_ratio, edge_angle, edge_length])
            if [aspect_ratio, edge_angle, edge_length].iter().all(|x| x.is_finite() && *x >= 0.0) =>
        {
            Ok(Thresholds { aspect_ratio, edge_angle, edge_length })
        }
        _ => Err("three numbers are wanted, such as 10,0.1,0.01: aspect ratio, edge angle, edge length".to_owned()),
    }
}

/// `1` or `0`, then which file it was, and why not.
pub fn line(name: &str, it: &Goodness) -> String {
    if it.good {
        return format!("1 {name}\n");
    }
    format!("0 {name}: {}\n", reasons(it))
}

/// The verdict with a line for each reason.
pub fn in_words(name: &str, it: &Goodness) -> String {
    let mut text = format!("{name}: mesh is {}\n", if it.good { "good" } else { "NOT good" });
    for reason in &it.reasons {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {}", in_a_phrase(reason, &it.thresholds));
    }
    text
}

/// Why a mesh is not good, in a line.
pub fn reasons(it: &Goodness) -> String {
    it.reasons.iter().map(|reason| in_a_phrase(reason, &it.thresholds)).collect::<Vec<_>>().join(", ")
}

/// What every mesh meets that has nothing wrong with it.
pub const SOUND: Thresholds = Thresholds { aspect_ratio: f64::INFINITY, edge_angle: 0.0, edge_length: 0.0 };

fn in_a_phrase(reason: &Shortfall, than: &Thresholds) -> String {
    let value = reason.value.map_or_else(|| "unknown".to_owned(), figure);
    match reason.lack {
        Lack::Closed => format!("not closed (boundary edges: {value})"),
        Lack::Manifold => format!("not manifold (non-manifold edges and vertices: {value})"),
        Lack::Consistent => format!("not consistent (misoriented edges: {value})"),
        Lack::Outward if reason.value.is_some() => format!("not outward (parts turned inward: {value})"),
        Lack::Outward => "not known to be outward".to_owned(),
        Lack::NoIntersectingFaces => format!("pairs of intersecting faces: {value}"),
        Lack::IntersectionsChecked => "intersecting faces were not looked for".to_owned(),
        Lack::NoOrphanVertices => format!("orphan vertices: {value}"),
        Lack::NoMissingVertices => format!("missing vertices: {value}"),
        Lack::NoDegenerateFaces => format!("degenerate faces: {value}"),
        Lack::FiniteFaces => format!("faces that are not finite: {value}"),
        Lack::ContiguousVertices => "vertices are not numbered 1, 2, 3 and so on".to_owned(),
        Lack::ContiguousFaces => "faces are not numbered 1, 2, 3 and so on".to_owned(),
        Lack::AspectRatio => format!("largest aspect ratio {value} is not below {}", figure(than.aspect_ratio)),
        Lack::EdgeAngle => format!("smallest edge angle {value} is not above {}", figure(than.edge_angle)),
        Lack::EdgeLength => format!("smallest edge length {value} is not above {}", figure(than.edge_length)),
    }
}
