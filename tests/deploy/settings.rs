//! Every variable and command line in the shipped files is one that the program accepts.

use std::collections::{BTreeMap, BTreeSet};

use crate::support::program::{config, known_variables};
use crate::support::source::{names, shipped};

#[test]
fn every_variable_that_is_named_is_one_that_the_program_reads() {
    let known_variables = known_variables();
    let mut seen = BTreeSet::new();
    for (path, text) in shipped() {
        for name in names(&text, "MESHMEND_", |c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_') {
            // `MESHMEND_` alone is the prefix.
            if name != "MESHMEND_" {
                assert!(known_variables.contains(name), "{path}: nothing reads {name}");
                seen.insert(name.to_owned());
            }
        }
    }
    assert!(seen.len() > 15, "{seen:?}");
}

#[test]
fn every_command_in_the_shipped_files_is_accepted_by_the_program() {
    let mut seen = 0;
    for (path, text) in shipped() {
        let prefixes = ["run --rm api ", "`meshmend ", "(meshmend "];
        for (at, before) in prefixes.iter().flat_map(|before| text.match_indices(before)) {
            let line = &text[at + before.len()..];
            let line = &line[..line.find(['`', ')', '\n']).unwrap_or(line.len())];
            // With `--help` the program would not check the rest of the line.
            let line: Vec<_> = line.split_whitespace().filter(|word| *word != "--help").map(str::to_owned).collect();
            config(&line, &BTreeMap::new()).unwrap_or_else(|error| panic!("{path}: {error}"));
            seen += 1;
        }
    }
    assert!(seen >= 4, "{seen}");
}
