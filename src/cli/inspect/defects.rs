use std::fmt::Write as _;

use meshmend::inspect::{Defect, DefectKind, Inspection, Level, Meeting};
use meshmend::render::palette::{BY_GRAVITY, in_words};

use super::Look;
use super::bars::figure;

/// Places in the whole of a short list, and of one kind.
const MOST_PLACES: usize = 12;
const MOST_OF_A_KIND: usize = 3;
/// Faces of a place in a short list.
const MOST_FACES: usize = 4;
/// How wide a list of names may be.
const WIDTH: usize = 100;

/// What is wrong where, gravest first: every place that is known, or the first few. Nothing at level none, which does not
/// look for defects.
pub fn section(look: &Look, all: bool) -> String {
    let (it, findings) = (&look.inspection, &look.findings);
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
    let numbering = look.mesh.numbering.as_ref();
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

/// A place in words.
pub fn point([x, y, z]: [f64; 3]) -> String {
    format!("({}, {}, {})", figure(x), figure(y), figure(z))
}
