//! A hull of arbitrary points must be refused with a reason or satisfy every definition.
#![no_main]

use hullcast_contact::ConvexHull;
use hullcast_fuzz::Cloud;
use libfuzzer_sys::fuzz_target;

#[path = "../../crates/contact/tests/hull/check.rs"]
mod check;

fuzz_target!(|cloud: Cloud| {
    let Cloud(points) = cloud;
    // The check's own predicates underflow on coordinates below 2^-280.
    let size = points.iter().flatten().fold(0.0f64, |size, c| size.max(c.abs()));
    let checked = points.iter().flatten().all(|c| *c == 0.0 || c.abs() > 1e-60 * size);
    match ConvexHull::new(&points) {
        Ok(hull) if checked => check::check(&points, &hull, &mut check::CheckCounts::default()),
        Ok(_) => {}
        // The builder must never report a state that it considers impossible.
        Err(error) => assert!(!error.detail.contains("internal"), "{error}"),
    }
});
