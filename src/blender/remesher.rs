use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::process::{Command, ExitStatus};
use std::time::Duration;

use glam::DVec3;

use super::estimate::{TooHeavy, check_voxel_memory};
use super::exchange::{self, RawMesh, ReadResultError};
use super::find::{BPY, BlenderConfig, BlenderMissing, find, parse_version};
use super::frame::Frame;
use super::process::{ERROR, isolate, run};
use crate::mesh::Soup;
use crate::repair::{Context, RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};

/// A position of the frame.
type Place = [f32; 3];

const SCRIPT: &str = include_str!("script.py");
/// The first version that can be told to stay off the network.
const OFFLINE_MODE: (u32, u32) = (4, 2);
/// The smallest voxel of Blender's remesh modifier, in its own unit.
const LEAST_VOXEL: f64 = 1e-4;
/// Most faces to send.
const MOST_FACES: usize = 500_000_000;
/// Exit code for an error in the script that it did not foresee.
const SCRIPT_ERROR: &str = "3";

/// [`Remesher`] by a Blender that runs as a process of its own.
#[derive(Debug, Clone)]
pub struct BlenderRemesher {
    info: RemesherInfo,
    config: BlenderConfig,
}

impl BlenderRemesher {
    /// Finds a program and asks it for its version, which takes up to some seconds: once a process is enough, and
    /// [`BlenderRemesher::new`] takes over what was found elsewhere.
    ///
    /// # Errors
    /// [`BlenderMissing`], with each program that was tried.
    pub fn find(config: BlenderConfig) -> Result<Self, BlenderMissing> {
        Ok(Self { info: find(&config)?, config })
    }

    /// A remesher by a program that was found before; it is not asked again.
    #[must_use]
    pub fn new(info: RemesherInfo, config: BlenderConfig) -> Self {
        Self { info, config }
    }

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

