//! Every constant of the geometry, with its unit, formula and source.
//!
//! Three lengths of a pair scale the tolerances. `R` is the sum of the circumradii about the
//! contraction points, and `r` the sum of the inradii. `M` is the sum of the lengths that enter the
//! centre offset `d`: the distance between the origins of the hulls' frames, and the distance of each
//! contraction point from its own origin. There are no absolute tolerances.

/// Unit roundoff of double precision.
pub(crate) const U: f64 = f64::EPSILON / 2.0;

/// Rounding error, as a multiple of `U * M` in `d`, and of `U * R` in a support value. It
/// covers a subtraction and two rotations of three products each, rounded up.
pub(crate) const NOISE: f64 = 16.0;

/// Multiple of `U * R / r` by which a bracket may be open and still count as closed. It is twice
/// [`NOISE`] for the two ends, doubled to leave room for the error of the solver.
pub(crate) const BRACKET: f64 = 64.0;

/// Multiple of `U * (alpha R + M) / r` by which the ends of a bracket may differ, their allowance for
/// noise left out, before wide arithmetic is tried. It is half of the permitted error of alpha.
pub(crate) const COARSE: f64 = 8.0;

/// Centres closer than this multiple of `U * M` coincide, because `d` is then only noise.
pub(crate) const COINCIDENT: f64 = 8.0;

/// Multiple of `U * R` below the highest vertex within which a vertex belongs to the support set, and
/// multiple of `U * (R + M)` within which points of the contact plane count as one.
pub(crate) const MERGE: f64 = 64.0;

/// A turn from one projected side to the next is certainly to the left if its sine exceeds this. The two
/// directions and their product have 8 roundoffs, and the value is rounded up.
pub(crate) const TURN: f64 = 16.0 * U;

/// Multiple of `U * (R + |d|)` in the rounding band around the margin. The multiple of `U * M` in it is
/// [`NOISE`].
pub(crate) const BAND: f64 = 64.0;

/// Multiple of `U * (R + |c| + margin)` of one body by which its bounding box exceeds the body and half
/// the margin. It covers, at least twice over, the rounding of the body's vertices and its half of the
/// rounding band around the margin. Inside the band `|d|` is at most `R + margin`, and `M` is at most
/// `|d|` plus twice both `|c|`, so the band is at most `144 R + 80 margin + 32 |c|` times `U`.
pub(crate) const REACH: f64 = 512.0;

/// For the certificate: below the normal doubles, alpha is a multiple of 2^-1074, and so is its error.
/// Alpha, both ends of its bracket, and the bound that is proved for it are each rounded once.
pub(crate) const SUBNORMAL: f64 = f64::from_bits(4);

/// For the support map, in hull units. If a vertex is at least this far below another one along each
/// direction through a cell's corners, it is not the farthest along any direction in the cell. The
/// value covers 3 roundoffs of each of two heights along a direction no longer than `sqrt(3)`, and 4
/// of the direction's place in the cell, rounded up.
pub(crate) const MAPPED: f64 = 64.0 * U;

/// A face whose normal has a smaller cosine than this to the contact normal counts as seen edge-on.
/// A touched face within the largest feature angle, 0.5 rad, has a cosine above 0.87. Any other
/// touched face has all its corners in the support set, to the accuracy asked of the bracket. If such
/// a face is this steep, its projection is narrower than the merge distance, and points lifted onto
/// its plane would be off by several times that distance.
pub(crate) const EDGE_ON: f64 = 0.5;

/// Cosines of face normals, and sines of edges, that differ by at most this multiple of `U` tie.
pub(crate) const TIE: f64 = 8.0;

/// The surplus, in cosines and in hull units, by which a feature must stand apart from the others to
/// be taken without a search. It is far above rounding. A feature that misses it costs a search.
pub(crate) const LONE: f64 = 1e-9;

/// Multiple of `U * R * |n|` below which a support point does not improve a portal, because it is within
/// the rounding of the two support values.
pub(crate) const GAIN: f64 = 4.0;

/// Multiple of `U` times the product of the lengths within which exact arithmetic decides the sign of a
/// triple product: 3 products and 5 sums, rounded up.
pub(crate) const TRIPLE_PRODUCT: f64 = 16.0;

/// Inverse square of the sine, 1/16, below which a triangle counts as thin: the products of its
/// normal then cancel 4 bits or more. It is a power of two, so that the comparison rounds nothing.
pub(crate) const THIN: f64 = 256.0;

/// Fraction of `R` at which the point of the GJK ray cast is so near to `K` that its direction is mostly
/// rounding (the squared distance of a closest point has the error `U R^2`). The ray cast then hands
/// its simplex to the portal.
pub(crate) const RAY_CAST_NEAR: f64 = 1.5e-8;

/// The first iterations of a portal, which count as improvements without a comparison: from a cold
/// start each one is an improvement.
pub(crate) const FIRST_STEPS: u32 = 8;

/// Iterations without improvement after which a loop gives up.
pub(crate) const STALL: u32 = 24;

/// Iterations after which the search for the distance between two hulls gives up.
pub(crate) const DISTANCE_ITERATIONS: u32 = 500;
