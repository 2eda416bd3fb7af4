//! Each edit compared with the same edit on a bare list of faces.

use super::*;

/// An edit on a list of faces, as its words say; a list that is no mesh is an edit that must be refused.
struct Oracle {
    faces: Vec<[u32; 3]>,
    vertices: usize,
}

impl Oracle {
    fn of(mesh: &HalfEdgeMesh) -> Self {
        Self { faces: faces_of(mesh), vertices: mesh.positions.len() }
    }

    fn without(&self, dropped: impl Fn(&[u32; 3]) -> bool, added: &[[u32; 3]]) -> Vec<[u32; 3]> {
        let kept = self.faces.iter().filter(|f| !dropped(f)).chain(added).copied();
        sorted(kept.collect())
    }

    fn mesh(&self, faces: &[[u32; 3]]) -> Option<HalfEdgeMesh> {
        let positions = vec![DVec3::ZERO; self.vertices];
        let source = vec![NO_SOURCE; faces.len()];
        HalfEdgeMesh::try_from(&Surface { positions, faces: faces.to_vec(), source }).ok()
    }
}

/// How many different sets of vertices the faces have.
fn group_count(faces: &[[u32; 3]]) -> usize {
    let mut sets = faces.to_vec();
    sets.iter_mut().for_each(|face| face.sort_unstable());
    sets.sort_unstable();
    sets.dedup();
    sets.len()
}

fn has(face: &[u32; 3], vertices: &[u32]) -> bool {
    vertices.iter().all(|v| face.contains(v))
}

/// What an edit does to the shape as a whole.
fn shape(mesh: &HalfEdgeMesh) -> (i64, usize, usize) {
    (mesh.euler_characteristic(), mesh.boundary_loops().len(), mesh.shells().count)
}

#[derive(Debug, Clone, Copy)]
enum Edit {
    Flip,
    Split,
    Collapse,
    Merge,
    Remove,
    Add,
}

/// Makes the edit at the half-edge, and asks that it is made just when the oracle's result is a mesh, with its faces.
fn try_edit(mesh: &mut HalfEdgeMesh, edit: Edit, h: HalfEdgeId, at: u32) {
    let before = mesh.clone();
    let oracle = Oracle::of(mesh);
    let [a, b, c] = [h, h.next(), h.prev()].map(|h| before.origin(h).raw());
    let d = before.twin(h).map(|t| before.origin(t.prev()).raw());
    let m = u32::try_from(oracle.vertices).unwrap();
    let (done, expected) = match edit {
        Edit::Flip => {
            let turned = d.map(|d| oracle.without(|f| has(f, &[a, b]), &[[c, a, d], [d, b, c]]));
            (mesh.flip_edge(h).is_ok(), turned.filter(|f| oracle.mesh(f).is_some()))
        }
        Edit::Split => {
            let mut halves = vec![[a, m, c], [m, b, c]];
            halves.extend(d.into_iter().flat_map(|d| [[b, m, d], [m, a, d]]));
            let wider = Oracle { vertices: oracle.vertices + 1, faces: oracle.faces.clone() };
            let cut = Some(wider.without(|f| has(f, &[a, b]), &halves)).filter(|f| wider.mesh(f).is_some());
            (mesh.split_edge(h, DVec3::ONE).is_ok(), cut)
        }
        Edit::Collapse | Edit::Merge => {
            let next = mesh.next_on_boundary(h).map(|next| mesh.destination(next).raw());
            let b = match edit {
                Edit::Collapse => b,
                // Most often across a corner of the boundary, sometimes any vertex.
                _ => next.filter(|_| !at.is_multiple_of(4)).unwrap_or(at % m),
            };
            let joined = oracle.faces.iter().any(|f| has(f, &[a, b]));
            let moved: Vec<[u32; 3]> = oracle.without(|f| has(f, &[a, b]), &[]);
            let moved = sorted(moved.into_iter().map(|f| f.map(|v| if v == a { b } else { v })).collect());
            // The link condition keeps complexes: no two faces fall on one another, and no other vertex goes.
            let doubled = |f: &[[u32; 3]]| f.len() - group_count(f);
            let same = |f: &Vec<[u32; 3]>| {
                doubled(f) == doubled(&oracle.faces)
                    && oracle
                        .mesh(f)
                        .is_some_and(|m| shape(&m) == shape(&before) && m.vertex_count() + 1 == before.vertex_count())
            };
            match edit {
                Edit::Collapse => (mesh.collapse_edge(h).is_ok(), Some(moved).filter(same)),
                _ => {
                    let possible = |f: &Vec<[u32; 3]>| {
                        before.has_vertex(v(b)) && a != b && if joined { same(f) } else { oracle.mesh(f).is_some() }
                    };
                    (mesh.merge_vertices(v(a), v(b)).is_ok(), Some(moved).filter(possible))
                }
            }
        }
        Edit::Remove => {
            let rest = oracle.without(|f| has(f, &[a, b, c]) && *f == sorted(vec![[a, b, c]])[0], &[]);
            (mesh.remove_face(h.face()).is_ok(), Some(rest).filter(|f| oracle.mesh(f).is_some()))
        }
        Edit::Add => {
            // Most often across two edges of the boundary, sometimes to any vertex.
            let far = mesh.next_on_boundary(h).map_or(at % m, |next| mesh.destination(next).raw());
            let third = if at.is_multiple_of(4) { at % m } else { far };
            let more = oracle.without(|_| false, &[[b, a, third]]);
            (mesh.add_face([b, a, third].map(v), NO_SOURCE).is_ok(), Some(more).filter(|f| oracle.mesh(f).is_some()))
        }
    };
    assert_eq!(done, expected.is_some(), "{edit:?} of {h} from {a} to {b} in {:?}", oracle.faces);
    mesh.check().unwrap();
    match expected {
        Some(faces) => assert_eq!(faces_of(mesh), faces),
        None => assert_eq!(*mesh, before, "a refused edit changed something"),
    }
    if matches!(edit, Edit::Flip | Edit::Split | Edit::Collapse) {
        assert_eq!(shape(mesh), shape(&before));
    }
}

