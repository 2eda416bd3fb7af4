//! Placing meshes: the node hierarchy (glTF 2.0, 3.5), and the rest pose of meshes with morph targets (3.7.2.2) or joints (3.7.3).

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::super::errors::ReadError;
use super::accessor::Accessor;
use super::container::Integer;
use super::document::{Document, Node, SceneNodes, Skin};
use super::file::{File, entry, malformed};
use super::primitive::PrimitiveData;

/// The transforms of all nodes, and the order of the scene's nodes.
pub(super) struct Nodes {
    /// The transform of each node to scene coordinates.
    pub worlds: Vec<DAffine3>,
    /// The nodes of the scene, depth first, each before its children.
    pub order: Vec<usize>,
}

/// Computes the transforms and the order of all nodes. An explicit stack allows any depth.
///
/// # Errors
/// A [`ReadError`] if the nodes are no tree: a node has two parents or is its own ancestor.
pub(super) fn walk_nodes(document: &Document<'_>) -> Result<Nodes, ReadError> {
    let nodes = &document.nodes;
    let mut is_child = vec![false; nodes.len()];
    for child in nodes.iter().flat_map(|node| node.children.iter()) {
        entry(nodes, *child, "node")?;
        if std::mem::replace(&mut is_child[child.index()], true) {
            return Err(malformed(format!("node {} has two parents", child.0)));
        }
    }
    let roots: Vec<usize> = (0..nodes.len()).filter(|&node| !is_child[node]).collect();
    let mut worlds = vec![DAffine3::IDENTITY; nodes.len()];
    for &root in &roots {
        worlds[root] = local(nodes, root)?;
    }
    // Each node has at most one parent, so this loop ends.
    let mut stack = roots.clone();
    let mut reached = 0;
    while let Some(node) = stack.pop() {
        reached += 1;
        if !worlds[node].is_finite() {
            return Err(malformed(format!("the combined transform of node {node} and its ancestors is not finite")));
        }
        for child in nodes[node].children.iter() {
            worlds[child.index()] = worlds[node] * local(nodes, child.index())?;
            stack.push(child.index());
        }
    }
    if reached < nodes.len() {
        return Err(malformed("the document has nodes that are their own ancestors"));
    }
    Ok(Nodes { order: order(document, roots)?, worlds })
}

fn order(document: &Document<'_>, roots: Vec<usize>) -> Result<Vec<usize>, ReadError> {
    let nodes = &document.nodes;
    let mut stack = match (document.scene, document.scenes.first()) {
        (None, None) => roots,
        (Some(scene), _) => scene_nodes(document, entry(&document.scenes, scene, "scene")?)?,
        (None, Some(first)) => scene_nodes(document, first)?,
    };
    stack.reverse();
    let mut seen = vec![false; nodes.len()];
    let mut order = Vec::new();
    while let Some(node) = stack.pop() {
        if std::mem::replace(&mut seen[node], true) {
            return Err(malformed(format!("node {node} occurs twice in the scene")));
        }
        order.push(node);
        stack.extend(nodes[node].children.iter().rev().map(|child| child.index()));
    }
    Ok(order)
}

fn scene_nodes(document: &Document<'_>, scene: &SceneNodes) -> Result<Vec<usize>, ReadError> {
    scene.nodes.iter().map(|&node| entry(&document.nodes, node, "node").map(|_| node.index())).collect()
}

/// The transform of a node to its parent's coordinates.
fn local(nodes: &[Node<'_>], number: usize) -> Result<DAffine3, ReadError> {
    let node = &nodes[number];
    if let Some(m) = node.matrix.as_deref() {
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err(malformed(format!("the matrix of node {number} is not affine")));
        }
        return Ok(affine(m));
    }
    let scale = node.scale.as_deref().map_or(DVec3::ONE, |&scale| DVec3::from_array(scale));
    let shift = node.translation.as_deref().map_or(DVec3::ZERO, |&shift| DVec3::from_array(shift));
    let rotation = match node.rotation.as_deref() {
        None => DQuat::IDENTITY,
        Some(&rotation) => {
            let rotation = DQuat::from_array(rotation);
            let length = rotation.length();
            if !length.is_finite() || length == 0.0 {
                return Err(malformed(format!("the rotation of node {number} has length zero or is not finite")));
            }
            // Files store f32, so the length is only close to one.
            rotation / length
        }
    };
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, shift))
}

/// An affine transform from a column-major 4x4 matrix.
fn affine(m: &[f64; 16]) -> DAffine3 {
    let column = |k: usize| DVec3::new(m[4 * k], m[4 * k + 1], m[4 * k + 2]);
    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
}

