//! Materials, colours and textures in 3MF.

use std::sync::Arc;

use meshmend::format::ReadErrorKind;
use meshmend::scene::{Material, PAINTLESS, Paint, Palette, Wrap};

use super::{assert_no, clean, file_with, mesh, model, scene_of, simple};

const MATERIALS: &str = "<basematerials id=\"1\"><base name=\"PLA &quot;red&quot;\" displaycolor=\"#FF0000\"/><base name=\"b\" displaycolor=\"#0000ff80\"/></basematerials>";
const COLORS: &str = "<m:colorgroup id=\"2\"><m:color color=\"#102030\"/><m:color color=\"#405060\"/><m:color color=\"#708090\"/></m:colorgroup>";
const TEXTURE: &str = "<m:texture2d id=\"3\" path=\"/3D/t.png\" contenttype=\"image/png\" tilestyleu=\"mirror\" tilestylev=\"none\" filter=\"nearest\"/><m:texture2dgroup id=\"4\" texid=\"3\"><m:tex2coord u=\"0\" v=\"0.25\"/><m:tex2coord u=\"1\" v=\"2\"/></m:texture2dgroup>";

/// A mesh of one triangle for each of these attributes.
fn triangles(attributes: &[&str]) -> String {
    let each: String =
        attributes.iter().map(|attributes| format!("<triangle v1=\"0\" v2=\"1\" v3=\"2\" {attributes}/>")).collect();
    format!(
        "<mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles>{each}</triangles></mesh>"
    )
}

fn painted(palette: u32, at: [u32; 3]) -> Paint {
    Paint { palette, at }
}

#[test]
fn a_triangle_has_its_own_property_or_that_of_its_object() {
    let resources = format!("{MATERIALS}{COLORS}");
    let triangles =
        triangles(&["", "p1=\"1\"", "pid=\"2\" p1=\"0\" p2=\"1\" p3=\"2\"", "pid=\"2\" p1=\"2\"", "pid=\"2\""]);
    let file = clean(&simple("", &resources, "pid=\"1\" pindex=\"0\"", &triangles));
    let expected = [[0; 3], [1; 3]].map(|at| painted(0, at)).into_iter();
    let expected: Vec<Paint> =
        expected.chain([painted(1, [0, 1, 2]), painted(1, [2; 3]), painted(0, [0; 3])]).collect();
    assert_eq!(mesh(&file).paint, expected);
    let materials = Palette::Materials(vec![
        Material { name: "PLA \"red\"".to_owned(), color: [255, 0, 0, 255] },
        Material { name: "b".to_owned(), color: [0, 0, 255, 128] },
    ]);
    let colors = Palette::Colors(vec![[0x10, 0x20, 0x30, 255], [0x40, 0x50, 0x60, 255], [0x70, 0x80, 0x90, 255]]);
    assert_eq!(file.scene.palettes, [materials, colors]);
}

#[test]
fn a_triangle_without_any_property_is_not_painted() {
    let file = clean(&simple("", COLORS, "", &triangles(&["", "pid=\"2\" p1=\"1\"", ""])));
    assert_eq!(mesh(&file).paint, [PAINTLESS, painted(0, [1; 3]), PAINTLESS]);
}

#[test]
fn a_texture_is_the_bytes_of_its_part() {
    let text = model(
        "",
        &format!(
            "{TEXTURE}<object id=\"9\" pid=\"4\" pindex=\"1\">{}</object>",
            triangles(&["pid=\"4\" p1=\"0\" p2=\"1\" p3=\"1\"", ""])
        ),
        "<item objectid=\"9\"/>",
    );
    let read = clean(&file_with(&text, &[("3D/T.PNG", b"a picture")]));
    let texture = &read.scene.textures[0];
    assert_eq!(texture.bytes, Arc::from(&b"a picture"[..]));
    assert_eq!((texture.wrap_u, texture.wrap_v, texture.nearest), (Wrap::Mirror, Wrap::None, true));
    let places = vec![[0.0, 0.25], [1.0, 2.0]];
    assert_eq!(read.scene.palettes, [Palette::Textured { texture: 0, name: None, tint: [255; 4], places }]);
    assert_eq!(mesh(&read).paint, [painted(0, [0, 1, 1]), painted(0, [1; 3])]);
    assert_no(&super::file(&text), ReadErrorKind::Malformed, "the texture 3D/t.png is not in the file");
}

