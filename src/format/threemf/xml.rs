//! Streaming XML of a part: well-formedness, namespaces, and the restrictions of 3MF.
//!
//! Elements are read while they are unpacked, and skipped elements take no memory. Size, depth and number of attributes are limited to far
//! more than real files need.

use std::io::BufRead as _;

use memchr::{memchr, memmem};
use quick_xml::escape::unescape;
use quick_xml::events::attributes::Attributes;
use quick_xml::events::{BytesStart, BytesText, Event};
use quick_xml::{Error, Reader};

use super::schema::Namespace;
use crate::format::archive::{Stream, StreamError};
use crate::format::errors::{ReadError, ReadErrorKind, excerpt, excerpt_up_to};

/// Maximum depth of elements; models need seven.
const MAX_DEPTH: usize = 64;
/// Maximum number of attributes of an element.
const MAX_ATTRIBUTES: usize = 64;
/// Maximum number of namespaces in scope.
const MAX_BINDINGS: usize = 64;
/// Maximum length of an element's text, in bytes.
const MAX_TEXT_BYTES: usize = 1 << 20;

/// An XML document that is being read.
pub(super) struct Xml<'a> {
    reader: Reader<Stream<'a>>,
    part: String,
    depth: usize,
    bindings: Vec<Binding>,
    /// URIs of the namespaces that [`Namespace::Other`] refers to.
    unknown_uris: Vec<String>,
}

/// A namespace prefix in scope.
struct Binding {
    prefix: Box<[u8]>,
    space: Namespace,
    uri: String,
}

/// A start tag.
pub(super) struct Tag<'t> {
    /// The namespace of its name.
    pub space: Namespace,
    start: &'t BytesStart<'t>,
    empty: bool,
}

/// An attribute; its value is unescaped by [`Xml::string`].
pub(super) struct Attribute<'t> {
    /// The namespace of its name.
    pub space: Namespace,
    /// Its name without the prefix.
    pub name: &'t [u8],
    /// Its value as it is in the file.
    pub value: &'t [u8],
}

impl<'t> Tag<'t> {
    /// The element's name without its prefix.
    pub fn name(&self) -> &'t [u8] {
        self.start.local_name().into_inner()
    }

    /// The attributes without checks, with their prefixes. Fast, for vertices and triangles.
    pub fn raw_attributes(&self) -> Attributes<'t> {
        let mut attributes = self.start.attributes();
        attributes.with_checks(false);
        attributes
    }
}

impl<'a> Xml<'a> {
    /// Starts reading a part. `part` is its name in messages.
    pub fn new(part: &str, mut stream: Stream<'a>) -> Result<Self, ReadError> {
        let part = part.to_owned();
        stream.begin_event();
        let head = match stream.fill_buf() {
            Ok(head) => head,
            Err(error) => return Err(parser_error(&part, 0, &Error::from(error))),
        };
        if head.starts_with(b"\xFF\xFE") || head.starts_with(b"\xFE\xFF") || head.iter().take(4).any(|&b| b == 0) {
            let detail =
                format!("the part {part} is text in UTF-16 or UTF-32, but 3MF requires UTF-8; export the model again");
            return Err(ReadError::for_file(ReadErrorKind::Malformed, detail));
        }
        let mut reader = Reader::from_reader(stream);
        reader.config_mut().trim_text_start = true;
        let binding = |prefix: &[u8], space| Binding { prefix: prefix.into(), space, uri: String::new() };
        let bindings = vec![binding(b"", Namespace::None), binding(b"xml", Namespace::Xml)];
        Ok(Self { reader, part, depth: 0, bindings, unknown_uris: Vec::new() })
    }

    /// The name of the part.
    pub fn part(&self) -> &str {
        &self.part
    }

    /// An error at the current position.
    #[cold]
    pub fn error(&self, kind: ReadErrorKind, detail: impl std::fmt::Display) -> ReadError {
        error_at(&self.part, self.reader.buffer_position(), kind, detail)
    }

    /// An error of kind `Malformed` at the current position.
    #[cold]
    pub fn malformed(&self, detail: impl std::fmt::Display) -> ReadError {
        self.error(ReadErrorKind::Malformed, detail)
    }

