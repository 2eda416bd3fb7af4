//! Mesh characteristics, as meshalyzer defines them, of shapes with known values.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::format::{Format, Limits, read, write};
use meshmend::inspect::{
    Answer, Distribution, FileFacts, InspectOptions, Inspection, Lack, Level, SelfIntersections, Subject, Thresholds,
    Unmeasurable, goodness, inspect, solids,
};
use meshmend::mesh::{Edges, Numbering, Parts, Soup, Surface};
use meshmend::repair::{Context, NoProgress};
use proptest::prelude::*;

use crate::meshes::{cube, inside_out, join, sheet, sphere, torus};

fn with_numbering<'a>(soup: &'a Soup, numbering: Option<&'a Numbering>) -> Subject<'a> {
    Subject { facts: FileFacts { numbering, ..FileFacts::default() }, ..Subject::from(soup) }
}

fn inspect_subject(subject: Subject<'_>, options: &InspectOptions) -> Inspection {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    inspect(subject, options, &Context::new(&NoProgress, &cancel, &clock, Duration::MAX)).unwrap().0
}

fn inspect_soup(soup: &Soup) -> Inspection {
    inspect_subject(soup.into(), &InspectOptions::default())
}

/// The outer surface of `columns` by `rows` unit cubes, without those where `hole` is true.
fn block(columns: i32, rows: i32, hole: impl Fn(i32, i32) -> bool) -> Soup {
    let full = |x: i32, y: i32| (0..columns).contains(&x) && (0..rows).contains(&y) && !hole(x, y);
    let mut soup = Soup::default();
    for x in 0..columns {
        for y in 0..rows {
            if !full(x, y) {
                continue;
            }
            let one = cube(DVec3::new(f64::from(x), f64::from(y), 0.0), 1.0, 1);
            for face in 0..one.faces.len() {
                let [a, b, c] = one.corners(face);
                let out = (b - a).cross(c - a);
                if out.z != 0.0 || !full(x + out.x as i32, y + out.y as i32) {
                    crate::meshes::push(&mut soup, [a, b, c]);
                }
            }
        }
    }
    soup
}

#[test]
fn genus_counts_the_handles() {
    for (name, soup, handles) in [
        ("cube", cube(DVec3::ZERO, 1.0, 3), 0),
        ("ball", sphere(DVec3::ONE, 2.0, 20, 10), 0),
        ("torus", torus(3.0, 1.0, 24, 12), 1),
        ("block with two holes", block(5, 3, |x, y| y == 1 && (x == 1 || x == 3)), 2),
        ("block with three holes", block(7, 3, |x, y| y == 1 && x % 2 == 1), 3),
    ] {
        let characteristics = inspect_soup(&soup).characteristics;
        assert_eq!(characteristics.shells.genus, Some(handles), "{name}");
        assert_eq!((characteristics.shells.list[0].genus, characteristics.shells.count), (Some(handles), 1), "{name}");
    }
}

#[test]
fn each_part_has_its_genus_or_a_reason_why_not() {
    let both = join(&torus(3.0, 1.0, 24, 12), &cube(DVec3::splat(10.0), 1.0, 1));
    let shells = inspect_soup(&both).characteristics.shells;
    assert_eq!(shells.genus, Some(1));
    assert_eq!(shells.list.iter().map(|s| (s.faces, s.genus)).collect::<Vec<_>>(), [(576, Some(1)), (12, Some(0))]);
    let shells = inspect_soup(&join(&both, &sheet(3))).characteristics.shells;
    assert_eq!((shells.genus, shells.genus_not_measurable), (None, Some(Unmeasurable::NotClosed)));
    let open = shells.list.iter().find(|s| s.faces == 18).unwrap();
    assert_eq!((open.genus, open.boundaries, open.closed, open.depth), (None, 1, false, None));
    assert_eq!((open.vertices, open.edges), (16, 33));
    // Two boxes that share an edge are one part.
    let two = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1));
    let shells = inspect_soup(&two).characteristics.shells;
    assert_eq!((shells.count, shells.genus_not_measurable), (1, Some(Unmeasurable::NotManifold)));
    // Two boxes that share a corner are two parts, each with a genus, though the mesh is not manifold.
    let two = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::ONE, 1.0, 1));
    let inspection = inspect_soup(&two);
    assert_eq!((inspection.measures.manifold, inspection.characteristics.shells.genus), (false, Some(0)));
    assert_eq!(inspection.characteristics.shells.list[1].vertices, 8);
}

