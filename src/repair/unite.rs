//! Uniting objects that intersect in their placed positions, and cutting an object where one of another material overlaps it.

use glam::DAffine3;

use super::attribute_transfer::{Painted, SoupWithSource, transfer_paint};
use super::operators::self_union::SelfUnionRounds;
use crate::arrange::{Exact, WindingRule};
use crate::context::{Cancelled, Context};
use crate::inspect::{Analysis, InstanceContact, Solid, instance_contacts, measure_analysis, solids};
use crate::math::Box3;
use crate::mesh::{Edges, NO_SOURCE, Parts, Soup, Surface, UnionFind};
use crate::scene::{Instance, Item, Object, PaintedMesh, Palette, Scene, SceneError, Shape};

/// Most names of members that the name of a union lists.
const MAX_NAMES: usize = 4;

/// A scene in which some objects are unions of the file's objects.
#[derive(Clone)]
pub(super) struct UnitedScene {
    /// The scene before any repair.
    pub scene: Scene,
    /// For each object of the scene, the indices of its members in the file, one for each instance. An object that is no union has only
    /// itself.
    pub members: Vec<Vec<usize>>,
    /// For each object of the scene, its index before the last call of [`Self::unite`]; none for a new union.
    pub unchanged_from: Vec<Option<usize>>,
    /// For each group of the last call of [`Self::unite`], the index of its union.
    pub unions: Vec<usize>,
    /// Whether the scene differs from the file's scene.
    pub is_changed: bool,
}

impl UnitedScene {
    /// Makes a scene without unions.
    pub fn of(scene: &Scene) -> Self {
        let count = scene.objects.len();
        Self {
            scene: scene.clone(),
            members: (0..count).map(|object| vec![object]).collect(),
            unchanged_from: (0..count).map(Some).collect(),
            unions: Vec::new(),
            is_changed: false,
        }
    }

    /// Whether an object is a union.
    pub fn is_union(&self, object: usize) -> bool {
        self.members[object].len() > 1
    }

    /// Unites each group of instances into one object, which takes the position of the group's first instance in the file's order.
    ///
    /// Objects without a remaining instance are dropped. Items that lost an instance are split into one item for each other instance.
    pub fn unite(&self, instances: &[Instance], groups: &[Vec<usize>]) -> Self {
        let mut group_of = vec![None; instances.len()];
        for (number, group) in groups.iter().enumerate() {
            group.iter().for_each(|&instance| group_of[instance] = Some(number));
        }
        let mut scene = self.scene.clone();
        let (mut members, mut unchanged_from) = (self.members.clone(), Vec::new());
        unchanged_from.extend((0..scene.objects.len()).map(Some));
        let first_union = scene.objects.len();
        for group in groups {
            let of_group = || group.iter().map(|&instance| &instances[instance]);
            let name = union_name(of_group().map(|it| &self.scene.objects[it.object as usize]));
            scene.objects.push(Object::of_mesh(name, self.scene.placed_instances(of_group())));
            members.push(of_group().flat_map(|it| self.members[it.object as usize].iter().copied()).collect());
            unchanged_from.push(None);
        }
        scene.items = self.items_without(instances, &group_of, groups, first_union);
        let keep = objects_in_use(&self.scene, &scene);
        // A union takes the position of its first member in the order of objects.
        let first_member = |group: &Vec<usize>| group.first().map_or(0, |&first| instances[first].object as usize);
        let place = |object: usize| match object.checked_sub(first_union) {
            None => (object, 0),
            Some(group) => (first_member(&groups[group]), group + 1),
        };
        let mut order: Vec<usize> = (0..keep.len()).filter(|&object| keep[object]).collect();
        order.sort_by_key(|&object| place(object));
        let members = order.iter().map(|&object| std::mem::take(&mut members[object])).collect();
        let unchanged_from = order.iter().map(|&object| unchanged_from[object]).collect();
        select_objects(&mut scene, &order);
        let place_of = |object: usize| order.iter().position(|&it| it == object).unwrap_or(0);
        let unions = (0..groups.len()).map(|group| place_of(first_union + group)).collect();
        Self { scene, members, unchanged_from, unions, is_changed: true }
    }

