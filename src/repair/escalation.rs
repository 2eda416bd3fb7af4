//! The escalation: runs a plan's strategies one after another until a result is good enough.
//!
//! All strategies begin with the same actions, the common start. It runs once, and each strategy continues from its surface. Operators that
//! an earlier strategy already ran on the same surface are not run again (see [`PrefixCache`]).

mod skipping;

use std::ops::Range;
use std::time::Duration;

use super::common_start::{COMMON_ACTIONS, CommonStart, percent};
use super::input::Input;
use super::judge::{JudgeError, Judged, Judging, Patches, verdict_text};
use super::method_agreement::{Method, MethodFinding, explain_by_agreement};
use super::operators::Failure;
use super::options::Operator;
use super::prefix_cache::{KnownResult, PrefixCache, START, TaskKey, shared_prefixes};
use super::presets::remesh_action;
use super::report::{Action, Candidate, OmittedSection, PlannedAction, RedFlagCode, Step, StepStatus, Strategy, When};
use super::runner::{Runner, TaskEnd, TaskRun};
use super::tasks::{ExecutedStep, IndexedStrategy, Intersections, SurfaceState, Task};
use crate::arrange::ArrangeError;
use crate::context::{Cancelled, Context, Stage};
use crate::inspect::Measures;

/// The state of an escalation: the attempts so far, and what they showed about the input.
pub(super) struct Escalation<'a> {
    input: &'a Input<'a>,
    runner: Runner<'a>,
    common_start: CommonStart,
    cache: PrefixCache,
    validations: Vec<Validation>,
    attempts: Attempts,
    /// Whether a result was open or had lost visible surface: signs that the input has open sheets.
    may_have_open_sheets: bool,
    /// For each method that gave a result, the red flags of the result.
    findings: Vec<MethodFinding>,
    /// Whether two independent methods raised the same red flags.
    methods_agree: bool,
    /// Whether the native remesh made a printable result.
    has_printable_remesh: bool,
    /// Whether a forecast showed that no remesh on a grid can beat the best result.
    is_remesh_hopeless: bool,
    /// Whether too many faces intersected for a self-union after open sheets were closed.
    is_tangled: bool,
    /// Whether a result of many faces stayed non-manifold nearly everywhere (see [`is_shredded`]).
    is_shredded: bool,
}

/// The result of a strategy's operators.
enum StrategyResult {
    /// No surface.
    Nothing,
    /// A surface with its number in the prefix cache.
    New(u32, Box<SurfaceState>),
    /// A surface that was judged before; the index of its validation.
    Judged(usize),
}

/// The validation of a surface, which later strategies with the same surface reuse.
struct Validation {
    /// The number of the surface in the prefix cache.
    surface: u32,
    patches: Patches,
    /// The index of the judged result in `Attempts::candidates`.
    candidate: usize,
    step: Step,
}

/// The steps and results of all strategies.
pub(super) struct Attempts {
    /// The steps in order.
    pub steps: Vec<ExecutedStep>,
    /// The results that were judged, in order.
    pub candidates: Vec<Candidate>,
    /// The best result, with its index in `candidates`.
    pub best: Option<(usize, Judged)>,
}

impl<'a> Escalation<'a> {
    /// Runs the common start of all strategies. Its surface shows whether the input is an open sheet or a solid with holes.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled.
    pub fn start(input: &'a Input<'a>, runner: Runner<'a>, cache: PrefixCache) -> Result<Self, Cancelled> {
        let common_start = CommonStart::run(input, &runner)?;
        let steps = common_start.steps.iter().map(|step| step.clone().into()).collect();
        Ok(Self {
            input,
            runner,
            common_start,
            cache,
            validations: Vec::new(),
            attempts: Attempts { steps, candidates: Vec::new(), best: None },
            may_have_open_sheets: false,
            findings: Vec::new(),
            methods_agree: false,
            has_printable_remesh: false,
            is_remesh_hopeless: false,
            is_tangled: false,
            is_shredded: false,
        })
    }

    /// Share of the area in open sheets after the common start, from 0 to 1.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled.
    pub fn sheet_share(&self) -> Result<f64, Cancelled> {
        self.common_start.sheet_share(&self.runner)
    }

