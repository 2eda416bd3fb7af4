//! The source of ids and secrets, passed in like the clock so that tests can fix them.

use uuid::Uuid;

/// A source of ids and random numbers.
pub trait IdSource: Send + Sync {
    /// A new UUID that sorts by its creation time.
    fn sortable(&self) -> Uuid;

    /// A new random UUID that can't be guessed, with 122 random bits.
    fn random(&self) -> Uuid;
}

/// Ids from the operating system's random numbers: UUIDs of versions 7 and 4.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemIds;

impl IdSource for SystemIds {
    fn sortable(&self) -> Uuid {
        Uuid::now_v7()
    }

    fn random(&self) -> Uuid {
        Uuid::new_v4()
    }
}

/// Returns 32 bytes with 244 random bits.
#[must_use]
pub fn random_bytes(ids: &dyn IdSource) -> [u8; 32] {
    let mut bytes = [0; 32];
    bytes[..16].copy_from_slice(ids.random().as_bytes());
    bytes[16..].copy_from_slice(ids.random().as_bytes());
    bytes
}
