//! Objects in their places: every instance of a scene, all of them as one mesh, and the materials that they are made of.

use glam::DAffine3;

use super::{Item, Object, PAINTLESS, Paint, PaintedMesh, Palette, Scene, SceneError, Shape};

impl Scene {
    /// How deep objects may be made of objects that are made of objects.
    pub const DEPTH: usize = 32;

    /// A scene of one mesh.
    #[must_use]
    pub fn of_mesh(mesh: PaintedMesh) -> Self {
        Self { objects: vec![Object::of_mesh(None, mesh)], items: vec![Item::of(0)], ..Self::default() }
    }

    /// All that it says but its objects and where they stand.
    #[must_use]
    pub fn without_objects(&self) -> Self {
        let (palettes, textures, notes) = (self.palettes.clone(), self.textures.clone(), self.notes.clone());
        Self { unit: self.unit, up: self.up, palettes, textures, notes, ..Self::default() }
    }

    /// The same with all lengths multiplied by `factor`.
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

    /// In how many places each object stands.
    #[must_use]
    pub fn places(&self) -> Vec<u64> {
        let mut places = vec![0_u64; self.objects.len()];
        for item in &self.items {
            if let Some(count) = places.get_mut(item.object as usize) {
                *count += 1;
            }
        }
        // Objects are made of those before them.
        for number in (0..self.objects.len()).rev() {
            if let Shape::Components(parts) = &self.objects[number].shape {
                for part in parts.iter().filter(|part| (part.object as usize) < number) {
                    places[part.object as usize] = places[part.object as usize].saturating_add(places[number]);
                }
            }
        }
        places
    }

    /// What all items have of something in their places, where a mesh has `of` of it, and an object of others `own` of its own.
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

    /// The faces of all items in their places.
    #[must_use]
    pub fn placed_faces(&self) -> u64 {
        self.count(|mesh| mesh.soup.faces.len(), 0)
    }

    /// All items in their places as one mesh, the faces of an instance after those of the instance before (see [`Scene::instances`]);
    /// instances that are not printed are left out. An instance whose transform mirrors has its faces turned, so that they look outward
    /// as before.
    ///
    /// # Errors
    /// [`SceneError`] where there would be more than `max_faces` faces, or more vertices than can be numbered; before anything is copied.
    pub fn placed(&self, max_faces: u64) -> Result<PaintedMesh, SceneError> {
        let instances = self.instances(max_faces)?;
        Ok(self.placed_instances(instances.iter().filter(|instance| instance.is_printed)))
    }

    /// Some instances in their places as one mesh.
    #[must_use]
    pub fn placed_instances<'i>(&self, instances: impl IntoIterator<Item = &'i Instance>) -> PaintedMesh {
        let mut whole = PaintedMesh::default();
        instances.into_iter().for_each(|instance| self.place(instance, &mut whole));
        if whole.paint.iter().all(|&paint| paint == PAINTLESS) {
            whole.paint.clear();
        }
        whole
    }

    /// Every mesh in each of its places, in the order of the items and of the components within them.
    ///
    /// # Errors
    /// [`SceneError`] where the instances have more than `max_faces` faces, or more vertices than can be numbered.
    pub fn instances(&self, max_faces: u64) -> Result<Vec<Instance>, SceneError> {
        // Objects without a face count too, so that the time is bounded by the count.
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
        let has_bodies = instances.iter().any(|it| is_body(it) && self.objects[it.object as usize].has_faces());
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

    fn place(&self, instance: &Instance, whole: &mut PaintedMesh) {
        let Some(mesh) = self.objects.get(instance.object as usize).and_then(|object| object.mesh()) else { return };
        #[expect(clippy::cast_possible_truncation, reason = "the vertices were counted")]
        let first = whole.soup.positions.len() as u32;
        let transform = instance.transform;
        let unmoved = transform == DAffine3::IDENTITY;
        let moved = |&p: &glam::DVec3| if unmoved { p } else { transform.transform_point3(p) };
        whole.soup.positions.extend(mesh.soup.positions.iter().map(moved));
        let turned = transform.matrix3.determinant() < 0.0;
        let turn = |[a, b, c]: [u32; 3]| if turned { [a, c, b] } else { [a, b, c] };
        whole.soup.faces.extend(mesh.soup.faces.iter().map(|face| turn(face.map(|v| v + first))));
        match mesh.paint.is_empty() {
            true => whole.paint.resize(whole.soup.faces.len(), PAINTLESS),
            false => {
                let paint = |paint: &Paint| Paint { at: turn(paint.at), ..*paint };
                whole.paint.extend(mesh.paint.iter().map(paint));
            }
        }
    }
}

/// A mesh in one of its places.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Instance {
    /// Index into [`Scene::objects`] of an object of triangles.
    pub object: u32,
    /// Index into [`Scene::items`] of the item that it belongs to.
    pub item: u32,
    /// From the object's coordinates to those of the scene.
    pub transform: DAffine3,
    /// Whether it is a body to be printed; where the scene has no such body, every instance counts as one.
    pub is_printed: bool,
    /// Index of its first face in the mesh of [`Scene::placed`].
    pub first_face: usize,
}

/// The material of an object: that of its faces. Surfaces with several colours or a picture all count as one material, since
/// their colours are drawn on a body rather than being bodies.
#[derive(Debug, Clone, PartialEq, Eq)]
enum ObjectMaterial {
    Unnamed,
    One(u32, u32),
    Several,
}

impl Scene {
    /// Of each instance the number of its material, where the printed ones are made of more than one: they are then the volumes of one
    /// print of several materials, as slicers take the parts of a 3MF file. None where all are of one material.
    ///
    /// Materials are told apart by their entries in the scene's palettes, and numbered from 0 in the order of the instances.
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
        let mut printed = instances.iter().zip(&materials).filter(|(it, _)| it.is_printed).map(|(_, &number)| number);
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
    fn an_object_stands_in_each_of_its_places() {
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
    fn a_scaled_scene_is_placed_as_its_placed_mesh_is_scaled() {
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
    fn objects_of_objects_without_end_are_refused_at_once() {
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
    fn a_mirrored_item_looks_outward_still_and_its_paint_turns_with_it() {
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