#[test]
fn a_surface_pinched_at_a_vertex_within_one_part_has_no_genus() {
    // A belt of triangles whose two sides meet in one point.
    let mut soup = torus(3.0, 1.0, 12, 8);
    let (a, b) = (soup.positions[0], soup.positions[300]);
    for p in &mut soup.positions {
        if *p == b {
            *p = a;
        }
    }
    let shell = &inspect_soup(&soup).characteristics.shells.list[0];
    assert_eq!((shell.closed, shell.manifold, shell.genus), (true, false, None));
}

#[test]
fn each_part_s_area_volume_and_bounding_box_are_exact() {
    let both = join(&cube(DVec3::new(1e6, 0.0, 0.0), 0.5, 2), &inside_out(cube(DVec3::ZERO, 2.0, 1)));
    let shells = inspect_soup(&both).characteristics.shells;
    for (shell, area, volume, outward) in [(&shells.list[0], 24.0, -8.0, false), (&shells.list[1], 1.5, 0.125, true)] {
        assert!((shell.area / area - 1.0).abs() < 1e-12 && (shell.volume.value / volume - 1.0).abs() < 1e-12);
        assert_eq!((shell.volume.reliable, shell.outward), (true, Some(outward)));
    }
    assert_eq!((shells.inward, shells.list[1].first_face), (1, 0));
    assert_eq!(shells.list[1].bounding_box.min, [1e6, 0.0, 0.0]);
    assert_eq!(shells.list[0].bounding_box.max, [2.0; 3]);
}

#[test]
fn a_cavity_has_correct_orientation_and_a_solid_in_a_solid_has_not() {
    let outer = cube(DVec3::ZERO, 4.0, 1);
    let inner = cube(DVec3::ONE, 1.0, 1);
    for (soup, outward, depths) in [
        (join(&outer, &inside_out(inner.clone())), Answer::Yes, vec![Some(0), Some(1)]),
        (join(&outer, &inner), Answer::No, vec![Some(0), Some(1)]),
        (join(&inside_out(outer.clone()), &inner), Answer::No, vec![Some(0), Some(1)]),
    ] {
        let characteristics = inspect_soup(&soup).characteristics;
        assert_eq!(characteristics.attributes.outward, outward);
        assert_eq!(characteristics.shells.list.iter().map(|s| s.depth).collect::<Vec<_>>(), depths);
    }
}

#[test]
fn a_thousand_parts_are_counted_and_the_hundred_largest_are_listed() {
    let mut soup = Soup::default();
    for i in 0..1000 {
        let x = f64::from(i) * 10.0;
        crate::meshes::push(
            &mut soup,
            [DVec3::X * x, DVec3::X * (x + 1.0), DVec3::new(x, f64::from(i % 500 + 1), 0.0)],
        );
    }
    let shells = inspect_soup(&soup).characteristics.shells;
    assert_eq!((shells.count, shells.list.len()), (1000, 100));
    assert_eq!([0, 1, 99].map(|i| shells.list[i].first_face), [499, 999, 950]);
}

#[test]
fn elements_distinguish_the_file_s_vertices_from_merged_ones() {
    let box_ = cube(DVec3::ZERO, 1.0, 1);
    let counts = inspect_soup(&box_).characteristics.elements;
    assert_eq!((counts.vertices, counts.indistinguishable_vertices), (36, None), "no vertex is used twice");
    let mut indexed = Soup {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::ZERO, DVec3::ONE, DVec3::X * 3.0],
        faces: vec![[0, 2, 1], [4, 1, 3], [1, 2, 3], [2, 0, 3]],
    };
    indexed.faces.extend([[0, 0, 1], [0, 4, 1], [0, 1, 6]]);
    let inspection = inspect_soup(&indexed);
    let elements = inspection.characteristics.elements;
    assert_eq!((elements.vertices, elements.indistinguishable_vertices), (7, Some(1)));
    assert_eq!((elements.repeated_vertex_faces, elements.collinear_faces), (2, 1));
    assert_eq!((inspection.measures.degenerate_faces, inspection.measures.unreferenced_vertices), (3, 1));
    assert_eq!((elements.missing_vertices, elements.vertices_contiguous), (None, None));
}

