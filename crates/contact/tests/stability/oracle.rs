//! The exact answers for the given floats: growth scale, separation along a direction, distance.
//!
//! A quaternion `q` gives the rational rotation `I + 2 / |q|^2 (...)`. Multiplied by both squared
//! norms, the centre offset and every vertex of the Minkowski difference are therefore integers
//! times one power of two. They all have the same unit, which cancels in ratios.

use hullcast_contact::ConvexHull;
use num_bigint::BigInt;

use super::exact::*;

/// The points of a hull as they were registered, the hull, and its pose.
#[derive(Clone, Copy)]
pub(crate) struct Placed<'a> {
    pub(crate) points: &'a [[f64; 3]],
    pub(crate) hull: &'a ConvexHull,
    pub(crate) position: [f64; 3],
    pub(crate) rotation: [f64; 4],
}

/// A pair in integers: `length = integer * 2^exponent / unit`.
pub(crate) struct Exact {
    /// Vertices about the contraction points, along the world axes.
    vertices: [Vec<V>; 2],
    floats: [Vec<[f64; 3]>; 2],
    /// From each frame's origin to its contraction point.
    centres: [V; 2],
    /// The offset from A's contraction point to B's.
    pub(crate) d: V,
    unit: BigInt,
    exponent: i32,
    /// A length below the pair's inradius.
    inner: BigInt,
}

/// A vertex of `K`: the indices, as registered, of A's vertex and of B's.
pub(crate) type Corner = [usize; 2];

/// The growth scale, `num / den`.
pub(crate) struct Growth {
    pub(crate) num: BigInt,
    pub(crate) den: BigInt,
    /// The weights of the optimal basis, times `den`.
    pub(crate) weights: [BigInt; 3],
    /// The number of pivots from the given start.
    pub(crate) pivots: usize,
}

impl Growth {
    /// The growth scale, rounded to about one ulp.
    pub(crate) fn value(&self) -> f64 {
        quotient(&self.num, &self.den, 0)
    }

    /// `x` minus the growth scale, rounded to about one ulp.
    pub(crate) fn error_of(&self, x: f64) -> f64 {
        let Some((m, e)) = parts(x) else { return -self.value() };
        let (num, m) =
            if e < 0 { (&self.num << (-e) as usize, m) } else { (self.num.clone(), m << e as usize) };
        quotient(&(m * &self.den - num), &self.den, i64::from(e.min(0)))
    }
}

impl Exact {
    pub(crate) fn new([a, b]: [Placed<'_>; 2]) -> Self {
        let centres = [a, b].map(|p| p.hull.contraction_point().to_array());
        let points = [a, b].into_iter().flat_map(|p| p.points.iter().flatten().copied());
        let others = [a.position, b.position, centres[0], centres[1]].into_iter().flatten();
        // A power of two between a quarter and a half of the inradius.
        let inner =
            f64::from_bits((0.5 * (a.hull.inradius() + b.hull.inradius())).to_bits() & !((1 << 52) - 1));
        let exponent = common_exponent(points.chain(others).chain([inner]));
        let [(rows_a, norm_a), (rows_b, norm_b)] = [a, b].map(|p| rotation(p.rotation));
        let (rows_a, rows_b) = (rows_a.map(|r| times(&r, &norm_b)), rows_b.map(|r| times(&r, &norm_a)));
        let unit = &norm_a * &norm_b;
        let rotated = |rows: &[V; 3], v: &V| [dot(&rows[0], v), dot(&rows[1], v), dot(&rows[2], v)];
        let about = |p: Placed<'_>, rows: &[V; 3], centre: [f64; 3]| -> Vec<V> {
            let centre = vector(centre, exponent);
            p.points.iter().map(|&v| rotated(rows, &minus(&vector(v, exponent), &centre))).collect()
        };
        let vertices = [about(a, &rows_a, centres[0]), about(b, &rows_b, centres[1])];
        let [ca, cb] =
            [(&rows_a, centres[0]), (&rows_b, centres[1])].map(|(r, c)| rotated(r, &vector(c, exponent)));
        let t = minus(&vector(b.position, exponent), &vector(a.position, exponent));
        let d = plus(&times(&t, &unit), &minus(&cb, &ca));
        Self {
            floats: [unit_floats(&vertices[0]), unit_floats(&vertices[1])],
            vertices,
            centres: [ca, cb],
            d,
            inner: &unit * integer(inner, exponent),
            unit,
            exponent,
        }
    }

