//! Walls that are too thin grow to the least wall, and the rest of the model stays.

use glam::{DQuat, DVec3};
use meshmend::format::{Limits, read};
use meshmend::math::Box3;
use meshmend::mesh::Soup;
use meshmend::repair::{NotAppliedCause, Options, Outcome, PrintOptions, Repaired, WallGrowth, WallThickening};
use meshmend::scene::Unit;

use crate::meshes::{as_f32, cuboid, cylinder, inside_out, join, push, sphere};
use crate::support::{assert_outcome, measured_file, repair_soup};

/// Thickens to a least wall. Nothing may stay thin.
fn thickened(soup: &Soup, min_wall: f64) -> (Repaired, WallThickening) {
    thickened_on(soup, min_wall, WallGrowth::Both)
}

/// Thickens on some sides.
fn thickened_on(soup: &Soup, min_wall: f64, wall_growth: WallGrowth) -> (Repaired, WallThickening) {
    let print = PrintOptions { min_wall: Some(min_wall), wall_growth, ..PrintOptions::default() };
    let options = Options { print, unit: Some(Unit::Millimetre), max_tier: 2, ..Options::default() };
    let repaired = repair_soup(soup, &options, None);
    assert_outcome(&repaired, Outcome::Repaired);
    let thickening = repaired.report.steps.iter().find_map(|step| step.thickening.clone()).expect("a thickening step");
    assert_eq!(thickening.left_count, 0, "{thickening:?}");
    (repaired, thickening)
}

fn bounds(repaired: &Repaired) -> Box3 {
    Box3::of(read(&repaired.bytes, &Limits::default()).expect("a readable file").soup.positions)
}

fn turned(mut soup: Soup) -> Soup {
    let turn = DQuat::from_scaled_axis(DVec3::new(0.4, -0.9, 0.3));
    soup.positions.iter_mut().for_each(|p| *p = turn * *p);
    as_f32(soup)
}

/// A bracket of two walls, 12 and 9 long, 10 high and 0.8 thick. Its corner is in the origin. A vertex in the middle of the long
/// inner side is `near` the other wall.
fn bracket(near: f64) -> Soup {
    let outline = [[0.0, 0.0], [12.0, 0.0], [12.0, 0.8], [0.8, 0.8], [0.8, 9.0], [0.0, 9.0]];
    let at = |k: usize, z: f64| DVec3::new(outline[k % 6][0], outline[k % 6][1], z);
    let mut soup = Soup::default();
    for [a, b, c] in [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]] {
        push(&mut soup, [at(a, 10.0), at(b, 10.0), at(c, 10.0)]);
        push(&mut soup, [at(a, 0.0), at(c, 0.0), at(b, 0.0)]);
    }
    for k in 0..6 {
        let side = [at(k, 0.0), at(k + 1, 0.0), at(k + 1, 10.0), at(k, 10.0)];
        if k == 2 {
            let middle = DVec3::new(0.8 + near, 0.8, 5.0);
            (0..4).for_each(|i| push(&mut soup, [side[i], side[(i + 1) % 4], middle]));
        } else {
            push(&mut soup, [side[0], side[1], side[2]]);
            push(&mut soup, [side[0], side[2], side[3]]);
        }
    }
    as_f32(soup)
}

/// The volume of the bracket with walls of 1.2, of which each side grew by 0.2.
fn thick_bracket() -> f64 {
    10.0 * 1.2 * (12.2 + 9.2 - 1.2)
}

#[test]
fn a_bracket_keeps_its_faces_while_its_walls_grow() {
    for soup in [bracket(4.0), turned(bracket(4.0))] {
        let (repaired, thickening) = thickened(&soup, 1.2);
        let measured = measured_file(&repaired.bytes);
        assert_eq!(measured.faces, soup.faces.len() as u64);
        assert!((measured.volume.value / thick_bracket() - 1.0).abs() < 0.01, "{}", measured.volume.value);
        // The corner moves along the diagonal.
        assert!((0.28..0.30).contains(&thickening.max_deviation_mm), "{thickening:?}");
    }
}

