//! What is sent to be repaired.

use glam::DVec3;
use meshmend::format::{Format, write};
use meshmend::mesh::Soup;

use crate::meshes;

/// A broken model that a shop may get.
#[derive(Clone, Copy)]
pub enum Model {
    /// The smallest: a box without its top, with one face turned.
    Box,
    /// A ring of about so many faces, all of a good shape, with a hole in every 500.
    Ring(u32),
    /// A ball of about so many faces, which are slim near its poles, with a hole in every 500.
    Ball(u32),
}

impl Model {
    pub const ALL: [Self; 4] = [Self::Box, Self::Ring(1000), Self::Ring(4000), Self::Ball(4000)];

    pub fn name(self) -> String {
        match self {
            Self::Box => "box, 10 faces".to_owned(),
            Self::Ring(faces) => format!("ring, {faces} faces"),
            Self::Ball(faces) => format!("ball, {faces} faces"),
        }
    }

    /// The model as binary STL. Each job has it in a size of its own, so that no result can be used twice.
    pub fn bytes(self, job: usize) -> Vec<u8> {
        let across = |faces: u32| f64::from(faces / 4).sqrt().round() as u32;
        let mut soup = match self {
            Self::Box => {
                let mut soup = meshes::cube(DVec3::ZERO, 1.0, 1);
                soup.faces.truncate(10);
                soup.faces[3].swap(0, 1);
                soup
            }
            Self::Ring(faces) => with_holes(meshes::torus(30.0, 10.0, 2 * across(faces), across(faces))),
            Self::Ball(faces) => with_holes(meshes::sphere(DVec3::ZERO, 20.0, 2 * across(faces), across(faces))),
        };
        let size = 1.0 + job as f64 / 4096.0;
        soup.positions.iter_mut().for_each(|position| *position *= size);
        write(&soup, Format::Stl).expect("a mesh that STL can hold")
    }
}

/// Of each 500 faces, 6 go that lie side by side.
fn with_holes(mut soup: Soup) -> Soup {
    soup.faces = soup.faces.chunks(500).flat_map(|chunk| &chunk[chunk.len().min(6)..]).copied().collect();
    soup
}