    fn corner(&self, [a, b]: Corner) -> V {
        minus(&self.vertices[0][a], &self.vertices[1][b])
    }

    /// The vertex of `K` farthest along `n`.
    pub(crate) fn support(&self, n: &V) -> Corner {
        let back = [-&n[0], -&n[1], -&n[2]];
        [self.highest(0, n), self.highest(1, &back)]
    }

    /// The vertex that is highest along `n`. Vertices whose heights floats cannot tell apart are
    /// compared exactly.
    fn highest(&self, side: usize, n: &V) -> usize {
        let [nx, ny, nz] = unit_floats(std::slice::from_ref(n))[0];
        let heights = self.floats[side].iter().map(|v| nx * v[0] + ny * v[1] + nz * v[2]);
        let heights: Vec<f64> = heights.collect();
        let top = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut near = (0..heights.len()).filter(|&i| heights[i] >= top - 1e-13);
        let first = near.next().expect("a vertex");
        let mut best: (usize, Option<BigInt>) = (first, None);
        for i in near {
            let height = |i: usize| dot(n, &self.vertices[side][i]);
            let old = best.1.take().unwrap_or_else(|| height(best.0));
            let new = height(i);
            best = if new > old { (i, Some(new)) } else { (best.0, Some(old)) };
        }
        best.0
    }

    /// `n.d` and `h_K(n)` for any direction, in one unit.
    fn along(&self, n: [f64; 3]) -> (BigInt, BigInt, i32) {
        let e = common_exponent(n);
        let n = vector(n, e);
        let top = self.corner(self.support(&n));
        (dot(&n, &self.d), dot(&n, &top), e)
    }

    /// Signed separation along `n`.
    pub(crate) fn separation(&self, n: [f64; 3]) -> f64 {
        let (ahead, reach, e) = self.along(n);
        quotient(&(ahead - reach), &self.unit, i64::from(e + self.exponent))
    }

    /// The exact growth scale minus the lower bound that `n` proves.
    pub(crate) fn optimality_gap(&self, n: [f64; 3], growth: &Growth) -> f64 {
        let (ahead, reach, _) = self.along(n);
        quotient(&(&growth.num * &reach - ahead * &growth.den), &(&growth.den * &reach), 0)
    }

    /// The exact growth scale by the simplex method. If the warm basis is already optimal, this
    /// costs one evaluation of every vertex.
    pub(crate) fn growth(&self, warm: Option<[Corner; 3]>) -> Growth {
        let warm = warm.map(|basis| basis.map(|c| self.corner(c)));
        if let Some(Step::Optimal(growth)) =
            warm.and_then(|basis| Some(Tableau::new(basis, &self.d)?.improved(self)))
        {
            return growth;
        }
        // The three axes towards d, scaled to lie inside K: they are feasible, and never optimal.
        let axis = |k: usize| -> V {
            let reach = if negative(&self.d[k]) { -&self.inner } else { self.inner.clone() };
            std::array::from_fn(|i| if i == k { reach.clone() } else { BigInt::ZERO })
        };
        let mut basis = [axis(0), axis(1), axis(2)];
        for pivots in 1.. {
            let tableau = Tableau::new(basis.clone(), &self.d).expect("a feasible basis");
            match tableau.improved(self) {
                Step::Exchange(leaving, entering) => basis[leaving] = entering,
                Step::Optimal(growth) => return Growth { pivots, ..growth },
            }
        }
        unreachable!("the simplex method is finite")
    }

    /// The gradient of the growth scale while this basis is optimal: by a translation of B, a rotation of A
    /// and a rotation of B about its frame's origin. Each number is rounded to about one ulp.
    pub(crate) fn gradient(&self, basis: [Corner; 3]) -> [f64; 9] {
        let [u0, u1, u2] = basis.map(|c| self.corner(c));
        let duals = [cross(&u1, &u2), cross(&u2, &u0), cross(&u0, &u1)];
        let (n, volume) = (plus(&plus(&duals[0], &duals[1]), &duals[2]), dot(&u0, &duals[0]));
        let weights = duals.each_ref().map(|c| dot(c, &self.d));
        let whole = &volume * &volume;
        let mut gradient = [0.0; 9];
        for k in 0..3 {
            gradient[k] = quotient(&(&n[k] * &self.unit), &volume, -i64::from(self.exponent));
        }
        for side in 0..2 {
            let mut lever = times(&self.centres[side], &volume);
            for (corner, weight) in basis.iter().zip(&weights) {
                lever = plus(&lever, &times(&self.vertices[side][corner[side]], weight));
            }
            let moment = if side == 0 { cross(&n, &lever) } else { cross(&lever, &n) };
            for k in 0..3 {
                gradient[3 + 3 * side + k] = quotient(&moment[k], &whole, 0);
            }
        }
        gradient
    }

