//! The rest pose: what morph targets and joints make of positions where nothing moves (glTF 2.0, 3.7.2.2 and 3.7.3).

use glam::{DAffine3, DMat3, DVec3};

use super::super::errors::ReadError;
use super::accessor::Accessor;
use super::document::Skin;
use super::file::{File, entry, malformed};
use super::nodes::affine;
use super::source::Source;

/// The rest pose of a mesh at a node.
#[derive(Default)]
pub(super) struct Pose {
    /// How far it morphs to each of its targets.
    pub weights: Vec<f64>,
    /// From the coordinates of the mesh to those of the scene, by each joint.
    pub joints: Vec<DAffine3>,
}

/// What joints make of a mesh, one after the other.
pub(super) fn joints(file: &File<'_>, skin: &Skin, worlds: &[DAffine3]) -> Result<Vec<DAffine3>, ReadError> {
    file.spend(skin.joints.len())?;
    let bind = skin.inverse_bind_matrices.map(|number| Accessor::new(file, number)).transpose()?;
    if let Some(bind) = &bind
        && (bind.width != 16 || bind.count < skin.joints.len())
    {
        return Err(malformed("a skin does not have a matrix for each of its joints"));
    }
    let joint = |(number, joint): (usize, &super::json::Whole)| {
        let world = *entry(worlds, *joint, "node")?;
        Ok(bind.as_ref().map_or(world, |bind| world * affine(&bind.floats::<16>(number).map(f64::from))))
    };
    skin.joints.iter().enumerate().map(joint).collect()
}

/// The positions of a primitive in its rest pose.
pub(super) struct Posed<'p, 'f> {
    positions: &'p Accessor<'f>,
    morphs: Vec<(f64, Accessor<'f>)>,
    /// Up to two sets of four joints and their weights.
    bones: Vec<(Accessor<'f>, Accessor<'f>)>,
    joints: &'p [DAffine3],
}

impl<'p, 'f> Posed<'p, 'f> {
    pub fn new(source: &Source<'f, '_>, positions: &'p Accessor<'f>, pose: &'p Pose) -> Result<Self, ReadError> {
        let (file, primitive, count) = (source.file, source.primitive, positions.count);
        let mut morphs = Vec::new();
        for (target, &weight) in primitive.targets.iter().zip(&pose.weights) {
            if let Some(number) = target.position.filter(|_| weight != 0.0) {
                let shifts = Accessor::new(file, number)?;
                if shifts.width != 3 || shifts.count < count {
                    return Err(malformed("a morph target does not have a place for each vertex"));
                }
                morphs.push((weight, shifts));
            }
        }
        let mut bones = Vec::new();
        if !pose.joints.is_empty() {
            let sets = [
                (
                    source.of_vertices("JOINTS_0", |it| it.joints_0, count)?,
                    source.of_vertices("WEIGHTS_0", |it| it.weights_0, count)?,
                ),
                (
                    source.of_vertices("JOINTS_1", |it| it.joints_1, count)?,
                    source.of_vertices("WEIGHTS_1", |it| it.weights_1, count)?,
                ),
            ];
            bones.extend(sets.into_iter().filter_map(|(joints, weights)| joints.zip(weights)));
        }
        Ok(Self { positions, morphs, bones, joints: &pose.joints })
    }

    pub fn at(&self, vertex: usize) -> Result<DVec3, ReadError> {
        let read = |accessor: &Accessor<'_>| DVec3::from_array(accessor.floats::<3>(vertex).map(f64::from));
        let mut position = read(self.positions);
        for (weight, shifts) in &self.morphs {
            position += *weight * read(shifts);
        }
        if self.bones.is_empty() {
            return Ok(position);
        }
        let mut blended = DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO };
        let mut whole = 0.0;
        for (joints, weights) in &self.bones {
            let weights = weights.fractions::<4>(vertex).map(f64::from);
            for (joint, weight) in joints.wholes::<4>(vertex).into_iter().zip(weights) {
                if weight == 0.0 {
                    continue;
                }
                let Some(joint) = self.joints.get(joint as usize) else {
                    return Err(malformed(format!(
                        "a vertex hangs on joint {joint}, and its skin has {}",
                        self.joints.len()
                    )));
                };
                blended.matrix3 += joint.matrix3 * weight;
                blended.translation += joint.translation * weight;
                whole += weight;
            }
        }
        // Weights add up to one by a hair's breadth only; where there are none, the first joint holds the vertex.
        if whole == 0.0 {
            return Ok(self.joints[0].transform_point3(position));
        }
        Ok(blended.transform_point3(position) / whole)
    }
}
