//! Normals in files: which are read, and that no bad normal makes a reader refuse a file.

use glam::DVec3;
use meshmend::format::{Format, write};
use meshmend::mesh::CornerNormals;

use super::{read_all, tetrahedron};

/// The binary STL of the tetrahedron with these normals.
fn binary(normals: [[f32; 3]; 4]) -> Vec<u8> {
    let mut bytes = write(&tetrahedron(), Format::Stl).unwrap();
    for (facet, normal) in bytes[84..].chunks_exact_mut(50).zip(normals) {
        for (slot, x) in facet.chunks_exact_mut(4).zip(normal) {
            slot.copy_from_slice(&x.to_le_bytes());
        }
    }
    bytes
}

fn ascii(normals: [&str; 4]) -> Vec<u8> {
    let mut text = "solid\n".to_owned();
    let soup = tetrahedron();
    for (f, normal) in normals.into_iter().enumerate() {
        text += &format!("facet {normal}\nouter loop\n");
        for p in soup.corners(f) {
            text += &format!("vertex {} {} {}\n", p.x, p.y, p.z);
        }
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid\n").into_bytes()
}

#[test]
fn facet_normals_are_kept_where_they_are_against_the_corners() {
    let down = [0.0, 0.0, -1.0];
    let against = [0.5, -0.25, 2.0];
    // The first facet faces down, the second along -y.
    let good = [down, [0.0, -1.0, 0.0], [1.0, 1.0, 1.0], [-1.0, 0.0, 0.0]];
    assert_eq!(read_all(&binary(good)).normals, Some(CornerNormals::OfFaces { opposed: vec![] }));
    let mut bad = good;
    bad[0] = against;
    bad[2] = [f32::NAN, -1.0, -1.0];
    let kept = Some(CornerNormals::OfFaces { opposed: vec![(0, against)] });
    assert_eq!(read_all(&binary(bad)).normals, kept);
    assert_eq!(read_all(&binary([[0.0; 3]; 4])).normals, None);

    let text = ["normal 0.5 -.25 2e0", "normal 0 -1 0", "normal nan what 1", "normal"];
    assert_eq!(read_all(&ascii(text)).normals, kept);
    assert_eq!(read_all(&ascii(["", "normal 0 0 0", "normal 1 1", "normal 1.#QNAN 1 1"])).normals, None);
}

#[test]
fn facets_after_one_that_is_left_out_keep_their_own_normals() {
    let mut bytes = binary([[0.0; 3]; 4]);
    bytes[84 + 150..84 + 154].copy_from_slice(&1f32.to_le_bytes());
    let kept = CornerNormals::OfFaces { opposed: vec![(3, [1.0, 0.0, 0.0])] };
    assert_eq!(read_all(&bytes).normals, Some(kept));
}

#[test]
fn ply_gives_a_normal_to_each_vertex_if_it_names_all_three_numbers() {
    let ply = |names: &str, rows: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{names}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}3 0 1 2\n"
        )
    };
    let all = "property float nz\nproperty float nx\nproperty uchar red\nproperty float ny\n";
    let read = read_all(ply(all, "0 0 0 1 2 9 3\n1 0 0 4 bad 9 6\n0 1 0 7 8 9 9\n").as_bytes());
    let Some(normals @ CornerNormals::OfVertices(rows)) = &read.normals else { panic!("{:?}", read.normals) };
    assert_eq!((rows[0], rows[2]), ([2.0, 3.0, 1.0], [8.0, 9.0, 7.0]));
    assert_eq!(normals.at(0, read.soup.faces[0], 2), Some([8.0, 9.0, 7.0]));
    assert_eq!(normals.at(0, read.soup.faces[0], 1), None);
    assert_eq!(read.soup.positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let two = "property float nx\nproperty float ny\n";
    assert_eq!(read_all(ply(two, "0 0 0 1 2\n1 0 0 4 5\n0 1 0 7 8\n").as_bytes()).normals, None);
}

/// The normals at the corners of each triangle.
fn of_obj(text: &str) -> Vec<[Option<[f32; 3]>; 3]> {
    let read = read_all(text.as_bytes());
    let normals = read.normals.unwrap();
    let of_face = |(f, &face): (usize, &[u32; 3])| [0, 1, 2].map(|k| normals.at(f, face, k));
    read.soup.faces.iter().enumerate().map(of_face).collect()
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn obj_normals_follow_the_corners_of_polygons_as_they_are_cut() {
    let normals = "vn 1 0 0\nvn 2 0 0\nvn 3 0 0\nvn 4 0 0\n";
    let square = "f 1//4 2/7/3 3//2 4//1\n";
    let expect = |all: Vec<[Option<[f32; 3]>; 3]>, text: &str| {
        let read = read_all(text.as_bytes());
        for (face, corners) in read.soup.faces.iter().zip(&all) {
            for (&v, normal) in face.iter().zip(corners) {
                assert_eq!(*normal, Some([4.0 - v as f32, 0.0, 0.0]), "{text}");
            }
        }
        assert_eq!(all.len(), 2);
    };
    // Normals may come before or after, and so may vertices.
    for text in [
        format!("{SQUARE}{normals}{square}"),
        format!("{SQUARE}{square}{normals}"),
        format!("{normals}{square}{SQUARE}"),
        format!("{SQUARE}{normals}f 1//-1 2//-2 3//-3 4//-4\n"),
    ] {
        expect(of_obj(&text), &text);
    }
}

#[test]
fn obj_corners_without_a_normal_have_none_and_nothing_is_refused() {
    let (n, none) = (Some([0.0, 0.0, 1.0]), None);
    let text = format!(
        "{SQUARE}vn 0 0 1\nvn not a number\nvn 0 0\nf 1 2 3\nf 1//1 2 3/1/1\nf 1//2 2//9 3//-9\nf 1//0 2// 3//x\nf 1 2 3 4\n"
    );
    let found = of_obj(&text);
    assert_eq!(found, [[none; 3], [n, none, n], [none; 3], [none; 3], [none; 3], [none; 3]]);
    assert_eq!(read_all(format!("{SQUARE}f 1//1 2//2 3//3\n").as_bytes()).normals, None);
    assert_eq!(read_all(format!("{SQUARE}vn 0 0 1\nf 1 2 3\n").as_bytes()).normals, None);
}
