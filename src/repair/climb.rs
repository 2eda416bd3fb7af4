use std::ops::Range;
use std::time::Duration;

use super::agreement::{Method, Testimony, explain_by_agreement};
use super::checkpoints::{Checkpoints, START};
use super::input::Input;
use super::operators::{Counter, Counts, Failure};
use super::presets::{planned, remesh_action, tier_of};
use super::sheets::{SHEET_SHARE, open_sheet_share};
use super::tiers::{End, Key, Place, Runner, Task};
use super::verdict::{JudgeError, Judged, Patches, judge};
use super::{
    Action, Cancelled, Candidate, Context, LeftOut, Operator, Options, PlannedAction, Preset, RedFlag, RedFlagCode,
    Remesher, Rung, Stage, Step, StepStatus, When, summary,
};
use crate::arrange::ArrangeError;
use crate::mesh::Surface;

/// The way up a plan's rungs: what was done so far, and the best that came of it.
pub(super) struct Climb<'a> {
    input: &'a Input<'a>,
    runner: Runner<'a>,
    /// What the opening left, from which every rung starts.
    opened: Place,
    /// How the opening ended.
    end: End,
    opening: Vec<Step>,
    checkpoints: Checkpoints,
    verdicts: Vec<Verdict>,
    steps: Vec<Step>,
    best: Option<(usize, Judged)>,
    candidates: Vec<Candidate>,
    /// Whether a result was left open, or lost surface that can be seen.
    left_sheets: bool,
    /// What methods found wrong with their own results.
    testimonies: Vec<Testimony>,
    /// Whether two methods of different kind found the same.
    agreed: bool,
    /// Whether the native remesh made something printable.
    remeshed: bool,
}

/// What a rung made.
enum Made {
    Nothing,
    /// A surface, and its number.
    New(u32, Box<Place>),
    /// A surface on which there is a verdict, by the place of that.
    Judged(usize),
}

/// A verdict on a surface that is not good enough.
struct Verdict {
    surface: u32,
    patches: Patches,
    candidate: usize,
    step: Step,
}

/// What a climb brought.
pub(super) struct Climbed {
    pub steps: Vec<Step>,
    pub candidates: Vec<Candidate>,
    /// The best candidate, with its place in the list.
    pub best: Option<(usize, Judged)>,
}

/// The note of a step that was not run again, where it has none of its own.
pub(super) const TAKEN_OVER: &str = "its result was taken over from an earlier rung";

/// The two actions that every recipe begins with.
const OPENING: [Action; 2] = [Action::BasicCleanup, Action::FixNormals];

impl<'a> Climb<'a> {
    /// Runs the opening that every rung shares; what it leaves is what tells a sheet from a solid with holes.
    pub fn open(input: &'a Input<'a>, runner: Runner<'a>) -> Result<Self, Cancelled> {
        let actions = OPENING.map(|action| planned(action, runner.options)).to_vec();
        let rung = Rung { when: When::NothingGood, tier: 1, preset: Preset::BasicCleanup, actions };
        let mut opened = Place::new(input.analysis.surface.clone());
        let (mut opening, mut end) = (Vec::new(), End::Finished);
        let tasks = Task::of(&rung, 0);
        for (at, &task) in tasks.iter().enumerate() {
            let percent = percent(&(5..15), at, tasks.len());
            let (step, ended, _) = runner.run(0, &rung, task, percent, &mut opened)?;
            opening.push(step);
            end = ended;
            if end != End::Finished {
                break;
            }
        }
        Ok(Self {
            input,
            runner,
            opened,
            end,
            steps: opening.clone(),
            opening,
            checkpoints: Checkpoints::default(),
            verdicts: Vec::new(),
            best: None,
            candidates: Vec::new(),
            left_sheets: false,
            testimonies: Vec::new(),
            agreed: false,
            remeshed: false,
        })
    }

    /// Share of the area in open sheets, as the opening left them. Where they look like the whole model, cracks are stitched first for
    /// trial: the patches of a cracked solid are sheets only as long as they are apart.
    pub fn sheet_share(&self) -> Result<f64, Cancelled> {
        let share = open_sheet_share(&self.opened.surface);
        if share < SHEET_SHARE || self.runner.options.max_tier < tier_of(Action::Stitch) {
            return Ok(share);
        }
        let actions = vec![planned(Action::Stitch, self.runner.options)];
        let rung = Rung { when: When::NothingGood, tier: 2, preset: Preset::FullRepair, actions };
        let mut place = self.opened.clone();
        for task in Task::of(&rung, 0) {
            let (_, end, _) = self.runner.run(0, &rung, task, 15, &mut place)?;
            if end != End::Finished {
                return Ok(share);
            }
        }
        Ok(open_sheet_share(&place.surface))
    }

