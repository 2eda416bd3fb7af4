//! Lists defects with their places, most severe first, and offending elements by their numbers in the file.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use meshmend::inspect::{Analysis, Defect, DefectKind, Inspection, Level, Meeting, Thresholds, aspect_ratio};
use meshmend::mesh::Edges;
use meshmend::render::palette::{BY_SEVERITY, in_words};

use super::inspected::Inspected;
use super::numbers::{format_number, format_point};

/// Most places in a short list, in total and per kind.
const MAX_PLACES: usize = 12;
const MAX_PLACES_PER_KIND: usize = 3;
/// Most faces per place in a short list.
const MAX_FACES_PER_PLACE: usize = 4;
/// Longest line of a list of names.
const LINE_WIDTH: usize = 100;

/// The section "Defects", most severe first: with `all`, every known place, otherwise the first few. Empty at level
/// none, which does not look for defects.
pub fn section(file: &Inspected, all: bool) -> String {
    let (inspection, findings) = (&file.inspection, &file.findings);
    if inspection.level == Level::None {
        return String::new();
    }
    let kinds: Vec<DefectKind> = BY_SEVERITY.into_iter().filter(|&kind| findings.count(kind) > 0).collect();
    let max_places = if all { usize::MAX } else { (MAX_PLACES / kinds.len().max(1)).clamp(1, MAX_PLACES_PER_KIND) };
    let count_width = kinds.iter().map(|&kind| findings.count(kind).to_string().len()).max().unwrap_or(0);
    let name_width = kinds.iter().map(|&kind| in_words(kind, findings.count(kind)).len()).max().unwrap_or(0);
    let incomplete = BY_SEVERITY.into_iter().any(|kind| is_unfinished(inspection, kind));
    if kinds.is_empty() && !incomplete && inspection.level == Level::Full {
        return format!("\nDefects: none (all {} kinds checked)\n", BY_SEVERITY.len());
    }
    let numbering = file.mesh.numbering.as_ref();
    let origin = if numbering.is_some() { "as in the file" } else { "from 0" };
    let mut text = format!("\nDefects, most severe first; faces are numbered {origin}\n");
    for &kind in &kinds {
        let count = findings.count(kind);
        let mut lines = kind_remarks(kind, inspection);
        lines.extend(by_severity(kind, findings.places(kind)).iter().take(max_places).map(|place| {
            let face = |index: u32| numbering.map_or(index, |numbering| numbering.face(index));
            place_line(kind, place, all, face)
        }));
        let mut label = format!("{count:>count_width$}  {:name_width$}", in_words(kind, count));
        for line in lines {
            // Writing to a string can't fail.
            let _ = writeln!(text, "  {label}  {line}");
            label = " ".repeat(label.len());
        }
    }
    let names = |keep: &dyn Fn(DefectKind) -> bool| BY_SEVERITY.into_iter().filter(|&kind| keep(kind)).collect();
    let none = names(&|kind| {
        inspection.level.looks_for(kind) && findings.count(kind) == 0 && !is_unfinished(inspection, kind)
    });
    text += &list("not found:", none);
    text += &list("search not finished, there may be more:", names(&|kind| is_unfinished(inspection, kind)));
    text + &list("not checked at this level:", names(&|kind| !inspection.level.looks_for(kind)))
}

/// Whether the search for a kind was stopped before its end.
fn is_unfinished(inspection: &Inspection, kind: DefectKind) -> bool {
    let pairs = &inspection.measures.self_intersections;
    inspection.incomplete.contains(&kind) || kind == DefectKind::SelfIntersection && pairs.checked && !pairs.complete
}

/// Names of kinds, wrapped to the line width; empty without kinds.
fn list(title: &str, kinds: Vec<DefectKind>) -> String {
    let mut text = String::new();
    let mut line = format!("  {title}");
    let last = kinds.len().saturating_sub(1);
    for (i, &kind) in kinds.iter().enumerate() {
        let word = format!("{}{}", in_words(kind, 2), if i < last { "," } else { "" });
        if line.len() + 1 + word.len() > LINE_WIDTH {
            text += &line;
            line = "\n   ".to_owned();
        }
        line = format!("{line} {word}");
    }
    if kinds.is_empty() { String::new() } else { format!("{text}{line}\n") }
}

