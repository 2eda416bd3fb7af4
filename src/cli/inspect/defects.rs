//! Defects with their places, the gravest first, and offending elements by the numbers that the file gives them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use meshmend::inspect::{Analysis, Defect, DefectKind, Inspection, Level, Meeting, Thresholds, aspect_ratio};
use meshmend::mesh::Edges;
use meshmend::render::palette::{BY_GRAVITY, in_words};

use super::figures::{figure, point};
use super::subject::Inspected;

/// Places in the whole of a short list, and of one kind.
const MOST_PLACES: usize = 12;
const MOST_OF_A_KIND: usize = 3;
/// Faces of a place in a short list.
const MOST_FACES: usize = 4;
/// How wide a list of names may be.
const WIDTH: usize = 100;

/// What is wrong where, gravest first: every place that is known, or the first few. Nothing at level none, which does not
/// look for defects.
pub fn section(file: &Inspected, all: bool) -> String {
    let (it, findings) = (&file.inspection, &file.findings);
    if it.level == Level::None {
        return String::new();
    }
    let found: Vec<DefectKind> = BY_GRAVITY.into_iter().filter(|&kind| findings.count(kind) > 0).collect();
    let most = if all { usize::MAX } else { (MOST_PLACES / found.len().max(1)).clamp(1, MOST_OF_A_KIND) };
    let wide = found.iter().map(|&kind| findings.count(kind).to_string().len()).max().unwrap_or(0);
    let wide_name = found.iter().map(|&kind| in_words(kind, findings.count(kind)).len()).max().unwrap_or(0);
    let incomplete = BY_GRAVITY.into_iter().any(|kind| given_up(it, kind));
    if found.is_empty() && !incomplete && it.level == Level::Full {
        return format!("\nDefects: none of the {} kinds\n", BY_GRAVITY.len());
    }
    let numbering = file.mesh.numbering.as_ref();
    let counted = if numbering.is_some() { "as in the file" } else { "from 0" };
    let mut text = format!("\nDefects, the gravest first; faces are numbered {counted}\n");
    for &kind in &found {
        let count = findings.count(kind);
        let mut lines = remarks(kind, it);
        lines.extend(by_gravity(kind, findings.places(kind)).iter().take(most).map(|place| {
            let face = |index: u32| numbering.map_or(index, |it| it.face(index));
            in_a_line(kind, place, all, face)
        }));
        let mut head = format!("{count:>wide$}  {:wide_name$}", in_words(kind, count));
        for line in lines {
            // Writing to a string can't fail.
            let _ = writeln!(text, "  {head}  {line}");
            head = " ".repeat(head.len());
        }
    }
    let names = |keep: &dyn Fn(DefectKind) -> bool| BY_GRAVITY.into_iter().filter(|&kind| keep(kind)).collect();
    let none = names(&|kind| it.level.looks_for(kind) && findings.count(kind) == 0 && !given_up(it, kind));
    text += &list("none of:", none);
    text += &list("given up before the end, there may be more:", names(&|kind| given_up(it, kind)));
    text + &list("not looked for at this level:", names(&|kind| !it.level.looks_for(kind)))
}

fn given_up(it: &Inspection, kind: DefectKind) -> bool {
    let pairs = &it.measures.self_intersections;
    it.incomplete.contains(&kind) || kind == DefectKind::SelfIntersection && pairs.checked && !pairs.complete
}

/// Names of kinds on lines that are not too long; nothing where there is no kind.
fn list(title: &str, kinds: Vec<DefectKind>) -> String {
    let mut text = String::new();
    let mut line = format!("  {title}");
    let last = kinds.len().saturating_sub(1);
    for (i, &kind) in kinds.iter().enumerate() {
        let word = format!("{}{}", in_words(kind, 2), if i < last { "," } else { "" });
        if line.len() + 1 + word.len() > WIDTH {
            text += &line;
            line = "\n   ".to_owned();
        }
        line = format!("{line} {word}");
    }
    if kinds.is_empty() { String::new() } else { format!("{text}{line}\n") }
}

