//! Pictures, kept as the files that they are: nothing here decodes one.

/// Most bytes of all pictures of a file together, where it does not hold them itself.
pub(super) const MOST_BYTES: u64 = 128 << 20;

/// What the files begin with that 3MF and glTF take, their media types and the usual endings of their names.
const KINDS: [(&[u8], &str, &str); 2] =
    [(b"\x89PNG\r\n\x1A\n", "image/png", "png"), (b"\xFF\xD8\xFF", "image/jpeg", "jpg")];

/// The media type of a picture by its first bytes; none for other kinds than PNG and JPEG.
pub(super) fn media_type(bytes: &[u8]) -> Option<&'static str> {
    KINDS.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|(_, media_type, _)| *media_type)
}

/// The usual ending of the name of a file of this kind.
pub(super) fn extension(bytes: &[u8]) -> Option<&'static str> {
    KINDS.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|(.., extension)| *extension)
}
