//! A simulated fleet: the queue's protocol with simulated machines, clocks and networks, from a seed.
//!
//! ```text
//! plan (from a seed) -> environment -> api, worker -> network -> the store's traits -> database or a real store
//!                                                                      |
//!                                                                   witness (invariants) -> shortened history
//! ```
//!
//! `docs/design/fleet.md` describes what is simulated.

mod api;
mod database;
mod environment;
mod executor;
mod guards;
mod history;
mod network;
mod plan;
#[expect(dead_code, reason = "other tests also kill and restart the server")]
#[path = "../support/postgres.rs"]
mod postgres;
mod random;
mod request;
mod show;
mod simulation;
mod stores;
mod support;
mod witness;
mod worker;
mod world;
