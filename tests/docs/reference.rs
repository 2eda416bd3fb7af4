//! The tables of the pages, made of what the program itself says. `make docs` writes them between the comments `<!-- name -->` and
//! `<!-- /name -->`.

use std::collections::{BTreeMap, BTreeSet};

use meshmend::api;
use meshmend::inspect::DefectKind;
use meshmend::jobs::Mode;
use meshmend::manual::{Outline, PAGES};
use meshmend::render::palette;
use meshmend::repair::Operator;
use meshmend::telemetry::METRICS;
use serde_json::Value;

use crate::pages::{Page, root, written};
use crate::source::variants;

/// Where schemas are in the document of the API.
const SCHEMAS: &str = "#/components/schemas/";

/// What is generated, by the name of its comments.
fn sections() -> BTreeMap<&'static str, String> {
    let document = serde_json::to_value(api::document()).unwrap();
    let schemas = &document["components"]["schemas"];
    let of_enum = |name: &str| table(["Name", "What it is"], described(schemas, name));
    let of_fields = |name: &str| {
        let fields = schemas[name]["properties"].as_object().unwrap();
        table(["Field", "What it is"], fields.iter().map(|(field, it)| [code(field), said(it)]))
    };
    BTreeMap::from([
        ("pages", list_of_pages()),
        ("presets", of_enum("Preset")),
        ("outcomes", of_enum("Outcome")),
        ("red-flags", of_enum("RedFlagCode")),
        ("assumptions", of_enum("AssumptionKind")),
        ("reasons", of_enum("PartReason")),
        ("job-outcomes", of_enum("JobOutcome")),
        ("statuses", of_enum("Status")),
        ("stages", of_enum("Stage")),
        ("categories", of_enum("Category")),
        ("actions", of_enum("Action")),
        ("step-statuses", of_enum("StepStatus")),
        ("unmeasurable", of_enum("Unmeasurable")),
        ("measures", of_fields("Measures")),
        ("print-measures", of_fields("PrintMeasures")),
        ("changes", of_fields("Changes")),
        ("part_accounting", of_fields("PartAccounting")),
        ("tolerances", of_fields("Tolerances")),
        ("defects", defects()),
        ("modes", of_enum("Mode")),
        ("options-repair", options(Mode::Repair, schemas)),
        ("options-analyze", options(Mode::Analyze, schemas)),
        ("values", values(schemas)),
        ("operators", operators()),
        ("problems-requests", problems(true)),
        ("problems-jobs", problems(false)),
        ("addresses", addresses(&document)),
        ("scopes", of_enum("Scope")),
        ("metrics", metrics()),
    ])
}

/// The names of an enum's values as they are sent, with what the code says of each.
fn described(schemas: &Value, name: &str) -> Vec<[String; 2]> {
    let names = schemas[name]["enum"].as_array().unwrap_or_else(|| panic!("{name} is no enum"));
    let said = variants(name);
    assert_eq!(names.len(), said.len(), "{name}");
    names.iter().map(|it| code(it.as_str().unwrap())).zip(said).map(|(name, what)| [name, what]).collect()
}

fn code(text: &str) -> String {
    format!("`{text}`")
}

/// A description as the cell of a table.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

/// What a schema says of itself.
fn said(schema: &Value) -> String {
    let own = schema["description"].as_str().or_else(|| schema["oneOf"][0]["description"].as_str());
    own.unwrap_or_else(|| panic!("nothing is said of {schema}")).to_owned()
}

fn table<const N: usize>(head: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let line = |cells: &[String; N]| format!("| {} |\n", cells.each_ref().map(|it| cell(it)).join(" | "));
    let rows: String = rows.into_iter().map(|row| line(&row)).collect();
    format!("{}|{}\n{rows}", line(&head.map(str::to_owned)), "---|".repeat(N))
}

fn list_of_pages() -> String {
    let line = |(name, text): &(&str, &str)| {
        let outline = Outline::of(text);
        format!("- [{}]({name}.md): {}\n", outline.title, outline.summary)
    };
    PAGES[1..].iter().map(line).collect()
}

/// The schema of each option of a mode, in the order in which the program has them.
fn options_of(mode: Mode, schemas: &Value) -> Vec<(String, &Value)> {
    let places = match mode {
        Mode::Repair => vec![&schemas["Options"]["properties"]],
        Mode::Analyze => {
            vec![&schemas["InspectOptions"]["properties"], &schemas["AnalyzeOptions"]["allOf"][1]["properties"]]
        }
    };
    let schema = |name: &String| places.iter().find_map(|place| place.get(name)).unwrap_or_else(|| panic!("{name}"));
    mode.option_names().into_iter().map(|name| (name.clone(), schema(&name))).collect()
}

fn options(mode: Mode, schemas: &Value) -> String {
    let row = |(name, it): (String, &Value)| {
        let default = match &it["default"] {
            Value::Null => "-".to_owned(),
            Value::Object(_) => "[below](#tolerances)".to_owned(),
            other => code(&other.to_string()),
        };
        [code(&name), kind(&name, it, schemas), default, range(it), said(it)]
    };
    table(["Option", "Type", "Default", "Range", "What it does"], options_of(mode, schemas).into_iter().map(row))
}

/// The name of the schema that one refers to, if it does.
fn referred(schema: &Value) -> Option<&str> {
    let to = schema["$ref"].as_str().or_else(|| schema["oneOf"][0]["$ref"].as_str())?;
    Some(to.strip_prefix(SCHEMAS).unwrap())
}

