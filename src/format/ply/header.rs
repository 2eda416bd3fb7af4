//! The PLY header: the declared elements and properties, and their meaning for a mesh.

use super::super::errors::{ReadError, ReadErrorKind, excerpt};
use super::super::limits::Limits;
use super::super::text::{Text, Word, integer};

/// The encoding of the elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    BinaryLittleEndian,
    BinaryBigEndian,
}

impl Encoding {
    /// The dialect's name for reports.
    pub fn dialect(self) -> &'static str {
        match self {
            Self::Ascii => "ASCII PLY",
            Self::BinaryLittleEndian => "binary little-endian PLY",
            Self::BinaryBigEndian => "binary big-endian PLY",
        }
    }
}

/// A number type of PLY.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(word: Word<'_>) -> Option<Self> {
        Some(match word.bytes {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    /// Size in bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Whether this is an integer type.
    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

/// The value type of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PropertyType {
    /// One number.
    Scalar(Scalar),
    /// A length of type `count`, then that many numbers of type `item`.
    List { count: Scalar, item: Scalar },
}

/// The meaning of a property for a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Meaning {
    /// Coordinate of a vertex: 0, 1 or 2 for x, y or z.
    Coordinate(usize),
    /// Component of a vertex normal: 0, 1 or 2 for x, y or z.
    Normal(usize),
    /// Colour component of a vertex or face: 0 to 3 for red, green, blue or alpha.
    Color(usize),
    /// Vertex indices of a face or a strip.
    Indices,
    /// Texture coordinates of a face's corners.
    TextureCoordinates,
    /// A property that is skipped.
    Other,
}

/// A property of an element.
#[derive(Debug, Clone, Copy)]
pub(super) struct Property {
    /// One number or a list.
    pub value_type: PropertyType,
    /// Its meaning for a mesh.
    pub meaning: Meaning,
}

/// The meaning of an element for a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// Vertices.
    Vertices,
    /// Polygons.
    Faces,
    /// Triangle strips, which some range scanners write.
    Strips,
    /// An element that is skipped.
    Other,
}

/// An element declared by the header.
#[derive(Debug, Clone)]
pub(super) struct Element {
    /// The element's name in the header.
    pub name: String,
    /// Its meaning.
    pub role: Role,
    /// Number of rows.
    pub count: u64,
    /// The properties of each row, in order.
    pub properties: Vec<Property>,
    /// Byte offset of the declaration.
    at: usize,
}

/// A row of an element, for error messages.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row<'e> {
    /// The element.
    pub element: &'e Element,
    /// Number of the row, counted from 0.
    pub number: u64,
}

impl Element {
    /// The element's rows.
    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.count).map(|number| Row { element: self, number })
    }

    /// Size of a binary row in bytes; `None` if the element has a list.
    pub fn fixed_size(&self) -> Option<usize> {
        self.properties
            .iter()
            .map(|p| if let PropertyType::Scalar(s) = p.value_type { Some(s.size()) } else { None })
            .sum()
    }

    /// Minimum size of a row in bytes.
    fn min_size(&self, encoding: Encoding) -> u64 {
        match encoding {
            // One digit and one separator for each property.
            Encoding::Ascii => 2 * self.properties.len() as u64,
            _ => self
                .properties
                .iter()
                .map(|p| match p.value_type {
                    PropertyType::Scalar(s) | PropertyType::List { count: s, .. } => s.size() as u64,
                })
                .sum(),
        }
    }

    /// Whether all three normal components are declared.
    pub fn has_normals(&self) -> bool {
        (0..3).all(|k| self.has(Meaning::Normal(k)))
    }

    /// Whether red, green and blue are declared.
    pub fn has_colors(&self) -> bool {
        (0..3).all(|k| self.has(Meaning::Color(k)))
    }

    fn has(&self, meaning: Meaning) -> bool {
        self.properties.iter().any(|p| p.meaning == meaning)
    }
}

/// The parsed header.
#[derive(Debug, Clone)]
pub(super) struct Header {
    /// The encoding of the elements.
    pub encoding: Encoding,
    /// The elements, in file order.
    pub elements: Vec<Element>,
    /// Whether the header refers to a texture.
    pub has_texture: bool,
    /// Oddities that did not prevent reading.
    pub warnings: Vec<String>,
    /// Byte offset of the first byte after the header.
    pub body: usize,
}