    /// The exact squared distance of the hulls, `num / den` in squared units, by GJK from any
    /// vertex of `K`.
    pub(crate) fn distance_squared(&self, start: Corner) -> Distance<'_> {
        let from_d = |c: Corner| minus(&self.corner(c), &self.d);
        let mut simplex = vec![from_d(start)];
        loop {
            let Some(nearest) = Nearest::of(&simplex) else {
                let nowhere = [BigInt::ZERO, BigInt::ZERO, BigInt::ZERO];
                return Distance { pair: self, point: nowhere, num: BigInt::ZERO, den: BigInt::from(1) };
            };
            let square = dot(&nearest.point, &nearest.point);
            let towards = nearest.point.each_ref().map(|x| -x);
            let w = from_d(self.support(&towards));
            // No vertex is nearer along this direction: w.p >= p.p / den.
            if zero(&square) || dot(&w, &nearest.point) * &nearest.den >= square {
                let den = &nearest.den * &nearest.den;
                return Distance { pair: self, point: nearest.point, num: square, den };
            }
            simplex = nearest.kept.iter().map(|&i| simplex[i].clone()).collect();
            simplex.push(w);
        }
    }
}

/// `|q|^2` times the rotation matrix, and `|q|^2`, in one unit.
fn rotation(q: [f64; 4]) -> ([V; 3], BigInt) {
    let e = common_exponent(q);
    let [x, y, z, w] = q.map(|c| integer(c, e));
    let norm = &x * &x + &y * &y + &z * &z + &w * &w;
    let two = |v: BigInt| v << 1usize;
    let rows = [
        [&norm - two(&y * &y + &z * &z), two(&x * &y - &w * &z), two(&x * &z + &w * &y)],
        [two(&x * &y + &w * &z), &norm - two(&x * &x + &z * &z), two(&y * &z - &w * &x)],
        [two(&x * &z - &w * &y), two(&y * &z + &w * &x), &norm - two(&x * &x + &y * &y)],
    ];
    (rows, norm)
}

/// A feasible basis of `min sum l_i : sum l_i u_i = d`, `u_i` in `K`.
struct Tableau {
    /// `duals[i] . v / volume` is the weight of `u_i` in `v`.
    duals: [V; 3],
    volume: BigInt,
    /// The weights of `d`, times the volume.
    weights: [BigInt; 3],
}

/// One step of the simplex method.
enum Step {
    /// The index of the basis vertex that leaves, and the vertex that enters.
    Exchange(usize, V),
    Optimal(Growth),
}

impl Tableau {
    fn new(basis: [V; 3], d: &V) -> Option<Self> {
        let [u0, u1, u2] = &basis;
        let mut duals = [cross(u1, u2), cross(u2, u0), cross(u0, u1)];
        let mut volume = dot(u0, &duals[0]);
        if negative(&volume) {
            volume = -volume;
            duals = duals.map(|c| c.map(|x| -x));
        }
        let weights = duals.each_ref().map(|c| dot(c, d));
        let feasible = positive(&volume) && !weights.iter().any(negative);
        feasible.then_some(Self { duals, volume, weights })
    }