    /// Runs strategies until a result is good enough.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled.
    pub fn run(mut self, strategies: &[Strategy]) -> Result<Attempts, Cancelled> {
        for (index, strategy) in (0u32..).zip(strategies) {
            // Every strategy begins with the common start, so none has a result if no face was left after it.
            if index > 0 && self.common_start.end == TaskEnd::Nothing {
                break;
            }
            let later = &strategies[index as usize + 1..];
            let strategy = IndexedStrategy { index, strategy };
            let step = self.skipped_for_time(strategy).or_else(|| self.skipped_as_needless(strategy));
            // The check for Blender comes last because it starts Blender to learn its version.
            if let Some(step) = step.or_else(|| self.skipped_without_blender(strategy)) {
                self.record(step.into());
                continue;
            }
            let is_good = match self.run_strategy(strategy, later)? {
                StrategyResult::Nothing => false,
                StrategyResult::New(number, result) => self.judge(strategy, number, &result)?,
                StrategyResult::Judged(validation) => {
                    self.reuse_validation(index, validation);
                    false
                }
            };
            if is_good {
                break;
            }
        }
        Ok(self.attempts)
    }

    /// Runs a strategy, and reuses the steps that it shares with earlier strategies.
    fn run_strategy(&mut self, indexed: IndexedStrategy<'_>, later: &[Strategy]) -> Result<StrategyResult, Cancelled> {
        let IndexedStrategy { index, strategy } = indexed;
        if index > 0 {
            let common_start =
                self.common_start.steps.iter().map(|step| ExecutedStep::reused(step, index, step.action));
            self.attempts.steps.extend(common_start);
        }
        let tasks = Task::of(strategy, COMMON_ACTIONS.len());
        let mut prefix = self.known_tasks(strategy, (START, Intersections::Unknown), &tasks);
        if let Some(validation) = self.known_rest(indexed, START, &tasks, &prefix) {
            return Ok(StrategyResult::Judged(validation));
        }
        // Continue from the last surface that the cache still holds.
        while let Some(&KnownTask { surface, .. }) = prefix.last()
            && surface != START
            && self.cache.kept(surface).is_none()
        {
            prefix.pop();
        }
        self.record_reused(index, &tasks, &prefix);
        self.run_from(indexed, &tasks, &prefix, later)
    }

    /// The validation of a strategy's result, if the results of all its remaining `tasks` are `known` and the last was validated. `before` is
    /// the number of the surface before them. Records the reused steps.
    fn known_rest(
        &mut self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
        before: u32,
        tasks: &[Task],
        known: &[KnownTask],
    ) -> Option<usize> {
        let result = known.last().map_or(before, |known_task| known_task.surface);
        let is_same = |other: &Validation| other.surface == result && other.patches == patches_of(strategy);
        let validation = self.validations.iter().position(is_same).filter(|_| known.len() == tasks.len())?;
        self.record_reused(index, tasks, known);
        Some(validation)
    }

    /// Appends the steps of tasks whose results are known.
    fn record_reused(&mut self, index: u32, tasks: &[Task], known: &[KnownTask]) {
        for (task, KnownResult { step, .. }) in
            tasks.iter().zip(known).filter_map(|(task, known_task)| Some((task, known_task.known.as_ref()?)))
        {
            self.attempts.steps.push(ExecutedStep::reused(step, index, task.action));
        }
    }