    /// Reads the next event into `buffer`.
    fn event<'b>(&mut self, buffer: &'b mut Vec<u8>) -> Result<Event<'b>, ReadError> {
        buffer.clear();
        self.reader.get_mut().begin_event();
        match self.reader.read_event_into(buffer) {
            Ok(Event::DocType(_)) => {
                Err(self.malformed("a document type (<!DOCTYPE>) is forbidden in 3MF; export the model again"))
            }
            Ok(event) => Ok(event),
            Err(error) => Err(parser_error(&self.part, self.reader.buffer_position(), &error)),
        }
    }

    /// Reads the document; calls `each` with its root element.
    pub fn root(&mut self, each: impl FnOnce(&mut Self, &Tag<'_>) -> Result<(), ReadError>) -> Result<(), ReadError> {
        let mut each = Some(each);
        let mut buffer = Vec::new();
        loop {
            match self.event(&mut buffer)? {
                Event::Decl(declaration) => {
                    let encoding = declaration.encoding().and_then(Result::ok).unwrap_or_default();
                    if !encoding.is_empty() && !encoding.eq_ignore_ascii_case(b"utf-8") {
                        let detail = format!(
                            "the part declares the encoding {}, but 3MF requires UTF-8; export the model again",
                            excerpt(&encoding)
                        );
                        return Err(self.malformed(detail));
                    }
                }
                Event::Start(start) => self.open_root(&start, false, &mut each)?,
                Event::Empty(start) => self.open_root(&start, true, &mut each)?,
                Event::Eof if each.is_some() => {
                    return Err(self.malformed("the part has no element; export the model again"));
                }
                Event::Eof => return Ok(()),
                Event::Comment(_) | Event::PI(_) => {}
                Event::Text(text) if text.trim_ascii().is_empty() => {}
                _ => {
                    return Err(self.malformed(
                        "the part has text outside its root element, or is not UTF-8; export the model again",
                    ));
                }
            }
        }
    }

    fn open_root(
        &mut self,
        start: &BytesStart<'_>,
        empty: bool,
        each: &mut Option<impl FnOnce(&mut Self, &Tag<'_>) -> Result<(), ReadError>>,
    ) -> Result<(), ReadError> {
        let each = each.take();
        let each = each.ok_or_else(|| self.malformed("the part has a second root element; export the model again"))?;
        self.element(start, empty, each)
    }

    /// Calls `each` with the child elements in order. Content that `each` does not read is skipped.
    pub fn children(
        &mut self,
        parent: &Tag<'_>,
        mut each: impl FnMut(&mut Self, &Tag<'_>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        let mut buffer = Vec::new();
        if parent.empty {
            return Ok(());
        }
        loop {
            match self.event(&mut buffer)? {
                Event::Start(start) => self.element(&start, false, &mut each)?,
                Event::Empty(start) => self.element(&start, true, &mut each)?,
                Event::End(_) => {
                    self.depth -= 1;
                    return Ok(());
                }
                Event::Eof => return Err(self.ended()),
                _ => {}
            }
        }
    }

    /// Opens an element, calls `each` with it, and skips the rest of it.
    #[inline]
    fn element(
        &mut self,
        start: &BytesStart<'_>,
        empty: bool,
        each: impl FnOnce(&mut Self, &Tag<'_>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        let bindings = self.bindings.len();
        let attributes = start.attributes_raw();
        // Fast path: the attributes of vertices and triangles contain no `m`.
        if memchr(b'm', attributes).is_some() && memmem::find(attributes, b"xmlns").is_some() {
            self.bind(start)?;
        }
        let name = start.name();
        let space = self.space(name.prefix().map_or(&[][..], |prefix| prefix.into_inner()))?;
        let depth = self.depth;
        if !empty {
            self.depth += 1;
            if self.depth > MAX_DEPTH {
                return Err(self.error(
                    ReadErrorKind::TooLarge,
                    format_args!("elements are nested more than {MAX_DEPTH} deep; export the model again"),
                ));
            }
        }
        each(self, &Tag { space, start, empty })?;
        if self.depth > depth {
            self.skip(depth)?;
        }
        self.bindings.truncate(bindings);
        Ok(())
    }

    /// Skips events until all elements deeper than `depth` are closed.
    fn skip(&mut self, depth: usize) -> Result<(), ReadError> {
        let mut buffer = Vec::new();
        while self.depth > depth {
            match self.event(&mut buffer)? {
                Event::Start(_) if self.depth - depth >= MAX_DEPTH => {
                    return Err(self.error(
                        ReadErrorKind::TooLarge,
                        format_args!("elements are nested more than {MAX_DEPTH} deep; export the model again"),
                    ));
                }
                Event::Start(_) => self.depth += 1,
                Event::End(_) => self.depth -= 1,
                Event::Eof => return Err(self.ended()),
                _ => {}
            }
        }
        Ok(())
    }

    #[cold]
    fn ended(&self) -> ReadError {
        let detail =
            "the part ends within an element; it was probably cut off, so send it again or export the model again";
        self.error(ReadErrorKind::Truncated, detail)
    }

    /// Adds the namespaces that an element declares.
    fn bind(&mut self, start: &BytesStart<'_>) -> Result<(), ReadError> {
        for attribute in start.attributes().with_checks(false).take(MAX_ATTRIBUTES + 1) {
            let attribute = attribute.map_err(|error| self.malformed(error))?;
            let prefix = match attribute.key.into_inner() {
                b"xmlns" => &[][..],
                name => match name.strip_prefix(b"xmlns:") {
                    Some(prefix) => prefix,
                    None => continue,
                },
            };
            let uri = self.string(&attribute.value)?;
            let space = match Namespace::known(&uri) {
                Some(space) => space,
                None => Namespace::Other(self.unknown_index(&uri)?),
            };
            if self.bindings.len() >= MAX_BINDINGS {
                return Err(
                    self.error(ReadErrorKind::TooLarge, "the part uses too many namespaces; export the model again")
                );
            }
            self.bindings.push(Binding { prefix: prefix.into(), space, uri });
        }
        Ok(())
    }

    /// The index of an unknown namespace in `unknown_uris`.
    fn unknown_index(&mut self, uri: &str) -> Result<u16, ReadError> {
        let known = self.unknown_uris.iter().position(|other| other == uri);
        if known.is_none() {
            if self.unknown_uris.len() >= MAX_BINDINGS {
                return Err(
                    self.error(ReadErrorKind::TooLarge, "the part uses too many namespaces; export the model again")
                );
            }
            self.unknown_uris.push(uri.to_owned());
        }
        Ok(u16::try_from(known.unwrap_or(self.unknown_uris.len() - 1)).unwrap_or(u16::MAX))
    }

    /// The URI of an unknown namespace; empty for known ones.
    pub fn uri(&self, space: Namespace) -> &str {
        match space {
            Namespace::Other(index) => self.unknown_uris.get(usize::from(index)).map_or("", String::as_str),
            _ => "",
        }
    }

    /// The namespace that a prefix refers to here.
    #[inline]
    pub fn space(&self, prefix: &[u8]) -> Result<Namespace, ReadError> {
        self.binding(prefix).map(|binding| binding.space)
    }

    /// The URI of the namespace that a prefix refers to here.
    pub fn uri_of_prefix(&self, prefix: &[u8]) -> Result<String, ReadError> {
        self.binding(prefix).map(|binding| binding.uri.clone())
    }

    #[inline]
    fn binding(&self, prefix: &[u8]) -> Result<&Binding, ReadError> {
        // Comparing two empty slices calls `memcmp` with a dangling pointer, which is slow on some processors, so skip it.
        let is_same = |own: &[u8]| own.len() == prefix.len() && (prefix.is_empty() || own == prefix);
        self.bindings.iter().rev().find(|binding| is_same(&binding.prefix)).ok_or_else(|| {
            self.malformed(format_args!(
                "the namespace prefix '{}' is not declared; export the model again",
                excerpt(prefix)
            ))
        })
    }

    /// Calls `each` with the element's attributes, except namespace declarations.
    pub fn attributes<'t>(
        &self,
        tag: &Tag<'t>,
        mut each: impl FnMut(Attribute<'_>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        if tag.start.attributes().with_checks(false).take(MAX_ATTRIBUTES + 1).count() > MAX_ATTRIBUTES {
            let detail = format!("an element has more than {MAX_ATTRIBUTES} attributes; export the model again");
            return Err(self.error(ReadErrorKind::TooLarge, detail));
        }
        for attribute in tag.start.attributes() {
            let attribute = attribute.map_err(|error| self.malformed(error))?;
            let key = attribute.key.into_inner();
            let (prefix, name) = match key.iter().position(|&b| b == b':') {
                Some(colon) => (&key[..colon], &key[colon + 1..]),
                None => (&[][..], key),
            };
            if prefix == b"xmlns" || key == b"xmlns" {
                continue;
            }
            // Attributes without a prefix have no namespace, whatever the default namespace is.
            let space = if prefix.is_empty() { Namespace::None } else { self.space(prefix)? };
            each(Attribute { space, name, value: &attribute.value })?;
        }
        Ok(())
    }

    /// Unescapes an attribute's value.
    pub fn string(&self, value: &[u8]) -> Result<String, ReadError> {
        let text =
            std::str::from_utf8(value).map_err(|_| self.malformed("a value is not UTF-8; export the model again"))?;
        // XML normalizes white space in attributes to spaces, except character references.
        let spaces = text.replace(['\t', '\n', '\r'], " ");
        let text = unescape(&spaces).map_err(|error| self.malformed(error))?;
        self.without_control_characters(text.into_owned())
    }

    fn without_control_characters(&self, text: String) -> Result<String, ReadError> {
        match text
            .chars()
            .find(|&c| (c < ' ' && !matches!(c, '\t' | '\n' | '\r')) || matches!(c, '\u{FFFE}' | '\u{FFFF}'))
        {
            Some(c) => Err(self.malformed(format_args!(
                "the character {:#x} is forbidden in XML; export the model again",
                u32::from(c)
            ))),
            None => Ok(text),
        }
    }

    /// Reads the text of an element; child elements are skipped.
    pub fn text(&mut self, tag: &Tag<'_>) -> Result<String, ReadError> {
        let mut whole = String::new();
        if tag.empty {
            return Ok(whole);
        }
        self.reader.config_mut().trim_text_start = false;
        let mut buffer = Vec::new();
        loop {
            match self.event(&mut buffer)? {
                Event::Text(text) => whole.push_str(&self.content(&text)?),
                Event::CData(text) => whole.push_str(&text.xml10_content().map_err(|error| self.malformed(error))?),
                Event::GeneralRef(reference) => match reference.resolve_char_ref() {
                    Ok(Some(character)) => whole.push(character),
                    Err(error) => return Err(self.malformed(error)),
                    Ok(None) => {
                        let reference = format!("&{};", String::from_utf8_lossy(&reference));
                        whole.push_str(&unescape(&reference).map_err(|error| self.malformed(error))?);
                    }
                },
                Event::Start(_) => {
                    self.depth += 1;
                    self.skip(self.depth - 1)?;
                }
                Event::End(_) => break,
                Event::Eof => return Err(self.ended()),
                _ => {}
            }
            if whole.len() > MAX_TEXT_BYTES {
                return Err(self.error(
                    ReadErrorKind::TooLarge,
                    "an element's text is longer than 1 MiB; export the model without it",
                ));
            }
        }
        self.depth -= 1;
        self.reader.config_mut().trim_text_start = true;
        self.without_control_characters(whole)
    }

    fn content(&self, text: &BytesText<'_>) -> Result<String, ReadError> {
        Ok(text.xml10_content().map_err(|error| self.malformed(error))?.into_owned())
    }
}

/// An error near a byte of a part.
fn error_at(part: &str, byte: u64, kind: ReadErrorKind, detail: impl std::fmt::Display) -> ReadError {
    ReadError::for_file(kind, format!("in the part {} near byte {byte}: {detail}", excerpt(part.as_bytes())))
}

/// The error for a failure of the XML parser or of unpacking.
#[cold]
fn parser_error(part: &str, byte: u64, error: &Error) -> ReadError {
    let (kind, detail) = match error {
        Error::Io(io) => match io.get_ref().and_then(|inner| inner.downcast_ref::<StreamError>()) {
            Some(stream_error) => (ReadErrorKind::TooLarge, format!("{stream_error}; export the model again")),
            None => (ReadErrorKind::Malformed, format!("the part can't be unpacked ({io}); send the file again")),
        },
        Error::Syntax(_) => (
            ReadErrorKind::Truncated,
            format!("{error}; the part was probably cut off, so send it again or export the model again"),
        ),
        // The parser may quote the file at any length.
        _ => (
            ReadErrorKind::Malformed,
            format!("{}; export the model again", excerpt_up_to(150, error.to_string().as_bytes())),
        ),
    };
    error_at(part, byte, kind, detail)
}
