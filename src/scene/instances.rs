//! Instances of objects: their number and placement, all of them as one mesh, and their materials.

use glam::DAffine3;

use super::{Item, Object, PAINTLESS, Paint, PaintedMesh, Palette, Scene, SceneError, Shape};

impl Scene {
    /// Maximum nesting depth of components.
    pub const DEPTH: usize = 32;

    /// Creates a scene with one mesh.
    #[must_use]
    pub fn of_mesh(mesh: PaintedMesh) -> Self {
        Self { objects: vec![Object::of_mesh(None, mesh)], items: vec![Item::of(0)], ..Self::default() }
    }

    /// A copy of the scene without objects and items.
    #[must_use]
    pub fn without_objects(&self) -> Self {
        let (palettes, textures, notes) = (self.palettes.clone(), self.textures.clone(), self.notes.clone());
        Self { unit: self.unit, up: self.up, palettes, textures, notes, ..Self::default() }
    }

    /// Multiplies all lengths by `factor`.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for object in &mut self.objects {
            match &mut object.shape {
                Shape::Mesh(mesh) => mesh.soup.positions.iter_mut().for_each(|p| *p *= factor),
                Shape::Components(parts) => parts.iter_mut().for_each(|part| part.transform.translation *= factor),
            }
        }
        self.items.iter_mut().for_each(|item| item.transform.translation *= factor);
        self
    }

    /// Number of instances of each object.
    #[must_use]
    pub fn places(&self) -> Vec<u64> {
        let mut counts = vec![0_u64; self.objects.len()];
        for item in &self.items {
            if let Some(count) = counts.get_mut(item.object as usize) {
                *count += 1;
            }
        }
        // Components refer to preceding objects only.
        for number in (0..self.objects.len()).rev() {
            if let Shape::Components(parts) = &self.objects[number].shape {
                for part in parts.iter().filter(|part| (part.object as usize) < number) {
                    counts[part.object as usize] = counts[part.object as usize].saturating_add(counts[number]);
                }
            }
        }
        counts
    }

    /// Sums a quantity over all instances: `of` gives the quantity of a mesh, and `own` the quantity of each object
    /// of components.
    fn count(&self, of: impl Fn(&PaintedMesh) -> usize, own: u64) -> u64 {
        let mut of_object: Vec<u64> = Vec::with_capacity(self.objects.len());
        let known = |counts: &[u64], object: u32| counts.get(object as usize).copied().unwrap_or(0);
        for object in &self.objects {
            let count = match &object.shape {
                Shape::Mesh(mesh) => of(mesh) as u64,
                Shape::Components(parts) => {
                    parts.iter().fold(own, |sum: u64, part| sum.saturating_add(known(&of_object, part.object)))
                }
            };
            of_object.push(count);
        }
        self.items.iter().fold(0, |sum, item| sum.saturating_add(known(&of_object, item.object)))
    }

    /// Number of faces of all instances.
    #[must_use]
    pub fn placed_faces(&self) -> u64 {
        self.count(|mesh| mesh.soup.faces.len(), 0)
    }

    /// Combines all printed instances in one mesh, in the order of [`Scene::instances`]. Flips the faces of instances
    /// with a mirroring transform, so that they still face outward.
    ///
    /// # Errors
    /// [`SceneError`] if there would be more than `max_faces` faces, or too many vertices for 32-bit indices. Checked
    /// before any copy.
    pub fn placed(&self, max_faces: u64) -> Result<PaintedMesh, SceneError> {
        let instances = self.instances(max_faces)?;
        Ok(self.placed_instances(instances.iter().filter(|instance| instance.is_printed)))
    }

    /// Combines some instances in one mesh.
    #[must_use]
    pub fn placed_instances<'i>(&self, instances: impl IntoIterator<Item = &'i Instance>) -> PaintedMesh {
        let mut combined = PaintedMesh::default();
        instances.into_iter().for_each(|instance| self.place(instance, &mut combined));
        if combined.paint.iter().all(|&paint| paint == PAINTLESS) {
            combined.paint.clear();
        }
        combined
    }

    /// Lists all instances of meshes, in the order of the items and of the components within them.
    ///
    /// # Errors
    /// [`SceneError`] if the instances have more than `max_faces` faces, or too many vertices for 32-bit indices.
    pub fn instances(&self, max_faces: u64) -> Result<Vec<Instance>, SceneError> {
        // An object without faces counts as one face, so that the count bounds the time.
        if self.count(|mesh| mesh.soup.faces.len().max(1), 1) > max_faces {
            return Err(SceneError::TooManyFaces(max_faces));
        }
        if self.count(|mesh| mesh.soup.positions.len(), 0) > u64::from(u32::MAX) {
            return Err(SceneError::TooManyVertices);
        }
        let mut instances = Vec::new();
        for (item, at) in (0u32..).zip(&self.items) {
            let (object, transform) = (at.object, at.transform);
            let instance = Instance { object, item, transform, is_printed: true, first_face: 0 };
            self.add_instances(instance, Self::DEPTH, &mut instances)?;
        }
        let is_body = |instance: &Instance| self.objects[instance.object as usize].kind.is_printed();
        let has_bodies = instances.iter().any(|i| is_body(i) && self.objects[i.object as usize].has_faces());
        let mut first_face = 0;
        for instance in &mut instances {
            instance.is_printed = !has_bodies || is_body(instance);
            instance.first_face = first_face;
            if instance.is_printed {
                first_face += self.objects[instance.object as usize].mesh().map_or(0, |mesh| mesh.soup.faces.len());
            }
        }
        Ok(instances)
    }

    fn add_instances(&self, instance: Instance, depth: usize, instances: &mut Vec<Instance>) -> Result<(), SceneError> {
        match self.objects.get(instance.object as usize).map(|object| &object.shape) {
            None => {}
            Some(Shape::Mesh(_)) => instances.push(instance),
            Some(Shape::Components(parts)) => {
                let depth = depth.checked_sub(1).ok_or(SceneError::TooDeep)?;
                for part in parts {
                    let transform = instance.transform * part.transform;
                    self.add_instances(Instance { object: part.object, transform, ..instance }, depth, instances)?;
                }
            }
        }
        Ok(())
    }

    fn place(&self, instance: &Instance, combined: &mut PaintedMesh) {
        let Some(mesh) = self.objects.get(instance.object as usize).and_then(|object| object.mesh()) else { return };
        #[expect(clippy::cast_possible_truncation, reason = "the vertices were counted")]
        let first = combined.soup.positions.len() as u32;
        let transform = instance.transform;
        let unmoved = transform == DAffine3::IDENTITY;
        let moved = |&p: &glam::DVec3| if unmoved { p } else { transform.transform_point3(p) };
        combined.soup.positions.extend(mesh.soup.positions.iter().map(moved));
        let flipped = transform.matrix3.determinant() < 0.0;
        let flip = |[a, b, c]: [u32; 3]| if flipped { [a, c, b] } else { [a, b, c] };
        combined.soup.faces.extend(mesh.soup.faces.iter().map(|face| flip(face.map(|v| v + first))));
        match mesh.paint.is_empty() {
            true => combined.paint.resize(combined.soup.faces.len(), PAINTLESS),
            false => {
                let paint = |paint: &Paint| Paint { at: flip(paint.at), ..*paint };
                combined.paint.extend(mesh.paint.iter().map(paint));
            }
        }
    }
}

