use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::Args;
use meshmend::format::{ReadMesh, read};
use meshmend::inspect::{Measures, SelfIntersections, measure};
use meshmend::repair::{Context, monotonic_clock};

use super::engine::{Bar, LimitArgs, read_file};
use super::exit;

/// Arguments of `meshmend inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// The model: STL, OBJ, PLY or OFF, told by its content.
    input: PathBuf,
    /// Print JSON.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
    #[command(flatten)]
    limits: LimitArgs,
}

/// Runs `meshmend inspect`.
pub fn run(args: &InspectArgs) -> ExitCode {
    let limits = args.limits.limits();
    let name = args.input.display();
    let file = read_file(&args.input, &limits)
        .and_then(|bytes| read(&bytes, &limits).map_err(|error| format!("{name}: {error}")));
    let file = match file {
        Ok(file) => file,
        Err(message) => return exit::fail(exit::BAD_INPUT, message),
    };
    let (clock, cancel, bar) = (monotonic_clock(), AtomicBool::new(false), Bar::new(false));
    let context = Context::new(&bar, &cancel, &clock, Duration::MAX);
    let measured = measure(&file.soup, &context);
    bar.finish();
    let measures = match measured {
        Ok(measures) => measures,
        Err(error) => return exit::fail(exit::INTERNAL, error),
    };
    let printable = measures.printable();
    let text = if args.json { as_json(&file, &measures) } else { as_text(&file, &measures) };
    if let Err(error) = std::io::stdout().write_all(text.as_bytes()) {
        return exit::fail(exit::INTERNAL, error);
    }
    ExitCode::from(if printable { exit::PRINTABLE } else { exit::PARTIAL })
}

fn as_json(file: &ReadMesh, measures: &Measures) -> String {
    let value = serde_json::json!({
        "format": file.format, "dialect": file.dialect, "printable": measures.printable(),
        "measures": measures, "warnings": file.warnings,
    });
    format!("{value:#}\n")
}

fn as_text(file: &ReadMesh, m: &Measures) -> String {
    let yes = |yes: bool| if yes { "yes" } else { "no" }.to_owned();
    let mut rows = vec![
        ("format", file.dialect.clone()),
        ("printable", yes(m.printable())),
        ("faces", m.faces.to_string()),
        ("vertices", m.vertices.to_string()),
        ("edges", m.edges.to_string()),
        ("parts", m.parts.to_string()),
        ("closed", yes(m.closed)),
        ("manifold", yes(m.manifold)),
        ("consistently oriented", yes(m.consistent)),
        ("outward", yes(m.outward)),
        ("boundary edges", format!("{} in {} loops", m.boundary_edges, m.boundary_loops)),
        ("non-manifold edges", m.nonmanifold_edges.to_string()),
        ("non-manifold vertices", m.nonmanifold_vertices.to_string()),
        ("misoriented edges", m.misoriented_edges.to_string()),
        ("inverted parts", m.inverted_parts.to_string()),
        ("degenerate faces", m.degenerate_faces.to_string()),
        ("duplicate faces", m.duplicate_faces.to_string()),
        ("faces not finite", m.nonfinite_faces.to_string()),
        ("unreferenced vertices", m.unreferenced_vertices.to_string()),
    ];
    rows.push(("self-intersecting pairs", intersecting(&m.self_intersections)));
    rows.push(("area", m.area.to_string()));
    rows.push((
        "volume",
        format!("{}{}", m.volume.value, if m.volume.reliable { "" } else { " (not reliable: not closed)" }),
    ));
    if let Some(b) = m.bounding_box {
        rows.push(("bounding box", format!("{:?} to {:?}", b.min, b.max)));
    }
    let mut text = String::new();
    for (name, value) in rows {
        let _ = writeln!(text, "{name:24}{value}");
    }
    for warning in &file.warnings {
        let _ = writeln!(text, "note: {warning}");
    }
    text
}

fn intersecting(it: &SelfIntersections) -> String {
    let Some(pairs) = it.pairs else { return "not checked".to_owned() };
    let mut text = if it.complete { pairs.to_string() } else { format!("at least {pairs}; too many to count") };
    if pairs > 0 {
        let _ = write!(
            text,
            " ({} crossing, {} touching, {} coplanar; {} within a part, {} between parts; {} faces)",
            it.crossing, it.touching, it.coplanar, it.within_one_part, it.between_parts, it.faces
        );
    }
    text
}
