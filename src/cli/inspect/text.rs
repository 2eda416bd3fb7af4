use std::fmt::Write as _;

use meshmend::inspect::{Answer, Inspection, Measures, Shell, Side, Statistics, Unmeasurable};

use super::Look;
use super::bars::{Style, distribution, figure};
use super::offenders::kind_in_words;

/// Parts that are listed on a terminal; JSON has more.
const MOST_PARTS: usize = 10;

/// Everything, plain words first. `short` lists only kinds of defects, for a list of places that follows has them anyway.
pub fn report(look: &Look, style: Style, short: bool) -> String {
    let it = &look.inspection;
    let mut text = headline(look);
    text += &section("Attributes", &attributes(it));
    text += &section("Counts", &counts(it));
    text += &section("Sizes", &sizes(it));
    if let Some(statistics) = &it.characteristics.statistics {
        text += &shapes(statistics, style);
    }
    text += &parts(it);
    if short && !it.defects.is_empty() {
        let rows: Vec<Row> = it.defects.iter().map(|g| row(kind_in_words(g.kind), g.count)).collect();
        text += &section("Defects", &rows);
    }
    text
}

/// The verdict and the four attributes.
pub fn attributes_only(look: &Look) -> String {
    format!("{}:\n{}", look.name, rows(&attributes(&look.inspection)))
}

type Row = (String, String);

fn row(name: impl Into<String>, value: impl ToString) -> Row {
    (name.into(), value.to_string())
}

fn rows(rows: &[Row]) -> String {
    let mut text = String::new();
    for (name, value) in rows {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {name:28}{value}");
    }
    text
}

fn section(title: &str, given: &[Row]) -> String {
    format!("\n{title}\n{}", rows(given))
}

fn headline(look: &Look) -> String {
    let measures = &look.inspection.measures;
    let verdict = if measures.printable() {
        "printable".to_owned()
    } else {
        format!("not printable: {}", measures.faults().join(", "))
    };
    let mut text = format!("{}: {}\n{verdict}\n", look.name, look.mesh.dialect);
    for warning in &look.mesh.warnings {
        let _ = writeln!(text, "note: {warning}");
    }
    text
}

fn attributes(it: &Inspection) -> Vec<Row> {
    let (given, m) = (&it.characteristics.attributes, &it.measures);
    let answer = |name: &str, answer: Answer, no: String, unknown: &str| {
        row(
            name,
            match answer {
                Answer::Yes => "yes".to_owned(),
                Answer::No => format!("no: {no}"),
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
    vec![
        answer("closed", given.closed, open, ""),
        answer("manifold", given.manifold, pinched, ""),
        answer("consistent", given.consistent, turned, "not manifold"),
        answer("outward", given.outward, inward, assumed),
    ]
}

fn counts(it: &Inspection) -> Vec<Row> {
    let (m, elements) = (&it.measures, &it.characteristics.elements);
    let mut list = vec![
        row("faces", m.faces),
        row("vertices", format!("{} at different places, {} in the file", m.vertices, elements.vertices)),
        row("edges", m.edges),
        row("parts", m.parts),
        row("boundaries", format!("{} of {} edges", m.boundary_loops, m.boundary_edges)),
        row("non-manifold edges", m.nonmanifold_edges),
        row("non-manifold vertices", m.nonmanifold_vertices),
        row("misoriented edges", m.misoriented_edges),
        row("intersecting face pairs", intersecting(m)),
        row("orphan vertices", m.unreferenced_vertices),
        row("missing vertices", missing(it)),
        row(
            "indistinguishable vertices",
            optional(elements.indistinguishable_vertices, "does not apply: faces share no vertex in this file"),
        ),
        row(
            "degenerate faces",
            format!(
                "{}: {} name a vertex twice, {} lie on a line",
                m.degenerate_faces, elements.repeated_vertex_faces, elements.collinear_faces
            ),
        ),
        row("duplicate faces", m.duplicate_faces),
        row("faces not finite", m.nonfinite_faces),
        row("parts inside out", m.inverted_parts),
    ];
    let contiguous = |it: Option<bool>| match it {
        Some(true) => "yes",
        Some(false) => "no",
        None => "does not apply: the format has no numbers",
    };
    list.push(row("vertices numbered 1, 2, ...", contiguous(elements.vertices_contiguous)));
    list.push(row("faces numbered 1, 2, ...", contiguous(elements.faces_contiguous)));
    list
}

fn optional(value: Option<u64>, otherwise: &str) -> String {
    value.map_or_else(|| otherwise.to_owned(), |value| value.to_string())
}

/// The count, and what else is counted of the pairs.
fn intersecting(m: &Measures) -> String {
    let Some(pairs) = m.self_intersections.pairs else { return "not checked".to_owned() };
    let fields = serde_json::to_value(m.self_intersections).unwrap_or_default();
    let more: Vec<String> = fields.as_object().into_iter().flatten().filter_map(in_words).collect();
    if pairs == 0 || more.is_empty() { pairs.to_string() } else { format!("{pairs}: {}", more.join(", ")) }
}

/// A count that is not zero with its name, but for the count of all.
fn in_words((name, value): (&String, &serde_json::Value)) -> Option<String> {
    let count = value.as_u64().filter(|&count| count > 0 && name != "pairs")?;
    Some(format!("{count} {}", name.replace('_', " ")))
}

fn missing(it: &Inspection) -> String {
    let elements = &it.characteristics.elements;
    match (elements.missing_vertices, elements.faces_without_vertex) {
        (Some(missing), Some(faces)) if faces > 0 => format!("{missing}, named by {faces} faces that were left out"),
        (missing, _) => optional(missing, "0: such a file is refused"),
    }
}

fn sizes(it: &Inspection) -> Vec<Row> {
    let m = &it.measures;
    let shells = &it.characteristics.shells;
    let volume = figure(m.volume.value);
    let mut list = vec![
        row("area", figure(m.area)),
        row(
            "volume",
            if m.volume.reliable { volume } else { format!("{volume} (not reliable: it is not a closed solid)") },
        ),
        row("genus", genus(shells.genus, shells.genus_not_measurable)),
    ];
    if let Some(b) = m.bounding_box {
        let size: Vec<String> = (0..3).map(|k| figure(b.max[k] - b.min[k])).collect();
        list.push(row("size", size.join(" x ")));
        list.push(row("box", format!("{} to {}", b.min.map(figure).join(", "), b.max.map(figure).join(", "))));
    }
    list
}

fn genus(genus: Option<u64>, why: Option<Unmeasurable>) -> String {
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
    let mut text = "\nShapes\n".to_owned();
    if let Some(area) = &it.face_area {
        text += &distribution("face area", area, style);
    }
    if let Some(ratio) = &it.face_aspect_ratio {
        text += &distribution("face aspect ratio (longest edge / shortest altitude)", ratio, style);
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
    let name = format!("edge angle ({side}, in radians; flat is 3.14159)");
    match (&angle.distribution, angle.not_measurable) {
        (Some(it), _) => text += &distribution(&name, it, style),
        (None, why) => {
            let _ = writeln!(text, "  edge angle: not measurable: {}", why.map_or("unknown", reason));
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
