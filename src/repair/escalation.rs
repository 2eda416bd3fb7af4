//! The escalation through a plan's strategies, until a result is good.

use std::ops::Range;
use std::time::Duration;

use super::input::Input;
use super::judge::{Finding, JudgeError, Judged, Judging, Method, Patches, explain_by_agreement, verdict_in_words};
use super::operators::{Counter, Counts};
use super::options::{Operator, Preset};
use super::prefix_cache::{Known, PrefixCache, START, shared_prefixes};
use super::presets::{planned, remesh_action, remesh_of, tier_of};
use super::remesher::Remesher;
use super::report::{
    Action, Candidate, OmittedSection, PlannedAction, RedFlag, RedFlagCode, Step, StepStatus, Strategy, When,
};
use super::runner::{End, Runner, TaskRun};
use super::sheets::{SHEET_SHARE, open_sheet_share};
use super::tasks::{Crossings, ExecutedStep, IndexedStrategy, State, Task};
use crate::context::{Cancelled, Context, Stage};
use crate::mesh::Surface;

/// The escalation: what was done so far, and the best result of it.
pub(super) struct Escalation<'a> {
    input: &'a Input<'a>,
    runner: Runner<'a>,
    opening: Opening,
    cache: PrefixCache,
    validations: Vec<Validation>,
    attempts: Attempts,
    /// Whether a result was left open, or lost surface that can be seen.
    left_sheets: bool,
    /// What methods found wrong with their own results.
    findings: Vec<Finding>,
    /// Whether two methods of different kind found the same.
    methods_agree: bool,
    /// Whether the native remesh made something printable.
    has_printable_remesh: bool,
}

/// The opening that every strategy shares.
struct Opening {
    /// The surface that it left, from which every strategy starts.
    state: State,
    end: End,
    steps: Vec<Step>,
}

/// What a strategy made.
enum Made {
    Nothing,
    /// A surface, and its number.
    New(u32, Box<State>),
    /// A surface that was judged before, by the index of its validation.
    Judged(usize),
}

/// The validation of a surface that is not good enough.
struct Validation {
    surface: u32,
    patches: Patches,
    candidate: usize,
    step: Step,
}

/// What the strategies did.
pub(super) struct Attempts {
    pub steps: Vec<ExecutedStep>,
    pub candidates: Vec<Candidate>,
    /// The best candidate, with its place in the list.
    pub best: Option<(usize, Judged)>,
}

/// The two actions that every recipe begins with.
const OPENING: [Action; 2] = [Action::BasicCleanup, Action::FixNormals];

impl<'a> Escalation<'a> {
    /// Runs the opening that every strategy shares; what it leaves is what tells a sheet from a solid with holes.
    pub fn open(input: &'a Input<'a>, runner: Runner<'a>, cache: PrefixCache) -> Result<Self, Cancelled> {
        let opening = Opening::run(input, &runner)?;
        let steps = opening.steps.iter().map(|step| step.clone().into()).collect();
        Ok(Self {
            input,
            runner,
            opening,
            cache,
            validations: Vec::new(),
            attempts: Attempts { steps, candidates: Vec::new(), best: None },
            left_sheets: false,
            findings: Vec::new(),
            methods_agree: false,
            has_printable_remesh: false,
        })
    }

    /// Share of the area in open sheets, as the opening left them. Where they look like the whole model, cracks are stitched first for
    /// trial: the patches of a cracked solid are sheets only as long as they are apart.
    pub fn sheet_share(&self) -> Result<f64, Cancelled> {
        let share = open_sheet_share(&self.opening.state.surface);
        if share < SHEET_SHARE || self.runner.options.max_tier < tier_of(Action::Stitch) {
            return Ok(share);
        }
        let actions = vec![planned(Action::Stitch, self.runner.options)];
        let strategy = Strategy { when: When::NothingAcceptable, tier: 2, preset: Preset::FullRepair, actions };
        let mut state = self.opening.state.clone();
        for task in Task::of(&strategy, 0) {
            if self.runner.run(IndexedStrategy { index: 0, strategy: &strategy }, task, 15, &mut state)?.end
                != End::Finished
            {
                return Ok(share);
            }
        }
        Ok(open_sheet_share(&state.surface))
    }

    /// Runs strategies until a result is good.
    pub fn run(mut self, strategies: &[Strategy]) -> Result<Attempts, Cancelled> {
        for (index, strategy) in (0u32..).zip(strategies) {
            let later = &strategies[index as usize + 1..];
            let strategy = IndexedStrategy { index, strategy };
            let step = self.out_of_time(strategy).or_else(|| self.needless(strategy));
            // Last, since it starts Blender to learn its version.
            if let Some(step) = step.or_else(|| not_runnable(strategy, self.runner.remesher)) {
                self.note(step.into());
                continue;
            }
            let is_good = match self.make(strategy, later)? {
                Made::Nothing => false,
                Made::New(number, result) => self.judge(strategy, number, &result)?,
                Made::Judged(validation) => {
                    self.judge_alike(index, validation);
                    false
                }
            };
            if is_good {
                break;
            }
        }
        Ok(self.attempts)
    }

