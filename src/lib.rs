//! meshmend repairs broken 3D models.
//!
//! One promise: **what you download is printable and still your model.** meshmend judges printability on the exact bytes of the result
//! file, read back and welded by position. If the promise can't be kept, the report says so.
//!
//! The modules of the engine form a pipeline, with [`context`] beside it:
//!
//! ```text
//! bytes -> format -> mesh -> inspect -> repair (plan, tiers) -> verify -> format -> bytes
//! ```
//!
//! The service adds a second pipeline around it:
//!
//! ```text
//! api -> blobs + jobs -> worker -> (the engine's pipeline, in a child process) -> blobs + jobs -> api
//! ```
//!
//! The engine (`math`, `mesh`, `format`, `inspect`, `printing`, `analyze`, `arrange`, `simplify`, `remesh`, `repair`, `blender`) does not depend on
//! tokio, axum or sqlx. Without cargo features the crate is the engine. The program needs the feature `cli`, and with the service the feature
//! `service`. On systems other than Linux there is neither `blender` nor the feature `service`.

#[cfg(all(feature = "service", not(target_os = "linux")))]
compile_error!(
    "the feature `service` needs Linux; build the program with the feature `cli`, or the library without features"
);

#[cfg(feature = "service")]
pub mod access;
pub mod allocator;
pub mod analyze;
#[cfg(feature = "service")]
pub mod api;
pub mod arrange;
#[cfg(target_os = "linux")]
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
#[cfg(feature = "openapi")]
pub mod options;
pub mod printing;
pub mod remesh;
pub mod render;
pub mod repair;
#[cfg(target_os = "linux")]
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