    /// Runs the tasks of a strategy that follow its known prefix, from the cached surface after that prefix.
    fn run_from(
        &mut self,
        indexed: IndexedStrategy<'_>,
        tasks: &[Task],
        prefix: &[KnownTask],
        later: &[Strategy],
    ) -> Result<StrategyResult, Cancelled> {
        let IndexedStrategy { index, strategy } = indexed;
        let options = self.runner.options;
        let mut number = prefix.last().map_or(START, |known_task| known_task.surface);
        let mut end = self.common_start.end;
        let mut state = self.cache.kept(number).unwrap_or(&self.common_start.state).clone();
        self.cache.drop_before(index as usize);
        // Edges take much memory while a result is judged. The first strategy has a use for those of the common start.
        self.common_start.state.edges = None;
        let mut intersections = Intersections::Unknown;
        // Known steps are not run again, but their findings about intersections and open holes still apply.
        for KnownResult { step, failure, .. } in prefix.iter().filter_map(|known_task| known_task.known.as_ref()) {
            intersections = intersections.after(step, failure.as_ref());
            state.record_holes(step);
        }
        let shared_lengths = shared_prefixes(strategy, later, COMMON_ACTIONS.len(), options);
        for (at, &task) in tasks.iter().enumerate().skip(prefix.len()) {
            if end != TaskEnd::Finished {
                break;
            }
            if let Some(step) = self.skipped_by_forecast(indexed, task, &state)? {
                self.record(step.into());
                return Ok(StrategyResult::Nothing);
            }
            if !intersections.makes_needless(task) {
                let percent = percent(&span(index), at, tasks.len());
                let run = self.runner.run(indexed, task, percent, &mut state)?;
                let TaskRun { step, failure, has_changed, .. } = run;
                end = run.end;
                intersections = intersections.after(&step, failure.as_ref());
                number = match TaskKey::of(task, strategy, options).filter(|_| end == TaskEnd::Finished) {
                    Some(key) => self.cache.learn(number, key, has_changed, (&step, failure.as_ref())),
                    None if has_changed => self.cache.new_number(),
                    None => number,
                };
                self.attempts.steps.push(step.into());
                // An operator without effect can lead back to the surface of an earlier strategy.
                if !has_changed && end == TaskEnd::Finished {
                    let rest = &tasks[at + 1..];
                    let known = self.known_tasks(strategy, (number, intersections), rest);
                    if let Some(validation) = self.known_rest(indexed, number, rest, &known) {
                        return Ok(StrategyResult::Judged(validation));
                    }
                }
                // Too many faces intersect for a self-union. The rest of this strategy would make the same mesh as a later strategy, which
                // keeps the overlaps.
                let is_tangled = matches!(failure, Some(Failure::Arrange(ArrangeError::Tangled(_))));
                self.is_tangled |= is_tangled && strategy.when == When::OpenSheetsRemain;
                if is_tangled && later.iter().any(|strategy| strategy.when == When::NothingClosed) {
                    return Ok(StrategyResult::Nothing);
                }
            }
            let sharing = (index as usize + 1..).zip(&shared_lengths).filter(|(_, length)| **length == at + 1);
            let sharing: Vec<usize> = sharing.map(|(strategy, _)| strategy).collect();
            if !sharing.is_empty() {
                self.cache.keep(number, at + 1, &state, sharing);
            }
        }
        state.edges = None;
        let is_nothing = end == TaskEnd::Nothing || state.surface.faces.is_empty();
        Ok(if is_nothing { StrategyResult::Nothing } else { StrategyResult::New(number, Box::new(state)) })
    }

    /// The first of `tasks` whose results are known from earlier strategies. `surface` is the number of the surface before them.
    fn known_tasks(
        &self,
        strategy: &Strategy,
        (mut surface, mut intersections): (u32, Intersections),
        tasks: &[Task],
    ) -> Vec<KnownTask> {
        let mut prefix = Vec::new();
        for &task in tasks {
            let mut known = None;
            if !intersections.makes_needless(task) {
                let cached =
                    TaskKey::of(task, strategy, self.runner.options).and_then(|key| self.cache.known(surface, key));
                let Some(cached) = cached else { break };
                surface = cached.surface;
                intersections = intersections.after(&cached.step, cached.failure.as_ref());
                known = Some(cached.clone());
            }
            prefix.push(KnownTask { surface, known });
        }
        prefix
    }

    /// Reuses the validation of the same surface by an earlier strategy.
    fn reuse_validation(&mut self, index: u32, validation: usize) {
        let Validation { candidate, step, .. } = &self.validations[validation];
        let candidate = self.attempts.candidates[*candidate].clone();
        let step = ExecutedStep::reused(step, index, Action::Validate);
        self.attempts.candidates.push(Candidate { strategy: Some(index), ..candidate });
        self.record(step);
    }