#[test]
fn vertex_numbers_of_the_file_are_reported_if_it_has_any() {
    let text = "Vertex 1 0 0 0\nVertex 2 1 0 0\nVertex 5 0 1 0\nFace 1 1 2 5\nFace 2 1 2 7\n";
    let mesh = read(text.as_bytes(), &Limits::default()).unwrap();
    let subject = with_numbering(&mesh.soup, mesh.numbering.as_ref());
    let elements = inspect_subject(subject, &InspectOptions::default()).characteristics.elements;
    assert_eq!((elements.missing_vertices, elements.faces_without_vertex), (Some(1), Some(1)));
    assert_eq!((elements.vertices_contiguous, elements.faces_contiguous), (Some(false), Some(true)));
    assert_eq!(elements.indistinguishable_vertices, Some(0));
}

#[test]
fn statistics_are_left_out_at_level_none_and_attributes_are_not() {
    let options = InspectOptions { level: Level::None, ..InspectOptions::default() };
    let characteristics = inspect_subject((&cube(DVec3::ZERO, 1.0, 1)).into(), &options).characteristics;
    assert_eq!((characteristics.statistics, characteristics.attributes.outward), (None, Answer::Yes));
}

/// A regular tetrahedron with edges of length `sqrt(8)`, and its inspection, which includes the search for intersections.
fn good_mesh() -> (Soup, Inspection) {
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let soup = Soup {
        positions: vec![corner(1., 1., 1.), corner(1., -1., -1.), corner(-1., 1., -1.), corner(-1., -1., 1.)],
        faces: vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
    };
    let mut inspection = inspect_soup(&soup);
    inspection.measures.self_intersections =
        SelfIntersections { checked: true, complete: true, pairs: Some(0), ..SelfIntersections::default() };
    (soup, inspection)
}

#[test]
fn a_mesh_is_good_within_its_thresholds_and_not_on_them() {
    let (_, inspection) = good_mesh();
    let angle = std::f64::consts::TAU - (1f64 / 3.0).acos();
    let within = Thresholds { aspect_ratio: 1.16, edge_angle: angle - 0.01, edge_length: 2.8 };
    assert_eq!(goodness(&inspection, within).reasons, []);
    assert!(goodness(&inspection, within).good);
    let statistics = inspection.characteristics.statistics.as_ref().unwrap();
    let of = |d: &Option<Distribution>| d.clone().unwrap();
    let (ratio, length) = (of(&statistics.face_aspect_ratio).max, of(&statistics.edge_length).min);
    let angle = of(&statistics.edge_angle.distribution).min;
    for (thresholds, lack, value) in [
        (Thresholds { aspect_ratio: ratio, ..within }, Lack::AspectRatio, ratio),
        (Thresholds { edge_angle: angle, ..within }, Lack::EdgeAngle, angle),
        (Thresholds { edge_length: length, ..within }, Lack::EdgeLength, length),
    ] {
        let verdict = goodness(&inspection, thresholds);
        assert!(!verdict.good);
        assert_eq!(verdict.reasons.iter().map(|r| (r.lack, r.value)).collect::<Vec<_>>(), [(lack, Some(value))]);
    }
}

#[test]
fn each_thing_that_meshalyzer_asks_of_a_good_mesh_is_asked() {
    let (soup, fine) = good_mesh();
    let lenient = Thresholds { aspect_ratio: 1e9, edge_angle: 0.0, edge_length: 0.0 };
    let lacks =
        |inspection: &Inspection| goodness(inspection, lenient).reasons.iter().map(|r| r.lack).collect::<Vec<_>>();
    let of = |soup: &Soup| {
        let mut inspection = inspect_soup(soup);
        inspection.measures.self_intersections = fine.measures.self_intersections;
        lacks(&inspection)
    };
    assert!(lacks(&inspect_soup(&soup)).is_empty());
    let mut unfinished = fine.clone();
    unfinished.measures.self_intersections.complete = false;
    assert_eq!(lacks(&unfinished), [Lack::IntersectionsChecked]);
    assert_eq!(of(&inside_out(soup.clone())), [Lack::Outward]);
    let mut open = soup.clone();
    open.faces.pop();
    assert_eq!(of(&open), [Lack::Closed, Lack::Outward]);
    let mut flipped = soup.clone();
    flipped.faces[0].swap(0, 1);
    assert_eq!(of(&flipped), [Lack::Consistent, Lack::Outward, Lack::EdgeAngle]);
    let mut orphan = soup.clone();
    orphan.positions.push(DVec3::ZERO);
    assert_eq!(of(&orphan), [Lack::NoOrphanVertices]);
    let mut degenerate = soup.clone();
    degenerate.faces.push([0, 0, 1]);
    assert_eq!(of(&degenerate), [Lack::NoDegenerateFaces]);
    let mut infinite = soup.clone();
    infinite.positions.push(DVec3::INFINITY);
    infinite.faces.push([0, 1, 4]);
    assert_eq!(of(&infinite), [Lack::FiniteFaces]);
    let mut doubled = soup.clone();
    doubled.faces.push([0, 1, 2]);
    assert_eq!(of(&doubled), [Lack::Manifold, Lack::Outward, Lack::EdgeAngle]);
    let mut crossing = fine.clone();
    crossing.measures.self_intersections.pairs = Some(3);
    assert_eq!(lacks(&crossing), [Lack::NoIntersectingFaces]);
    let numbering = Numbering {
        vertices_contiguous: false,
        faces_contiguous: false,
        missing_vertices: 2,
        faces_without_vertex: 1,
        ..Numbering::default()
    };
    let subject = with_numbering(&soup, Some(&numbering));
    let mut numbered = inspect_subject(subject, &InspectOptions::default());
    numbered.measures.self_intersections = fine.measures.self_intersections;
    assert_eq!(lacks(&numbered), [Lack::NoMissingVertices, Lack::ContiguousVertices, Lack::ContiguousFaces]);
    let counts: Vec<_> = goodness(&numbered, lenient).reasons.iter().map(|r| r.value).collect();
    assert_eq!(counts, [Some(2.0), None, None]);
}

