//! The text report of one inspected file.

use std::fmt::Write as _;

use clap::ValueEnum;
use meshmend::inspect::{
    Answer, CheckRule, CheckVerdict, Fit, Inspection, Level, Measures, NoWallReason, Overhang, OverhangArea,
    PrintMeasures, Shell, Side, Statistics, Unmeasurable,
};
use meshmend::printing::readiness::PrintReadiness;
use meshmend::printing::rules::RuleOutcome;
use meshmend::scene::{Unit, UnitSource};

use super::defects;
use super::inspected::Inspected;
use super::numbers::{Style, distribution, format_number, format_point};

/// Most parts in the text; JSON lists more.
const MAX_PARTS: usize = 10;

/// The whole report, verdict first; with `all_places`, every place of a defect, otherwise the first few.
pub fn report(file: &Inspected, style: Style, all_places: bool) -> String {
    let inspection = &file.inspection;
    let mut text = headline(file);
    text += &defects::section(file, all_places);
    text += &section("Attributes", &attributes(inspection, inspection.level == Level::None));
    text += &section("Counts", &counts(inspection));
    text += &section("Measures", &measures(inspection));
    if let Some(statistics) = &inspection.characteristics.statistics {
        text += &shapes(statistics, style);
    }
    text += &parts(inspection);
    text + &file.print_ready.as_ref().map_or_else(String::new, readiness)
}

/// Whether the file meets each rule of the process, and its hollows.
fn readiness(readiness: &PrintReadiness) -> String {
    let rules = readiness.rules.iter().map(|rule| {
        let verdict = match rule.result {
            RuleOutcome::Pass => "pass",
            RuleOutcome::Fail => "FAIL",
            RuleOutcome::Undecided => "undecided",
        };
        let number = |name: &str, value: Option<f64>| value.map(|value| format!("{name} {}", format_number(value)));
        let numbers = [number("limit", rule.limit), number("measured", rule.measured)];
        let at = rule.places.first().map(|place| format!("at {}", format_point(place.at)));
        let details = [Some(verdict.to_owned())].into_iter().chain(numbers).chain([at, rule.remedy.clone()]);
        row(rule.rule.in_words(), details.flatten().collect::<Vec<_>>().join("; "))
    });
    let cavities = readiness.cavities.iter().map(|cavity| {
        row("sealed cavity", format!("{} mm^3; at {}", format_number(cavity.volume_mm3), format_point(cavity.at)))
    });
    let cups = readiness.cups.iter().map(|cup| {
        let [volume, opening] = [cup.volume_mm3, cup.opening_mm2].map(format_number);
        row(
            "resin cup, as it stands",
            format!("{volume} mm^3; opening {opening} mm^2; drains at {}", format_point(cup.at)),
        )
    });
    section(&format!("Process: {}", readiness.title), &rules.chain(cavities).chain(cups).collect::<Vec<_>>())
}

/// The four attributes, and whether the file passes the rules of its level.
pub fn attributes_only(file: &Inspected) -> String {
    format!("{}:\n{}", file.name, rows(&attributes(&file.inspection, true)))
}

/// A name and its value.
type Row = (String, String);

