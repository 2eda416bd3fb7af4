//! The repair of a file whose objects are kept: each object is repaired separately, in its own coordinates, and put back in its places.
//! Objects that intersect in their places are united first, unless the option `merge` keeps them separate. Objects whose results
//! still intersect are united and repaired again, in up to [`MAX_ROUNDS`] rounds.

use super::attribute_transfer::{Painted, SoupWithSource, transfer_paint};
use super::body::{ObjectProgress, ObjectRepair, RepairedObject};
use super::conclusion::RepairedBody;
use super::export::{Exported, export};
use super::input::{Input, RepairError, RepairRequest};
use super::judge::{inspect_measured, surface_shares};
use super::options::{Merge, Options};
use super::report::{Assumption, AssumptionKind, ObjectReport, Outcome};
use super::report_draft::{MAX_NAMED, ObjectPlace, ReportDraft, objects_intersect, outcome_of};
use super::unite::{CutBody, UnitedScene, connected, contacts_of, cut_body, instance_of, instances_of, name_of};
use crate::analyze::subject;
use crate::context::Context;
use crate::format::{Format, ReadFile, WriteError};
use crate::inspect::{Analysis, Changes, Inspection, InstanceContact};
use crate::math::Box3;
use crate::mesh::Soup;
use crate::scene::{Instance, Object, Paint, Palette, Scene, Shape};

/// Most objects that are kept separate, because each gets its own section in the report.
const MAX_SEPARATE: usize = 200;

/// Most rounds of uniting and repairing objects. A new round follows if results intersect although the inputs did not.
const MAX_ROUNDS: usize = 4;

/// Start and end of the objects' repairs in the progress of the whole repair, in percent.
const PERCENT: [f64; 2] = [5.0, 90.0];

/// Whether the objects of a file are repaired separately for a result of this format. Adds a warning if there are too many.
pub(super) fn keeps_objects_separate(file: &mut ReadFile, format: Format, options: &Options) -> bool {
    let Some(scene) = file.scene.as_ref().filter(|_| format.has_objects() && file.mesh.format.has_objects()) else {
        return false;
    };
    let count = scene.objects.iter().filter(|object| object.has_faces()).count();
    match options.merge {
        Merge::Objects => false,
        Merge::Auto | Merge::None if count > MAX_SEPARATE => {
            let warning = format!(
                "The file has {count} objects, more than the limit of {MAX_SEPARATE} separate objects, so all were combined into one."
            );
            file.mesh.warnings.push(warning);
            false
        }
        Merge::Auto | Merge::None => count > 0,
    }
}

/// The repair of a file's objects.
pub(super) struct SceneRepair<'a> {
    /// The file that was read.
    pub file: &'a ReadFile,
    /// All objects in their places, as one mesh.
    pub input: &'a Input<'a>,
    /// The output format.
    pub format: Format,
    /// Whether the file may be returned byte for byte if no object needs a change.
    pub may_return_input: bool,
    /// The request, with the context of the objects' repairs.
    pub request: RepairRequest<'a>,
    /// The context of the work on all objects together, with a later deadline.
    pub file_context: &'a Context<'a>,
}

/// The result of one object.
struct ObjectResult {
    section: ObjectReport,
    /// The triangles with their colours and materials; none if there is nothing to write.
    mesh: Option<(Soup, Vec<Paint>)>,
    /// Whether the object in the file can stay as it is.
    is_untouched: bool,
}

/// The repaired file, assembled from the results of its bodies.
pub(super) struct AssembledFile {
    /// The draft of the file's report.
    pub draft: ReportDraft,
    /// The reports of objects that were repaired separately.
    pub sections: Vec<ObjectReport>,
    /// The file.
    pub bytes: Vec<u8>,
    /// The dialect of the file's format.
    pub dialect: String,
}

impl From<RepairedBody> for AssembledFile {
    fn from(body: RepairedBody) -> Self {
        Self { draft: body.draft, sections: Vec::new(), bytes: body.bytes, dialect: body.dialect }
    }
}

/// The objects after one round, repaired and judged in their places.
struct RepairRound {
    united: UnitedScene,
    /// The scene with the repaired objects.
    scene: Scene,
    results: Vec<Option<ObjectResult>>,
    bytes: Vec<u8>,
    dialect: String,
    after: Inspection,
    changes: Option<Changes>,
    conflicts: Conflicts,
}

/// The conflicts between the instances of a scene.
#[derive(Default)]
struct Conflicts {
    /// Pairs of instances that touch or intersect, with the names of their objects.
    contacts: Vec<(InstanceContact, [String; 2])>,
    /// Instances with faces inside objects of another material.
    contained: Vec<usize>,
}

