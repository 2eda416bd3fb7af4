//! Pictures, GLB and PLY drawings, read back as other programs read them.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use meshmend::format::{Limits, read};
use meshmend::inspect::{Defect, DefectKind, Findings};
use meshmend::mesh::{Soup, Surface};
use meshmend::render::{
    Drawing, Marked, Paint, RenderError, Scene, draw_inspected, draw_remaining, draw_repaired, write_glb, write_ply,
};
use serde_json::Value;

use crate::meshes::cube;
use crate::support::with_context;

fn scene(soup: &Soup, findings: &Findings) -> Scene {
    with_context(|context| Scene::new(soup, findings, context)).unwrap()
}

fn drawings(soup: &Soup, findings: &Findings) -> Vec<Drawing> {
    with_context(|context| draw_inspected(Marked { soup, findings }, context)).unwrap()
}

fn defect(faces: &[u32], at: DVec3, line: &[DVec3]) -> Defect {
    let line = line.iter().map(|p| p.to_array()).collect();
    Defect { at: at.to_array(), faces: faces.to_vec(), line, value: None, meeting: None }
}

/// A cube at `low` with an intersecting face, a hole of four edges and a non-manifold vertex.
fn marked_cube(low: DVec3, size: f64) -> (Soup, Findings) {
    let soup = cube(low, size, 1);
    let mut findings = Findings::new(soup.faces.len(), 100);
    let corner = |x: f64, y: f64| low + DVec3::new(x, y, 1.0) * size;
    let ring = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
    findings.push(DefectKind::SelfIntersection, defect(&[0], soup.corners(0)[0], &[]));
    findings.push(DefectKind::Hole, defect(&[1, 2], ring[0], &ring));
    findings.push(DefectKind::NonManifoldVertex, defect(&[], ring[0], &[]));
    (soup, findings)
}

/// The two chunks of a GLB file.
fn parse(glb: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&glb[..4], word(4), word(8)), (b"glTF".as_slice(), 2, glb.len()));
    let json = word(12);
    assert_eq!((json % 4, &glb[16..20]), (0, b"JSON".as_slice()));
    let document = serde_json::from_slice(&glb[20..20 + json]).unwrap();
    if 20 + json == glb.len() {
        return (document, &[]);
    }
    let start = 28 + json;
    assert_eq!((word(20 + json), &glb[24 + json..start]), (glb.len() - start, b"BIN\0".as_slice()));
    (document, &glb[start..])
}

fn number(value: &Value) -> usize {
    usize::try_from(value.as_u64().unwrap()).unwrap()
}

/// The points that a primitive draws, checked against the bounds of its accessors.
fn points(document: &Value, bytes: &[u8], primitive: &Value) -> Vec<Vec3> {
    let words = |accessor: &Value, each: usize| -> Vec<[u8; 4]> {
        let view = &document["bufferViews"][number(&accessor["bufferView"])];
        let (start, length) = (number(&view["byteOffset"]), number(&view["byteLength"]));
        assert_eq!((length, start % 4), (number(&accessor["count"]) * each * 4, 0));
        bytes[start..start + length].chunks_exact(4).map(|w| w.try_into().unwrap()).collect()
    };
    let accessor = &document["accessors"][number(&primitive["attributes"]["POSITION"])];
    let numbers: Vec<f32> = words(accessor, 3).into_iter().map(f32::from_le_bytes).collect();
    let all: Vec<Vec3> = numbers.chunks_exact(3).map(Vec3::from_slice).collect();
    for k in 0..3 {
        let least = all.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min);
        assert_eq!(accessor["min"][k].as_f64().unwrap() as f32, least);
    }
    match primitive.get("indices") {
        None => all,
        Some(indices) => {
            let indices = words(&document["accessors"][number(indices)], 1);
            indices.into_iter().map(|i| all[u32::from_le_bytes(i) as usize]).collect()
        }
    }
}

