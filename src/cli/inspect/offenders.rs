use std::fmt::Write as _;

use meshmend::inspect::{Defect, DefectKind, Inspection, Meeting};

use super::bars::figure;

/// A kind of defect in words.
pub fn kind_in_words(kind: DefectKind) -> String {
    let value = serde_json::to_value(kind).unwrap_or_default();
    value.as_str().unwrap_or_default().replace('_', " ")
}

/// Every defect of which a place is known, a line each.
pub fn all(inspection: &Inspection) -> String {
    let mut text = "\nOffending elements, faces numbered from 0\n".to_owned();
    if inspection.defects.is_empty() {
        text.push_str("  none\n");
    }
    for group in &inspection.defects {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {} ({})", kind_in_words(group.kind), group.count);
        for place in &group.places {
            let _ = writeln!(text, "    {}", in_a_line(place));
        }
    }
    text
}

fn in_a_line(place: &Defect) -> String {
    let mut text = format!("at {}", point(place.at));
    if !place.faces.is_empty() {
        let faces: Vec<String> = place.faces.iter().map(u32::to_string).collect();
        let _ = write!(text, "  faces {}", faces.join(", "));
    }
    if !place.line.is_empty() {
        let points: Vec<String> = place.line.iter().copied().map(point).collect();
        let _ = write!(text, "  along {}", points.join(" "));
    }
    if let Some(value) = place.value {
        let _ = write!(text, "  value {}", figure(value));
    }
    match place.meeting {
        None => {}
        Some(Meeting::Crossing) => text.push_str("  crossing"),
        Some(Meeting::Touching) => text.push_str("  touching"),
        Some(Meeting::Coplanar) => text.push_str("  in one plane"),
    }
    text
}

/// A place in words.
pub fn point([x, y, z]: [f64; 3]) -> String {
    format!("({}, {}, {})", figure(x), figure(y), figure(z))
}
