//! The rules for texts that users read: short sentences that name their subjects, without names of the code.

/// The most words of a sentence.
const MAX_WORDS: usize = 25;

/// Words that, as the subject of a sentence, do not say what they stand for.
const BARE_SUBJECTS: [&str; 11] =
    ["It", "This", "That", "They", "These", "Those", "Such", "What", "Who", "Which", "So"];

/// Verbs that make the word before them a subject: "This is" has no noun, "This option is" has one.
const VERBS: [&str; 13] =
    ["is", "are", "was", "were", "has", "have", "can", "may", "must", "does", "do", "holds", "means"];

/// Names with inner capitals that readers know.
const KNOWN_NAMES: [&str; 28] = [
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
    "OpenCTM",
    "OpenCASCADE",
    "SolidWorks",
    "WebP",
];

/// The text with each span of code in backticks as one word.
fn without_code(text: &str) -> String {
    text.split('`').enumerate().map(|(index, part)| if index % 2 == 1 { "CODE" } else { part }).collect()
}

/// The sentences of a text. Code in backticks is one word.
fn sentences(text: &str) -> Vec<String> {
    let plain = without_code(text);
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

/// The faults of a text; empty if it keeps the rules.
pub fn faults(text: &str) -> Vec<String> {
    let mut faults = Vec::new();
    if text.contains("[`") {
        faults.push("links to an item of the code".to_owned());
    }
    for (index, sentence) in sentences(text).into_iter().enumerate() {
        let words = sentence.split_whitespace().count();
        if words > MAX_WORDS {
            faults.push(format!("{words} words: {sentence}"));
        }
        let mut start = sentence.split_whitespace();
        // "This option" has its noun; "This is" has none.
        let (first, second) = (start.next().unwrap_or_default(), start.next().unwrap_or_default());
        // Messages begin with a lower-case letter; after a semicolon, the noun is in the same sentence. A lower-case "which" joins
        // a part of a sentence to the part before.
        let is_bare = |subject: &&str| {
            let may_begin = index == 0 && !["That", "What", "Who", "Which", "So"].contains(subject);
            first == *subject || may_begin && first.eq_ignore_ascii_case(subject)
        };
        let is_pronoun = ["It", "They"].iter().any(is_bare);
        if is_pronoun || VERBS.contains(&second) && BARE_SUBJECTS.iter().any(is_bare) {
            faults.push(format!("bare subject: {sentence}"));
        }
        faults.extend(type_names(&sentence).iter().map(|name| format!("type name {name}: {sentence}")));
    }
    faults
}

/// The names in snake case outside of backticks, such as names of fields.
pub fn unmarked_fields(text: &str) -> Vec<String> {
    let plain = without_code(text);
    let words = plain.split(|c: char| !c.is_alphanumeric() && c != '_');
    let is_field = |word: &&str| word.trim_matches('_').contains('_') && word.chars().any(char::is_lowercase);
    words.filter(is_field).map(str::to_owned).collect()
}

/// Asserts that texts, each with the place that it comes from, keep the rules.
#[track_caller]
pub fn assert_clear(texts: &[(String, String)]) {
    let found: Vec<String> = texts
        .iter()
        .flat_map(|(place, text)| faults(text).into_iter().map(move |fault| format!("{place}: {fault}")))
        .collect();
    assert!(found.is_empty(), "{} faults:\n{}", found.len(), found.join("\n"));
}
