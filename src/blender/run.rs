//! One remesh request: the input for Blender, the runs of the program, and the choice of the result.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use glam::DVec3;

use super::exchange::{self, RawMesh, ReadResultError};
use super::find::{BPY, BlenderConfig, parse_version};
use super::frame::{Frame, for_boolean, for_voxels, originals, unframed};
use super::memory::{Slot, check_voxel_memory};
use super::process::{ERROR, isolate, run};
use crate::repair::{Context, RemeshAction, RemeshError, RemeshRequest, Remeshed, RemesherInfo, Stage};

/// The Python script that Blender runs.
const SCRIPT: &str = include_str!("script.py");
/// The first Blender version with the option `--offline-mode`.
const OFFLINE_MODE: (u32, u32) = (4, 2);
/// The smallest voxel of Blender's remesh modifier, in frame units.
const MIN_VOXEL: f64 = 1e-4;
/// The most faces to send.
const MAX_FACES: usize = 500_000_000;
/// The factor by which voxels grow, repeatedly, until the remesh fits into memory.
const COARSER: f64 = 1.25;
/// The factor by which voxels grow after a crash, once.
const AFTER_A_CRASH: f64 = 1.5;
/// From this number of faces on, a coarser remesh comes first. It takes a quarter of the time, and is the result if time runs out.
const MANY_FACES: f64 = 200_000.0;
/// The voxels of that first remesh are larger by this factor.
const STAGE: f64 = 2.0;
/// The exit code of the script after an unexpected error.
const SCRIPT_ERROR: &str = "3";

/// A program that was found, its configuration, and the number of its runs.
#[derive(Debug)]
pub(super) struct Program {
    /// The program's kind, version and path.
    pub info: RemesherInfo,
    /// The resources that it may use.
    pub config: BlenderConfig,
    /// How often it was started.
    pub runs: AtomicU32,
}

impl Program {
    fn command(&self, script: &Path) -> Command {
        let mut command = Command::new(&self.info.program);
        if self.info.kind == BPY {
            command.arg("-I").arg(script);
        } else {
            command.args(["--background", "--factory-startup", "-noaudio"]);
            if parse_version(&self.info.version).is_some_and(|version| version >= OFFLINE_MODE) {
                command.arg("--offline-mode");
            }
            command.args(["--python-exit-code", SCRIPT_ERROR, "--python"]).arg(script);
        }
        command
    }

    fn unreadable(&self, error: ReadResultError, request: &RemeshRequest<'_>) -> RemeshError {
        match error {
            ReadResultError::TooManyFaces(faces) => RemeshError::TooManyFaces { faces, most: request.max_faces },
            other => RemeshError::Failed(format!("{} ended, but {other}", self.info.program)),
        }
    }

    fn describe_crash(&self, status: ExitStatus, error: Option<String>) -> String {
        match error {
            Some(error) => format!("{} {}: {error}", self.info.kind, self.info.version),
            None => format!(
                "{} {} ended with {status}, possibly because memory ran out; the job's log has its output",
                self.info.kind, self.info.version
            ),
        }
    }
}

/// The work on one request.
pub(super) struct Work<'a> {
    program: &'a Program,
    request: &'a RemeshRequest<'a>,
    /// The mesh to send, in frame units.
    input: RawMesh,
    frame: Frame,
    context: &'a Context<'a>,
    time: TimeLimit,
}

