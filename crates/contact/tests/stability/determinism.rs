//! Equal pairs give equal bits: in any order, on any number of threads, from a new workspace or a
//! used one. (`make stability` compares the digest of a debug build with that of a release build;
//! the service's tests compare its answers, however the batch is split, with the library's bits.)

use hullcast_contact::{Body, Element, Manifold, Pose, Query, Solver, Workspace, contact_manifold};

use crate::case::{Shape, any_shape};
use crate::scene::Random;

/// A pair of the sweep: the indices of its shapes, the offset, the rotations.
type Pair = ([usize; 2], [f64; 3], [[f64; 4]; 2]);

fn sweep(pairs: usize) -> (Vec<Shape>, Vec<Pair>) {
    let random = &mut Random::new(11);
    let shapes: Vec<Shape> =
        (0..40).map(|_| std::rc::Rc::into_inner(any_shape(random)).expect("one owner")).collect();
    let pair = |random: &mut Random| {
        let which = [random.below(shapes.len()), random.below(shapes.len())];
        let length = random.range(0.0, 2.5);
        let d = random.direction().map(|x| x * length);
        (which, d, [random.rotation(), random.rotation()])
    };
    let pairs = (0..pairs).map(|_| pair(random)).collect();
    (shapes, pairs)
}

fn answer(shapes: &[Shape], (which, d, rotations): &Pair, query: &Query, workspace: &mut Workspace) -> u64 {
    let pose = |p, q| Pose::new(p, q).expect("a pose");
    let [a, b] = which.map(|i| &shapes[i].hull);
    let (a, b) = (Body::new(a, pose([0.0; 3], rotations[0])), Body::new(b, pose(*d, rotations[1])));
    digest(contact_manifold(&a, &b, query, None, workspace))
}

/// The FNV-1a hash of all numbers of an answer.
fn digest(m: &Manifold) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut add = |x: u64| {
        x.to_le_bytes().iter().for_each(|&b| hash = (hash ^ u64::from(b)).wrapping_mul(0x100_0000_01b3))
    };
    let numbers = [m.alpha, m.alpha_lower, m.alpha_upper, m.separation, m.normal.x, m.normal.y, m.normal.z];
    numbers.iter().for_each(|x| add(x.to_bits()));
    add(m.outcome as u64);
    for p in &m.points {
        [p.witness_a.x, p.witness_a.y, p.witness_a.z, p.distance].iter().for_each(|x| add(x.to_bits()));
        for id in p.id {
            match id {
                Element::Vertex(v) => add(u64::from(v)),
                Element::Edge([v, w]) => add(u64::from(v) << 32 | u64::from(w)),
                Element::Inside => add(u64::MAX),
            }
        }
    }
    m.basis.iter().flat_map(|b| b.a.iter().chain(&b.b)).for_each(|&v| add(u64::from(v)));
    hash
}

/// Solves 3000 pairs with a new workspace each, in reverse order with one workspace, and on two
/// threads. Catches a workspace that carries something over to the next pair, and a result that
/// depends on time, address or thread.
#[test]
fn the_same_pairs_give_the_same_bits() {
    let (shapes, pairs) = sweep(3000);
    let mut all = 0u64;
    for solver in Solver::ALL {
        let mut query = Query { margin: 0.05, ..Query::default() };
        query.accuracy.solver = solver;
        let fresh: Vec<u64> =
            pairs.iter().map(|p| answer(&shapes, p, &query, &mut Workspace::default())).collect();
        let mut workspace = Workspace::default();
        let mut reversed: Vec<u64> =
            pairs.iter().rev().map(|p| answer(&shapes, p, &query, &mut workspace)).collect();
        reversed.reverse();
        assert!(fresh == reversed, "an old workspace changes an answer");
        let threaded: Vec<u64> = std::thread::scope(|scope| {
            let part = |part: &'static str, chunk| {
                let (shapes, query) = (&shapes, &query);
                let chunk: &[Pair] = chunk;
                std::thread::Builder::new().name(part.into()).spawn_scoped(scope, move || {
                    let mut workspace = Workspace::default();
                    chunk.iter().map(|p| answer(shapes, p, query, &mut workspace)).collect::<Vec<_>>()
                })
            };
            let (first, second) = pairs.split_at(1234);
            let handles = [part("first", first), part("second", second)];
            handles.into_iter().flat_map(|h| h.expect("a thread").join().expect("answers")).collect()
        });
        assert!(fresh == threaded, "a thread changes an answer");
        all = fresh.iter().fold(all, |all, d| all.rotate_left(5) ^ d);
    }
    println!("digest {all:016x}");
}
