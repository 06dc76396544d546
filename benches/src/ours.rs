//! hullcast as a contender, through its public function only.

use hullcast_contact::{
    Basis, Body, BoxPair, ConvexHull, HullError, InstructionSet, Pose, Query, Workspace, box_manifolds_with,
    contact_manifold,
};

use crate::cells::{Cell, PosedPair};

/// The hulls of a cell.
pub fn hulls(cell: &Cell) -> Result<Vec<ConvexHull>, HullError> {
    cell.hulls.iter().map(|points| ConvexHull::new(points)).collect()
}

/// Pairs at two poses each, and the query about them.
pub struct PosedPairs<'a> {
    /// For each pair the bodies at their poses in the cell, and in the moved cell.
    pairs: Vec<[[Body<'a>; 2]; 2]>,
    phase: usize,
    bases: Vec<Option<Basis>>,
    query: Query,
    workspace: Workspace,
}

impl<'a> PosedPairs<'a> {
    /// A scene of the pairs. `None` if a pose is not usable.
    pub fn new(hulls: &'a [ConvexHull], cell: &Cell, moved: &Cell, query: Query) -> Option<Self> {
        let bodies = |pair: &PosedPair| {
            let [a, b] = pair.poses.map(|pose| Pose::new(pose.position, pose.rotation).ok());
            Some([Body::new(&hulls[pair.hulls[0]], a?), Body::new(&hulls[pair.hulls[1]], b?)])
        };
        let both = |(pair, moved)| Some([bodies(pair)?, bodies(moved)?]);
        let pairs = cell.pairs.iter().zip(&moved.pairs).map(both).collect::<Option<Vec<_>>>()?;
        let bases = vec![None; pairs.len()];
        Some(Self { pairs, phase: 0, bases, query, workspace: Workspace::default() })
    }

    /// Computes every pair without a warm start. Returns the number of pairs with points.
    pub fn cold(&mut self) -> usize {
        let mut touching = 0;
        for [[a, b], _] in &self.pairs {
            let manifold = contact_manifold(a, b, &self.query, None, &mut self.workspace);
            touching += usize::from(!manifold.points.is_empty());
        }
        touching
    }

    /// Computes every pair at its other pose, from its basis of the previous pass. Returns the number of
    /// pairs with points.
    pub fn warm(&mut self) -> usize {
        self.phase ^= 1;
        let mut touching = 0;
        for (bodies, basis) in self.pairs.iter().zip(&mut self.bases) {
            let [a, b] = &bodies[self.phase];
            let manifold = contact_manifold(a, b, &self.query, basis.as_ref(), &mut self.workspace);
            touching += usize::from(!manifold.points.is_empty());
            *basis = manifold.basis;
        }
        touching
    }
}

/// Pairs that are computed together, as the server does.
const TOGETHER: usize = 64;

/// Pairs of boxes, one in each lane.
pub struct BoxesInLanes<'a> {
    pairs: Vec<BoxPair<'a>>,
    instructions: InstructionSet,
    query: Query,
    workspace: Workspace,
}

impl<'a> BoxesInLanes<'a> {
    /// The pairs of a cell. `None` if a pose is not usable, or a hull is not a box.
    pub fn new(
        hulls: &'a [ConvexHull],
        cell: &Cell,
        query: Query,
        instructions: InstructionSet,
    ) -> Option<Self> {
        let pair = |pair: &PosedPair| {
            let [a, b] = pair.poses.map(|pose| Pose::new(pose.position, pose.rotation).ok());
            let (a, b) = (Body::new(&hulls[pair.hulls[0]], a?), Body::new(&hulls[pair.hulls[1]], b?));
            BoxPair::new(&a, &b, &query, None)
        };
        let pairs = cell.pairs.iter().map(pair).collect::<Option<Vec<_>>>()?;
        Some(Self { pairs, instructions, query, workspace: Workspace::default() })
    }

    /// Computes every pair without a warm start. Returns the number of pairs with points.
    pub fn cold(&mut self) -> usize {
        let mut touching = 0;
        for pairs in self.pairs.chunks(TOGETHER) {
            let answers = box_manifolds_with(self.instructions, pairs, &self.query, &mut self.workspace);
            touching += answers.iter().filter(|manifold| !manifold.points.is_empty()).count();
        }
        touching
    }
}
