//! Objects, components, build items, units and parts in 3MF.

use glam::{DAffine3, DVec3};
use meshmend::format::{Format, Limits, ReadErrorKind, read, sniff};
use meshmend::scene::{Note, ObjectKind, Shape, Unit};

use super::{MESH, assert_no, clean, file, file_with, mesh, model, relationships, scene_of, simple};

#[test]
fn a_mesh_has_its_numbers_and_its_unit() {
    let text = "<mesh><vertices><vertex x=\" 0.1\" y=\"-2.5e-3\" z=\"+3\"/><vertex z=\"0\" y=\".5\" x=\"1\"/><vertex x='0' y='1' z='0'/></vertices><triangles><triangle v3=\"0\" v2=\"1\" v1=\"2\"></triangle></triangles></mesh>";
    let file = clean(&simple("unit=\"inch\" xml:lang=\"en\"", "", "", text));
    assert_eq!(file.scene.unit, Some(Unit::Inch));
    let soup = &mesh(&file).soup;
    assert_eq!(soup.positions, [DVec3::new(0.1, -2.5e-3, 3.0), DVec3::new(1.0, 0.5, 0.0), DVec3::Y]);
    assert_eq!(soup.faces, [[2, 1, 0]]);
    assert!(mesh(&file).paint.is_empty());
}

#[test]
fn a_file_that_names_no_unit_is_in_millimetres() {
    assert_eq!(clean(&simple("", "", "", MESH)).scene.unit, Some(Unit::Millimetre));
}

#[test]
fn an_element_may_have_any_prefix_for_its_namespace() {
    let text = model("", &format!("<object id=\"1\">{MESH}</object>"), "<item objectid=\"1\"/>");
    let prefixed = text.replace("</", "</c:").replace('<', "<c:").replace("<c:/c:", "</c:").replace("<c:?", "<?");
    let prefixed = prefixed.replace("xmlns=", "xmlns:c=");
    assert_eq!(clean(&file(&prefixed)).scene, clean(&file(&text)).scene);
}

#[test]
fn objects_have_names_kinds_numbers_and_notes() {
    let group = "<metadatagroup><metadata name=\"v:key\" type=\"xs:string\" preserve=\"1\">a &lt; b<![CDATA[ & c]]></metadata></metadatagroup>";
    let file = clean(&simple(
        "xmlns:v=\"urn:v\"",
        "",
        "name=\"A &amp; B\" partnumber=\"7\" type=\"support\"",
        &format!("{group}{MESH}"),
    ));
    let object = &file.scene.objects[0];
    assert_eq!(
        (object.name.as_deref(), object.part_number.as_deref(), object.kind),
        (Some("A & B"), Some("7"), ObjectKind::Support)
    );
    let note = Note {
        name: "v:key".to_owned(),
        namespace: Some("urn:v".to_owned()),
        value: "a < b & c".to_owned(),
        kind: Some("xs:string".to_owned()),
        preserve: true,
    };
    assert_eq!(object.notes, [note]);
}

#[test]
fn components_follow_their_parts_and_items_have_their_transforms() {
    let resources = format!(
        "<object id=\"9\" name=\"pair\"><components><component objectid=\"4\"/><component objectid=\"4\" transform=\"1 0 0 0 1 0 0 0 1 0 0 5\"/></components></object><object id=\"4\" name=\"one\">{MESH}</object>"
    );
    let item = "<item objectid=\"9\" partnumber=\"x\" transform=\"0 1 0 -1 0 0 0 0 2 10 0 0\"><metadatagroup><metadata name=\"Title\">left</metadata></metadatagroup></item>";
    let bytes = file(&model("", &resources, item));
    let found = clean(&bytes);
    let names: Vec<_> = found.scene.objects.iter().map(|object| object.name.as_deref().unwrap()).collect();
    assert_eq!(names, ["one", "pair"]);
    let Shape::Components(parts) = &found.scene.objects[1].shape else { panic!("not components") };
    assert_eq!(parts.iter().map(|part| part.object).collect::<Vec<_>>(), [0, 0]);
    assert_eq!(parts[1].transform, DAffine3::from_translation(DVec3::new(0.0, 0.0, 5.0)));
    let item = &found.scene.items[0];
    assert_eq!((item.name.as_deref(), item.part_number.as_deref(), item.notes.len()), (Some("left"), Some("x"), 0));
    let placed = read(&bytes, &Limits::default()).unwrap().soup;
    assert_eq!(placed.faces.len(), 2);
    assert_eq!(placed.positions[4], DVec3::new(10.0, 1.0, 10.0));
}

