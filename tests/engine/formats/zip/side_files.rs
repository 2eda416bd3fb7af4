//! Sidecar files of a model in a ZIP archive: materials, textures and buffers.

use meshmend::format::{Format, ReadOptions, read_scene};
use meshmend::scene::{Material, PAINTLESS, Paint, Palette, Wrap};

use super::{PNG, clean, colors, mesh, places, read_files, warned};

const OBJ: &[u8] = b"mtllib colors.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl red\nf 1 2 3\nusemtl wood\nf 1/1 3/3 2/2\n";
const MTL: &[u8] = b"newmtl red\nKd 1 0 0\nd 0.5\nnewmtl wood\nKd 1 1 1\nmap_Kd -s 1 1 1 wood.png\n";

fn obj(library: &str) -> Vec<u8> {
    String::from_utf8(OBJ.to_vec()).unwrap().replace("colors.mtl", library).into_bytes()
}

#[test]
fn materials_and_pictures_are_taken_from_beside_the_model() {
    let file = clean(&[("a/model.obj", OBJ), ("a/colors.mtl", MTL), ("a/wood.png", PNG)]);
    assert_eq!(file.format, Format::Zip);
    let red = Palette::Materials(vec![Material { name: "red".to_owned(), color: [255, 0, 0, 128] }]);
    let wood = Palette::Textured {
        texture: 0,
        name: Some("wood".to_owned()),
        tint: [255; 4],
        places: vec![[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]],
    };
    assert_eq!(file.scene.palettes, [red, wood]);
    let texture = &file.scene.textures[0];
    assert_eq!((&texture.bytes[..], texture.media_type.as_str(), texture.wrap_u), (PNG, "image/png", Wrap::Repeat));
    assert_eq!(mesh(&file).paint, [Paint { palette: 0, at: [0; 3] }, Paint { palette: 1, at: [0, 1, 2] }]);
}

#[test]
fn side_files_are_found_by_path_then_by_bare_name_in_any_case() {
    for (library, picture) in [
        ("colors.mtl", "wood.png"),
        ("./COLORS.MTL", "Wood.PNG"),
        ("..\\lib\\colors.mtl", "../tex/wood.png"),
        ("C:\\Users\\me\\My Models\\colors.mtl", "/home/me/wood.png"),
        ("../../../colors.mtl", "D:wood.png/../wood.png"),
        ("\"colors.mtl\"", "\"wood.png\""),
    ] {
        let mtl = String::from_utf8(MTL.to_vec()).unwrap().replace("wood.png", picture);
        let file = clean(&[("a/model.obj", &obj(library)), ("lib/Colors.mtl", mtl.as_bytes()), ("tex/wood.png", PNG)]);
        assert_eq!(file.scene.textures.len(), 1, "{library}");
    }
    // The file in the model's folder is preferred to others of the same name.
    let green = b"newmtl red\nKd 0 1 0\nnewmtl wood\n";
    let read = clean(&[("b/colors.mtl", green), ("a/colors.mtl", MTL), ("a/model.obj", OBJ), ("wood.png", PNG)]);
    assert_eq!(colors(&read)[0], Some([[255, 0, 0, 128]; 3]));
}

#[test]
fn a_statement_may_name_several_libraries_or_one_with_blanks() {
    let halves: [(&str, &[u8]); 2] =
        [("1.mtl", b"newmtl red\nKd 1 0 0\n"), ("2.mtl", b"newmtl wood\nmap_Kd wood.png\nnewmtl red\nKd 0 0 1\n")];
    let file = clean(&[("m.obj", &obj("1.mtl 2.mtl")), halves[0], halves[1], ("wood.png", PNG)]);
    assert_eq!((colors(&file)[0], file.scene.textures.len()), (Some([[255, 0, 0, 255]; 3]), 1));
    clean(&[("m.obj", &obj("my colors 1.mtl")), ("my colors 1.mtl", MTL), ("wood.png", PNG)]);
    warned(&[("m.obj", &obj("1.mtl none.mtl")), ("1.mtl", MTL), ("wood.png", PNG)], "1, the first 'none.mtl'");
}

#[test]
fn a_missing_library_is_reported_and_the_model_is_read() {
    let result = read_files(&[("m.obj", OBJ), ("wood.png", PNG)]).unwrap();
    assert_eq!(mesh(&result).paint, []);
    let [undefined, missing] = &result.warnings[..] else { panic!("{:?}", result.warnings) };
    assert!(
        undefined.contains("an undefined material were left without colour: 2, the first has the material 'red'"),
        "{undefined}"
    );
    assert!(missing.contains("not in the archive") && missing.contains("'colors.mtl'"), "{missing}");
}

#[test]
fn a_model_without_its_library_says_how_to_send_both() {
    let file = read_scene(OBJ, &ReadOptions::default()).unwrap();
    assert_eq!((file.format, mesh(&file).paint.len(), file.warnings.len()), (Format::Obj, 0, 1));
    assert!(file.warnings[0].contains("'colors.mtl', which was not sent") && file.warnings[0].contains("ZIP"));
}

#[test]
fn a_picture_that_is_missing_or_of_another_kind_leaves_the_materials_colour() {
    let mtl = b"newmtl red\nnewmtl wood\nKd 0 0 1\nmap_Kd wood.png\n";
    let file = warned(&[("m.obj", OBJ), ("colors.mtl", mtl)], "the first 'wood.png'");
    assert_eq!(colors(&file), [Some([[204, 204, 204, 255]; 3]), Some([[0, 0, 255, 255]; 3])]);
    let read = warned(&[("m.obj", OBJ), ("colors.mtl", mtl), ("wood.png", b"GIF89a")], "neither PNG nor JPEG");
    assert_eq!(colors(&read)[1], Some([[0, 0, 255, 255]; 3]));
}

