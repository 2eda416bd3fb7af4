//! 3MF files that are made to exhaust memory, time or the stack.

use std::time::{Duration, Instant};

use meshmend::format::{Limits, ReadErrorKind, ReadOptions, read, read_scene};
use proptest::prelude::*;

use super::{MESH, assert_no, file, model, package, simple};

const TOO_LARGE: ReadErrorKind = ReadErrorKind::TooLarge;

fn component(id: usize) -> String {
    format!("<component objectid=\"{id}\"/>")
}

/// Objects 1 to `levels`, each with `times` components of the object before it; the first is a mesh.
fn tower(levels: usize, times: usize) -> Vec<u8> {
    let above: String = (2..=levels)
        .map(|id| format!("<object id=\"{id}\"><components>{}</components></object>", component(id - 1).repeat(times)))
        .collect();
    let resources = format!("<object id=\"1\">{MESH}</object>{above}");
    file(&model("", &resources, &format!("<item objectid=\"{levels}\"/>")))
}

#[test]
fn objects_are_not_made_of_themselves() {
    for (components, words) in [
        (vec![(1, 1)], "object 1 contains itself"),
        (vec![(1, 2), (2, 3), (3, 1)], "contains itself"),
        (vec![(1, 9)], "object 9, which does not exist"),
    ] {
        let objects: String = components
            .iter()
            .map(|&(id, of)| format!("<object id=\"{id}\"><components>{}</components></object>", component(of)))
            .collect();
        assert_no(&file(&model("", &objects, "<item objectid=\"1\"/>")), ReadErrorKind::Malformed, words);
    }
}

#[test]
fn objects_are_made_of_objects_to_a_depth() {
    assert_eq!(super::clean(&tower(33, 1)).scene.placed_faces(), 1);
    assert_no(&tower(34, 1), TOO_LARGE, "more than 32 deep");
    // In reverse order each object is referred to before it is defined.
    let objects: String = (1..5000)
        .map(|id| format!("<object id=\"{id}\"><components>{}</components></object>", component(id + 1)))
        .collect();
    let resources = format!("{objects}<object id=\"5000\">{MESH}</object>");
    assert_no(&file(&model("", &resources, "<item objectid=\"1\"/>")), TOO_LARGE, "more than 32 deep");
}

#[test]
fn many_places_of_few_faces_are_counted_before_they_are_made() {
    let begin = Instant::now();
    assert_no(&tower(33, 3), TOO_LARGE, "faces, over the limit");
    assert_eq!(read(&tower(33, 3), &Limits::default()).unwrap_err().kind, TOO_LARGE);
    assert!(begin.elapsed() < Duration::from_secs(5));
}

#[test]
fn counts_are_held_to_the_limits_over_all_objects() {
    let objects: String = (1..=3).map(|id| format!("<object id=\"{id}\">{MESH}</object>")).collect();
    let bytes = file(&model("", &objects, "<item objectid=\"1\"/>"));
    let with = |limits| read_scene(&bytes, &ReadOptions::within(limits));
    assert!(with(Limits { max_faces: 3, max_vertices: 9, ..Limits::default() }).is_ok());
    let faces = with(Limits { max_faces: 2, ..Limits::default() }).unwrap_err();
    assert!(faces.kind == TOO_LARGE && faces.detail.contains("3 faces"), "{faces}");
    let vertices = with(Limits { max_vertices: 8, ..Limits::default() }).unwrap_err();
    assert!(vertices.kind == TOO_LARGE && vertices.detail.contains("9 vertices"), "{vertices}");
    let color = "<m:colorgroup id=\"1\"><m:color color=\"#000000\"/></m:colorgroup>";
    let colors = color.replace("<m:color ", "<m:color color=\"#000000\"/><m:color ");
    let bytes = simple("", &colors, "", MESH);
    let limits = Limits { max_vertices: 3, ..Limits::default() };
    assert!(read_scene(&bytes, &ReadOptions::within(limits)).is_ok());
    let more = simple("", &format!("{colors}{}", colors.replace("id=\"1\"", "id=\"2\"")), "", MESH);
    let error = read_scene(&more, &ReadOptions::within(limits)).unwrap_err();
    assert!(error.kind == TOO_LARGE && error.detail.contains("colours"), "{error}");
}

