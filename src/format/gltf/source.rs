//! Where the numbers of a primitive come from: accessors, or Draco.

use super::super::errors::{ReadError, ReadErrorKind};
use super::accessor::Accessor;
use super::document::{Attributes, Primitive};
use super::draco::Decoded;
use super::file::{File, malformed};
use super::json::Whole;

/// A primitive with what it takes its numbers from.
pub(super) struct Source<'f, 'a> {
    pub file: &'f File<'a>,
    pub primitive: &'f Primitive,
    decoded: Option<Decoded>,
}

impl<'f, 'a> Source<'f, 'a> {
    /// Finds, and if need be decodes, the numbers of a primitive, in a file that has `faces` and `vertices` already.
    pub fn new(file: &'f File<'a>, primitive: &'f Primitive, faces: u64, vertices: u64) -> Result<Self, ReadError> {
        let decoded = match &primitive.extensions.draco {
            Some(draco) => {
                let decoded = Decoded::new(file.view(draco.buffer_view)?, faces, vertices, &file.limits)?;
                file.spend(decoded.vertices())?;
                Some(decoded)
            }
            None => None,
        };
        Ok(Self { file, primitive, decoded })
    }

    pub fn indices(&self) -> Result<Option<Accessor<'f>>, ReadError> {
        match &self.decoded {
            Some(decoded) => Ok(Some(decoded.indices())),
            None => self.primitive.indices.map(|number| Accessor::new(self.file, number)).transpose(),
        }
    }

    /// The positions; none where the primitive has none, so that there is nothing to see of it.
    pub fn positions(&self) -> Result<Option<Accessor<'f>>, ReadError> {
        let positions = self.attribute("POSITION", |it| it.position)?;
        if let Some(positions) = &positions
            && positions.width != 3
        {
            return Err(malformed(format!("positions have {} coordinates", positions.width)));
        }
        Ok(positions)
    }

    /// Another attribute, which must have something for each of `vertices`.
    pub fn of_vertices(
        &self,
        name: &str,
        which: impl Fn(&Attributes) -> Option<Whole>,
        vertices: usize,
    ) -> Result<Option<Accessor<'f>>, ReadError> {
        let found = self.attribute(name, which)?;
        if let Some(found) = &found
            && found.count < vertices
        {
            let detail = format!("a primitive of {vertices} vertices has {name} for {} of them", found.count);
            return Err(ReadError::whole(ReadErrorKind::Malformed, format!("{detail}; export the model again")));
        }
        Ok(found)
    }

    fn attribute(
        &self,
        name: &str,
        which: impl Fn(&Attributes) -> Option<Whole>,
    ) -> Result<Option<Accessor<'f>>, ReadError> {
        let number = which(&self.primitive.attributes);
        if let (Some(decoded), Some(draco)) = (&self.decoded, &self.primitive.extensions.draco)
            && let Some(within) = which(&draco.attributes)
        {
            let told = number.and_then(|number| self.file.document.accessors.get(number.index()));
            let fraction = told.is_some_and(|told| told.normalized);
            return match decoded.attribute(within.0, fraction) {
                Some(found) => Ok(Some(found)),
                None => Err(malformed(format!("the data that is compressed with Draco lacks {name}"))),
            };
        }
        number.map(|number| Accessor::new(self.file, number)).transpose()
    }
}