    /// Runs the script on `input`, both in the frame's unit.
    fn run(
        &self,
        input: &RawMesh,
        voxel: f64,
        request: &RemeshRequest<'_>,
        context: &Context<'_>,
        limit: Duration,
        begin: Duration,
    ) -> Result<RawMesh, RemeshError> {
        let scratch = self.config.scratch_folder().map_err(|error| scratch_failed(&error))?;
        let [script, source, target] = ["script.py", "input", "result"].map(|name| scratch.path().join(name));
        fs::write(&script, SCRIPT).map_err(|error| scratch_failed(&error))?;
        exchange::write(&source, input).map_err(|error| scratch_failed(&error))?;

        let mut command = self.command(&script);
        isolate(&mut command, scratch.path());
        command.arg("--").arg(action_name(request.action)).arg(&source).arg(&target).args([
            voxel.to_string(),
            request.max_faces.to_string(),
            self.config.memory.to_string(),
            std::process::id().to_string(),
        ]);
        let most_bytes = exchange::most_bytes(request.max_faces).max(1 << 20);
        let mut last_error = None;
        let mut line = |text: &str| {
            if let Some(error) = text.strip_prefix(ERROR) {
                last_error = Some(error.to_owned());
            }
            context.log(&format!("{}: {text}", self.info.kind));
        };
        let mut watch = || {
            check(context, limit, begin)?;
            match fs::symlink_metadata(&target) {
                Ok(found) if found.len() > most_bytes => {
                    Err(RemeshError::Failed(format!("the result file grew over {most_bytes} bytes")))
                }
                _ => Ok(()),
            }
        };
        let ended = run(&mut command, scratch.path(), self.config.own_process_group, &mut line, &mut watch);
        let status = ended
            .map_err(|error| RemeshError::Start { program: self.info.program.clone(), reason: error.to_string() })??;
        if !status.success() {
            return Err(RemeshError::Failed(self.ended_badly(status, last_error)));
        }
        exchange::read(&target, request.max_faces).map_err(|error| match error {
            ReadResultError::TooManyFaces(faces) => RemeshError::TooManyFaces { faces, most: request.max_faces },
            other => RemeshError::Failed(format!("{} ended, but {other}", self.info.program)),
        })
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

    fn check_memory(&self, input: &RawMesh, voxel: f64, frame: Frame) -> Result<(), RemeshError> {
        if self.config.memory == 0 {
            return Ok(());
        }
        let corner = |v: u32| input.positions.get(v as usize).map_or(DVec3::ZERO, |p| DVec3::from(p.map(f64::from)));
        let triangles = input.faces.iter().map(|face| face.map(corner));
        check_voxel_memory(triangles, voxel, self.config.memory).map_err(|TooHeavy| {
            RemeshError::Failed(format!(
                "a remesh with a voxel_size of {} would take more than the {} MiB of memory it may; choose a larger voxel_size",
                frame.leave_length(voxel),
                self.config.memory >> 20
            ))
        })
    }
}

impl Remesher for BlenderRemesher {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        Ok(&self.info)
    }

    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        let begin = context.now();
        let limit = request.time_limit.min(context.remaining());
        check(context, limit, begin)?;
        let voxels = request.action == RemeshAction::VoxelRemesh;
        if voxels && !(request.voxel_size.is_finite() && request.voxel_size > 0.0) {
            let size = request.voxel_size;
            return Err(RemeshError::Failed(format!("the voxel_size is {size}; expected a length above zero")));
        }
        let corners = || request.soup.faces.iter().flatten().filter_map(|&v| request.soup.positions.get(v as usize));
        if request.soup.faces.is_empty() {
            return Err(RemeshError::Empty);
        }
        let frame = Frame::around(corners().copied()).ok_or_else(|| {
            RemeshError::Failed("the mesh is a point, is not finite, or is too large or small to be scaled".to_owned())
        })?;
        // Blender counts corners in 31 bits.
        if request.soup.faces.len() > MOST_FACES {
            let faces = request.soup.faces.len();
            return Err(RemeshError::Failed(format!(
                "{faces} faces are more than the {MOST_FACES} that Blender takes"
            )));
        }
        let input = if voxels { for_voxels(request.soup, frame) } else { for_boolean(request.soup, frame) };
        if input.faces.is_empty() {
            return Err(RemeshError::Empty);
        }
        let left_out = request.soup.faces.len() - input.faces.len();
        if left_out > 0 {
            context.log(&format!("{}: {left_out} faces that are flat or there twice are left out", self.info.kind));
        }
        let voxel = if voxels { frame.enter_length(request.voxel_size) } else { 0.0 };
        if voxels {
            if voxel < LEAST_VOXEL {
                let least = frame.leave_length(LEAST_VOXEL);
                let size = request.voxel_size;
                return Err(RemeshError::Failed(format!(
                    "a voxel_size of {size} is too small for a model of this size; choose more than {least}"
                )));
            }
            self.check_memory(&input, voxel, frame)?;
        }
        let made = self.run(&input, voxel, request, context, limit, begin)?;
        let originals = if voxels { HashMap::new() } else { originals(request.soup, frame) };
        let soup = unframed(&made, frame, &originals);
        if soup.faces.is_empty() {
            return Err(RemeshError::Empty);
        }
        Ok(Remeshed { soup })
    }
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

/// Whether a run that began at `begin` may go on.
fn check(context: &Context<'_>, limit: Duration, begin: Duration) -> Result<(), RemeshError> {
    if limit.is_zero() || context.now().saturating_sub(begin) >= limit {
        return Err(RemeshError::TimedOut(limit));
    }
    context.check().map_err(|_| {
        // The context stops for two reasons.
        if context.remaining().is_zero() { RemeshError::TimedOut(limit) } else { RemeshError::Cancelled }
    })
}

/// The faces of a soup in the frame, without those that have two corners in one place: they enclose nothing, their edges
/// cancel, and Blender can't hold them.
fn framed(soup: &Soup, frame: Frame) -> impl Iterator<Item = ([u32; 3], [Place; 3])> {
    soup.faces.iter().filter_map(move |face| {
        let corners = face.map(|v| soup.positions.get(v as usize).map(|&position| frame.enter(position)));
        let [Some(a), Some(b), Some(c)] = corners else { return None };
        (a != b && b != c && c != a).then_some((*face, [a, b, c]))
    })
}