/// Remarks on all defects of a kind.
fn kind_remarks(kind: DefectKind, inspection: &Inspection) -> Vec<String> {
    match kind {
        DefectKind::SelfIntersection => {
            let pairs = &inspection.measures.self_intersections;
            let counts = [
                (pairs.within_one_part, "within one part"),
                (pairs.between_parts, "between parts"),
                (pairs.crossing, "crossing"),
                (pairs.touching, "touching"),
                (pairs.coplanar, "in one plane"),
            ];
            let words = counts.iter().filter(|(count, _)| *count > 0).map(|(count, word)| format!("{count} {word}"));
            let words: Vec<String> = words.chain([format!("of {} faces", pairs.faces)]).collect();
            vec![words.join(", ")]
        }
        DefectKind::Disjoint | DefectKind::InnerShell => vec!["not a defect by itself".to_owned()],
        _ => Vec::new(),
    }
}

/// The places of a kind, most severe first: the longest hole and the widest gap, but the thinnest and the smallest. Places of equal
/// severity stay in their order.
fn by_severity(kind: DefectKind, places: &[Defect]) -> Vec<&Defect> {
    use DefectKind as K;
    let severity = |place: &Defect| match (kind, place.meeting, place.value) {
        (K::FlatFace | K::DegenerateFace | K::TJunction | K::Sheet | K::TinyPart, _, value) => -value.unwrap_or(0.0),
        (_, Some(Meeting::Crossing), _) => 2.0,
        (_, Some(Meeting::Coplanar), _) => 1.0,
        (.., value) => value.unwrap_or(0.0).abs(),
    };
    let mut sorted: Vec<&Defect> = places.iter().collect();
    sorted.sort_by(|a, b| severity(b).total_cmp(&severity(a)));
    sorted
}

/// One place of a defect, on one line.
fn place_line(kind: DefectKind, place: &Defect, all: bool, number: impl Fn(u32) -> u32) -> String {
    let mut text = format!("at {}", format_point(place.at));
    let shown = if all { place.faces.len() } else { place.faces.len().min(MAX_FACES_PER_PLACE) };
    let faces: Vec<String> = place.faces[..shown].iter().map(|&face| number(face).to_string()).collect();
    // Writing to a string can't fail.
    let _ = match place.faces.len() {
        0 => Ok(()),
        1 => write!(text, ", face {}", faces[0]),
        more => write!(text, ", faces {}{}", faces.join(" "), if more > shown { " ..." } else { "" }),
    };
    if let Some(value) = place.value {
        let _ = write!(text, ", {}", value_text(kind, value));
    }
    match place.meeting {
        None => {}
        Some(Meeting::Crossing) => text.push_str(", crossing"),
        Some(Meeting::Touching) => text.push_str(", touching"),
        Some(Meeting::Coplanar) => text.push_str(", in one plane"),
    }
    if all && !place.line.is_empty() {
        let points: Vec<String> = place.line.iter().copied().map(format_point).collect();
        let _ = write!(text, ", along {}", points.join(" "));
    }
    text
}

/// The value of a defect with its meaning.
fn value_text(kind: DefectKind, value: f64) -> String {
    use DefectKind as K;
    let number = format_number(value);
    match kind {
        K::Disjoint => format!("{number} faces"),
        K::NonManifoldEdge => format!("{number} faces meet"),
        K::NonManifoldVertex => format!("{number} fans"),
        K::Foldover | K::FlatFace => format!("height {number}"),
        K::DegenerateFace => format!("an edge of length {number}"),
        K::Slit | K::TJunction | K::Crack => format!("gap {number}"),
        K::BadVertexNormal => format!("off by {number} rad"),
        K::Hole => format!("length {number}"),
        K::InvertedPart => format!("inside {number} others"),
        K::InnerShell if value < 0.0 => format!("a solid inside {} others", format_number(-value)),
        K::InnerShell => format!("a cavity inside {number} others"),
        K::Sheet => format!("thickness {number}"),
        K::TinyPart => format!("diagonal {number}"),
        K::SelfIntersection | K::Corrupt | K::MisorientedEdge | K::DuplicateFace | K::OppositeFace => number,
    }
}

