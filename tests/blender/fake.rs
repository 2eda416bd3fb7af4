//! Tier 3 with fake programs in place of Blender: crashes, hangs, broken results, limits and clean-up.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use glam::DVec3;
use meshmend::blender::{BlenderConfig, BlenderRemesher, WarmUpResult, warm_up};
use meshmend::mesh::Soup;
use meshmend::repair::{
    Context, NoProgress, Progress, RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo, Stage,
    monotonic_clock,
};
use tempfile::TempDir;

use crate::models::cuboid;
use crate::remesh;

/// A shell script that stands in for Blender; its folder is also its scratch folder.
struct Fake {
    folder: TempDir,
    own_process_group: bool,
}

/// Shell code that sets `target` to the path of the result file, `voxels` to the sizes, and `desk` to the fake's folder.
const ARGUMENTS: &str =
    "while [ \"$1\" != -- ]; do shift; done; shift; target=$3; voxels=$4; desk=$HOME/..; echo $voxels >> $desk/runs\n";

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
        let slots = Some(self.folder.path().join("slots"));
        BlenderRemesher::new(info, BlenderConfig { scratch, slots, own_process_group, ..BlenderConfig::default() })
    }

    /// A result file that scripts may copy.
    fn with_mesh(self) -> Self {
        let mut bytes = b"MMSOUP01".to_vec();
        let (positions, faces) = ([[0.0f32; 3], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]], [0u32, 1, 2]);
        bytes.extend([3u64, 1].iter().flat_map(|count| count.to_le_bytes()));
        bytes.extend(positions.iter().flatten().flat_map(|x| x.to_le_bytes()));
        bytes.extend(faces.iter().flat_map(|v| v.to_le_bytes()));
        fs::write(self.folder.path().join("mesh"), bytes).unwrap();
        self
    }

    /// Remeshes a cube with voxels of 0.1 of its side, or up to `coarsest`.
    fn voxels(&self, voxel_size: f64, coarsest: f64, time_limit: Duration) -> Result<Remeshed, RemeshError> {
        self.voxels_by(&self.remesher(), [voxel_size, coarsest], time_limit, &NoProgress)
    }

    fn voxels_by(
        &self,
        remesher: &BlenderRemesher,
        [voxel_size, coarsest]: [f64; 2],
        time_limit: Duration,
        progress: &dyn Progress,
    ) -> Result<Remeshed, RemeshError> {
        let soup = cube();
        let request = RemeshRequest {
            soup: &soup,
            action: RemeshAction::VoxelRemesh,
            voxel_size,
            coarsest,
            max_faces: 1_000_000,
            time_limit,
            percent: 42,
        };
        let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
        remesher.remesh(&request, &Context::new(progress, &cancel, &clock, LONG))
    }

    /// The voxel sizes of each run in the cube's unit, as the script wrote them.
    fn runs(&self) -> Vec<Vec<f64>> {
        let text = fs::read_to_string(self.folder.path().join("runs")).unwrap_or_default();
        // The exchange frame scales the unit cube to a width of 32.
        let sizes = |line: &str| line.split(',').map(|size| size.parse::<f64>().unwrap() / 32.0).collect();
        text.lines().map(sizes).collect()
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
        let request = RemeshRequest {
            soup: &soup,
            action,
            voxel_size: 0.1,
            coarsest: 0.1,
            max_faces: 1000,
            time_limit,
            percent: 50,
        };
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
            assert!(begin.elapsed() < Duration::from_secs(30), "{name} was not created");
            thread::sleep(Duration::from_millis(5));
        }
    }

    #[track_caller]
    fn assert_nothing_left(&self) {
        assert_eq!(self.processes(), Vec::<PathBuf>::new(), "processes are still running");
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
    assert!(log.contains("output truncated"), "no word of the cut");
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
fn the_output_of_a_crashing_program_is_in_the_log() {
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
        // One vertex and one face without data; then a face whose index is out of range.
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
    assert!(fake.failure().0.contains("result file exceeds"));
    fake.assert_nothing_left();
}

#[test]
fn a_missing_program_is_named() {
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
            // The shell itself sets these.
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
fn a_program_stays_in_its_caller_s_process_group_by_default() {
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

#[test]
fn children_in_sessions_of_their_own_with_no_environment_are_ended_too() {
    // Only its parent process shows that it belongs to the run; the argument with the folder is for this test to find it.
    let fake = Fake::new("touch $desk/started; setsid env -i sh -c 'sleep 600; true' \"$HOME\" & sleep 600; true");
    let error = fake.run_within(SHORT, LONG, &AtomicBool::new(false));
    assert_eq!(error, RemeshError::TimedOut(SHORT));
    assert!(fake.folder.path().join("started").exists());
    fake.assert_nothing_left();
}

#[test]
fn after_a_crash_it_runs_once_more_with_larger_voxels_and_the_result_says_so() {
    let fake = Fake::new("[ $(wc -l < $desk/runs) = 2 ] || kill -SEGV $$; cp $desk/mesh $target").with_mesh();
    let remeshed = fake.voxels(0.1, 1.0, LONG).unwrap();
    assert_eq!(fake.runs().len(), 2);
    assert!((fake.runs()[1][0] - 0.15).abs() < 1e-12, "{:?}", fake.runs());
    assert!((remeshed.voxel_size.unwrap() - 0.15).abs() < 1e-12);
    assert!(remeshed.note.unwrap().contains("signal: 11"));
    fake.assert_nothing_left();
}

#[test]
fn a_crash_is_final_the_second_time_or_in_a_boolean_or_if_voxels_may_not_grow() {
    let fake = Fake::new("kill -SEGV $$");
    assert!(matches!(fake.voxels(0.1, 1.0, LONG), Err(RemeshError::Failed(_))));
    assert_eq!(fake.runs().len(), 2);
    let fake = Fake::new("kill -SEGV $$");
    assert!(matches!(fake.voxels(0.1, 0.1, LONG), Err(RemeshError::Failed(_))));
    assert_eq!(fake.runs().len(), 1);
    let fake = Fake::new("kill -SEGV $$");
    assert!(remesh(&fake.remesher(), &cube(), RemeshAction::BooleanUnion, 0.1, 1000).0.is_err());
    assert_eq!(fake.runs().len(), 1);
}

#[test]
fn a_run_that_timed_out_is_not_repeated() {
    let fake = Fake::new("sleep 600; true");
    assert_eq!(fake.voxels(0.1, 1.0, SHORT).unwrap_err(), RemeshError::TimedOut(SHORT));
    assert_eq!(fake.runs().len(), 1);
}

#[test]
fn a_result_that_was_complete_before_a_timeout_or_crash_is_kept() {
    for end in ["sleep 600; true", "kill -SEGV $$"] {
        let fake = Fake::new(&format!("cp $desk/mesh $target; {end}")).with_mesh();
        let remeshed = fake.voxels(0.1, 1.0, Duration::from_secs(2)).unwrap();
        assert_eq!((remeshed.soup.faces.len(), remeshed.voxel_size, fake.runs().len()), (1, None, 1), "{end}");
        assert!(remeshed.note.unwrap().contains("the result was complete"));
        fake.assert_nothing_left();
    }
    // A truncated result is not a result.
    let fake = Fake::new("head -c 40 $desk/mesh > $target; sleep 600; true").with_mesh();
    assert!(matches!(fake.voxels(0.1, 1.0, SHORT), Err(RemeshError::TimedOut(_))));
}

#[test]
fn a_long_remesh_comes_after_a_coarser_one_that_is_kept_when_time_is_over() {
    let fake = Fake::new("cp $desk/mesh $target.0; sleep 600; true").with_mesh();
    let remeshed = fake.voxels(0.005, 1.0, Duration::from_secs(2)).unwrap();
    let runs = fake.runs();
    assert_eq!(runs.len(), 1);
    assert!((runs[0][0] - 0.01).abs() < 1e-12 && (runs[0][1] - 0.005).abs() < 1e-12, "{runs:?}");
    assert!((remeshed.voxel_size.unwrap() - 0.01).abs() < 1e-12);
    assert!(remeshed.note.unwrap().contains("coarser stage"));
    // A quick run reports one stage.
    let fake = Fake::new("cp $desk/mesh $target").with_mesh();
    assert_eq!(fake.voxels(0.1, 1.0, LONG).unwrap().note, None);
    assert_eq!(fake.runs()[0].len(), 1);
}

#[test]
fn voxels_are_made_larger_until_memory_allows_them_and_refused_beyond_what_may_be() {
    let fake = Fake::new("cp $desk/mesh $target").with_mesh();
    let info = fake.remesher().info().unwrap().clone();
    let config = BlenderConfig {
        memory: 100 << 20,
        scratch: Some(fake.folder.path().to_owned()),
        slots: Some(fake.folder.path().join("slots")),
        ..BlenderConfig::default()
    };
    let remesher = BlenderRemesher::new(info, config);
    let remeshed = fake.voxels_by(&remesher, [0.0005, 0.1], LONG, &NoProgress).unwrap();
    let used = *fake.runs()[0].last().unwrap();
    assert!((0.002..0.02).contains(&used), "{used}");
    assert_eq!(remeshed.voxel_size, Some(used));
    assert!(remeshed.note.unwrap().contains("100 MiB"));
    let refused = fake.voxels_by(&remesher, [0.0005, 0.001], LONG, &NoProgress).unwrap_err();
    assert!(refused.to_string().contains("choose a larger `voxel_size`"), "{refused}");
    assert_eq!(fake.runs().len(), 1, "nothing ran");
}

/// Keeps the stages.
#[derive(Default)]
struct Stages(std::sync::Mutex<Vec<(Stage, Option<u8>, u8)>>);

impl Progress for Stages {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        self.0.lock().unwrap().push((stage, tier, percent));
    }
    fn log(&self, _: &str) {}
}

#[test]
fn no_more_run_at_once_than_memory_allows_and_the_others_wait_within_their_time() {
    // Two of these need more than half of the machine's memory.
    let fake =
        Fake::new("mkdir $desk/running || touch $desk/two-ran; sleep 1; rmdir $desk/running; cp $desk/mesh $target")
            .with_mesh();
    let info = fake.remesher().info().unwrap().clone();
    let config = BlenderConfig {
        memory: 1 << 40,
        scratch: Some(fake.folder.path().to_owned()),
        slots: Some(fake.folder.path().join("slots")),
        ..BlenderConfig::default()
    };
    assert_eq!(config.at_once(), 1);
    let remesher = BlenderRemesher::new(info, config);
    let stages = Stages::default();
    let remeshed: Vec<_> = thread::scope(|scope| {
        let runs: Vec<_> =
            (0..3).map(|_| scope.spawn(|| fake.voxels_by(&remesher, [0.1, 0.1], LONG, &stages))).collect();
        runs.into_iter().map(|run| run.join().unwrap()).collect()
    });
    assert!(remeshed.iter().all(Result::is_ok), "{remeshed:?}");
    assert!(!fake.folder.path().join("two-ran").exists());
    let waited = stages.0.lock().unwrap().iter().filter(|stage| **stage == (Stage::Wait, Some(3), 42)).count();
    assert_eq!(waited, 2);
    // A run that waits longer than its time limit gives up without starting the program.
    let before = fake.runs().len();
    let error = thread::scope(|scope| {
        scope.spawn(|| fake.voxels_by(&remesher, [0.1, 0.1], LONG, &NoProgress));
        fake.wait_for("running");
        fake.voxels_by(&remesher, [0.1, 0.1], SHORT, &NoProgress).unwrap_err()
    });
    assert!(matches!(error, RemeshError::NoneFree { at_once: 1, .. }), "{error}");
    assert_eq!(fake.runs().len(), before + 1);
    fake.assert_nothing_left();
}

#[test]
fn a_warm_up_shows_whether_the_program_works() {
    let config = |fake: &Fake| BlenderConfig {
        scratch: Some(fake.folder.path().to_owned()),
        slots: Some(fake.folder.path().join("slots")),
        ..BlenderConfig::default()
    };
    let warm = |fake: &Fake| warm_up(fake.remesher().info().unwrap().clone(), config(fake));
    assert!(matches!(warm(&Fake::new("cp $desk/mesh $target").with_mesh()), WarmUpResult::Warm(_)));
    assert!(matches!(warm(&Fake::new("exit 1")), WarmUpResult::Failed(why) if why.contains("exit status: 1")));
}
