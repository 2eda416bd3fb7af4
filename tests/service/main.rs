//! The service as its users meet it: the built program, a real socket, real processes.

#[path = "../support/files.rs"]
mod files;
#[path = "../support/server.rs"]
mod server;

mod access;
mod analyze;
mod blender;
mod cancel;
mod database;
mod faults;
mod idempotency;
mod jobs;
mod limits;
mod outbox;
#[path = "../support/postgres.rs"]
mod postgres;
mod problems;
mod readme;
mod receiver;
mod retention;
mod store;
mod stores;
mod surface;
mod webhooks;
