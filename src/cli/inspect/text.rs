use std::fmt::Write as _;

use clap::ValueEnum;
use meshmend::inspect::{
    Answer, CheckRule, CheckVerdict, Inspection, Level, Measures, Shell, Side, Statistics, Unmeasurable,
};

use super::bars::{Style, distribution, figure};
use super::print::measures;
use super::{Look, defects};

/// Parts that are listed on a terminal; JSON has more.
const MOST_PARTS: usize = 10;

/// Everything, plain words first, with every place or the first few.
pub fn report(look: &Look, style: Style, all_places: bool) -> String {
    let it = &look.inspection;
    let mut text = headline(look);
    text += &defects::section(look, all_places);
    text += &section("Attributes", &attributes(it, it.level == Level::None));
    text += &section("Counts", &counts(it));
    text += &section("Measures", &measures(it));
    if let Some(statistics) = &it.characteristics.statistics {
        text += &shapes(statistics, style);
    }
    text + &parts(it)
}

/// The verdict and the four attributes.
pub fn attributes_only(look: &Look) -> String {
    format!("{}:\n{}", look.name, rows(&attributes(&look.inspection, true)))
}

/// A name and what is said of it.
pub type Row = (String, String);

pub fn row(name: impl Into<String>, value: impl ToString) -> Row {
    (name.into(), value.to_string())
}

fn rows(rows: &[Row]) -> String {
    let mut text = String::new();
    for (name, value) in rows {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {name:27} {value}");
    }
    text
}

fn section(title: &str, given: &[Row]) -> String {
    format!("\n{title}\n{}", rows(given))
}

fn headline(look: &Look) -> String {
    let measures = &look.inspection.measures;
    let faults = measures.faults().join(", ");
    let verdict = match measures.verdict() {
        Some(true) => "printable".to_owned(),
        Some(false) => format!("not printable: {faults}"),
        None => format!("not known to be printable: {faults}"),
    };
    let mut text = format!("{}: {}\n{verdict}\n", look.name, look.mesh.dialect);
    for warning in look.mesh.warnings.iter().cloned().chain(measures.left_out()) {
        let _ = writeln!(text, "note: {warning}");
    }
    text
}

/// The attributes, where wanted with the counts of what is against them, and whether the level's rules are kept.
fn attributes(it: &Inspection, counted: bool) -> Vec<Row> {
    let (given, m) = (&it.characteristics.attributes, &it.measures);
    let answer = |name: &str, answer: Answer, no: String, unknown: &str| {
        row(
            name,
            match answer {
                Answer::Yes => "yes".to_owned(),
                Answer::No if counted => format!("no: {no}"),
                Answer::No => "no".to_owned(),
                Answer::NotMeasurable => format!("not measurable: {unknown}"),
            },
        )
    };
    let open = format!("{} boundary edges", m.boundary_edges);
    let pinched =
        format!("{} non-manifold edges, {} non-manifold vertices", m.nonmanifold_edges, m.nonmanifold_vertices);
    let turned = format!("{} edges are crossed twice in one direction", m.misoriented_edges);
    let inward = format!("{} parts are turned the wrong way", it.characteristics.shells.inward);
    let assumed = if !m.closed {
        "not closed"
    } else if !m.manifold {
        "not manifold"
    } else if !m.consistent {
        "not consistent"
    } else {
        "it can't be told how the parts lie in one another"
    };
    let mut list = vec![
        answer("closed", given.closed, open, ""),
        answer("manifold", given.manifold, pinched, ""),
        answer("consistent", given.consistent, turned, "not manifold"),
        answer("outward", given.outward, inward, assumed),
    ];
    list.extend(
        it.check.as_ref().map(|check| row(format!("check, level {}", level_name(it.level)), verdict(check, m))),
    );
    list
}

fn level_name(level: Level) -> String {
    level.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Whether the rules of a level are kept, and if not, what is against it.
fn verdict(check: &CheckVerdict, measures: &Measures) -> String {
    let list = |rules: &[CheckRule]| rules.iter().map(|&rule| against(rule)).collect::<Vec<_>>().join(", ");
    let undecided = format!("the search was not finished for {}", list(&check.undecided));
    match (check.passes, check.broken.is_empty(), check.undecided.is_empty()) {
        (true, ..) if measures.printable() && !check.advice.is_empty() => {
            format!("passes; within the tolerances there are {}", list(&check.advice))
        }
        (true, ..) if measures.printable() => "passes".to_owned(),
        (true, ..) => "passes: its rules allow boundaries and faces turned against each other".to_owned(),
        (false, false, true) => format!("fails: {}", list(&check.broken)),
        (false, false, false) => format!("fails: {}; {undecided}", list(&check.broken)),
        (false, true, _) => format!("undecided: {undecided}"),
    }
}

/// What a rule forbids.
fn against(rule: CheckRule) -> &'static str {
    match rule {
        CheckRule::Manifold => "non-manifold edges or vertices",
        CheckRule::NoZeroLengthEdge => "edges of zero length",
        CheckRule::NoZeroAreaFace => "faces of zero area",
        CheckRule::NoOpposedVertexNormal => "opposed vertex normals",
        CheckRule::NoSlit => "slits",
        CheckRule::NoSelfIntersection => "self-intersections",
    }
}