/// The mode of each primitive in a node's mesh, with the points that it draws.
fn drawn(document: &Value, bytes: &[u8], name: &str) -> Vec<(u64, Vec<Vec3>)> {
    let node = document["nodes"].as_array().unwrap().iter().find(|n| n["name"] == name);
    let mesh = &document["meshes"][number(&node.unwrap_or_else(|| panic!("no node {name}"))["mesh"])];
    let primitives = mesh["primitives"].as_array().unwrap();
    primitives.iter().map(|p| (p["mode"].as_u64().unwrap(), points(document, bytes, p))).collect()
}

#[test]
fn a_glb_has_a_node_for_each_kind_with_its_faces_lines_and_points_and_the_legend() {
    let (soup, findings) = marked_cube(DVec3::ZERO, 2.0);
    let glb = with_context(|context| write_glb(&scene(&soup, &findings), context)).unwrap();
    let (document, bytes) = parse(&glb);
    assert_eq!(document["asset"]["version"], "2.0");
    assert_eq!(number(&document["buffers"][0]["byteLength"]), bytes.len());
    let triangles: usize = 3 * soup.faces.len();
    let sound = drawn(&document, bytes, "sound");
    assert_eq!((sound[0].0, sound[0].1.len()), (4, triangles - 9));
    let crossing = drawn(&document, bytes, "self_intersection");
    assert_eq!((crossing[0].0, crossing[0].1.len()), (4, 3));
    assert_eq!(crossing[0].1[0].as_dvec3(), soup.corners(0)[0]);
    let hole = drawn(&document, bytes, "hole");
    assert_eq!(hole.iter().map(|(mode, p)| (*mode, p.len())).collect::<Vec<_>>(), [(4, 6), (1, 8)], "closed chain");
    let vertex = drawn(&document, bytes, "non_manifold_vertex");
    assert_eq!(vertex, [(0, vec![Vec3::new(0.0, 0.0, 2.0)])]);
    let material = &document["meshes"][number(&document["nodes"][2]["mesh"])]["primitives"][0]["material"];
    assert!(document["materials"][number(material)]["name"].is_string());
    let legend = &document["scenes"][0]["extras"]["legend"];
    assert_eq!(
        legend[0],
        serde_json::json!({
            "kind": "self_intersection", "name": "self-intersection", "colour": "#D1241B", "count": 1
        })
    );
    assert_eq!(legend.as_array().map(Vec::len), Some(3));
    // The model has z up and glTF has y up.
    let turn: Vec<f64> =
        document["nodes"][0]["rotation"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    let up = glam::DQuat::from_slice(&turn) * DVec3::Z;
    assert!(up.abs_diff_eq(DVec3::Y, 1e-12), "{up}");
}

#[test]
fn far_from_the_origin_a_glb_keeps_the_model_s_detail() {
    let low = DVec3::new(1e8, -3e8, 5e7);
    let (soup, findings) = marked_cube(low, 1.0);
    let glb = with_context(|context| write_glb(&scene(&soup, &findings), context)).unwrap();
    let (document, bytes) = parse(&glb);
    let root = &document["nodes"][0];
    let read =
        |name: &str| -> Vec<f64> { root[name].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect() };
    let (turn, moved) = (glam::DQuat::from_slice(&read("rotation")), DVec3::from_slice(&read("translation")));
    let dot = drawn(&document, bytes, "non_manifold_vertex")[0].1[0].as_dvec3();
    let placed = turn * dot + moved;
    let model = low + DVec3::Z;
    assert!(placed.abs_diff_eq(DVec3::new(model.x, model.z, -model.y), 1e-6), "{placed}");
}

#[test]
fn a_drawn_ply_has_the_legend_then_the_mesh_ordered_by_kind_then_the_markers() {
    let (soup, findings) = marked_cube(DVec3::new(0.1, 0.2, 0.3), 2.0);
    let ply = with_context(|context| write_ply(&scene(&soup, &findings), context)).unwrap();
    let found = read(&ply, &Limits::default()).unwrap();
    let markers = 4 * 6 + 8;
    assert_eq!(found.soup.faces.len(), soup.faces.len() + markers);
    let corners = |soup: &Soup, f: usize| {
        let mut mesh = soup.corners(f).map(|p| p.to_array());
        mesh.sort_by(|a, b| a.partial_cmp(b).unwrap());
        mesh
    };
    for f in 0..soup.faces.len() {
        assert!(
            (0..soup.faces.len()).any(|g| corners(&found.soup, g) == corners(&soup, f)),
            "face {f} is present exactly"
        );
    }
    let end = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&ply[..end]).unwrap();
    assert!(header.contains("comment legend hole #E69F00 1 hole\n"), "{header}");
    assert!(header.contains("property double x\n"), "0.1 is no f32");
    assert!(header.contains(&format!("comment faces from {} on are markers", soup.faces.len())), "{header}");
    // The vertices of a marked face have the colour of its kind, and no other vertex of the mesh has.
    let vertex = |v: usize| &ply[end + v * 27..end + (v + 1) * 27];
    let count = found.soup.positions.len();
    let faces = &ply[end + count * 27..];
    let red: Vec<usize> =
        (0..soup.faces.len()).filter(|&f| faces[f * 14 + 13] == 1 + DefectKind::SelfIntersection as u8).collect();
    assert_eq!(red.len(), 1);
    for v in found.soup.faces[red[0]] {
        assert_eq!(vertex(v as usize)[24..], [0xD1, 0x24, 0x1B]);
    }
    assert_eq!((0..count).filter(|&v| vertex(v)[24..] == [0xD1, 0x24, 0x1B]).count(), 3);
}

