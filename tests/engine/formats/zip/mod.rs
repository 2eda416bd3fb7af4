//! ZIP archives: choice of the model file, its sidecar files, and round trips.

mod hostile;
mod model;
mod round_trip;
mod side_files;

use meshmend::format::{ReadError, ReadErrorKind, ReadOptions, ReadScene, read_scene};
use meshmend::scene::{PaintedMesh, Palette};

use crate::support::archives::package;

/// A model of one triangle.
const TRIANGLE: &[u8] = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
const PNG: &[u8] = b"\x89PNG\r\n\x1A\nrest";

fn read_files(files: &[(&str, &[u8])]) -> Result<ReadScene, ReadError> {
    read_scene(&package(files), &ReadOptions::default())
}

#[track_caller]
fn scene_of(files: &[(&str, &[u8])]) -> ReadScene {
    read_files(files).unwrap_or_else(|error| panic!("{error}"))
}

/// Reads an archive and asserts that there are no warnings.
#[track_caller]
fn clean(files: &[(&str, &[u8])]) -> ReadScene {
    let file = scene_of(files);
    assert_eq!(file.warnings, Vec::<String>::new());
    file
}

/// Reads an archive and asserts that there is one warning, which contains these words.
#[track_caller]
fn warned(files: &[(&str, &[u8])], words: &str) -> ReadScene {
    let file = scene_of(files);
    assert_eq!(file.warnings.len(), 1, "{:?}", file.warnings);
    assert!(file.warnings[0].contains(words), "'{}' does not say '{words}'", file.warnings[0]);
    file
}

#[track_caller]
fn assert_no(bytes: &[u8], kind: ReadErrorKind, words: &[&str]) {
    match read_scene(bytes, &ReadOptions::default()) {
        Ok(file) => panic!("was read: {:?}", file.scene),
        Err(error) => {
            assert_eq!(error.kind, kind, "{error}");
            assert!(words.iter().all(|word| error.detail.contains(word)), "'{error}' does not say {words:?}");
            assert!(error.detail.len() < 600, "{error}");
        }
    }
}

fn mesh(file: &ReadScene) -> &PaintedMesh {
    file.scene.objects[0].mesh().unwrap()
}

/// The colours at the corners of each face; none if it has no colour or a texture.
fn colors(file: &ReadScene) -> Vec<Option<[[u8; 4]; 3]>> {
    let mesh = mesh(file);
    let color = |face: usize| {
        let paint = mesh.paint.get(face)?;
        file.scene.palettes.get(paint.palette as usize)?.colors(paint.at)
    };
    (0..mesh.soup.faces.len()).map(color).collect()
}

/// The texture coordinates at the corners of each face.
fn places(file: &ReadScene) -> Vec<Option<[[f64; 2]; 3]>> {
    let place = |paint: &meshmend::scene::Paint| match file.scene.palettes.get(paint.palette as usize)? {
        Palette::Textured { places, .. } => Some(paint.at.map(|at| places[at as usize])),
        _ => None,
    };
    mesh(file).paint.iter().map(place).collect()
}
