use super::{Instance, PAINTLESS, Palette, Scene};

/// What an instance is made of: the materials of its faces. Surfaces with several colours or a picture all count as one material, since
/// their colours are drawn on a body rather than being bodies.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Made {
    OfNothingNamed,
    Of(u32, u32),
    Colored,
}

impl Scene {
    /// Of each instance the number of its material, where the printed ones are made of more than one: they are then the volumes of one
    /// print of several materials, as slicers take the parts of a 3MF file. None where all are of one material.
    ///
    /// Materials are told apart by their entries in the scene's palettes, and numbered from 0 in the order of the instances.
    #[must_use]
    pub fn materials_of(&self, instances: &[Instance]) -> Option<Vec<u32>> {
        let mut of_object: Vec<Option<u32>> = vec![None; self.objects.len()];
        let mut known: Vec<Made> = Vec::new();
        let mut materials = Vec::with_capacity(instances.len());
        for instance in instances {
            let object = instance.object as usize;
            let number = match of_object[object] {
                Some(number) => number,
                None => {
                    let made = self.made_of(object);
                    let at = known.iter().position(|other| *other == made);
                    let number = at.unwrap_or_else(|| {
                        known.push(made);
                        known.len() - 1
                    });
                    u32::try_from(number).unwrap_or(u32::MAX)
                }
            };
            of_object[object] = Some(number);
            materials.push(number);
        }
        let mut printed = instances.iter().zip(&materials).filter(|(it, _)| it.is_printed).map(|(_, &number)| number);
        let first = printed.next()?;
        printed.any(|number| number != first).then_some(materials)
    }

    fn made_of(&self, object: usize) -> Made {
        let Some(mesh) = self.objects[object].mesh() else { return Made::OfNothingNamed };
        let (mut entry, mut is_bare) = (None, mesh.paint.is_empty());
        for paint in &mesh.paint {
            is_bare |= *paint == PAINTLESS;
            match self.palettes.get(paint.palette as usize) {
                Some(Palette::Textured { .. }) => return Made::Colored,
                Some(Palette::Colors(_) | Palette::Materials(_)) => {
                    for at in paint.at {
                        if *entry.get_or_insert((paint.palette, at)) != (paint.palette, at) {
                            return Made::Colored;
                        }
                    }
                }
                None => {}
            }
        }
        match entry {
            Some((palette, at)) if !is_bare => Made::Of(palette, at),
            _ => Made::OfNothingNamed,
        }
    }
}
