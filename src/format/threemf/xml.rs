//! A part's XML, element by element as it is decompressed: well formed, with namespaces, and without what 3MF forbids in it.
//!
//! Nothing is kept of an element that nobody asks for, and no element may be longer, deeper or fuller of attributes than files of
//! honest programs ever are.

use std::io::BufRead as _;

use memchr::{memchr, memmem};
use quick_xml::escape::unescape;
use quick_xml::events::attributes::Attributes;
use quick_xml::events::{BytesStart, BytesText, Event};
use quick_xml::{Error, Reader};

use super::schema::Space;
use crate::format::archive::{Stop, Stream};
use crate::format::errors::{ReadError, ReadErrorKind, shown, shown_up_to};

/// The deepest element; models have theirs at a depth of seven.
const DEPTH: usize = 64;
/// Most attributes of one element.
const ATTRIBUTES: usize = 64;
/// Most namespaces that are in force at once.
const BINDINGS: usize = 64;
/// The longest text of an element, in bytes.
const TEXT: usize = 1 << 20;

/// An XML document while it is read.
pub(super) struct Xml<'a> {
    reader: Reader<Stream<'a>>,
    part: String,
    depth: usize,
    bindings: Vec<Binding>,
    /// The addresses behind [`Space::Other`].
    others: Vec<String>,
}

/// What a prefix stands for, while an element is open.
struct Binding {
    prefix: Box<[u8]>,
    space: Space,
    uri: String,
}

/// The start of an element.
pub(super) struct Tag<'t> {
    /// What its name belongs to.
    pub space: Space,
    start: &'t BytesStart<'t>,
    empty: bool,
}

/// An attribute, its value as it stands in the file.
pub(super) struct Attribute<'t> {
    pub space: Space,
    pub name: &'t [u8],
    pub value: &'t [u8],
}

impl<'t> Tag<'t> {
    /// The name without its prefix.
    pub fn name(&self) -> &'t [u8] {
        self.start.local_name().into_inner()
    }

    /// Its attributes with whatever prefixes they have, for the elements that there are many of.
    pub fn raw_attributes(&self) -> Attributes<'t> {
        let mut attributes = self.start.attributes();
        attributes.with_checks(false);
        attributes
    }
}

impl<'a> Xml<'a> {
    /// Begins a part that is called `part` in messages.
    pub fn new(part: &str, mut stream: Stream<'a>) -> Result<Self, ReadError> {
        let part = part.to_owned();
        stream.begin_event();
        let head = match stream.fill_buf() {
            Ok(head) => head,
            Err(error) => return Err(failed(&part, 0, &Error::from(error))),
        };
        if head.starts_with(b"\xFF\xFE") || head.starts_with(b"\xFE\xFF") || head.iter().take(4).any(|&b| b == 0) {
            let detail =
                format!("{part} is text in UTF-16 or UTF-32, where 3MF asks for UTF-8; export the model again");
            return Err(ReadError::whole(ReadErrorKind::Malformed, detail));
        }
        let mut reader = Reader::from_reader(stream);
        reader.config_mut().trim_text_start = true;
        let binding = |prefix: &[u8], space| Binding { prefix: prefix.into(), space, uri: String::new() };
        let bindings = vec![binding(b"", Space::None), binding(b"xml", Space::Xml)];
        Ok(Self { reader, part, depth: 0, bindings, others: Vec::new() })
    }

    /// The part's name.
    pub fn part(&self) -> &str {
        &self.part
    }

    /// An error at the place that has been reached.
    #[cold]
    pub fn error(&self, kind: ReadErrorKind, detail: impl std::fmt::Display) -> ReadError {
        at(&self.part, self.reader.buffer_position(), kind, detail)
    }

    /// As [`Xml::error`], of what is not as it should be.
    #[cold]
    pub fn malformed(&self, detail: impl std::fmt::Display) -> ReadError {
        self.error(ReadErrorKind::Malformed, detail)
    }