#[test]
fn objects_are_taken_from_other_parts() {
    let root = model(
        "requiredextensions=\"p\"",
        "<object id=\"1\" p:UUID=\"u\"><components><component objectid=\"5\" p:path=\"/3D/Objects/a.model\"/></components></object>",
        "<item objectid=\"1\"/><item objectid=\"5\" p:path=\"/3d/objects/A.MODEL\"/>",
    );
    let other =
        model("", &format!("<object id=\"1\">{MESH}</object><object id=\"5\" name=\"far\">{MESH}</object>"), "");
    let read = clean(&file_with(&root, &[("3D/Objects/a.model", other.as_bytes())]));
    assert_eq!(read.scene.objects.len(), 3);
    assert_eq!(read.scene.objects[read.scene.items[1].object as usize].name.as_deref(), Some("far"));
    assert_eq!(read.scene.placed_faces(), 2);
    assert_no(&file(&root), ReadErrorKind::Malformed, "3D/Objects/a.model, which is not in the file");
}

#[test]
fn a_root_part_may_have_any_name() {
    let text = model("", &format!("<object id=\"1\">{MESH}</object>"), "<item objectid=\"1\"/>");
    let rels = relationships(&[(super::MODEL, "a%20b/../c.custom")]);
    let bytes = super::package(&[("_rels/.rels", rels.as_bytes()), ("C.custom", text.as_bytes())]);
    assert_eq!(clean(&bytes).scene.placed_faces(), 1);
}

#[test]
fn extensions_that_are_not_required_are_read_past_with_a_warning() {
    let lattice = "xmlns:b=\"http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02\" xmlns:o=\"urn:own\"";
    let inside =
        MESH.replace("</mesh>", "<b:beamlattice><b:beams><b:beam v1=\"0\" v2=\"1\"/></b:beams></b:beamlattice></mesh>");
    let bytes = simple(lattice, "<o:thing><o:deep/>text</o:thing>", "o:mark=\"1\" printable=\"1\"", &inside);
    let file = scene_of(&bytes);
    assert_eq!(mesh(&file).soup.faces.len(), 1);
    let [extensions, names] = &file.warnings[..] else { panic!("{:?}", file.warnings) };
    assert!(extensions.contains("beam lattices") && extensions.contains("'urn:own'"), "{extensions}");
    assert!(names.contains("'printable'"), "{names}");
}

#[test]
fn a_draft_is_read_without_its_colours() {
    let draft = model(
        "",
        &format!("<color id=\"1\" value=\"#000000\"/><object id=\"0\" materialid=\"5\">{MESH}</object>"),
        "<item objectid=\"0\"/>",
    );
    let read = scene_of(&file(&draft.replace("core/2015/02", "2013/01")));
    assert_eq!(read.scene.placed_faces(), 1);
    assert!(read.warnings[0].contains("draft"), "{:?}", read.warnings);
}

#[test]
fn an_archive_is_3mf_unless_its_end_shows_otherwise() {
    let bytes = super::package(&[("3D/model.txt", b"words")]);
    assert_eq!(sniff(&bytes, None), Ok(Format::ThreeMf));
    assert_no(&bytes, ReadErrorKind::UnsupportedFormat, "no supported model (3D/model.txt)");
    assert_no(&super::package(&[]), ReadErrorKind::UnsupportedFormat, "empty ZIP");
}
