//! Fuzzing without libFuzzer: models in every format, damaged as models and as bytes, through the whole pipeline.
//!
//! A few run with the other tests. For longer, with the seconds and the seed that the environment asks for:
//! `MESHMEND_FUZZ_SECONDS=600 MESHMEND_FUZZ_SEED=1 cargo test --test fuzz -- --ignored --nocapture for_long`
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

#[path = "../support/damage.rs"]
#[allow(dead_code, reason = "shared with other tests")]
mod damage;
#[path = "../../fuzz/src/lib.rs"]
mod entries;
#[path = "../support/meshes.rs"]
#[allow(dead_code, reason = "shared with other tests")]
mod meshes;
mod mutate;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use damage::Random;

/// A small model may take so long, twice and checked, on a busy machine.
const LONGEST: Duration = Duration::from_secs(60);

/// Where an input stays while it is tried, so that it is at hand whatever becomes of the process.
fn kept(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|it| it.parse().ok()).unwrap_or(default)
}

/// Tries inputs that follow from a seed until `enough` says so after some. Answers how many.
fn try_from_seed(
    name: &str,
    seed: u64,
    entry: fn(&[u8]),
    make: fn(u64) -> Vec<u8>,
    enough: impl Fn(u64) -> bool,
) -> u64 {
    let path = kept(&format!("{name}-{seed}"));
    let mut done = 0;
    while !enough(done) {
        let bytes = make(seed.wrapping_add(done));
        std::fs::write(&path, &bytes).unwrap();
        let begin = Instant::now();
        entry(&bytes);
        let took = begin.elapsed();
        assert!(took < LONGEST, "seed {} took {took:?}: {}", seed.wrapping_add(done), path.display());
        done += 1;
    }
    std::fs::remove_file(path).unwrap();
    done
}

/// What `arrange` reads solids from.
fn any_bytes(seed: u64) -> Vec<u8> {
    let mut random = Random::new(seed);
    let solids = 1 + random.below(8);
    (0..13 * solids).map(|_| random.below(256) as u8).collect()
}

#[test]
fn some_damaged_files_go_through_the_pipeline() {
    try_from_seed("repair-short", 1, entries::repair, mutate::file, |done| done >= 12);
}

#[test]
fn some_solids_with_whole_corners_are_arranged() {
    try_from_seed("arrange-short", 1, entries::arrange, any_bytes, |done| done >= 150);
}

#[test]
fn some_damaged_3mf_files_are_read_and_written() {
    try_from_seed("threemf-short", 1, entries::threemf, mutate::threemf, |done| done >= 300);
}

#[test]
#[ignore = "runs as long as it is asked to"]
#[allow(clippy::print_stderr, reason = "tells how far it came")]
fn for_long() {
    let (seconds, seed) = (number("MESHMEND_FUZZ_SECONDS", 60), number("MESHMEND_FUZZ_SEED", 1) << 32);
    let begin = Instant::now();
    let share = |share: f64| move |_| begin.elapsed().as_secs_f64() > share * seconds as f64;
    let arranged = try_from_seed("arrange", seed, entries::arrange, any_bytes, share(0.1));
    let packed = try_from_seed("threemf", seed, entries::threemf, mutate::threemf, share(0.2));
    let repaired = try_from_seed("repair", seed, entries::repair, mutate::file, share(1.0));
    eprintln!("arranged {arranged}, read and wrote {packed}, repaired {repaired}");
}

/// Runs one file again, as it was left by a failure or found by libFuzzer.
#[test]
#[ignore = "needs a file"]
fn one_file_again() {
    let bytes = std::fs::read(std::env::var("MESHMEND_FUZZ_FILE").unwrap()).unwrap();
    entries::repair(&bytes);
}

/// Writes files for libFuzzer to begin with.
#[test]
#[ignore = "writes files"]
fn seeds_for_libfuzzer() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/repair");
    std::fs::create_dir_all(&folder).unwrap();
    for seed in 0..200 {
        std::fs::write(folder.join(format!("made-{seed}")), mutate::file(seed)).unwrap();
    }
}