#[test]
fn xml_that_grows_is_refused() {
    let many = |what: &str, count: usize| what.repeat(count);
    let attributes: String = (0..100).map(|n| format!(" a{n}=\"\"")).collect();
    let namespaces: String = (0..60).map(|n| format!(" xmlns:a{n}=\"urn:{n}\"")).collect();
    let text = model("", &format!("<object id=\"1\">{MESH}</object>"), "<item objectid=\"1\"/>");
    for (text, kind, words) in [
        (text.replace("<resources>", &format!("<x>{}", many("<x>", 10_000))), TOO_LARGE, "64 deep"),
        (
            text.replace("<resources>", &format!("<metadata name=\"Title\">{}", many("<x>", 10_000))),
            TOO_LARGE,
            "64 deep",
        ),
        (text.replace("<object", &format!("<object{attributes}")), TOO_LARGE, "more than 64 attributes"),
        (text.replace("<object", &format!("<object name=\"{}\"", many("x", 5 << 20))), TOO_LARGE, "longer than"),
        (text.replace("<resources>", &format!("<!--{}--><resources>", many("x", 5 << 20))), TOO_LARGE, "longer than"),
        (
            text.replace(
                "<resources>",
                &format!("<metadata name=\"Title\">{}</metadata><resources>", many("x", 2 << 20)),
            ),
            TOO_LARGE,
            "longer than",
        ),
        (text.replace("<mesh>", &format!("<mesh><x{namespaces}><y{namespaces}>")), TOO_LARGE, "namespaces"),
        (
            text.replace(
                "<resources>",
                &format!("{}<resources>", many("<metadata name=\"x:y\" xmlns:x=\"urn:x\"/>", 2)),
            ),
            ReadErrorKind::Malformed,
            "two <metadata> elements",
        ),
        (
            format!("<!DOCTYPE m [<!ENTITY a \"{}\"><!ENTITY b \"{}\">]>{text}", many("x", 1000), many("&a;", 1000)),
            ReadErrorKind::Malformed,
            "document type",
        ),
    ] {
        let begin = Instant::now();
        assert_no(&file(&text), kind, words);
        assert!(begin.elapsed() < Duration::from_secs(5), "{words}");
    }
}

#[test]
fn lists_that_are_searched_linearly_are_bounded() {
    let notes: String = (0..10_001).map(|n| format!("<metadata name=\"x:n{n}\"/>")).collect();
    let text = model("xmlns:x=\"urn:x\"", &format!("<object id=\"1\">{MESH}</object>"), "<item objectid=\"1\"/>");
    assert_no(
        &file(&text.replace("<resources>", &format!("{notes}<resources>"))),
        TOO_LARGE,
        "more than 10000 metadata elements",
    );
    let groups: String = (200..10_201).map(|id| format!("<m:colorgroup id=\"{id}\"/>")).collect();
    assert_no(&simple("", &groups, "", MESH), TOO_LARGE, "more than 10000 property groups and textures");
}

/// Elements of a 3MF model.
const WORDS: [&str; 24] = [
    "<object id=\"1\">",
    "</object>",
    "<mesh>",
    "</mesh>",
    "<vertices>",
    "<vertex x=\"0\" y=\"0\" z=\"0\"/>",
    "</vertices>",
    "<triangles>",
    "<triangle v1=\"0\" v2=\"0\" v3=\"0\"/>",
    "<triangle v1=\"0\" v2=\"0\" v3=\"0\" pid=\"2\" p1=\"0\"/>",
    "</triangles>",
    "<components><component objectid=\"1\"/></components>",
    "<m:colorgroup id=\"2\"><m:color color=\"#000000\"/></m:colorgroup>",
    "<m:multiproperties id=\"3\" pids=\"2 2\"><m:multi pindices=\"0\"/></m:multiproperties>",
    "<m:compositematerials id=\"4\" matid=\"5\" matindices=\"\"><m:composite values=\"\"/></m:compositematerials>",
    "<basematerials id=\"5\"><base name=\"\" displaycolor=\"#000000\"/></basematerials>",
    "<m:texture2d id=\"6\" path=\"/3D/3dmodel.model\" contenttype=\"image/png\"/>",
    "<m:texture2dgroup id=\"7\" texid=\"6\"><m:tex2coord u=\"0\" v=\"0\"/></m:texture2dgroup>",
    "</resources><build>",
    "<item objectid=\"1\"/>",
    "</build>",
    "<resources>",
    "&amp;",
    "<![CDATA[]]>",
];

fn assert_answers(model: &[u8]) {
    let begin = Instant::now();
    let rels = super::relationships(&[(super::MODEL, "/3D/3dmodel.model")]);
    let bytes = package(&[(super::ROOT_RELATIONSHIPS, rels.as_bytes()), (super::ROOT, model)]);
    if let Err(error) = read_scene(&bytes, &ReadOptions::default()) {
        assert!(!error.detail.is_empty() && error.detail.len() < 600, "{error}");
    }
    assert!(begin.elapsed() < Duration::from_secs(5), "took {:?}", begin.elapsed());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_elements_in_any_order_are_answered(words in prop::collection::vec(0..WORDS.len(), 0..40)) {
        let resources: String = words.into_iter().map(|word| WORDS[word]).collect();
        assert_answers(model("", &resources, "<item objectid=\"1\"/>").as_bytes());
    }

    #[test]
    fn damaged_models_are_answered(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3_u8), 1..8),
    ) {
        let resources = format!("{}{}<object id=\"1\" pid=\"2\" pindex=\"0\">{MESH}</object>", WORDS[12], WORDS[15]);
        let mut bytes = model("", &resources, "<item objectid=\"1\" transform=\"1 0 0 0 1 0 0 0 1 0 0 0\"/>").into_bytes();
        for (at, value, what) in changes {
            let at = at.index(bytes.len());
            match what {
                0 => bytes[at] = value,
                1 => bytes.insert(at, value),
                _ => { bytes.remove(at); }
            }
        }
        assert_answers(&bytes);
    }
}
