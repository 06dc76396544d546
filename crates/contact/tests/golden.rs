//! Golden cases: pairs with exact answers from rational arithmetic, computed by a program that
//! shares no code with the library (tests/golden/README.md).

use glam::{DMat3, DVec3};
use hullcast_contact::{
    Accuracy, Body, ConvexHull, HullOptions, Manifold, Outcome, Pose, Query, Solver, Workspace,
    contact_manifold,
};
use serde_json::Value;

/// One hull at its pose, and the numbers that made it.
struct PosedHull {
    hull: ConvexHull,
    pose: Pose,
    vertices: Vec<DVec3>,
    centre: DVec3,
    position: DVec3,
    rotation: DMat3,
}

impl PosedHull {
    fn read(value: &Value) -> Self {
        let vertices = points(&value["vertices"]);
        let centre = vector(&value["contraction_point"]);
        let position = vector(&value["position"]);
        let q: [f64; 4] = numbers(&value["rotation"]).try_into().expect("four numbers");
        let given: Vec<_> = vertices.iter().map(|v| v.to_array()).collect();
        let options = HullOptions { contraction_point: Some(centre.to_array()), ..HullOptions::default() };
        let hull = ConvexHull::with_options(&given, &options).expect("a hull");
        let pose = Pose::new(position.to_array(), q).expect("a pose");
        Self { hull, pose, vertices, centre, position, rotation: rotation(q) }
    }

    /// The largest `n . (v - p)` over the vertices; n is a world direction.
    fn support(&self, n: DVec3) -> f64 {
        let local = self.rotation.transpose() * n;
        self.vertices.iter().map(|v| local.dot(*v - self.centre)).fold(f64::NEG_INFINITY, f64::max)
    }
}

/// The rotation matrix by its definition, independent of the library's formula.
fn rotation([x, y, z, w]: [f64; 4]) -> DMat3 {
    let turn = DMat3::from_cols(DVec3::new(0.0, z, -y), DVec3::new(-z, 0.0, x), DVec3::new(y, -x, 0.0));
    let s = 2.0 / (x * x + y * y + z * z + w * w);
    DMat3::IDENTITY + (turn * w + turn * turn) * s
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(number).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn vector(value: &Value) -> DVec3 {
    DVec3::from_slice(&numbers(value))
}

fn points(value: &Value) -> Vec<DVec3> {
    value.as_array().expect("a list").iter().map(vector).collect()
}

fn cases() -> Vec<Value> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/contacts.json");
    let text = std::fs::read_to_string(path).expect("the golden cases");
    let file: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(file["format"], "hullcast.golden.v1");
    file["cases"].as_array().expect("cases").clone()
}

/// Both solvers must give the exact answer of every golden case: the outcome, a bracket that
/// contains the exact growth scale to the last bit, an optimal normal (several may be optimal), the
/// separation along that normal, and the patch. The cases include ties, extreme sizes, places far
/// from the origin, and pairs that growth distance by itself would wrongly report as contacts; the
/// file states the reason for each.
#[test]
fn answers_are_the_exact_ones() {
    let (mut contacts, mut patches) = (0, 0);
    for solver in Solver::ALL {
        for case in cases() {
            let name = format!("{} with {solver:?}", case["name"]);
            let (a, b) = (PosedHull::read(&case["a"]), PosedHull::read(&case["b"]));
            let margin = case["margin"].as_f64().unwrap_or(f64::INFINITY);
            let query =
                Query { margin, accuracy: Accuracy { solver, ..Accuracy::default() }, ..Query::default() };
            let mut workspace = Workspace::default();
            let answer = contact_manifold(
                &Body::new(&a.hull, a.pose),
                &Body::new(&b.hull, b.pose),
                &query,
                None,
                &mut workspace,
            );
            let expected = if case["outcome"] == "CONTACT" { Outcome::Contact } else { Outcome::Separated };
            assert_eq!(answer.outcome, expected, "{name}");
            assert!(answer.alpha_lower <= number(&case["alpha_below"]), "{name}: {answer:?}");
            assert!(answer.alpha_upper >= number(&case["alpha_above"]), "{name}: {answer:?}");
            if expected == Outcome::Contact {
                check_numbers(&name, &case, &a, &b, answer);
                contacts += 1;
            }
            if case["patch"].is_array() {
                check_patch(&name, &case, answer);
                patches += 1;
            }
        }
    }
    assert!(contacts >= 70 && patches >= 16, "{contacts} contacts, {patches} patches");
}

/// Alpha, the normal's optimality and the separation, within twice the budgets, because this side
/// of the comparison is rounded too.
fn check_numbers(name: &str, case: &Value, a: &PosedHull, b: &PosedHull, answer: &Manifold) {
    let budget = 2.0 * number(&case["alpha_budget"]);
    let exact = number(&case["alpha_below"]);
    assert!((answer.alpha - exact).abs() <= budget, "{name}: {answer:?}");
    let n = answer.normal;
    assert!((n.length() - 1.0).abs() <= 8.0 * f64::EPSILON, "{name}: {answer:?}");
    let d = b.position - a.position + b.rotation * b.centre - a.rotation * a.centre;
    let reach = a.support(n) + b.support(-n);
    assert!(exact - n.dot(d) / reach <= budget, "{name}: {answer:?}");
    let separation = n.dot(d) - reach;
    let lengths = 2.0 * number(&case["length_budget"]);
    assert!((answer.separation - separation).abs() <= lengths, "{name}: {answer:?}");
    assert!(!answer.points.is_empty(), "{name}");
}

/// The witnesses on A and the exact intersection are the same polygon: the corners of each lie on
/// the other.
fn check_patch(name: &str, case: &Value, answer: &Manifold) {
    let exact = points(&case["patch"]);
    let found: Vec<_> = answer.points.iter().map(|p| p.witness_a).collect();
    let budget = number(&case["patch_budget"]);
    assert!(!answer.flags.estimated && found.len() >= 3, "{name}: {answer:?}");
    for (from, to) in [(&found, &exact), (&exact, &found)] {
        for p in from {
            let distance = distance_to_polygon(*p, to);
            assert!(distance <= budget, "{name}: {p} is {distance:e} from {to:?}");
        }
    }
}

/// The distance from a point to a convex polygon in space.
fn distance_to_polygon(p: DVec3, corners: &[DVec3]) -> f64 {
    let sides = || (0..corners.len()).map(|i| (corners[i], corners[(i + 1) % corners.len()]));
    let normal: DVec3 = sides().map(|(s, e)| (s - corners[0]).cross(e - corners[0])).sum();
    if sides().all(|(s, e)| normal.cross(e - s).dot(p - s) >= 0.0) {
        return (p - corners[0]).dot(normal.normalize()).abs();
    }
    let to_side = |(s, e): (DVec3, DVec3)| {
        let along = e - s;
        let t = ((p - s).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        p.distance(s + along * t)
    };
    sides().map(to_side).fold(f64::INFINITY, f64::min)
}