    /// The exchange that improves the basis, or the optimum. The ray is treated as if it were moved
    /// by `(e, e^2, e^3)` for an infinitely small `e`; this symbolic perturbation settles every
    /// tie, so the method ends.
    fn improved(&self, pair: &Exact) -> Step {
        let n = plus(&plus(&self.duals[0], &self.duals[1]), &self.duals[2]);
        let w = pair.corner(pair.support(&n));
        if dot(&n, &w) <= self.volume {
            let num = &self.weights[0] + &self.weights[1] + &self.weights[2];
            return Step::Optimal(Growth {
                num,
                den: self.volume.clone(),
                weights: self.weights.clone(),
                pivots: 0,
            });
        }
        let rates = self.duals.each_ref().map(|c| dot(c, &w));
        let shorter = |&i: &usize, &j: &usize| {
            let rows =
                [i, j].map(|i| [&self.weights[i], &self.duals[i][0], &self.duals[i][1], &self.duals[i][2]]);
            let terms = (0..4).map(|k| (rows[0][k] * &rates[j]).cmp(&(rows[1][k] * &rates[i])));
            terms.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
        };
        let leaving = (0..3).filter(|&i| positive(&rates[i])).min_by(shorter);
        Step::Exchange(leaving.expect("K is bounded"), w)
    }
}

/// The point of a simplex nearest to the origin, `point / den`.
struct Nearest {
    point: V,
    den: BigInt,
    kept: Vec<usize>,
}

impl Nearest {
    /// None if the origin is inside all four points. A face's nearest point is the simplex's
    /// nearest point if no other corner is nearer along its direction.
    fn of(simplex: &[V]) -> Option<Self> {
        let len = simplex.len();
        let mut subsets: Vec<u32> = (1..1 << len).filter(|s: &u32| s.count_ones() <= 3).collect();
        subsets.sort_by_key(|s| s.count_ones());
        subsets.into_iter().find_map(|set| {
            let kept: Vec<usize> = (0..len).filter(|i| set >> i & 1 == 1).collect();
            let corners: Vec<&V> = kept.iter().map(|&i| &simplex[i]).collect();
            let (point, den) = foot(&corners)?;
            let square = dot(&point, &point);
            let optimal = simplex.iter().all(|v| dot(v, &point) * &den >= square);
            optimal.then_some(Self { point, den, kept })
        })
    }
}

/// The foot of the perpendicular from the origin to a point, a line or a plane, if it is inside.
fn foot(corners: &[&V]) -> Option<(V, BigInt)> {
    match corners {
        [p] => Some(((*p).clone(), BigInt::from(1))),
        [p, q] => {
            let e = minus(q, p);
            let (den, share) = (dot(&e, &e), -dot(p, &e));
            let inside = positive(&den) && !negative(&share) && share <= den;
            inside.then(|| (plus(&times(p, &den), &times(&e, &share)), den))
        }
        [p, q, r] => {
            let n = cross(&minus(q, p), &minus(r, p));
            let den = dot(&n, &n);
            let inside = |u: &V, v: &V| !negative(&dot(&n, &cross(u, v)));
            let holds = positive(&den) && inside(p, q) && inside(q, r) && inside(r, p);
            holds.then(|| (times(&n, &dot(&n, p)), den))
        }
        _ => None,
    }
}

/// The distance of the hulls: its square is `num / den`, in the pair's integers.
pub(crate) struct Distance<'a> {
    pair: &'a Exact,
    /// A vector from B's nearest point to A's; its length is arbitrary.
    point: V,
    num: BigInt,
    den: BigInt,
}