/// Lists the vertices, edges and faces that keep the mesh from being good, by their numbers in the file, or from 0 if the file has no
/// numbers. Empty without offenders.
pub fn offenders(file: &Inspected, analysis: &Analysis<'_>, thresholds: Option<&Thresholds>) -> String {
    let numbering = file.mesh.numbering.as_ref();
    let vertex = |index: u32| numbering.map_or(index, |numbering| numbering.vertex(index));
    let face = |index: u32| numbering.map_or(index, |numbering| numbering.face(index));
    let (surface, soup) = (&analysis.surface, &file.mesh.soup);
    let face_of = |f: u32| face(surface.source[f as usize]);
    let corner_of = |h: u32| vertex(soup.faces[surface.source[h as usize / 3] as usize][h as usize % 3]);
    let edge_of = |h: u32| format!("{} {}", corner_of(h), corner_of(Edges::next(h)));
    let (mut boundary, mut non_manifold, mut flipped, mut short) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (edge, half_edges) in analysis.edges.iter().enumerate() {
        let Some(&first) = half_edges.first() else { continue };
        let faces: Vec<String> = half_edges.iter().map(|h| face_of(h / 3).to_string()).collect();
        let line = format!("{} of face {}", edge_of(first), faces.join(" "));
        let [a, b] = analysis.edges.vertices(edge).map(|v| surface.positions[v as usize]);
        if thresholds.is_some_and(|thresholds| a.distance(b) <= thresholds.edge_length) {
            short.push(line.clone());
        }
        match half_edges {
            [_] => boundary.push(line),
            [x, y] if Edges::is_forward(&surface.faces, *x) == Edges::is_forward(&surface.faces, *y) => {
                flipped.push(line)
            }
            [_, _] => {}
            _ => non_manifold.push(line),
        }
    }
    let mut used = vec![false; soup.positions.len()];
    for &v in soup.faces.iter().flatten() {
        if let Some(used) = used.get_mut(v as usize) {
            *used = true;
        }
    }
    let orphans = (0u32..).zip(&used).filter(|(_, used)| !**used).map(|(v, _)| vertex(v).to_string()).collect();
    let numbers = |list: &[u32]| list.iter().map(u32::to_string).collect::<Vec<_>>();
    let missing = numbering.map_or_else(Vec::new, |numbering| numbers(&numbering.missing));
    let omitted = numbering
        .map_or_else(Vec::new, |numbering| numbering.omitted.iter().map(|face| face.number.to_string()).collect());
    let is_thin = |&f: &u32| {
        let exceeds =
            |thresholds: &Thresholds| aspect_ratio(analysis, f).is_some_and(|ratio| ratio >= thresholds.aspect_ratio);
        thresholds.is_some_and(exceeds)
    };
    let thin = (0u32..).take(surface.faces.len()).filter(is_thin).map(|f| face_of(f).to_string()).collect();
    let lists = [
        ("boundary edges", boundary),
        ("non-manifold edges", non_manifold),
        ("flipped edges", flipped),
        ("non-manifold vertices", non_manifold_vertices(analysis, corner_of)),
        ("orphan vertices", orphans),
        ("missing vertices", missing),
        ("faces that refer to missing vertices", omitted),
        ("edges below the length limit", short),
        ("faces above the aspect ratio limit", thin),
    ];
    let mut text = String::new();
    for (name, list) in lists.iter().filter(|(_, list)| !list.is_empty()) {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {name} ({}): {}", list.len(), list.join(", "));
    }
    let origin = if numbering.is_some() { "as in the file" } else { "from 0" };
    if text.is_empty() { text } else { format!("\nOffending elements, numbered {origin}\n{text}") }
}

/// Vertices with more than one fan of faces.
fn non_manifold_vertices(analysis: &Analysis<'_>, number: impl Fn(u32) -> u32) -> Vec<String> {
    let mut fans: BTreeMap<u32, (u32, bool)> = BTreeMap::new();
    let mut vertices = Vec::new();
    let faces = &analysis.surface.faces;
    for (corner, &v) in (0u32..).zip(faces.as_flattened()) {
        let Some(fan) = analysis.fans.of_corner(faces, corner) else { continue };
        let (first, listed) = fans.entry(v).or_insert((fan, false));
        if *first != fan && !*listed {
            *listed = true;
            vertices.push(number(corner).to_string());
        }
    }
    vertices
}
