//! The engine as the Python module `meshmend._engine`. Its functions take checked arguments: the Python sources of the package read models,
//! and document everything. `src/meshmend/_engine.pyi` has the types.

mod arrays;
mod call;
mod compare;
mod errors;
mod inspect;
mod model;
mod options;
mod repair;

use meshmend::format::Limits;
use pyo3::prelude::*;

/// Maximum size of a file in bytes, of its faces and of its vertices.
type LimitNumbers = (u64, u64, u64);

fn limits((max_bytes, max_faces, max_vertices): LimitNumbers) -> Limits {
    Limits { max_bytes, max_faces, max_vertices }
}

/// The engine of meshmend.
#[pymodule]
mod _engine {
    #[pymodule_export]
    use super::arrays::{ply_of_arrays, read_arrays};
    #[pymodule_export]
    use super::call::Settings;
    #[pymodule_export]
    use super::compare::compare;
    #[pymodule_export]
    use super::inspect::inspect;
    #[pymodule_export]
    use super::repair::{Repaired, repair};
    use super::*;

    /// Sets the constants of the module.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let Limits { max_bytes, max_faces, max_vertices } = Limits::default();
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("DEFAULT_LIMITS", (max_bytes, max_faces, max_vertices))
    }
}