impl Distance<'_> {
    /// The unit direction from A to B, or `None` if the hulls meet.
    pub(crate) fn direction(&self) -> Option<[f64; 3]> {
        let [x, y, z] = unit_floats(std::slice::from_ref(&self.point))[0];
        let length = (x * x + y * y + z * z).sqrt();
        positive(&self.num).then(|| [-x / length, -y / length, -z / length])
    }

    /// The distance in the caller's units, rounded to about one ulp.
    pub(crate) fn value(&self) -> f64 {
        let unit = &self.pair.unit * &self.pair.unit;
        let (top, e) = approximate(&self.num);
        let (bottom, f) = approximate(&(&self.den * unit));
        let (ratio, e) = (top / bottom, e - f);
        // The square root needs an even exponent.
        let (ratio, e) = if e % 2 == 0 { (ratio, e) } else { (2.0 * ratio, e - 1) };
        scale(ratio.sqrt(), e / 2 + i64::from(self.pair.exponent))
    }

    /// The distance minus `x >= 0`; the rounding is about one ulp of the difference.
    pub(crate) fn beyond(&self, x: f64) -> f64 {
        let Some((m, e)) = parts(x) else { return self.value() };
        // In the pair's integers, x is m * unit * 2^by.
        let by = e - self.pair.exponent;
        let (num, den, m) = (&self.num, &self.den, m * &self.pair.unit);
        let square = &m * &m * den;
        let (difference, shift) = if by >= 0 {
            (num - (square << (2 * by) as usize), 0)
        } else {
            ((num << (-2 * by) as usize) - square, 2 * by)
        };
        let unit = &self.pair.unit * &self.pair.unit;
        // The exponents are applied last: for a pair with a subnormal coordinate, the square of the
        // distance in the pair's unit is beyond the range of floats.
        let ((top, e), (bottom, f)) = (approximate(&difference), approximate(&(den * unit)));
        scale(top / bottom / (self.value() + x), e - f + i64::from(shift) + 2 * i64::from(self.pair.exponent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: [[f64; 3]; 8] = [
        [-1.0, -1.0, -1.0],
        [1.0, -1.0, -1.0],
        [-1.0, 1.0, -1.0],
        [1.0, 1.0, -1.0],
        [-1.0, -1.0, 1.0],
        [1.0, -1.0, 1.0],
        [-1.0, 1.0, 1.0],
        [1.0, 1.0, 1.0],
    ];

    fn cubes(position: [f64; 3], rotation: [f64; 4], test: impl FnOnce(&Exact)) {
        let hull = ConvexHull::new(&CUBE).expect("a cube");
        let place = |position, rotation| Placed { points: &CUBE, hull: &hull, position, rotation };
        test(&Exact::new([place([0.0; 3], [0.0, 0.0, 0.0, 1.0]), place(position, rotation)]));
    }

    /// Two cubes of half extent 1 at a given offset. Alpha is half the largest component of the
    /// offset; the distance is the length of the components' excess over 2. Catches a wrong
    /// exponent, sign or tie in the oracle, which would accept wrong answers.
    #[test]
    fn cubes_are_known_by_hand() {
        for (d, alpha, distance) in [
            ([3.0, 0.0, 0.0], 1.5, 1.0),
            ([3.0, 3.0, 3.0], 1.5, 3f64.sqrt()),
            ([0.5, -1.0, 0.25], 0.5, 0.0),
            ([0.0, 3.0, -4.0], 2.0, 5f64.sqrt()),
            ([2.0, 0.0, 0.0], 1.0, 0.0),
        ] {
            // A quaternion of length 2, so that the oracle's unit is not 1.
            cubes(d, [0.0, 0.0, 0.0, 2.0], |exact| {
                let growth = exact.growth(None);
                assert_eq!(growth.value(), alpha);
                assert_eq!(growth.error_of(alpha), 0.0);
                assert_eq!(growth.error_of(alpha + 0.25), 0.25);
                let found = exact.distance_squared([0, 0]);
                assert!((found.value() - distance).abs() <= 1e-15 * distance);
                assert!((found.beyond(0.5) - (distance - 0.5)).abs() <= 1e-15);
                let n = [0.0, 2.0, 0.0];
                assert_eq!(exact.separation(n), 2.0 * (d[1] - 2.0));
            });
        }
    }

    /// A cube turned by 45 degrees about z, so that an edge points along x: its reach is 1 +
    /// sqrt(2). Catches a transposed rotation.
    #[test]
    fn a_turned_cube_is_known_by_hand() {
        let (s, c) = std::f64::consts::FRAC_PI_8.sin_cos();
        cubes([2.5, 0.3, 0.2], [0.0, 0.0, s, c], |exact| {
            let reach = 1.0 + 2f64.sqrt();
            assert!((exact.growth(None).value() - 2.5 / reach).abs() < 1e-15);
            assert!((exact.distance_squared([3, 5]).value() - (2.5 - reach)).abs() < 1e-15);
        });
    }

    /// The exact simplex method finds the same growth scale with and without a warm basis. Catches
    /// an optimality test that accepts a basis which is not optimal.
    #[test]
    fn starts_do_not_matter() {
        cubes([0.3, 0.2, 1.7], [0.1, 0.2, 0.3, 0.9], |exact| {
            let cold = exact.growth(None);
            for start in [[[0, 0], [1, 1], [2, 2]], [[4, 1], [5, 2], [6, 3]]] {
                let warm = exact.growth(Some(start));
                assert_eq!(&cold.num * &warm.den, &warm.num * &cold.den);
            }
            assert!(cold.pivots > 1);
        });
    }
}
