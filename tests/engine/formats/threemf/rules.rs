//! 3MF files that break the rules of the specification are refused.

use meshmend::format::ReadErrorKind;

use super::{
    MESH, MODEL, ROOT, ROOT_RELATIONSHIPS, assert_no, clean, file, file_with, model, package, relationships, simple,
};

const MALFORMED: ReadErrorKind = ReadErrorKind::Malformed;

fn one_object() -> String {
    model("", &format!("<object id=\"1\">{MESH}</object>"), "<item objectid=\"1\"/>")
}

#[test]
fn relationships_must_follow_the_3mf_specification() {
    let text = one_object();
    let with = |root: &[(&str, &str)]| {
        let rels = relationships(root);
        package(&[(ROOT_RELATIONSHIPS, rels.as_bytes()), (ROOT, text.as_bytes()), ("3D/b.model", text.as_bytes())])
    };
    let thumbnail = "http://schemas.openxmlformats.org/package/2006/relationships/metadata/thumbnail";
    let good = (MODEL, "/3D/3dmodel.model");
    assert_no(&with(&[]), MALFORMED, "relationships (_rels/.rels) name no 3MF model");
    assert_no(&with(&[good, (MODEL, "/3D/b.model")]), MALFORMED, "more than one root model");
    assert_no(&with(&[(MODEL, "/3D/c.model")]), MALFORMED, "3D/c.model, which is not in the file");
    assert_no(&with(&[good, (thumbnail, "/Metadata/t.png")]), MALFORMED, "Metadata/t.png, which is not in the file");
    assert_no(&with(&[good, ("urn:any", "C:/x.png")]), MALFORMED, "outside the file");
    assert_no(&with(&[good, ("urn:any", "x\" TargetMode=\"External")]), MALFORMED, "outside the file");
    assert_eq!(clean(&with(&[good, ("urn:any", "/not/there")])).scene.placed_faces(), 1);
}

#[test]
fn a_model_has_one_print_ticket_at_most() {
    let ticket = "http://schemas.microsoft.com/3dmanufacturing/2013/01/printticket";
    let rels = |count| relationships(&vec![(ticket, "t.xml"); count]);
    let with = |count| {
        let rels = rels(count);
        file_with(&one_object(), &[("3D/_rels/3dmodel.model.rels", rels.as_bytes()), ("3D/t.xml", b"<t/>")])
    };
    clean(&with(1));
    assert_no(&with(2), MALFORMED, "more than one print ticket");
}

#[test]
fn an_encrypted_part_is_refused() {
    let encrypted = "http://schemas.openxmlformats.org/package/2006/relationships/encryptedfile";
    let rels = relationships(&[(encrypted, "b.model")]);
    let bytes = file_with(&one_object(), &[("3D/_rels/3dmodel.model.rels", rels.as_bytes()), ("3D/b.model", b"%3McF")]);
    assert_no(&bytes, ReadErrorKind::UnsupportedFormat, "3D/b.model is encrypted");
}

#[test]
fn an_extension_that_is_required_and_not_read_is_named() {
    for (address, words) in [
        ("http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02", "beam lattices"),
        ("http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04", "encrypted content"),
        ("http://schemas.3mf.io/3dmanufacturing/implicit/2023/12", "implicit functions"),
        ("urn:nobody", "'urn:nobody'"),
    ] {
        let bytes = simple(&format!("xmlns:x=\"{address}\" requiredextensions=\"m x\""), "", "", MESH);
        assert_no(&bytes, ReadErrorKind::UnsupportedFormat, words);
    }
    let slices = "xmlns:s=\"http://schemas.microsoft.com/3dmanufacturing/slice/2015/07\" requiredextensions=\"s m p\"";
    clean(&simple(slices, "", "", MESH));
    assert_no(&simple("requiredextensions=\"q\"", "", "", MESH), MALFORMED, "prefix 'q' is not declared");
}

