//! The files that come with a model: those in the archive that it came in, found as the model names them.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::sync::Arc;

use super::archive::{Archive, key, resolve};
use super::errors::shown;
use super::{Limits, pictures};

/// What is beside a model.
pub(super) struct Beside<'z> {
    /// The archive and the model's name in it; none for a model that came alone.
    within: Option<(&'z Archive<'z>, &'z str)>,
    /// The first file of each bare name, by [`key`].
    bare: HashMap<String, &'z str>,
    /// How many bytes may still be unpacked, and how many of pictures.
    left: Cell<u64>,
    left_for_pictures: Cell<u64>,
    missing: RefCell<Names>,
    strange: RefCell<Names>,
}

/// Names that could not be followed: how many, and the first.
#[derive(Default)]
struct Names {
    count: u64,
    first: String,
}

impl Names {
    fn add(&mut self, name: &str) {
        if self.count == 0 {
            self.first = shown(name.as_bytes());
        }
        self.count += 1;
    }
}

impl<'z> Beside<'z> {
    /// Nothing, for a model that came alone.
    pub fn nothing() -> Self {
        Self {
            within: None,
            bare: HashMap::new(),
            left: Cell::new(0),
            left_for_pictures: Cell::new(0),
            missing: RefCell::default(),
            strange: RefCell::default(),
        }
    }

    /// What is in the archive of a model.
    pub fn of(model: &'z str, archive: &'z Archive<'z>, limits: &Limits) -> Self {
        let mut bare = HashMap::new();
        for name in archive.names() {
            bare.entry(key(bare_name(name))).or_insert(name);
        }
        Self {
            within: Some((archive, model)),
            bare,
            left: Cell::new(limits.max_bytes),
            left_for_pictures: Cell::new(pictures::MOST_BYTES),
            ..Self::nothing()
        }
    }

    /// Whether there may be any.
    pub fn is_something(&self) -> bool {
        self.within.is_some()
    }

    /// Whether there is a file that the model means by this name.
    pub fn has(&self, name: &str) -> bool {
        self.find(name).is_some()
    }

    /// The bytes, no more than `most`, of the file that the model means by a name; none if they can't be had, which [`Beside::warnings`]
    /// tells.
    pub fn file(&self, name: &str, most: u64) -> Option<Vec<u8>> {
        let (archive, _) = self.within?;
        let most = most.min(self.left.get());
        let bytes = self.find(name).and_then(|found| archive.bytes(found, most).ok().flatten());
        match &bytes {
            Some(bytes) => self.left.set(self.left.get().saturating_sub(bytes.len() as u64)),
            None => self.missing.borrow_mut().add(name),
        }
        bytes
    }

    /// As [`Beside::file`], for a picture, with its media type; none too if it is not of a kind that is kept.
    pub fn picture(&self, name: &str) -> Option<(Arc<[u8]>, &'static str)> {
        let bytes = self.file(name, self.left_for_pictures.get())?;
        let Some(media_type) = pictures::media_type(&bytes) else {
            self.strange.borrow_mut().add(name);
            return None;
        };
        self.left_for_pictures.set(self.left_for_pictures.get().saturating_sub(bytes.len() as u64));
        Some((bytes.into(), media_type))
    }

    /// What could not be had.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let missing = self.missing.borrow();
        if missing.count > 0 {
            warnings.push(format!(
                "files that the model names are not in the archive, or can't be unpacked within the limits: {}, the first '{}'",
                missing.count, missing.first
            ));
        }
        let strange = self.strange.borrow();
        if strange.count > 0 {
            warnings.push(format!(
                "pictures that are neither PNG nor JPEG were left out: {}, the first '{}'",
                strange.count, strange.first
            ));
        }
        warnings
    }

    /// By its path from the model's folder, else by its bare name, as paths are often those of another machine.
    fn find(&self, name: &str) -> Option<&'z str> {
        let (archive, model) = self.within?;
        let there = resolve(model, name).and_then(|path| archive.name(&path));
        there.or_else(|| self.bare.get(&key(bare_name(name))).copied())
    }
}

fn bare_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}
