//! What is fuzzed: bytes in, a panic where a promise is broken. The same is run with damaged models by `tests/fuzz/`.

mod arrangement;
mod pipeline;
mod threemf;

pub use arrangement::arrange;
pub use pipeline::repair;
pub use threemf::threemf;
