//! The files in docker/ and deploy/ match the program: every variable, command line, metric and path in them.

#[path = "../support/files.rs"]
#[allow(dead_code, reason = "the tests of the service need all of it")]
mod files;
#[path = "../support/postgres.rs"]
#[allow(dead_code, reason = "the tests of the service need all of it")]
mod postgres;
#[path = "../support/s3.rs"]
#[allow(dead_code, reason = "the tests of the service need all of it")]
mod s3;
#[path = "../support/server.rs"]
#[allow(dead_code, reason = "the tests of the service need all of it")]
mod server;

mod compose;
mod compose_run;
mod helm;
mod image;
mod image_script;
mod kubernetes;
mod metrics;
mod settings;
mod support;
mod unit;
mod workflows;
