//! What is fuzzed: bytes in, a panic where a promise is broken. The same is run with damaged input by `tests/fuzz/`.

mod archive;
mod arrangement;
mod choices;
mod gltf;
mod pipeline;
mod readers;
mod requests;
mod threemf;
mod zip;

pub use arrangement::arrange;
pub use gltf::gltf;
pub use pipeline::repair;
pub use readers::read_as;
pub use requests::{form, request};
pub use threemf::threemf;
pub use zip::zip;
