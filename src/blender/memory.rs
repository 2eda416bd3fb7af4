//! Keeps Blender within the machine's memory: slots limit how many programs run at once, and an estimate refuses voxel remeshes that
//! need too much.

use std::collections::HashSet;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use glam::DVec3;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

use crate::math::longest_side_first;

/// The memory of a program before it loads a mesh, in bytes. Blender 3.4 to 5.0 use 150 to 400 MiB.
const PROGRAM_BYTES: u64 = 512 << 20;
/// The most slots, however much memory there is.
const MAX_SLOTS: u64 = 64;
/// The pause between two attempts to take a slot.
const PAUSE: Duration = Duration::from_millis(50);

/// The right to run one Blender on this machine: a lock on one of the slot files, whose number depends on memory. The kernel
/// releases the lock however the process ends.
#[derive(Debug)]
pub(super) struct Slot {
    /// Locked while open. Started programs do not inherit it.
    _file: File,
}

/// The number of Blenders of `each` bytes that may run at once within `total` bytes: at least one, and one if `each` is 0 (no limit).
pub(super) fn count(each: u64, total: u64) -> u32 {
    let fitting = if each == 0 { 1 } else { total / each.saturating_add(PROGRAM_BYTES) };
    u32::try_from(fitting.clamp(1, MAX_SLOTS)).unwrap_or(1)
}

/// Half of the memory of this machine, or of this container's limit, in bytes.
pub(super) fn half_of_memory() -> u64 {
    let kib = |text: String| {
        text.lines()
            .find_map(|line| line.strip_prefix("MemTotal:"))
            .and_then(|rest| rest.trim().strip_suffix("kB")?.trim().parse::<u64>().ok())
    };
    let machine = fs::read_to_string("/proc/meminfo").ok().and_then(kib).map_or(0, |kib| kib << 10);
    let limit = |path| fs::read_to_string(path).ok().and_then(|text: String| text.trim().parse::<u64>().ok());
    // Control groups v2, then v1, where no limit is a number larger than any machine's memory.
    let container = limit("/sys/fs/cgroup/memory.max").or_else(|| limit("/sys/fs/cgroup/memory/memory.limit_in_bytes"));
    container.map_or(machine, |max| max.min(machine)) / 2
}

/// The default folder of slots: the same for every process of this user on this machine.
pub(super) fn default_folder() -> PathBuf {
    PathBuf::from(format!("/tmp/meshmend-blender-{}", rustix::process::geteuid().as_raw()))
}

/// Takes one of `count` slots in `folder`, which is created if missing. If none is free, calls `waiting` once, and then `watch`
/// repeatedly, until a slot is free or `watch` returns an error.
///
/// # Errors
/// The operating system's error when the folder or a file in it can't be used.
pub(super) fn take<S>(
    folder: &Path,
    count: u32,
    waiting: &mut dyn FnMut(),
    watch: &mut dyn FnMut() -> Result<(), S>,
) -> io::Result<Result<Slot, S>> {
    create_private(folder)?;
    let mut is_waiting = false;
    loop {
        for number in 0..count {
            if let Some(slot) = try_take(open(folder, number)?)? {
                return Ok(Ok(slot));
            }
        }
        if !is_waiting {
            waiting();
            is_waiting = true;
        }
        if let Err(stop) = watch() {
            return Ok(Err(stop));
        }
        sleep(PAUSE);
    }
}

/// Creates `count` slots in `folder`, so that a process without write access can take them later.
///
/// # Errors
/// The operating system's error when the folder or a file in it can't be used.
pub(super) fn prepare(folder: &Path, count: u32) -> io::Result<()> {
    create_private(folder)?;
    (0..count).try_for_each(|number| open(folder, number).map(drop))
}

