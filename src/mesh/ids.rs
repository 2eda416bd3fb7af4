use std::fmt;
use std::num::NonZeroU32;

/// A handle: the index of one kind of element, of the size of a `u32` even within an `Option`.
macro_rules! handle {
    ($(#[$doc:meta])* $name:ident, $word:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(NonZeroU32);

        impl $name {
            /// The handle of the element with an index below `u32::MAX`.
            #[must_use]
            pub const fn new(index: u32) -> Self {
                // One more than the index, so that zero is free for `Option`.
                Self(NonZeroU32::MIN.saturating_add(index))
            }

            /// The index as it stands in faces.
            #[must_use]
            pub const fn raw(self) -> u32 {
                self.0.get() - 1
            }

            /// The index, to look up in a slice.
            #[must_use]
            pub const fn index(self) -> usize {
                self.raw() as usize
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($word, " {}"), self.raw())
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!(stringify!($name), "({})"), self.raw())
            }
        }
    };
}

handle! {
    /// A vertex of a mesh.
    VertexId, "vertex"
}
handle! {
    /// A face of a mesh.
    FaceId, "face"
}
handle! {
    /// A half-edge: one side of an edge, which runs along one face from its origin. It is named by the corner of the
    /// face where it starts, `3 * face + i`.
    HalfEdgeId, "half-edge"
}
handle! {
    /// An edge, by its place among [`Edges`](super::Edges).
    EdgeId, "edge"
}

impl FaceId {
    /// The half-edges of the face, each from its corner to the next.
    #[must_use]
    pub const fn half_edges(self) -> [HalfEdgeId; 3] {
        let first = 3 * self.raw();
        [HalfEdgeId::new(first), HalfEdgeId::new(first + 1), HalfEdgeId::new(first + 2)]
    }
}

impl HalfEdgeId {
    /// The face along which it runs.
    #[must_use]
    pub const fn face(self) -> FaceId {
        FaceId::new(self.raw() / 3)
    }

    /// The half-edge of the same face that starts where this one ends.
    #[must_use]
    pub const fn next(self) -> Self {
        let raw = self.raw();
        Self::new(if raw % 3 == 2 { raw - 2 } else { raw + 1 })
    }

    /// The half-edge of the same face that ends where this one starts.
    #[must_use]
    pub const fn prev(self) -> Self {
        let raw = self.raw();
        Self::new(if raw.is_multiple_of(3) { raw + 2 } else { raw - 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_handle_takes_no_more_room_than_its_number_even_when_it_may_be_missing() {
        assert_eq!(size_of::<Option<HalfEdgeId>>(), size_of::<u32>());
        assert_eq!(VertexId::new(0).index(), 0);
        assert_eq!(VertexId::new(u32::MAX - 1).raw(), u32::MAX - 1);
        assert!(FaceId::new(3) < FaceId::new(4));
    }

    #[test]
    fn three_half_edges_go_around_a_face_both_ways() {
        let [a, b, c] = FaceId::new(7).half_edges();
        assert_eq!([a.next(), b.next(), c.next()], [b, c, a]);
        assert_eq!([a.prev(), b.prev(), c.prev()], [c, a, b]);
        assert!([a, b, c].iter().all(|h| h.face() == FaceId::new(7)));
    }

    #[test]
    fn handles_name_their_kind() {
        assert_eq!(format!("{} {:?}", EdgeId::new(4), VertexId::new(5)), "edge 4 VertexId(5)");
    }
}