#[test]
fn a_side_whose_faces_would_turn_over_gets_new_faces() {
    let soup = bracket(0.05);
    let (repaired, _) = thickened(&soup, 1.2);
    let measured = measured_file(&repaired.bytes);
    // The vertex in the middle is gone, and with it two of four faces.
    assert_eq!(measured.faces, soup.faces.len() as u64 - 2);
    assert!((measured.volume.value / thick_bracket() - 1.0).abs() < 0.01, "{}", measured.volume.value);
}

#[test]
fn a_plate_beside_a_block_grows_only_on_its_own_side() {
    // The lower sides of the plate and the block are one flat region.
    let step = join(
        &cuboid(DVec3::ZERO, DVec3::new(20.0, 10.0, 0.5), 1),
        &cuboid(DVec3::ZERO, DVec3::new(10.0, 10.0, 5.0), 1),
    );
    let (repaired, thickening) = thickened(&as_f32(step), 1.0);
    let bounds = bounds(&repaired);
    assert_eq!((bounds.min.z, bounds.max.z), (0.0, 5.0));
    assert!((thickening.added_volume_mm3 / 50.0 - 1.0).abs() < 0.02, "{thickening:?}");
}

#[test]
fn a_frame_of_thin_bars_stays_a_frame_of_few_faces() {
    let (length, thickness) = (10.0, 0.625);
    let mut frame = Soup::default();
    for axis in 0..3 {
        for corner in 0..4 {
            let mut low = DVec3::ZERO;
            low[(axis + 1) % 3] = f64::from(corner & 1) * (length - thickness);
            low[(axis + 2) % 3] = f64::from(corner >> 1) * (length - thickness);
            let mut sides = DVec3::splat(thickness);
            sides[axis] = length;
            frame = join(&frame, &cuboid(low, sides, 1));
        }
    }
    let (repaired, _) = thickened(&as_f32(frame), 1.0);
    let measured = measured_file(&repaired.bytes);
    assert!(measured.faces < 400, "{}", measured.faces);
    // Twelve bars of 1 x 1 around a cube of 10.375, which share eight corners.
    let volume = 12.0 * (10.375 - 2.0) + 8.0;
    assert!((measured.volume.value / volume - 1.0).abs() < 0.02, "{}", measured.volume.value);
}

#[test]
fn a_thin_shell_grows_on_both_sides_and_keeps_its_faces() {
    let shell = as_f32(join(&sphere(DVec3::ZERO, 10.0, 48, 24), &inside_out(sphere(DVec3::ZERO, 9.5, 48, 24))));
    let (repaired, _) = thickened(&shell, 1.0);
    let measured = measured_file(&repaired.bytes);
    assert_eq!(measured.faces, shell.faces.len() as u64);
    let [outer, inner] = [10.0f64, 9.5].map(measured_ball);
    let grown = (measured.volume.value - (outer - inner)) / (4.0 * std::f64::consts::PI * 9.75 * 9.75);
    assert!((0.45..0.56).contains(&grown), "{grown}");
}

/// The volume of the tests' ball of 48 by 24.
fn measured_ball(radius: f64) -> f64 {
    measured_file(&repair_soup(&sphere(DVec3::ZERO, radius, 48, 24), &Options::default(), None).bytes).volume.value
}

#[test]
fn a_wall_that_grows_over_its_neighbour_is_cut_there() {
    // A fin of 0.4 on a plate, 0.3 from the plate's edge: its side grows beyond the edge.
    let plate = cuboid(DVec3::ZERO, DVec3::new(20.0, 10.0, 3.0), 1);
    let fin = cuboid(DVec3::new(0.1, 1.0, 2.0), DVec3::new(0.4, 8.0, 6.0), 1);
    let (repaired, thickening) = thickened(&as_f32(join(&plate, &fin)), 1.0);
    let bounds = bounds(&repaired);
    assert!(bounds.min.x < 0.0 && bounds.max.x == 20.0, "{bounds:?}");
    assert!(thickening.added_volume_mm3 < 0.6 * 8.0 * 5.0 * 1.5, "{thickening:?}");
}

