//! Every text in the code, held to the rules for plain English: messages of errors, notes of repairs, and log lines.
//!
//! Most messages are built where they are reported, with the numbers of the case. So the texts come from the syntax tree of the whole
//! source: each string that has at least three words, in code that is not a test.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use syn::parse::{ParseStream, Parser};
use syn::visit::{self, Visit};

use crate::prose;

/// Folders whose strings are SQL or markup.
const WITHOUT_TEXTS: [&str; 2] = ["src/jobs/sql", "src/manual"];

/// The starts of strings that only programs read: headers of PLY files, statements of OBJ, and Python for Blender.
const FOR_MACHINES: [&str; 5] = ["ply\nformat ", "element vertex ", "VALUE\nelement vertex", "v vt vn ", "import os"];

/// The strings of a file.
#[derive(Default)]
struct Strings(Vec<String>);

impl Strings {
    fn add(&mut self, literal: &syn::LitStr) {
        self.0.push(literal.value());
    }

    /// Adds the strings among the tokens of a macro call.
    fn add_tokens(&mut self, input: ParseStream<'_>) -> syn::Result<()> {
        while !input.is_empty() {
            if input.peek(syn::Ident) && input.peek2(syn::Token![=]) && input.peek3(syn::LitStr) {
                let name: syn::Ident = input.parse()?;
                input.parse::<syn::Token![=]>()?;
                let text = input.parse()?;
                if name != "doc" {
                    self.add(&text);
                }
                continue;
            }
            if input.peek(syn::LitStr) {
                self.add(&input.parse()?);
                continue;
            }
            let inner = input.step(|cursor| {
                if let Some((inside, _, _, rest)) = cursor.any_group() {
                    Ok((Some(inside.token_stream()), rest))
                } else {
                    cursor.token_tree().map(|(_, rest)| (None, rest)).ok_or_else(|| cursor.error("a token"))
                }
            })?;
            if let Some(tokens) = inner {
                (|input: ParseStream<'_>| self.add_tokens(input)).parse2(tokens)?;
            }
        }
        Ok(())
    }
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("test")
            || attribute.path().is_ident("cfg")
                && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    })
}

impl<'ast> Visit<'ast> for Strings {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !is_test(&module.attrs) {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_item_fn(&mut self, function: &'ast syn::ItemFn) {
        if !is_test(&function.attrs) {
            visit::visit_item_fn(self, function);
        }
    }

    fn visit_attribute(&mut self, attribute: &'ast syn::Attribute) {
        // The message of an error. Documents of items have their own tests.
        if attribute.path().is_ident("error")
            && let syn::Meta::List(list) = &attribute.meta
        {
            (|input: ParseStream<'_>| self.add_tokens(input)).parse2(list.tokens.clone()).unwrap();
        }
    }

    fn visit_lit_str(&mut self, literal: &'ast syn::LitStr) {
        self.add(literal);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        (|input: ParseStream<'_>| self.add_tokens(input)).parse2(call.tokens.clone()).unwrap();
    }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    let is_left_out = |path: &PathBuf| {
        path.file_name().is_some_and(|name| name == "node_modules" || name == "tests" || name == "tests.rs")
            || WITHOUT_TEXTS.iter().any(|left_out| path.ends_with(left_out))
    };
    entries.retain(|path| !is_left_out(path));
    let files = entries.into_iter().flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] });
    files.filter(|path| path.extension().is_some_and(|e| e == "rs")).collect()
}

/// The text with each placeholder as one word.
fn with_values(text: &str) -> String {
    let mut plain = String::new();
    for part in text.split('{') {
        match part.split_once('}') {
            Some((_, rest)) => plain.extend(["VALUE", rest]),
            None => plain.push_str(part),
        }
    }
    plain
}

/// Whether a string is text for people: at least three words, and neither markup nor code.
fn is_text(text: &str) -> bool {
    let is_word = |word: &&str| word.len() > 1 && word.chars().all(|c| c.is_alphabetic() || ".,:;'-".contains(c));
    let is_for_machines = FOR_MACHINES.iter().any(|start| text.starts_with(start));
    !is_for_machines
        && !text.contains("</")
        && !text.contains("/>")
        && text.split_whitespace().filter(is_word).count() >= 3
}

/// The texts of the source, each with its place.
fn texts() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut texts = Vec::new();
    for file in files(&root.join("src")) {
        let mut strings = Strings::default();
        strings.visit_file(&syn::parse_file(&std::fs::read_to_string(&file).unwrap()).unwrap());
        let name = file.strip_prefix(root).unwrap().display().to_string();
        let own = strings.0.into_iter().map(|text| (name.clone(), with_values(&text)));
        texts.extend(own.filter(|(_, text)| is_text(text)));
    }
    texts
}

#[test]
fn texts_in_the_code_are_short_and_name_their_subjects() {
    let texts = texts();
    assert!(texts.len() > 600, "only {} texts were found", texts.len());
    prose::assert_clear(&texts);
}

#[test]
fn texts_in_the_code_mark_names_of_fields() {
    let marks = |(place, text): &(String, String)| {
        let fields = prose::unmarked_fields(text);
        (!fields.is_empty()).then(|| format!("{place}: {}: {text}", fields.join(", ")))
    };
    let found: Vec<String> = texts().iter().filter_map(marks).collect();
    assert!(found.is_empty(), "{} texts have names without backticks:\n{}", found.len(), found.join("\n"));
}

/// The names of all fields in the code of the command line, which are those of its flags.
#[derive(Default)]
struct Fields(BTreeSet<String>);

impl<'ast> Visit<'ast> for Fields {
    fn visit_field(&mut self, field: &'ast syn::Field) {
        self.0.extend(field.ident.as_ref().map(ToString::to_string));
    }
}

#[test]
fn flags_that_texts_name_exist() {
    let mut fields = Fields::default();
    for file in files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli")) {
        fields.visit_file(&syn::parse_file(&std::fs::read_to_string(&file).unwrap()).unwrap());
    }
    // Flags of other programs, and those that clap adds.
    fields.0.extend(["format", "file", "version"].map(str::to_owned));
    let mut unknown = Vec::new();
    for (place, text) in texts() {
        for (at, _) in text.match_indices("--").filter(|(at, _)| text[..*at].ends_with([' ', '`', '('])) {
            let flag: String = text[at + 2..]
                .chars()
                .take_while(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || *c == '-')
                .collect();
            if !flag.is_empty() && !fields.0.contains(&flag.replace('-', "_")) {
                unknown.push(format!("{place}: --{flag}: {text}"));
            }
        }
    }
    assert!(unknown.is_empty(), "unknown flags:\n{}", unknown.join("\n"));
}
