//! The compute threads of the package `hullcast-batch`, and the jobs of the service's callers.

pub use hullcast_batch::compute::{
    Compute, ComputeError, DeferredDrop, LARGE_BYTES, Panicked, Parts, catch_panic,
};

use crate::budget::Caller;

/// The work of one of the service's callers.
pub type Job = hullcast_batch::compute::Job<Caller>;

impl hullcast_batch::compute::CallerId for Caller {
    fn id(&self) -> u64 {
        Self::id(self)
    }
}
