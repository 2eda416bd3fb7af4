use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::blender::{BlenderConfig, BlenderRemesher, WarmUpResult, warm_up};
use meshmend::mesh::Soup;
use meshmend::repair::{
    Context, NoProgress, RemeshAction, RemeshError, RemeshRequest, Remesher, RemesherInfo, monotonic_clock,
};

use crate::models::{bounds, cuboid, is_closed, overlapping_cubes, sized, together, turned, volume};
use crate::remesh;

fn config() -> BlenderConfig {
    BlenderConfig { program: std::env::var_os("MESHMEND_BLENDER").map(Into::into), ..BlenderConfig::default() }
}

fn blender() -> BlenderRemesher {
    static FOUND: OnceLock<RemesherInfo> = OnceLock::new();
    let info = FOUND.get_or_init(|| match BlenderRemesher::find(config()) {
        Ok(found) => found.info().expect("found").clone(),
        Err(missing) => panic!("these tests need a real Blender: {missing}"),
    });
    BlenderRemesher::new(info.clone(), config())
}

#[track_caller]
fn made(soup: &Soup, action: RemeshAction, voxel_size: f64) -> Soup {
    let (result, log) = remesh(&blender(), soup, action, voxel_size, 1_000_000);
    result.unwrap_or_else(|error| panic!("{error}\n{log}"))
}

#[track_caller]
fn union(soup: &Soup) -> Soup {
    made(soup, RemeshAction::BooleanUnion, f64::NAN)
}

#[track_caller]
fn assert_close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance * expected.abs(), "found {found}, expected {expected}");
}

#[test]
fn a_voxel_remesh_of_a_box_is_closed_and_has_its_volume_and_place() {
    let (low, high) = (DVec3::new(10.0, 20.0, 30.0), DVec3::new(40.0, 40.0, 40.0));
    let solid = made(&cuboid(low, high), RemeshAction::VoxelRemesh, 0.5);
    assert!(is_closed(&solid));
    assert_close(volume(&solid), 6000.0, 0.01);
    let (found_low, found_high) = bounds(&solid);
    assert!((found_low - low).abs().max_element() < 0.5, "{found_low}");
    assert!((found_high - high).abs().max_element() < 0.5, "{found_high}");
}

#[test]
fn a_voxel_remesh_keeps_unit_and_place_far_from_the_origin_and_at_extreme_sizes() {
    for (size, place) in [(1.0, 1e6), (1e-6, 0.0), (1e-6, 1.0), (1e9, -3e9), (1e-150, 0.0), (1e150, 0.0)] {
        let low = DVec3::splat(place);
        let high = low + size;
        let solid = made(&cuboid(low, high), RemeshAction::VoxelRemesh, size / 20.0);
        assert!(is_closed(&solid), "size {size} at {place}");
        assert_close(volume(&sized(&solid, size)), 1.0, 0.05);
        let (found_low, found_high) = bounds(&solid);
        assert!((found_low - low).abs().max_element() < size / 20.0, "size {size} at {place}: {found_low}");
        assert!((found_high - high).abs().max_element() < size / 20.0, "size {size} at {place}: {found_high}");
    }
}

#[test]
fn a_voxel_remesh_unites_overlapping_parts() {
    let solid = made(&overlapping_cubes(1.0, DVec3::ZERO), RemeshAction::VoxelRemesh, 0.02);
    assert!(is_closed(&solid));
    assert_close(volume(&solid), 1.875, 0.02);
}

#[test]
fn the_union_of_overlapping_cubes_is_closed_and_has_the_exact_volume() {
    let solid = union(&overlapping_cubes(1.0, DVec3::ZERO));
    assert!(is_closed(&solid));
    assert_close(volume(&solid), 1.875, 1e-6);
}

#[test]
fn the_union_keeps_unit_and_place_far_from_the_origin_and_at_extreme_sizes() {
    for (size, place) in [(1.0, 1e6), (1e-6, 1.0), (1e9, -3e9), (1e-150, 0.0)] {
        let solid = union(&overlapping_cubes(size, DVec3::splat(place)));
        assert!(is_closed(&solid), "size {size} at {place}");
        assert_close(volume(&sized(&solid, size)), 1.875, 1e-5);
    }
}

#[test]
fn the_union_does_not_move_what_it_leaves_alone() {
    // Thirds have no exact f32, and the shift to the frame rounds them.
    let cubes = overlapping_cubes(1.0 / 3.0, DVec3::new(0.1, 100.1, -7.7));
    let solid = union(&cubes);
    let kept = |position: &&DVec3| solid.positions.contains(position);
    // One corner of each cube lies inside the other.
    assert_eq!(cubes.positions.iter().filter(kept).count(), 14);
}

#[test]
fn the_union_keeps_a_cavity_and_swallows_an_inner_body() {
    let outer = cuboid(DVec3::ZERO, DVec3::splat(4.0));
    let inner = cuboid(DVec3::splat(1.0), DVec3::splat(3.0));
    let hollow = union(&together(&[outer.clone(), turned(inner.clone())]));
    assert_close(volume(&hollow), 56.0, 1e-6);
    let solid = union(&together(&[outer, inner]));
    assert_close(volume(&solid), 64.0, 1e-6);
    assert!(is_closed(&hollow) && is_closed(&solid));
}

