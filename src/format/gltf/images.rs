//! Pictures, kept as the files that they are.

use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::super::errors::{ReadError, ReadErrorKind};
use super::super::pictures::media_type;
use super::file::{File, data, entry, path};
use super::json::Whole;
use crate::scene::{Texture, Wrap};

/// Values of a sampler (glTF 2.0, 5.26).
pub(super) const NEAREST: u32 = 9728;
pub(super) const LINEAR: u32 = 9729;
pub(super) const LINEAR_MIPMAP_LINEAR: u32 = 9987;
pub(super) const REPEAT: u32 = 10497;
pub(super) const CLAMP_TO_EDGE: u32 = 33071;
pub(super) const MIRRORED_REPEAT: u32 = 33648;

/// A picture file and its media type.
type Picture = (Arc<[u8]>, &'static str);

/// The pictures that faces are painted with.
pub(super) struct Images<'f, 'a> {
    file: &'f File<'a>,
    pub textures: Vec<Texture>,
    /// Textures of the file by number; none where there is no picture that can be kept.
    known: FxHashMap<u32, Option<u32>>,
    /// Places in `textures` by the number of their image and how it is shown.
    shown: FxHashMap<(Whole, u8, u8, bool), usize>,
    /// Picture files by the number of their image.
    files: FxHashMap<u32, Option<Picture>>,
    /// The bytes of all picture files.
    bytes: usize,
    /// Pictures that were left out.
    pub left_out: u64,
}

impl<'f, 'a> Images<'f, 'a> {
    pub fn new(file: &'f File<'a>) -> Self {
        let (known, shown, files) = (FxHashMap::default(), FxHashMap::default(), FxHashMap::default());
        Self { file, textures: Vec::new(), known, shown, files, bytes: 0, left_out: 0 }
    }

    /// The place in [`Self::textures`] of a texture of the file; none where its picture can't be kept.
    pub fn texture(&mut self, number: Whole) -> Result<Option<u32>, ReadError> {
        if let Some(known) = self.known.get(&number.0) {
            return Ok(*known);
        }
        let document = &self.file.document;
        let texture = entry(&document.textures, number, "texture")?;
        let sampler = texture.sampler.map(|number| entry(&document.samplers, number, "sampler")).transpose()?;
        // Where there is no source, the picture is in a format that only an extension knows.
        let picture = match texture.source {
            Some(source) => self.picture(source)?.map(|picture| (source, picture)),
            None => None,
        };
        let added = match picture {
            Some((source, (bytes, media_type))) => {
                let wrap_u = wrap(sampler.and_then(|it| it.wrap_s));
                let wrap_v = wrap(sampler.and_then(|it| it.wrap_t));
                let nearest = sampler.and_then(|it| it.mag_filter) == Some(Whole(NEAREST));
                let at = *self.shown.entry((source, wrap_u as u8, wrap_v as u8, nearest)).or_insert_with(|| {
                    self.textures.push(Texture { bytes, media_type: media_type.to_owned(), wrap_u, wrap_v, nearest });
                    self.textures.len() - 1
                });
                u32::try_from(at).ok()
            }
            None => {
                self.left_out += 1;
                None
            }
        };
        self.known.insert(number.0, added);
        Ok(added)
    }

    fn picture(&mut self, number: Whole) -> Result<Option<Picture>, ReadError> {
        if let Some(known) = self.files.get(&number.0) {
            return Ok(known.clone());
        }
        let image = entry(&self.file.document.images, number, "image")?;
        let (copied, view);
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => match data(uri) {
                Some(data) => {
                    copied = data.unwrap_or_default();
                    &copied[..]
                }
                None => {
                    let picture = path(uri).and_then(|path| self.file.beside.picture(&path));
                    self.files.insert(number.0, picture.clone());
                    return Ok(picture);
                }
            },
            (None, Some(number)) => {
                view = self.file.view(number)?;
                view.bytes
            }
            (None, None) => &[],
        };
        let picture = match media_type(bytes) {
            Some(media_type) => {
                self.bytes += bytes.len();
                // Only pictures that lie over each other come to more than the file.
                if self.bytes > self.file.length {
                    let detail = "the file's pictures come to more bytes than the file; export the model again";
                    return Err(ReadError::whole(ReadErrorKind::TooLarge, detail));
                }
                Some((Arc::from(bytes), media_type))
            }
            None => None,
        };
        self.files.insert(number.0, picture.clone());
        Ok(picture)
    }
}

fn wrap(code: Option<Whole>) -> Wrap {
    match code {
        Some(Whole(CLAMP_TO_EDGE)) => Wrap::Clamp,
        Some(Whole(MIRRORED_REPEAT)) => Wrap::Mirror,
        _ => Wrap::Repeat,
    }
}