    /// Climbs until a result is good.
    pub fn run(mut self, rungs: &[Rung]) -> Result<Climbed, Cancelled> {
        for (index, rung) in (0u32..).zip(rungs) {
            let later = &rungs[index as usize + 1..];
            let step = self.out_of_time(index, rung).or_else(|| self.needless(index, rung));
            // Last, since it starts Blender to learn its version.
            if let Some(step) = step.or_else(|| not_runnable(index, rung, self.runner.remesher)) {
                self.note(step);
            } else {
                let good = match self.make(index, rung, later)? {
                    Made::Nothing => false,
                    Made::New(number, result) => self.judge(index, rung, number, &result)?,
                    Made::Judged(verdict) => {
                        self.judge_alike(index, verdict);
                        false
                    }
                };
                if good {
                    break;
                }
            }
        }
        Ok(Climbed { steps: self.steps, candidates: self.candidates, best: self.best })
    }

    /// The step that says that a rung is passed over, where there is no time to run it and to verify what it makes.
    fn out_of_time(&self, index: u32, rung: &Rung) -> Option<Step> {
        let Runner { context, time, .. } = self.runner;
        let faces = self.opened.surface.faces.len();
        if !time.for_operators(faces, context).is_late() {
            return None;
        }
        time.leave_out(LeftOut::Repair);
        // What the opening brought is better than nothing.
        let opened = self.candidates.is_empty() && self.opened.surface.faces != self.input.analysis.surface.faces;
        if opened && remesh_of(rung).is_none() && time.can_verify(faces, context) {
            return None;
        }
        let last = rung.actions.iter().rev().map(|it| it.action).find(|&it| it != Action::Validate)?;
        let note = Some("the time was over before it could start".to_owned());
        Some(Step { status: StepStatus::Skipped, note, ..Step::new(index, rung.tier, last, None) })
    }

    /// The step that says why a rung is passed over, where what came before it makes it needless.
    fn needless(&self, index: u32, rung: &Rung) -> Option<Step> {
        let whole = || self.best.as_ref().is_some_and(|(_, best)| best.is_whole());
        let why = match rung.when {
            When::SheetsLeft if !self.candidates.is_empty() && !self.left_sheets => {
                "the rungs before it left nothing open and lost no surface"
            }
            When::NothingWhole if whole() => "the best result before it is closed and whole",
            _ if self.agreed && Method::of(rung) == Some(Method::Blender) => {
                "methods of different kind agree on the red flags, so the input is their cause"
            }
            _ if remesh_of(rung) == Some(Action::VoxelRemesh) && self.remeshed => {
                "the native remesh made a printable solid of the same inside, so its red flags would come back"
            }
            _ if remesh_of(rung) == Some(Action::BooleanUnion) && has_boundary(&self.opened.surface) => {
                "parts with holes enclose nothing that could be united"
            }
            _ if self.encloses_other_room() && matches!(Method::of(rung), Some(Method::Grid | Method::Blender)) => {
                "it starts from the same closed holes, so it encloses the same room"
            }
            _ => return None,
        };
        let last = rung.actions.iter().rev().map(|it| it.action).find(|&it| it != Action::Validate)?;
        let skipped = Step::new(index, rung.tier, last, None);
        Some(Step { status: StepStatus::Skipped, note: Some(why.to_owned()), ..skipped })
    }

    /// Whether all that is wrong with the best result is how much an open input's closed holes enclose.
    fn encloses_other_room(&self) -> bool {
        let is_of_holes =
            |flag: &RedFlag| matches!(flag.code, RedFlagCode::VolumeChange | RedFlagCode::SurfaceInvented);
        let best = self.best.as_ref().map(|(_, best)| best);
        !self.input.original.measures().closed
            && best.is_some_and(|it| it.measures.printable() && it.red_flags.iter().all(is_of_holes))
    }