fn shapes() -> impl Strategy<Value = Vec<[u32; 3]>> {
    prop_oneof![
        Just(tetrahedron()),
        Just(octahedron()),
        Just(two_shells()),
        Just(vec![[0, 1, 2], [0, 2, 1]]),
        (3u32..6, 3u32..6).prop_map(|(n, m)| torus(n, m)),
        (3u32..7).prop_map(ring),
    ]
}

fn edits(kinds: &'static [Edit]) -> impl Strategy<Value = Vec<(Edit, u32)>> {
    prop::collection::vec((prop::sample::select(kinds), any::<u32>()), 1..60)
}

fn nth_half_edge(mesh: &HalfEdgeMesh, at: u32) -> Option<HalfEdgeId> {
    mesh.half_edges().nth(at as usize % (3 * mesh.face_count()).max(1))
}

proptest! {
    #[test]
    fn every_edit_is_made_just_when_its_result_is_a_mesh_and_gives_that_mesh(
        faces in shapes(),
        edits in edits(&[
            Edit::Flip, Edit::Split, Edit::Collapse, Edit::Remove, Edit::Remove, Edit::Add, Edit::Add, Edit::Merge, Edit::Merge,
        ]),
    ) {
        let mut mesh = mesh(faces).unwrap();
        for (edit, at) in edits {
            let Some(h) = nth_half_edge(&mesh, at) else { break };
            // An edge to add a face to or to merge across is looked for on the boundary.
            let h = match edit {
                Edit::Add | Edit::Merge => mesh.boundary_loops().first().map_or(h, |l| l[at as usize % l.len()]),
                _ => h,
            };
            try_edit(&mut mesh, edit, h, at);
        }
    }

    #[test]
    fn a_vertex_parted_in_two_and_drawn_together_again_leaves_the_mesh_as_it_was(
        faces in shapes(),
        edits in edits(&[Edit::Flip, Edit::Split, Edit::Remove]),
        at in any::<u32>(),
    ) {
        let mut before = mesh(faces).unwrap();
        for (edit, at) in edits {
            if let Some(h) = nth_half_edge(&before, at) {
                try_edit(&mut before, edit, h, at);
            }
        }
        let Some(first) = nth_half_edge(&before, at) else { return Ok(()) };
        let v = before.origin(first);
        let around: Vec<HalfEdgeId> = before.around(v).collect();
        let from = around.iter().position(|&h| h == first).unwrap();
        for (to, &last) in around.iter().enumerate() {
            let mut mesh = before.clone();
            let parted = mesh.split_vertex(first, last, DVec3::ONE);
            mesh.check().unwrap();
            // On the boundary the walk can't go on past its end, and its first half-edge has no twin.
            let possible = first != last && (!before.is_boundary_vertex(v) || (0 < from && from < to));
            prop_assert_eq!(parted.is_ok(), possible);
            let Ok(a) = parted else {
                prop_assert_eq!(&mesh, &before);
                continue;
            };
            prop_assert_eq!((shape(&mesh), mesh.face_count()), (shape(&before), before.face_count() + 2));
            prop_assert_eq!((mesh.origin(first), mesh.origin(last)), (a, v));
            let moved = (to + around.len() - from) % around.len();
            prop_assert_eq!(mesh.around(a).count(), moved + 2);
            let undone = mesh.collapse_edge(mesh.find(a, v).unwrap());
            mesh.check().unwrap();
            if around.len() == 2 && !before.is_boundary_vertex(v) {
                // Two faces on one another became a tetrahedron, which stays one.
                prop_assert_eq!(undone, Err(Refused::Doubled));
            } else {
                prop_assert_eq!(undone, Ok(v));
                prop_assert_eq!(faces_of(&mesh), faces_of(&before));
            }
        }
    }

    #[test]
    fn a_closed_mesh_stays_closed_and_keeps_its_genus(
        (n, m) in (3u32..6, 3u32..6),
        edits in edits(&[Edit::Flip, Edit::Split, Edit::Collapse, Edit::Collapse]),
    ) {
        let mut manifold = Manifold::try_from(&surface(torus(n, m))).unwrap();
        for (edit, at) in edits {
            let h = nth_half_edge(&manifold, at).unwrap();
            let faces = manifold.face_count();
            let (done, change) = match edit {
                Edit::Flip => (manifold.flip_edge(h).is_ok(), 0),
                Edit::Split => (manifold.split_edge(h, DVec3::ONE).is_ok(), 2),
                _ => (manifold.collapse_edge(h).is_ok(), -2),
            };
            manifold.check().unwrap();
            prop_assert_eq!(manifold.face_count(), faces.saturating_add_signed(if done { change } else { 0 }));
            prop_assert_eq!((manifold.euler_characteristic(), manifold.shells().count), (0, 1));
        }
    }

    #[test]
    fn loops_and_shells_are_those_that_the_surface_has(
        faces in shapes(),
        edits in edits(&[Edit::Remove, Edit::Collapse, Edit::Flip]),
    ) {
        let mut mesh = mesh(faces).unwrap();
        for (edit, at) in edits {
            if let Some(h) = nth_half_edge(&mesh, at) {
                try_edit(&mut mesh, edit, h, at);
            }
        }
        let surface = mesh.to_surface();
        let edges = Edges::new(&surface.faces);
        let fans = Fans::new(&surface, &edges);
        prop_assert_eq!(mesh.shells().count, Parts::new(&surface, &edges).count);
        prop_assert_eq!(mesh.boundary_loops().len() as u64, count_boundary_chains(&edges, &fans));
        let loops = boundary_loops(&surface, &edges, &fans);
        prop_assert_eq!(loops.left, 0);
        let lengths = |of: Vec<usize>| { let mut of = of; of.sort_unstable(); of };
        prop_assert_eq!(
            lengths(mesh.boundary_loops().iter().map(Vec::len).collect()),
            lengths(loops.simple.iter().map(Vec::len).collect())
        );
    }
}