/// Creates the folder, or checks that it belongs to this user. Other users must neither lock its files nor redirect them by links.
fn create_private(folder: &Path) -> io::Result<()> {
    match DirBuilder::new().mode(0o700).create(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            DirBuilder::new().mode(0o700).recursive(true).create(folder)?;
        }
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let metadata = fs::symlink_metadata(folder)?;
    if !metadata.is_dir() || metadata.uid() != rustix::process::geteuid().as_raw() {
        return Err(io::Error::other("the path is not a folder of this user"));
    }
    Ok(())
}

/// Opens a slot's file, which is created if missing.
fn open(folder: &Path, number: u32) -> io::Result<File> {
    #[expect(clippy::cast_possible_wrap, reason = "a flag")]
    let no_links = rustix::fs::OFlags::NOFOLLOW.bits() as i32;
    let path = folder.join(format!("slot-{number}"));
    let mut options = OpenOptions::new();
    match options.read(true).custom_flags(no_links).open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            options.write(true).create(true).truncate(false).mode(0o600).open(&path)
        }
        opened => opened,
    }
}

fn try_take(file: File) -> io::Result<Option<Slot>> {
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(Some(Slot { _file: file })),
        Err(Errno::WOULDBLOCK | Errno::INTR) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// Voxels along the edge of a block. Blender's voxel remesh uses OpenVDB, whose leaf nodes are 8 voxels wide (Museth 2013, "VDB:
/// High-resolution sparse volumes with dynamic topology").
const BLOCK_VOXELS: f64 = 8.0;

/// Memory of a voxel remesh for each block that the surface touches, in bytes. Blender 3.4, 4.5 and 5.0 used 20,000 to 38,000 on a
/// box of one and of four million faces, mostly for the new faces.
const BLOCK_BYTES: u64 = 40_000;

/// The voxel remesh needs too much memory or time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TooHeavy;

/// Checks that a voxel remesh of `triangles` with voxel edge `voxel` stays within about `memory` bytes. `voxel` is positive and in
/// the triangles' unit. The check samples the surface at half a block's distance and counts the blocks with samples; `memory` also
/// bounds its own time and memory.
///
/// # Errors
/// [`TooHeavy`] when there are more blocks. Also when so many layers of surface coincide that the remesh would take far longer than
/// its number of blocks suggests.
pub(super) fn check_voxel_memory(
    triangles: impl Iterator<Item = [DVec3; 3]>,
    voxel: f64,
    memory: u64,
) -> Result<(), TooHeavy> {
    let block = voxel * BLOCK_VOXELS;
    // At a whole block's distance, rounding can put two samples into one block and none into the next.
    let spacing = block * 0.5;
    let max_blocks = usize::try_from(memory / BLOCK_BYTES).unwrap_or(usize::MAX);
    let mut samples_left = max_blocks.saturating_mul(64);
    let mut blocks = HashSet::new();
    let mut touch = |point: DVec3| {
        #[expect(clippy::cast_possible_truncation, reason = "saturates, and such a grid has too many blocks anyway")]
        blocks.insert((point / block).floor().to_array().map(|c| c as i64));
        if blocks.len() > max_blocks { Err(TooHeavy) } else { Ok(()) }
    };
    for triangle in triangles {
        let [a, b, c] = longest_side_first(triangle);
        let length = a.distance(b);
        if length <= block {
            touch((a + b + c) / 3.0)?;
            continue;
        }
        // Rows follow the longest edge, so that a needle's cost grows with its length, not with the square of its length.
        let height = (b - a).cross(c - a).length() / length;
        let rows = (height / spacing).ceil().max(1.0);
        let mut row = 0.0;
        while row <= rows {
            let (from, to) = (a.lerp(c, row / rows), b.lerp(c, row / rows));
            let steps = (from.distance(to) / spacing).ceil().max(1.0);
            let mut step = 0.0;
            while step <= steps {
                samples_left = samples_left.checked_sub(1).ok_or(TooHeavy)?;
                touch(from.lerp(to, step / steps))?;
                step += 1.0;
            }
            row += 1.0;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    fn try_one(folder: &Path, count: u32) -> Option<Slot> {
        take(folder, count, &mut || (), &mut || Err(())).unwrap().ok()
    }

    #[test]
    fn memory_limits_the_number_of_slots_to_at_least_one() {
        assert_eq!(count(4 * GIB, 9 * GIB), 2);
        assert_eq!(count(4 * GIB, 8 * GIB), 1);
        assert_eq!(count(4 * GIB, 0), 1);
        assert_eq!(count(0, u64::MAX), 1);
        assert_eq!(count(1, u64::MAX), 64);
        assert!(half_of_memory() > 1 << 20);
    }

    #[test]
    fn no_more_slots_are_taken_than_exist_and_a_dropped_slot_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let slots = folder.path().join("made/here");
        let (first, second) = (try_one(&slots, 2).unwrap(), try_one(&slots, 2).unwrap());
        assert!(try_one(&slots, 2).is_none());
        drop(first);
        let again = try_one(&slots, 2).unwrap();
        assert!(try_one(&slots, 2).is_none());
        drop((second, again));
    }

    #[test]
    fn waiting_is_reported_once_and_ends_when_a_slot_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let mut held = try_one(folder.path(), 1);
        let (mut reports, mut checks) = (0, 0);
        let slot = take(folder.path(), 1, &mut || reports += 1, &mut || {
            checks += 1;
            if checks == 3 {
                held = None;
            }
            if checks < 100 { Ok(()) } else { Err(()) }
        });
        assert!(slot.unwrap().is_ok());
        assert_eq!((reports, checks), (1, 3));
    }

    #[test]
    fn the_slot_of_a_killed_process_is_free() {
        use std::io::BufRead;
        let folder = tempfile::tempdir().unwrap();
        let mut command = std::process::Command::new("sh");
        command.args(["-c", "exec 9>slot-0; flock 9; echo held; exec sleep 600"]).current_dir(folder.path());
        let mut child = command.stdout(std::process::Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        io::BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert_eq!((line.as_str(), try_one(folder.path(), 1).is_none()), ("held\n", true));
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(try_one(folder.path(), 1).is_some());
    }

    #[test]
    fn a_link_or_a_file_instead_of_the_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "").unwrap();
        std::os::unix::fs::symlink(folder.path(), &link).unwrap();
        for path in [file, link] {
            assert!(take(&path, 1, &mut || (), &mut || Err(())).is_err(), "{}", path.display());
        }
    }

    const SQUARE: [[DVec3; 3]; 2] =
        [[DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0)], [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]];

    fn check(triangles: &[[DVec3; 3]], voxel: f64, blocks: u64) -> Result<(), TooHeavy> {
        check_voxel_memory(triangles.iter().copied(), voxel, blocks * BLOCK_BYTES)
    }

    #[test]
    fn a_flat_square_touches_as_many_blocks_as_the_grid_has_cells() {
        // 1 / (8 * 1/800) = 100 blocks along an edge, and the far border lies in the next.
        assert_eq!(check(&SQUARE, 1.0 / 800.0, 10_300), Ok(()));
        assert_eq!(check(&SQUARE, 1.0 / 800.0, 9_500), Err(TooHeavy));
    }

    #[test]
    fn a_needles_cost_grows_with_its_length_not_its_square() {
        let needle = [[DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1e-6, 0.0)]];
        assert_eq!(check(&needle, 1.0 / 80_000.0, 11_000), Ok(()));
        assert_eq!(check(&needle, 1.0 / 80_000.0, 9_000), Err(TooHeavy));
    }

    #[test]
    fn faces_smaller_than_a_block_add_no_cost() {
        let crumbs = vec![SQUARE[0]; 100_000];
        assert_eq!(check(&crumbs, 1.0, 10), Ok(()));
    }

    #[test]
    fn many_layers_of_large_faces_end_the_check_early() {
        let layers = vec![SQUARE[0]; 100_000];
        assert_eq!(check(&layers, 1.0 / 800.0, 20_000), Err(TooHeavy));
    }
}
