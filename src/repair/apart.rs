//! Objects stay objects: each is repaired apart, in its own coordinates, and stands in its places again.

use super::dress::{Dressed, carried, carrier, dress};
use super::input::{Input, Told, look, subject};
use super::pipeline::{Mended, mend};
use super::repaint::repaint;
use super::verdict::fates;
use super::{
    Category, Changes, Context, Merge, ObjectReport, Options, Outcome, Progress, RedFlag, Remesher, RepairError,
    Report, Stage,
};
use crate::format::{Format, ReadFile};
use crate::inspect::{Analysis, CompareOptions, Original, measure_analysis};
use crate::mesh::{Soup, Surface};
use crate::scene::{Object, ObjectKind, Scene, Shape};

/// Most objects that are kept apart: each has a section of its own in the report.
const MOST_APART: usize = 200;

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
        Merge::None if count > MOST_APART => {
            let warning = format!(
                "the file has {count} objects, and more than {MOST_APART} are not kept apart, so they were united"
            );
            file.mesh.warnings.push(warning);
            false
        }
        Merge::None => count > 0,
    }
}

/// What came of the objects.
pub(super) struct Apart {
    /// The result; none where nothing was to be changed.
    pub dressed: Option<Dressed>,
    /// A section for each object that was looked at, in their order.
    pub sections: Vec<ObjectReport>,
    /// What a person should know of objects that were not.
    pub warnings: Vec<String>,
}

impl Apart {
    /// Puts down how it ended, and looks at the result as a whole.
    pub fn tell(
        self,
        input: &Input<'_>,
        bytes: &[u8],
        report: &mut Report,
        context: &Context<'_>,
    ) -> Result<Told, RepairError> {
        let patient = &context.without_deadline();
        let Self { dressed, sections, warnings } = self;
        report.warnings.extend(warnings);
        report.verified_from_output_bytes = true;
        sum_up(report, sections);
        let (told, after) = match dressed {
            None => {
                let fates = fates(input.original, input.analysis, context)?;
                let dialect = input.mesh.dialect.clone();
                (Told { bytes: bytes.to_vec(), dialect, fates, ..Told::default() }, input.before.clone())
            }
            Some(Dressed { bytes, mesh, .. }) => {
                let analysis = Analysis::new(subject(&mesh, input.analysis.subject.unit), patient)?;
                let (after, found) = look(&analysis, || measure_analysis(&analysis, patient), context)?;
                let changes = input.original.changes(&analysis, &after.measures, None, patient)?;
                let fates = fates(input.original, &analysis, context)?;
                let surface = fates.as_ref().map(|fates| fates.shares);
                report.changes = Some(Changes { surface, ..changes });
                (Told { bytes, dialect: mesh.dialect, found: Some(found), fates, ..Told::default() }, after)
            }
        };
        let good = matches!(report.outcome, Outcome::AlreadyPrintable | Outcome::Repaired);
        if good && !after.measures.printable() {
            report.warnings.push(format!(
                "the objects meet where they stand, so that taken as one mesh they are not printable: {}; merge=objects unites them",
                after.measures.faults().join(", ")
            ));
        }
        report.after = Some(after);
        Ok(told)
    }
}

