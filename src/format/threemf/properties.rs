//! Resources for materials, colours and textures (core specification, chapter 5; materials extension, chapters 2 to 6).

use super::part::{GroupKind, ModelReader, TextureResource, parse_index, unexpected_value};
use super::schema::{Namespace, color, number, resolve, words};
use super::xml::{Tag, Xml};
use crate::format::errors::{ReadError, ReadErrorKind, excerpt};
use crate::scene::{Material, Wrap};

/// Maximum number of groups or materials that a resource combines.
const MAX_COMBINED: usize = 256;

/// Reads the id of a resource.
pub(super) fn id(xml: &Xml<'_>, tag: &Tag<'_>) -> Result<u32, ReadError> {
    let mut id = None;
    xml.attributes(tag, |attribute| {
        if attribute.space == Namespace::None && attribute.name == b"id" {
            id = Some(parse_index(xml, attribute.value)?);
        }
        Ok(())
    })?;
    id.ok_or_else(|| xml.malformed(format_args!("a <{}> has no id; export the model again", excerpt(tag.name()))))
}

/// The values of the named attributes without a namespace; other attributes are ignored or reported.
fn values<const N: usize>(
    reader: &mut ModelReader,
    xml: &Xml<'_>,
    tag: &Tag<'_>,
    names: [&[u8]; N],
) -> Result<[Option<Vec<u8>>; N], ReadError> {
    let mut values = [const { None }; N];
    xml.attributes(tag, |attribute| {
        let known = names.iter().position(|&name| name == attribute.name && attribute.space == Namespace::None);
        match known {
            Some(which) => values[which] = Some(attribute.value.to_owned()),
            None if matches!(attribute.name, b"id" | b"displaypropertiesid" | b"box") => {}
            None => reader.ignore_attribute(xml, &attribute, true)?,
        }
        Ok(())
    })?;
    Ok(values)
}

fn missing(xml: &Xml<'_>, tag: &Tag<'_>, name: &str) -> ReadError {
    xml.malformed(format_args!("a <{}> has no {name}; export the model again", excerpt(tag.name())))
}

/// Calls `entry` with the child elements that have this name; other elements are reported.
fn entries(
    reader: &mut ModelReader,
    xml: &mut Xml<'_>,
    tag: &Tag<'_>,
    (space, name): (Namespace, &[u8]),
    mut entry: impl FnMut(&mut ModelReader, &Xml<'_>, &Tag<'_>) -> Result<(), ReadError>,
) -> Result<(), ReadError> {
    xml.children(tag, |xml, tag| {
        if tag.space != space || tag.name() != name {
            return reader.ignore_element(xml, tag);
        }
        reader.budget.entries(1, xml)?;
        entry(reader, xml, tag)
    })
}

fn color_in(xml: &Xml<'_>, value: &[u8]) -> Result<[u8; 4], ReadError> {
    color(value).ok_or_else(|| unexpected_value(xml, "a colour such as #FF8000", value))
}

/// Reads `basematerials`.
pub(super) fn materials(reader: &mut ModelReader, xml: &mut Xml<'_>, tag: &Tag<'_>) -> Result<GroupKind, ReadError> {
    let [] = values(reader, xml, tag, [])?;
    let mut materials = Vec::new();
    entries(reader, xml, tag, (Namespace::Core, b"base"), |reader, xml, tag| {
        let [name, color] = values(reader, xml, tag, [b"name", b"displaycolor"])?;
        let name = name.ok_or_else(|| missing(xml, tag, "name"))?;
        let color = color.ok_or_else(|| missing(xml, tag, "displaycolor"))?;
        materials.push(Material { name: reader.text(xml, &name)?, color: color_in(xml, &color)? });
        Ok(())
    })?;
    Ok(GroupKind::Materials(materials))
}

/// Reads `colorgroup`.
pub(super) fn colors(reader: &mut ModelReader, xml: &mut Xml<'_>, tag: &Tag<'_>) -> Result<GroupKind, ReadError> {
    let [] = values(reader, xml, tag, [])?;
    let mut colors = Vec::new();
    entries(reader, xml, tag, (Namespace::Material, b"color"), |reader, xml, tag| {
        let [color] = values(reader, xml, tag, [b"color"])?;
        colors.push(color_in(xml, &color.ok_or_else(|| missing(xml, tag, "color"))?)?);
        Ok(())
    })?;
    Ok(GroupKind::Colors(colors))
}

/// Reads `texture2d`.
pub(super) fn texture(
    reader: &mut ModelReader,
    xml: &mut Xml<'_>,
    tag: &Tag<'_>,
    id: u32,
) -> Result<TextureResource, ReadError> {
    let [path, media_type, wrap_u, wrap_v, filter] =
        values(reader, xml, tag, [b"path", b"contenttype", b"tilestyleu", b"tilestylev", b"filter"])?;
    let reference = reader.text(xml, &path.ok_or_else(|| missing(xml, tag, "path"))?)?;
    let path = resolve("", &reference).filter(|_| reference.starts_with('/'));
    let path = path.ok_or_else(|| unexpected_value(xml, "the absolute path of a part", reference.as_bytes()))?;
    let media_type = match media_type.ok_or_else(|| missing(xml, tag, "contenttype"))?.as_slice() {
        b"image/png" => "image/png",
        b"image/jpeg" => "image/jpeg",
        value => return Err(unexpected_value(xml, "image/png or image/jpeg", value)),
    };
    let nearest = match filter.as_deref() {
        None | Some(b"auto" | b"linear") => false,
        Some(b"nearest") => true,
        Some(value) => return Err(unexpected_value(xml, "a filter (auto, linear, nearest)", value)),
    };
    let (wrap_u, wrap_v) = (wrap(xml, wrap_u.as_deref())?, wrap(xml, wrap_v.as_deref())?);
    Ok(TextureResource { id, path, media_type, wrap_u, wrap_v, nearest })
}