impl<'a> Work<'a> {
    /// Prepares the work on a request.
    ///
    /// # Errors
    /// [`RemeshError`] when the mesh is empty, too large, or can't be scaled.
    pub fn new(
        program: &'a Program,
        request: &'a RemeshRequest<'a>,
        context: &'a Context<'a>,
    ) -> Result<Self, RemeshError> {
        let time = TimeLimit { begin: context.now(), limit: request.time_limit.min(context.remaining()) };
        time.check(context)?;
        let soup = request.soup;
        let corners = soup.faces.iter().flatten().filter_map(|&v| soup.positions.get(v as usize));
        if soup.faces.is_empty() {
            return Err(RemeshError::Empty);
        }
        let frame = Frame::around(corners.copied()).ok_or_else(|| {
            RemeshError::Failed(
                "the mesh can't be scaled: all its points coincide, are not finite, or are too large or too small"
                    .to_owned(),
            )
        })?;
        // Blender's counts of corners have 31 bits.
        if soup.faces.len() > MAX_FACES {
            let faces = soup.faces.len();
            return Err(RemeshError::Failed(format!(
                "the mesh has {faces} faces; Blender accepts at most {MAX_FACES}"
            )));
        }
        let input = match request.action {
            RemeshAction::VoxelRemesh => for_voxels(soup, frame),
            RemeshAction::BooleanUnion => for_boolean(soup, frame),
        };
        if input.faces.is_empty() {
            return Err(RemeshError::Empty);
        }
        let omitted = soup.faces.len() - input.faces.len();
        if omitted > 0 {
            let kind = &program.info.kind;
            context.log(&format!("{kind}: omitted {omitted} faces that have coinciding corners or are duplicates"));
        }
        Ok(Self { program, request, input, frame, context, time })
    }

    /// Runs the request's action.
    ///
    /// # Errors
    /// [`RemeshError`] when there is no result.
    pub fn remesh(&self) -> Result<Remeshed, RemeshError> {
        let remeshed = match self.request.action {
            RemeshAction::VoxelRemesh => self.voxels()?,
            RemeshAction::BooleanUnion => {
                let StageResult { mesh, note, .. } = self.run(&[0.0])?;
                let soup = unframed(&mesh, self.frame, &originals(self.request.soup, self.frame));
                Remeshed { soup, voxel_size: None, note }
            }
        };
        if remeshed.soup.faces.is_empty() { Err(RemeshError::Empty) } else { Ok(remeshed) }
    }

    /// Waits for a slot and runs the script once. `voxels` are the voxel sizes of its stages, coarsest first, in frame units. The
    /// result of an interrupted run is that of the last stage that finished.
    fn run(&self, voxels: &[f64]) -> Result<StageResult, Failed> {
        let Self { program, request, context, .. } = *self;
        let scratch = program.config.scratch_folder().map_err(|error| scratch_failed(&error))?;
        let [script, source, target] = ["script.py", "input", "result"].map(|name| scratch.path().join(name));
        fs::write(&script, SCRIPT).map_err(|error| scratch_failed(&error))?;
        exchange::write(&source, &self.input).map_err(|error| scratch_failed(&error))?;

        let mut command = program.command(&script);
        isolate(&mut command, scratch.path());
        let sizes: Vec<String> = voxels.iter().map(f64::to_string).collect();
        command.arg("--").arg(action_name(request.action)).arg(&source).arg(&target).args([
            sizes.join(","),
            request.max_faces.to_string(),
            program.config.memory.to_string(),
            std::process::id().to_string(),
        ]);
        let max_bytes = exchange::max_bytes(request.max_faces).max(1 << 20);
        let mut last_error = None;
        let mut line = |text: &str| {
            if let Some(error) = text.strip_prefix(ERROR) {
                last_error = Some(error.to_owned());
            }
            context.log(&format!("{}: {text}", program.info.kind));
        };
        let mut watch = || {
            self.time.check(context)?;
            match fs::symlink_metadata(&target) {
                Ok(metadata) if metadata.len() > max_bytes => {
                    Err(RemeshError::Failed(format!("the result file exceeds {max_bytes} bytes")))
                }
                _ => Ok(()),
            }
        };
        // Held until the program has ended.
        let slot = self.slot()?;
        program.runs.fetch_add(1, Ordering::Relaxed);
        let ended = run(&mut command, scratch.path(), program.config.own_process_group, &mut line, &mut watch);
        drop(slot);
        let ended = ended
            .map_err(|error| RemeshError::Start { program: program.info.program.clone(), reason: error.to_string() })?;
        let failed = match ended {
            Ok(status) if status.success() => None,
            Ok(status) => Some(Failed::Crashed(program.describe_crash(status, last_error))),
            Err(RemeshError::Cancelled) => return Err(RemeshError::Cancelled.into()),
            Err(stopped) => Some(stopped.into()),
        };
        self.result(&target, voxels.len().saturating_sub(1), failed)
    }