fn row(name: impl Into<String>, value: impl ToString) -> Row {
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

fn section(title: &str, list: &[Row]) -> String {
    format!("\n{title}\n{}", rows(list))
}

/// File, dialect, verdict and warnings.
fn headline(file: &Inspected) -> String {
    let measures = &file.inspection.measures;
    let faults = measures.faults().join(", ");
    let verdict = match measures.verdict() {
        Some(true) => "printable".to_owned(),
        Some(false) => format!("not printable: {faults}"),
        None => format!("printability unknown: {faults}"),
    };
    let mut text = format!("{}: {}\n{verdict}\n", file.name, file.mesh.dialect);
    for warning in file.mesh.warnings.iter().cloned().chain(measures.omitted()) {
        let _ = writeln!(text, "note: {warning}");
    }
    text
}

/// The attributes, with `with_counts` also the counts of the elements at fault, and whether the rules of the level hold.
fn attributes(inspection: &Inspection, with_counts: bool) -> Vec<Row> {
    let (attributes, m) = (&inspection.characteristics.attributes, &inspection.measures);
    let answer = |name: &str, answer: Answer, no: String, unknown: &str| {
        row(
            name,
            match answer {
                Answer::Yes => "yes".to_owned(),
                Answer::No if with_counts => format!("no: {no}"),
                Answer::No => "no".to_owned(),
                Answer::NotMeasurable => format!("not measurable: {unknown}"),
            },
        )
    };
    let open = format!("{} boundary edges", m.boundary_edges);
    let non_manifold =
        format!("{} non-manifold edges, {} non-manifold vertices", m.non_manifold_edges, m.non_manifold_vertices);
    let misoriented = format!("{} edges whose two faces have opposite orientation", m.misoriented_edges);
    let inward = format!("{} parts are oriented inward", inspection.characteristics.shells.inward);
    let unknown = if !m.closed {
        "not closed"
    } else if !m.manifold {
        "not manifold"
    } else if !m.consistent {
        "not consistent"
    } else {
        "the nesting of the parts is unknown"
    };
    let mut list = vec![
        answer("closed", attributes.closed, open, ""),
        answer("manifold", attributes.manifold, non_manifold, ""),
        answer("consistent", attributes.consistent, misoriented, "not manifold"),
        answer("outward", attributes.outward, inward, unknown),
    ];
    list.extend(
        inspection
            .check
            .as_ref()
            .map(|check| row(format!("check, level {}", level_name(inspection.level)), verdict(check, m))),
    );
    list
}

fn level_name(level: Level) -> String {
    level.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Whether the rules of a level hold, and which do not.
fn verdict(check: &CheckVerdict, measures: &Measures) -> String {
    let list = |rules: &[CheckRule]| rules.iter().map(|&rule| violation(rule)).collect::<Vec<_>>().join(", ");
    let undecided = format!("the search was not finished for {}", list(&check.undecided));
    match (check.passes, check.broken.is_empty(), check.undecided.is_empty()) {
        (true, ..) if measures.printable() && !check.advice.is_empty() => {
            format!("passes; within the tolerances: {}", list(&check.advice))
        }
        (true, ..) if measures.printable() => "passes".to_owned(),
        (true, ..) => "passes: the rules of this level allow boundaries and inconsistent orientation".to_owned(),
        (false, false, true) => format!("fails: {}", list(&check.broken)),
        (false, false, false) => format!("fails: {}; {undecided}", list(&check.broken)),
        (false, true, _) => format!("undecided: {undecided}"),
    }
}

/// What a rule forbids.
fn violation(rule: CheckRule) -> &'static str {
    match rule {
        CheckRule::Manifold => "non-manifold edges or vertices",
        CheckRule::NoZeroLengthEdge => "edges of zero length",
        CheckRule::NoZeroAreaFace => "faces of zero area",
        CheckRule::NoOpposedVertexNormal => "opposed vertex normals",
        CheckRule::NoSlit => "slits",
        CheckRule::NoSelfIntersection => "self-intersections",
    }
}

/// Counts of elements. At level none, which lists no defects, also counts of faults.
fn counts(inspection: &Inspection) -> Vec<Row> {
    let (m, elements) = (&inspection.measures, &inspection.characteristics.elements);
    let mut list = vec![
        row("faces", m.faces),
        row("vertices", format!("{} distinct positions, {} in the file", m.vertices, elements.vertices)),
        row("edges", m.edges),
        row("parts", m.parts),
        row("boundaries", format!("{} of {} edges", m.boundary_loops, m.boundary_edges)),
    ];
    let degenerate = format!(
        "{}: {} with a repeated vertex, {} with collinear vertices",
        m.degenerate_faces, elements.repeated_vertex_faces, elements.collinear_faces
    );
    let mut faults = vec![
        (m.unreferenced_vertices, "orphan vertices", m.unreferenced_vertices.to_string()),
        (elements.missing_vertices.unwrap_or(0), "missing vertices", missing_vertices(inspection)),
        (m.degenerate_faces, "faces without area", degenerate),
    ];
    match elements.indistinguishable_vertices {
        Some(count) => faults.push((count, "indistinguishable vertices", count.to_string())),
        None => {
            list.push(row("indistinguishable vertices", "not applicable: faces share no vertices in this format"));
        }
    }
    if inspection.level == Level::None {
        let more = [
            (m.duplicate_faces, "duplicate faces"),
            (m.non_finite_faces, "faces with non-finite coordinates"),
            (m.inverted_parts, "inverted parts"),
        ];
        faults.extend(more.map(|(count, name)| (count, name, count.to_string())));
    }
    let none: Vec<&str> = faults.iter().filter(|fault| fault.0 == 0).map(|fault| fault.1).collect();
    list.extend(faults.iter().filter(|fault| fault.0 > 0).map(|(_, name, text)| row(*name, text)));
    if !none.is_empty() {
        list.push(row("not found", none.join(", ")));
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

fn missing_vertices(inspection: &Inspection) -> String {
    let elements = &inspection.characteristics.elements;
    let missing = elements.missing_vertices.unwrap_or(0);
    match elements.faces_without_vertex {
        Some(faces) if faces > 0 => format!("{missing}; {faces} faces that refer to them were omitted"),
        _ => missing.to_string(),
    }
}

fn genus(genus: Option<u64>, cause: Option<Unmeasurable>) -> String {
    optional(genus, &format!("not measurable: {}", cause.map_or("unknown", reason)))
}

fn reason(cause: Unmeasurable) -> &'static str {
    match cause {
        Unmeasurable::NotClosed => "not closed",
        Unmeasurable::NotManifold => "not manifold",
        Unmeasurable::NotConsistent => "not consistent",
        Unmeasurable::NoElement => "no element to measure",
    }
}

/// Areas, aspect ratios, lengths and angles.
fn shapes(statistics: &Statistics, style: Style) -> String {
    let mut text = "\nShapes (aspect ratio: longest edge over shortest altitude)\n".to_owned();
    if let Some(area) = &statistics.face_area {
        text += &distribution("face area", area, style);
    }
    if let Some(ratio) = &statistics.face_aspect_ratio {
        text += &distribution("aspect ratio", ratio, style);
    }
    if statistics.faces_without_aspect_ratio > 0 {
        let _ = writeln!(text, "    faces without an aspect ratio: {}", statistics.faces_without_aspect_ratio);
    }
    if let Some(length) = &statistics.edge_length {
        text += &distribution("edge length", length, style);
    }
    let angle = &statistics.edge_angle;
    let side = match angle.side {
        Some(Side::Exterior) => "exterior",
        Some(Side::Interior) => "interior",
        Some(Side::Mixed) => "exterior and interior",
        None => "on the side of the normals",
    };
    match (&angle.distribution, angle.not_measurable) {
        (Some(angles), _) => {
            text += &distribution("edge angle", angles, style);
            let _ = writeln!(text, "    in radians, {side}; a flat edge has 3.14159");
        }
        (None, cause) => {
            let _ = writeln!(text, "  edge angle      not measurable: {}", cause.map_or("unknown", reason));
        }
    }
    if angle.edges_without_angle > 0 {
        let _ = writeln!(text, "    edges of degenerate faces, without an angle: {}", angle.edges_without_angle);
    }
    text
}

/// A table of the largest parts.
fn parts(inspection: &Inspection) -> String {
    let shells = &inspection.characteristics.shells;
    if shells.list.is_empty() {
        return String::new();
    }
    let mut table = vec![PART_COLUMNS.map(str::to_owned)];
    table.extend(shells.list.iter().take(MAX_PARTS).map(part_row));
    let width = |column: usize| table.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let mut text = "\nParts, largest area first\n".to_owned();
    for row in &table {
        let cells: Vec<String> = (0..row.len()).map(|i| format!("{:>1$}", row[i], width(i))).collect();
        let _ = writeln!(text, "  {}", cells.join("  "));
    }
    let shown = shells.list.len().min(MAX_PARTS) as u64;
    if shells.count > shown {
        let _ = writeln!(text, "  and {} more", shells.count - shown);
    }
    text
}

const PART_COLUMNS: [&str; 9] =
    ["faces", "vertices", "edges", "boundaries", "area", "volume", "genus", "depth", "first face"];

fn part_row(shell: &Shell) -> [String; 9] {
    let volume = format_number(shell.volume.value);
    [
        shell.faces.to_string(),
        shell.vertices.to_string(),
        shell.edges.to_string(),
        shell.boundaries.to_string(),
        format_number(shell.area),
        if shell.volume.reliable { volume } else { format!("({volume})") },
        optional(shell.genus, "-"),
        optional(shell.depth.map(u64::from), "-"),
        shell.first_face.to_string(),
    ]
}

/// Sizes and printing measures, as far as they were measured.
fn measures(inspection: &Inspection) -> Vec<Row> {
    let (m, print) = (&inspection.measures, inspection.print.as_ref());
    let scale = Scale::of(print);
    let mut list = Vec::new();
    if let Some(print) = print {
        list.push(row("unit", unit_text(print)));
    }
    if let Some(b) = m.bounding_box {
        list.push(row("size", scale.lengths([0, 1, 2].map(|k| b.max[k] - b.min[k]))));
        list.push(row("bounding box", format!("{} to {}", format_point(b.min), format_point(b.max))));
    }
    list.push(row("area", scale.power(m.area, 2)));
    let volume = scale.power(m.volume.value, 3);
    list.push(row(
        "volume",
        if m.volume.reliable { volume } else { format!("{volume}, unreliable: not a closed solid") },
    ));
    let shells = &inspection.characteristics.shells;
    list.push(row("genus", genus(shells.genus, shells.genus_not_measurable)));
    list.extend(print.into_iter().flat_map(|print| print_rows(print, &scale)));
    list
}

fn unit_text(print: &PrintMeasures) -> String {
    let source = match print.unit_source {
        UnitSource::Declared => "as set by --unit",
        UnitSource::File => "as stated in the file",
        UnitSource::Assumed => "assumed; set --unit to change",
    };
    format!("{}, {source}", symbol(print.unit))
}

fn print_rows(print: &PrintMeasures, scale: &Scale) -> Vec<Row> {
    let centre = print.centre_of_mass.map_or_else(
        || "not measurable: no reliable volume".to_owned(),
        |at| {
            // Coordinates below the rounding error of the model's size are printed as 0.
            let rounding = print.size.iter().fold(0.0f64, |longest, side| longest.max(*side)) * f64::EPSILON;
            format_point(at.map(|x| if x.abs() > rounding { x } else { 0.0 }))
        },
    );
    let wall = match (&print.thinnest_wall, print.no_wall_reason) {
        (Some(wall), _) => format!(
            "{} at {}, faces {} and {}; the median is {}",
            scale.lengths([wall.thickness]),
            format_point(wall.at),
            wall.faces[0],
            wall.faces[1],
            format_number(wall.median)
        ),
        (None, Some(NoWallReason::NoSurface)) => "not measurable: no surface".to_owned(),
        (None, Some(NoWallReason::NoOppositeSides)) => {
            "not measurable: no two sides face away from each other".to_owned()
        }
        (None, Some(NoWallReason::NotPrintable)) => "not measured: the mesh is not printable".to_owned(),
        (None, Some(NoWallReason::OpenSurface) | None) => {
            "not measurable: too open to have an inside, or a single sheet".to_owned()
        }
    };
    let mut list = vec![row("centre of mass", centre), row("solids", print.solids), row("thinnest wall", wall)];
    list.push(row("overhang", overhang_text(&print.overhang, scale)));
    list.extend(print.fit.map(|fit| row("build volume", fit_text(fit))));
    list
}

fn overhang_text(overhang: &Overhang, scale: &Scale) -> String {
    let list =
        |value: &dyn Fn(&OverhangArea) -> String| overhang.areas.iter().map(value).collect::<Vec<_>>().join(", ");
    let degrees = list(&|overhang| format_number(overhang.degrees));
    let up = format_point(overhang.up);
    if overhang.areas.iter().all(|overhang| overhang.area == 0.0) {
        return format!("none beyond {degrees} degrees; up is {up}");
    }
    let (areas, percent) =
        (list(&|overhang| format_number(overhang.area)), list(&|overhang| format!("{:.1}", overhang.percent)));
    format!("beyond {degrees} degrees: {areas}{} ({percent} %); up is {up}", scale.suffix(2))
}

fn fit_text(fit: Fit) -> String {
    let build_volume = format!("{} mm", fit.build_volume.map(format_number).join(" x "));
    match (fit.as_is, fit.rotated) {
        (true, _) => format!("the model fits into {build_volume}"),
        (false, true) => format!("the model fits into {build_volume} only when rotated"),
        (false, false) => format!("the model does not fit into {build_volume}"),
    }
}

/// The short name of a unit, as on the command line.
fn symbol(unit: Unit) -> String {
    unit.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Formats measures with their unit, if the unit is known.
struct Scale {
    unit: Option<Unit>,
}

impl Scale {
    fn of(print: Option<&PrintMeasures>) -> Self {
        Self { unit: print.map(|print| print.unit) }
    }

    /// Lengths; if the unit is not mm, also in millimetres.
    fn lengths<const N: usize>(&self, lengths: [f64; N]) -> String {
        let text = lengths.map(format_number).join(" x ");
        match self.unit {
            None => text,
            Some(Unit::Millimetre) => format!("{text} mm"),
            Some(unit) => {
                let millimetres = lengths.map(|length| format_number(length * unit.millimetres())).join(" x ");
                format!("{text} {} = {millimetres} mm", symbol(unit))
            }
        }
    }

    /// An area or a volume.
    fn power(&self, value: f64, dimension: u32) -> String {
        format_number(value) + &self.suffix(dimension)
    }

    fn suffix(&self, dimension: u32) -> String {
        self.unit.map_or_else(String::new, |unit| format!(" {}^{dimension}", symbol(unit)))
    }
}