#[test]
fn xml_must_follow_the_3mf_specification() {
    let text = one_object();
    let body = text.split_once("?>").unwrap().1;
    for (text, words) in [
        (text.replace("UTF-8", "UTF-32"), "declares the encoding UTF-32"),
        (format!("<!DOCTYPE model [<!ENTITY a \"b\">]>{body}"), "document type"),
        (format!("{body}{body}"), "second root element"),
        (format!("text{body}"), "text outside its root"),
        (body.replace("</vertices>", "</vertexes>"), "expected"),
        (body.replace("<mesh>", "<mesh xml:space=\"default\">"), "'space' has a namespace that 3MF forbids"),
        (body.replace("<mesh>", "<mesh p:x=\"1\">"), "'x' has a namespace that 3MF forbids"),
        (body.replace("<vertices>", "<vertices xmlns:v=\"urn:v\" v:x=\"1\">"), "'x' has a namespace that 3MF forbids"),
        (body.replace("id=\"1\">", "id=\"1\" v:x=\"1\">"), "prefix 'v' is not declared"),
        (
            body.replace("<vertices>", "<v:vertices>").replace("</vertices>", "</v:vertices>"),
            "prefix 'v' is not declared",
        ),
        (
            body.replace("<object", "<object xmlns:i=\"http://www.w3.org/2001/XMLSchema-instance\" i:nil=\"1\""),
            "'nil' has a namespace that 3MF forbids",
        ),
        (body.replace("id=\"1\">", "id=\"1\" name=\"&a;\">"), "entity"),
        (body.replace("id=\"1\">", "id=\"1\" name=\"&#1;\">"), "0x1 is forbidden"),
        (body.replace("id=\"1\">", "id=\"1\" id=\"2\">"), "duplicated"),
        (body.replace("x=\"0\"", "x=\"0\" x=\"1\""), "'x' twice"),
        (body.replace("<model", "<modell").replace("</model", "</modell"), "must be the <model> of 3MF"),
        (String::new(), "has no element"),
    ] {
        assert_no(&file(&text), MALFORMED, words);
    }
    let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let rels = relationships(&[(MODEL, "/3D/3dmodel.model")]);
    assert_no(&package(&[(ROOT_RELATIONSHIPS, rels.as_bytes()), (ROOT, &wide)]), MALFORMED, "UTF-16");
    assert_no(&file(&text[..text.len() - 20]), ReadErrorKind::Truncated, "cut off");
    assert_no(&file(body.strip_suffix("</model>").unwrap()), ReadErrorKind::Truncated, "ends within an element");
    clean(&file(&format!("\u{FEFF}{text}<!-- end -->\n")));
}

#[test]
fn a_model_must_follow_the_core_specification() {
    let text = one_object();
    for (text, words) in [
        (text.replace("<object ", "<object pid=\"x\" "), "found 'x' where a whole number"),
        (text.replace("<model ", "<model unit=\"yard\" "), "found 'yard' where a unit"),
        (text.replace("<object ", "<object type=\"thing\" "), "found 'thing'"),
        (text.replace("<object id=\"1\"", "<object"), "has no id"),
        (
            text.replace("<resources>", "<ressources>").replace("</resources>", "</ressources>"),
            "0 elements <resources>",
        ),
        (text.replace("<build>", "<build></build><build>"), "2 elements <build>"),
        (text.replace("<build>", "<build><item/>"), "<item> has no objectid"),
        (text.replace("objectid=\"1\"", "objectid=\"2\""), "object 2, which does not exist"),
        (text.replace("id=\"1\">", "id=\"1\" type=\"other\">"), "the type 'other'"),
        (text.replace("x=\"1\"", "x=\"NaN\""), "found 'NaN' where a coordinate"),
        (text.replace("x=\"1\"", "x=\"inf\""), "found 'inf' where a coordinate"),
        (text.replace("x=\"1\"", "x=\"1,5\""), "decimal comma"),
        (text.replace("x=\"1\"", ""), "fewer than three coordinates"),
        (text.replace("v2=\"1\"", ""), "fewer than three corners"),
        (text.replace("v2=\"1\"", "v2=\"-1\""), "found '-1'"),
        (text.replace(MESH, &format!("{MESH}{MESH}")), "more than one mesh or list of components"),
        (text.replace("objectid=\"1\"", "objectid=\"1\" transform=\"1 0 0 0 1 0 0 0 1 0 0\""), "12 numbers"),
        (text.replace("objectid=\"1\"", "objectid=\"1\" transform=\"1,0 0 0 0 1 0 0 0 1 0 0 0\""), "decimal commas"),
        (text.replace("objectid=\"1\"", "objectid=\"1\" transform=\"1 0 0 0 1 0 0 0 0 0 0 0\""), "flattens its object"),
        (text.replace("objectid=\"1\"", "objectid=\"1\" p:path=\"a.model\""), "is not the absolute path of a part"),
        (
            text.replace("<resources>", "<metadata name=\"Title\"/><metadata name=\"Title\"/><resources>"),
            "two <metadata> elements",
        ),
        (text.replace("<resources>", "<metadata/><resources>"), "has no name"),
        (text.replace("<resources>", "<metadata name=\"v:x\"/><resources>"), "prefix 'v' is not declared"),
        (text.replace("<resources>", "<metadata name=\"Title\" preserve=\"yes\"/><resources>"), "0 or 1"),
    ] {
        assert_no(&file(&text), MALFORMED, words);
    }
    assert_no(&file(&text.replace("v2=\"1\"", "v2=\"3\"")), ReadErrorKind::IndexOutOfRange, "refers to vertex 3");
    assert_no(&file(&text.replace("<item objectid=\"1\"/>", "")), ReadErrorKind::NoFaces, "build plate");
    assert_no(
        &file(&text.replace(MESH, "<mesh><vertices/><triangles/></mesh>")),
        ReadErrorKind::NoFaces,
        "no triangles",
    );
}

#[test]
fn a_note_with_a_name_of_its_own_is_kept_with_a_warning() {
    let text = one_object().replace("<resources>", "<metadata name=\"Region\">US</metadata><resources>");
    let read = super::scene_of(&file(&text));
    assert_eq!((read.scene.notes[0].name.as_str(), read.scene.notes[0].value.as_str()), ("Region", "US"));
    assert!(read.warnings[0].contains("'Region'"), "{:?}", read.warnings);
}