fn wrap(xml: &Xml<'_>, value: Option<&[u8]>) -> Result<Wrap, ReadError> {
    Ok(match value {
        None | Some(b"wrap") => Wrap::Repeat,
        Some(b"mirror") => Wrap::Mirror,
        Some(b"clamp") => Wrap::Clamp,
        Some(b"none") => Wrap::None,
        Some(value) => return Err(unexpected_value(xml, "a tile style (wrap, mirror, clamp, none)", value)),
    })
}

/// Reads `texture2dgroup`.
pub(super) fn texture_coordinates(
    reader: &mut ModelReader,
    xml: &mut Xml<'_>,
    tag: &Tag<'_>,
) -> Result<GroupKind, ReadError> {
    let [texture] = values(reader, xml, tag, [b"texid"])?;
    let texture = parse_index(xml, &texture.ok_or_else(|| missing(xml, tag, "texid"))?)?;
    let mut places = Vec::new();
    entries(reader, xml, tag, (Namespace::Material, b"tex2coord"), |reader, xml, tag| {
        let [u, v] = values(reader, xml, tag, [b"u", b"v"])?;
        let coordinate = |value: Option<Vec<u8>>| {
            let value = value.ok_or_else(|| missing(xml, tag, "u or v"))?;
            number(&value).ok_or_else(|| unexpected_value(xml, "a texture coordinate", &value))
        };
        places.push([coordinate(u)?, coordinate(v)?]);
        Ok(())
    })?;
    Ok(GroupKind::TextureCoordinates { texture, places })
}

/// A list of at most [`MAX_COMBINED`] whole numbers.
fn indices(xml: &Xml<'_>, value: &[u8]) -> Result<Vec<u32>, ReadError> {
    let indices: Vec<u32> =
        words(value).take(MAX_COMBINED + 1).map(|word| parse_index(xml, word)).collect::<Result<_, _>>()?;
    if indices.len() > MAX_COMBINED {
        let detail = format!("a resource combines more than {MAX_COMBINED} others; export the model again");
        return Err(xml.error(ReadErrorKind::TooLarge, detail));
    }
    Ok(indices)
}

/// Reads `compositematerials`.
pub(super) fn composites(reader: &mut ModelReader, xml: &mut Xml<'_>, tag: &Tag<'_>) -> Result<GroupKind, ReadError> {
    let [of, materials] = values(reader, xml, tag, [b"matid", b"matindices"])?;
    let of = parse_index(xml, &of.ok_or_else(|| missing(xml, tag, "matid"))?)?;
    let materials = indices(xml, &materials.ok_or_else(|| missing(xml, tag, "matindices"))?)?;
    let mut shares = Vec::new();
    entries(reader, xml, tag, (Namespace::Material, b"composite"), |reader, xml, tag| {
        let [values] = values(reader, xml, tag, [b"values"])?;
        let values = values.ok_or_else(|| missing(xml, tag, "values"))?;
        reader.budget.entries(materials.len(), xml)?;
        let end = shares.len() + materials.len();
        for word in words(&values).take(materials.len()) {
            let share = number(word).filter(|share| *share >= 0.0);
            shares.push(share.ok_or_else(|| unexpected_value(xml, "a share of a material, 0 or more", word))?);
        }
        shares.resize(end, 0.0);
        Ok(())
    })?;
    Ok(GroupKind::Composites { of, materials, shares })
}

/// Reads `multiproperties`.
pub(super) fn multiproperties(
    reader: &mut ModelReader,
    xml: &mut Xml<'_>,
    tag: &Tag<'_>,
) -> Result<GroupKind, ReadError> {
    let [of, methods] = values(reader, xml, tag, [b"pids", b"blendmethods"])?;
    let of = indices(xml, &of.ok_or_else(|| missing(xml, tag, "pids"))?)?;
    let methods: Vec<&[u8]> =
        methods.as_deref().map_or_else(Vec::new, |methods| words(methods).take(MAX_COMBINED + 1).collect());
    if let Some(method) = methods.iter().find(|&&method| method != b"mix" && method != b"multiply") {
        return Err(unexpected_value(xml, "mix or multiply", method));
    }
    if methods.len() >= of.len() {
        let detail = format!(
            "a <multiproperties> has {} groups and {} blend methods, but needs fewer methods than groups; export the model again",
            of.len(),
            methods.len()
        );
        return Err(xml.malformed(detail));
    }
    let mut rows = Vec::new();
    entries(reader, xml, tag, (Namespace::Material, b"multi"), |reader, xml, tag| {
        let [entries] = values(reader, xml, tag, [b"pindices"])?;
        let entries = entries.ok_or_else(|| missing(xml, tag, "pindices"))?;
        reader.budget.entries(of.len(), xml)?;
        let end = rows.len() + of.len();
        for word in words(&entries).take(of.len()) {
            rows.push(parse_index(xml, word)?);
        }
        rows.resize(end, 0);
        Ok(())
    })?;
    Ok(GroupKind::Layers { of, entries: rows })
}
