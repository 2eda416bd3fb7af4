use super::{Counter, Counts, Operator};

impl Operator {
    /// What it claims to fix. None of these may rise by it.
    #[must_use]
    pub fn fixes(self) -> &'static [Counter] {
        use Counter::{
            BoundaryEdges, DegenerateFaces, DuplicateFaces, MisorientedEdges, NonmanifoldEdges, PinchedVertices,
        };
        match self {
            Self::RoundCoordinates | Self::MergeVertices | Self::DropSmallParts => &[],
            Self::Simplify | Self::Remesh => &Counter::ALL,
            Self::RemoveCollapsedFaces | Self::RemoveCaps | Self::RemoveSlivers => &[DegenerateFaces],
            Self::Weld | Self::JoinParts | Self::FillHoles | Self::AddBase | Self::RemoveDebris => &[BoundaryEdges],
            Self::ThickenSheets => &[BoundaryEdges, MisorientedEdges],
            Self::RemoveDuplicates => &[DuplicateFaces],
            // A cut edge is two for a while, where only one of them finds its counterpart.
            Self::SplitTJunctions => &[MisorientedEdges, NonmanifoldEdges, DuplicateFaces],
            Self::Sew | Self::Stitch => &[BoundaryEdges, MisorientedEdges, NonmanifoldEdges, DuplicateFaces],
            Self::UnfoldFoldovers => &[NonmanifoldEdges, BoundaryEdges],
            Self::RemoveSheetsWithin => &[BoundaryEdges, NonmanifoldEdges],
            Self::RemoveOverlappingNeighbours | Self::RemoveMembranes => &[NonmanifoldEdges],
            Self::Orient | Self::CutOneSided => &[MisorientedEdges],
            Self::CutApart => &[NonmanifoldEdges, PinchedVertices],
            Self::CleanAndPatch => &[BoundaryEdges, NonmanifoldEdges],
            Self::FreeFins | Self::Resolve | Self::Separate => &[NonmanifoldEdges],
        }
    }

    /// What may rise by it, since a later operator takes it up or since it is the lesser evil.
    #[must_use]
    pub fn may_raise(self) -> &'static [Counter] {
        use Counter::{
            BoundaryEdges, DegenerateFaces, DuplicateFaces, MisorientedEdges, NonmanifoldEdges, PinchedVertices,
        };
        match self {
            Self::RoundCoordinates | Self::MergeVertices => &Counter::ALL,
            Self::RemoveCollapsedFaces
            | Self::Orient
            | Self::UnfoldFoldovers
            | Self::CleanAndPatch
            | Self::DropSmallParts
            | Self::Simplify
            | Self::Remesh => &[],
            // Where several sheets meet, what was open becomes an edge of several faces.
            Self::Weld => &[NonmanifoldEdges, MisorientedEdges, PinchedVertices, DuplicateFaces],
            // What is joined at one end of an edge and not at the other is pinched.
            Self::SplitTJunctions => &[BoundaryEdges, PinchedVertices],
            Self::Sew | Self::Stitch => &[PinchedVertices],
            Self::RemoveDuplicates => &[BoundaryEdges, MisorientedEdges, NonmanifoldEdges, PinchedVertices],
            // A cap on the boundary goes, and the two edges behind it are open instead of its one.
            Self::RemoveCaps | Self::RemoveSlivers => &[BoundaryEdges],
            Self::RemoveOverlappingNeighbours => &[BoundaryEdges, PinchedVertices],
            // Faces that the wall kept apart may wind against one another.
            Self::RemoveSheetsWithin | Self::RemoveMembranes => &[MisorientedEdges, PinchedVertices],
            Self::CutOneSided => &[BoundaryEdges],
            Self::FreeFins => &[BoundaryEdges, PinchedVertices],
            Self::CutApart | Self::Separate => &[BoundaryEdges, DuplicateFaces],
            // A crack whose border lies on a line is closed by faces without area.
            Self::FillHoles => &[DegenerateFaces],
            // A band between parts that touch.
            Self::JoinParts => &[DegenerateFaces, NonmanifoldEdges, PinchedVertices],
            // What was one edge of several faces is so on both skins.
            Self::ThickenSheets => &[NonmanifoldEdges, PinchedVertices, DegenerateFaces, DuplicateFaces],
            Self::AddBase => &[NonmanifoldEdges, PinchedVertices],
            Self::Resolve => &[BoundaryEdges, MisorientedEdges, PinchedVertices, DegenerateFaces, DuplicateFaces],
            Self::RemoveDebris => &[PinchedVertices],
        }
    }

    /// The first counter that rose though it must not, with what it was and became.
    pub(in crate::repair) fn broken_claim(self, before: &Counts, after: &Counts) -> Option<(Counter, u64, u64)> {
        let rose = |counter: &Counter| after.get(*counter) > before.get(*counter);
        let claimed = self.fixes().iter().find(|c| rose(c));
        let found = claimed.or_else(|| Counter::ALL.iter().find(|c| rose(c) && !self.may_raise().contains(c)));
        found.map(|&counter| (counter, before.get(counter), after.get(counter)))
    }
}
