use super::Format;
use crate::scene::Scene;

/// What a file of several objects holds, with what a reader should tell.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadScene {
    /// The objects, where they stand, and what they are painted with.
    pub scene: Scene,
    /// The format that was found.
    pub format: Format,
    /// The dialect in words: `3MF`, `GLB`, `OBJ in a ZIP archive`.
    pub dialect: String,
    /// Oddities that were read past, each a sentence for the person who sent the file.
    pub warnings: Vec<String>,
}
