//! Objects stay objects: each is repaired by itself, in its own coordinates, and stands in its places again. Objects that intersect where
//! they stand are united first, unless the options keep them apart.

use super::account::{Account, MAX_NAMED, ObjectPlace, objects_intersect, outcome_of};
use super::attribute_transfer::{CutSoup, Painted, transfer_paint};
use super::body::{ObjectRepair, RepairedObject, Share};
use super::ended::RepairedBody;
use super::export::{Exported, export};
use super::input::{Input, RepairError, Request};
use super::judge::{inspect_measured, surface_shares};
use super::options::{Merge, Options};
use super::report::{Assumption, AssumptionKind, ObjectReport, Outcome};
use super::unite::{CutBody, UnitedScene, connected, contacts_of, cut_body, instance_of, instances_of, name_of};
use crate::analyze::subject;
use crate::context::Context;
use crate::format::{Format, ReadFile, WriteError};
use crate::inspect::{Analysis, Changes, Inspection, InstanceContact};
use crate::math::Box3;
use crate::mesh::Soup;
use crate::scene::{Instance, Object, Paint, Palette, Scene, Shape};

/// Most objects that are kept apart: each has a section of its own in the report.
const MAX_APART: usize = 200;

/// How often objects are united again because results intersect where the input did not.
const MAX_ROUNDS: usize = 4;

/// Where the percents of all objects begin and end.
const PERCENT: [f64; 2] = [5.0, 90.0];

/// Whether the objects of a file are repaired apart for a result of this format.
pub(super) fn keeps_apart(file: &mut ReadFile, format: Format, options: &Options) -> bool {
    let Some(scene) = file.scene.as_ref().filter(|_| format.has_objects() && file.mesh.format.has_objects()) else {
        return false;
    };
    let count = scene.objects.iter().filter(|object| object.has_faces()).count();
    match options.merge {
        Merge::Objects => false,
        Merge::Auto | Merge::None if count > MAX_APART => {
            let warning = format!(
                "The file has {count} objects; more than {MAX_APART} are not kept apart, so all of them became one object."
            );
            file.mesh.warnings.push(warning);
            false
        }
        Merge::Auto | Merge::None => count > 0,
    }
}

/// The repair of a file's objects.
pub(super) struct ObjectsRepair<'a> {
    pub file: &'a ReadFile,
    pub input: &'a Input<'a>,
    pub format: Format,
    /// Whether the file may come back byte for byte where no object needs anything.
    pub as_it_is: bool,
    /// What is asked for, with the surroundings of the objects' repairs.
    pub request: Request<'a>,
    /// The surroundings of what is done with all objects together, which end later.
    pub whole: &'a Context<'a>,
}

/// The result of one object.
struct ObjectResult {
    section: ObjectReport,
    /// Its triangles and paint; none where it has nothing that can be written.
    mesh: Option<(Soup, Vec<Paint>)>,
    /// Whether the file's own object can stay.
    is_untouched: bool,
}

/// A file that the results of its bodies were assembled to.
pub(super) struct Assembled {
    pub account: Account,
    /// The accounts of its objects, where they were repaired apart.
    pub sections: Vec<ObjectReport>,
    pub bytes: Vec<u8>,
    pub dialect: String,
}

impl From<RepairedBody> for Assembled {
    fn from(body: RepairedBody) -> Self {
        Self { account: body.account, sections: Vec::new(), bytes: body.bytes, dialect: body.dialect }
    }
}

/// The objects of a round, repaired and judged where they stand.
struct Round {
    united: UnitedScene,
    /// The scene with its results.
    scene: Scene,
    results: Vec<Option<ObjectResult>>,
    bytes: Vec<u8>,
    dialect: String,
    after: Inspection,
    changes: Option<Changes>,
    meetings: Meetings,
}

/// Where the instances of a scene meet.
#[derive(Default)]
struct Meetings {
    /// The instances that have points in common, with the names of their objects.
    contacts: Vec<(InstanceContact, [String; 2])>,
    /// The instances with faces inside bodies of another material.
    contained: Vec<usize>,
}

