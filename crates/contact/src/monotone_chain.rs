//! The convex polygon of points in the plane.
//!
//! The method is the monotone chain of A. M. Andrew, *Another efficient algorithm for convex hulls in two
//! dimensions*, 1979, doi:10.1016/0020-0190(79)90072-3:
//!
//! ```text
//! sort the points by x, then by y
//! lower chain: take the points in order; while the last two of the chain and the new point
//!              do not turn left, drop the last one of the chain
//! upper chain: the same with the points in reverse order
//! ```
//!
//! The two chains together are the polygon. Every point is added and dropped at most once per chain, so it
//! takes `O(n)` time for `n` sorted points. If the turns are exact, the polygon is strictly convex.

/// Replaces `polygon` by the strictly convex polygon of the points, anticlockwise from the first point: two
/// points if all are on one line, and one if there is only one.
///
/// `sorted` are the points by x, then by y; no two of them are at one place. `turn` is the sign of the area of
/// the triangle of three points, positive if it is anticlockwise.
///
/// # Errors
/// The first error of `turn`.
pub(crate) fn convex_polygon<P: Copy, E>(
    sorted: &[P],
    polygon: &mut Vec<P>,
    mut turn: impl FnMut([&P; 3]) -> Result<f64, E>,
) -> Result<(), E> {
    polygon.clear();
    add_chain(polygon, sorted.iter(), &mut turn)?;
    add_chain(polygon, sorted.iter().rev(), &mut turn)?;
    if let [only] = sorted {
        polygon.push(*only);
    }
    Ok(())
}

/// Adds the convex chain through `points` to the polygon, without its last point.
fn add_chain<'a, P: Copy + 'a, E>(
    polygon: &mut Vec<P>,
    points: impl Iterator<Item = &'a P>,
    turn: &mut impl FnMut([&P; 3]) -> Result<f64, E>,
) -> Result<(), E> {
    let start = polygon.len();
    for point in points {
        while let [.., a, b] = &polygon[start..] {
            if turn([a, b, point])? > 0.0 {
                break;
            }
            polygon.pop();
        }
        polygon.push(*point);
    }
    polygon.pop();
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::exact::orient2d;

    fn polygon(sorted: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut polygon = vec![[9.0; 2]];
        let Ok(()) =
            convex_polygon(sorted, &mut polygon, |[a, b, c]| Ok::<_, Infallible>(orient2d(*a, *b, *c)));
        polygon
    }

    /// Catches a point on a side or inside that is kept, a corner that is lost or out of order, and points on
    /// one line or alone that become a polygon of the wrong length.
    #[test]
    fn only_the_corners_are_kept() {
        assert_eq!(polygon(&[]), [[0.0; 2]; 0]);
        assert_eq!(polygon(&[[1.0, 2.0]]), [[1.0, 2.0]]);
        assert_eq!(polygon(&[[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]]), [[0.0, 0.0], [3.0, 3.0]]);
        let (mut grid, corners) = (Vec::new(), [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]);
        for x in 0..5 {
            grid.extend((0..5).map(|y| [f64::from(x), f64::from(y)]));
        }
        assert_eq!(polygon(&grid), corners);
    }
}