/// A scene in which objects are cut where a later object of another material overlaps them.
struct CutScene {
    united: UnitedScene,
    assumptions: Vec<Assumption>,
}

impl SceneRepair<'_> {
    /// Repairs the objects of a scene that are printed, and assembles the file.
    ///
    /// # Errors
    /// [`RepairError`] if the job was canceled, the file cannot be written, or it does not read back as judged.
    pub fn run(&self, scene: &Scene, bytes: &[u8]) -> Result<AssembledFile, RepairError> {
        let start = instances_of(scene).map_err(|_| WriteError::TooLarge)?;
        let mut united = UnitedScene::of(scene);
        let (mut united_contacts, mut cuts) = (Vec::new(), Vec::new());
        if self.request.options.merge == Merge::Auto {
            united_contacts = contacts_of(&start, self.input.analysis, &self.file_context.for_verification())?;
            let materials = self.materials_of(scene, &start);
            united_contacts.retain(|contact| is_of_one_material(materials.as_deref(), contact));
            let groups = connected(start.len(), &united_contacts);
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
                return Ok(self.conclude(judged, &united_contacts, cuts));
            }
            let instances = instances_of(&judged.scene).map_err(|_| WriteError::TooLarge)?;
            let materials = self.materials_of(&judged.scene, &instances);
            let groups = next_groups(&judged, &instances, materials.as_deref());
            united = if groups.is_empty() {
                let Some(cut) = self.cut_overlaps(&judged, &instances, materials.as_deref(), &mut palettes)? else {
                    return Ok(self.conclude(judged, &united_contacts, cuts));
                };
                cuts.extend(cut.assumptions);
                cut.united
            } else {
                united_contacts.extend(judged.conflicts.contacts.iter().map(|(contact, _)| *contact));
                judged.united.unite(&instances, &groups)
            };
            let mut old = judged.results;
            results = united.unchanged_from.iter().map(|from| from.and_then(|from| old[from].take())).collect();
        }
    }

    /// The material of each instance, if both files are 3MF and so describe one print of several materials.
    fn materials_of(&self, scene: &Scene, instances: &[Instance]) -> Option<Vec<u32>> {
        let is_print = self.file.mesh.format == Format::ThreeMf && self.format == Format::ThreeMf;
        is_print.then(|| scene.materials_of(instances)).flatten()
    }

    /// Cuts objects where a later object of another material overlaps them; none if there is nothing to cut, or all cuts failed.
    fn cut_overlaps(
        &self,
        round: &RepairRound,
        instances: &[Instance],
        materials: Option<&[u32]>,
        palettes: &mut [Palette],
    ) -> Result<Option<CutScene>, RepairError> {
        let Some(materials) = materials else { return Ok(None) };
        let verification = &self.file_context.for_verification();
        let overlaps = |a: usize, b: usize| {
            let is_met = |(contact, _): &(InstanceContact, _)| contact.instances.map(|i| i as usize) == [a, b];
            let is_contained = round.conflicts.contained.contains(&a) || round.conflicts.contained.contains(&b);
            instances[b].is_printed
                && materials[a] != materials[b]
                && (is_contained || round.conflicts.contacts.iter().any(is_met))
        };
        let placed = |instance: usize| round.scene.placed_instances([&instances[instance]]);
        let (mut groups, mut bodies, mut assumptions) = (Vec::new(), Vec::new(), Vec::new());
        for a in (0..instances.len()).filter(|&a| instances[a].is_printed) {
            let later: Vec<usize> = (a + 1..instances.len()).filter(|&b| overlaps(a, b)).collect();
            if later.is_empty() {
                continue;
            }
            let others: Vec<Soup> = later.iter().map(|&b| placed(b).soup).collect();
            let Some(CutBody { mesh, removed }) = cut_body(&placed(a), &others, palettes, verification)? else {
                continue;
            };
            let name = |instance: usize| self.instance_name(&round.united, &instances[instance]);
            let names: Vec<String> = later.iter().take(MAX_NAMED).map(|&b| name(b)).collect();
            let detail = format!(
                "The part of {} that overlaps {} was removed: as in slicers, the later object in the file keeps the space.",
                name(a),
                names.join(", ")
            );
            let cut = Assumption::new(AssumptionKind::OverlapRemoved, later.len() as u64, detail);
            let is_met = |(contact, _): &&(InstanceContact, _)| contact.instances[0] as usize == a;
            let places = round.conflicts.contacts.iter().filter(is_met).map(|(contact, _)| contact.at);
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
        Ok(Some(CutScene { united, assumptions }))
    }

    /// The name of an instance's object in the file.
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
        let RepairRequest { context, options, .. } = self.request;
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
            // Time that an object does not use goes to the objects after it.
            let share = (own as f64 / left.max(1) as f64).max(1.0 / (missing.len() - index) as f64);
            let done = |faces: usize| PERCENT[0] + (PERCENT[1] - PERCENT[0]) * faces as f64 / total.max(1) as f64;
            let (from, to) = (done(total - left), done(total - left + own));
            let name = name_of(object, number);
            let progress = ObjectProgress { context, from, to, name: &name };
            let object_context = context.with_progress(&progress).limited_to(context.remaining().mul_f64(share));
            let share = |most: u64| ((most as f64 * own as f64 / all.max(1) as f64) as u64).max(4);
            let options = Options { max_faces: options.max_faces.map(share), ..options.clone() };
            let index = united.members[number].first().copied().unwrap_or(number);
            let place = ObjectPlace { name: object.name.clone(), index, places: places[number] };
            let RepairedObject { report, before, soup, source, welded } = repair.run(
                object,
                place,
                &RepairRequest { options: &options, context: &object_context, ..self.request },
            )?;
            let is_untouched = match report.outcome {
                Outcome::AlreadyPrintable => !welded,
                outcome => outcome == Outcome::Unrepairable,
            };
            let paint = object.mesh().map_or(&[][..], |mesh| &mesh.paint);
            let verification = &context.for_verification();
            let mesh = match soup {
                None => None,
                Some(soup) => {
                    let painted = Painted { surface: &before, paint };
                    let result = SoupWithSource { soup: &soup, source: &source };
                    let paint = transfer_paint(painted, result, palettes, verification)?;
                    Some((soup, paint))
                }
            };
            results[number] = Some(ObjectResult { section: report, mesh, is_untouched });
            left -= own;
        }
        Ok(())
    }

    /// Writes the scene with the repaired objects, reads the file back, and judges all objects in their places.
    fn judge(
        &self,
        united: UnitedScene,
        results: Vec<Option<ObjectResult>>,
        palettes: &[Palette],
        bytes: &[u8],
    ) -> Result<RepairRound, RepairError> {
        let (input, context) = (self.input, self.file_context);
        let verification = &context.for_verification();
        let is_untouched =
            self.may_return_input && !united.is_changed && results.iter().flatten().all(|result| result.is_untouched);
        if is_untouched {
            let (scene, after) = (united.scene.clone(), input.before.clone());
            let conflicts = self.conflicts(&united, &scene, input.analysis, &after)?;
            let (bytes, dialect) = (bytes.to_vec(), input.mesh.dialect.clone());
            return Ok(RepairRound { united, scene, results, bytes, dialect, after, changes: None, conflicts });
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
        let analysis = Analysis::new(subject(&mesh, input.analysis.facts.unit), verification)?;
        let (after, _) = inspect_measured(&analysis, context)?;
        let conflicts = self.conflicts(&united, &scene, &analysis, &after)?;
        let changes = input.original.changes(&analysis, &after.measures, None, verification)?;
        let surface = surface_shares(input.original, &analysis, context)?;
        let changes = Some(Changes { surface, ..changes });
        let dialect = mesh.dialect.clone();
        Ok(RepairRound { united, scene, results, bytes, dialect, after, changes, conflicts })
    }

    /// The conflicts between the instances of a scene. A printable file has none.
    fn conflicts(
        &self,
        united: &UnitedScene,
        scene: &Scene,
        analysis: &Analysis<'_>,
        inspection: &Inspection,
    ) -> Result<Conflicts, RepairError> {
        if inspection.measures.printable() {
            return Ok(Conflicts::default());
        }
        let verification = &self.file_context.for_verification();
        let instances = &instances_of(scene).map_err(|_| WriteError::TooLarge)?;
        let contacts = contacts_of(instances, analysis, verification)?;
        let name = |instance: u32| self.instance_name(united, &instances[instance as usize]);
        let contacts = contacts.into_iter().map(|contact| (contact, contact.instances.map(name))).collect();
        let of = instance_of(instances);
        let mut contained: Vec<usize> =
            analysis.faces_in_other_materials(verification)?.iter().map(|&face| of(face) as usize).collect();
        contained.dedup();
        Ok(Conflicts { contacts, contained })
    }

    /// Concludes the repair of the whole file after the last round.
    fn conclude(
        &self,
        round: RepairRound,
        united_contacts: &[InstanceContact],
        cuts: Vec<Assumption>,
    ) -> AssembledFile {
        let RepairRound { united, scene, results, bytes, dialect, after, changes, conflicts } = round;
        let Conflicts { contacts, contained } = conflicts;
        let instances = instances_of(&scene).unwrap_or_default();
        let contained: Vec<String> =
            contained.iter().take(MAX_NAMED).map(|&i| self.instance_name(&united, &instances[i])).collect();
        let unions = (0..united.members.len()).filter(|&object| united.is_union(object));
        let unions: Vec<Assumption> = unions.map(|union| self.assumed_union(&united, union, united_contacts)).collect();
        let sections: Vec<ObjectReport> = results.into_iter().flatten().map(|result| result.section).collect();
        let mut draft = ReportDraft::of_objects(&sections);
        draft.outcome = outcome_of(&sections, after.measures.printable(), united.is_changed);
        draft.warnings.splice(0..0, warning_of_unprinted(&united.scene));
        draft.assumptions = [cuts, draft.assumptions, unions].concat();
        draft.changes = changes.or(draft.changes);
        draft.omitted.extend(self.input.time.omitted());
        draft.omitted.sort_unstable();
        draft.omitted.dedup();
        if let Some(flag) = objects_intersect(&contacts, &contained) {
            if sections.iter().all(|section| section.outcome.is_printable()) {
                let advice = match self.request.options.merge {
                    Merge::None => " Set `merge=auto` to unite them.",
                    Merge::Auto | Merge::Objects => "",
                };
                draft.summary = format!("The file is not printable as it is arranged: {}.{advice}", flag.detail);
            }
            draft.red_flags.push(flag);
        }
        draft.after = Some(after);
        AssembledFile { draft, sections, bytes, dialect }
    }

    /// The assumption that intersecting objects are meant to be one solid.
    fn assumed_union(&self, united: &UnitedScene, union: usize, united_contacts: &[InstanceContact]) -> Assumption {
        let members = &united.members[union];
        let name = |&object: &usize| {
            let object_of = |scene: &Scene| scene.objects.get(object).map(|member| name_of(member, object));
            self.file.scene.as_ref().and_then(object_of).unwrap_or_default()
        };
        let mut names: Vec<String> = members.iter().take(MAX_NAMED).map(name).collect();
        if members.len() > MAX_NAMED {
            names.push(format!("{} more", members.len() - MAX_NAMED));
        }
        let detail = format!("{} intersecting objects were united into one: {}.", members.len(), names.join(", "));
        let soup = united.scene.objects[union].mesh().map(|mesh| &mesh.soup);
        let corners = soup.into_iter().flat_map(|soup| (0..soup.faces.len()).flat_map(|face| soup.corners(face)));
        let bounds = Box3::of(corners.filter(|corner| corner.is_finite()));
        let within = |at: &[f64; 3]| bounds.holds((*at).into());
        Assumption::new(AssumptionKind::ObjectsUnited, members.len() as u64, detail)
            .with_amount(members.len() as f64)
            .at(united_contacts.iter().map(|contact| contact.at).filter(within))
            .unless("merge=none")
    }
}

