mod lines;
mod locate;
mod topology;

use smallvec::SmallVec;

use super::points::Points;
use crate::math::Sign;
use locate::Spot;

pub(super) use lines::{Line, Support};

/// No triangle, no line.
const NONE: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// Counter-clockwise.
    corners: [u32; 3],
    /// The triangle across the edge from corner `i` to the next.
    across: [u32; 3],
    /// The set of lines on that edge.
    lines: [u32; 3],
}

/// A triangulation in a plane that holds points and lines: made by inserting one after the other, with exact signs. Where two
/// lines cross, a new point is made.
///
/// Points go in by splitting and Lawson's flips, lines by flipping the edges that they cross (Sloan 1993, "A fast algorithm for
/// generating constrained Delaunay triangulations"). That it is near Delaunay is decided by floating point and only a matter of
/// shape; that it is a triangulation is exact.
pub(super) struct Triangulation<'a> {
    points: &'a mut Points,
    /// The plane's axis, and whether its normal points against it, so that what turns counter-clockwise seen against the
    /// normal turns clockwise seen against the axis.
    axis: usize,
    turned: bool,
    /// The plane that all is in.
    plane: u32,
    triangles: Vec<Triangle>,
    /// The points by their order of arrival, which is their number here.
    ids: Vec<u32>,
    local: rustc_hash::FxHashMap<u32, u32>,
    /// For each point a triangle that has it as a corner.
    at: Vec<u32>,
    lines: Vec<Line>,
    /// Sets of lines that run along one edge.
    sets: Vec<SmallVec<[u32; 2]>>,
    last: u32,
}

impl<'a> Triangulation<'a> {
    /// One triangle of three points, counter-clockwise seen against the normal of `plane`.
    pub fn new(points: &'a mut Points, plane: u32, corners: [u32; 3]) -> Self {
        let axis = points.planes[plane as usize].axis();
        let turned = points.planes[plane as usize].normal[axis] < 0;
        let local = corners.into_iter().zip(0..).collect();
        Self {
            points,
            axis,
            turned,
            plane,
            triangles: vec![Triangle { corners: [0, 1, 2], across: [NONE; 3], lines: [NONE; 3] }],
            ids: corners.to_vec(),
            local,
            at: vec![0; 3],
            lines: Vec::new(),
            sets: Vec::new(),
            last: 0,
        }
    }

    /// How many points there are, here and elsewhere.
    pub fn count(&self) -> usize {
        self.points.len()
    }

    /// The triangles, by points.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.triangles.iter().map(|t| t.corners.map(|c| self.ids[c as usize]))
    }

    /// Puts a point in, unless it is in.
    pub fn insert(&mut self, id: u32) -> u32 {
        if let Some(&known) = self.local.get(&id) {
            return known;
        }
        let p = self.name(id);
        match self.locate(p) {
            Spot::Inside(t) => self.split_inside(t, p),
            Spot::On(t, i) => self.split_edge(t, i, p),
            // Points are different, so that this is not met; but it is no reason to go wrong.
            Spot::Corner(c) => {
                self.local.insert(id, c);
                return c;
            }
        }
        self.legalise_around(p);
        p
    }

    /// Flips edges until the triangulation is as near to Delaunay as floating point can tell.
    pub fn improve(&mut self) {
        let mut stack: Vec<(u32, usize)> = Vec::new();
        for t in 0..self.triangles.len() {
            #[expect(clippy::cast_possible_truncation, reason = "triangles are counted in u32")]
            stack.extend((0..3).map(|i| (t as u32, i)));
        }
        let mut left = 20 * self.triangles.len();
        while let Some((t, i)) = stack.pop() {
            if left == 0 {
                break;
            }
            if self.wants_flip(t, i) && self.can_flip(t, i) {
                left -= 1;
                let (s, _) = self.twin(t, i);
                self.flip(t, i);
                for k in 0..3 {
                    stack.extend([(t, k), (s, k)]);
                }
            }
        }
    }

    fn name(&mut self, id: u32) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "points are counted in u32")]
        let p = self.ids.len() as u32;
        self.ids.push(id);
        self.local.insert(id, p);
        self.at.push(NONE);
        p
    }

    /// Positive where the corners turn counter-clockwise.
    fn turn(&self, a: u32, b: u32, c: u32) -> Sign {
        let ids = [a, b, c].map(|x| self.ids[x as usize]);
        let sign = self.points.turn(self.axis, ids);
        match (self.turned, sign) {
            (true, Sign::Positive) => Sign::Negative,
            (true, Sign::Negative) => Sign::Positive,
            (_, sign) => sign,
        }
    }

    fn xy(&self, a: u32) -> [f64; 2] {
        let p = self.points.place(self.ids[a as usize]);
        let (i, j) = ((self.axis + 1) % 3, (self.axis + 2) % 3);
        if self.turned { [p[j], p[i]] } else { [p[i], p[j]] }
    }

    /// Lawson's flips around a new point.
    fn legalise_around(&mut self, p: u32) {
        let mut stack: Vec<u32> = self.triangles_at(p).collect();
        while let Some(t) = stack.pop() {
            let Some(k) = self.triangles[t as usize].corners.iter().position(|&c| c == p) else { continue };
            let i = (k + 1) % 3;
            if self.wants_flip(t, i) && self.can_flip(t, i) {
                let (s, _) = self.twin(t, i);
                self.flip(t, i);
                stack.extend([t, s]);
            }
        }
    }
}
