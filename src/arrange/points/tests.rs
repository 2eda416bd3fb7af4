//! Tests of exact predicates on points.

use super::*;

#[test]
fn points_in_the_planes_of_coplanar_faces_are_not_on_one_line() {
    let mut points = Points::default();
    points.planes.push(Plane::through([[0, 0, 0], [64, 0, 0], [0, 64, 0]]));
    points.planes.push(Plane::through([[8, 8, 0], [8, 64, 0], [64, 8, 0]]));
    // Edges that meet the planes so near to each other that floating point does not decide.
    let corners = [[0, 0], [1, 0], [0, 1]].map(|[x, y]| {
        let ends = [[0, 0, -1], [x, y, 1023]].map(|end| points.push(end));
        points.on_edge(ends, 1)
    });
    assert_eq!(points.turn(0, 2, corners), Sign::Positive);
}

#[test]
fn points_on_one_line_by_definition_have_no_orientation() {
    let mut points = Points::default();
    points.planes.push(Plane::through([[0, 0, 0], [64, 0, 0], [0, 64, 0]]));
    points.planes.push(Plane::through([[0, 0, -8], [64, 64, -8], [0, 0, 8]]));
    // In the plane through the diagonal, and on the level of the floor.
    let edges = [[0, 9], [9, 1], [3, 30]].map(|[x, y]| {
        let ends = [[x, y, 0], [y, x, 0]].map(|end| points.push(end));
        points.on_edge(ends, 1)
    });
    assert_eq!(points.turn(0, 2, edges), Sign::Zero);
    assert_eq!(points.turn(1, 0, edges), Sign::Zero);
    let corner = points.push([40, 41, 0]);
    assert_eq!(points.turn(0, 2, [edges[0], edges[2], corner]), Sign::Positive);
}
