//! What was read past, told once each.

use crate::format::errors::shown;

/// Collects what a reader should tell.
#[derive(Default)]
pub(super) struct Warnings {
    /// What extensions that are not read are about.
    extensions: Vec<String>,
    /// Names of attributes and elements that 3MF does not know: how many, and the first.
    names: (u64, Option<String>),
    notes: (u64, Option<String>),
    other: Vec<String>,
}

impl Warnings {
    /// Something of an extension was passed over.
    pub fn extension(&mut self, subject: String) {
        if !self.extensions.contains(&subject) {
            self.extensions.push(subject);
        }
    }

    /// An attribute or element was passed over.
    pub fn name(&mut self, name: &[u8]) {
        self.names.0 += 1;
        self.names.1.get_or_insert_with(|| shown(name));
    }

    /// A note has a name that 3MF does not know.
    pub fn note(&mut self, name: &str) {
        self.notes.0 += 1;
        self.notes.1.get_or_insert_with(|| shown(name.as_bytes()));
    }

    /// Something else, unless it was told before.
    pub fn tell(&mut self, warning: &str) {
        if !self.other.iter().any(|told| told == warning) {
            self.other.push(warning.to_owned());
        }
    }

    pub fn finish(self) -> Vec<String> {
        let mut warnings = self.other;
        if !self.extensions.is_empty() {
            let (some, more) = self.extensions.split_at(self.extensions.len().min(5));
            let more = if more.is_empty() { String::new() } else { format!(" and {} more", more.len()) };
            warnings.push(format!("what extensions of 3MF say was left out: {}{more}", some.join(", ")));
        }
        if let (count, Some(first)) = self.names {
            warnings.push(format!(
                "attributes or elements that are no part of 3MF were left out: {count}, the first '{first}'"
            ));
        }
        if let (count, Some(first)) = self.notes {
            warnings.push(format!(
                "notes with names that are no part of 3MF and have no namespace were kept: {count}, the first '{first}'"
            ));
        }
        warnings
    }
}
