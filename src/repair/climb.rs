use std::ops::Range;
use std::time::Duration;

use super::input::Input;
use super::presets::{planned, remesh_action};
use super::tiers::{End, Runner};
use super::verdict::{JudgeError, Judged, Patches, judge};
use super::{
    Action, Cancelled, Candidate, Context, Preset, RedFlagCode, Remesher, Rung, Stage, Step, StepStatus, When, summary,
};
use crate::mesh::{NO_SOURCE, Surface};

/// The way up a plan's rungs: what was done so far, and the best that came of it.
pub(super) struct Climb<'a> {
    input: &'a Input<'a>,
    runner: Runner<'a>,
    /// What the opening left, from which every rung starts.
    pub surface: Surface,
    opened: End,
    /// How far the opening moved vertices, at most.
    moved: f64,
    opening: Vec<Step>,
    best: Option<(usize, Judged)>,
    candidates: Vec<Candidate>,
    /// Whether a result was left open, or lost surface that can be seen.
    left_sheets: bool,
}

/// What a climb brought.
pub(super) struct Climbed {
    pub steps: Vec<Step>,
    pub candidates: Vec<Candidate>,
    /// The best candidate, with its place in the list.
    pub best: Option<(usize, Judged)>,
}

/// The two actions that every recipe begins with.
const OPENING: [Action; 2] = [Action::BasicCleanup, Action::FixNormals];

impl<'a> Climb<'a> {
    /// Runs the opening that every rung shares; what it leaves is what tells a sheet from a solid with holes.
    pub fn open(input: &'a Input<'a>, mut runner: Runner<'a>) -> Result<Self, Cancelled> {
        let mut surface = input.analysis.surface.clone();
        let actions = OPENING.map(|action| planned(action, runner.options)).to_vec();
        let rung = Rung { when: When::NothingGood, tier: 1, preset: Preset::BasicCleanup, actions };
        let opened = runner.run(0, &rung, 0, &(5..15), &mut surface)?;
        let (opening, moved) = (runner.steps.clone(), runner.moved);
        Ok(Self {
            input,
            runner,
            surface,
            opened,
            moved,
            opening,
            best: None,
            candidates: Vec::new(),
            left_sheets: false,
        })
    }

    /// Climbs until a result is good.
    pub fn run(mut self, rungs: &[Rung]) -> Result<Climbed, Cancelled> {
        for (index, rung) in (0u32..).zip(rungs) {
            let step = not_runnable(index, rung, self.runner.remesher, self.runner.context);
            if let Some(step) = step.or_else(|| self.needless(index, rung)) {
                self.note(step);
            } else if let Some(result) = self.make(index, rung)?
                && self.judge(index, rung, &result)?
            {
                break;
            }
        }
        Ok(Climbed { steps: self.runner.steps, candidates: self.candidates, best: self.best })
    }

    /// The step that says why a rung is passed over, where what came before it makes it needless.
    fn needless(&self, index: u32, rung: &Rung) -> Option<Step> {
        let whole = || self.best.as_ref().is_some_and(|(_, best)| best.is_whole());
        let why = match rung.when {
            When::SheetsLeft if !self.candidates.is_empty() && !self.left_sheets => {
                "the rungs before it left nothing open and lost no surface"
            }
            When::NothingWhole if whole() => "the best result before it is closed and whole",
            _ => return None,
        };
        let last = rung.actions.iter().rev().map(|it| it.action).find(|&it| it != Action::Validate)?;
        let skipped = Step::new(index, rung.tier, last, None);
        Some(Step { status: StepStatus::Skipped, note: Some(why.to_owned()), ..skipped })
    }

    /// What a rung makes, if anything.
    fn make(&mut self, index: u32, rung: &Rung) -> Result<Option<Surface>, Cancelled> {
        if index > 0 {
            self.runner.steps.extend(self.opening.iter().cloned().map(|step| taken_over(step, index)));
        }
        let mut result = self.surface.clone();
        self.runner.moved = self.moved;
        let end = match self.opened {
            End::Finished => self.runner.run(index, rung, OPENING.len(), &span(index), &mut result)?,
            End::Nothing => End::Nothing,
            End::OutOfTime => End::OutOfTime,
        };
        Ok((!matches!(end, End::Nothing) && !result.faces.is_empty()).then_some(result))
    }

    /// Judges a result and keeps it if it is the best so far. Whether it is good.
    fn judge(&mut self, index: u32, rung: &Rung, result: &Surface) -> Result<bool, Cancelled> {
        let Runner { options, format, context, .. } = self.runner;
        context.report(Stage::Verify, Some(rung.tier), span(index).end);
        let start = context.now();
        let anew = result.source.iter().all(|&source| source == NO_SOURCE);
        let patches = if anew { Patches::None } else { Patches::BySource };
        let verdict = judge(result, patches, format, self.input.original, options, context);
        let mut step = validation(index, start, context);
        let mut good = false;
        match verdict {
            Ok(judged) => {
                step.note = Some(summary::verdict_in_words(&judged));
                self.candidates.push(Candidate::new(Some(index), &judged, false));
                let lost = judged.red_flags.iter().any(|flag| flag.code == RedFlagCode::SurfaceLost);
                self.left_sheets |= lost || judged.measures.boundary_edges > 0;
                good = judged.is_good();
                if self.best.as_ref().is_none_or(|(_, best)| judged.rank() < best.rank()) {
                    self.best = Some((self.candidates.len() - 1, judged));
                }
            }
            Err(JudgeError::Cancelled(stop)) => return Err(stop),
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
            }
        }
        self.note(step);
        Ok(good)
    }

    fn note(&mut self, step: Step) {
        self.runner.log(&step);
        self.runner.steps.push(step);
    }
}

impl Candidate {
    pub(super) fn new(rung: Option<u32>, judged: &Judged, chosen: bool) -> Self {
        Self {
            rung,
            printable: judged.measures.printable(),
            defects: judged.measures.defects(),
            faces: judged.measures.faces,
            red_flags: judged.red_flags.clone(),
            chosen,
        }
    }
}

/// The step that says why a rung is passed over, if it is.
fn not_runnable(index: u32, rung: &Rung, remesher: Option<&dyn Remesher>, context: &Context<'_>) -> Option<Step> {
    let action = rung.actions.iter().map(|planned| planned.action).find(|&a| remesh_action(a).is_some())?;
    let why = if context.remaining().is_zero() {
        "the time was over before it could start".to_owned()
    } else {
        let missing = remesher.map_or(Err("Blender is not installed on this server"), |r| r.info().map(drop)).err()?;
        format!("{missing}; the best result without tier 3 is handed out")
    };
    Some(Step { status: StepStatus::Skipped, note: Some(why), ..Step::new(index, 3, action, None) })
}

fn taken_over(step: Step, rung: u32) -> Step {
    let note = step.note.unwrap_or_else(|| "its result was taken over from the first rung".to_owned());
    Step { rung, milliseconds: 0.0, note: Some(note), ..step }
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
