//! Fuzzing without libFuzzer: damaged models in every format through each reader and the whole pipeline, and damaged
//! requests through the HTTP surface.
//!
//! A short run is part of the tests. A long run takes its seconds and its seed from the environment:
//! `MESHMEND_FUZZ_SECONDS=600 MESHMEND_FUZZ_SEED=1 cargo test --features service --test fuzz -- --ignored --nocapture for_long`
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
mod requests;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use damage::Random;
use meshmend::format::Format;

/// The longest time that one input may take on a busy machine.
const LONGEST: Duration = Duration::from_secs(60);

/// The file that holds the current input, so that it survives a crash of the process.
fn kept(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|value| value.parse().ok()).unwrap_or(default)
}

/// Tries inputs from consecutive seeds until `enough` is true of their number. Returns the number.
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

/// Random bytes, from which the target `arrange` builds solids.
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

fn read_as_any(bytes: &[u8]) {
    for format in Format::ALL {
        entries::read_as(format, bytes);
    }
}

#[test]
fn some_damaged_files_are_read() {
    try_from_seed("read-short", 1, read_as_any, mutate::file, |done| done >= 300);
}

#[test]
fn some_damaged_forms_are_answered() {
    try_from_seed("form-short", 1, entries::form, requests::form, |done| done >= 150);
}

#[test]
fn some_damaged_requests_are_answered() {
    try_from_seed("request-short", 1, entries::request, requests::request, |done| done >= 150);
}

#[test]
fn some_damaged_3mf_files_are_read_and_written() {
    try_from_seed("threemf-short", 1, entries::threemf, mutate::threemf, |done| done >= 300);
}

#[test]
fn some_damaged_gltf_files_are_read_and_written() {
    try_from_seed("gltf-short", 1, entries::gltf, mutate::gltf, |done| done >= 300);
}

#[test]
fn the_gltf_document_is_valid_before_it_is_damaged() {
    assert!(mutate::gltf_is_read());
}

#[test]
fn some_damaged_models_with_materials_are_read_and_written() {
    try_from_seed("zip-short", 1, entries::zip, mutate::zip, |done| done >= 300);
}

#[test]
#[ignore = "runs as long as it is asked to"]
#[allow(clippy::print_stderr, reason = "tells how far it came")]
fn for_long() {
    let (seconds, seed) = (number("MESHMEND_FUZZ_SECONDS", 60), number("MESHMEND_FUZZ_SEED", 1) << 32);
    let begin = Instant::now();
    let share = |share: f64| move |_| begin.elapsed().as_secs_f64() > share * seconds as f64;
    let read = try_from_seed("read", seed, read_as_any, mutate::file, share(0.1));
    let packed = try_from_seed("threemf", seed, entries::threemf, mutate::threemf, share(0.15));
    let glb = try_from_seed("gltf", seed, entries::gltf, mutate::gltf, share(0.2));
    let painted = try_from_seed("zip", seed, entries::zip, mutate::zip, share(0.25));
    let forms = try_from_seed("form", seed, entries::form, requests::form, share(0.3));
    let requests = try_from_seed("request", seed, entries::request, requests::request, share(0.4));
    let arranged = try_from_seed("arrange", seed, entries::arrange, any_bytes, share(0.5));
    let repaired = try_from_seed("repair", seed, entries::repair, mutate::file, share(1.0));
    eprintln!(
        "read {read}, {packed} 3MF, {glb} glTF and {painted} with materials, answered {forms} forms and {requests} requests, arranged {arranged}, repaired {repaired}"
    );
}

/// The name of a target, its function, and a generator of inputs from a seed.
type Target = (&'static str, fn(&[u8]), fn(u64) -> Vec<u8>);

/// The targets of libFuzzer.
const TARGETS: [Target; 12] = [
    ("arrange", entries::arrange, any_bytes),
    ("repair", entries::repair, mutate::file),
    ("read_stl", |bytes| _ = entries::read_as(Format::Stl, bytes), mutate::stl),
    ("read_obj", |bytes| _ = entries::read_as(Format::Obj, bytes), mutate::obj),
    ("read_ply", |bytes| _ = entries::read_as(Format::Ply, bytes), mutate::ply),
    ("read_off", |bytes| _ = entries::read_as(Format::Off, bytes), mutate::off),
    ("read_mesh", |bytes| _ = entries::read_as(Format::Mesh, bytes), mutate::mesh),
    ("threemf", entries::threemf, mutate::threemf),
    ("gltf", entries::gltf, mutate::gltf),
    ("zip", entries::zip, mutate::zip),
    ("form", entries::form, requests::form),
    ("request", entries::request, requests::request),
];

/// Runs one file again that failed here or in libFuzzer, with the target that the environment names.
#[test]
#[ignore = "needs a file"]
fn one_file_again() {
    let bytes = std::fs::read(std::env::var("MESHMEND_FUZZ_FILE").unwrap()).unwrap();
    let target = std::env::var("MESHMEND_FUZZ_TARGET").unwrap_or_else(|_| "repair".to_owned());
    TARGETS.iter().find(|(name, ..)| *name == target).unwrap().1(&bytes);
}

/// Writes a seed corpus for libFuzzer.
#[test]
#[ignore = "writes files"]
fn seeds_for_libfuzzer() {
    for (name, _, make) in TARGETS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        for seed in 0..200 {
            std::fs::write(folder.join(format!("made-{seed}")), make(seed)).unwrap();
        }
    }
}

/// `TARGETS` lists every target of libFuzzer.
#[test]
fn every_target_of_libfuzzer_is_tried_here() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/fuzz_targets");
    let files = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path());
    let mut found: Vec<String> = files.map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    let mut known: Vec<&str> = TARGETS.iter().map(|(name, ..)| *name).collect();
    found.sort_unstable();
    known.sort_unstable();
    assert_eq!(found, known);
}
