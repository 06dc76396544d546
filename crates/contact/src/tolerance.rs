//! Every tolerance of the geometry, grouped by step, with its unit, formula and source.
//!
//! Three lengths of a pair scale the tolerances. `R` is the sum of the circumradii about the
//! contraction points, and `r` the sum of the inradii. `M` is the sum of the lengths that enter the
//! centre offset `d`: the distance between the origins of the hulls' frames, and the distance of each
//! contraction point from its own origin. There are no absolute
//! tolerances. A length in hull units is a fraction of the circumradius, rounded up to a power of two.

// Shared by all steps.

/// Unit roundoff of double precision.
pub(crate) const U: f64 = f64::EPSILON / 2.0;

/// Rounding error, as a multiple of `U * M` in `d`, and of `U * R` in a support value. It
/// covers a subtraction and two rotations of three products each, rounded up.
pub(crate) const NOISE: f64 = 16.0;

/// Multiple of `U * R` below the highest vertex within which a vertex belongs to the support set, and
/// multiple of `U * (R + M)` within which points of the contact plane count as one.
pub(crate) const MERGE: f64 = 64.0;

/// Multiple of `U * (R + |d|)` in the rounding band around the margin. The multiple of `U * M` in it is
/// [`NOISE`].
pub(crate) const BAND: f64 = 64.0;

// Exact predicates and normals (`exact`).

/// Multiple of `U` times the product of the lengths within which exact arithmetic decides the sign of a
/// triple product: 3 products and 5 sums, rounded up.
pub(crate) const TRIPLE_PRODUCT: f64 = 16.0;

/// The sine of the angle between two sides above which their double-double cross product has a
/// relative error below 2^-58. (Its error is below 2^-98 of the product of the sides.)
pub(crate) const SLIVER_SINE: f64 = 1.0 / (1_u64 << 40) as f64;

/// If a determinant exceeds this fraction of the product of the lengths in it, its rounded value certainly
/// decides.
pub(crate) const SURELY_ROUNDED: f64 = 64.0 * U;

/// Error of a product of two double-double vectors of normalised length, as in the depth of a point below a
/// plane: each has a relative error below 2^-98, and there are three products.
pub(crate) const DOUBLE_DOUBLE_PRODUCT: f64 = 1.0 / (1_u128 << 96) as f64;

/// Relative error of a depth that is computed in double-double numbers and rounded: a length, a quotient and a
/// sum, rounded up to 8 roundoffs.
pub(crate) const DEPTH: f64 = 8.0 * U;

// Building a hull (`hull`).

/// Multiple of `U`, of the sums of the sizes of its products, in the rounding of a point's height above a
/// triangle of quickhull. Each term of `normal . (p - a)` has at most 8 roundings; a ninth covers the rounding
/// of this bound.
pub(crate) const HEIGHT_ABOVE: f64 = 9.0;

/// Factor that rounds a length up: its square has 3 products and 2 sums, and the root is rounded once.
pub(crate) const LENGTH_ABOVE: f64 = 1.0 + 8.0 * U;

/// Multiple of a distance, or in hull units, by which the height of a point above the plane of a triangle may be
/// off. The unit normal is accurate to 4 roundoffs, and the difference and the product add 4 more; rounded up.
pub(crate) const PLANE_HEIGHT: f64 = 16.0 * U;

/// The inradius must exceed this fraction of the circumradius. At this depth alpha is known to about
/// a thousandth only (its error is `64 u R/r`). At a tenth of this depth, the rounding of the
/// vertices would be as large as the tolerance that keeps faces apart, a fraction of the inradius.
pub(crate) const THINNEST: f64 = 65536.0 * U;

/// More than the rounding errors of two inradii; hull units.
pub(crate) const TWO_INRADII: f64 = 256.0 * U;

/// The tolerance of a face is at most this fraction of the inradius, however large the planarity is. So the
/// two sides of a thin plate, or a side and the rim, never become one face.
pub(crate) const PLANARITY_PER_INRADIUS: f64 = 1.0 / 64.0;