/// An object with a mesh at one of its placements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::objects`]; the object has a mesh.
    pub object: u32,
    /// Index into [`Scene::items`] of the item that contains the instance.
    pub item: u32,
    /// Transform from the object's coordinates to the coordinates of the scene.
    pub transform: DAffine3,
    /// Whether the instance is a printed solid. If the scene has none, every instance counts as printed.
    pub is_printed: bool,
    /// Index of the instance's first face in the mesh of [`Scene::placed`].
    pub first_face: usize,
}

/// Material of an object, derived from its faces. A surface with several colours or a texture counts as one material,
/// since its colours decorate one body rather than form several bodies.
#[derive(Debug, Clone, PartialEq, Eq)]
enum ObjectMaterial {
    Unnamed,
    One(u32, u32),
    Several,
}

impl Scene {
    /// Material number of each instance, if the printed instances have more than one material. Such instances are the
    /// volumes of a multi-material print, as slicers interpret the parts of a 3MF file. `None` if all have the same
    /// material.
    ///
    /// Materials are distinguished by palette entry, and numbered from 0 in the order of the instances.
    #[must_use]
    pub fn materials_of(&self, instances: &[Instance]) -> Option<Vec<u32>> {
        let mut of_object: Vec<Option<u32>> = vec![None; self.objects.len()];
        let mut known: Vec<ObjectMaterial> = Vec::new();
        let mut materials = Vec::with_capacity(instances.len());
        for instance in instances {
            let object = instance.object as usize;
            let number = match of_object[object] {
                Some(number) => number,
                None => {
                    let material = self.material_of_object(object);
                    let at = known.iter().position(|other| *other == material);
                    let number = at.unwrap_or_else(|| {
                        known.push(material);
                        known.len() - 1
                    });
                    u32::try_from(number).unwrap_or(u32::MAX)
                }
            };
            of_object[object] = Some(number);
            materials.push(number);
        }
        let mut printed =
            instances.iter().zip(&materials).filter(|(instance, _)| instance.is_printed).map(|(_, &number)| number);
        let first = printed.next()?;
        printed.any(|number| number != first).then_some(materials)
    }

