//! The report of one inspected file, for people.

use std::fmt::Write as _;

use clap::ValueEnum;
use meshmend::inspect::{
    Answer, CheckRule, CheckVerdict, Fit, Inspection, Level, Measures, NoWallReason, Overhang, OverhangArea,
    PrintMeasures, Shell, Side, Statistics, Unmeasurable,
};
use meshmend::scene::{Unit, UnitSource};

use super::defects;
use super::figures::{Style, distribution, figure, point};
use super::subject::Inspected;

/// Parts that are listed on a terminal; JSON has more.
const MOST_PARTS: usize = 10;

/// Everything, plain words first, with every place or the first few.
pub fn report(file: &Inspected, style: Style, all_places: bool) -> String {
    let it = &file.inspection;
    let mut text = headline(file);
    text += &defects::section(file, all_places);
    text += &section("Attributes", &attributes(it, it.level == Level::None));
    text += &section("Counts", &counts(it));
    text += &section("Measures", &measures(it));
    if let Some(statistics) = &it.characteristics.statistics {
        text += &shapes(statistics, style);
    }
    text + &parts(it)
}

/// The verdict and the four attributes.
pub fn attributes_only(file: &Inspected) -> String {
    format!("{}:\n{}", file.name, rows(&attributes(&file.inspection, true)))
}

/// A name and what is said of it.
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

fn section(title: &str, given: &[Row]) -> String {
    format!("\n{title}\n{}", rows(given))
}

fn headline(file: &Inspected) -> String {
    let measures = &file.inspection.measures;
    let faults = measures.faults().join(", ");
    let verdict = match measures.verdict() {
        Some(true) => "printable".to_owned(),
        Some(false) => format!("not printable: {faults}"),
        None => format!("not known to be printable: {faults}"),
    };
    let mut text = format!("{}: {}\n{verdict}\n", file.name, file.mesh.dialect);
    for warning in file.mesh.warnings.iter().cloned().chain(measures.omitted()) {
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
        format!("{} non-manifold edges, {} non-manifold vertices", m.non_manifold_edges, m.non_manifold_vertices);
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
            (m.non_finite_faces, "faces not finite"),
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

/// Sizes, and what a printer wants to know, as far as it was measured.
fn measures(it: &Inspection) -> Vec<Row> {
    let (m, print) = (&it.measures, it.print.as_ref());
    let scale = Scale::of(print);
    let mut list = Vec::new();
    if let Some(print) = print {
        list.push(row("unit", unit(print)));
    }
    if let Some(b) = m.bounding_box {
        list.push(row("size", scale.lengths([0, 1, 2].map(|k| b.max[k] - b.min[k]))));
        list.push(row("box", format!("{} to {}", point(b.min), point(b.max))));
    }
    list.push(row("area", scale.power(m.area, 2)));
    let volume = scale.power(m.volume.value, 3);
    list.push(row(
        "volume",
        if m.volume.reliable { volume } else { format!("{volume}, not reliable: not a closed solid") },
    ));
    let shells = &it.characteristics.shells;
    list.push(row("genus", genus(shells.genus, shells.genus_not_measurable)));
    list.extend(print.into_iter().flat_map(|print| printing(print, &scale)));
    list
}

fn unit(print: &PrintMeasures) -> String {
    let why = match print.unit_source {
        UnitSource::Declared => "as given",
        UnitSource::File => "as the file says",
        UnitSource::Assumed => "assumed; --unit says otherwise",
    };
    format!("{}, {why}", symbol(print.unit))
}

fn printing(it: &PrintMeasures, scale: &Scale) -> Vec<Row> {
    let centre = it.centre_of_mass.map_or_else(
        || "not measurable: no reliable volume".to_owned(),
        |at| {
            // What is less than rounding on the model's size is told as 0.
            let least = it.size.iter().fold(0.0f64, |most, side| most.max(*side)) * f64::EPSILON;
            point(at.map(|x| if x.abs() > least { x } else { 0.0 }))
        },
    );
    let wall = match (&it.thinnest_wall, it.no_wall_reason) {
        (Some(wall), _) => format!(
            "{} at {}, faces {} and {}; the median is {}",
            scale.lengths([wall.thickness]),
            point(wall.at),
            wall.faces[0],
            wall.faces[1],
            figure(wall.median)
        ),
        (None, Some(NoWallReason::NoSurface)) => "not measurable: no surface".to_owned(),
        (None, Some(NoWallReason::NoOppositeSides)) => {
            "not measurable: no two sides face away from each other".to_owned()
        }
        (None, Some(NoWallReason::NotPrintable)) => "not measured: the mesh is not printable".to_owned(),
        (None, Some(NoWallReason::OpenSurface) | None) => {
            "not measurable: too open to have an inside, or a sheet".to_owned()
        }
    };
    let mut list = vec![row("centre of mass", centre), row("solids", it.solids), row("thinnest wall", wall)];
    list.push(row("overhang", overhang(&it.overhang, scale)));
    list.extend(it.fit.map(|fit| row("build volume", fits(fit))));
    list
}

fn overhang(it: &Overhang, scale: &Scale) -> String {
    let list = |number: &dyn Fn(&OverhangArea) -> String| it.areas.iter().map(number).collect::<Vec<_>>().join(", ");
    let degrees = list(&|it| figure(it.degrees));
    let up = point(it.up);
    if it.areas.iter().all(|it| it.area == 0.0) {
        return format!("none beyond {degrees} degrees; up is {up}");
    }
    let (areas, percent) = (list(&|it| figure(it.area)), list(&|it| format!("{:.1}", it.percent)));
    format!("beyond {degrees} degrees: {areas}{} ({percent} %); up is {up}", scale.suffix(2))
}

fn fits(fit: Fit) -> String {
    let room = format!("{} mm", fit.build_volume.map(figure).join(" x "));
    match (fit.as_is, fit.rotated) {
        (true, _) => format!("it fits into {room}"),
        (false, true) => format!("it fits into {room} only when turned"),
        (false, false) => format!("it does not fit into {room}"),
    }
}

/// The short name of a unit, as on the command line.
fn symbol(unit: Unit) -> String {
    unit.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Writes measures with their unit, where it is told.
struct Scale {
    unit: Option<Unit>,
}

impl Scale {
    fn of(print: Option<&PrintMeasures>) -> Self {
        Self { unit: print.map(|print| print.unit) }
    }

    /// Lengths, in millimetres too.
    fn lengths<const N: usize>(&self, lengths: [f64; N]) -> String {
        let text = lengths.map(figure).join(" x ");
        match self.unit {
            None => text,
            Some(Unit::Millimetre) => format!("{text} mm"),
            Some(unit) => {
                let millimetres = lengths.map(|length| figure(length * unit.millimetres())).join(" x ");
                format!("{text} {} = {millimetres} mm", symbol(unit))
            }
        }
    }

    /// An area or a volume.
    fn power(&self, value: f64, dimension: u32) -> String {
        figure(value) + &self.suffix(dimension)
    }

    fn suffix(&self, dimension: u32) -> String {
        self.unit.map_or_else(String::new, |unit| format!(" {}^{dimension}", symbol(unit)))
    }
}
