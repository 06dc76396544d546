//! Locks whose holders may panic.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The locked value. A panic of an earlier holder does not matter: no code of hullcast leaves a
/// locked value half changed where it can panic.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
