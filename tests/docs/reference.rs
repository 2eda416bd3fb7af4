//! The generated tables of the documentation are up to date.
//!
//! `make docs` writes them between the comments `<!-- name -->` and `<!-- /name -->`.

use std::collections::{BTreeMap, BTreeSet};

use meshmend::api;
use meshmend::inspect::DefectKind;
use meshmend::jobs::Mode;
use meshmend::manual::{Outline, PAGES};
use meshmend::render::palette;
use meshmend::repair::Operator;
use meshmend::telemetry::METRICS;
use serde_json::Value;

use crate::support::pages::{Page, all_pages, root};
use crate::support::source::variants;

/// The prefix of references to schemas in the OpenAPI document.
const SCHEMAS: &str = "#/components/schemas/";

/// The generated sections, by the name in their comments.
fn sections() -> BTreeMap<&'static str, String> {
    let document = serde_json::to_value(api::document()).unwrap();
    let schemas = &document["components"]["schemas"];
    let of_enum = |name: &str| table(["Name", "What it is"], described(schemas, name));
    let of_fields = |name: &str| {
        let fields = schemas[name]["properties"].as_object().unwrap();
        table(["Field", "What it is"], fields.iter().map(|(field, schema)| [code(field), description(schema)]))
    };
    BTreeMap::from([
        ("pages", list_of_pages()),
        ("enum-values", values_of_enums(schemas)),
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
        ("process_limits", of_fields("ProcessLimits")),
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

/// The JSON names of an enum's values, each with the doc comment from the code.
fn described(schemas: &Value, name: &str) -> Vec<[String; 2]> {
    let names = schemas[name]["enum"].as_array().unwrap_or_else(|| panic!("{name} is no enum"));
    let description = variants(name);
    assert_eq!(names.len(), description.len(), "{name}");
    names.iter().map(|name| code(name.as_str().unwrap())).zip(description).map(|(name, what)| [name, what]).collect()
}

fn code(text: &str) -> String {
    format!("`{text}`")
}

/// A description as the cell of a table.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

/// The description of a schema.
fn description(schema: &Value) -> String {
    let own = schema["description"].as_str().or_else(|| schema["oneOf"][0]["description"].as_str());
    own.unwrap_or_else(|| panic!("nothing is said of {schema}")).to_owned()
}

fn table<const N: usize>(head: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let line = |cells: &[String; N]| format!("| {} |\n", cells.each_ref().map(|text| cell(text)).join(" | "));
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

/// The schema of each option of a mode, in the program's order.
fn options_of(mode: Mode, schemas: &Value) -> Vec<(String, &Value)> {
    let places = match mode {
        Mode::Repair => {
            vec![&schemas["Options"]["allOf"][1]["properties"], &schemas["PrintOptions"]["properties"]]
        }
        Mode::Analyze => {
            vec![&schemas["InspectOptions"]["properties"], &schemas["AnalyzeOptions"]["allOf"][1]["properties"]]
        }
    };
    let schema = |name: &String| places.iter().find_map(|place| place.get(name)).unwrap_or_else(|| panic!("{name}"));
    mode.option_names().into_iter().map(|name| (name.clone(), schema(&name))).collect()
}

fn options(mode: Mode, schemas: &Value) -> String {
    let row = |(name, schema): (String, &Value)| {
        let default = match &schema["default"] {
            Value::Null => "-".to_owned(),
            Value::Object(_) => "[below](#tolerances)".to_owned(),
            other => code(&other.to_string()),
        };
        [code(&name), kind(&name, schema, schemas), default, range(schema), description(schema)]
    };
    table(["Option", "Type", "Default", "Range", "What it does"], options_of(mode, schemas).into_iter().map(row))
}

/// The name of the schema that this one refers to.
fn referred(schema: &Value) -> Option<&str> {
    let to = schema["$ref"].as_str().or_else(|| schema["oneOf"][0]["$ref"].as_str())?;
    Some(to.strip_prefix(SCHEMAS).unwrap())
}

/// The type of an option in words.
fn kind(name: &str, schema: &Value, schemas: &Value) -> String {
    if let Some(other) = referred(schema) {
        let has_values = schemas[other]["enum"].is_array();
        return if has_values { format!("[one of](#{name})") } else { format!("[object](#{name})") };
    }
    let types = &schema["type"];
    let own = types
        .as_str()
        .or_else(|| types.as_array()?.iter().find_map(|kind| kind.as_str().filter(|kind| *kind != "null")));
    match own.unwrap() {
        "array" if schema["items"]["$ref"].is_string() => "list of [operators](#operators)".to_owned(),
        "array" => format!("{} numbers", schema["maxItems"]),
        own => own.to_owned(),
    }
}

/// The range of an option in words.
fn range(schema: &Value) -> String {
    let bound = |name: &str| schema.get(name).filter(|bound| bound.is_number()).map(ToString::to_string);
    match (bound("minimum"), bound("maximum"), bound("exclusiveMinimum")) {
        (Some(least), Some(most), _) => format!("{least} to {most}"),
        (Some(least), None, _) => format!("at least {least}"),
        (None, _, Some(below)) => format!("more than {below}"),
        _ => "-".to_owned(),
    }
}

/// A table of values for each option that is an enum.
fn values(schemas: &Value) -> String {
    let mut seen = BTreeSet::new();
    let mut text = String::new();
    for (name, schema) in Mode::ALL.into_iter().flat_map(|mode| options_of(mode, schemas)) {
        let Some(other) = referred(schema).filter(|name| schemas[*name]["enum"].is_array()) else { continue };
        // Both modes may have the option.
        if !seen.insert(name.clone()) {
            continue;
        }
        text += &format!("### `{name}`\n\n{}\n", table(["Value", "What it does"], described(schemas, other)));
    }
    text.trim_end().to_owned() + "\n"
}

/// Every enumeration of the API with its values; those of operators and options' values are in it too.
fn values_of_enums(schemas: &Value) -> String {
    let enums = schemas.as_object().unwrap().iter().filter(|(_, schema)| schema["enum"].is_array());
    let section = |(name, schema): (&String, &Value)| {
        let heading = format!("### {name}\n\n");
        let about = schema["description"].as_str().map(|text| format!("{}\n\n", cell(text))).unwrap_or_default();
        heading + &about + &table(["Value", "Meaning"], described(schemas, name))
    };
    enums.map(section).collect::<Vec<_>>().join("\n")
}

fn operators() -> String {
    let rows = Operator::ALL.iter().zip(variants("Operator")).map(|(operator, what)| {
        [code(operator.as_str()), what, if operator.is_on_request() { "on request" } else { "by default" }.to_owned()]
    });
    table(["Operator", "What it does", "Runs"], rows)
}

fn defects() -> String {
    let description = variants("DefectKind");
    let at = |kind: DefectKind| DefectKind::ALL.iter().position(|other| *other == kind).unwrap();
    let row = |kind| {
        let colour = palette::colour(kind).to_string();
        [code(&palette::id(kind)), palette::in_words(kind, 1).to_owned(), code(&colour), description[at(kind)].clone()]
    };
    table(["Kind", "In words", "Colour", "What it is"], palette::BY_SEVERITY.into_iter().map(row))
}

fn problems(of_requests: bool) -> String {
    let document = serde_json::to_value(api::document()).unwrap();
    let of = |name: &str| described(&document["components"]["schemas"], name);
    let meanings: BTreeMap<_, _> =
        of("ProblemCode").into_iter().chain(of("ProblemKind")).map(|[code, what]| (code, what)).collect();
    let listed = api::catalogue().into_iter().filter(|problem| problem.status.is_some() == of_requests);
    let rows = listed.map(|problem| {
        let status = problem.status.map_or_else(|| "-".to_owned(), |status| status.to_string());
        let (title, more) = (format!("{}.", problem.title), &meanings[&code(&problem.code)]);
        let meaning = if title == *more { title } else { format!("{title} {more}") };
        [code(&problem.code), status, meaning, problem.advice.to_owned()]
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

/// The page with its tables generated again.
fn regenerated(page: &Page, sections: &BTreeMap<&str, String>) -> String {
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
fn the_tables_match_the_program() {
    let sections = sections();
    let mut used = 0;
    for page in all_pages() {
        assert!(regenerated(&page, &sections) == page.text, "a table of {} is stale: run 'make docs'", page.path);
        let comments = page.text.lines().filter(|line| line.starts_with("<!-- ") && !line.starts_with("<!-- /"));
        for comment in comments {
            let name = comment.trim_start_matches("<!-- ").trim_end_matches(" -->");
            // A comment with a file's name is above an example.
            if root().join(name).is_file() {
                continue;
            }
            assert!(sections.contains_key(name), "{}: no section is called {name}", page.path);
            used += 1;
        }
    }
    assert_eq!(used, sections.len(), "each table is on one page");
}

#[test]
#[ignore = "writes docs: 'make docs'"]
fn write_tables() {
    let sections = sections();
    for page in all_pages() {
        std::fs::write(root().join(&page.path), regenerated(&page, &sections)).unwrap();
    }
}
