//! A part's groups of properties as palettes. What mixes groups is told by colours alone, since a palette knows no mixtures.

use std::collections::HashMap;

use super::part::{Group, GroupKind, Part, ShapeResource};
use super::warnings::Warnings;
use crate::format::errors::{ReadError, ReadErrorKind, shown};
use crate::scene::{Material, PAINTLESS, Palette};

/// What a group has become.
struct Known {
    kind: Kind,
    palette: u32,
    entries: Entries,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Materials,
    Composites,
    Colors,
    Texture,
}

/// The entries of a palette that are those of a group.
enum Entries {
    /// The first ones, as many.
    First(usize),
    These(Vec<u32>),
}

impl Entries {
    fn get(&self, entry: u32) -> Option<u32> {
        match self {
            Self::First(count) => ((entry as usize) < *count).then_some(entry),
            Self::These(entries) => entries.get(entry as usize).copied(),
        }
    }
}

/// Takes a part's groups over into palettes, and makes its paint name them. Its textures are `first_texture` and the following.
pub(super) fn take(
    part: &mut Part,
    first_texture: u32,
    palettes: &mut Vec<Palette>,
    warnings: &mut Warnings,
) -> Result<(), ReadError> {
    let known = groups(part, first_texture, palettes, warnings)?;
    let mut used = Vec::with_capacity(part.painted_by.groups.len());
    for id in &part.painted_by.groups {
        let group = known.get(id);
        used.push(group.ok_or_else(|| {
            refused(&part.name, format!("an object names the property group {id}, which is not there"))
        })?);
    }
    for object in &mut part.objects {
        let ShapeResource::Mesh { paint, .. } = &mut object.shape else { continue };
        for paint in paint.iter_mut().filter(|paint| **paint != PAINTLESS) {
            let group = used[paint.palette as usize];
            for at in &mut paint.at {
                *at = group.entries.get(*at).ok_or_else(|| {
                    let detail =
                        format!("the object {} names entry {at} of a property group that has fewer", object.id);
                    ReadError { kind: ReadErrorKind::IndexOutOfRange, ..refused(&part.name, detail) }
                })?;
            }
            if group.kind == Kind::Materials {
                paint.at = [paint.at[0]; 3];
            }
            paint.palette = group.palette;
        }
    }
    Ok(())
}

fn groups(
    part: &mut Part,
    first_texture: u32,
    palettes: &mut Vec<Palette>,
    warnings: &mut Warnings,
) -> Result<HashMap<u32, Known>, ReadError> {
    let refused = |detail| refused(&part.name, detail);
    let mut mixed =
        part.groups.iter().map(|group| mix(&part.groups, group)).collect::<Result<Vec<_>, _>>().map_err(refused)?;
    let mut known = HashMap::new();
    let mut layered = Vec::new();
    for (Group { id, kind }, mixed) in std::mem::take(&mut part.groups).into_iter().zip(&mut mixed) {
        let (kind, palette) = match kind {
            GroupKind::Materials(materials) => (Kind::Materials, Palette::Materials(materials)),
            GroupKind::Colors(colors) => (Kind::Colors, Palette::Colors(colors)),
            GroupKind::Composites { .. } => {
                warnings.tell("mixtures of materials (composite materials) became colours");
                (Kind::Composites, Palette::Colors(std::mem::take(mixed)))
            }
            GroupKind::Places { texture, places } => {
                let index = part.textures.iter().position(|it| it.id == texture);
                let index = index.ok_or_else(|| {
                    refused(format!("the texture group {id} names the texture {texture}, which is not there"))
                })?;
                let texture = first_texture + u32::try_from(index).unwrap_or(u32::MAX);
                (Kind::Texture, Palette::Textured { texture, name: None, tint: [255; 4], places })
            }
            GroupKind::Layers { of, entries } => {
                layered.push((id, of, entries));
                continue;
            }
        };
        let entries = Entries::First(palette.len());
        known.insert(id, Known { kind, palette: u32::try_from(palettes.len()).unwrap_or(u32::MAX), entries });
        palettes.push(palette);
    }
    let mut layers = Vec::with_capacity(layered.len());
    for (id, of, entries) in &layered {
        let top = top_layer(&known, of).map_err(|detail| refused(format!("the multiproperties {id}: {detail}")))?;
        let group = &known[&of[top]];
        let chosen = entries.iter().skip(top).step_by(of.len());
        let chosen = chosen.map(|&entry| {
            group.entries.get(entry).ok_or_else(|| {
                refused(format!(
                    "the multiproperties {id} name entry {entry} of the group {}, which has fewer",
                    of[top]
                ))
            })
        });
        let layer = Known {
            kind: group.kind,
            palette: group.palette,
            entries: Entries::These(chosen.collect::<Result<_, _>>()?),
        };
        warnings.tell("of properties on one another (multiproperties) only the uppermost colours or texture were kept");
        layers.push((*id, layer));
    }
    known.extend(layers);
    Ok(known)
}