/// A tube of the given number of sides, 20 long. Its outer corners are 10 from the axis.
fn tube(sides: u32, wall: f64) -> Soup {
    let at = |k: u32, radius: f64, z: f64| {
        let angle = std::f64::consts::TAU * f64::from(k % sides) / f64::from(sides);
        DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
    };
    let mut soup = Soup::default();
    let outline = [[10.0, 0.0], [10.0, 20.0], [10.0 - wall, 20.0], [10.0 - wall, 0.0]];
    for k in 0..sides {
        for i in 0..4 {
            let ([r, z], [s, y]) = (outline[i], outline[(i + 1) % 4]);
            let corners = [at(k, r, z), at(k + 1, r, z), at(k + 1, s, y), at(k, s, y)];
            push(&mut soup, [corners[0], corners[1], corners[2]]);
            push(&mut soup, [corners[0], corners[2], corners[3]]);
        }
    }
    as_f32(soup)
}

#[test]
fn a_round_wall_gets_hardly_more_material_than_it_lacks() {
    // With 128 sides, the nearest points of many faces lie aside of each other.
    for (sides, wall) in [(6, 0.3), (16, 0.3), (128, 0.3), (128, 0.6)] {
        for growth in [WallGrowth::Both, WallGrowth::Outward, WallGrowth::Inward] {
            let (repaired, thickening) = thickened_on(&tube(sides, wall), 1.0, growth);
            let half_angle = std::f64::consts::PI / f64::from(sides);
            // Distances of sides from the axis.
            let [outer, inner] = [10.0, 10.0 - wall].map(|radius| radius * half_angle.cos());
            let lack = 1.0 - (outer - inner);
            let middle = match growth {
                WallGrowth::Both => (outer + inner) / 2.0,
                WallGrowth::Outward => outer + lack / 2.0,
                WallGrowth::Inward => inner - lack / 2.0,
            };
            let least = 20.0 * lack * 2.0 * middle * f64::from(sides) * half_angle.tan();
            let share = thickening.added_volume_mm3 / least;
            assert!((0.999..1.02).contains(&share), "{sides}, {wall}, {growth:?}: {share}");
            assert_eq!(repaired.report.options_not_applied, []);
        }
    }
}

#[test]
fn an_open_box_grows_on_the_side_that_is_asked_for() {
    let [outer, inner] = [(DVec3::ZERO, DVec3::splat(20.0)), (DVec3::splat(0.5), DVec3::new(19.0, 19.0, 19.5))];
    let mut open_box = Soup::default();
    for (low, size, is_inner) in [(outer.0, outer.1, false), (inner.0, inner.1, true)] {
        let side = cuboid(low, size, 1);
        let is_top = |face: &[u32; 3]| face.iter().all(|&v| side.positions[v as usize].z == 20.0);
        let faces = side.faces.iter().filter(|face| !is_top(face)).copied().collect();
        let open = Soup { positions: side.positions.clone(), faces };
        open_box = join(&open_box, &if is_inner { inside_out(open) } else { open });
    }
    let ring = |corner: DVec3, size: DVec3| {
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .map(|[x, y]| DVec3::new(corner.x + x * size.x, corner.y + y * size.y, 20.0))
    };
    let (rim, hole) = (ring(outer.0, outer.1), ring(inner.0, inner.1));
    for k in 0..4 {
        push(&mut open_box, [rim[k], rim[(k + 1) % 4], hole[(k + 1) % 4]]);
        push(&mut open_box, [rim[k], hole[(k + 1) % 4], hole[k]]);
    }
    let (inward, _) = thickened_on(&as_f32(open_box.clone()), 1.0, WallGrowth::Inward);
    assert_eq!(bounds(&inward), Box3 { min: DVec3::ZERO, max: DVec3::splat(20.0) });
    let (outward, _) = thickened_on(&as_f32(open_box), 1.0, WallGrowth::Outward);
    let grown = bounds(&outward);
    assert!(grown.min.max_element() < -0.49 && grown.min.min_element() > -0.53 && grown.max.z == 20.0, "{grown:?}");
    let added = measured_file(&outward.bytes).volume.value - measured_file(&inward.bytes).volume.value;
    assert!(added > 0.0);
}

#[test]
fn a_plate_without_an_inner_side_grows_on_both_and_the_report_says_so() {
    let plate = as_f32(cuboid(DVec3::ZERO, DVec3::new(20.0, 10.0, 0.5), 1));
    let (repaired, _) = thickened_on(&plate, 1.0, WallGrowth::Inward);
    let [entry] = &repaired.report.options_not_applied[..] else { panic!("{:?}", repaired.report.options_not_applied) };
    assert_eq!((entry.option.as_str(), entry.cause), ("wall_growth", NotAppliedCause::Limited));
    assert!(entry.reason.contains("no inner side"), "{}", entry.reason);
}

