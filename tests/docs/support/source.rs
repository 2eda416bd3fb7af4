//! Doc comments of enum variants, which the OpenAPI document does not hold.

use super::pages::root;
use crate::server::files_below;

/// The doc comment of each variant of an enum, in the order of the code.
pub fn variants(name: &str) -> Vec<String> {
    // An enum in a macro is indented.
    let code = files_below(&root().join("src"))
        .into_iter()
        .filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
    let texts = code.map(|path| std::fs::read_to_string(path).unwrap());
    let texts: Vec<String> = texts.collect();
    let bodies = |before: String| -> Vec<String> {
        texts.iter().filter_map(|text| Some(text.split_once(&before)?.1.to_owned())).collect()
    };
    // Some enums of requests are private.
    let public = bodies(format!("pub enum {name} {{\n"));
    let found = if public.is_empty() { bodies(format!("\nenum {name} {{\n")) } else { public };
    assert_eq!(found.len(), 1, "enums {name}");
    let body = found[0].split("\n}").next().and_then(|body| body.split("\n    }").next()).unwrap();
    // If the macro takes the variants as input, read them where it is called; more may follow each name there.
    let used = |text: &'static str| found[0].split_once(text).and_then(|(_, rest)| rest.split("\n}").next());
    let body = if body.contains("$(") { used("! {\n").expect("the macro is used") } else { body };
    let mut docs = Vec::new();
    let mut said = String::new();
    for line in body.lines().map(str::trim) {
        if let Some(words) = line.strip_prefix("///") {
            said.push_str(words);
        } else if !line.starts_with(['#', '"']) && !line.is_empty() {
            docs.push(std::mem::take(&mut said).trim().to_owned());
        }
    }
    assert!(docs.iter().all(|doc| !doc.is_empty()), "{name}: {docs:?}");
    docs
}