    /// Judges a result and keeps it if it is the best so far. Returns whether a good enough result is known.
    fn judge(&mut self, indexed: IndexedStrategy<'_>, number: u32, result: &SurfaceState) -> Result<bool, Cancelled> {
        let IndexedStrategy { index, strategy } = indexed;
        let Runner { options, format, context, time, .. } = self.runner;
        context.report(Stage::Verify, Some(strategy.tier), span(index).end);
        let start = context.now();
        let patches = patches_of(strategy);
        let verdict = if time.can_verify(result.surface.faces.len(), context) {
            let judging = Judging { format, input: self.input.original, options, context };
            judging.judge_with_requests(result, patches)
        } else {
            Err(JudgeError::Cancelled(Cancelled))
        };
        let mut step = validation_step(index, start, context);
        let mut is_good = false;
        match verdict {
            Ok(judged) => {
                time.record_verification(result.surface.faces.len(), context.now().saturating_sub(start));
                is_good = self.compare(indexed, judged, &mut step);
                let candidate = self.attempts.candidates.len() - 1;
                if !self.cache.is_disabled() {
                    self.validations.push(Validation { surface: number, patches, candidate, step: step.clone() });
                }
            }
            Err(JudgeError::Cancelled(stop)) if context.is_cancelled() => return Err(stop),
            Err(JudgeError::Cancelled(_)) => {
                time.omit(OmittedSection::Verification);
                step.status = StepStatus::Failed;
                step.note =
                    Some("the deadline passed before the result was verified, so it is not returned".to_owned());
            }
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
            }
        }
        self.record(step.into());
        Ok(is_good)
    }

    /// Compares a judged result with earlier ones and keeps it if it is the best. Returns whether this result or the best one so far is
    /// good enough.
    fn compare(
        &mut self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
        mut judged: Judged,
        step: &mut Step,
    ) -> bool {
        self.compare_methods(strategy, &mut judged);
        self.has_printable_remesh |= Method::of(strategy) == Some(Method::Grid) && judged.measures.printable();
        self.is_shredded |= is_shredded(&judged.measures);
        step.note = Some(verdict_text(&judged));
        self.attempts.candidates.push(Candidate::new(Some(index), &judged, false));
        let lost = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::SurfaceLost);
        self.may_have_open_sheets |= lost || judged.measures.boundary_edges > 0;
        let best = &mut self.attempts.best;
        let is_good = judged.is_final() || best.as_ref().is_some_and(|(_, best)| best.is_final());
        if best.as_ref().is_none_or(|(_, best)| judged.rank() < best.rank()) {
            *best = Some((self.attempts.candidates.len() - 1, judged));
        }
        is_good
    }

    /// Checks whether an independent method raised the same red flags. If so, they are a property of the input.
    fn compare_methods(&mut self, strategy: &Strategy, judged: &mut Judged) {
        let Some(own) = MethodFinding::of(strategy, judged) else { return };
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

    /// Logs a step and appends it to the attempts.
    fn record(&mut self, step: ExecutedStep) {
        self.runner.log(&step.step);
        self.attempts.steps.push(step);
    }
}

/// A task whose result is known from an earlier strategy.
struct KnownTask {
    /// The number of the surface after the task.
    surface: u32,
    /// The cached result of the operator; none if the task would change nothing and is not run.
    known: Option<KnownResult>,
}

/// Whether a surface of many faces has a non-manifold edge for every fourth face, like the cells of a volume mesh. Operators mend such edges
/// one by one. Where they left so many, others leave them as well.
fn is_shredded(measures: &Measures) -> bool {
    const MIN_FACES: u64 = 10_000;
    measures.faces >= MIN_FACES && 4 * measures.non_manifold_edges > measures.faces
}

/// Which faces of a strategy's result are patches of holes.
fn patches_of(strategy: &Strategy) -> Patches {
    let remeshes = |planned: &PlannedAction| {
        remesh_action(planned.action).is_some() || planned.operators.contains(&Operator::Remesh)
    };
    if strategy.actions.iter().any(remeshes) { Patches::None } else { Patches::BySource }
}

/// The step of a validation that began at `start`.
fn validation_step(strategy: u32, start: Duration, context: &Context<'_>) -> Step {
    let milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
    Step { milliseconds, ..Step::new(strategy, 0, Action::Validate, None) }
}

/// The range of a strategy in the progress of the whole repair, in percent. Each strategy gets half of the progress that earlier ones left,
/// because later strategies seldom run.
fn span(index: u32) -> Range<u8> {
    let begin = |index: u32| 95 - (80 >> index.min(7));
    begin(index)..begin(index + 1)
}