#[test]
fn corners_without_a_place_or_with_one_that_is_not_there_have_the_materials_colour() {
    let with = |corners: &str| {
        let text = format!("mtllib c.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl wood\nf {corners}\n");
        let mtl: &[u8] = b"newmtl wood\nKd 0 1 0\nmap_Kd wood.png\n";
        read_files(&[("m.obj", text.as_bytes()), ("c.mtl", mtl), ("wood.png", PNG)]).unwrap()
    };
    for (corners, warnings) in
        [("1 2 3", 0), ("1/1 2/1 3", 0), ("1/1 2/1 3/0", 0), ("1/1 2/1 3/2", 1), ("1/1 2/-1 3/-9", 0)]
    {
        let result = with(corners);
        assert_eq!(
            (colors(&result), result.warnings.len()),
            (vec![Some([[0, 255, 0, 255]; 3])], warnings),
            "{corners}"
        );
    }
    assert_eq!(places(&with("1/1 2/-1 3/1/7")), [Some([[0.0; 2]; 3])]);
}

#[test]
fn places_in_a_picture_follow_polygons_as_they_are_cut() {
    // Each vertex position equals its texture coordinates, so that the two can be compared.
    let outline = [[0, 0], [4, 2], [1, 2], [0, 4], [9, 9], [9, 8], [7, 7], [8, 9]];
    let vertices: String = outline.iter().map(|[x, y]| format!("v {x} {y} 0\n")).collect();
    let texture: String = outline.iter().rev().map(|[x, y]| format!("vt {x} {y}\n")).collect();
    let faces =
        "f 1/8 2/7 3/6 4/5\nf 1/8 2/7\nf 5/-5 6/-6 7/-7 8/-8 1/8\nusemtl red\nf 1 2 3 4\nusemtl wood\nf 1/8 2/7 5/4\n";
    let mtl: &[u8] = b"newmtl wood\nmap_Kd wood.png\nnewmtl red\nKd 1 0 0\n";
    let counted = faces.replace("-5", "4").replace("-6", "3").replace("-7", "2").replace("-8", "1");
    for text in [
        format!("mtllib c.mtl\n{vertices}{texture}usemtl wood\n{faces}"),
        format!("mtllib c.mtl\nusemtl wood\n{counted}{texture}{vertices}"),
        format!("{texture}usemtl wood\n{}{vertices}mtllib c.mtl\n", counted.replace("f 1 2 3 4", "f 1/1 2 3 4/9")),
    ] {
        let result = read_files(&[("m.obj", text.as_bytes()), ("c.mtl", mtl), ("wood.png", PNG)]).unwrap();
        let mesh = mesh(&result);
        assert_eq!(mesh.soup.faces.len(), 8);
        for (face, found) in places(&result).into_iter().enumerate() {
            let expected = mesh.soup.corners(face).map(|p| [p.x, p.y]);
            assert_eq!(found, (!(5..7).contains(&face)).then_some(expected), "{face} of {text}");
        }
        assert_eq!(colors(&result)[5..7], [Some([[255, 0, 0, 255]; 3]); 2]);
    }
}

#[test]
fn faces_before_any_material_and_of_none_are_not_painted() {
    let text = b"mtllib c.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nusemtl red\nf 1 2 3\nusemtl\nf 1 2 3\nusemtl (null)\nf 1 2 3\nusemtl red\n";
    let file = clean(&[("m.obj", text), ("c.mtl", b"newmtl red\nKd 1 0 0\n")]);
    assert_eq!(mesh(&file).paint, [PAINTLESS, Paint { palette: 0, at: [0; 3] }, PAINTLESS, PAINTLESS]);
}

#[test]
fn gltf_takes_its_buffers_and_pictures_from_beside_it() {
    let json = br#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1},"material":0}]}],
        "materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],"textures":[{"source":0}],"images":[{"uri":"tex/a%20b.png"}],
        "buffers":[{"uri":"data.bin","byteLength":60}],"bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":24}],
        "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3},{"bufferView":1,"componentType":5126,"type":"VEC2","count":3}]}"#;
    let numbers = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0];
    let data: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    let file = clean(&[("a/scene.gltf", json), ("a/data.bin", &data), ("a/tex/a b.png", PNG)]);
    assert_eq!((file.format, file.dialect.as_str()), (Format::Glb, "glTF in a ZIP archive"));
    assert_eq!(
        (&file.scene.textures[0].bytes[..], places(&file)[0]),
        (PNG, Some([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    );
    let error = read_files(&[("scene.gltf", json), ("a b.png", PNG)]).unwrap_err();
    assert!(error.detail.contains("'data.bin'") && error.detail.contains("ZIP archive"), "{error}");
    let error = read_files(&[("scene.gltf", json), ("data.bin", &data[..59])]).unwrap_err();
    assert!(error.detail.contains("declares 60 bytes but has 59"), "{error}");
    let result = read_files(&[("scene.gltf", json), ("data.bin", &data)]).unwrap();
    assert!(result.warnings.iter().any(|warning| warning.contains("'tex/a b.png'")), "{:?}", result.warnings);
}
