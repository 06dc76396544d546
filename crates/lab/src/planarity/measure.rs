//! Patches, faces and times for every shape, rounding and planarity.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use glam::{DQuat, DVec3};
use hullcast_contact::workload::Random;
use hullcast_contact::{
    Body, ConvexHull, HullOptions, Manifold, Outcome, Pose, Query, Workspace, contact_manifold,
};

use super::shapes::{ROUNDINGS, Rounding, ShapeGroup};
use crate::progress;

pub(super) const PLANARITIES: [f64; 11] = [1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 7e-4, 1e-3, 2e-3, 5e-3, 1e-2];

/// How deep a shape is sunk into the floor, and the margin for contact points. Both are fractions of the
/// circumradius.
const DEPTH: f64 = 1e-3;
const MARGIN: f64 = 1e-2;
/// Two faces at an angle larger than this, the default feature angle, count as different features for contacts.
const FEATURE_ANGLE: f64 = 1e-2;
/// The number of orientations of each shape in which times are measured.
const TIMED: usize = 20;
/// A patch is whole if its area is within this fraction of the unrounded shape's area.
const WHOLE: f64 = 0.01;

/// The figures of one group, rounding and planarity; most are sums over shapes and orientations.
#[derive(Clone, Debug)]
pub(super) struct PlanarityFigures {
    pub(super) group: String,
    pub(super) rounding: Rounding,
    pub(super) planarity: f64,
    pub(super) cases: usize,
    /// The sum of the areas, each divided by the unrounded shape's.
    pub(super) area: f64,
    pub(super) least_area: f64,
    pub(super) whole: usize,
    /// The largest relative difference of alpha from its value at the first planarity.
    pub(super) alpha: f64,
    /// The largest `geometric_error`, divided by the circumradius.
    pub(super) error: f64,
    /// The number of edges sharper than the feature angle, here and in the unrounded shape at the first planarity.
    pub(super) edges: usize,
    pub(super) all_edges: usize,
    /// Nanoseconds, summed over the timed cases.
    pub(super) building: f64,
    pub(super) answering: f64,
}

/// A shape in the pose in which it stands on a face.
struct Standing<'a> {
    hull: &'a ConvexHull,
    pose: Pose,
}

/// The unrounded shape, and its pose when it stands on its largest face.
struct Reference {
    hull: ConvexHull,
    /// The rotation that turns the face downwards.
    upright: DQuat,
    height: f64,
    edges: usize,
}

impl Reference {
    fn new(points: &[[f64; 3]]) -> Self {
        let hull = hull(points, PLANARITIES[0]);
        let faces = hull.faces();
        let largest = (0..faces.len()).max_by(|&f, &g| faces[f].area.total_cmp(&faces[g].area));
        let down = faces[largest.unwrap_or(0)].normal;
        let upright = DQuat::from_rotation_arc(down, DVec3::NEG_Z);
        let lowest = points.iter().map(|&p| (upright * DVec3::from_array(p)).z).fold(f64::INFINITY, f64::min);
        let height = -lowest - DEPTH * hull.circumradius();
        let edges = sharp_edges(&hull);
        Self { hull, upright, height, edges }
    }
}

fn hull(points: &[[f64; 3]], planarity: f64) -> ConvexHull {
    let options = HullOptions { planarity: Some(planarity), ..HullOptions::default() };
    ConvexHull::with_options(points, &options).expect("a hull")
}

fn sharp_edges(hull: &ConvexHull) -> usize {
    let sharp = |&&[f, g]: &&[u32; 2]| {
        let [m, n] = [f, g].map(|face| hull.faces()[face as usize].normal);
        m.cross(n).length() > FEATURE_ANGLE.sin() || m.dot(n) < 0.0
    };
    hull.edge_faces().iter().filter(sharp).count()
}

/// The area of the patch, projected along the normal; 0 if there is no contact.
fn area(manifold: &Manifold) -> f64 {
    if manifold.outcome != Outcome::Contact || manifold.points.len() < 3 {
        return 0.0;
    }
    let first = manifold.points[0].witness_a;
    let fan = manifold.points.windows(2);
    let sum: DVec3 = fan.map(|w| (w[0].witness_a - first).cross(w[1].witness_a - first)).sum();
    0.5 * sum.dot(manifold.normal).abs()
}