/// What a voxel remesh is given: shared vertices stay shared, and vertices that no face uses are left out.
fn for_voxels(soup: &Soup, frame: Frame) -> RawMesh {
    let mut new_index: Vec<Option<u32>> = vec![None; soup.positions.len()];
    let mut mesh = RawMesh::default();
    for (face, places) in framed(soup, frame) {
        let mut corners = [0; 3];
        for ((corner, v), place) in corners.iter_mut().zip(face).zip(places) {
            let Some(known) = new_index.get_mut(v as usize) else { continue };
            *corner = *known.get_or_insert_with(|| {
                mesh.positions.push(place);
                index(mesh.positions.len() - 1)
            });
        }
        mesh.faces.push(corners);
    }
    mesh
}

/// What a boolean is given: each face with three vertices of its own. Blender's mesh can't hold two faces on the same
/// three vertices, and to drop one side of a double wall would open what was closed; its exact boolean welds by
/// position anyway.
///
/// Faces on the same three places count as in chain arithmetic, up to one: copies turned the same way become one, which
/// keeps a closed surface closed, and as many of one turn as of the other become one of each.
fn for_boolean(soup: &Soup, frame: Frame) -> RawMesh {
    /// Copies of one turn, then of the other.
    type Turns = [u32; 2];
    let mut turns: HashMap<[[u32; 3]; 3], Turns> = HashMap::with_capacity(soup.faces.len());
    for (_, places) in framed(soup, frame) {
        let (key, turn) = without_turn(places);
        let count = &mut turns.entry(key).or_default()[turn];
        *count = count.saturating_add(1);
    }
    let mut mesh = RawMesh::default();
    for (_, places) in framed(soup, frame) {
        let (key, turn) = without_turn(places);
        let Some(counts) = turns.get_mut(&key) else { continue };
        if counts[turn] == 0 || counts[turn] < counts[1 - turn] {
            continue;
        }
        let first = index(mesh.positions.len());
        mesh.positions.extend(places);
        mesh.faces.push([first, first + 1, first + 2]);
        // Taken; of two equal counts the other turn is still to come.
        *counts = if counts[turn] == counts[1 - turn] { [u32::from(turn == 1), u32::from(turn == 0)] } else { [0, 0] };
    }
    mesh
}

/// The bits of three places in ascending order, and whether the order of the face is an even (0) or odd (1) exchange of it.
fn without_turn(places: [Place; 3]) -> ([[u32; 3]; 3], usize) {
    let [a, b, c] = places.map(|place| place.map(f32::to_bits));
    let odd = usize::from(a > b) + usize::from(b > c) + usize::from(a > c);
    let mut key = [a, b, c];
    key.sort_unstable();
    (key, odd % 2)
}

/// An index of a mesh that [`MOST_FACES`] keeps within u32.
fn index(position: usize) -> u32 {
    u32::try_from(position).unwrap_or(u32::MAX)
}

/// The first position of the soup for each place of the frame.
fn originals(soup: &Soup, frame: Frame) -> HashMap<[u32; 3], DVec3> {
    let mut originals = HashMap::with_capacity(soup.positions.len());
    for &position in &soup.positions {
        originals.entry(frame.enter(position).map(f32::to_bits)).or_insert(position);
    }
    originals
}

/// What Blender made, in the model's unit and place, without vertices that no face uses. A vertex that is still where
/// it was sent gets its position back to the last bit.
fn unframed(mesh: &RawMesh, frame: Frame, originals: &HashMap<[u32; 3], DVec3>) -> Soup {
    const UNUSED: u32 = u32::MAX;
    let mut soup = Soup::default();
    let mut new_index = vec![UNUSED; mesh.positions.len()];
    for face in &mesh.faces {
        let face = face.map(|v| {
            let (Some(new), Some(position)) = (new_index.get_mut(v as usize), mesh.positions.get(v as usize)) else {
                return UNUSED;
            };
            if *new == UNUSED {
                *new = u32::try_from(soup.positions.len()).unwrap_or(UNUSED);
                let position = position.map(|c| c + 0.0);
                let original = originals.get(&position.map(f32::to_bits));
                soup.positions.push(original.copied().unwrap_or_else(|| frame.leave(position)));
            }
            *new
        });
        soup.faces.push(face);
    }
    soup
}
