use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use glam::DVec3;
use meshmend::blender::{BlenderConfig, BlenderRemesher};
use meshmend::mesh::Soup;
use meshmend::repair::{
    Context, NoProgress, RemeshAction, RemeshError, RemeshRequest, Remesher, RemesherInfo, monotonic_clock,
};
use tempfile::TempDir;

use crate::models::cuboid;
use crate::remesh;

/// A shell script in Blender's place, in a folder that is its scratch folder as well.
struct Fake {
    folder: TempDir,
    own_process_group: bool,
}

/// Sets `target` to the path of the result file.
const ARGUMENTS: &str = "while [ \"$1\" != -- ]; do shift; done; shift; target=$3\n";

impl Fake {
    fn new(text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let fake = Self { folder, own_process_group: false };
        fs::write(fake.program(), format!("#!/bin/sh\n{ARGUMENTS}{text}\n")).unwrap();
        fs::set_permissions(fake.program(), fs::Permissions::from_mode(0o755)).unwrap();
        fake
    }

    fn program(&self) -> PathBuf {
        self.folder.path().join("blender")
    }

    fn remesher(&self) -> BlenderRemesher {
        let info = RemesherInfo {
            kind: "blender".into(),
            version: "4.2.0".into(),
            program: self.program().display().to_string(),
        };
        let scratch = Some(self.folder.path().to_path_buf());
        let own_process_group = self.own_process_group;
        BlenderRemesher::new(info, BlenderConfig { scratch, own_process_group, ..BlenderConfig::default() })
    }

    fn run(&self) -> (Result<Soup, RemeshError>, String) {
        remesh(&self.remesher(), &cube(), RemeshAction::VoxelRemesh, 0.1, 1000)
    }

    fn failure(&self) -> (String, String) {
        match self.run() {
            (Err(RemeshError::Failed(message)), log) => (message, log),
            other => panic!("{other:?}"),
        }
    }

    fn run_within(&self, time_limit: Duration, deadline: Duration, cancel: &AtomicBool) -> RemeshError {
        let soup = cube();
        let action = RemeshAction::VoxelRemesh;
        let request = RemeshRequest { soup: &soup, action, voxel_size: 0.1, max_faces: 1000, time_limit };
        let clock = monotonic_clock();
        let context = Context::new(&NoProgress, cancel, &clock, deadline);
        self.remesher().remesh(&request, &context).unwrap_err()
    }

    /// Processes with this fake's folder in their command line or environment.
    fn processes(&self) -> Vec<PathBuf> {
        let name = self.folder.path().as_os_str().as_encoded_bytes();
        let names_it =
            |file: PathBuf| fs::read(file).is_ok_and(|bytes| bytes.windows(name.len()).any(|window| window == name));
        let found = fs::read_dir("/proc").unwrap().flatten().map(|entry| entry.path());
        found.filter(|path| names_it(path.join("cmdline")) || names_it(path.join("environ"))).collect()
    }

    /// Waits until `name` is in the fake's folder.
    fn wait_for(&self, name: &str) {
        let begin = Instant::now();
        while !self.folder.path().join(name).exists() {
            assert!(begin.elapsed() < Duration::from_secs(30), "{name} was not made");
            thread::sleep(Duration::from_millis(5));
        }
    }

    #[track_caller]
    fn assert_nothing_left(&self) {
        assert_eq!(self.processes(), Vec::<PathBuf>::new(), "processes are left");
        let names: Vec<_> =
            fs::read_dir(self.folder.path()).unwrap().flatten().map(|entry| entry.file_name()).collect();
        assert!(!names.iter().any(|name| name.to_string_lossy().starts_with("meshmend-")), "{names:?}");
    }
}

fn cube() -> Soup {
    cuboid(DVec3::ZERO, DVec3::ONE)
}

const LONG: Duration = Duration::from_secs(300);
const SHORT: Duration = Duration::from_millis(400);