    fn material_of_object(&self, object: usize) -> ObjectMaterial {
        let Some(mesh) = self.objects[object].mesh() else { return ObjectMaterial::Unnamed };
        let (mut entry, mut is_bare) = (None, mesh.paint.is_empty());
        for paint in &mesh.paint {
            is_bare |= *paint == PAINTLESS;
            match self.palettes.get(paint.palette as usize) {
                Some(Palette::Textured { .. }) => return ObjectMaterial::Several,
                Some(Palette::Colors(_) | Palette::Materials(_)) => {
                    for at in paint.at {
                        if *entry.get_or_insert((paint.palette, at)) != (paint.palette, at) {
                            return ObjectMaterial::Several;
                        }
                    }
                }
                None => {}
            }
        }
        match entry {
            Some((palette, at)) if !is_bare => ObjectMaterial::One(palette, at),
            _ => ObjectMaterial::Unnamed,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::mesh::Soup;
    use crate::scene::Component;

    fn triangle(paint: Vec<Paint>) -> PaintedMesh {
        let soup = Soup { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], faces: vec![[0, 1, 2]] };
        PaintedMesh { soup, paint }
    }

    fn object(shape: Shape) -> Object {
        Object { shape, ..Object::of_mesh(None, PaintedMesh::default()) }
    }

    #[test]
    fn every_placement_of_an_object_is_an_instance() {
        let up = DAffine3::from_translation(DVec3::Z);
        let pair = [DAffine3::IDENTITY, up].map(|transform| Component { object: 0, transform });
        let scene = Scene {
            objects: vec![object(Shape::Mesh(triangle(Vec::new()))), object(Shape::Components(pair.to_vec()))],
            items: vec![Item { transform: up, ..Item::of(1) }, Item::of(0)],
            ..Scene::default()
        };
        assert_eq!(scene.placed_faces(), 3);
        let placed = scene.placed(4).expect("few faces");
        let heights: Vec<f64> = placed.soup.faces.iter().map(|f| placed.soup.positions[f[0] as usize].z).collect();
        assert_eq!(heights, [1.0, 2.0, 0.0]);
        assert_eq!(scene.placed(2), Err(SceneError::TooManyFaces(2)));
    }

    #[test]
    fn scaling_a_scene_scales_its_placed_mesh() {
        let turn = DAffine3::from_rotation_z(0.5) * DAffine3::from_translation(DVec3::new(1.0, 2.0, 3.0));
        let scene = Scene {
            objects: vec![
                object(Shape::Mesh(triangle(Vec::new()))),
                object(Shape::Components(vec![Component { object: 0, transform: turn }])),
            ],
            items: vec![Item { transform: turn, ..Item::of(1) }],
            ..Scene::default()
        };
        let corners = |scene: &Scene| scene.placed(4).expect("one face").soup.corners(0);
        let expected = corners(&scene).map(|p| p * 25.4);
        for (a, b) in corners(&scene.scaled(25.4)).into_iter().zip(expected) {
            assert!(a.abs_diff_eq(b, 1e-12), "{a} for {b}");
        }
    }

    #[test]
    fn exponential_and_too_deep_nesting_is_rejected() {
        let doubled = |object| Shape::Components(vec![Component { object, transform: DAffine3::IDENTITY }; 2]);
        let mut scene = Scene::of_mesh(PaintedMesh::default());
        scene.objects.extend((0..63).map(|below| object(doubled(below))));
        scene.items = vec![Item::of(63)];
        assert_eq!(scene.placed(1_000_000), Err(SceneError::TooManyFaces(1_000_000)));
        let single = |object| Shape::Components(vec![Component { object, transform: DAffine3::IDENTITY }]);
        scene.objects.splice(1.., (0..63).map(|below| object(single(below))));
        assert_eq!(scene.placed(1_000_000), Err(SceneError::TooDeep));
    }

    #[test]
    fn a_mirrored_item_keeps_facing_outward_and_flips_its_paint() {
        let paint = Paint { palette: 0, at: [7, 8, 9] };
        let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        let mut scene = Scene::of_mesh(triangle(vec![paint]));
        scene.items[0].transform = mirror;
        let placed = scene.placed(1).expect("one face");
        let [a, b, c] = placed.soup.corners(0);
        assert!((b - a).cross(c - a).z > 0.0);
        assert_eq!(placed.paint, [Paint { palette: 0, at: [7, 9, 8] }]);
    }
}
