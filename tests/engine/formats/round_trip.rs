//! Meshes that are written and read again are the same in every format.

use glam::DVec3;
use meshmend::format::{Format, write};
use meshmend::mesh::Soup;
use proptest::prelude::*;

use super::{corners, read_all};

/// Meshes of any topology, good or bad; at least one face.
fn soups(coordinate: impl Strategy<Value = f64> + Clone) -> impl Strategy<Value = Soup> {
    let position = [coordinate.clone(), coordinate.clone(), coordinate].prop_map(DVec3::from_array);
    prop::collection::vec(position, 1..30).prop_flat_map(|positions| {
        let vertex = 0..positions.len() as u32;
        prop::collection::vec([vertex.clone(), vertex.clone(), vertex], 1..40)
            .prop_map(move |faces| Soup { positions: positions.clone(), faces })
    })
}

fn any_finite() -> impl Strategy<Value = f64> + Clone {
    prop_oneof![
        prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO | prop::num::f64::NEGATIVE,
        -1000.0..1000.0,
    ]
}

fn any_f32() -> impl Strategy<Value = f64> + Clone {
    (prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO | prop::num::f32::NEGATIVE)
        .prop_map(f64::from)
}

/// The bits of the corner coordinates, which distinguish `-0.0` from `0.0`.
fn bits(soup: &Soup) -> Vec<[u64; 3]> {
    soup.positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn an_indexed_format_gives_back_the_same_mesh(soup in soups(any_finite())) {
        for format in [Format::Obj, Format::Ply, Format::Off, Format::Mesh, Format::Zip] {
            let bytes = write(&soup, format).unwrap();
            let mesh = read_all(&bytes);
            prop_assert_eq!(mesh.format, format);
            prop_assert_eq!(bits(&mesh.soup), bits(&soup));
            prop_assert_eq!(&mesh.soup.faces, &soup.faces);
            prop_assert_eq!(mesh.warnings, Vec::<String>::new());
            prop_assert_eq!(write(&soup, format).unwrap(), bytes);
        }
    }

    #[test]
    fn ply_of_floats_gives_back_the_same_mesh(soup in soups(any_f32())) {
        let bytes = write(&soup, Format::Ply).unwrap();
        prop_assert!(bytes.windows(16).any(|w| w == b"property float x"));
        prop_assert_eq!(bits(&read_all(&bytes).soup), bits(&soup));
    }

    #[test]
    fn stl_gives_back_the_same_corners(soup in soups(any_f32())) {
        let bytes = write(&soup, Format::Stl).unwrap();
        let mesh = read_all(&bytes);
        prop_assert_eq!((mesh.format, mesh.warnings.len()), (Format::Stl, 0));
        prop_assert_eq!(corners(&mesh.soup), corners(&soup));
        prop_assert_eq!(write(&mesh.soup, Format::Stl).unwrap(), bytes);
    }

    #[test]
    fn stl_rounds_to_f32(soup in soups(-1e30..1e30)) {
        let mesh = read_all(&write(&soup, Format::Stl).unwrap());
        let rounded: Vec<_> = corners(&soup).into_iter().map(|c| c.map(|p| p.as_vec3().as_dvec3())).collect();
        prop_assert_eq!(corners(&mesh.soup), rounded);
    }

    #[test]
    fn ascii_stl_gives_back_the_same_corners(soup in soups(any_f32()), name in "[a-z ]{0,12}", exponents in any::<bool>()) {
        let mut text = super::ascii_stl(&soup, &name);
        if exponents {
            text = text.lines().map(|line| match line.trim().strip_prefix("vertex ") {
                Some(numbers) => {
                    let spelled: Vec<String> =
                        numbers.split(' ').map(|n| format!("{:e}", n.parse::<f64>().unwrap())).collect();
                    format!("vertex {}\n", spelled.join("\t"))
                }
                None => format!("{line}\n"),
            }).collect();
        }
        let mesh = read_all(text.as_bytes());
        prop_assert_eq!(mesh.dialect.as_str(), "ASCII STL");
        prop_assert_eq!(corners(&mesh.soup), corners(&soup));
    }

    #[test]
    fn ascii_and_big_endian_ply_give_back_the_same_mesh(soup in soups(any_finite())) {
        let header = |format: &str| format!(
            "ply\nformat {format} 1.0\nelement face {}\nproperty list uint uint vertex_index\nelement vertex {}\nproperty double z\nproperty double y\nproperty double x\nend_header\n",
            soup.faces.len(), soup.positions.len()
        );
        let mut ascii = header("ascii");
        let mut binary = header("binary_big_endian").into_bytes();
        for face in &soup.faces {
            ascii += &format!("3 {} {} {}\n", face[0], face[1], face[2]);
            binary.extend(3_u32.to_be_bytes());
            face.iter().for_each(|v| binary.extend(v.to_be_bytes()));
        }
        for p in &soup.positions {
            ascii += &format!("{:e} {} {}\n", p.z, p.y, p.x);
            [p.z, p.y, p.x].iter().for_each(|x| binary.extend(x.to_be_bytes()));
        }
        for bytes in [ascii.as_bytes(), &binary] {
            let mesh = read_all(bytes);
            prop_assert_eq!(bits(&mesh.soup), bits(&soup));
            prop_assert_eq!(&mesh.soup.faces, &soup.faces);
        }
    }

    #[test]
    fn polygons_give_two_triangles_fewer_than_corners(
        outline in prop::collection::vec([-9.0..9.0, -9.0..9.0, -1.0..1.0], 3..40),
    ) {
        let mut text = String::new();
        for p in &outline {
            text += &format!("v {} {} {}\n", p[0], p[1], p[2]);
        }
        let corners: Vec<String> = (1..=outline.len()).map(|k| k.to_string()).collect();
        text += &format!("f {}\n", corners.join(" "));
        let soup = read_all(text.as_bytes()).soup;
        prop_assert_eq!(soup.faces.len(), outline.len() - 2);
        let mut used: Vec<u32> = soup.faces.concat();
        used.sort_unstable();
        used.dedup();
        prop_assert_eq!(used.len(), outline.len());
    }
}