/// The type of an option in words.
fn kind(name: &str, schema: &Value, schemas: &Value) -> String {
    if let Some(other) = referred(schema) {
        let has_values = schemas[other]["enum"].is_array();
        return if has_values { format!("[one of](#{name})") } else { "[object](#tolerances)".to_owned() };
    }
    let types = &schema["type"];
    let own = types.as_str().or_else(|| types.as_array()?.iter().find_map(|it| it.as_str().filter(|it| *it != "null")));
    match own.unwrap() {
        "array" if schema["items"]["$ref"].is_string() => "list of [operators](#operators)".to_owned(),
        "array" => format!("{} numbers", schema["maxItems"]),
        own => own.to_owned(),
    }
}

/// The range of an option in words.
fn range(schema: &Value) -> String {
    let bound = |name: &str| schema.get(name).filter(|it| it.is_number()).map(ToString::to_string);
    match (bound("minimum"), bound("maximum"), bound("exclusiveMinimum")) {
        (Some(least), Some(most), _) => format!("{least} to {most}"),
        (Some(least), None, _) => format!("at least {least}"),
        (None, _, Some(below)) => format!("more than {below}"),
        _ => "-".to_owned(),
    }
}

/// The values of each option that has a few.
fn values(schemas: &Value) -> String {
    let mut seen = BTreeSet::new();
    let mut text = String::new();
    for (name, schema) in Mode::ALL.into_iter().flat_map(|mode| options_of(mode, schemas)) {
        let Some(other) = referred(schema).filter(|it| schemas[*it]["enum"].is_array()) else { continue };
        // Both modes have some.
        if !seen.insert(name.clone()) {
            continue;
        }
        text += &format!("### `{name}`\n\n{}\n", table(["Value", "What it does"], described(schemas, other)));
    }
    text.trim_end().to_owned() + "\n"
}

fn operators() -> String {
    let rows = Operator::ALL.iter().zip(variants("Operator")).map(|(operator, what)| {
        [code(operator.as_str()), what, if operator.is_on_request() { "on request" } else { "by default" }.to_owned()]
    });
    table(["Operator", "What it does", "Runs"], rows)
}

fn defects() -> String {
    let said = variants("DefectKind");
    let at = |kind: DefectKind| DefectKind::ALL.iter().position(|it| *it == kind).unwrap();
    let row = |kind| {
        let colour = palette::colour(kind).to_string();
        [code(&palette::id(kind)), palette::in_words(kind, 1).to_owned(), code(&colour), said[at(kind)].clone()]
    };
    table(["Kind", "In words", "Colour", "What it is"], palette::BY_GRAVITY.into_iter().map(row))
}

fn problems(of_requests: bool) -> String {
    let document = serde_json::to_value(api::document()).unwrap();
    let of = |name: &str| described(&document["components"]["schemas"], name);
    let meanings: BTreeMap<_, _> =
        of("ProblemCode").into_iter().chain(of("ProblemKind")).map(|[code, what]| (code, what)).collect();
    let listed = api::catalogue().into_iter().filter(|it| it.status.is_some() == of_requests);
    let rows = listed.map(|it| {
        let status = it.status.map_or_else(|| "-".to_owned(), |it| it.to_string());
        let (title, more) = (format!("{}.", it.title), &meanings[&code(&it.code)]);
        let meaning = if title == *more { title } else { format!("{title} {more}") };
        [code(&it.code), status, meaning, it.advice.to_owned()]
    });
    table(["Code", "Status", "What it means", "What to do"], rows)
}

fn addresses(document: &Value) -> String {
    let paths = document["paths"].as_object().unwrap().iter();
    let rows = paths.flat_map(|(path, operations)| {
        operations.as_object().unwrap().iter().map(move |(method, operation)| {
            let summary = operation["summary"].as_str().unwrap();
            [code(&format!("{} {path}", method.to_uppercase())), summary.to_owned()]
        })
    });
    table(["Address", "What it does"], rows)
}

fn metrics() -> String {
    let rows = METRICS.iter().map(|metric| {
        let labels = metric.labels.iter().map(|label| code(label)).collect::<Vec<_>>().join(", ");
        [code(metric.name), metric.kind.as_str().to_owned(), labels, metric.help.to_owned()]
    });
    table(["Name", "Kind", "Labels", "What it tells"], rows)
}

/// The page with its tables made anew.
fn made_anew(page: &Page, sections: &BTreeMap<&str, String>) -> String {
    let mut text = page.text.clone();
    for (name, section) in sections {
        let (from, to) = (format!("<!-- {name} -->\n"), format!("<!-- /{name} -->"));
        let Some((before, rest)) = text.split_once(&from) else { continue };
        let (_, after) = rest.split_once(&to).unwrap_or_else(|| panic!("{}: {from} has no end", page.path));
        text = format!("{before}{from}\n{section}\n{to}{after}");
    }
    text
}

#[test]
fn the_tables_are_what_the_program_says() {
    let sections = sections();
    let mut used = 0;
    for page in written() {
        assert!(made_anew(&page, &sections) == page.text, "a table of {} is stale: run 'make docs'", page.path);
        let comments = page.text.lines().filter(|line| line.starts_with("<!-- ") && !line.starts_with("<!-- /"));
        for comment in comments {
            let name = comment.trim_start_matches("<!-- ").trim_end_matches(" -->");
            // Examples stand below the names of their files.
            if root().join(name).is_file() {
                continue;
            }
            assert!(sections.contains_key(name), "{}: nothing is called {name}", page.path);
            used += 1;
        }
    }
    assert_eq!(used, sections.len(), "each table stands on one page");
}

#[test]
#[ignore = "writes docs: 'make docs'"]
fn write_tables() {
    let sections = sections();
    for page in written() {
        std::fs::write(root().join(&page.path), made_anew(&page, &sections)).unwrap();
    }
}
