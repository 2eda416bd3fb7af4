//! The engine through its public functions, on meshes that the tests make.
#![allow(clippy::unwrap_used, reason = "a test that fails here says where")]

mod formats;