    /// The items, with each union at the position of its first member.
    fn items_without(
        &self,
        instances: &[Instance],
        group_of: &[Option<usize>],
        groups: &[Vec<usize>],
        first_union: usize,
    ) -> Vec<Item> {
        let index = |object: usize| u32::try_from(object).unwrap_or(u32::MAX);
        let mut placed = vec![false; groups.len()];
        let mut items = Vec::new();
        for (number, item) in (0u32..).zip(&self.scene.items) {
            let own: Vec<usize> = (0..instances.len()).filter(|&i| instances[i].item == number).collect();
            if own.iter().all(|&i| group_of[i].is_none()) {
                items.push(item.clone());
                continue;
            }
            for i in own {
                match group_of[i] {
                    None => {
                        let Instance { object, transform, .. } = instances[i];
                        items.push(Item { object, transform, ..item.clone() });
                    }
                    Some(group) if !placed[group] => {
                        placed[group] = true;
                        let alone = groups[group].iter().all(|&other| instances[other].item == number);
                        let base = if alone { item.clone() } else { Item::of(0) };
                        let object = index(first_union + group);
                        items.push(Item { object, transform: DAffine3::IDENTITY, ..base });
                    }
                    Some(_) => {}
                }
            }
        }
        items
    }
}

/// The contacts between the printed instances of a scene, as indices into `instances`.
///
/// # Errors
/// [`Cancelled`] if the job was canceled or the deadline passed.
pub(super) fn contacts_of(
    instances: &[Instance],
    placed: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Vec<InstanceContact>, Cancelled> {
    instance_contacts(placed, instance_of(instances), context)
}

/// A function that maps a face of the placed mesh to its instance.
pub(super) fn instance_of(instances: &[Instance]) -> impl Fn(u32) -> u32 + use<> {
    let printed: Vec<usize> = (0..instances.len()).filter(|&i| instances[i].is_printed).collect();
    let firsts: Vec<usize> = printed.iter().map(|&i| instances[i].first_face).collect();
    #[expect(clippy::cast_possible_truncation, reason = "instances are no more than faces, which are counted in u32")]
    move |face| printed[firsts.partition_point(|&first| first <= face as usize) - 1] as u32
}

/// The groups of two or more instances that contacts connect, each in the order of the instances.
pub(super) fn connected(count: usize, contacts: &[InstanceContact]) -> Vec<Vec<usize>> {
    let mut sets = UnionFind::new(count);
    contacts.iter().for_each(|contact| sets.unite(contact.instances[0], contact.instances[1]));
    let mut groups: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (instance, set) in sets.into_roots().into_iter().enumerate() {
        groups[set as usize].push(instance);
    }
    groups.retain(|group| group.len() > 1);
    groups.sort_unstable();
    groups
}

/// The instances of a scene, without a limit: reading the file already limited their number.
///
/// # Errors
/// [`SceneError`] if the scene is not valid.
pub(super) fn instances_of(scene: &Scene) -> Result<Vec<Instance>, SceneError> {
    scene.instances(u64::MAX)
}

/// The name of a union: the different names of its members.
fn union_name<'a>(members: impl Iterator<Item = &'a Object>) -> Option<String> {
    let mut names: Vec<&str> = Vec::new();
    for name in members.filter_map(|object| object.name.as_deref()) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let more = names.len().saturating_sub(MAX_NAMES);
    let mut listed = names[..names.len() - more].join(" + ");
    if more > 0 {
        listed.push_str(&format!(" + {more} more"));
    }
    (!names.is_empty()).then_some(listed)
}

/// For each object of `after`, whether it is kept: objects that are placed or were not placed before either, and their components.
fn objects_in_use(before: &Scene, after: &Scene) -> Vec<bool> {
    let (was, is) = (before.places(), after.places());
    let mut keep: Vec<bool> =
        is.iter().enumerate().map(|(object, &count)| count > 0 || was.get(object) == Some(&0)).collect();
    for object in (0..keep.len()).rev().filter(|&object| object < was.len()) {
        if let (true, Shape::Components(parts)) = (keep[object], &after.objects[object].shape) {
            for part in parts {
                if let Some(keep) = keep.get_mut(part.object as usize) {
                    *keep = true;
                }
            }
        }
    }
    keep
}