/// All figures, with the planarities of one rounding next to each other.
pub(super) fn figures(groups: &[ShapeGroup], orientations: usize) -> Vec<PlanarityFigures> {
    let rows: Vec<_> = groups.iter().flat_map(|group| ROUNDINGS.map(|rounding| (group, rounding))).collect();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let progress = progress::bar("groups of shapes and roundings", rows.len());
    let work = || {
        let mut done = Vec::new();
        while let Some(&(group, rounding)) = rows.get(next.fetch_add(1, Ordering::Relaxed)) {
            done.push(row(group, rounding, orientations.div_ceil(group.thinned)));
            progress.inc(1);
        }
        done
    };
    let mut done: Vec<Vec<PlanarityFigures>> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        handles.into_iter().flat_map(|handle| handle.join().expect("rows")).collect()
    });
    let place = |figures: &Vec<PlanarityFigures>| {
        rows.iter().position(|(group, rounding)| {
            (&group.name, *rounding) == (&figures[0].group, figures[0].rounding)
        })
    };
    done.sort_by_key(place);
    done.concat()
}

/// The figures of one group and rounding, one per planarity.
fn row(group: &ShapeGroup, rounding: Rounding, orientations: usize) -> Vec<PlanarityFigures> {
    let mut row = PLANARITIES.map(|planarity| PlanarityFigures::new(&group.name, rounding, planarity));
    for (seed, points) in group.shapes.iter().enumerate() {
        let reference = Reference::new(points);
        let mut random = Random::new(seed as u64);
        for i in 0..orientations {
            measure(points, &reference, random.rotation(), i < TIMED, &mut row);
        }
    }
    row.into()
}

/// Measures one orientation of a shape with every planarity, and adds the figures to the row.
fn measure(
    points: &[[f64; 3]],
    reference: &Reference,
    turned: DQuat,
    timed: bool,
    row: &mut [PlanarityFigures],
) {
    let floor = floor(8.0 * reference.hull.circumradius());
    let mut workspace = Workspace::default();
    let rounding = row[0].rounding;
    let written: Vec<[f64; 3]> =
        points.iter().map(|&p| (turned * DVec3::from_array(p)).to_array().map(|x| rounding.of(x))).collect();
    let standing = |rotation: DQuat| {
        Pose::new([0.0, 0.0, reference.height], rotation.normalize().to_array()).expect("a pose")
    };
    let origin = Pose::new([0.0; 3], [0.0, 0.0, 0.0, 1.0]).expect("a pose");
    let query = Query { margin: MARGIN * reference.hull.circumradius(), ..Query::default() };
    let mut ask = |shape: &Standing<'_>| {
        let [below, above] = [Body::new(&floor, origin), Body::new(shape.hull, shape.pose)];
        let manifold = contact_manifold(&below, &above, &query, None, &mut workspace);
        (area(manifold), manifold.alpha)
    };
    let (true_area, _) = ask(&Standing { hull: &reference.hull, pose: standing(reference.upright) });
    let mut first_alpha = None;
    for figures in row {
        let hull = hull(&written, figures.planarity);
        let shape = Standing { hull: &hull, pose: standing(reference.upright * turned.conjugate()) };
        let (area, alpha) = ask(&shape);
        if timed {
            figures.building += fastest(|| self::hull(&written, figures.planarity));
            figures.answering += fastest(|| ask(&shape));
        }
        let share = area / true_area;
        figures.cases += 1;
        figures.area += share;
        figures.least_area = figures.least_area.min(share);
        figures.whole += usize::from((share - 1.0).abs() <= WHOLE);
        let expected = *first_alpha.get_or_insert(alpha);
        figures.alpha = figures.alpha.max((alpha / expected - 1.0).abs());
        figures.error = figures.error.max(hull.geometric_error() / hull.circumradius());
        figures.edges += sharp_edges(&hull).min(reference.edges);
        figures.all_edges += reference.edges;
    }
}

/// The duration of the fastest of three runs, in nanoseconds.
fn fastest<T>(mut run: impl FnMut() -> T) -> f64 {
    let mut once = || {
        let start = Instant::now();
        std::hint::black_box(run());
        start.elapsed().as_nanos() as f64
    };
    once().min(once()).min(once())
}

/// A slab whose top is the plane z = 0.
fn floor(half: f64) -> ConvexHull {
    let corner = |i: usize| {
        let sign = |k: usize| if i >> k & 1 == 0 { -half } else { half };
        [sign(0), sign(1), if i >> 2 & 1 == 0 { -0.1 * half } else { 0.0 }]
    };
    ConvexHull::new(&(0..8).map(corner).collect::<Vec<_>>()).expect("a slab")
}

impl PlanarityFigures {
    fn new(group: &str, rounding: Rounding, planarity: f64) -> Self {
        Self {
            group: group.to_owned(),
            rounding,
            planarity,
            cases: 0,
            area: 0.0,
            least_area: f64::INFINITY,
            whole: 0,
            alpha: 0.0,
            error: 0.0,
            edges: 0,
            all_edges: 0,
            building: 0.0,
            answering: 0.0,
        }
    }

    /// The mean over the cases of a sum.
    pub(super) fn mean(&self, sum: f64) -> f64 {
        sum / self.cases as f64
    }
}