/// A scene whose bodies give way to later ones of another material.
struct Cut {
    united: UnitedScene,
    assumptions: Vec<Assumption>,
}

impl ObjectsRepair<'_> {
    /// Repairs each object of a scene that is to be printed.
    pub fn run(&self, scene: &Scene, bytes: &[u8]) -> Result<Assembled, RepairError> {
        let start = instances_of(scene).map_err(|_| WriteError::TooLarge)?;
        let mut united = UnitedScene::of(scene);
        let (mut met, mut cuts) = (Vec::new(), Vec::new());
        if self.request.options.merge == Merge::Auto {
            met = contacts_of(&start, self.input.analysis, &self.whole.for_verification())?;
            let materials = self.materials_of(scene, &start);
            met.retain(|contact| is_of_one_material(materials.as_deref(), contact));
            let groups = connected(start.len(), &met);
            if !groups.is_empty() {
                united = united.unite(&start, &groups);
            }
        }
        let mut palettes = scene.palettes.clone();
        let mut results: Vec<Option<ObjectResult>> = Vec::new();
        results.resize_with(united.scene.objects.len(), || None);
        let mut round = 0;
        loop {
            round += 1;
            self.repair_missing(&united, &mut results, &mut palettes)?;
            let judged = self.judge(united, results, &palettes, bytes)?;
            let is_last = round == MAX_ROUNDS || self.request.context.is_late();
            if self.request.options.merge != Merge::Auto || judged.after.measures.printable() || is_last {
                return Ok(self.conclude(judged, &met, cuts));
            }
            let instances = instances_of(&judged.scene).map_err(|_| WriteError::TooLarge)?;
            let materials = self.materials_of(&judged.scene, &instances);
            let groups = next_groups(&judged, &instances, materials.as_deref());
            united = if groups.is_empty() {
                let Some(cut) = self.cut_overlaps(&judged, &instances, materials.as_deref(), &mut palettes)? else {
                    return Ok(self.conclude(judged, &met, cuts));
                };
                cuts.extend(cut.assumptions);
                cut.united
            } else {
                met.extend(judged.meetings.contacts.iter().map(|(contact, _)| *contact));
                judged.united.unite(&instances, &groups)
            };
            let mut old = judged.results;
            results = united.unchanged_from.iter().map(|from| from.and_then(|from| old[from].take())).collect();
        }
    }

    /// The materials of instances where they are the volumes of one print of several materials: of 3MF files alone.
    fn materials_of(&self, scene: &Scene, instances: &[Instance]) -> Option<Vec<u32>> {
        let is_print = self.file.mesh.format == Format::ThreeMf && self.format == Format::ThreeMf;
        is_print.then(|| scene.materials_of(instances)).flatten()
    }

    /// The scene with bodies cut where a later one of another material overlaps them; none where there is nothing to cut, or it fails.
    fn cut_overlaps(
        &self,
        round: &Round,
        instances: &[Instance],
        materials: Option<&[u32]>,
        palettes: &mut [Palette],
    ) -> Result<Option<Cut>, RepairError> {
        let Some(materials) = materials else { return Ok(None) };
        let patient = &self.whole.for_verification();
        let overlaps = |a: usize, b: usize| {
            let is_met = |(contact, _): &(InstanceContact, _)| contact.instances.map(|i| i as usize) == [a, b];
            let is_within = round.meetings.contained.contains(&a) || round.meetings.contained.contains(&b);
            instances[b].is_printed
                && materials[a] != materials[b]
                && (is_within || round.meetings.contacts.iter().any(is_met))
        };
        let placed = |instance: usize| round.scene.placed_instances([&instances[instance]]);
        let (mut groups, mut bodies, mut assumptions) = (Vec::new(), Vec::new(), Vec::new());
        for a in (0..instances.len()).filter(|&a| instances[a].is_printed) {
            let later: Vec<usize> = (a + 1..instances.len()).filter(|&b| overlaps(a, b)).collect();
            if later.is_empty() {
                continue;
            }
            let others: Vec<Soup> = later.iter().map(|&b| placed(b).soup).collect();
            let Some(CutBody { mesh, removed }) = cut_body(&placed(a), &others, palettes, patient)? else { continue };
            let name = |instance: usize| self.instance_name(&round.united, &instances[instance]);
            let names: Vec<String> = later.iter().take(MAX_NAMED).map(|&b| name(b)).collect();
            let detail = format!(
                "{} overlaps {} and gives way to what comes later in the file, as in slicers.",
                name(a),
                names.join(", ")
            );
            let cut = Assumption::new(AssumptionKind::OverlapRemoved, later.len() as u64, detail);
            let is_met = |(contact, _): &&(InstanceContact, _)| contact.instances[0] as usize == a;
            let places = round.meetings.contacts.iter().filter(is_met).map(|(contact, _)| contact.at);
            assumptions.push(cut.with_amount(removed).at(places).unless("merge=objects"));
            groups.push(vec![a]);
            bodies.push(mesh);
        }
        if groups.is_empty() {
            return Ok(None);
        }
        let mut united = round.united.unite(instances, &groups);
        for (object, body) in united.unions.clone().into_iter().zip(bodies) {
            united.scene.objects[object].shape = Shape::Mesh(body);
        }
        united.scene.palettes = palettes.to_vec();
        Ok(Some(Cut { united, assumptions }))
    }

    /// The name of an instance's object as the file has it.
    fn instance_name(&self, united: &UnitedScene, instance: &Instance) -> String {
        let object = instance.object as usize;
        name_of(&united.scene.objects[object], united.members[object].first().copied().unwrap_or(object))
    }

    /// Repairs the objects that have no result yet.
    fn repair_missing(
        &self,
        united: &UnitedScene,
        results: &mut [Option<ObjectResult>],
        palettes: &mut [Palette],
    ) -> Result<(), RepairError> {
        let Request { context, options, .. } = self.request;
        let scene = &united.scene;
        let places = scene.places();
        let faces = |object: &Object| object.mesh().map_or(0, |mesh| mesh.soup.faces.len());
        let numbers = printed_objects(scene, &places);
        let all: usize = numbers.iter().map(|&number| faces(&scene.objects[number])).sum();
        let missing: Vec<usize> = numbers.into_iter().filter(|&number| results[number].is_none()).collect();
        let mut left: usize = missing.iter().map(|&number| faces(&scene.objects[number])).sum();
        let total = left;
        let repair = ObjectRepair { file: self.file, format: self.format };
        for (index, &number) in missing.iter().enumerate() {
            let object = &scene.objects[number];
            let own = faces(object);
            // What an object does not need is left to those after it.
            let share = (own as f64 / left.max(1) as f64).max(1.0 / (missing.len() - index) as f64);
            let done = |faces: usize| PERCENT[0] + (PERCENT[1] - PERCENT[0]) * faces as f64 / total.max(1) as f64;
            let (from, to) = (done(total - left), done(total - left + own));
            let name = name_of(object, number);
            let progress = Share { context, from, to, name: &name };
            let around = context.with_progress(&progress).limited_to(context.remaining().mul_f64(share));
            let share = |most: u64| ((most as f64 * own as f64 / all.max(1) as f64) as u64).max(4);
            let options = Options { max_faces: options.max_faces.map(share), ..options.clone() };
            let index = united.members[number].first().copied().unwrap_or(number);
            let place = ObjectPlace { name: object.name.clone(), index, places: places[number] };
            let RepairedObject { report, before, soup, source, welded } =
                repair.run(object, place, &Request { options: &options, context: &around, ..self.request })?;
            let is_untouched = match report.outcome {
                Outcome::AlreadyPrintable => !welded,
                outcome => outcome == Outcome::Unrepairable,
            };
            let paint = object.mesh().map_or(&[][..], |mesh| &mesh.paint);
            let patient = &context.for_verification();
            let mesh = match soup {
                None => None,
                Some(soup) => {
                    let painted = Painted { surface: &before, paint };
                    let result = CutSoup { soup: &soup, source: &source };
                    let paint = transfer_paint(painted, result, palettes, patient)?;
                    Some((soup, paint))
                }
            };
            results[number] = Some(ObjectResult { section: report, mesh, is_untouched });
            left -= own;
        }
        Ok(())
    }

    /// Writes the scene with its results, reads it back, and judges all objects where they stand.
    fn judge(
        &self,
        united: UnitedScene,
        results: Vec<Option<ObjectResult>>,
        palettes: &[Palette],
        bytes: &[u8],
    ) -> Result<Round, RepairError> {
        let (input, context) = (self.input, self.whole);
        let verification = &context.for_verification();
        let is_untouched = self.as_it_is && !united.is_changed && results.iter().flatten().all(|it| it.is_untouched);
        if is_untouched {
            let (scene, after) = (united.scene.clone(), input.before.clone());
            let meetings = self.meetings(&united, &scene, input.analysis, &after)?;
            let (bytes, dialect) = (bytes.to_vec(), input.mesh.dialect.clone());
            return Ok(Round { united, scene, results, bytes, dialect, after, changes: None, meetings });
        }
        let mut scene = united.scene.clone();
        scene.palettes = palettes.to_vec();
        for (object, repaired) in scene.objects.iter_mut().zip(&results) {
            if let (Some((soup, paint)), Shape::Mesh(mesh)) =
                (repaired.as_ref().and_then(|repaired| repaired.mesh.as_ref()), &mut object.shape)
            {
                (mesh.soup, mesh.paint) = (soup.clone(), paint.clone());
            }
        }
        let Exported { bytes, mesh, .. } = export(&scene, self.format)?;
        let analysis = Analysis::new(subject(&mesh, input.analysis.subject.unit), verification)?;
        let (after, _) = inspect_measured(&analysis, context)?;
        let meetings = self.meetings(&united, &scene, &analysis, &after)?;
        let changes = input.original.changes(&analysis, &after.measures, None, verification)?;
        let surface = surface_shares(input.original, &analysis, context)?;
        let changes = Some(Changes { surface, ..changes });
        let dialect = mesh.dialect.clone();
        Ok(Round { united, scene, results, bytes, dialect, after, changes, meetings })
    }

    /// The contacts between the instances of a scene by the names of their objects, and the instances that lie in other materials. A
    /// printable file has neither.
    fn meetings(
        &self,
        united: &UnitedScene,
        scene: &Scene,
        analysis: &Analysis<'_>,
        found: &Inspection,
    ) -> Result<Meetings, RepairError> {
        if found.measures.printable() {
            return Ok(Meetings::default());
        }
        let patient = &self.whole.for_verification();
        let instances = &instances_of(scene).map_err(|_| WriteError::TooLarge)?;
        let contacts = contacts_of(instances, analysis, patient)?;
        let name = |instance: u32| self.instance_name(united, &instances[instance as usize]);
        let contacts = contacts.into_iter().map(|contact| (contact, contact.instances.map(name))).collect();
        let of = instance_of(instances);
        let mut contained: Vec<usize> =
            analysis.faces_in_other_materials(patient)?.iter().map(|&face| of(face) as usize).collect();
        contained.dedup();
        Ok(Meetings { contacts, contained })
    }

    /// How the file as a whole ended.
    fn conclude(&self, round: Round, met: &[InstanceContact], cuts: Vec<Assumption>) -> Assembled {
        let Round { united, scene, results, bytes, dialect, after, changes, meetings } = round;
        let Meetings { contacts, contained } = meetings;
        let instances = instances_of(&scene).unwrap_or_default();
        let contained: Vec<String> =
            contained.iter().take(MAX_NAMED).map(|&it| self.instance_name(&united, &instances[it])).collect();
        let unions = (0..united.members.len()).filter(|&object| united.is_union(object));
        let unions: Vec<Assumption> = unions.map(|union| self.assumed_union(&united, union, met)).collect();
        let sections: Vec<ObjectReport> = results.into_iter().flatten().map(|result| result.section).collect();
        let mut account = Account::of_objects(&sections);
        account.outcome = outcome_of(&sections, after.measures.printable(), united.is_changed);
        account.warnings.splice(0..0, omitted(&united.scene));
        account.assumptions = [cuts, account.assumptions, unions].concat();
        account.changes = changes.or(account.changes);
        account.omitted.extend(self.input.time.omitted());
        account.omitted.sort_unstable();
        account.omitted.dedup();
        if let Some(flag) = objects_intersect(&contacts, &contained) {
            if sections.iter().all(|section| section.outcome.is_printable()) {
                let advice = match self.request.options.merge {
                    Merge::None => " Set merge=auto to unite them.",
                    Merge::Auto | Merge::Objects => "",
                };
                account.summary = format!("The file is not printable as it stands: {}.{advice}", flag.detail);
            }
            account.red_flags.push(flag);
        }
        account.after = Some(after);
        Assembled { account, sections, bytes, dialect }
    }

    /// The assumption that some objects are one solid.
    fn assumed_union(&self, united: &UnitedScene, union: usize, met: &[InstanceContact]) -> Assumption {
        let members = &united.members[union];
        let name = |&object: &usize| {
            let object_of = |scene: &Scene| scene.objects.get(object).map(|it| name_of(it, object));
            self.file.scene.as_ref().and_then(object_of).unwrap_or_default()
        };
        let mut names: Vec<String> = members.iter().take(MAX_NAMED).map(name).collect();
        if members.len() > MAX_NAMED {
            names.push(format!("{} more", members.len() - MAX_NAMED));
        }
        let detail = format!("{} objects that intersect were united into one: {}.", members.len(), names.join(", "));
        let soup = united.scene.objects[union].mesh().map(|mesh| &mesh.soup);
        let corners = soup.into_iter().flat_map(|soup| (0..soup.faces.len()).flat_map(|face| soup.corners(face)));
        let bounds = Box3::of(corners.filter(|corner| corner.is_finite()));
        let within = |at: &[f64; 3]| bounds.holds((*at).into());
        Assumption::new(AssumptionKind::ObjectsUnited, members.len() as u64, detail)
            .with_amount(members.len() as f64)
            .at(met.iter().map(|contact| contact.at).filter(within))
            .unless("merge=none")
    }
}

