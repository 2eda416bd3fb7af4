#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod oracle;

use glam::DVec3;
use proptest::prelude::*;

use super::{HalfEdgeMesh, Manifold, NotManifold, Refused};
use crate::mesh::{
    Edges, FaceId, Fans, HalfEdgeId, NO_SOURCE, Parts, Surface, VertexId, boundary_loops, count_boundary_chains,
};

fn surface(faces: Vec<[u32; 3]>) -> Surface {
    let n = faces.iter().flatten().max().map_or(0, |m| m + 1);
    let source = (0u32..).take(faces.len()).collect();
    Surface { positions: (0..n).map(|i| DVec3::splat(f64::from(i))).collect(), faces, source }
}

fn mesh(faces: Vec<[u32; 3]>) -> Result<HalfEdgeMesh, NotManifold> {
    let mesh = HalfEdgeMesh::try_from(&surface(faces))?;
    mesh.check().unwrap();
    Ok(mesh)
}

fn tetrahedron() -> Vec<[u32; 3]> {
    vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
}

fn octahedron() -> Vec<[u32; 3]> {
    vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
}

fn torus(n: u32, m: u32) -> Vec<[u32; 3]> {
    let at = |i: u32, j: u32| (i % n) * m + j % m;
    let quads = (0..n).flat_map(|i| (0..m).map(move |j| (i, j)));
    quads
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// A strip of `n` quads that closes to a ring with two boundary loops.
fn ring(n: u32) -> Vec<[u32; 3]> {
    let at = |i: u32, side: u32| (i % n) * 2 + side;
    (0..n).flat_map(|i| [[at(i, 0), at(i + 1, 0), at(i + 1, 1)], [at(i, 0), at(i + 1, 1), at(i, 1)]]).collect()
}

fn two_shells() -> Vec<[u32; 3]> {
    let moved = tetrahedron().into_iter().map(|face| face.map(|v| v + 6));
    octahedron().into_iter().chain(moved).collect()
}

fn v(index: u32) -> VertexId {
    VertexId::new(index)
}

#[test]
fn the_first_face_edge_or_vertex_in_the_way_is_named() {
    assert_eq!(mesh(vec![[0, 1, 2], [3, 4, 3]]), Err(NotManifold::BadFace { face: FaceId::new(1) }));
    let mut outside = surface(vec![[0, 1, 2]]);
    outside.positions.pop();
    assert_eq!(HalfEdgeMesh::try_from(&outside), Err(NotManifold::BadFace { face: FaceId::new(0) }));
    let three = vec![[5, 6, 7], [0, 1, 2], [1, 0, 3], [0, 1, 4]];
    assert_eq!(mesh(three), Err(NotManifold::ManyFaces { ends: [v(0), v(1)], faces: 3, face: FaceId::new(1) }));
    let faces = [FaceId::new(0), FaceId::new(1)];
    assert_eq!(mesh(vec![[0, 1, 2], [0, 1, 3]]), Err(NotManifold::SameDirection { ends: [v(0), v(1)], faces }));
    assert_eq!(mesh(vec![[1, 0, 2], [0, 3, 4]]), Err(NotManifold::ManyFans { vertex: v(0) }));
    let open = Manifold::try_from(mesh(vec![[3, 4, 5]]).unwrap());
    assert_eq!(open, Err(NotManifold::Open { ends: [v(3), v(4)], face: FaceId::new(0) }));
}

#[test]
fn a_vertex_that_two_tetrahedra_share_is_refused() {
    let other = tetrahedron().into_iter().map(|face| face.map(|v| v + 3));
    let faces = tetrahedron().into_iter().chain(other).collect();
    assert_eq!(mesh(faces), Err(NotManifold::ManyFans { vertex: v(3) }));
}

#[test]
fn closed_meshes_have_the_euler_characteristic_of_their_genus() {
    for (faces, expected) in
        [(tetrahedron(), 2), (octahedron(), 2), (torus(3, 3), 0), (torus(4, 5), 0), (two_shells(), 4)]
    {
        let manifold = Manifold::try_from(&surface(faces)).unwrap();
        manifold.check().unwrap();
        assert_eq!(manifold.euler_characteristic(), expected);
        assert!(manifold.half_edges().all(|h| manifold.twin(manifold.twin(h)) == h));
    }
}

#[test]
fn walking_around_a_vertex_turns_counter_clockwise_and_begins_on_the_boundary() {
    let closed = mesh(octahedron()).unwrap();
    assert_eq!(closed.neighbours(v(4)).collect::<Vec<_>>(), [0, 2, 1, 3].map(v));
    let fan = mesh(vec![[0, 2, 3], [0, 3, 4], [0, 1, 2]]).unwrap();
    assert_eq!(fan.neighbours(v(0)).collect::<Vec<_>>(), [1, 2, 3, 4].map(v));
    assert_eq!(fan.around(v(0)).map(HalfEdgeId::face).collect::<Vec<_>>(), [2, 0, 1].map(FaceId::new));
    assert!(fan.is_boundary_vertex(v(0)) && !closed.is_boundary_vertex(v(4)));
}

#[test]
fn a_ring_has_two_boundary_loops_along_its_faces() {
    let ring = mesh(ring(4)).unwrap();
    let loops = ring.boundary_loops();
    let origins: Vec<Vec<u32>> = loops.iter().map(|l| l.iter().map(|&h| ring.origin(h).raw()).collect()).collect();
    assert_eq!(origins, [[0, 2, 4, 6], [3, 1, 7, 5]]);
    assert_eq!(ring.euler_characteristic(), 0);
}

#[test]
fn the_last_edges_of_a_tetrahedron_and_of_a_triangle_do_not_collapse() {
    let mut closed = mesh(tetrahedron()).unwrap();
    let mut triangle = mesh(vec![[0, 1, 2]]).unwrap();
    let untouched = (closed.clone(), triangle.clone());
    let h = HalfEdgeId::new(0);
    assert_eq!(closed.collapse_edge(h), Err(Refused::Doubled));
    assert_eq!(triangle.collapse_edge(h), Err(Refused::Doubled));
    assert_eq!(closed.flip_edge(h), Err(Refused::Doubled));
    assert_eq!(triangle.flip_edge(h), Err(Refused::Boundary));
    assert_eq!((closed, triangle), untouched);
}

#[test]
fn flipping_an_edge_twice_more_than_once_brings_the_faces_back() {
    let before = mesh(octahedron()).unwrap();
    let mut mesh = before.clone();
    let h = mesh.find(v(2), v(4)).unwrap();
    mesh.flip_edge(h).unwrap();
    assert!(!mesh.are_neighbours(v(2), v(4)) && mesh.are_neighbours(v(0), v(1)));
    mesh.flip_edge(h).unwrap();
    assert_eq!(faces_of(&mesh), faces_of(&before));
}

#[test]
fn splitting_an_edge_and_collapsing_the_new_one_brings_the_faces_back() {
    for faces in [octahedron(), ring(5)] {
        let before = mesh(faces).unwrap();
        for h in before.half_edges() {
            let mut mesh = before.clone();
            let m = mesh.split_edge(h, DVec3::splat(0.5)).unwrap();
            mesh.check().unwrap();
            assert_eq!((mesh.destination(h), mesh.position(m)), (m, DVec3::splat(0.5)));
            let back = mesh.find(m, before.origin(h)).or_else(|| mesh.find(m, before.destination(h))).unwrap();
            mesh.collapse_edge(back).unwrap();
            mesh.check().unwrap();
            assert_eq!(faces_of(&mesh), faces_of(&before));
        }
    }
}

#[test]
fn a_slit_is_closed_from_its_end_by_merging_vertices() {
    // Two strips that share their first vertex: 0, 1, 2, 3 on one side of the slit and 0, 4, 5, 6 on the other.
    let upper = [[0, 7, 1], [1, 7, 2], [2, 7, 3]];
    let lower = [[0, 4, 8], [4, 5, 8], [5, 6, 8]];
    let around = [[0, 9, 7], [0, 8, 9]];
    let mut mesh = mesh([&upper[..], &lower, &around].concat()).unwrap();
    let before = mesh.clone();
    assert_eq!(mesh.merge_vertices(v(5), v(2)), Err(Refused::Pinched(v(2))));
    assert_eq!(mesh.merge_vertices(v(5), v(5)), Err(Refused::Repeated(v(5))));
    assert_eq!(mesh.merge_vertices(v(5), v(77)), Err(Refused::Missing));
    assert_eq!(mesh.merge_vertices(v(9), v(1)), Err(Refused::Occupied(v(1), v(0))));
    assert_eq!(mesh, before);
    for (from, to) in [(4, 1), (5, 2), (6, 3)] {
        assert_eq!(mesh.merge_vertices(v(from), v(to)), Ok(v(to)));
        mesh.check().unwrap();
    }
    assert_eq!((mesh.vertex_count(), mesh.face_count(), mesh.boundary_loops().len()), (7, 8, 1));
    assert!(!mesh.is_boundary_vertex(v(1)) && mesh.is_boundary_vertex(v(3)));
    assert!((0..8).all(|f| mesh.source(FaceId::new(f)) == f), "no face was made anew");
}

#[test]
fn a_mesh_taken_apart_face_by_face_and_put_together_again_is_the_same() {
    let mut before = mesh(octahedron()).unwrap();
    for h in [0, 7, 11, 19, 2, 30].map(HalfEdgeId::new) {
        before.split_edge(h, DVec3::ONE).unwrap();
    }
    let mut mesh = before.clone();
    let mut taken = Vec::new();
    while mesh.face_count() > 0 {
        // From the boundary inward, so that what is left is always a disc.
        let closed = mesh.boundary_loops().is_empty();
        let outer = |f: FaceId| closed || f.half_edges().iter().any(|&h| mesh.is_boundary(h));
        let next = mesh.faces().find(|&f| outer(f) && mesh.clone().remove_face(f).is_ok()).unwrap();
        taken.push((mesh.corners(next), mesh.source(next)));
        mesh.remove_face(next).unwrap();
        mesh.check().unwrap();
    }
    for (corners, source) in taken.into_iter().rev() {
        mesh.add_face(corners, source).unwrap();
        mesh.check().unwrap();
    }
    assert_eq!(faces_of(&mesh), faces_of(&before));
    let sources = |mesh: &HalfEdgeMesh| {
        let mut of: Vec<u32> = mesh.faces().map(|f| mesh.source(f)).collect();
        of.sort_unstable();
        of
    };
    assert_eq!(sources(&mesh), sources(&before));
}

#[test]
fn going_to_a_surface_leaves_gaps_behind() {
    let mut mesh = mesh(octahedron()).unwrap();
    mesh.remove_face(FaceId::new(0)).unwrap();
    mesh.collapse_edge(mesh.find(v(1), v(3)).unwrap()).unwrap();
    let surface = mesh.to_surface();
    surface.check().unwrap();
    assert_eq!((surface.faces.len(), surface.positions.len()), (5, 5));
    assert_eq!(surface.source, [1, 3, 4, 5, 7]);
}

fn faces_of(mesh: &HalfEdgeMesh) -> Vec<[u32; 3]> {
    sorted(mesh.faces().map(|f| mesh.corners(f).map(VertexId::raw)).collect())
}

/// The faces, each from its smallest vertex on, sorted.
fn sorted(mut faces: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
    for face in &mut faces {
        let least = (0..3).min_by_key(|&i| face[i]).unwrap();
        face.rotate_left(least);
    }
    faces.sort_unstable();
    faces
}