    /// The result of a run at `target`: that of its last stage, numbered `last`, or of an earlier one. `failed` says why the run failed, if
    /// it did.
    fn result(&self, target: &Path, last: usize, failed: Option<Failed>) -> Result<StageResult, Failed> {
        let Self { program, request, .. } = *self;
        match (failed, exchange::read(target, request.max_faces)) {
            (None, Ok(mesh)) => Ok(StageResult { mesh, stage: last, note: None }),
            // The whole result was written before the timeout or a crash at exit.
            (Some(failed), Ok(mesh)) => {
                Ok(StageResult { mesh, stage: last, note: Some(format!("{failed}, but the result was complete")) })
            }
            (failed, Err(error)) => {
                let reason = failed.unwrap_or_else(|| program.unreadable(error, request).into());
                let earlier = (0..last).rev().find_map(|stage| {
                    let mesh = exchange::read(&stage_file(target, stage), request.max_faces).ok()?;
                    let note = Some(format!("{reason}; the result is that of the coarser stage before"));
                    Some(StageResult { mesh, stage, note })
                });
                earlier.ok_or(reason)
            }
        }
    }

    /// Waits for a slot of this machine.
    fn slot(&self) -> Result<Slot, RemeshError> {
        let Self { program, request, context, .. } = *self;
        let begin = context.now();
        let at_once = program.config.at_once();
        let mut waited = false;
        let mut waiting = || {
            waited = true;
            context.log(&format!(
                "waiting for a slot: {at_once} programs may run at once on this machine, and all slots are taken"
            ));
            context.report(Stage::Wait, Some(3), request.percent);
        };
        let taken = program
            .config
            .slot(&mut waiting, &mut || self.time.check(context))
            .map_err(|error| RemeshError::Failed(format!("could not lock a slot file: {error}")))?;
        match taken {
            Ok(slot) => {
                if waited {
                    context.report(Stage::Repair, Some(3), request.percent);
                }
                Ok(slot)
            }
            Err(RemeshError::TimedOut(_)) => {
                Err(RemeshError::NoneFree { at_once, waited: context.now().saturating_sub(begin) })
            }
            Err(stop) => Err(stop),
        }
    }

    /// The smallest voxel size at or above the requested one that fits into memory, in frame units.
    fn fitting_voxel(&self) -> Result<f64, RemeshError> {
        let Self { program, ref input, frame, context, .. } = *self;
        let RemeshRequest { voxel_size: size, coarsest, .. } = *self.request;
        if !(size.is_finite() && size > 0.0) {
            return Err(RemeshError::Failed(format!("`voxel_size` must be a length above zero; got {size}")));
        }
        let mut voxel = frame.enter_length(size);
        if voxel < MIN_VOXEL {
            let min = frame.leave_length(MIN_VOXEL);
            return Err(RemeshError::Failed(format!(
                "`voxel_size` {size} is too small for a model of this size; it must be more than {min}"
            )));
        }
        let max = frame.enter_length(coarsest);
        let memory = program.config.memory;
        let too_heavy = |voxel: f64| memory > 0 && check_voxel_memory(triangles(input), voxel, memory).is_err();
        while too_heavy(voxel) {
            self.time.check(context)?;
            if voxel * COARSER > max {
                return Err(RemeshError::Failed(format!(
                    "a remesh with `voxel_size` {} would exceed the memory limit of {} MiB; choose a larger `voxel_size`",
                    frame.leave_length(voxel),
                    memory >> 20
                )));
            }
            voxel *= COARSER;
        }
        Ok(voxel)
    }