/// The tolerance of a face is at least this, in hull units. It covers the rounding of the vertices, which
/// remains if the planarity is 0 or the contraction point is very near a face.
pub(crate) const LEAST_PLANARITY: f64 = 64.0 * U;

/// If the heights of two vertices differ by less than this, their order is uncertain; hull units.
pub(crate) const PLATEAU: f64 = 64.0 * U;

/// Rounding of the difference of two heights, hull units: each is a dot product of vectors no longer than 1.
pub(crate) const HEIGHT_DIFFERENCE: f64 = 8.0 * U;

/// How far a corner may be from the corner of the ideal box: a fraction of the circumradius. The shape only
/// gives the solver its first directions, so no result depends on this value.
pub(crate) const BOX_CORNER: f64 = 1e-9;

/// The rounding error of a bound in single precision, as a fraction of its largest product. It covers
/// three axes, two sums of products for each axis, and the rounding of the factors.
pub(crate) const SINGLE_ROUNDING: f64 = 64.0 * (f32::EPSILON / 2.0) as f64;

/// Multiple of `U` and of the sizes of the products in the rounding of a mapped height in double precision:
/// the mapping of a point and the height have two rotations' roundings each ([`NOISE`]), rounded up.
pub(crate) const MAPPED_HEIGHT: f64 = 4.0 * NOISE;

// Support mapping and bounds (`support`, `bounds`).

/// For the support map, in hull units. If a vertex is at least this far below another one along each
/// direction through a cell's corners, it is not the farthest along any direction in the cell. The
/// value covers 3 roundoffs of each of two heights along a direction no longer than `sqrt(3)`, and 4
/// of the direction's place in the cell, rounded up.
pub(crate) const MAPPED: f64 = 64.0 * U;

/// Multiple of `U * (R + |c| + margin)` of one body by which its bounding box exceeds the body and half
/// the margin. It covers, at least twice over, the rounding of the body's vertices and its half of the
/// rounding band around the margin. Inside the band `|d|` is at most `R + margin`, and `M` is at most
/// `|d|` plus twice both `|c|`, so the band is at most `144 R + 80 margin + 32 |c|` times `U`.
pub(crate) const REACH: f64 = 512.0;

// Motion (`motion`).

/// Factor that rounds the bound of a motion up. A term has at most 13 roundings: 5 of a length, 5 of another
/// length, a sum, and two products. The sum of the terms has 2 more, and the factor itself one.
pub(crate) const MOTION_ABOVE: f64 = 1.0 + 16.0 * U;

// Step 1: growth scale (`growth`).

/// Multiple of `U * R / r` by which a bracket may be open and still count as closed. It is twice
/// [`NOISE`] for the two ends, doubled to leave room for the error of the solver.
pub(crate) const BRACKET: f64 = 64.0;

/// Multiple of `U * (alpha R + M) / r` by which the ends of a bracket may differ, their allowance for
/// noise left out, before weights by areas, and then wide arithmetic, are tried. It is half of the
/// permitted error of alpha.
pub(crate) const COARSE: f64 = 8.0;

/// Centres closer than this multiple of `U * M` coincide, because `d` is then only noise.
pub(crate) const COINCIDENT: f64 = 8.0;

/// Multiple of `U * R * |n|` below which a support point does not improve a portal, because it is within
/// the rounding of the two support values.
pub(crate) const GAIN: f64 = 4.0;

/// Inverse square of the sine, 1/16, below which a triangle counts as thin: the products of its
/// normal then cancel 4 bits or more. It is a power of two, so that the comparison rounds nothing.
pub(crate) const THIN: f64 = 256.0;

/// Fraction of `R` at which the point of the GJK ray cast is so near to `K` that its direction is mostly
/// rounding (the squared distance of a closest point has the error `U R^2`). The ray cast then hands
/// its simplex to the portal.
pub(crate) const RAY_CAST_NEAR: f64 = 1.5e-8;