/// The rest pose of a mesh.
#[derive(Default)]
pub(super) struct RestPose {
    /// The weight of each morph target.
    pub weights: Vec<f64>,
    /// The transform of each joint, from mesh to scene coordinates.
    pub joints: Vec<DAffine3>,
}

/// The transforms of a skin's joints, from mesh to scene coordinates.
pub(super) fn joint_transforms(file: &File<'_>, skin: &Skin, worlds: &[DAffine3]) -> Result<Vec<DAffine3>, ReadError> {
    file.count_work(skin.joints.len())?;
    let bind = skin.inverse_bind_matrices.map(|number| Accessor::new(file, number)).transpose()?;
    if let Some(bind) = &bind
        && (bind.width != 16 || bind.count < skin.joints.len())
    {
        return Err(malformed("a skin has fewer inverse bind matrices than joints, or they are not 4x4 matrices"));
    }
    let joint = |(number, joint): (usize, &Integer)| {
        let world = *entry(worlds, *joint, "node")?;
        Ok(bind.as_ref().map_or(world, |bind| world * affine(&bind.floats::<16>(number).map(f64::from))))
    };
    skin.joints.iter().enumerate().map(joint).collect()
}

/// Computes the positions of a primitive in its rest pose.
pub(super) struct PosedPositions<'p, 'f> {
    positions: &'p Accessor<'f>,
    morphs: Vec<(f64, Accessor<'f>)>,
    /// Up to two sets of four joint indices and weights.
    influences: Vec<(Accessor<'f>, Accessor<'f>)>,
    joints: &'p [DAffine3],
}

impl<'p, 'f> PosedPositions<'p, 'f> {
    /// Finds and checks the attributes that the pose needs.
    pub fn new(
        source: &PrimitiveData<'f, '_>,
        positions: &'p Accessor<'f>,
        pose: &'p RestPose,
    ) -> Result<Self, ReadError> {
        let (file, primitive, count) = (source.file, source.primitive, positions.count);
        let mut morphs = Vec::new();
        for (target, &weight) in primitive.targets.iter().zip(&pose.weights) {
            if let Some(number) = target.position.filter(|_| weight != 0.0) {
                let shifts = Accessor::new(file, number)?;
                if shifts.width != 3 || shifts.count < count {
                    return Err(malformed("a morph target does not have a displacement for each vertex"));
                }
                morphs.push((weight, shifts));
            }
        }
        let mut influences = Vec::new();
        if !pose.joints.is_empty() {
            let sets = [
                (
                    source.vertex_attribute("JOINTS_0", |attributes| attributes.joints_0, count)?,
                    source.vertex_attribute("WEIGHTS_0", |attributes| attributes.weights_0, count)?,
                ),
                (
                    source.vertex_attribute("JOINTS_1", |attributes| attributes.joints_1, count)?,
                    source.vertex_attribute("WEIGHTS_1", |attributes| attributes.weights_1, count)?,
                ),
            ];
            influences.extend(sets.into_iter().filter_map(|(joints, weights)| joints.zip(weights)));
        }
        Ok(Self { positions, morphs, influences, joints: &pose.joints })
    }

    /// The position of a vertex.
    pub fn at(&self, vertex: usize) -> Result<DVec3, ReadError> {
        let read = |accessor: &Accessor<'_>| DVec3::from_array(accessor.floats::<3>(vertex).map(f64::from));
        let mut position = read(self.positions);
        for (weight, shifts) in &self.morphs {
            position += *weight * read(shifts);
        }
        if self.influences.is_empty() {
            return Ok(position);
        }
        let mut blended = DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO };
        let mut whole = 0.0;
        for (joints, weights) in &self.influences {
            let weights = weights.fractions::<4>(vertex).map(f64::from);
            for (joint, weight) in joints.integers::<4>(vertex).into_iter().zip(weights) {
                if weight == 0.0 {
                    continue;
                }
                let Some(joint) = self.joints.get(joint as usize) else {
                    return Err(malformed(format!(
                        "a vertex refers to joint {joint}, but its skin has only {} joints",
                        self.joints.len()
                    )));
                };
                blended.matrix3 += joint.matrix3 * weight;
                blended.translation += joint.translation * weight;
                whole += weight;
            }
        }
        // Weights sum to one only approximately. If all are zero, the first joint moves the vertex.
        if whole == 0.0 {
            return Ok(self.joints[0].transform_point3(position));
        }
        Ok(blended.transform_point3(position) / whole)
    }
}