#[test]
fn the_same_mesh_gives_the_same_bytes_on_one_thread_and_on_several() {
    let (soup, findings) = marked_cube(DVec3::ONE, 3.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| drawings(&soup, &findings))
    };
    assert_eq!(on(1), on(4));
}

#[test]
fn hostile_meshes_and_findings_are_drawn_without_a_panic() {
    let nan = DVec3::NAN;
    let (cube, _) = marked_cube(DVec3::ZERO, 1.0);
    let scaled = |by: f64| Soup { positions: cube.positions.iter().map(|&p| p * by).collect(), ..cube.clone() };
    let mut outlier = cube.clone();
    outlier.positions.push(DVec3::new(1e300, -1e300, 1e300));
    outlier.faces.push([0, 1, u32::try_from(outlier.positions.len()).unwrap() - 1]);
    let soups = [
        Soup::default(),
        Soup { positions: vec![nan; 3], faces: vec![[0, 1, 2], [0, 9, 4]] },
        Soup { positions: vec![DVec3::ONE; 3], faces: vec![[0, 1, 2], [0, 0, 0]] },
        Soup { positions: vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0], faces: vec![[0, 1, 2]] },
        scaled(1e300),
        scaled(1.7e308),
        scaled(1e-300),
        scaled(5e-324),
        outlier,
    ];
    for soup in &soups {
        let mut findings = Findings::new(soup.faces.len(), 1000);
        for kind in DefectKind::ALL {
            findings.push(kind, defect(&[0, 1, u32::MAX], nan, &[]));
            findings.push(kind, defect(&[], DVec3::splat(f64::MAX), &[nan, DVec3::ZERO, DVec3::INFINITY, DVec3::ZERO]));
            findings.push(kind, defect(&[0], DVec3::ZERO, &[DVec3::ZERO, DVec3::splat(f64::MIN), DVec3::ZERO]));
        }
        for drawing in drawings(soup, &findings) {
            match drawing.name {
                "defects.glb" => {
                    let (document, bytes) = parse(&drawing.bytes);
                    assert!(document["meshes"].as_array().is_none_or(|meshes| !meshes.is_empty()));
                    assert!(bytes.chunks_exact(4).all(|w| f32::from_le_bytes(w.try_into().unwrap()).is_finite()));
                }
                "defects.ply" => assert!(drawing.bytes.starts_with(b"ply\n")),
                _ => assert!(drawing.bytes.starts_with(b"\x89PNG")),
            }
        }
    }
}