#[test]
fn a_program_that_hangs_is_stopped_at_its_time_limit_with_all_its_children() {
    // A wrapper that waits for a child, an orphan that holds the pipes open, and one that ignores polite signals.
    for own_process_group in [false, true] {
        let mut fake = Fake::new("(trap '' TERM HUP INT; sleep 600 & sleep 600) & (sleep 600 &)\nsleep 600; true");
        fake.own_process_group = own_process_group;
        let begin = Instant::now();
        let error = fake.run_within(SHORT, LONG, &AtomicBool::new(false));
        assert_eq!(error, RemeshError::TimedOut(SHORT));
        assert!(begin.elapsed() < Duration::from_secs(20), "it took {:?}", begin.elapsed());
        fake.assert_nothing_left();
    }
}

#[test]
fn a_program_that_hangs_is_stopped_at_the_deadline_of_the_repair() {
    let fake = Fake::new("sleep 600");
    let error = fake.run_within(LONG, SHORT, &AtomicBool::new(false));
    assert!(matches!(error, RemeshError::TimedOut(limit) if limit <= SHORT), "{error:?}");
    fake.assert_nothing_left();
}

#[test]
fn a_cancelled_repair_stops_the_program() {
    let fake = Fake::new("touch \"$HOME/../started\"; sleep 600; true");
    let cancel = AtomicBool::new(false);
    let error = thread::scope(|scope| {
        let run = scope.spawn(|| fake.run_within(LONG, LONG, &cancel));
        fake.wait_for("started");
        cancel.store(true, Ordering::Relaxed);
        run.join().unwrap()
    });
    assert_eq!(error, RemeshError::Cancelled);
    fake.assert_nothing_left();
}

#[test]
fn a_repair_without_time_starts_nothing() {
    let fake = Fake::new("touch \"$HOME/../started\"");
    assert_eq!(fake.run_within(LONG, Duration::ZERO, &AtomicBool::new(false)), RemeshError::TimedOut(Duration::ZERO));
    assert_eq!(fake.run_within(LONG, LONG, &AtomicBool::new(true)), RemeshError::Cancelled);
    assert!(!fake.folder.path().join("started").exists());
}

#[test]
fn children_that_outlive_a_program_that_ended_well_are_ended() {
    let fake = Fake::new("sleep 600 & exit 0");
    let begin = Instant::now();
    assert!(fake.failure().0.contains("left no result file"));
    assert!(begin.elapsed() < Duration::from_secs(20));
    fake.assert_nothing_left();
}

#[test]
fn endless_output_is_cut_and_the_program_still_runs_to_its_end() {
    let fake = Fake::new("head -c 30000000 /dev/zero | tr '\\0' 'x' | fold -w 100; echo end >&2; exit 7");
    let (message, log) = fake.failure();
    assert!(message.contains("exit status: 7"), "{message}");
    assert!(log.contains("output cut"), "no word of the cut");
    assert!(log.len() < 400_000, "{} bytes of log", log.len());
}

#[test]
fn a_line_without_an_end_is_cut_in_pieces() {
    let fake = Fake::new("head -c 100000 /dev/zero | tr '\\0' 'x'; exit 1");
    let (_, log) = fake.failure();
    assert!(log.lines().all(|line| line.len() < 5000));
    assert_eq!(log.matches('x').count(), 100_000);
}

#[test]
fn what_a_crashing_program_printed_is_in_the_log() {
    let (message, log) = Fake::new("echo 'part one'; printf 'bad \\033[31m bytes \\377' >&2; kill -SEGV $$").failure();
    assert!(message.contains("signal: 11"), "{message}");
    assert!(log.contains("blender: part one"), "{log}");
    assert!(log.contains("bad  [31m bytes \u{fffd}"), "{log}");
}

#[test]
fn the_reason_that_the_script_gives_is_the_error_even_after_too_much_output() {
    let fake = Fake::new(
        "head -c 3000000 /dev/zero | tr '\\0' 'x' | fold -w 100; echo; echo 'meshmend-error: no such thing'; exit 4",
    );
    assert_eq!(fake.failure().0, "blender 4.2.0: no such thing");
}