#[test]
fn the_union_removes_a_double_wall_and_closes_up() {
    let mut walled = cuboid(DVec3::ZERO, DVec3::ONE);
    walled.faces.extend([[0, 1, 7], [7, 1, 0], [0, 7, 6], [6, 7, 0]]);
    let solid = union(&walled);
    assert!(is_closed(&solid));
    assert_close(volume(&solid), 1.0, 1e-6);
}

#[test]
fn faces_that_are_flat_or_repeated_do_no_harm() {
    let mut soup = overlapping_cubes(1.0, DVec3::ZERO);
    soup.positions.push(DVec3::splat(f64::NAN));
    soup.positions.push(soup.positions[0]);
    let again = soup.faces[0];
    soup.faces.extend([[0, 0, 1], [1, 1, 1], [0, 17, 1], again, again]);
    assert_close(volume(&union(&soup)), 1.875, 1e-6);
    assert_close(volume(&made(&soup, RemeshAction::VoxelRemesh, 0.02)), 1.875, 0.02);
}

#[test]
fn the_same_mesh_gives_the_same_result() {
    let cubes = overlapping_cubes(1.0, DVec3::ZERO);
    for action in [RemeshAction::VoxelRemesh, RemeshAction::BooleanUnion] {
        assert!(made(&cubes, action, 0.01) == made(&cubes, action, 0.01), "{action:?} differs from run to run");
    }
}

#[test]
fn a_result_with_nothing_in_it_is_told() {
    let cube = cuboid(DVec3::ZERO, DVec3::ONE);
    let flat = vec![[0, 0, 1], [1, 2, 1]];
    for (soup, action) in [
        (Soup::default(), RemeshAction::VoxelRemesh),
        (Soup { positions: cube.positions.clone(), faces: flat.clone() }, RemeshAction::VoxelRemesh),
        (Soup { positions: cube.positions.clone(), faces: flat }, RemeshAction::BooleanUnion),
    ] {
        let (result, log) = remesh(&blender(), &soup, action, 0.1, 1000);
        assert_eq!(result.unwrap_err(), RemeshError::Empty, "{log}");
    }
}

#[test]
fn more_faces_than_allowed_are_told_with_their_number() {
    let cube = cuboid(DVec3::ZERO, DVec3::ONE);
    let (result, log) = remesh(&blender(), &cube, RemeshAction::VoxelRemesh, 0.05, 100);
    match result {
        Err(RemeshError::TooManyFaces { faces, most: 100 }) => assert!((3000..10_000).contains(&faces), "{faces}"),
        other => panic!("{other:?}\n{log}"),
    }
}

#[test]
fn a_voxel_that_would_eat_the_memory_is_refused_before_anything_runs() {
    let cube = cuboid(DVec3::ZERO, DVec3::ONE);
    for (voxel_size, words) in [(1e-4, "memory"), (1e-9, "too small"), (0.0, "above zero"), (f64::NAN, "above zero")] {
        let nothing = RemesherInfo { kind: "blender".into(), version: "4.2.0".into(), program: "/nowhere".into() };
        let remesher = BlenderRemesher::new(nothing, BlenderConfig::default());
        let (result, _) = remesh(&remesher, &cube, RemeshAction::VoxelRemesh, voxel_size, 1000);
        match result {
            Err(RemeshError::Failed(message)) => assert!(message.contains(words), "{message}"),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_run_that_needs_more_memory_than_allowed_fails_and_says_so() {
    // A union is not estimated, so that the limit strikes inside the program.
    let parts: Vec<Soup> = (0..4000).map(|i| overlapping_cubes(1.0, DVec3::X * f64::from(i) * 3.0)).collect();
    let config = BlenderConfig { memory: 1 << 20, ..config() };
    let remesher = BlenderRemesher::new(blender().info().expect("found").clone(), config);
    let (result, log) = remesh(&remesher, &together(&parts), RemeshAction::BooleanUnion, 1.0, 1_000_000);
    match result {
        Err(RemeshError::Failed(message)) => assert!(message.contains("memory"), "{message}\n{log}"),
        other => panic!("{other:?}\n{log}"),
    }
}

#[test]
fn a_remesh_in_stages_gives_the_last_one() {
    let cube = cuboid(DVec3::ZERO, DVec3::ONE);
    let (cancel, clock, time_limit) = (AtomicBool::new(false), monotonic_clock(), Duration::from_secs(100));
    let request = RemeshRequest {
        soup: &cube,
        action: RemeshAction::VoxelRemesh,
        voxel_size: 0.009,
        coarsest: 1.0,
        max_faces: 10_000_000,
        time_limit,
        percent: 0,
    };
    let made = blender().remesh(&request, &Context::new(&NoProgress, &cancel, &clock, time_limit)).unwrap();
    assert_eq!((made.voxel_size, &made.note), (None, &None));
    assert!(is_closed(&made.soup));
    assert!((100_000..300_000).contains(&made.soup.faces.len()), "{}", made.soup.faces.len());
}

#[test]
fn a_warm_up_finds_it_working() {
    let info = blender().info().expect("found").clone();
    assert!(matches!(warm_up(info, config()), WarmUpResult::Warm(_)));
}