    /// What a rung makes. What rungs before it did is taken over from them.
    fn make(&mut self, index: u32, rung: &Rung, later: &[Rung]) -> Result<Made, Cancelled> {
        if index > 0 {
            self.steps.extend(self.opening.iter().map(|step| taken_over(step, index, step.action)));
        }
        let tasks = Task::of(rung, OPENING.len());
        let mut way = self.known_way(rung, &tasks);
        let comes_to = |way: &[(u32, Option<Step>)]| way.last().map_or(START, |&(number, _)| number);
        let mut number = comes_to(&way);
        let is_on_it = |it: &Verdict| it.surface == number && it.patches == patches_of(rung);
        let verdict = self.verdicts.iter().position(is_on_it).filter(|_| way.len() == tasks.len());
        if verdict.is_none() {
            // On from the last surface that is at hand.
            while number != START && self.checkpoints.kept(number).is_none() {
                way.pop();
                number = comes_to(&way);
            }
        }
        let mut crossings = Crossings::Unknown;
        for (&task, (_, step)) in tasks.iter().zip(&way) {
            if let Some(step) = step {
                crossings = crossings.after(step);
                self.steps.push(taken_over(step, index, task.action));
            }
        }
        if let Some(verdict) = verdict {
            return Ok(Made::Judged(verdict));
        }
        let mut end = self.end;
        let mut place = self.checkpoints.kept(number).unwrap_or(&self.opened).clone();
        way.iter().filter_map(|(_, step)| step.as_ref()).for_each(|step| place.note_holes(step));
        let turnings = turnings(rung, later, self.runner.options);
        for (at, &task) in tasks.iter().enumerate().skip(way.len()) {
            if end != End::Finished {
                break;
            }
            if !crossings.make_needless(task) {
                let percent = percent(&span(index), at, tasks.len());
                let (step, ended, changed) = self.runner.run(index, rung, task, percent, &mut place)?;
                end = ended;
                crossings = crossings.after(&step);
                number = match task.key(rung, self.runner.options).filter(|_| end == End::Finished) {
                    Some(key) => self.checkpoints.learn(number, key, changed, &step),
                    None if changed => self.checkpoints.fresh(),
                    None => number,
                };
                self.steps.push(Step { failure: None, ..step });
            }
            if turnings.contains(&(at + 1)) {
                self.checkpoints.keep(number, at + 1, &place);
            }
        }
        let nothing = end == End::Nothing || place.surface.faces.is_empty();
        Ok(if nothing { Made::Nothing } else { Made::New(number, Box::new(place)) })
    }

    /// How far it is known what a rung does: the step of each task, unless it was needless, and the number of what it made.
    fn known_way(&self, rung: &Rung, tasks: &[Task]) -> Vec<(u32, Option<Step>)> {
        let (mut number, mut crossings) = (START, Crossings::Unknown);
        let mut way = Vec::new();
        for &task in tasks {
            let mut taken = None;
            if !crossings.make_needless(task) {
                let known = task.key(rung, self.runner.options).and_then(|key| self.checkpoints.known(number, key));
                let Some((made, step)) = known else { break };
                number = *made;
                crossings = crossings.after(step);
                taken = Some(step.clone());
            }
            way.push((number, taken));
        }
        way
    }

    /// Takes over a verdict on the same surface.
    fn judge_alike(&mut self, index: u32, verdict: usize) {
        let Verdict { candidate, step, .. } = &self.verdicts[verdict];
        let (candidate, step) = (self.candidates[*candidate].clone(), taken_over(step, index, Action::Validate));
        self.candidates.push(Candidate { rung: Some(index), ..candidate });
        self.note(step);
    }

    /// Judges a result and keeps it if it is the best so far. Whether it is good.
    fn judge(&mut self, index: u32, rung: &Rung, number: u32, result: &Place) -> Result<bool, Cancelled> {
        let Runner { options, format, context, time, .. } = self.runner;
        context.report(Stage::Verify, Some(rung.tier), span(index).end);
        let start = context.now();
        let patches = patches_of(rung);
        let verdict = if time.can_verify(result.surface.faces.len(), context) {
            judge(&result.surface, patches, result.invented.as_ref(), format, self.input.original, options, context)
        } else {
            Err(JudgeError::Cancelled(Cancelled))
        };
        let mut step = validation(index, start, context);
        let mut good = false;
        match verdict {
            Ok(mut judged) => {
                time.note_verification(result.surface.faces.len(), context.now().saturating_sub(start));
                self.hear(rung, &mut judged);
                self.remeshed |= Method::of(rung) == Some(Method::Grid) && judged.measures.printable();
                step.note = Some(summary::verdict_in_words(&judged));
                self.candidates.push(Candidate::new(Some(index), &judged, false));
                let lost = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::SurfaceLost);
                self.left_sheets |= lost || judged.measures.boundary_edges > 0;
                let candidate = self.candidates.len() - 1;
                self.verdicts.push(Verdict { surface: number, patches, candidate, step: step.clone() });
                good = judged.is_final() || self.best.as_ref().is_some_and(|(_, best)| best.is_final());
                if self.best.as_ref().is_none_or(|(_, best)| judged.rank() < best.rank()) {
                    self.best = Some((candidate, judged));
                }
            }
            Err(JudgeError::Cancelled(stop)) if context.is_cancelled() => return Err(stop),
            Err(JudgeError::Cancelled(_)) => {
                time.leave_out(LeftOut::Verification);
                step.status = StepStatus::Failed;
                step.note = Some("the time was over before it was verified, so it is not handed out".to_owned());
            }
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
            }
        }
        self.note(step);
        Ok(good)
    }

    /// Looks whether a method of another kind found the same wrong with its result. If so, that is a property of the input.
    fn hear(&mut self, rung: &Rung, judged: &mut Judged) {
        let Some(own) = Testimony::of(rung, judged) else { return };
        if self.testimonies.iter().any(|other| own.agrees_with(other)) {
            self.agreed = true;
            explain_by_agreement(judged);
            if let Some((candidate, best)) = &mut self.best
                && best.measures.printable()
                && own.is_of(best)
            {
                explain_by_agreement(best);
                self.candidates[*candidate].red_flags.clone_from(&best.red_flags);
            }
        }
        self.testimonies.push(own);
    }

    fn note(&mut self, step: Step) {
        self.runner.log(&step);
        self.steps.push(step);
    }
}

