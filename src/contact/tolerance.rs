//! Every constant of the geometry, with its unit, formula and source.
//!
//! `R` is the sum of the circumradii about the contraction points, `r` of the
//! inradii, `M` the lengths that enter the centre offset `d`: the distance of
//! the hull frames' origins and of the contraction points from them. All three
//! are lengths. Nothing here is an absolute epsilon.

/// Unit roundoff of double precision.
pub(crate) const U: f64 = f64::EPSILON / 2.0;

/// Share of `U * M` by which `d` may be off, and of `U * R` by which a support
/// value may be: subtraction, two rotations of three products each, rounded up.
pub(crate) const NOISE: f64 = 16.0;

/// Share of `U * R / r` by which a bracket counted as closed may be open: twice
/// [`NOISE`] for its two ends, and as much again for solving.
pub(crate) const BRACKET: f64 = 64.0;

/// Share of `U * (alpha R + M) / r` by which the two ends of a bracket may differ
/// without their allowance for noise before wide arithmetic is tried: half of
/// what alpha may be off.
pub(crate) const COARSE: f64 = 8.0;

/// Centres closer than this share of `U * M` coincide: `d` itself is noise.
pub(crate) const COINCIDENT: f64 = 8.0;

/// Share of `U * R` within which a vertex belongs to the support set, and of
/// `U * (R + M)` within which points of the contact plane are one.
pub(crate) const MERGE: f64 = 64.0;

/// Sine of the turn from one projected side to the next above which it is certainly
/// to the left: 8 roundoffs of two directions and their product.
pub(crate) const TURN: f64 = 16.0 * U;

/// Share of `U * (R + |d|)` of the rounding band around the margin; the share
/// of `U * M` is [`NOISE`].
pub(crate) const BAND: f64 = 64.0;

/// Share of `U * (R + |c| + margin)` of one body by which its bounds are wider than it and
/// half the margin: its half of the rounding band around the margin, where `|d|` is at most
/// `R + margin` and `M` at most that and both `|c|` (144 and 48 shares of the pair's), and
/// the rounding of its own vertices, twice over.
pub(crate) const REACH: f64 = 512.0;

/// Of the certificate: below the normal doubles alpha is a multiple of 2^-1074, and so is
/// what it may be off: alpha, both ends of its bracket and what is shown of them are each
/// rounded once.
pub(crate) const SUBNORMAL: f64 = f64::from_bits(4);

/// Hull units: how far below another, along each of the directions through a cell's corners, a
/// vertex is not farther along any direction in the cell, however its height is rounded: 3
/// roundoffs of each of two heights along a direction no longer than `sqrt(3)`, and 4 of the
/// direction's place in the cell, rounded up.
pub(crate) const MAPPED: f64 = 64.0 * U;

/// Cosine of the angle of a face to the contact plane below which it counts as
/// seen edge-on. Within the largest feature angle, 0.5 rad, it is above 0.87; of
/// other faces that touch every corner supports, to what was asked of the bracket, and one
/// as steep is else narrower than the merge distance, by which its lifted points would be
/// off several times.
pub(crate) const EDGE_ON: f64 = 0.5;

/// Cosines of face normals, and sines of edges, within this share of `U` tie.
pub(crate) const TIE: f64 = 8.0;

/// Of cosines and of hull units: by how much more than it has to a face must
/// stand apart to be the only one looked at. Far above rounding; a face that
/// misses it costs a longer search.
pub(crate) const LONE: f64 = 1e-9;

/// Share of `U * R * |n|` below which a support point does not improve a portal:
/// what the rounding of the two support values leaves open.
pub(crate) const GAIN: f64 = 4.0;

/// Share of `U` times the product of the lengths within which the sign of a
/// triple product is left to exact arithmetic: 3 products and 5 sums, rounded up.
pub(crate) const TRIPLE_PRODUCT: f64 = 16.0;

/// Inverse square of the sine, 1/16, below which a triangle counts as thin: the products
/// of its normal cancel 4 bits and more. A power of two, so that comparing rounds nothing.
pub(crate) const THIN: f64 = 256.0;

/// Of `R`: where the GJK ray cast is so near to its hull that its direction is
/// mostly rounding (the error of a closest point squared, `U R^2`), it hands
/// its simplex to the pivot.
pub(crate) const RAY_CAST_NEAR: f64 = 1.5e-8;

/// Steps from nothing that are not compared with those before: each is better.
pub(crate) const FIRST_STEPS: u32 = 8;

/// Steps without improvement after which a loop gives up.
pub(crate) const STALL: u32 = 24;

/// Steps after which the distance between two hulls is given up.
pub(crate) const DISTANCE_ITERATIONS: u32 = 500;