    /// The step that says that a strategy is passed over, where there is no time to run it and to verify what it makes.
    fn out_of_time(&self, IndexedStrategy { index, strategy }: IndexedStrategy<'_>) -> Option<Step> {
        let Runner { context, time, .. } = self.runner;
        let faces = self.opening.state.surface.faces.len();
        if !time.for_operators(faces, context).is_late() {
            return None;
        }
        time.leave_out(OmittedSection::Repair);
        // What the opening brought is better than nothing.
        let opened = self.attempts.candidates.is_empty()
            && self.opening.state.surface.faces != self.input.analysis.surface.faces;
        if opened && remesh_of(strategy).is_none() && time.can_verify(faces, context) {
            return None;
        }
        let last = strategy.actions.iter().rev().map(|it| it.action).find(|&it| it != Action::Validate)?;
        let note = Some("the time was over before it could start".to_owned());
        Some(Step { status: StepStatus::Skipped, note, ..Step::new(index, strategy.tier, last, None) })
    }

    /// The step that says why a strategy is passed over, where what came before it makes it needless.
    fn needless(&self, IndexedStrategy { index, strategy }: IndexedStrategy<'_>) -> Option<Step> {
        let whole = || self.attempts.best.as_ref().is_some_and(|(_, best)| best.is_whole());
        let why = match strategy.when {
            When::OpenSheetsRemain if !self.attempts.candidates.is_empty() && !self.left_sheets => {
                "the strategies before it left nothing open and lost no surface"
            }
            When::NothingClosed if whole() => "the best result before it is closed and whole",
            _ if self.methods_agree && Method::of(strategy) == Some(Method::Blender) => {
                "methods of different kind agree on the red flags, so the input is their cause"
            }
            _ if remesh_of(strategy) == Some(Action::VoxelRemesh) && self.has_printable_remesh => {
                "the native remesh made a printable solid of the same inside, so its red flags would come back"
            }
            _ if remesh_of(strategy) == Some(Action::BooleanUnion) && has_boundary(&self.opening.state.surface) => {
                "parts with holes enclose nothing that could be united"
            }
            _ if self.encloses_other_volume()
                && matches!(Method::of(strategy), Some(Method::Grid | Method::Blender)) =>
            {
                "it starts from the same closed holes, so it encloses the same room"
            }
            _ => return None,
        };
        let last = strategy.actions.iter().rev().map(|it| it.action).find(|&it| it != Action::Validate)?;
        let skipped = Step::new(index, strategy.tier, last, None);
        Some(Step { status: StepStatus::Skipped, note: Some(why.to_owned()), ..skipped })
    }

    /// Whether all that is wrong with the best result is how much an open input's closed holes enclose.
    fn encloses_other_volume(&self) -> bool {
        let is_of_holes =
            |flag: &RedFlag| matches!(flag.code, RedFlagCode::VolumeChange | RedFlagCode::SurfaceInvented);
        let best = self.attempts.best.as_ref().map(|(_, best)| best);
        !self.input.original.measures().closed
            && best.is_some_and(|it| it.measures.printable() && it.red_flags.iter().all(is_of_holes))
    }

    /// What a strategy makes. What strategies before it did is reused.
    fn make(&mut self, indexed: IndexedStrategy<'_>, later: &[Strategy]) -> Result<Made, Cancelled> {
        let IndexedStrategy { index, strategy } = indexed;
        if index > 0 {
            let opening = self.opening.steps.iter().map(|step| ExecutedStep::reused(step, index, step.action));
            self.attempts.steps.extend(opening);
        }
        let tasks = Task::of(strategy, OPENING.len());
        let mut prefix = self.known_prefix(strategy, &tasks);
        let comes_to = |prefix: &[Reused]| prefix.last().map_or(START, |it| it.surface);
        let number = comes_to(&prefix);
        let is_same = |it: &Validation| it.surface == number && it.patches == patches_of(strategy);
        let validation = self.validations.iter().position(is_same).filter(|_| prefix.len() == tasks.len());
        if validation.is_none() {
            // On from the last surface that is at hand.
            while !prefix.is_empty() && comes_to(&prefix) != START && self.cache.kept(comes_to(&prefix)).is_none() {
                prefix.pop();
            }
        }
        for (task, Known { step, .. }) in
            tasks.iter().zip(&prefix).filter_map(|(task, it)| Some((task, it.known.as_ref()?)))
        {
            self.attempts.steps.push(ExecutedStep::reused(step, index, task.action));
        }
        match validation {
            Some(validation) => Ok(Made::Judged(validation)),
            None => self.run_from(indexed, &tasks, &prefix, later),
        }
    }

