use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder, PointAttribute,
    PointIndex,
};
use glam::DVec3;
use serde_json::json;

use super::super::super::{Limits, ReadErrorKind};
use super::{Model, floats, read, read_within};
use crate::scene::Palette;

/// Rows of vertices on a bent sheet, and the faces between them.
fn sheet(n: u32) -> (Vec<f32>, Vec<[u32; 3]>) {
    let at = |k: u32| f64::from(k) / f64::from(n);
    let positions = (0..=n)
        .flat_map(|y| (0..=n).flat_map(move |x| [at(x) as f32, at(y) as f32, (at(x) * at(y) * 3.0).sin() as f32]));
    let faces = (0..n).flat_map(|y| {
        (0..n).flat_map(move |x| {
            let a = y * (n + 1) + x;
            [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
        })
    });
    (positions.collect(), faces.collect())
}

fn attribute(of: GeometryAttributeType, width: u8, kind: DataType, bytes: &[u8], count: usize) -> PointAttribute {
    let mut attribute = PointAttribute::new();
    attribute.init(of, width, kind, kind != DataType::Float32, count);
    attribute.buffer_mut().write(0, bytes);
    attribute
}

/// A sheet, packed. Attribute 0 has positions, attribute 1 a colour for each vertex.
fn packed(n: u32, options: &EncoderOptions) -> Vec<u8> {
    let (positions, faces) = sheet(n);
    let count = positions.len() / 3;
    let colors: Vec<u8> = (0..count).flat_map(|k| [255, if k % 2 == 0 { 255 } else { 0 }, 0]).collect();
    let mut mesh = Mesh::new();
    mesh.add_attribute(attribute(GeometryAttributeType::Position, 3, DataType::Float32, &floats(&positions), count));
    mesh.add_attribute(attribute(GeometryAttributeType::Color, 3, DataType::Uint8, &colors, count));
    mesh.set_num_points(count);
    mesh.set_num_faces(faces.len());
    for (face, corners) in faces.iter().enumerate() {
        mesh.set_face(FaceIndex(face as u32), corners.map(PointIndex));
    }
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut out = EncoderBuffer::new();
    encoder.encode(options, &mut out).expect("a sound mesh");
    out.data().to_vec()
}

/// By rows of faces as they come, by the usual way around, and by the closest one.
fn all_ways(n: u32) -> Vec<Vec<u8>> {
    let mut in_order = EncoderOptions::new();
    in_order.set_encoding_method(0);
    let mut close = EncoderOptions::new();
    close.set_compression_level(10);
    [in_order, EncoderOptions::new(), close].iter().map(|options| packed(n, options)).collect()
}

/// A file with a sheet that is packed so.
fn model(data: &[u8]) -> Model {
    let mut model = Model::empty();
    let view = model.view(data);
    let told = |shape: &str, component: u32| json!({ "componentType": component, "type": shape, "count": 9, "normalized": component == 5121 });
    model.json["accessors"] = json!([told("VEC3", 5126), told("VEC3", 5121), told("SCALAR", 5123)]);
    model.json["meshes"] = json!([{ "primitives": [{
        "attributes": { "POSITION": 0, "COLOR_0": 1 }, "indices": 2, "mode": 5,
        "extensions": { "KHR_draco_mesh_compression": { "bufferView": view, "attributes": { "POSITION": 0, "COLOR_0": 1 } } },
    }] }]);
    model.json["nodes"] = json!([{ "mesh": 0 }]);
    model.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    model
}

#[test]
fn packed_primitives_are_unpacked() {
    let (positions, faces) = sheet(8);
    let middle = |corners: [DVec3; 3]| corners.iter().sum::<DVec3>() / 3.0;
    let at = |v: u32| DVec3::from_array([0, 1, 2].map(|k| f64::from(positions[3 * v as usize + k])));
    let expected: Vec<DVec3> = faces.iter().map(|face| middle(face.map(at))).collect();
    for data in all_ways(8) {
        let read = model(&data).read();
        let mesh = read.scene.objects[0].mesh().expect("a mesh");
        assert_eq!((mesh.soup.faces.len(), mesh.soup.positions.len()), (128, 81));
        for face in 0..128 {
            let found = middle(mesh.soup.corners(face));
            assert!(expected.iter().any(|it| it.abs_diff_eq(found, 2e-3)), "{found} is the middle of no face");
        }
        let Palette::Colors(colors) = &read.scene.palettes[0] else { panic!("{:?}", read.scene.palettes) };
        let mut colors = colors.clone();
        colors.sort_unstable();
        assert_eq!(colors, [[255, 0, 0, 255], [255, 255, 0, 255]]);
    }
}

#[test]
fn packed_data_that_lacks_an_attribute_is_refused() {
    let data = all_ways(2).remove(1);
    let model =
        model(&data).with("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression/attributes/COLOR_0", json!(7));
    model.assert_refused(ReadErrorKind::Malformed, "lacks COLOR_0");
}

#[test]
fn packed_data_that_is_damaged_anywhere_is_answered() {
    for data in all_ways(4) {
        for end in 0..data.len() {
            let answer = read(&model(&data[..end]).glb());
            // The last bytes may be of no use.
            assert!(answer.is_err() || end > data.len() / 2, "{end} of {} bytes were enough", data.len());
        }
        for at in 0..data.len() {
            for value in [0, 1, 0x7F, 0x80, 0xFF, data[at] ^ 0x10] {
                let mut bytes = data.clone();
                bytes[at] = value;
                if let Ok(read) = read(&model(&bytes).glb()) {
                    let mesh = read.scene.objects[0].mesh().expect("a mesh");
                    let count = mesh.soup.positions.len() as u32;
                    assert!(mesh.soup.faces.iter().flatten().all(|&v| v < count));
                }
            }
        }
    }
}

#[test]
fn packed_data_is_unpacked_within_the_limits() {
    for data in all_ways(8) {
        let bytes = model(&data).glb();
        assert!(read_within(&bytes, Limits { max_faces: 128, max_vertices: 81, ..Limits::default() }).is_ok());
        for limits in [Limits { max_faces: 127, ..Limits::default() }, Limits { max_vertices: 80, ..Limits::default() }]
        {
            assert_eq!(read_within(&bytes, limits).expect_err("over").kind, ReadErrorKind::TooLarge);
        }
    }
}
