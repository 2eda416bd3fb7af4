//! The service as its users meet it: the built program, a real socket, real processes.

#[path = "../support/files.rs"]
mod files;
#[path = "../support/server.rs"]
mod server;

mod analyze;
mod blender;
mod blobs;
mod buckets;
mod cancel;
mod database;
mod faults;
mod idempotency;
mod jobs;
mod limits;
#[path = "../support/postgres.rs"]
mod postgres;
mod problems;
mod readme;
#[path = "../support/s3.rs"]
mod s3;
mod store;
mod surface;
mod uploads;