#[test]
fn pins_have_no_inner_side_and_grow_all_around() {
    // Seen from each pin, the free way towards the other one is shorter.
    let plate = cuboid(DVec3::ZERO, DVec3::new(20.0, 20.0, 2.0), 1);
    let pins = [(6.0, 6.0, 0.17, 13), (9.0, 12.0, 0.3, 24)];
    let on_plate =
        |soup: Soup, (x, y, radius, sides)| join(&soup, &cylinder(DVec3::new(x, y, 1.0), radius, 6.0, sides));
    let model = as_f32(pins.into_iter().fold(plate, on_plate));
    for growth in [WallGrowth::Outward, WallGrowth::Inward] {
        let (repaired, thickening) = thickened_on(&model, 0.8, growth);
        assert!(thickening.added_volume_mm3 > 3.0, "{growth:?}: {thickening:?}");
        let [entry] = &repaired.report.options_not_applied[..] else { panic!("{growth:?}") };
        assert!(entry.reason.contains("no inner side"), "{}", entry.reason);
    }
}

#[test]
fn a_bar_does_not_grow_by_what_it_lacks_only_where_thinner_pins_stand_on_it() {
    let (wide, height) = (0.9, 6.0);
    let bar = cuboid(DVec3::ZERO, DVec3::new(20.0, wide, 2.0), 1);
    let with_pin = |soup: Soup, k: u32| {
        join(&soup, &cylinder(DVec3::new(2.0 + 4.0 * f64::from(k), wide / 2.0, 1.0), 0.3, 1.0 + height, 6))
    };
    let fence = as_f32((0..5).fold(bar, with_pin));
    let (repaired, thickening) = thickened(&fence, 1.0);
    let faces = measured_file(&repaired.bytes).faces;
    assert!(faces < 400, "{faces}");
    // The bar lacks a tenth of its width. Hexagons of a radius of 0.3 get one of 1 across.
    let hexagon = |across: f64| 3.0f64.sqrt() / 2.0 * across * across;
    let least = 20.0 * 2.0 * (1.0 - wide) + 5.0 * height * (hexagon(1.0) - hexagon(0.3 * 3.0f64.sqrt()));
    assert!((1.0..1.05).contains(&(thickening.added_volume_mm3 / least)), "{thickening:?}, {least}");
}

/// A tray with walls and a floor of 0.4, whose inner corners are rounded.
fn tray(length: f64, height: f64) -> Soup {
    const STEPS: u32 = 4;
    let (wall, radius) = (0.4, 0.1);
    let at = |[x, y]: [f64; 2], z: f64| DVec3::new(x, y, z);
    let outer = [[length, length], [0.0, length], [0.0, 0.0], [length, 0.0]];
    let arcs: [Vec<[f64; 2]>; 4] = [0u32, 1, 2, 3].map(|k| {
        let [x, y] = outer[k as usize].map(|c| if c == 0.0 { wall + radius } else { length - wall - radius });
        let angle = |step: u32| std::f64::consts::FRAC_PI_2 * (f64::from(k) + f64::from(step) / f64::from(STEPS));
        (0..=STEPS).map(|step| [x + radius * angle(step).cos(), y + radius * angle(step).sin()]).collect()
    });
    let mut soup = Soup::default();
    for k in 0..4 {
        let ([a, b], arc, next) = ([outer[k], outer[(k + 1) % 4]], &arcs[k], arcs[(k + 1) % 4][0]);
        push(&mut soup, [at(a, 0.0), at(a, height), at(b, height)]);
        push(&mut soup, [at(a, 0.0), at(b, height), at(b, 0.0)]);
        arc.windows(2).for_each(|w| push(&mut soup, [at(a, height), at(w[1], height), at(w[0], height)]));
        push(&mut soup, [at(a, height), at(b, height), at(next, height)]);
        push(&mut soup, [at(a, height), at(next, height), at(arc[arc.len() - 1], height)]);
        let middle = at([length / 2.0; 2], wall);
        for [p, q] in arc.windows(2).map(|w| [w[0], w[1]]).chain([[arc[arc.len() - 1], next]]) {
            push(&mut soup, [at(p, wall), at(q, wall), middle]);
            push(&mut soup, [at(p, height), at(q, height), at(q, wall)]);
            push(&mut soup, [at(p, height), at(q, wall), at(p, wall)]);
        }
    }
    push(&mut soup, [at(outer[2], 0.0), at(outer[1], 0.0), at(outer[0], 0.0)]);
    push(&mut soup, [at(outer[2], 0.0), at(outer[0], 0.0), at(outer[3], 0.0)]);
    as_f32(soup)
}