/// Repairs each object of a scene that is to be printed. `as_it_is` tells whether the file may come back byte for byte where no object needs
/// anything.
pub(super) fn repair_apart(
    file: &ReadFile,
    scene: &Scene,
    format: Format,
    as_it_is: bool,
    options: &Options,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<Apart, RepairError> {
    let places = scene.places();
    let whole = |number: usize, object: &Object| {
        object.has_faces() && places[number] > 0 && matches!(object.kind, ObjectKind::Model | ObjectKind::SolidSupport)
    };
    let faces = |object: &Object| object.mesh().map_or(0, |mesh| mesh.soup.faces.len());
    let numbers: Vec<usize> =
        (0..scene.objects.len()).filter(|&number| whole(number, &scene.objects[number])).collect();
    let all: usize = numbers.iter().map(|&number| faces(&scene.objects[number])).sum();
    let mut result = scene.clone();
    let (mut sections, mut done, mut untouched) = (Vec::new(), 0, as_it_is);
    for (index, &number) in numbers.iter().enumerate() {
        let object = &scene.objects[number];
        let own = faces(object);
        let share = |faces: usize| faces as f64 / all as f64;
        let left = numbers.len() - index;
        // What an object does not need is left to those after it.
        let time = context.remaining().mul_f64((own as f64 / (all - done).max(1) as f64).max(1.0 / left as f64));
        let [from, to] = [done, done + own].map(|faces| PERCENT[0] + (PERCENT[1] - PERCENT[0]) * share(faces));
        let name = name_of(object, number);
        let progress = Share { context, from, to, name: &name };
        let around = context.with_progress(&progress).limited_to(time);
        let options = Options {
            max_faces: options.max_faces.map(|most| ((most as f64 * share(own)) as u64).max(4)),
            ..options.clone()
        };
        let start = context.now();
        let made = repair_object(file, object, format, &options, remesher, &around)?;
        let RepairedObject { mut report, before, soup, source, welded } = made;
        report.milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
        untouched &= match report.outcome {
            Outcome::AlreadyPrintable => !welded,
            outcome => outcome == Outcome::Unrepairable,
        };
        if let (Some(soup), Shape::Mesh(mesh)) = (soup, &mut result.objects[number].shape) {
            let patient = &context.without_deadline();
            mesh.paint = repaint(&before, &mesh.paint, &soup, &source, &mut result.palettes, patient)?;
            mesh.soup = soup;
        }
        sections.push(ObjectReport::new(object.name.clone(), number, places[number], report));
        done += own;
    }
    let left_out = scene
        .objects
        .iter()
        .enumerate()
        .filter(|(number, object)| object.has_faces() && !whole(*number, object))
        .count();
    let warnings = (left_out > 0)
        .then(|| format!("objects that are not to be printed, or stand nowhere, were left as they are: {left_out}"));
    let dressed = if untouched { None } else { Some(dress(&result, format)?) };
    Ok(Apart { dressed, sections, warnings: warnings.into_iter().collect() })
}

struct RepairedObject {
    report: Report,
    /// The object as it was, welded.
    before: Surface,
    /// Its result; none where it has nothing that can be written.
    soup: Option<Soup>,
    /// For each face of the result the object's face that it was cut from.
    source: Vec<u32>,
    /// Whether the object has vertices that are one only by their positions.
    welded: bool,
}

fn repair_object(
    file: &ReadFile,
    object: &Object,
    format: Format,
    options: &Options,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<RepairedObject, RepairError> {
    let patient = &context.without_deadline();
    let mesh = file.mesh.of_same_file(object.mesh().map(|mesh| mesh.soup.clone()).unwrap_or_default());
    let analysis = Analysis::new(subject(&mesh, file.unit.as_ref()), patient)?;
    let (before, _) = look(&analysis, || measure_analysis(&analysis, patient), context)?;
    let original = Original::new(&analysis, &before.measures, CompareOptions::BRIEF);
    let input = Input { bytes: None, mesh: &mesh, analysis: &analysis, original: &original, before: &before };
    let mut report = input.report(options, 0);
    let Mended { outcome, judged } = mend(&input, carrier(format), &mut report, options, remesher, context)?;
    let Told { bytes, source, .. } = input.tell(&mut report, outcome, judged, context)?;
    let soup = if bytes.is_empty() { None } else { Some(carried(&bytes)?) };
    let welded = analysis.ingest.merged_vertices > 0 && format == Format::ThreeMf;
    Ok(RepairedObject { report, before: analysis.surface, soup, source, welded })
}

fn name_of(object: &Object, number: usize) -> String {
    object.name.as_ref().map_or_else(|| format!("object {}", number + 1), |name| format!("object '{name}'"))
}

/// The progress of one object as a part of the whole.
struct Share<'a> {
    context: &'a Context<'a>,
    from: f64,
    to: f64,
    name: &'a str,
}

impl Progress for Share<'_> {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        let percent = self.from + (self.to - self.from) * f64::from(percent) / 100.0;
        // What an object is finished with the whole is not.
        let stage = if stage == Stage::Finish { Stage::Verify } else { stage };
        self.context.report(stage, tier, percent as u8);
    }

    fn log(&self, line: &str) {
        self.context.log(&format!("{}: {line}", self.name));
    }
}

/// What became of all objects together.
fn outcome_of(sections: &[ObjectReport]) -> Outcome {
    let all = |outcome| sections.iter().all(|section| section.outcome == outcome);
    let good = |section: &ObjectReport| matches!(section.outcome, Outcome::AlreadyPrintable | Outcome::Repaired);
    if sections.is_empty() || all(Outcome::AlreadyPrintable) {
        Outcome::AlreadyPrintable
    } else if sections.iter().all(good) {
        Outcome::Repaired
    } else if sections.iter().any(|section| matches!(section.outcome, Outcome::Repaired | Outcome::PartiallyRepaired)) {
        Outcome::PartiallyRepaired
    } else {
        Outcome::Unrepairable
    }
}

/// Puts the accounts of all objects together: what was planned and done for a single one is what was done to the file.
fn sum_up(report: &mut Report, sections: Vec<ObjectReport>) {
    report.outcome = outcome_of(&sections);
    for section in &sections {
        let told =
            |text: &str| if sections.len() == 1 { text.to_owned() } else { format!("{}: {text}", section.title()) };
        report
            .red_flags
            .extend(section.red_flags.iter().map(|flag| RedFlag { detail: told(&flag.detail), ..flag.clone() }));
        report.warnings.extend(section.warnings.iter().map(|warning| told(warning)));
    }
    match sections.as_slice() {
        [] => report.summary = "The file has no object that is to be printed; it is handed back unchanged.".to_owned(),
        [only] => {
            report.summary.clone_from(&only.summary);
            (report.plan, report.steps, report.candidates) =
                (only.plan.clone(), only.steps.clone(), only.candidates.clone());
            (report.changes, report.ledger) = (only.changes, only.ledger.clone());
        }
        several => {
            report.summary = in_words(several);
            report.plan.category = Category::MultipleComponents;
            report.plan.preset = several[0].plan.preset;
            report.plan.reason = "each object has a plan of its own".to_owned();
        }
    }
    report.objects = sections;
}

/// What became of all objects together, in words.
fn in_words(sections: &[ObjectReport]) -> String {
    let count = |outcome| sections.iter().filter(|section| section.outcome == outcome).count();
    let told = [
        (Outcome::AlreadyPrintable, "printable already"),
        (Outcome::Repaired, "repaired and printable"),
        (Outcome::PartiallyRepaired, "better but not as it should be"),
        (Outcome::Unrepairable, "as it was, not printable"),
    ];
    let words: Vec<String> = told
        .into_iter()
        .map(|(outcome, words)| (count(outcome), words))
        .filter(|(count, _)| *count > 0)
        .map(|(count, words)| format!("{count} {words}"))
        .collect();
    let mut text = format!("Of {} objects: {}.", sections.len(), words.join(", "));
    let bad = |section: &&ObjectReport| matches!(section.outcome, Outcome::PartiallyRepaired | Outcome::Unrepairable);
    if let Some(first) = sections.iter().find(bad) {
        text.push_str(&format!(" {}: {}", first.title(), first.summary));
    }
    text
}
