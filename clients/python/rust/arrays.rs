//! Meshes between numpy and the engine: arrays as a file, and a file as arrays.

use glam::DVec3;
use meshmend::format::{self, Format, Limits, ReadOptions};
use meshmend::mesh::{Soup, Surface};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{Failure, model_error, read_error};

/// Writes a mesh of two arrays as a PLY file, which holds exactly the same mesh.
///
/// The file goes through the readers' checks like any other. A coordinate that is not finite, and an index without a vertex, are errors.
#[pyfunction]
pub fn ply_of_arrays<'py>(
    py: Python<'py>,
    name: &str,
    vertices: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i64>,
) -> PyResult<Bound<'py, PyBytes>> {
    let (vertices, faces) = (vertices.as_array(), faces.as_array());
    let mut soup = Soup { positions: Vec::with_capacity(vertices.nrows()), faces: Vec::with_capacity(faces.nrows()) };
    for (row, at) in vertices.rows().into_iter().enumerate() {
        let position = DVec3::new(at[0], at[1], at[2]);
        if !position.is_finite() {
            let message = format!("row {row} of the vertices is not finite: {at}; remove or replace it");
            return Err(model_error(name, &message, "malformed".to_owned(), None, None));
        }
        soup.positions.push(position);
    }
    let count = soup.positions.len();
    let index = |vertex: i64| u32::try_from(vertex).ok().filter(|&vertex| (vertex as usize) < count);
    for (row, corners) in faces.rows().into_iter().enumerate() {
        let [Some(a), Some(b), Some(c)] = [corners[0], corners[1], corners[2]].map(index) else {
            let message = format!(
                "row {row} of the faces is {corners}; indices must be from 0 to below {count}, the number of vertices"
            );
            return Err(model_error(name, &message, "index_out_of_range".to_owned(), None, None));
        };
        soup.faces.push([a, b, c]);
    }
    let written = py.detach(|| format::write(&soup, Format::Ply));
    let bytes = written.map_err(|error| Failure::Other(error.to_string()).into_exception(None, false))?;
    Ok(PyBytes::new(py, &bytes))
}

/// The vertices and the faces of a file. Faces of a format without indices get common vertices where positions are equal.
#[pyfunction]
#[expect(clippy::type_complexity, reason = "two arrays")]
pub fn read_arrays<'py>(
    py: Python<'py>,
    bytes: &[u8],
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<i32>>)> {
    let read = py.detach(|| {
        let mesh = format::read_shape(bytes, &ReadOptions::within(Limits::NONE))?.mesh;
        Ok(if mesh.format.is_indexed() { mesh.soup } else { Surface::from_soup(&mesh.soup).0.to_soup() })
    });
    let soup = read.map_err(|error| read_error("result", &error))?;
    let (vertices, faces) = (soup.positions.len(), soup.faces.len());
    // Neither conversion copies: arrays have the size and alignment of what they replace, so the vectors keep their memory.
    let positions = soup.positions.into_iter().map(|position| position.to_array()).collect::<Vec<_>>().into_flattened();
    let indices: Result<Vec<i32>, _> = soup.faces.into_flattened().into_iter().map(i32::try_from).collect();
    let indices = indices.map_err(|error| Failure::Other(error.to_string()).into_exception(None, false))?;
    Ok((positions.into_pyarray(py).reshape([vertices, 3])?, indices.into_pyarray(py).reshape([faces, 3])?))
}
