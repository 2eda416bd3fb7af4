//! The texts that users read, held to the rules for plain English.
//!
//! The texts come from the program's own tables: the OpenAPI document, the catalogue of problems, and the metrics.

use meshmend::api;
use meshmend::telemetry::METRICS;
use serde_json::Value;

/// The most words of a sentence.
const MAX_WORDS: usize = 25;

/// Words that, as the subject of a sentence, do not say what they stand for.
const BARE_SUBJECTS: [&str; 12] =
    ["It", "This", "That", "They", "These", "Those", "Such", "What", "Who", "Which", "So", "There"];

/// Names with inner capitals that readers know.
const KNOWN_NAMES: [&str; 24] = [
    "OpenAPI",
    "PostgreSQL",
    "SQLite",
    "MeshPrep",
    "MiB",
    "KiB",
    "GiB",
    "OpenTelemetry",
    "JavaScript",
    "TypeScript",
    "WebGL",
    "GitHub",
    "GLBs",
    "STLs",
    "IDs",
    "URLs",
    "APIs",
    "CAs",
    "UUIDs",
    "RateLimit",
    "OAuth",
    "PrusaSlicer",
    "OpenSCAD",
    "MeshLab",
];

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

/// The sentences of a text. Code in backticks is one word.
fn sentences(text: &str) -> Vec<String> {
    let mut plain = String::new();
    for (index, part) in text.split('`').enumerate() {
        plain.push_str(if index % 2 == 1 { "CODE" } else { part });
    }
    // A list's items and the parts around a semicolon stand alone.
    let parts = plain.split(['\n', ';']).flat_map(|line| line.split(". ").flat_map(|part| part.split(": ")));
    parts.map(|part| part.trim().to_owned()).filter(|part| !part.is_empty()).collect()
}

/// The names with inner capitals in a sentence, such as names of types.
fn type_names(sentence: &str) -> Vec<&str> {
    let words = sentence.split(|c: char| !c.is_alphanumeric());
    let has_inner_capital = |word: &&str| {
        let mut letters = word.chars();
        letters.next().is_some_and(char::is_uppercase)
            && word.chars().any(char::is_lowercase)
            && letters.skip_while(|c| c.is_uppercase()).any(char::is_uppercase)
    };
    words.filter(has_inner_capital).filter(|word| !KNOWN_NAMES.contains(word)).collect()
}

fn faults(text: &str) -> Vec<String> {
    let mut faults = Vec::new();
    if text.contains("[`") {
        faults.push("links to an item of the code".to_owned());
    }
    for sentence in sentences(text) {
        let words = sentence.split_whitespace().count();
        if words > MAX_WORDS {
            faults.push(format!("{words} words: {sentence}"));
        }
        let mut start = sentence.split_whitespace();
        // "This option" has its noun; "This is" has none.
        let (first, second) = (start.next().unwrap_or_default(), start.next().unwrap_or_default());
        let verbs = ["is", "are", "was", "were", "has", "have", "can", "may", "must", "does", "do", "holds", "means"];
        if BARE_SUBJECTS.contains(&first) && (first == "It" || first == "They" || verbs.contains(&second)) {
            faults.push(format!("bare subject: {sentence}"));
        }
        faults.extend(type_names(&sentence).iter().map(|name| format!("type name {name}: {sentence}")));
    }
    faults
}

#[test]
fn texts_for_users_are_short_and_name_their_subjects() {
    let texts = texts();
    assert!(texts.len() > 800, "only {} texts were found", texts.len());
    let found: Vec<String> = texts
        .iter()
        .flat_map(|(path, text)| faults(text).into_iter().map(move |fault| format!("{path}: {fault}")))
        .collect();
    assert!(found.is_empty(), "{} faults:\n{}", found.len(), found.join("\n"));
}

#[test]
fn long_sentences_bare_subjects_and_type_names_are_found() {
    let long = "word ".repeat(MAX_WORDS + 1);
    for text in [long.as_str(), "It is not there.", "The kinds of [`Assumption`].", "The JobOptions of a job."] {
        assert!(!faults(text).is_empty(), "{text}");
    }
    assert_eq!(faults("`max_tier` must be 1, 2 or 3. This option needs Blender; PostgreSQL does not."), [""; 0]);
}