#[test]
fn mixtures_of_materials_become_their_mean_colours() {
    let mixed = "<m:compositematerials id=\"5\" matid=\"1\" matindices=\"0 1\"><m:composite values=\"1 3\"/><m:composite values=\"0 0\"/><m:composite values=\"2\"/></m:compositematerials>";
    let file = scene_of(&simple("", &format!("{MATERIALS}{mixed}"), "pid=\"5\" pindex=\"0\"", &triangles(&[""])));
    // Proportions are divided by their sum, or equal if the sum is zero; missing ones are zero.
    assert_eq!(file.scene.palettes[1], Palette::Colors(vec![[64, 0, 191, 160], [128, 0, 128, 192], [255, 0, 0, 255]]));
    assert!(file.warnings[0].contains("mixtures"), "{:?}", file.warnings);
}

#[test]
fn the_uppermost_coloured_layer_is_kept() {
    let layers = "<m:multiproperties id=\"6\" pids=\"1 2\" blendmethods=\"multiply\"><m:multi pindices=\"1 2\"/><m:multi pindices=\"0\"/></m:multiproperties>";
    let resources = format!("{layers}{MATERIALS}{COLORS}");
    let file = scene_of(&simple("", &resources, "", &triangles(&["pid=\"6\" p1=\"0\" p2=\"1\" p3=\"0\""])));
    assert_eq!(mesh(&file).paint, [painted(1, [2, 0, 2])]);
    assert!(file.warnings[0].contains("multiproperties"), "{:?}", file.warnings);
}

#[test]
fn invalid_colour_properties_are_refused() {
    let malformed = ReadErrorKind::Malformed;
    let multi = |pids: &str| {
        format!(
            "{MATERIALS}{COLORS}<m:colorgroup id=\"7\"><m:color color=\"#000000\"/></m:colorgroup><m:multiproperties id=\"8\" pids=\"1 2\"><m:multi pindices=\"0 0\"/></m:multiproperties><m:multiproperties id=\"6\" pids=\"{pids}\"><m:multi pindices=\"0 0\"/></m:multiproperties>"
        )
    };
    for (resources, object, triangle, kind, words) in [
        (COLORS.to_owned(), "pindex=\"0\"", "", malformed, "pindex but no pid"),
        (COLORS.to_owned(), "", "p1=\"0\"", malformed, "neither the triangle nor its object has a pid"),
        (COLORS.to_owned(), "", "pid=\"77\" p1=\"0\"", malformed, "property group 77"),
        (COLORS.to_owned(), "", "pid=\"2\" p1=\"3\"", ReadErrorKind::IndexOutOfRange, "refers to entry 3"),
        (COLORS.to_owned(), "pid=\"2\" pindex=\"9\"", "", ReadErrorKind::IndexOutOfRange, "refers to entry 9"),
        (COLORS.replace("#102030", "red"), "", "", malformed, "found 'red'"),
        (MATERIALS.replace("name=\"b\" ", ""), "", "", malformed, "has no name"),
        (TEXTURE.replace("path=\"/3D/t.png\"", ""), "", "", malformed, "has no path"),
        (TEXTURE.replace("image/png", "image/webp"), "", "", malformed, "found 'image/webp'"),
        (TEXTURE.replace("/3D/t.png", "/../t.png"), "", "", malformed, "the absolute path of a part"),
        ("<m:texture2dgroup id=\"4\" texid=\"3\"/>".to_owned(), "", "", malformed, "texture 3, which does not exist"),
        ("<m:compositematerials id=\"5\" matid=\"1\"/>".to_owned(), "", "", malformed, "no matindices"),
        (
            format!("{COLORS}<m:compositematerials id=\"5\" matid=\"2\" matindices=\"0\"/>"),
            "",
            "",
            malformed,
            "not a base materials group",
        ),
        (
            format!("{MATERIALS}<m:compositematerials id=\"5\" matid=\"1\" matindices=\"2\"/>"),
            "",
            "",
            malformed,
            "does not have",
        ),
        ("<m:multiproperties id=\"6\"/>".to_owned(), "", "", malformed, "has no pids"),
        (multi("2 1"), "", "", malformed, "only be the first layer"),
        (multi("2 7"), "", "", malformed, "only one layer"),
        (multi("1 8"), "", "", malformed, "8 is not a group"),
        (multi("1 6"), "", "", malformed, "6 is not a group"),
        (multi("1 2\" blendmethods=\"mix mix"), "", "", malformed, "2 blend methods"),
        (multi("1 2\" blendmethods=\"add"), "", "", malformed, "mix or multiply"),
        (format!("{COLORS}{COLORS}"), "", "", malformed, "two resources have the id 2"),
    ] {
        assert_no(&simple("", &resources, object, &triangles(&[triangle])), kind, words);
    }
}