    fn event<'b>(&mut self, buffer: &'b mut Vec<u8>) -> Result<Event<'b>, ReadError> {
        buffer.clear();
        self.reader.get_mut().begin_event();
        match self.reader.read_event_into(buffer) {
            Ok(Event::DocType(_)) => {
                Err(self.malformed("a document type (<!DOCTYPE>) is forbidden in 3MF; export the model again"))
            }
            Ok(event) => Ok(event),
            Err(error) => Err(failed(&self.part, self.reader.buffer_position(), &error)),
        }
    }

    /// Reads the document: its one root element.
    pub fn root(&mut self, each: impl FnOnce(&mut Self, &Tag<'_>) -> Result<(), ReadError>) -> Result<(), ReadError> {
        let mut each = Some(each);
        let mut buffer = Vec::new();
        loop {
            match self.event(&mut buffer)? {
                Event::Decl(declaration) => {
                    let encoding = declaration.encoding().and_then(Result::ok).unwrap_or_default();
                    if !encoding.is_empty() && !encoding.eq_ignore_ascii_case(b"utf-8") {
                        let detail =
                            format!("it is in {}, where 3MF asks for UTF-8; export the model again", shown(&encoding));
                        return Err(self.malformed(detail));
                    }
                }
                Event::Start(start) => self.opened(&start, false, &mut each)?,
                Event::Empty(start) => self.opened(&start, true, &mut each)?,
                Event::Eof if each.is_some() => {
                    return Err(self.malformed("there is no element in it; export the model again"));
                }
                Event::Eof => return Ok(()),
                Event::Comment(_) | Event::PI(_) => {}
                Event::Text(text) if text.trim_ascii().is_empty() => {}
                _ => {
                    return Err(self.malformed(
                        "there is text outside of its root element, or it is not in UTF-8; export the model again",
                    ));
                }
            }
        }
    }

    fn opened(
        &mut self,
        start: &BytesStart<'_>,
        empty: bool,
        each: &mut Option<impl FnOnce(&mut Self, &Tag<'_>) -> Result<(), ReadError>>,
    ) -> Result<(), ReadError> {
        let each = each.take();
        let each = each.ok_or_else(|| self.malformed("there is a second root element; export the model again"))?;
        self.element(start, empty, each)
    }

    /// Reads the elements in an element, one after the other. Of those that `each` leaves unread the rest is passed over.
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

    #[inline]
    fn element(
        &mut self,
        start: &BytesStart<'_>,
        empty: bool,
        each: impl FnOnce(&mut Self, &Tag<'_>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        let bindings = self.bindings.len();
        let attributes = start.attributes_raw();
        // Of the elements that there are millions of none has an m.
        if memchr(b'm', attributes).is_some() && memmem::find(attributes, b"xmlns").is_some() {
            self.bind(start)?;
        }
        let name = start.name();
        let space = self.space(name.prefix().map_or(&[][..], |prefix| prefix.into_inner()))?;
        let depth = self.depth;
        if !empty {
            self.depth += 1;
            if self.depth > DEPTH {
                return Err(self.error(
                    ReadErrorKind::TooLarge,
                    format_args!("elements are more than {DEPTH} deep; export the model again"),
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

    /// Goes on until the elements below a depth are closed.
    fn skip(&mut self, depth: usize) -> Result<(), ReadError> {
        let mut buffer = Vec::new();
        while self.depth > depth {
            match self.event(&mut buffer)? {
                Event::Start(_) if self.depth - depth >= DEPTH => {
                    return Err(self.error(
                        ReadErrorKind::TooLarge,
                        format_args!("elements are more than {DEPTH} deep; export the model again"),
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
        let detail = "it ends within an element; it was probably cut off, so send or export it again";
        self.error(ReadErrorKind::Truncated, detail)
    }

    /// Takes the namespaces that an element declares.
    fn bind(&mut self, start: &BytesStart<'_>) -> Result<(), ReadError> {
        for attribute in start.attributes().with_checks(false).take(ATTRIBUTES + 1) {
            let attribute = attribute.map_err(|error| self.malformed(error))?;
            let prefix = match attribute.key.into_inner() {
                b"xmlns" => &[][..],
                name => match name.strip_prefix(b"xmlns:") {
                    Some(prefix) => prefix,
                    None => continue,
                },
            };
            let uri = self.string(&attribute.value)?;
            let space = match Space::known(&uri) {
                Some(space) => space,
                None => Space::Other(self.other(&uri)?),
            };
            if self.bindings.len() >= BINDINGS {
                return Err(self.error(ReadErrorKind::TooLarge, "it has too many namespaces; export the model again"));
            }
            self.bindings.push(Binding { prefix: prefix.into(), space, uri });
        }
        Ok(())
    }

    fn other(&mut self, uri: &str) -> Result<u16, ReadError> {
        let known = self.others.iter().position(|other| other == uri);
        if known.is_none() {
            if self.others.len() >= BINDINGS {
                return Err(self.error(ReadErrorKind::TooLarge, "it has too many namespaces; export the model again"));
            }
            self.others.push(uri.to_owned());
        }
        Ok(u16::try_from(known.unwrap_or(self.others.len() - 1)).unwrap_or(u16::MAX))
    }

    /// The address of a namespace that is not read.
    pub fn uri(&self, space: Space) -> &str {
        match space {
            Space::Other(index) => self.others.get(usize::from(index)).map_or("", String::as_str),
            _ => "",
        }
    }

    /// What a prefix stands for here.
    #[inline]
    pub fn space(&self, prefix: &[u8]) -> Result<Space, ReadError> {
        self.binding(prefix).map(|binding| binding.space)
    }

    /// The address of the namespace that a prefix stands for here.
    pub fn address(&self, prefix: &[u8]) -> Result<String, ReadError> {
        self.binding(prefix).map(|binding| binding.uri.clone())
    }

    #[inline]
    fn binding(&self, prefix: &[u8]) -> Result<&Binding, ReadError> {
        // Not by comparing no bytes with none at an address where there is no memory, which some processors are slow at.
        let is_it = |own: &[u8]| own.len() == prefix.len() && (prefix.is_empty() || own == prefix);
        self.bindings.iter().rev().find(|binding| is_it(&binding.prefix)).ok_or_else(|| {
            self.malformed(format_args!(
                "the prefix '{}' stands for no namespace; export the model again",
                shown(prefix)
            ))
        })
    }

    /// Reads an element's attributes, declarations of namespaces left out.
    pub fn attributes<'t>(
        &self,
        tag: &Tag<'t>,
        mut each: impl FnMut(Attribute<'_>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        if tag.start.attributes().with_checks(false).take(ATTRIBUTES + 1).count() > ATTRIBUTES {
            let detail = format!("an element has more than {ATTRIBUTES} attributes; export the model again");
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
            // A name without a prefix belongs to no namespace, whatever the default is.
            let space = if prefix.is_empty() { Space::None } else { self.space(prefix)? };
            each(Attribute { space, name, value: &attribute.value })?;
        }
        Ok(())
    }

    /// A value as text.
    pub fn string(&self, value: &[u8]) -> Result<String, ReadError> {
        let text =
            std::str::from_utf8(value).map_err(|_| self.malformed("a value is not UTF-8; export the model again"))?;
        // White space in a value is a space, unless it is spelled as a reference.
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

    /// The text of an element; elements in it are passed over.
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
            if whole.len() > TEXT {
                return Err(self
                    .error(ReadErrorKind::TooLarge, "a text is longer than a megabyte; export the model without it"));
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

fn at(part: &str, byte: u64, kind: ReadErrorKind, detail: impl std::fmt::Display) -> ReadError {
    ReadError::whole(kind, format!("in the part {} near byte {byte}: {detail}", shown(part.as_bytes())))
}

/// What made the reader stop.
#[cold]
fn failed(part: &str, byte: u64, error: &Error) -> ReadError {
    let (kind, detail) = match error {
        Error::Io(io) => match io.get_ref().and_then(|inner| inner.downcast_ref::<Stop>()) {
            Some(stop) => (ReadErrorKind::TooLarge, format!("{stop}; export the model again")),
            None => (ReadErrorKind::Malformed, format!("it can't be unpacked ({io}); send the file again")),
        },
        Error::Syntax(_) => {
            (ReadErrorKind::Truncated, format!("{error}; it was probably cut off, so send or export it again"))
        }
        // What the parser cites may be as long as the file.
        _ => (
            ReadErrorKind::Malformed,
            format!("{}; export the model again", shown_up_to(150, error.to_string().as_bytes())),
        ),
    };
    at(part, byte, kind, detail)
}