/// Two axes of a pair of boxes count as one if their growth scales differ by less than this fraction. It only
/// chooses the start, so no answer depends on the value.
pub(crate) const SAME_AXIS: f64 = 1e-9;

// Pairs of boxes in lanes (`lanes`).

/// A hull takes part in lanes of boxes if each corner is within this multiple of `U * R` of its box's, with
/// `R` its own circumradius. The bracket allows for it, and is still inside the published budget.
pub(crate) const OFF_BOX: f64 = 8.0;

/// Lengths of a pair may differ by this factor at most, a power of two. Then products of four of them
/// neither overflow nor underflow.
pub(crate) const LANE_RANGE: f64 = f64::from_bits((1023 + 200) << 52);

/// Two axes tie if their growth scales differ by less than this fraction. It only chooses the direction for
/// which the bracket is proved.
pub(crate) const LANE_SAME_AXIS: f64 = 16.0 * U;

/// The cosine of the angle between two edges above which their cross product loses so many bits that it is
/// no axis. A pair whose axis it would be gets an open bracket, and goes to the portal.
pub(crate) const PARALLEL_EDGES: f64 = 1.0 - 5e-7;

/// Two faces are parallel to rounding if their normals, by the axes of either box, differ by at most this: the
/// rounding of both rotations and of their product. The octagon of their sides is then a facet of `K`.
pub(crate) const PARALLEL_FACES: f64 = 16.0 * U;

/// The bracket of a lane is closed if it is this narrow; see [`BRACKET`]. One unit less leaves room for the
/// rounding of the radii.
pub(crate) const LANE_BRACKET: f64 = BRACKET - 1.0;

/// Multiple of the merge distance by which a single contact point must be inside its features.
pub(crate) const LANE_INSIDE: f64 = 4.0;

/// Multiple of the merge distance by which each corner of two rectangles must be off the lines of the other
/// one's sides.
pub(crate) const LANE_CLEAR: f64 = 4096.0;

/// Two sides are nearly parallel if the sine of their angle is below this. The vertices of a crossing of
/// others, with sides longer than [`LANE_CLEAR`], turn by at least twice the merge distance.
pub(crate) const LANE_TURN: f64 = 1.0 / 1024.0;

// Step 1: iterations.

/// The first iterations of a portal, which count as improvements without a comparison: from a cold
/// start each one is an improvement.
pub(crate) const FIRST_STEPS: u32 = 8;

/// Iterations without improvement after which a loop gives up.
pub(crate) const STALL: u32 = 24;

// Step 2: features (`gauss_map`).

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

// Step 3: contact points (`intersection`).

/// A turn from one projected side to the next is certainly to the left if its sine exceeds this. The two
/// directions and their product have 8 roundoffs, and the value is rounded up.
pub(crate) const TURN: f64 = 16.0 * U;

/// A corner is sharp if the squared sum of its sides' unit inward directions is below this. At a right angle
/// it is 2, and the margin of a thousandth is far above rounding.
pub(crate) const SHARP: f64 = 1.999;

// Derivatives (`derivatives`).

/// Multiple of `U k^2 (R / h) (1 + M / (alpha R))` in the error of a derivative, where `h` is the height of the
/// facet's plane and `R / k` the least height of the basis' triangle. A corner has the error [`NOISE`] `U R`, and
/// a side twice that, which turns the plane and shifts the shares by `k` times as much; doubled for the products
/// of both.
pub(crate) const GRADIENT: f64 = 4.0 * NOISE;

// Distance (`distance`).

/// Iterations after which the search for the distance between two hulls gives up.
pub(crate) const DISTANCE_ITERATIONS: u32 = 500;

// Certificate (`certificate`).

/// For the certificate: below the normal doubles, alpha is a multiple of 2^-1074, and so is its error.
/// Alpha, both ends of its bracket, and the bound that is proved for it are each rounded once.
pub(crate) const SUBNORMAL: f64 = f64::from_bits(4);

/// How far the length of a normal may be from 1: 3 products, 2 sums, a root and a quotient, rounded up.
pub(crate) const UNIT_NORMAL: f64 = 8.0 * U;