/// The instances to unite after a round that is not printable as a whole: those of one material that meet, or, where each object is
/// printable and none meets another, all of them, since one then lies within another.
fn next_groups(round: &Round, instances: &[Instance], materials: Option<&[u32]>) -> Vec<Vec<usize>> {
    let contacts: Vec<InstanceContact> =
        round.meetings.contacts.iter().map(|(it, _)| *it).filter(|it| is_of_one_material(materials, it)).collect();
    let groups = connected(instances.len(), &contacts);
    let all_good = round.results.iter().flatten().all(|result| result.section.outcome.is_printable());
    if !groups.is_empty() || !all_good || materials.is_some() {
        return groups;
    }
    let printed: Vec<usize> = (0..instances.len()).filter(|&i| instances[i].is_printed).collect();
    if printed.len() > 1 { vec![printed] } else { Vec::new() }
}

fn is_of_one_material(materials: Option<&[u32]>, contact: &InstanceContact) -> bool {
    let of = |instance: u32| materials.map(|materials| materials[instance as usize]);
    of(contact.instances[0]) == of(contact.instances[1])
}

/// The objects with faces that are to be printed and stand somewhere.
fn printed_objects(scene: &Scene, places: &[u64]) -> Vec<usize> {
    let is_printed = |&number: &usize| {
        let object = &scene.objects[number];
        object.has_faces() && places[number] > 0 && object.kind.is_printed()
    };
    (0..scene.objects.len()).filter(is_printed).collect()
}

/// The warning about objects that were not looked at.
fn omitted(scene: &Scene) -> Option<String> {
    let with_faces = scene.objects.iter().filter(|object| object.has_faces()).count();
    let count = with_faces - printed_objects(scene, &scene.places()).len();
    let plural = if count == 1 {
        "object that is not printed or not placed was"
    } else {
        "objects that are not printed or not placed were"
    };
    (count > 0).then(|| format!("{count} {plural} left as they are."))
}