/// Counts of elements; at level none, which lists no defects, those of faults too.
fn counts(it: &Inspection) -> Vec<Row> {
    let (m, elements) = (&it.measures, &it.characteristics.elements);
    let mut list = vec![
        row("faces", m.faces),
        row("vertices", format!("{} at different places, {} in the file", m.vertices, elements.vertices)),
        row("edges", m.edges),
        row("parts", m.parts),
        row("boundaries", format!("{} of {} edges", m.boundary_loops, m.boundary_edges)),
    ];
    let degenerate = format!(
        "{}: {} name a vertex twice, {} lie on a line",
        m.degenerate_faces, elements.repeated_vertex_faces, elements.collinear_faces
    );
    let mut faults = vec![
        (m.unreferenced_vertices, "orphan vertices", m.unreferenced_vertices.to_string()),
        (elements.missing_vertices.unwrap_or(0), "missing vertices", missing(it)),
        (m.degenerate_faces, "faces without area", degenerate),
    ];
    match elements.indistinguishable_vertices {
        Some(count) => faults.push((count, "indistinguishable vertices", count.to_string())),
        None => {
            list.push(row("indistinguishable vertices", "does not apply: faces share no vertex in this file"));
        }
    }
    if it.level == Level::None {
        let more = [
            (m.duplicate_faces, "duplicate faces"),
            (m.nonfinite_faces, "faces not finite"),
            (m.inverted_parts, "parts inside out"),
        ];
        faults.extend(more.map(|(count, name)| (count, name, count.to_string())));
    }
    let none: Vec<&str> = faults.iter().filter(|fault| fault.0 == 0).map(|fault| fault.1).collect();
    list.extend(faults.iter().filter(|fault| fault.0 > 0).map(|(_, name, text)| row(*name, text)));
    if !none.is_empty() {
        list.push(row("none of", none.join(", ")));
    }
    let numbered = [("vertices", elements.vertices_contiguous), ("faces", elements.faces_contiguous)];
    list.extend(numbered.into_iter().filter_map(|(name, contiguous)| {
        Some(row(format!("{name} numbered 1, 2, ..."), if contiguous? { "yes" } else { "no" }))
    }));
    list
}

fn optional(value: Option<u64>, otherwise: &str) -> String {
    value.map_or_else(|| otherwise.to_owned(), |value| value.to_string())
}

fn missing(it: &Inspection) -> String {
    let elements = &it.characteristics.elements;
    let missing = elements.missing_vertices.unwrap_or(0);
    match elements.faces_without_vertex {
        Some(faces) if faces > 0 => format!("{missing}, named by {faces} faces that were left out"),
        _ => missing.to_string(),
    }
}

pub fn genus(genus: Option<u64>, why: Option<Unmeasurable>) -> String {
    optional(genus, &format!("not measurable: {}", why.map_or("unknown", reason)))
}

fn reason(why: Unmeasurable) -> &'static str {
    match why {
        Unmeasurable::NotClosed => "not closed",
        Unmeasurable::NotManifold => "not manifold",
        Unmeasurable::NotConsistent => "not consistent",
        Unmeasurable::NoElement => "there is none",
    }
}

fn shapes(it: &Statistics, style: Style) -> String {
    let mut text = "\nShapes; the aspect ratio is longest edge over shortest altitude\n".to_owned();
    if let Some(area) = &it.face_area {
        text += &distribution("face area", area, style);
    }
    if let Some(ratio) = &it.face_aspect_ratio {
        text += &distribution("aspect ratio", ratio, style);
    }
    if it.faces_without_aspect_ratio > 0 {
        let _ = writeln!(text, "    faces without an aspect ratio: {}", it.faces_without_aspect_ratio);
    }
    if let Some(length) = &it.edge_length {
        text += &distribution("edge length", length, style);
    }
    let angle = &it.edge_angle;
    let side = match angle.side {
        Some(Side::Exterior) => "exterior",
        Some(Side::Interior) => "interior",
        Some(Side::Mixed) => "exterior and interior",
        None => "on the side of the normals",
    };
    match (&angle.distribution, angle.not_measurable) {
        (Some(it), _) => {
            text += &distribution("edge angle", it, style);
            let _ = writeln!(text, "    in radians, {side}; flat is 3.14159");
        }
        (None, why) => {
            let _ = writeln!(text, "  edge angle      not measurable: {}", why.map_or("unknown", reason));
        }
    }
    if angle.edges_without_angle > 0 {
        let _ = writeln!(text, "    edges of degenerate faces, without an angle: {}", angle.edges_without_angle);
    }
    text
}

fn parts(it: &Inspection) -> String {
    let shells = &it.characteristics.shells;
    if shells.list.is_empty() {
        return String::new();
    }
    let mut table = vec![PART_COLUMNS.map(str::to_owned)];
    table.extend(shells.list.iter().take(MOST_PARTS).map(part));
    let wide = |column: usize| table.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let mut text = "\nParts, largest area first\n".to_owned();
    for row in &table {
        let cells: Vec<String> = (0..row.len()).map(|i| format!("{:>1$}", row[i], wide(i))).collect();
        let _ = writeln!(text, "  {}", cells.join("  "));
    }
    let shown = shells.list.len().min(MOST_PARTS) as u64;
    if shells.count > shown {
        let _ = writeln!(text, "  and {} more", shells.count - shown);
    }
    text
}

const PART_COLUMNS: [&str; 9] =
    ["faces", "vertices", "edges", "boundaries", "area", "volume", "genus", "depth", "first face"];

fn part(shell: &Shell) -> [String; 9] {
    let volume = figure(shell.volume.value);
    [
        shell.faces.to_string(),
        shell.vertices.to_string(),
        shell.edges.to_string(),
        shell.boundaries.to_string(),
        figure(shell.area),
        if shell.volume.reliable { volume } else { format!("({volume})") },
        optional(shell.genus, "-"),
        optional(shell.depth.map(u64::from), "-"),
        shell.first_face.to_string(),
    ]
}
