//! Reads the columns of an answer pair by pair.

use hullcast_proto::{Flag, Outcome, QueryContactsResponse};

/// The answer for one pair. A value is `None`, and a slice is empty, if its output was not asked for.
///
/// If the outcome is INVALID, the pair has no answer, and its numbers are NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair<'a> {
    /// Whether the hulls touch. An outcome that this version does not know is UNSPECIFIED.
    pub outcome: Outcome,
    /// The bits of [`Flag`]; [`Pair::has_flag`] tests one.
    pub flags: u8,
    /// The bodies, the lower index first. Only a search states them.
    pub bodies: Option<[u32; 2]>,
    /// The growth scale: below 1 the hulls overlap, above 1 they are apart. A certified lower bound for a
    /// SEPARATED pair.
    pub alpha: Option<f64>,
    /// The certified lower and upper end of the bracket of `alpha`.
    pub alpha_bracket: Option<[f64; 2]>,
    /// The signed separation along the normal, a length; negative if the hulls overlap.
    pub separation: Option<f64>,
    /// The unit normal in the world frame, from A to B.
    pub normal: Option<[f64; 3]>,
    /// The contact points on A, in the world frame. The point on B is the point on A + distance * normal.
    pub witness_as: &'a [[f64; 3]],
    /// The signed distance of each contact point along the normal, a length; negative if the hulls overlap
    /// there.
    pub distances: &'a [f64],
    /// The contact points on B, in the world frame.
    pub witness_bs: &'a [[f64; 3]],
}

impl Pair<'_> {
    /// Whether a bit of `flags` is set.
    pub fn has_flag(&self, flag: Flag) -> bool {
        i32::from(self.flags) & flag as i32 != 0
    }
}

/// The pairs of an answer of [`Client::query`](crate::Client::query), [`Search::next`](crate::Search::next) or
/// [`Session::step`](crate::Session::step), in order. The remaining columns are read from the answer itself.
///
/// ```
/// # let answer = hullcast_client::proto::QueryContactsResponse::default();
/// for pair in hullcast_client::pairs(&answer) {
///     println!("{:?} {:?} {} points", pair.outcome, pair.separation, pair.witness_as.len());
/// }
/// ```
pub fn pairs(answer: &QueryContactsResponse) -> impl Iterator<Item = Pair<'_>> {
    let mut begin = 0;
    (0..answer.outcomes.len()).map(move |pair| {
        let end = begin + answer.point_counts.get(pair).map_or(0, |&count| count as usize);
        let points = begin..end;
        begin = end;
        let value = |column: &[f64]| column.get(pair).copied();
        Pair {
            outcome: Outcome::try_from(i32::from(answer.outcomes[pair])).unwrap_or(Outcome::Unspecified),
            flags: answer.flags.get(pair).copied().unwrap_or_default(),
            bodies: answer.pairs.as_chunks().0.get(pair).copied(),
            alpha: value(&answer.alphas),
            alpha_bracket: value(&answer.alpha_lowers).zip(value(&answer.alpha_uppers)).map(Into::into),
            separation: value(&answer.separations),
            normal: answer.normals.as_chunks().0.get(pair).copied(),
            witness_as: answer.witness_as.as_chunks().0.get(points.clone()).unwrap_or_default(),
            distances: answer.distances.get(points.clone()).unwrap_or_default(),
            witness_bs: answer.witness_bs.as_chunks().0.get(points).unwrap_or_default(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches points that are given to another pair, and a column that was not asked for and is read.
    #[test]
    fn each_pair_has_its_own_points() {
        let answer = QueryContactsResponse {
            outcomes: vec![1, 2, 1, 9],
            flags: vec![0, 0, 5, 0],
            separations: vec![-1.0, 2.0, -3.0, 4.0],
            normals: (0..12).map(f64::from).collect(),
            point_counts: vec![2, 0, 1, 0],
            witness_as: (0..9).map(f64::from).collect(),
            distances: vec![-1.0, -0.5, -3.0],
            pairs: vec![0, 1, 0, 2, 1, 2, 2, 3],
            ..QueryContactsResponse::default()
        };
        let read: Vec<Pair<'_>> = pairs(&answer).collect();
        assert_eq!(read.len(), 4);
        assert_eq!(read[0].witness_as, [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]);
        assert_eq!((read[1].witness_as.len(), read[1].distances.len()), (0, 0));
        assert_eq!((read[2].witness_as, read[2].distances), (&[[6.0, 7.0, 8.0]][..], &[-3.0][..]));
        assert_eq!((read[2].normal, read[2].bodies), (Some([6.0, 7.0, 8.0]), Some([1, 2])));
        assert!(read[2].has_flag(Flag::Estimated) && read[2].has_flag(Flag::GapOpen));
        assert!(!read[2].has_flag(Flag::Reduced));
        assert_eq!((read[1].outcome, read[3].outcome), (Outcome::Separated, Outcome::Unspecified));
        assert_eq!((read[0].alpha, read[0].alpha_bracket, read[0].witness_bs), (None, None, &[][..]));
    }
}
