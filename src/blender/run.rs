//! One request to Blender: what is sent, how often the program runs, and which result is taken.

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

const SCRIPT: &str = include_str!("script.py");
/// The first version that can be told to stay off the network.
const OFFLINE_MODE: (u32, u32) = (4, 2);
/// The smallest voxel of Blender's remesh modifier, in its own unit.
const LEAST_VOXEL: f64 = 1e-4;
/// Most faces to send.
const MOST_FACES: usize = 500_000_000;
/// How much larger voxels are made, again and again, until memory allows them.
const COARSER: f64 = 1.25;
/// How much larger they are made after a crash, once.
const AFTER_A_CRASH: f64 = 1.5;
/// From so many faces on a remesh with voxels larger by this comes first, for a quarter of the time, so that there is something
/// when the time is over.
const MANY_FACES: f64 = 200_000.0;
const STAGE: f64 = 2.0;
/// Exit code for an error in the script that it did not foresee.
const SCRIPT_ERROR: &str = "3";

/// A program that was found, what it may use, and how often it was started.
#[derive(Debug)]
pub(super) struct Program {
    pub info: RemesherInfo,
    pub config: BlenderConfig,
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

    fn ended_badly(&self, status: ExitStatus, error: Option<String>) -> String {
        match error {
            Some(error) => format!("{} {}: {error}", self.info.kind, self.info.version),
            None => format!(
                "{} {} ended with {status}, perhaps for want of memory; what it printed is in the log",
                self.info.kind, self.info.version
            ),
        }
    }
}

/// One request.
pub(super) struct Work<'a> {
    by: &'a Program,
    request: &'a RemeshRequest<'a>,
    /// What is sent, in the frame's unit.
    input: RawMesh,
    frame: Frame,
    context: &'a Context<'a>,
    time: Time,
}