#[test]
fn a_result_file_that_is_garbage_is_refused() {
    for garbage in [
        "",
        "echo garbage > $target",
        "head -c 5000 /dev/zero > $target",
        "cp /bin/sh $target",
        "mkfifo $target",
        "ln -s /dev/zero $target",
        "mkdir $target",
        // One vertex, one face, no data; then a face out of range.
        "printf 'MMSOUP01\\001\\0\\0\\0\\0\\0\\0\\0\\001\\0\\0\\0\\0\\0\\0\\0' > $target",
        "printf 'MMSOUP01\\001\\0\\0\\0\\0\\0\\0\\0\\001\\0\\0\\0\\0\\0\\0\\0' > $target; printf '%024d' 0 >> $target",
    ] {
        let (message, _) = Fake::new(garbage).failure();
        assert!(message.contains("result file"), "{garbage}: {message}");
    }
}

#[test]
fn a_result_file_without_faces_is_an_empty_result() {
    let fake = Fake::new("printf 'MMSOUP01\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0\\0' > $target");
    assert_eq!(fake.run().0.unwrap_err(), RemeshError::Empty);
}

#[test]
fn a_result_file_that_grows_without_end_is_stopped() {
    let fake = Fake::new("head -c 20000000 /dev/zero > $target; sleep 600; true");
    assert!(fake.failure().0.contains("grew over"));
    fake.assert_nothing_left();
}

#[test]
fn a_program_that_is_not_there_is_named() {
    let fake = Fake::new("");
    fs::remove_file(fake.program()).unwrap();
    match fake.run().0 {
        Err(RemeshError::Start { program, reason }) => {
            assert_eq!(Path::new(&program), fake.program());
            assert!(reason.contains("No such file"), "{reason}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_program_sees_no_environment_and_no_home_but_its_scratch_folder() {
    let fake = Fake::new("env; echo working-folder=$(pwd); exit 1");
    let (_, log) = fake.failure();
    let base = fake.folder.path().display().to_string();
    for line in log.lines().filter_map(|line| line.strip_prefix("blender: ")) {
        let Some((name, value)) = line.split_once('=') else { panic!("{line}") };
        match name {
            "PATH" | "LD_LIBRARY_PATH" | "LC_ALL" | "PYTHONDONTWRITEBYTECODE" | "PYTHONNOUSERSITE" => {}
            // Set by the shell itself.
            "_" | "SHLVL" | "OLDPWD" => {}
            _ => assert!(value.starts_with(&base), "{line}"),
        }
    }
    for name in ["HOME=", "TMPDIR=", "XDG_CONFIG_HOME=", "BLENDER_USER_RESOURCES=", "working-folder="] {
        assert!(log.contains(&format!("blender: {name}{base}")), "{name} is missing in {log}");
    }
    fake.assert_nothing_left();
}

#[test]
fn a_program_stays_in_the_process_group_of_its_caller_unless_told_otherwise() {
    for own_process_group in [false, true] {
        let mut fake = Fake::new("cut -d ' ' -f 5 /proc/$$/stat; echo pid=$$; exit 1");
        fake.own_process_group = own_process_group;
        let (_, log) = fake.failure();
        let lines: Vec<&str> = log.lines().filter_map(|line| line.strip_prefix("blender: ")).collect();
        let leads = lines[1].strip_prefix("pid=") == Some(lines[0]);
        assert_eq!(leads, own_process_group, "{log}");
    }
}

#[test]
fn blender_is_started_without_profile_sound_or_network() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("blender");
    fs::write(&program, "#!/bin/sh\nprintf '%s\\n' \"$@\"; exit 1\n").unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    for (version, offline) in [("3.4.1", false), ("4.1.1", false), ("4.2.0", true), ("5.0.1", true)] {
        let info =
            RemesherInfo { kind: "blender".into(), version: version.into(), program: program.display().to_string() };
        let remesher = BlenderRemesher::new(info, BlenderConfig::default());
        let (_, log) = remesh(&remesher, &cube(), RemeshAction::BooleanUnion, 0.1, 1000);
        for argument in ["--background", "--factory-startup", "-noaudio"] {
            assert!(log.contains(&format!("blender: {argument}\n")), "{log}");
        }
        assert_eq!(log.contains("--offline-mode"), offline, "{version}: {log}");
    }
}