/// Keeps the objects with these indices, in this order, and renumbers them. Components must come before the objects that use them.
fn select_objects(scene: &mut Scene, order: &[usize]) {
    let mut numbers = vec![u32::MAX; scene.objects.len()];
    for (number, &object) in (0u32..).zip(order) {
        numbers[object] = number;
    }
    let renumbered = |object: u32| numbers.get(object as usize).copied().unwrap_or(u32::MAX);
    let mut objects: Vec<Option<Object>> = std::mem::take(&mut scene.objects).into_iter().map(Some).collect();
    scene.objects = order.iter().filter_map(|&object| objects[object].take()).collect();
    for object in &mut scene.objects {
        if let Shape::Components(parts) = &mut object.shape {
            parts.iter_mut().for_each(|part| part.object = renumbered(part.object));
        }
    }
    scene.items.iter_mut().for_each(|item| item.object = renumbered(item.object));
}

/// The object's name for messages, or its number from 1 if it has no name.
pub(super) fn name_of(object: &Object, number: usize) -> String {
    object.name.as_ref().map_or_else(|| format!("object {}", number + 1), |name| format!("object '{name}'"))
}

/// A body without the space that other bodies take.
pub(super) struct CutBody {
    /// The cut body.
    pub mesh: PaintedMesh,
    /// The removed volume in cubic units.
    pub removed: f64,
}

/// Subtracts other bodies from a body, all in their placed positions. Bodies must be closed.
///
/// The later body keeps the shared space, as in slicers: since version 2.4, PrusaSlicer and its derivatives give overlaps to the volume
/// that is lower in the list.
///
/// None if nothing is left, or if the rest is not printable.
///
/// # Errors
/// [`Cancelled`] if the job was canceled or the deadline passed.
pub(super) fn cut_body(
    body: &PaintedMesh,
    others: &[Soup],
    palettes: &mut [Palette],
    context: &Context<'_>,
) -> Result<Option<CutBody>, Cancelled> {
    let own = Surface::from_soup(&body.soup).0;
    let bounds = own.bounds();
    let mut whole = body.soup.clone();
    let first_other = whole.faces.len();
    for other in others {
        append_flipped(&near_parts(other, &bounds), &mut whole);
    }
    // The flipped bodies subtract from the winding number, so only space in no other body stays inside.
    let difference = SelfUnionRounds {
        winding_rule: WindingRule::Positive,
        max_deviation: f64::INFINITY,
        sheets: None,
        always: true,
    };
    let surface = difference.boundary(&Surface::from_soup(&whole).0, &Exact, context)?;
    let Some(surface) = surface.filter(|surface| !surface.faces.is_empty()) else { return Ok(None) };
    let soup = surface.to_soup();
    let measures = measure_analysis(&Analysis::new((&soup).into(), context)?, context)?;
    if !measures.printable() {
        return Ok(None);
    }
    let source: Vec<u32> =
        surface.source.iter().map(|&face| if (face as usize) < first_other { face } else { NO_SOURCE }).collect();
    let painted = Painted { surface: &own, paint: &body.paint };
    let paint = transfer_paint(painted, SoupWithSource { soup: &soup, source: &source }, palettes, context)?;
    let volume: f64 = parts_of(&own).1.iter().map(|solid| solid.volume).sum();
    let removed = volume - measures.volume.value;
    Ok(Some(CutBody { mesh: PaintedMesh { soup, paint }, removed }))
}

/// The parts of a body whose bounding boxes overlap a box.
fn near_parts(body: &Soup, bounds: &Box3) -> Soup {
    let surface = Surface::from_soup(body).0;
    let (parts, solids) = parts_of(&surface);
    let is_near: Vec<bool> = solids.iter().map(|solid| solid.bounds.meets(bounds)).collect();
    let near = |part: u32| part != Parts::NONE && is_near[part as usize];
    let faces = surface.faces.iter().zip(&parts.of_face).filter(|(_, part)| near(**part)).map(|(face, _)| *face);
    Soup { faces: faces.collect(), positions: surface.positions.clone() }
}

/// The connected parts of a surface, with their measures.
fn parts_of(surface: &Surface) -> (Parts, Vec<Solid>) {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    (parts, solids)
}

/// Appends a body with flipped faces to a mesh.
fn append_flipped(body: &Soup, whole: &mut Soup) {
    #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
    let first = whole.positions.len() as u32;
    whole.positions.extend(&body.positions);
    whole.faces.extend(body.faces.iter().map(|&[a, b, c]| [a + first, c + first, b + first]));
}