/// The groups of instances to unite after a round whose file is not printable: intersecting instances of one material.
///
/// If each object is printable and none intersects another, one object lies inside another, and all instances are one group.
fn next_groups(round: &RepairRound, instances: &[Instance], materials: Option<&[u32]>) -> Vec<Vec<usize>> {
    let contacts = round.conflicts.contacts.iter().map(|(contact, _)| *contact);
    let contacts: Vec<InstanceContact> = contacts.filter(|c| is_of_one_material(materials, c)).collect();
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

/// The indices of objects that have faces, are printed and have an instance.
fn printed_objects(scene: &Scene, places: &[u64]) -> Vec<usize> {
    let is_printed = |&number: &usize| {
        let object = &scene.objects[number];
        object.has_faces() && places[number] > 0 && object.kind.is_printed()
    };
    (0..scene.objects.len()).filter(is_printed).collect()
}

/// The warning about objects that were not repaired because they are not printed; none if there are none.
fn warning_of_unprinted(scene: &Scene) -> Option<String> {
    let with_faces = scene.objects.iter().filter(|object| object.has_faces()).count();
    let count = with_faces - printed_objects(scene, &scene.places()).len();
    let subject = if count == 1 { "object is" } else { "objects are" };
    (count > 0).then(|| format!("{count} {subject} left unchanged: not printed or not placed."))
}