#[test]
fn a_repair_is_drawn_before_and_after_and_without_a_result_only_before() {
    let (soup, findings) = marked_cube(DVec3::ZERO, 1.0);
    let clean = Findings::new(soup.faces.len(), 1);
    let before = Marked { soup: &soup, findings: &findings };
    let after = Marked { soup: &soup, findings: &clean };
    let names = |drawings: &[Drawing]| drawings.iter().map(|d| d.name).collect::<Vec<_>>();
    let both = with_context(|context| draw_repaired(before, Some(after), context)).unwrap();
    assert_eq!(names(&both), ["before.png", "defects.glb", "defects.ply", "after.png"]);
    assert_ne!(both[0].bytes, both[3].bytes);
    let alone = with_context(|context| draw_repaired(before, None, context)).unwrap();
    assert_eq!(names(&alone), ["before.png", "defects.glb", "defects.ply"]);
}

#[test]
fn remaining_defects_of_a_result_are_drawn_like_defects_of_an_input() {
    let (soup, findings) = marked_cube(DVec3::ZERO, 1.0);
    let marked = Marked { soup: &soup, findings: &findings };
    let defects = with_context(|context| draw_repaired(marked, None, context)).unwrap();
    let remaining = with_context(|context| draw_remaining(marked, context)).unwrap();
    assert_eq!((remaining.name, &remaining.bytes), ("remaining.glb", &defects[1].bytes));
}

#[test]
fn a_coarse_scene_looks_like_the_whole_one_with_few_faces() {
    // A sphere of 80,000 faces, half of which are marked.
    let (around, up) = (200u32, 200u32);
    let at = |i: u32, j: u32| {
        let (u, v) = (f64::from(i % around) / f64::from(around) * TAU, f64::from(j) / f64::from(up) * PI);
        DVec3::new(v.sin() * u.cos(), v.sin() * u.sin(), v.cos()) * 50.0 + DVec3::splat(1000.0)
    };
    let positions = (0..=up).flat_map(|j| (0..around).map(move |i| at(i, j))).collect();
    let corner = |i: u32, j: u32| j * around + i % around;
    let quad = |i: u32, j: u32| {
        [[corner(i, j), corner(i, j + 1), corner(i + 1, j + 1)], [corner(i, j), corner(i + 1, j + 1), corner(i + 1, j)]]
    };
    let faces: Vec<[u32; 3]> = (0..up).flat_map(|j| (0..around).flat_map(move |i| quad(i, j))).collect();
    let half = u32::try_from(faces.len() / 2).unwrap();
    let soup = Soup { positions, faces };
    let mut findings = Findings::new(soup.faces.len(), 10);
    (0..half).for_each(|face| findings.push(DefectKind::SelfIntersection, defect(&[face], DVec3::splat(1000.0), &[])));
    let (whole, coarse) = with_context(|context| {
        let whole = Scene::new(&soup, &findings, context)?;
        let coarse = whole.coarse(5000, context)?;
        Ok::<_, RenderError>((whole, coarse))
    })
    .unwrap();
    assert!((1500..=5000).contains(&coarse.surface.faces.len()), "{}", coarse.surface.faces.len());
    assert_eq!((coarse.legend, coarse.frame), (whole.legend.clone(), whole.frame));
    for &position in &coarse.surface.positions {
        assert!(((position - DVec3::splat(1000.0)).length() - 50.0).abs() < 1.5, "{position}");
    }
    let area = |surface: &Surface| (0..surface.faces.len()).map(|f| surface.area_vector(f).length()).sum::<f64>();
    let share = area(&coarse.surface) / area(&whole.surface);
    assert!((0.95..1.02).contains(&share), "{share}");
    let marked = coarse.paint.iter().filter(|&&paint| paint == Paint::Defect(DefectKind::SelfIntersection)).count();
    let share = marked as f64 / coarse.paint.len() as f64;
    assert!((0.4..0.6).contains(&share), "{share}");
}

#[test]
fn a_picture_is_a_png_of_a_fixed_size() {
    let (soup, findings) = marked_cube(DVec3::ZERO, 1.0);
    let picture = &drawings(&soup, &findings)[0];
    let mut reader = png::Decoder::new(std::io::Cursor::new(&picture.bytes)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((frame.width, frame.height, pixels.len()), (960, 720, 960 * 720 * 3));
}