    /// Runs the tasks of a strategy after those of its prefix that are known, of which the surface is at hand.
    fn run_from(
        &mut self,
        indexed: IndexedStrategy<'_>,
        tasks: &[Task],
        prefix: &[Reused],
        later: &[Strategy],
    ) -> Result<Made, Cancelled> {
        let IndexedStrategy { index, strategy } = indexed;
        let options = self.runner.options;
        let mut number = prefix.last().map_or(START, |it| it.surface);
        let mut end = self.opening.end;
        let mut state = self.cache.kept(number).unwrap_or(&self.opening.state).clone();
        let mut crossings = Crossings::Unknown;
        for Known { step, failure, .. } in prefix.iter().filter_map(|it| it.known.as_ref()) {
            crossings = crossings.after(step, failure.as_ref());
            state.note_holes(step);
        }
        let turn_offs = shared_prefixes(strategy, later, OPENING.len(), options);
        for (at, &task) in tasks.iter().enumerate().skip(prefix.len()) {
            if end != End::Finished {
                break;
            }
            if !crossings.make_needless(task) {
                let percent = percent(&span(index), at, tasks.len());
                let run = self.runner.run(indexed, task, percent, &mut state)?;
                let TaskRun { step, failure, has_changed, .. } = run;
                end = run.end;
                crossings = crossings.after(&step, failure.as_ref());
                number = match task.key(strategy, options).filter(|_| end == End::Finished) {
                    Some(key) => self.cache.learn(number, key, has_changed, (&step, failure.as_ref())),
                    None if has_changed => self.cache.new_number(),
                    None => number,
                };
                self.attempts.steps.push(step.into());
            }
            if turn_offs.contains(&(at + 1)) {
                self.cache.keep(number, at + 1, &state);
            }
        }
        let is_nothing = end == End::Nothing || state.surface.faces.is_empty();
        Ok(if is_nothing { Made::Nothing } else { Made::New(number, Box::new(state)) })
    }

    /// How far it is known what a strategy does.
    fn known_prefix(&self, strategy: &Strategy, tasks: &[Task]) -> Vec<Reused> {
        let (mut surface, mut crossings) = (START, Crossings::Unknown);
        let mut prefix = Vec::new();
        for &task in tasks {
            let mut known = None;
            if !crossings.make_needless(task) {
                let found = task.key(strategy, self.runner.options).and_then(|key| self.cache.known(surface, key));
                let Some(found) = found else { break };
                surface = found.surface;
                crossings = crossings.after(&found.step, found.failure.as_ref());
                known = Some(found.clone());
            }
            prefix.push(Reused { surface, known });
        }
        prefix
    }

    /// Reuses the validation of the same surface.
    fn judge_alike(&mut self, index: u32, validation: usize) {
        let Validation { candidate, step, .. } = &self.validations[validation];
        let candidate = self.attempts.candidates[*candidate].clone();
        let step = ExecutedStep::reused(step, index, Action::Validate);
        self.attempts.candidates.push(Candidate { strategy: Some(index), ..candidate });
        self.note(step);
    }