    /// Remeshes with voxels: in two stages if the remesh takes long, and again with larger voxels if the program crashed.
    fn voxels(&self) -> Result<Remeshed, RemeshError> {
        let Self { program, request, frame, context, .. } = *self;
        let max = frame.enter_length(request.coarsest);
        let voxel = self.fitting_voxel()?;
        let first = frame.enter_length(request.voxel_size);
        let mut notes = Vec::new();
        if voxel > first {
            notes.push(format!(
                "the voxels are larger than the requested {}, to stay within {} MiB of memory",
                request.voxel_size,
                program.config.memory >> 20
            ));
        }
        let mut voxels = vec![voxel];
        if voxel * STAGE <= max && estimated_faces(&self.input, voxel) > MANY_FACES {
            voxels.insert(0, voxel * STAGE);
        }
        let mut result = self.run(&voxels);
        if let Err(Failed::Crashed(reason)) = &result
            && voxel * AFTER_A_CRASH <= max
        {
            context.log(&format!("{reason}; running again with larger voxels"));
            notes.push(format!("{reason}, and ran again with larger voxels"));
            voxels = vec![voxel * AFTER_A_CRASH];
            result = self.run(&voxels);
        }
        let StageResult { mesh, stage, note } = result?;
        notes.extend(note);
        let used = voxels.get(stage).copied().unwrap_or(voxel);
        let voxel_size = (used != first).then(|| frame.leave_length(used));
        let note = (!notes.is_empty()).then(|| notes.join("; "));
        Ok(Remeshed { soup: unframed(&mesh, frame, &HashMap::new()), voxel_size, note })
    }
}

/// The result of a run.
struct StageResult {
    mesh: RawMesh,
    /// The number of the stage that produced the mesh, counted from 0.
    stage: usize,
    /// What the user should know about the run.
    note: Option<String>,
}

/// Why a run has no result.
#[derive(Debug, thiserror::Error)]
enum Failed {
    /// The program crashed; a smaller task may succeed.
    #[error("{0}")]
    Crashed(String),
    /// Another error.
    #[error(transparent)]
    Otherwise(#[from] RemeshError),
}

impl From<Failed> for RemeshError {
    fn from(failed: Failed) -> Self {
        match failed {
            Failed::Crashed(reason) => Self::Failed(reason),
            Failed::Otherwise(error) => error,
        }
    }
}

/// The begin and the time limit of a request, which cover all its runs and the wait for slots.
#[derive(Clone, Copy)]
struct TimeLimit {
    begin: Duration,
    limit: Duration,
}

impl TimeLimit {
    /// Checks whether the work may continue.
    fn check(self, context: &Context<'_>) -> Result<(), RemeshError> {
        let Self { begin, limit } = self;
        if limit.is_zero() || context.now().saturating_sub(begin) >= limit {
            return Err(RemeshError::TimedOut(limit));
        }
        context.check().map_err(|_| {
            // The context stops at its deadline or on cancellation.
            if context.remaining().is_zero() { RemeshError::TimedOut(limit) } else { RemeshError::Cancelled }
        })
    }
}

/// An estimate of the number of triangles of a voxel remesh.
fn estimated_faces(input: &RawMesh, voxel: f64) -> f64 {
    let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length() / 2.0;
    3.0 * triangles(input).map(area).sum::<f64>() / (voxel * voxel)
}

fn triangles(mesh: &RawMesh) -> impl Iterator<Item = [DVec3; 3]> {
    let corner = |v: u32| mesh.positions.get(v as usize).map_or(DVec3::ZERO, |p| DVec3::from(p.map(f64::from)));
    mesh.faces.iter().map(move |face| face.map(corner))
}

/// The file of a stage before the last; the script uses the same name.
fn stage_file(target: &Path, stage: usize) -> PathBuf {
    target.with_extension(stage.to_string())
}

fn action_name(action: RemeshAction) -> &'static str {
    match action {
        RemeshAction::VoxelRemesh => "voxel",
        RemeshAction::BooleanUnion => "union",
    }
}

fn scratch_failed(error: &std::io::Error) -> RemeshError {
    RemeshError::Failed(format!("could not write to the scratch folder: {error}"))
}
