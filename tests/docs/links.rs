//! Links, anchors and pictures of the documentation lead to something that exists.

use std::collections::BTreeSet;
use std::path::{Component, PathBuf};

use meshmend::manual::{self, Outline, PAGES};
use pulldown_cmark::{Event, Tag};

use crate::support::pages::{Page, all_pages, root};
use crate::support::pictures::picture_names;

/// The targets of the links and pictures of a page.
fn targets(page: &Page) -> Vec<String> {
    let target = |event: Event<'_>| match event {
        Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => Some(dest_url.to_string()),
        _ => None,
    };
    page.events().filter_map(target).collect()
}

/// The path from the repository's root, with `..` resolved.
fn plain(path: PathBuf) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut plain, part| {
        if part == Component::ParentDir {
            plain.pop();
        } else {
            plain.push(part);
        }
        plain
    })
}

#[test]
fn every_link_between_files_leads_to_a_file_and_to_a_heading_in_it() {
    let mut seen = 0;
    for page in all_pages() {
        for target in targets(&page).iter().filter(|target| !target.contains("://")) {
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            let from = PathBuf::from(&page.path);
            let path = if file.is_empty() { from } else { plain(from.parent().unwrap().join(file)) };
            assert!(root().join(&path).exists(), "{}: there is no {target}", page.path);
            if !anchor.is_empty() {
                let text = std::fs::read_to_string(root().join(&path)).unwrap();
                let headings = Outline::of(&text).headings;
                assert!(headings.iter().any(|heading| heading.anchor == anchor), "{}: there is no {target}", page.path);
            }
            seen += 1;
        }
    }
    assert!(seen > 30, "{seen}");
}

#[test]
fn every_page_is_reached_from_the_index_and_from_the_readme() {
    let mut left = all_pages();
    let mut reached = BTreeSet::from(["README.md".to_owned()]);
    // Each page that is reached adds its own links.
    while let Some(at) = left.iter().position(|page| reached.contains(&page.path)) {
        let page = left.remove(at);
        let folder = PathBuf::from(&page.path);
        let files = targets(&page).into_iter().filter(|target| !target.contains("://")).map(|target| {
            plain(folder.parent().unwrap().join(target.split('#').next().unwrap())).display().to_string()
        });
        reached.extend(files);
    }
    assert!(left.is_empty(), "nothing leads to {:?}", left.iter().map(|page| &page.path).collect::<Vec<_>>());
    let index = manual::index().html.plain();
    let index = std::str::from_utf8(index).unwrap();
    for (name, _) in &PAGES[1..] {
        assert!(index.split("<article>").nth(1).unwrap().contains(&format!("href=\"{name}\"")), "{name}");
    }
}

#[test]
fn every_picture_of_a_page_is_served_and_every_one_that_is_served_is_on_a_page() {
    let pages = all_pages();
    let shown: BTreeSet<String> = pages
        .iter()
        .filter(|page| page.path.starts_with("docs/"))
        .flat_map(targets)
        .filter_map(|target| Some(target.strip_prefix("pictures/")?.to_owned()))
        .collect();
    for name in &shown {
        assert!(manual::picture(name).is_some(), "{name}");
    }
    for name in picture_names() {
        assert!(shown.contains(&name), "{name} is on no page");
    }
}
