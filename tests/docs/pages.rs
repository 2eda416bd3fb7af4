//! The list of pages is complete, and each page has a title and a summary.

use std::path::PathBuf;

use meshmend::manual::PAGES;

use crate::support::pages::root;

#[test]
fn every_file_in_docs_is_a_page_that_is_served() {
    let mut there: Vec<PathBuf> =
        std::fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path()).collect();
    there.retain(|path| path.extension().is_some_and(|ending| ending == "md"));
    let mut names: Vec<_> = there.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
    let mut listed: Vec<_> = PAGES.iter().map(|(name, _)| *name).collect();
    names.sort_unstable();
    listed.sort_unstable();
    assert_eq!(listed, names);
}

#[test]
fn every_page_has_one_title_and_a_summary() {
    for page in meshmend::manual::pages() {
        let text = std::str::from_utf8(page.markdown.plain()).unwrap();
        assert!(text.starts_with(&format!("# {}\n", page.outline.title)), "{}", page.name);
        assert!(!page.outline.summary.is_empty() && page.outline.summary.ends_with('.'), "{}", page.name);
        let levels: Vec<_> = page.outline.headings.iter().map(|heading| heading.level).collect();
        assert!(levels.windows(2).all(|two| two[1] <= two[0] + 1), "{} leaves a level out: {levels:?}", page.name);
    }
}