/// What is to be said of all defects of a kind.
fn remarks(kind: DefectKind, it: &Inspection) -> Vec<String> {
    match kind {
        DefectKind::SelfIntersection => {
            let pairs = &it.measures.self_intersections;
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
        DefectKind::Disjoint | DefectKind::InnerShell => vec!["no fault by itself".to_owned()],
        _ => Vec::new(),
    }
}

/// The places of a kind, the gravest first and else as they were found: the longest hole and the widest gap, but of what is
/// too thin or too small the least.
fn by_gravity(kind: DefectKind, places: &[Defect]) -> Vec<&Defect> {
    use DefectKind as K;
    let gravity = |place: &Defect| match (kind, place.meeting, place.value) {
        (K::FlatFace | K::DegenerateFace | K::TJunction | K::Sheet | K::TinyPart, _, value) => -value.unwrap_or(0.0),
        (_, Some(Meeting::Crossing), _) => 2.0,
        (_, Some(Meeting::Coplanar), _) => 1.0,
        (.., value) => value.unwrap_or(0.0).abs(),
    };
    let mut sorted: Vec<&Defect> = places.iter().collect();
    sorted.sort_by(|a, b| gravity(b).total_cmp(&gravity(a)));
    sorted
}

fn in_a_line(kind: DefectKind, place: &Defect, all: bool, number: impl Fn(u32) -> u32) -> String {
    let mut text = format!("at {}", point(place.at));
    let shown = if all { place.faces.len() } else { place.faces.len().min(MOST_FACES) };
    let faces: Vec<String> = place.faces[..shown].iter().map(|&face| number(face).to_string()).collect();
    // Writing to a string can't fail.
    let _ = match place.faces.len() {
        0 => Ok(()),
        1 => write!(text, ", face {}", faces[0]),
        more => write!(text, ", faces {}{}", faces.join(" "), if more > shown { " ..." } else { "" }),
    };
    if let Some(value) = place.value {
        let _ = write!(text, ", {}", measured(kind, value));
    }
    match place.meeting {
        None => {}
        Some(Meeting::Crossing) => text.push_str(", crossing"),
        Some(Meeting::Touching) => text.push_str(", touching"),
        Some(Meeting::Coplanar) => text.push_str(", in one plane"),
    }
    if all && !place.line.is_empty() {
        let points: Vec<String> = place.line.iter().copied().map(point).collect();
        let _ = write!(text, ", along {}", points.join(" "));
    }
    text
}

/// The value of a defect in words.
fn measured(kind: DefectKind, value: f64) -> String {
    use DefectKind as K;
    let number = figure(value);
    match kind {
        K::Disjoint => format!("{number} faces in it"),
        K::NonManifoldEdge => format!("{number} faces at it"),
        K::NonManifoldVertex => format!("{number} fans"),
        K::Foldover | K::FlatFace => format!("height {number}"),
        K::DegenerateFace => format!("an edge of length {number}"),
        K::Slit | K::TJunction | K::Crack => format!("gap {number}"),
        K::BadVertexNormal => format!("off by {number} rad"),
        K::Hole => format!("length {number}"),
        K::InvertedPart => format!("within {number} others"),
        K::InnerShell if value < 0.0 => format!("a solid within {} others", figure(-value)),
        K::InnerShell => format!("a cavity within {number} others"),
        K::Sheet => format!("thickness {number}"),
        K::TinyPart => format!("diagonal {number}"),
        K::SelfIntersection | K::Corrupt | K::MisorientedEdge | K::DuplicateFace | K::OppositeFace => number,
    }
}

/// Vertices, edges and faces that keep the mesh from being good, each kind in a list, by vertex and face numbers of the file; where it gives
/// none, they count from 0. Nothing where there is no offender.
pub fn offenders(file: &Inspected, analysis: &Analysis<'_>, thresholds: Option<&Thresholds>) -> String {
    let numbering = file.mesh.numbering.as_ref();
    let vertex = |index: u32| numbering.map_or(index, |it| it.vertex(index));
    let face = |index: u32| numbering.map_or(index, |it| it.face(index));
    let (surface, soup) = (&analysis.surface, &file.mesh.soup);
    let face_of = |f: u32| face(surface.source[f as usize]);
    let corner_of = |h: u32| vertex(soup.faces[surface.source[h as usize / 3] as usize][h as usize % 3]);
    let edge_of = |h: u32| format!("{} {}", corner_of(h), corner_of(Edges::next(h)));
    let (mut border, mut shared, mut flipped, mut short) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (edge, half_edges) in analysis.edges.iter().enumerate() {
        let Some(&first) = half_edges.first() else { continue };
        let faces: Vec<String> = half_edges.iter().map(|h| face_of(h / 3).to_string()).collect();
        let line = format!("{} of face {}", edge_of(first), faces.join(" "));
        let [a, b] = analysis.edges.vertices(edge).map(|v| surface.positions[v as usize]);
        if thresholds.is_some_and(|than| a.distance(b) <= than.edge_length) {
            short.push(line.clone());
        }
        match half_edges {
            [_] => border.push(line),
            [x, y] if Edges::is_forward(&surface.faces, *x) == Edges::is_forward(&surface.faces, *y) => {
                flipped.push(line)
            }
            [_, _] => {}
            _ => shared.push(line),
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
    let missing = numbering.map_or_else(Vec::new, |it| numbers(&it.missing));
    let omitted = numbering.map_or_else(Vec::new, |it| it.omitted.iter().map(|face| face.number.to_string()).collect());
    let is_thin = |&f: &u32| {
        let is_over = |than: &Thresholds| aspect_ratio(analysis, f).is_some_and(|ratio| ratio >= than.aspect_ratio);
        thresholds.is_some_and(is_over)
    };
    let thin = (0u32..).take(surface.faces.len()).filter(is_thin).map(|f| face_of(f).to_string()).collect();
    let lists = [
        ("border edges", border),
        ("non-manifold edges", shared),
        ("flipped edges", flipped),
        ("non-manifold vertices", pinched(analysis, corner_of)),
        ("orphan vertices", orphans),
        ("missing vertices", missing),
        ("faces that name missing vertices", omitted),
        ("edges that are too short", short),
        ("faces of too large an aspect ratio", thin),
    ];
    let mut text = String::new();
    for (name, list) in lists.iter().filter(|(_, list)| !list.is_empty()) {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {name} ({}): {}", list.len(), list.join(", "));
    }
    let counted = if numbering.is_some() { "as in the file" } else { "from 0" };
    if text.is_empty() { text } else { format!("\nOffending elements, numbered {counted}\n{text}") }
}

/// Vertices of more than one fan.
fn pinched(analysis: &Analysis<'_>, number: impl Fn(u32) -> u32) -> Vec<String> {
    let mut fans: BTreeMap<u32, (u32, u32)> = BTreeMap::new();
    let mut found = Vec::new();
    let faces = analysis.surface.faces.as_flattened();
    for ((corner, &v), &fan) in (0u32..).zip(faces).zip(&analysis.fans.of_corner) {
        let [a, b, c] = analysis.surface.faces[corner as usize / 3];
        if a == b || b == c || c == a {
            continue;
        }
        let (first, told) = fans.entry(v).or_insert((fan, 0));
        if *first != fan && *told == 0 {
            *told = 1;
            found.push(number(corner).to_string());
        }
    }
    found
}
