//! Helpers for the tests of the service.

pub mod access;
pub mod audit;
pub mod disk;
pub mod fake_blender;
pub mod interceptor;
pub mod receiver;
pub mod stores;

/// The files of a repair job before any picture is drawn: the upload, the model, the two reports and the log.
pub const FILES_PER_JOB: usize = 5;
