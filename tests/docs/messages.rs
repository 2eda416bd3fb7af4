//! The texts that users read, held to the rules for plain English.
//!
//! The texts come from the program's own tables: the OpenAPI document, the catalogue of problems, and the metrics.

use meshmend::api;
use meshmend::jobs::{JobOptions, Mode};
use meshmend::telemetry::METRICS;
use serde_json::{Value, json};

use crate::prose;

/// Every text with the place that it comes from.
fn texts() -> Vec<(String, String)> {
    let mut texts = Vec::new();
    let document = serde_json::to_value(api::document()).unwrap();
    collect(&document, "openapi", &mut texts);
    for problem in api::catalogue() {
        texts.push((format!("problem {}", problem.code), format!("{}.", problem.title)));
        texts.push((format!("problem {}", problem.code), problem.advice.to_owned()));
    }
    texts.extend(METRICS.iter().map(|metric| (metric.name.to_owned(), metric.help.to_owned())));
    texts
}

/// Adds the descriptions and summaries below a value of the OpenAPI document.
fn collect(value: &Value, path: &str, texts: &mut Vec<(String, String)>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                match value {
                    Value::String(text) if key == "description" || key == "summary" => {
                        texts.push((path.to_owned(), text.clone()));
                    }
                    _ => collect(value, &format!("{path}/{key}"), texts),
                }
            }
        }
        Value::Array(values) => values.iter().for_each(|value| collect(value, path, texts)),
        _ => {}
    }
}

#[test]
fn texts_for_users_are_short_and_name_their_subjects() {
    let texts = texts();
    assert!(texts.len() > 800, "only {} texts were found", texts.len());
    prose::assert_clear(&texts);
}

#[test]
fn errors_of_options_name_the_option() {
    for mode in [Mode::Repair, Mode::Analyze] {
        for option in mode.option_names() {
            let read = |value: &Value| {
                let fields = json!({ "mode": mode.as_str(), &option: value });
                JobOptions::from_fields(fields.as_object().unwrap().clone())
            };
            let of_wrong_type = read(&json!({ "wrong": [] }));
            assert!(of_wrong_type.is_err(), "{option}");
            // Whether a number is in range depends on the option.
            for error in [of_wrong_type, read(&json!(-1)), read(&json!(1e300))].into_iter().filter_map(Result::err) {
                assert!(error.to_string().contains(&format!("`{option}`")), "{option}: {error}");
                prose::assert_clear(&[(option.clone(), error.to_string())]);
            }
        }
    }
}

#[test]
fn long_sentences_bare_subjects_and_type_names_are_found() {
    let long = "word ".repeat(26);
    for text in [long.as_str(), "It is not there.", "The kinds of [`Assumption`].", "The JobOptions of a job."] {
        assert!(!prose::faults(text).is_empty(), "{text}");
    }
    assert_eq!(prose::faults("`max_tier` must be 1, 2 or 3. This option needs Blender; PostgreSQL does not."), [""; 0]);
    assert_eq!(prose::unmarked_fields("max_tier must be `max_tier`, not MAX_TIER."), ["max_tier"]);
}