/// The step that says why a rung is passed over, if it is.
fn not_runnable(index: u32, rung: &Rung, remesher: Option<&dyn Remesher>) -> Option<Step> {
    let action = remesh_of(rung)?;
    let missing = remesher.map_or(Err("Blender is not installed on this server"), |r| r.info().map(drop)).err()?;
    let why = format!("{missing}; the best result without tier 3 is handed out");
    Some(Step { status: StepStatus::Skipped, note: Some(why), ..Step::new(index, 3, action, None) })
}

fn has_boundary(surface: &Surface) -> bool {
    Counts::of(surface).get(Counter::BoundaryEdges) > 0
}

/// The action of a rung that Blender does, if there is one.
pub(super) fn remesh_of(rung: &Rung) -> Option<Action> {
    rung.actions.iter().map(|planned| planned.action).find(|&action| remesh_action(action).is_some())
}

/// What is known of faces that intersect, on a rung's way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Crossings {
    Unknown,
    /// Nothing changed since they were resolved, as far as they could be.
    Resolved,
    /// They could not be resolved, and nothing but sheets that were moved apart by a hair changed since.
    Given,
}

impl Crossings {
    fn after(self, step: &Step) -> Self {
        match step.operator {
            Some(Operator::Resolve) => {
                let failed = step.status == StepStatus::Failed;
                // Sheets that are cut apart may be closed.
                let open = matches!(step.failure, Some(Failure::Arrange(ArrangeError::NotClosed(_))));
                if failed && !open { Self::Given } else { Self::Resolved }
            }
            Some(Operator::Separate) if self == Self::Given => self,
            _ if step.changed.is_empty() => self,
            _ => Self::Unknown,
        }
    }

    /// Whether a task can be left out.
    fn make_needless(self, task: Task) -> bool {
        self != Self::Unknown && task.operator == Some(Operator::Resolve)
    }
}

/// After how many tasks later rungs turn off from a rung's way.
fn turnings(rung: &Rung, later: &[Rung], options: &Options) -> Vec<usize> {
    let keys = |rung: &Rung| -> Vec<Option<Key>> {
        Task::of(rung, OPENING.len()).into_iter().map(|task| task.key(rung, options)).collect()
    };
    let own = keys(rung);
    let alike = |other: &Rung| own.iter().zip(keys(other)).take_while(|(a, b)| a.is_some() && *a == b).count();
    later.iter().map(alike).collect()
}

fn patches_of(rung: &Rung) -> Patches {
    let anew = |planned: &PlannedAction| {
        remesh_action(planned.action).is_some() || planned.operators.contains(&Operator::Remesh)
    };
    if rung.actions.iter().any(anew) { Patches::None } else { Patches::BySource }
}

fn taken_over(step: &Step, rung: u32, action: Action) -> Step {
    let note = step.note.clone().unwrap_or_else(|| TAKEN_OVER.to_owned());
    Step { rung, action, tier: tier_of(action), milliseconds: 0.0, note: Some(note), failure: None, ..step.clone() }
}

fn validation(rung: u32, start: Duration, context: &Context<'_>) -> Step {
    let milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    Step { milliseconds, ..Step::new(rung, 0, Action::Validate, None) }
}

/// The share of the whole repair, in percent, that a rung is taken to be: each is half of what is left, since later ones
/// seldom run.
fn span(rung: u32) -> Range<u8> {
    let begin = |rung: u32| 95 - (80 >> rung.min(7));
    begin(rung)..begin(rung + 1)
}

/// How far the whole is when `done` of `tasks` are done.
fn percent(span: &Range<u8>, done: usize, tasks: usize) -> u8 {
    let width = usize::from(span.end.saturating_sub(span.start));
    span.start + u8::try_from(width * done / tasks.max(1)).unwrap_or(0)
}
