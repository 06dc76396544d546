//! The memory that answers take, and its limit.
//!
//! The engine takes the bytes of a column before it keeps the column, and gives them back when the column
//! is freed. Where the bytes come from is up to the owner of the engine: an implementation of [`Memory`]
//! may count them, limit them, or share them between callers.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use thiserror::Error;

/// The memory of one answer. The bytes that it holds are free again when it is dropped.
pub trait Memory: Send + 'static {
    /// The reason why there is no memory.
    type Refused: Copy + Send + Sync + fmt::Debug + 'static;

    /// Takes `more` bytes.
    ///
    /// # Errors
    /// There is no room for them. The bytes that were taken before stay taken.
    fn grow(&mut self, more: u64) -> Result<(), Self::Refused>;

    /// Gives all but `bytes` back. Memory that holds less stays as it is.
    fn shrink_to(&mut self, bytes: u64);
}

/// Memory without a limit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unlimited;

impl Memory for Unlimited {
    type Refused = std::convert::Infallible;

    fn grow(&mut self, _: u64) -> Result<(), Self::Refused> {
        Ok(())
    }

    fn shrink_to(&mut self, _: u64) {}
}

/// A number of bytes that several answers share. Clones are the same pool.
#[derive(Clone, Debug)]
pub struct MemoryPool(Arc<PoolState>);

#[derive(Debug)]
struct PoolState {
    limit: u64,
    used: AtomicU64,
}

/// The bytes that one answer holds of a [`MemoryPool`].
#[derive(Debug)]
pub struct PooledMemory {
    pool: MemoryPool,
    bytes: u64,
}

/// The pool has fewer free bytes than were asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{asked} more bytes are needed than are free of the {limit} bytes that may be used")]
pub struct PoolIsFull {
    /// The number of bytes that were asked for.
    pub asked: u64,
    /// The size of the pool.
    pub limit: u64,
}

impl MemoryPool {
    /// A pool of `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self(Arc::new(PoolState { limit, used: AtomicU64::new(0) }))
    }

    /// Memory of this pool that holds nothing yet.
    pub fn memory(&self) -> PooledMemory {
        PooledMemory { pool: self.clone(), bytes: 0 }
    }

    /// The number of bytes that are taken.
    pub fn used(&self) -> u64 {
        self.0.used.load(Ordering::Relaxed)
    }
}

impl PooledMemory {
    /// The number of bytes that this memory holds.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Memory for PooledMemory {
    type Refused = PoolIsFull;

    fn grow(&mut self, more: u64) -> Result<(), PoolIsFull> {
        let PoolState { limit, used } = &*self.pool.0;
        let within = |used: u64| used.checked_add(more).filter(|after| after <= limit);
        used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, within)
            .map_err(|_| PoolIsFull { asked: more, limit: *limit })?;
        self.bytes += more;
        Ok(())
    }

    fn shrink_to(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.pool.0.used.fetch_sub(less, Ordering::Relaxed);
        self.bytes -= less;
    }
}

impl Drop for PooledMemory {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches bytes beyond the limit of a pool, bytes that a refusal takes, and bytes that are not given
    /// back, or given back twice.
    #[test]
    fn a_pool_counts_its_bytes() {
        let pool = MemoryPool::new(100);
        let (mut one, mut other) = (pool.memory(), pool.memory());
        assert_eq!((one.grow(60), other.grow(40)), (Ok(()), Ok(())));
        assert_eq!(one.grow(1), Err(PoolIsFull { asked: 1, limit: 100 }));
        assert_eq!(one.grow(u64::MAX), Err(PoolIsFull { asked: u64::MAX, limit: 100 }));
        assert_eq!((pool.used(), one.bytes(), other.bytes()), (100, 60, 40));
        one.shrink_to(70);
        one.shrink_to(10);
        assert_eq!((pool.used(), one.bytes()), (50, 10));
        drop(one);
        assert_eq!(other.grow(60), Ok(()));
        drop(other);
        assert_eq!(pool.used(), 0);
    }
}
