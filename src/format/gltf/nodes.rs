//! The tree of nodes: which meshes stand where (glTF 2.0, 3.5).

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::super::errors::ReadError;
use super::document::{Document, Node};
use super::file::{entry, malformed};

/// Where all nodes stand, and the order in which those of the scene follow each other.
pub(super) struct Nodes {
    /// From the coordinates of each node to those of the scene.
    pub worlds: Vec<DAffine3>,
    /// The nodes of the scene, depth first, each before its children.
    pub order: Vec<usize>,
}

/// Walks the tree with lists of its own for a stack, so that no depth is too much.
///
/// # Errors
/// Where the nodes are no tree: one has two parents or is its own ancestor.
pub(super) fn walk(document: &Document<'_>) -> Result<Nodes, ReadError> {
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
    // Each has one parent at most, so this ends.
    let mut stack = roots.clone();
    let mut reached = 0;
    while let Some(node) = stack.pop() {
        reached += 1;
        if !worlds[node].is_finite() {
            return Err(malformed(format!(
                "the transforms of node {node} and its parents, taken together, are not finite"
            )));
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
            return Err(malformed(format!("node {node} stands twice in the scene")));
        }
        order.push(node);
        stack.extend(nodes[node].children.iter().rev().map(|child| child.index()));
    }
    Ok(order)
}

fn scene_nodes(document: &Document<'_>, scene: &super::document::SceneNodes) -> Result<Vec<usize>, ReadError> {
    scene.nodes.iter().map(|&node| entry(&document.nodes, node, "node").map(|_| node.index())).collect()
}

/// From the coordinates of a node to those of its parent.
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
                return Err(malformed(format!("the rotation of node {number} is none")));
            }
            // In f32, as files have them, they are of unit length by a hair's breadth only.
            rotation / length
        }
    };
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, shift))
}

/// The first three rows of a matrix that is given by its columns.
pub(super) fn affine(m: &[f64; 16]) -> DAffine3 {
    let column = |k: usize| DVec3::new(m[4 * k], m[4 * k + 1], m[4 * k + 2]);
    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
}
