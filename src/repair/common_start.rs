//! The common start: the actions that every strategy begins with run once, and every strategy continues from their surface.

use std::ops::Range;
use std::sync::Arc;

use super::input::Input;
use super::operators::Counts;
use super::operators::sheets::SHEET_SHARE;
use super::options::Preset;
use super::presets::{planned, tier_of};
use super::report::{Action, Step, Strategy, When};
use super::runner::{Runner, TaskEnd};
use super::tasks::{IndexedStrategy, SurfaceState, Task};
use crate::context::Cancelled;

/// The actions that every recipe begins with.
pub(super) const COMMON_ACTIONS: [Action; 2] = [Action::BasicCleanup, Action::FixNormals];

/// The result of the common start.
pub(super) struct CommonStart {
    /// The surface from which every strategy starts.
    pub state: SurfaceState,
    /// How the common start ended.
    pub end: TaskEnd,
    /// The steps of the common start.
    pub steps: Vec<Step>,
}

impl CommonStart {
    /// Runs the common actions on the input.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled.
    pub fn run(input: &Input<'_>, runner: &Runner<'_>) -> Result<Self, Cancelled> {
        let actions = COMMON_ACTIONS.map(|action| planned(action, runner.options)).to_vec();
        let strategy = &Strategy { when: When::NothingAcceptable, tier: 1, preset: Preset::BasicCleanup, actions };
        let mut state = SurfaceState::new(input.analysis.surface.clone());
        state.counts = Some(Counts::of_measured(input.analysis, &input.before.measures));
        state.edges = Some(Arc::clone(&input.analysis.edges));
        let (mut end, mut steps) = (TaskEnd::Finished, Vec::new());
        let tasks = Task::of(strategy, 0);
        for (at, &task) in tasks.iter().enumerate() {
            let percent = percent(&(5..15), at, tasks.len());
            let run = runner.run(IndexedStrategy { index: 0, strategy }, task, percent, &mut state)?;
            steps.push(run.step);
            end = run.end;
            if end != TaskEnd::Finished {
                break;
            }
        }
        Ok(Self { state, end, steps })
    }

    /// Share of the area in open sheets, from 0 to 1. If the whole model looks like a sheet, cracks are stitched on a copy first: the
    /// patches of a cracked solid look like sheets until they are joined.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled.
    pub fn sheet_share(&self, runner: &Runner<'_>) -> Result<f64, Cancelled> {
        let share = self.state.open_sheet_share();
        if share < SHEET_SHARE || runner.options.max_tier < tier_of(Action::Stitch) {
            return Ok(share);
        }
        let actions = vec![planned(Action::Stitch, runner.options)];
        let strategy = &Strategy { when: When::NothingAcceptable, tier: 2, preset: Preset::FullRepair, actions };
        let mut state = self.state.clone();
        for task in Task::of(strategy, 0) {
            if runner.run(IndexedStrategy { index: 0, strategy }, task, 15, &mut state)?.end != TaskEnd::Finished {
                return Ok(share);
            }
        }
        Ok(state.open_sheet_share())
    }
}

/// The progress of the whole repair, in percent, when `done` of `tasks` tasks in this range are done.
pub(super) fn percent(range: &Range<u8>, done: usize, tasks: usize) -> u8 {
    let width = usize::from(range.end.saturating_sub(range.start));
    range.start + u8::try_from(width * done / tasks.max(1)).unwrap_or(0)
}
