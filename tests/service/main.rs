//! The service as its users see it: the built program, real sockets and real processes.

#[path = "../support/files.rs"]
mod files;
#[path = "../support/server.rs"]
#[allow(dead_code, reason = "shared with the tests of the deployment")]
mod server;

mod access;
mod administration;
mod alternatives;
mod analyze;
mod blender;
mod blobs;
mod buckets;
mod cancel;
mod chaos;
mod commands;
mod contract;
mod database;
mod disk;
mod drawings;
mod faults;
mod idempotency;
mod jobs;
mod limits;
mod load;
mod matrix;
mod operations;
mod outbox;
mod page;
#[path = "../support/postgres.rs"]
mod postgres;
mod prepared;
mod problems;
mod profiles;
#[path = "../support/proxy.rs"]
mod proxy;
mod remote;
mod retention;
#[path = "../support/s3.rs"]
mod s3;
mod sandbox;
mod small_answers;
mod statements;
mod stopping;
mod store;
mod support;
mod surface;
mod traces;
mod uploads;
mod verdict;
mod webhooks;