impl<'a> Work<'a> {
    /// The work of a request, once it is clear that there is something to send.
    ///
    /// # Errors
    /// [`RemeshError`] where the mesh is empty, too large, or can't be scaled.
    pub fn new(by: &'a Program, request: &'a RemeshRequest<'a>, context: &'a Context<'a>) -> Result<Self, RemeshError> {
        let time = Time { begin: context.now(), limit: request.time_limit.min(context.remaining()) };
        time.check(context)?;
        let soup = request.soup;
        let corners = soup.faces.iter().flatten().filter_map(|&v| soup.positions.get(v as usize));
        if soup.faces.is_empty() {
            return Err(RemeshError::Empty);
        }
        let frame = Frame::around(corners.copied()).ok_or_else(|| {
            RemeshError::Failed("the mesh is a point, is not finite, or is too large or small to be scaled".to_owned())
        })?;
        // Blender counts corners in 31 bits.
        if soup.faces.len() > MOST_FACES {
            let faces = soup.faces.len();
            return Err(RemeshError::Failed(format!(
                "{faces} faces are more than the {MOST_FACES} that Blender takes"
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
            context.log(&format!("{}: {omitted} faces that are flat or there twice are left out", by.info.kind));
        }
        Ok(Self { by, request, input, frame, context, time })
    }

    /// Does the work.
    ///
    /// # Errors
    /// [`RemeshError`] where there is no result.
    pub fn remesh(&self) -> Result<Remeshed, RemeshError> {
        let remeshed = match self.request.action {
            RemeshAction::VoxelRemesh => self.voxels()?,
            RemeshAction::BooleanUnion => {
                let Made { mesh, note, .. } = self.run(&[0.0])?;
                let soup = unframed(&mesh, self.frame, &originals(self.request.soup, self.frame));
                Remeshed { soup, voxel_size: None, note }
            }
        };
        if remeshed.soup.faces.is_empty() { Err(RemeshError::Empty) } else { Ok(remeshed) }
    }

    /// Waits for a slot and runs the script once. `voxels` are its stages, coarsest first, in the frame's unit; of a run that did
    /// not come to its end the result is that of the last stage that did.
    fn run(&self, voxels: &[f64]) -> Result<Made, Failed> {
        let Self { by, request, context, .. } = *self;
        let scratch = by.config.scratch_folder().map_err(|error| scratch_failed(&error))?;
        let [script, source, target] = ["script.py", "input", "result"].map(|name| scratch.path().join(name));
        fs::write(&script, SCRIPT).map_err(|error| scratch_failed(&error))?;
        exchange::write(&source, &self.input).map_err(|error| scratch_failed(&error))?;

        let mut command = by.command(&script);
        isolate(&mut command, scratch.path());
        let sizes: Vec<String> = voxels.iter().map(f64::to_string).collect();
        command.arg("--").arg(action_name(request.action)).arg(&source).arg(&target).args([
            sizes.join(","),
            request.max_faces.to_string(),
            by.config.memory.to_string(),
            std::process::id().to_string(),
        ]);
        let most_bytes = exchange::most_bytes(request.max_faces).max(1 << 20);
        let mut last_error = None;
        let mut line = |text: &str| {
            if let Some(error) = text.strip_prefix(ERROR) {
                last_error = Some(error.to_owned());
            }
            context.log(&format!("{}: {text}", by.info.kind));
        };
        let mut watch = || {
            self.time.check(context)?;
            match fs::symlink_metadata(&target) {
                Ok(found) if found.len() > most_bytes => {
                    Err(RemeshError::Failed(format!("the result file grew over {most_bytes} bytes")))
                }
                _ => Ok(()),
            }
        };
        // Held until the program has ended.
        let slot = self.slot()?;
        by.runs.fetch_add(1, Ordering::Relaxed);
        let ended = run(&mut command, scratch.path(), by.config.own_process_group, &mut line, &mut watch);
        drop(slot);
        let ended = ended
            .map_err(|error| RemeshError::Start { program: by.info.program.clone(), reason: error.to_string() })?;
        let failed = match ended {
            Ok(status) if status.success() => None,
            Ok(status) => Some(Failed::Crashed(by.ended_badly(status, last_error))),
            Err(RemeshError::Cancelled) => return Err(RemeshError::Cancelled.into()),
            Err(stopped) => Some(stopped.into()),
        };
        self.result(&target, voxels.len().saturating_sub(1), failed)
    }

    /// The result that a run left at `target`: that of its last stage, numbered `last`, or of the one before. `failed` says why the
    /// run did not end well.
    fn result(&self, target: &Path, last: usize, failed: Option<Failed>) -> Result<Made, Failed> {
        let Self { by, request, .. } = *self;
        match (failed, exchange::read(target, request.max_faces)) {
            (None, Ok(mesh)) => Ok(Made { mesh, stage: last, note: None }),
            // It was there as a whole when time was over or what comes after it crashed.
            (Some(failed), Ok(mesh)) => {
                Ok(Made { mesh, stage: last, note: Some(format!("{failed}, but its result was there")) })
            }
            (failed, Err(error)) => {
                let why = failed.unwrap_or_else(|| by.unreadable(error, request).into());
                let made = (0..last).rev().find_map(|stage| {
                    let mesh = exchange::read(&stage_file(target, stage), request.max_faces).ok()?;
                    let note = Some(format!("{why}; the result is that of the coarser stage before"));
                    Some(Made { mesh, stage, note })
                });
                made.ok_or(why)
            }
        }
    }

    /// Waits until the machine has room for one more.
    fn slot(&self) -> Result<Slot, RemeshError> {
        let Self { by, request, context, .. } = *self;
        let begin = context.now();
        let at_once = by.config.at_once();
        let mut waited = false;
        let mut waiting = || {
            waited = true;
            context.log(&format!("waiting: {at_once} may run at once on this machine, and as many do"));
            context.report(Stage::Wait, Some(3), request.percent);
        };
        let taken = by.config.slot(&mut waiting, &mut || self.time.check(context)).map_err(|error| {
            RemeshError::Failed(format!("could not lock the file that says how many run on this machine: {error}"))
        })?;
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

    /// The voxel edge nearest above the one asked for that memory allows, in the frame's unit.
    fn fitting_voxel(&self) -> Result<f64, RemeshError> {
        let Self { by, ref input, frame, context, .. } = *self;
        let RemeshRequest { voxel_size: size, coarsest, .. } = *self.request;
        if !(size.is_finite() && size > 0.0) {
            return Err(RemeshError::Failed(format!("the voxel_size is {size}; expected a length above zero")));
        }
        let mut voxel = frame.enter_length(size);
        if voxel < LEAST_VOXEL {
            let least = frame.leave_length(LEAST_VOXEL);
            return Err(RemeshError::Failed(format!(
                "a voxel_size of {size} is too small for a model of this size; choose more than {least}"
            )));
        }
        let most = frame.enter_length(coarsest);
        let memory = by.config.memory;
        let too_heavy = |voxel: f64| memory > 0 && check_voxel_memory(triangles(input), voxel, memory).is_err();
        while too_heavy(voxel) {
            self.time.check(context)?;
            if voxel * COARSER > most {
                return Err(RemeshError::Failed(format!(
                    "a remesh with a voxel_size of {} would take more than the {} MiB of memory it may; choose a larger voxel_size",
                    frame.leave_length(voxel),
                    memory >> 20
                )));
            }
            voxel *= COARSER;
        }
        Ok(voxel)
    }

    /// Remeshes with voxels, in stages where it takes long, and once more with larger ones where the program crashed.
    fn voxels(&self) -> Result<Remeshed, RemeshError> {
        let Self { by, request, frame, context, .. } = *self;
        let most = frame.enter_length(request.coarsest);
        let voxel = self.fitting_voxel()?;
        let first = frame.enter_length(request.voxel_size);
        let mut notes = Vec::new();
        if voxel > first {
            notes.push(format!(
                "the voxels were made larger than the {} asked for, to stay within {} MiB of memory",
                request.voxel_size,
                by.config.memory >> 20
            ));
        }
        let mut voxels = vec![voxel];
        if voxel * STAGE <= most && estimated_faces(&self.input, voxel) > MANY_FACES {
            voxels.insert(0, voxel * STAGE);
        }
        let mut made = self.run(&voxels);
        if let Err(Failed::Crashed(why)) = &made
            && voxel * AFTER_A_CRASH <= most
        {
            context.log(&format!("{why}; it is started again with larger voxels"));
            notes.push(format!("{why}, and was started again with larger voxels"));
            voxels = vec![voxel * AFTER_A_CRASH];
            made = self.run(&voxels);
        }
        let Made { mesh, stage, note } = made?;
        notes.extend(note);
        let used = voxels.get(stage).copied().unwrap_or(voxel);
        let voxel_size = (used != first).then(|| frame.leave_length(used));
        let note = (!notes.is_empty()).then(|| notes.join("; "));
        Ok(Remeshed { soup: unframed(&mesh, frame, &HashMap::new()), voxel_size, note })
    }
}

/// What a run made.
struct Made {
    mesh: RawMesh,
    /// The stage that made it.
    stage: usize,
    note: Option<String>,
}

/// Why a run made nothing.
#[derive(Debug, thiserror::Error)]
enum Failed {
    /// The program ended by itself, and not well: it may do better with less to do.
    #[error("{0}")]
    Crashed(String),
    #[error(transparent)]
    Otherwise(#[from] RemeshError),
}

impl From<Failed> for RemeshError {
    fn from(failed: Failed) -> Self {
        match failed {
            Failed::Crashed(why) => Self::Failed(why),
            Failed::Otherwise(error) => error,
        }
    }
}

/// When a piece of work began and how long it may take, with all its runs and the waiting for them.
#[derive(Clone, Copy)]
struct Time {
    begin: Duration,
    limit: Duration,
}

impl Time {
    /// Whether it may go on.
    fn check(self, context: &Context<'_>) -> Result<(), RemeshError> {
        let Self { begin, limit } = self;
        if limit.is_zero() || context.now().saturating_sub(begin) >= limit {
            return Err(RemeshError::TimedOut(limit));
        }
        context.check().map_err(|_| {
            // The context stops for two reasons.
            if context.remaining().is_zero() { RemeshError::TimedOut(limit) } else { RemeshError::Cancelled }
        })
    }
}

/// About how many triangles a voxel remesh makes.
fn estimated_faces(input: &RawMesh, voxel: f64) -> f64 {
    let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length() / 2.0;
    3.0 * triangles(input).map(area).sum::<f64>() / (voxel * voxel)
}

fn triangles(mesh: &RawMesh) -> impl Iterator<Item = [DVec3; 3]> {
    let corner = |v: u32| mesh.positions.get(v as usize).map_or(DVec3::ZERO, |p| DVec3::from(p.map(f64::from)));
    mesh.faces.iter().map(move |face| face.map(corner))
}

/// Where the script writes what a stage before the last made.
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