#[test]
fn rounded_corners_that_vanish_do_not_make_the_walls_of_a_tray_too_thick() {
    let (repaired, _) = thickened_on(&tray(20.0, 6.0), 1.0, WallGrowth::Inward);
    let measured = measured_file(&repaired.bytes);
    assert!(measured.faces < 200, "{}", measured.faces);
    // The inside of 18 x 18 x 5 has no rounded corners any more.
    let volume = 20.0 * 20.0 * 6.0 - 18.0 * 18.0 * 5.0;
    assert!((0.999..1.01).contains(&(measured.volume.value / volume)), "{}", measured.volume.value);
}

#[test]
fn a_pointed_tongue_does_not_decide_that_a_plate_has_two_outer_sides() {
    // The window has more room on one side of the tongue.
    let outer = [[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0]];
    let window = [[3.0, 2.0], [17.0, 2.0], [17.0, 8.0], [3.0, 8.0], [3.0, 5.8], [14.0, 5.0], [3.0, 4.0]];
    let at = |[x, y]: [f64; 2], z: f64| DVec3::new(x, y, z);
    let mut plate = Soup::default();
    for (ring, is_inner) in [(&outer[..], false), (&window[..], true)] {
        for (k, &a) in ring.iter().enumerate() {
            let [a, b] = if is_inner { [ring[(k + 1) % ring.len()], a] } else { [a, ring[(k + 1) % ring.len()]] };
            push(&mut plate, [at(a, 0.0), at(b, 0.0), at(a, 0.5)]);
            push(&mut plate, [at(b, 0.0), at(b, 0.5), at(a, 0.5)]);
        }
    }
    let (o, w) = (outer, window);
    let top = [
        [o[0], o[1], w[1]],
        [o[0], w[1], w[0]],
        [o[1], o[2], w[1]],
        [o[2], w[2], w[1]],
        [o[3], w[3], w[2]],
        [o[2], o[3], w[2]],
        [o[3], o[0], w[6]],
        [o[0], w[0], w[6]],
        [o[3], w[6], w[4]],
        [o[3], w[4], w[3]],
        [w[6], w[5], w[4]],
    ];
    for [a, b, c] in top {
        push(&mut plate, [at(a, 0.5), at(b, 0.5), at(c, 0.5)]);
        push(&mut plate, [at(a, 0.0), at(c, 0.0), at(b, 0.0)]);
    }
    let (repaired, _) = thickened_on(&as_f32(plate), 0.8, WallGrowth::Inward);
    // Flat layers on both sides. Balls along the middle would stand out farther.
    let bounds = bounds(&repaired);
    assert!(bounds.min.z > -0.18 && bounds.max.z < 0.68, "{bounds:?}");
}

#[test]
fn a_blade_grows_where_only_balls_can_thicken_it() {
    // Both sides end in sharp edges.
    let outline = [[0.0, 0.0], [5.0, -0.3], [10.0, 0.0], [5.0, 0.3]].map(|[x, y]| DVec3::new(x, y, 0.0));
    let mut blade = Soup::default();
    for k in 0..4 {
        let [a, b] = [outline[k], outline[(k + 1) % 4]];
        let up = DVec3::Z * 8.0;
        push(&mut blade, [a, b, b + up]);
        push(&mut blade, [a, b + up, a + up]);
    }
    for k in [1, 2] {
        push(&mut blade, [outline[0], outline[k + 1], outline[k]]);
        push(&mut blade, [outline[0], outline[k], outline[k + 1]].map(|p| p + DVec3::Z * 8.0));
    }
    thickened_on(&turned(blade), 0.8, WallGrowth::Outward);
}