/// The colours of a group of mixtures, each the mean of its materials' colours.
fn mix(groups: &[Group], group: &Group) -> Result<Vec<[u8; 4]>, String> {
    let GroupKind::Composites { of, materials, shares } = &group.kind else { return Ok(Vec::new()) };
    let base = groups.iter().find_map(|it| match &it.kind {
        GroupKind::Materials(materials) if it.id == *of => Some(materials),
        _ => None,
    });
    let base = base
        .ok_or_else(|| format!("the mixtures {} are of the group {of}, which is none of base materials", group.id))?;
    let colors = materials.iter().map(|&index| base.get(index as usize).map(|material: &Material| material.color));
    let colors: Option<Vec<_>> = colors.collect();
    let colors =
        colors.ok_or_else(|| format!("the mixtures {} name a material that the group {of} does not have", group.id))?;
    let mean = |shares: &[f64]| {
        let sum: f64 = shares.iter().sum();
        let of_channel = |channel: usize| {
            let (weighted, sum) = match sum > 0.0 {
                true => (colors.iter().zip(shares).map(|(color, share)| f64::from(color[channel]) * share).sum(), sum),
                false => (colors.iter().map(|color| f64::from(color[channel])).sum::<f64>(), colors.len() as f64),
            };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a mean of bytes; sums beyond f64 saturate"
            )]
            {
                (weighted / sum).round() as u8
            }
        };
        std::array::from_fn(of_channel)
    };
    Ok(shares.chunks_exact(colors.len().max(1)).map(mean).collect())
}

/// The last of the layers that has colours or a texture, else the first; the rules for what may be a layer are those of the materials
/// extension, chapter 5.
fn top_layer(known: &HashMap<u32, Known>, of: &[u32]) -> Result<usize, String> {
    let kinds = of.iter().map(|id| {
        known
            .get(id)
            .map(|it| it.kind)
            .ok_or_else(|| format!("{} is no group that can be a layer", shown(id.to_string().as_bytes())))
    });
    let kinds: Vec<Kind> = kinds.collect::<Result<_, _>>()?;
    let is_material = |kind: &Kind| matches!(kind, Kind::Materials | Kind::Composites);
    if kinds.iter().skip(1).any(is_material) {
        return Err("a material may only be the first layer".to_owned());
    }
    if kinds.iter().filter(|&&kind| kind == Kind::Colors).count() > 1 {
        return Err("only one layer may be a colour group".to_owned());
    }
    Ok(kinds.iter().rposition(|kind| !is_material(kind)).unwrap_or(0))
}

fn refused(part: &str, detail: String) -> ReadError {
    let detail = format!("in the part {}: {detail}; export the model again", shown(part.as_bytes()));
    ReadError::whole(ReadErrorKind::Malformed, detail)
}
