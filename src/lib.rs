//! meshmend repairs broken 3D models.
//!
//! One promise: **what you download is printable and still your model.** Printable is judged on the very bytes that are
//! handed out, read back and welded by position; where the promise can't be kept, the report says so.
//!
//! A mesh's way through the crate is one straight line, and the engine's modules stand in that order, with [`context`] beside them:
//!
//! ```text
//! bytes -> format -> mesh -> inspect -> repair (plan, tiers) -> verify -> format -> bytes
//! ```
//!
//! and a job's way is another:
//!
//! ```text
//! api -> blobs + jobs -> worker -> (the line above, in a child process) -> blobs + jobs -> api
//! ```
//!
//! The engine (`math`, `mesh`, `format`, `inspect`, `analyze`, `arrange`, `simplify`, `remesh`, `repair`, `blender`) knows nothing of tokio, axum or sqlx.

#[cfg(feature = "service")]
pub mod access;
pub mod analyze;
#[cfg(feature = "service")]
pub mod api;
pub mod arrange;
pub mod blender;
#[cfg(feature = "service")]
pub mod blobs;
pub mod context;
pub mod format;
pub mod inspect;
#[cfg(feature = "service")]
pub mod jobs;
#[cfg(feature = "service")]
pub mod manual;
pub mod math;
pub mod mesh;
pub mod remesh;
pub mod render;
pub mod repair;
pub mod sandbox;
pub mod scene;
pub mod simplify;
#[cfg(feature = "service")]
pub mod telemetry;
#[cfg(feature = "service")]
pub mod tls;
#[cfg(feature = "service")]
pub mod web;
#[cfg(feature = "service")]
pub mod webhooks;
#[cfg(feature = "service")]
pub mod worker;

/// Name and version of the engine, as in every report.
pub const ENGINE: &str = concat!("meshmend ", env!("CARGO_PKG_VERSION"));