    /// Judges a result and keeps it if it is the best so far. Whether it is good.
    fn judge(&mut self, indexed: IndexedStrategy<'_>, number: u32, result: &State) -> Result<bool, Cancelled> {
        let IndexedStrategy { index, strategy } = indexed;
        let Runner { options, format, context, time, .. } = self.runner;
        context.report(Stage::Verify, Some(strategy.tier), span(index).end);
        let start = context.now();
        let patches = patches_of(strategy);
        let verdict = if time.can_verify(result.surface.faces.len(), context) {
            let judging = Judging { format, input: self.input.original, options, context };
            judging.judge(&result.surface, patches, result.invented.as_ref())
        } else {
            Err(JudgeError::Cancelled(Cancelled))
        };
        let mut step = validation(index, start, context);
        let mut is_good = false;
        match verdict {
            Ok(judged) => {
                time.note_verification(result.surface.faces.len(), context.now().saturating_sub(start));
                is_good = self.compare(indexed, judged, &mut step);
                let candidate = self.attempts.candidates.len() - 1;
                self.validations.push(Validation { surface: number, patches, candidate, step: step.clone() });
            }
            Err(JudgeError::Cancelled(stop)) if context.is_cancelled() => return Err(stop),
            Err(JudgeError::Cancelled(_)) => {
                time.leave_out(OmittedSection::Verification);
                step.status = StepStatus::Failed;
                step.note = Some("the time was over before it was verified, so it is not handed out".to_owned());
            }
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
            }
        }
        self.note(step.into());
        Ok(is_good)
    }

    /// Compares a judged result with those before it, and keeps it if it is the best. Whether it is good, or the best before it.
    fn compare(
        &mut self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
        mut judged: Judged,
        step: &mut Step,
    ) -> bool {
        self.compare_methods(strategy, &mut judged);
        self.has_printable_remesh |= Method::of(strategy) == Some(Method::Grid) && judged.measures.printable();
        step.note = Some(verdict_in_words(&judged));
        self.attempts.candidates.push(Candidate::new(Some(index), &judged, false));
        let lost = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::SurfaceLost);
        self.left_sheets |= lost || judged.measures.boundary_edges > 0;
        let best = &mut self.attempts.best;
        let is_good = judged.is_final() || best.as_ref().is_some_and(|(_, best)| best.is_final());
        if best.as_ref().is_none_or(|(_, best)| judged.rank() < best.rank()) {
            *best = Some((self.attempts.candidates.len() - 1, judged));
        }
        is_good
    }

    /// Looks whether a method of another kind found the same wrong with its result. If so, that is a property of the input.
    fn compare_methods(&mut self, strategy: &Strategy, judged: &mut Judged) {
        let Some(own) = Finding::of(strategy, judged) else { return };
        if self.findings.iter().any(|other| own.agrees_with(other)) {
            self.methods_agree = true;
            explain_by_agreement(judged);
            if let Some((candidate, best)) = &mut self.attempts.best
                && best.measures.printable()
                && own.is_of(best)
            {
                explain_by_agreement(best);
                self.attempts.candidates[*candidate].red_flags.clone_from(&best.red_flags);
            }
        }
        self.findings.push(own);
    }

    fn note(&mut self, step: ExecutedStep) {
        self.runner.log(&step.step);
        self.attempts.steps.push(step);
    }
}

impl Opening {
    fn run(input: &Input<'_>, runner: &Runner<'_>) -> Result<Self, Cancelled> {
        let actions = OPENING.map(|action| planned(action, runner.options)).to_vec();
        let strategy = Strategy { when: When::NothingAcceptable, tier: 1, preset: Preset::BasicCleanup, actions };
        let mut opening =
            Self { state: State::new(input.analysis.surface.clone()), end: End::Finished, steps: Vec::new() };
        let tasks = Task::of(&strategy, 0);
        for (at, &task) in tasks.iter().enumerate() {
            let percent = percent(&(5..15), at, tasks.len());
            let run =
                runner.run(IndexedStrategy { index: 0, strategy: &strategy }, task, percent, &mut opening.state)?;
            opening.steps.push(run.step);
            opening.end = run.end;
            if opening.end != End::Finished {
                break;
            }
        }
        Ok(opening)
    }
}

/// A task of which it is known what it does.
struct Reused {
    /// The number of the surface that it comes to.
    surface: u32,
    /// What its operator did; none where it is needless.
    known: Option<Known>,
}

/// The step that says why a strategy is passed over, if it is.
fn not_runnable(
    IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
    remesher: Option<&dyn Remesher>,
) -> Option<Step> {
    let action = remesh_of(strategy)?;
    let missing = remesher.map_or(Err("Blender is not installed on this server"), |r| r.info().map(drop)).err()?;
    let why = format!("{missing}; the best result without tier 3 is handed out");
    Some(Step { status: StepStatus::Skipped, note: Some(why), ..Step::new(index, 3, action, None) })
}

fn has_boundary(surface: &Surface) -> bool {
    Counts::of(surface).get(Counter::BoundaryEdges) > 0
}

fn patches_of(strategy: &Strategy) -> Patches {
    let remeshes = |planned: &PlannedAction| {
        remesh_action(planned.action).is_some() || planned.operators.contains(&Operator::Remesh)
    };
    if strategy.actions.iter().any(remeshes) { Patches::None } else { Patches::BySource }
}

fn validation(strategy: u32, start: Duration, context: &Context<'_>) -> Step {
    let milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    Step { milliseconds, ..Step::new(strategy, 0, Action::Validate, None) }
}

/// The share of the whole repair, in percent, that a strategy is taken to be: each is half of what is left, since later ones
/// seldom run.
fn span(index: u32) -> Range<u8> {
    let begin = |index: u32| 95 - (80 >> index.min(7));
    begin(index)..begin(index + 1)
}

/// How far the whole is when `done` of `tasks` are done.
fn percent(span: &Range<u8>, done: usize, tasks: usize) -> u8 {
    let width = usize::from(span.end.saturating_sub(span.start));
    span.start + u8::try_from(width * done / tasks.max(1)).unwrap_or(0)
}