impl Header {
    /// Parses the header.
    ///
    /// # Errors
    /// A [`ReadError`] at the line that is malformed, or if the elements do not describe a mesh.
    pub fn read(bytes: &[u8]) -> Result<Self, ReadError> {
        let mut text = Text::new(bytes);
        // The sniffer has checked that the first word is `ply`.
        let _ = text.word();
        text.skip_line();
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut unknown = None;
        let mut has_texture = false;
        loop {
            let Some(word) = text.word() else { return Err(text.ended("the header's 'end_header'")) };
            match word.bytes {
                b"comment" | b"obj_info" => {
                    has_texture |= text.word_on_line().is_some_and(|word| word.is("texturefile"));
                    text.skip_line();
                }
                b"format" => encoding = Some(read_format(&mut text, word)?),
                b"element" => elements.push(read_element(&mut text, word)?),
                b"property" => {
                    let Some(element) = elements.last_mut() else {
                        return Err(malformed(&text, word, "an 'element' line before this property"));
                    };
                    let property = read_property(&mut text, word, element.role)?;
                    element.properties.push(property);
                }
                b"end_header" => break,
                // Some exporters omit the word `comment`.
                _ => {
                    unknown.get_or_insert(word);
                    text.skip_line();
                }
            }
        }
        let Some(encoding) = encoding else {
            return Err(text.error(
                ReadErrorKind::Malformed,
                text.at(),
                "the header has no line such as `format binary_little_endian 1.0`; export the model again",
            ));
        };
        let warnings = unknown
            .map(|word: Word<'_>| {
                format!(
                    "lines that do not belong to a PLY header were ignored, the first begins with '{}'",
                    excerpt(word.bytes)
                )
            })
            .into_iter()
            .collect();
        has_texture |= elements.iter().any(|element| element.has(Meaning::TextureCoordinates));
        let header = Self { encoding, elements, has_texture, warnings, body: body_start(bytes, text.at()) };
        header.check_elements(&text)?;
        Ok(header)
    }

    /// Checks that the elements describe a mesh.
    fn check_elements(&self, text: &Text<'_>) -> Result<(), ReadError> {
        let mut has_vertices = false;
        for element in &self.elements {
            let error = |detail: String| Err(text.error(ReadErrorKind::Malformed, element.at, detail));
            match element.role {
                Role::Vertices if has_vertices => {
                    return error("the header has a second element 'vertex'; export the model again".to_owned());
                }
                Role::Vertices => {
                    has_vertices = true;
                    if let Some(k) = (0..3).find(|&k| !element.has(Meaning::Coordinate(k))) {
                        return error(format!(
                            "the element 'vertex' has no property '{}', but needs x, y and z; export the model again",
                            ["x", "y", "z"][k]
                        ));
                    }
                }
                Role::Faces | Role::Strips if element.count > 0 && !element.has(Meaning::Indices) => {
                    return error(format!(
                        "the element '{}' has no list of whole numbers named `vertex_indices` or `vertex_index`; export the model again",
                        excerpt(element.name.as_bytes())
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Checks all counts against the file's size of `length` bytes, and against the limits.
    pub fn check_counts(&self, length: usize, limits: &Limits) -> Result<(), ReadError> {
        let available = (length - self.body) as u64;
        let mut min_bytes = 0_u64;
        for element in &self.elements {
            min_bytes = min_bytes.saturating_add(element.count.saturating_mul(element.min_size(self.encoding)));
            // The last word of a text file needs no separator.
            if min_bytes > available + 1 {
                return Err(ReadError::at_byte(
                    ReadErrorKind::Truncated,
                    length,
                    format!(
                        "the header counts {} rows of the element '{}', but {available} bytes can't hold them; the file is cut off or damaged, so send it again",
                        element.count,
                        excerpt(element.name.as_bytes())
                    ),
                ));
            }
        }
        for element in &self.elements {
            match element.role {
                Role::Vertices => limits.check_vertices(element.count)?,
                Role::Faces => limits.check_faces(element.count)?,
                Role::Strips | Role::Other => {}
            }
        }
        Ok(())
    }
}

fn malformed(text: &Text<'_>, word: Word<'_>, expected: &str) -> ReadError {
    text.error(
        ReadErrorKind::Malformed,
        word.at,
        format!(
            "found '{}' in the PLY header where {expected} was expected; export the model again",
            excerpt(word.bytes)
        ),
    )
}

fn read_format(text: &mut Text<'_>, keyword: Word<'_>) -> Result<Encoding, ReadError> {
    let word = text.word_on_line().unwrap_or(keyword);
    let encoding = match word.bytes {
        b"ascii" => Encoding::Ascii,
        b"binary_little_endian" => Encoding::BinaryLittleEndian,
        b"binary_big_endian" => Encoding::BinaryBigEndian,
        _ => return Err(malformed(text, word, "'ascii', 'binary_little_endian' or 'binary_big_endian'")),
    };
    text.skip_line();
    Ok(encoding)
}

fn read_element(text: &mut Text<'_>, keyword: Word<'_>) -> Result<Element, ReadError> {
    let name = text.word_on_line().ok_or_else(|| malformed(text, keyword, "an element's name"))?;
    let count = text.word_on_line().ok_or_else(|| malformed(text, name, "an element's name and count"))?;
    let Some(count) = integer(count.bytes).and_then(|n| u64::try_from(n).ok()) else {
        return Err(malformed(text, count, "an element's count"));
    };
    text.skip_line();
    let role = match name.bytes {
        b"vertex" => Role::Vertices,
        b"face" => Role::Faces,
        b"tristrips" => Role::Strips,
        _ => Role::Other,
    };
    let name = String::from_utf8_lossy(name.bytes).into_owned();
    Ok(Element { name, role, count, properties: Vec::new(), at: keyword.at })
}

fn read_property(text: &mut Text<'_>, keyword: Word<'_>, role: Role) -> Result<Property, ReadError> {
    let scalar = |text: &mut Text<'_>, last: Word<'_>| {
        let word = text.word_on_line().unwrap_or(last);
        Scalar::named(word).ok_or_else(|| malformed(text, word, "a number type such as 'float' or 'int'"))
    };
    let ahead = text.clone().word_on_line();
    let value_type = if ahead.is_some_and(|word| word.bytes == b"list") {
        let list = text.word_on_line().unwrap_or(keyword);
        let count = scalar(text, list)?;
        if !count.is_integer() {
            return Err(malformed(text, list, "a list whose count is a whole number"));
        }
        PropertyType::List { count, item: scalar(text, list)? }
    } else {
        PropertyType::Scalar(scalar(text, keyword)?)
    };
    let name = text.word_on_line().ok_or_else(|| malformed(text, keyword, "a property's type and name"))?;
    text.skip_line();
    let meaning = match (role, value_type, name.bytes) {
        (Role::Vertices, PropertyType::Scalar(_), b"x") => Meaning::Coordinate(0),
        (Role::Vertices, PropertyType::Scalar(_), b"y") => Meaning::Coordinate(1),
        (Role::Vertices, PropertyType::Scalar(_), b"z") => Meaning::Coordinate(2),
        (Role::Vertices, PropertyType::Scalar(_), b"nx") => Meaning::Normal(0),
        (Role::Vertices, PropertyType::Scalar(_), b"ny") => Meaning::Normal(1),
        (Role::Vertices, PropertyType::Scalar(_), b"nz") => Meaning::Normal(2),
        (Role::Vertices | Role::Faces, PropertyType::Scalar(_), b"red" | b"diffuse_red") => Meaning::Color(0),
        (Role::Vertices | Role::Faces, PropertyType::Scalar(_), b"green" | b"diffuse_green") => Meaning::Color(1),
        (Role::Vertices | Role::Faces, PropertyType::Scalar(_), b"blue" | b"diffuse_blue") => Meaning::Color(2),
        (Role::Vertices | Role::Faces, PropertyType::Scalar(_), b"alpha") => Meaning::Color(3),
        (Role::Faces, PropertyType::List { .. }, b"texcoord") => Meaning::TextureCoordinates,
        (Role::Faces | Role::Strips, PropertyType::List { item, .. }, b"vertex_indices" | b"vertex_index")
            if item.is_integer() =>
        {
            Meaning::Indices
        }
        _ => Meaning::Other,
    };
    Ok(Property { value_type, meaning })
}

/// The byte offset of the elements: after one line end of the kind that the first line has. A binary number may follow that looks like a
/// line end.
fn body_start(bytes: &[u8], after_word: usize) -> usize {
    let rest = &bytes[after_word..];
    let blank = rest.iter().take_while(|b| matches!(b, b' ' | b'\t')).count();
    let at = after_word + blank;
    let first_line = bytes.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(0);
    let only_cr = bytes.get(first_line) == Some(&b'\r') && bytes.get(first_line + 1) != Some(&b'\n');
    match (bytes.get(at), bytes.get(at + 1)) {
        (Some(b'\r'), Some(b'\n')) if !only_cr => at + 2,
        (Some(b'\r' | b'\n'), _) => at + 1,
        _ => at,
    }
}