#[test]
fn an_inspection_goes_through_json_and_comes_back_the_same() {
    for scale in [1.0, 1e300, 1e-300] {
        let mut soup = join(&torus(3.0, 1.0, 12, 8), &sheet(3));
        soup.positions.iter_mut().for_each(|p| *p *= scale);
        let inspection = inspect_soup(&soup);
        let text = serde_json::to_string(&inspection).unwrap();
        assert_eq!(serde_json::from_str::<Inspection>(&text).unwrap(), inspection);
    }
}

#[test]
fn a_mesh_without_a_usable_face_is_described_too() {
    for soup in [
        Soup::default(),
        Soup { positions: vec![DVec3::NAN; 3], faces: vec![[0, 1, 2]] },
        Soup { positions: vec![DVec3::X; 3], faces: vec![[0, 1, 2]] },
    ] {
        let characteristics = inspect_soup(&soup).characteristics;
        assert_eq!(
            (characteristics.attributes.closed, characteristics.shells.count, characteristics.shells.genus),
            (Answer::No, 0, None)
        );
        assert_eq!(characteristics.statistics.unwrap().edge_length, None);
    }
}

/// Broken meshes: faces of a wavy torus, some missing, some flipped, with arbitrary faces among them.
fn broken() -> impl Strategy<Value = Soup> {
    let bumps = prop::collection::vec(-0.2..0.2f64, 30);
    let kept = prop::collection::vec(0..8u8, 60);
    (bumps, kept, 0..3u32).prop_map(|(bumps, kept, extra)| {
        let whole = Soup {
            positions: (0..30)
                .map(|v| {
                    let (u, w) = (f64::from(v / 5) * 1.05, f64::from(v % 5) * 1.26);
                    let r = 3.0 + w.cos() + bumps[v as usize];
                    DVec3::new(r * u.cos(), r * u.sin(), w.sin())
                })
                .collect(),
            faces: (0..6u32)
                .flat_map(|i| (0..5u32).map(move |j| (i, j)))
                .flat_map(|(i, j)| {
                    let at = |i: u32, j: u32| i % 6 * 5 + j % 5;
                    let q = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                    [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
                })
                .collect(),
        };
        let mut soup = Soup { positions: whole.positions, faces: Vec::new() };
        for (face, kind) in whole.faces.iter().zip(&kept) {
            match kind {
                0 => {}
                1 => soup.faces.push([face[1], face[0], face[2]]),
                _ => soup.faces.push(*face),
            }
        }
        for k in 0..extra {
            soup.faces.push([k, k + 7, 20 + k]);
        }
        soup.faces.push([0, 1, 2]);
        soup
    })
}

/// Compares inspections, with lengths in units of `length`: integers exactly, other numbers within rounding.
#[track_caller]
fn assert_same(a: &Inspection, b: &Inspection, length: f64) {
    let near = |x: f64, y: f64| (x - y).abs() <= 1e-9 * x.abs().max(y.abs()).max(1e-9);
    let (x, y) = (&a.characteristics, &b.characteristics);
    assert_eq!((x.attributes, &x.elements), (y.attributes, &y.elements));
    assert_eq!((x.shells.count, x.shells.genus, x.shells.inward), (y.shells.count, y.shells.genus, y.shells.inward));
    for (s, t) in x.shells.list.iter().zip(&y.shells.list) {
        assert_eq!((s.faces, s.vertices, s.edges, s.boundaries), (t.faces, t.vertices, t.edges, t.boundaries));
        assert_eq!((s.closed, s.manifold, s.consistent, s.genus), (t.closed, t.manifold, t.consistent, t.genus));
        assert!(near(s.area * length * length, t.area));
    }
    let (s, t) = (x.statistics.as_ref().unwrap(), y.statistics.as_ref().unwrap());
    assert_eq!(s.faces_without_aspect_ratio, t.faces_without_aspect_ratio);
    for (of, power, s, t) in [
        ("area", 2, &s.face_area, &t.face_area),
        ("ratio", 0, &s.face_aspect_ratio, &t.face_aspect_ratio),
        ("length", 1, &s.edge_length, &t.edge_length),
        ("angle", 0, &s.edge_angle.distribution, &t.edge_angle.distribution),
    ] {
        assert_eq!(s.is_some(), t.is_some());
        let (Some(s), Some(t)) = (s, t) else { continue };
        let s = s.clone().in_unit(length, power);
        assert_eq!(s.count, t.count, "{of}");
        let pairs = [(s.min, t.min), (s.max, t.max), (s.mean, t.mean), (s.median, t.median)];
        assert!(pairs.iter().all(|&(s, t)| near(s, t)), "{of}: {pairs:?}");
        assert!((s.variance - t.variance).abs() <= 1e-9 * s.max * s.max, "{of}");
        assert_eq!(s.histogram.counts, t.histogram.counts, "{of}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn face_order_rotation_and_scale_change_nothing(
        soup in broken(),
        order in any::<prop::sample::Index>(),
        turns in 0..4u32,
        axis in 0..3usize,
        power in -60..60i32,
    ) {
        let given = inspect_soup(&soup);
        // Reorder faces and vertices, and rotate the corners of each face.
        let n = soup.positions.len() as u32;
        let shift = order.index(n as usize) as u32;
        let mut moved = Soup {
            positions: (0..n).map(|v| soup.positions[((v + n - shift) % n) as usize]).collect(),
            faces: soup.faces.iter().rev().map(|&[a, b, c]| [b, c, a].map(|v| (v + shift) % n)).collect(),
        };
        moved.faces.rotate_left(order.index(soup.faces.len()));
        let scale = 2f64.powi(power);
        for p in &mut moved.positions {
            for _ in 0..turns {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                (p[u], p[v]) = (-p[v], p[u]);
            }
            *p *= scale;
        }
        assert_same(&given, &inspect_soup(&moved), scale);
        // A file with vertex indices gives exactly the same.
        let bytes = write(&soup, Format::Mesh).unwrap();
        let again = inspect_soup(&read(&bytes, &Limits::default()).unwrap().soup);
        prop_assert_eq!(again, given);
    }
}

#[test]
fn measures_of_few_parts_with_many_faces_are_those_of_the_parts() {
    let soup = join(&cube(DVec3::ZERO, 2.0, 60), &cube(DVec3::splat(5.0), 1.0, 40));
    let measured = |surface: &Surface| {
        let edges = Edges::new(&surface.faces);
        solids(surface, &edges, &Parts::new(surface, &edges))
    };
    let (mut surface, _) = Surface::from_soup(&soup);
    let found = measured(&surface);
    let expected = [(8.0, 24.0, DVec3::ZERO, DVec3::splat(2.0)), (1.0, 6.0, DVec3::splat(5.0), DVec3::splat(6.0))];
    assert_eq!(found.len(), expected.len());
    for (solid, (volume, area, min, max)) in found.iter().zip(expected) {
        assert!(solid.closed && (solid.volume - volume).abs() < 1e-9 && (solid.area - area).abs() < 1e-9, "{solid:?}");
        assert_eq!((solid.bounds.min, solid.bounds.max), (min, max));
    }
    // A face of the second part is in a later chunk of the faces than those of the first.
    surface.faces.pop();
    assert_eq!(measured(&surface).iter().map(|solid| solid.closed).collect::<Vec<_>>(), [true, false]);
}
