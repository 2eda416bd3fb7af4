"""Models that the engine takes: files, arrays, and meshes of other libraries."""

from __future__ import annotations

import os
import warnings
from typing import Any, TypeAlias, Union

import numpy as np
import numpy.typing as npt

from . import _engine
from .errors import InvalidModel

#: A path; the bytes of a file; a pair of arrays ``(vertices, faces)``; or a mesh of trimesh, meshio, open3d or pyvista.
#: Any object with ``vertices`` and ``faces`` counts as a mesh.
ModelLike: TypeAlias = Union[str, "os.PathLike[str]", bytes, bytearray, memoryview, tuple[Any, Any], Any]

#: Name and content of a model, as the engine takes it.
EngineModel: TypeAlias = tuple[str, Union[bytes, str, "os.PathLike[str]"]]

Limits: TypeAlias = tuple[int, int, int]


def engine_model(model: ModelLike, limits: Limits, name: str | None = None) -> tuple[EngineModel, bool]:
    """Returns a model for the engine, and whether it is a mesh rather than a file.

    The engine reads files itself. A mesh becomes a PLY file in memory, which holds the same mesh exactly.
    """
    if isinstance(model, (str, os.PathLike)):
        return (name or os.path.basename(os.fspath(model)), model), False
    if isinstance(model, (bytes, bytearray, memoryview)):
        return (name or "model", bytes(model)), False
    name = name or "mesh"
    vertices, faces = arrays_of(model, name)
    return (name, _ply(vertices, faces, name, limits)), True


def arrays_of(mesh: Any, name: str) -> tuple[Any, Any]:
    """Returns the vertices and the triangles of a mesh. Quads are split from their first corner."""
    if isinstance(mesh, (tuple, list)):
        if len(mesh) != 2:
            raise InvalidModel(f"{name}: a pair of arrays (vertices, faces) has 2 items; got {len(mesh)}")
        return mesh[0], mesh[1]
    if hasattr(mesh, "geometry") and hasattr(mesh, "to_mesh"):
        mesh = mesh.to_mesh()  # trimesh.Scene
    if hasattr(mesh, "points") and hasattr(mesh, "extract_surface"):
        return _pyvista_arrays(mesh)
    if hasattr(mesh, "points") and hasattr(mesh, "cells_dict"):
        return mesh.points, _meshio_faces(mesh, name)
    if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):
        return mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy()  # open3d.t.geometry
    # trimesh has `triangles` too, which are coordinates there.
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        return mesh.vertices, mesh.faces
    if hasattr(mesh, "vertices") and hasattr(mesh, "triangles"):
        return mesh.vertices, mesh.triangles  # open3d.geometry
    raise TypeError(
        f"{name}: a model is a path, bytes, (vertices, faces), or a mesh of trimesh, meshio, open3d or pyvista; "
        f"got {type(mesh).__name__}"
    )


def _meshio_faces(mesh: Any, name: str) -> npt.NDArray[Any]:
    cells = mesh.cells_dict
    pieces = [np.asarray(cells["triangle"])] if "triangle" in cells else []
    if "quad" in cells:
        quads = np.asarray(cells["quad"])
        pieces.append(quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
    if not pieces:
        kinds = ", ".join(cells) or "no cells"
        raise InvalidModel(f"{name}: the mesh has no triangles and no quads, but {kinds}", "no_faces")
    return np.concatenate(pieces)


def _pyvista_arrays(mesh: Any) -> tuple[Any, Any]:
    surface = mesh
    # A grid of volumes has no `faces`; its surface has.
    if not hasattr(mesh, "is_all_triangles"):
        with warnings.catch_warnings():
            # pyvista announces another default, with the same surface.
            warnings.simplefilter("ignore")
            surface = mesh.extract_surface()
    triangles = surface if surface.is_all_triangles else surface.triangulate()
    return triangles.points, np.asarray(triangles.faces).reshape(-1, 4)[:, 1:]


def _ply(vertices: Any, faces: Any, name: str, limits: Limits) -> bytes:
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    _, max_faces, max_vertices = limits
    for what, array, most in (("vertices", vertices, max_vertices), ("faces", faces, max_faces)):
        if array.ndim != 2 or array.shape[1] != 3:
            shape = "x".join(map(str, array.shape)) or "one number"
            raise InvalidModel(f"{name}: {what} must be an array of n rows and 3 columns; got {shape}")
        # Before the copies below.
        if len(array) > most:
            raise InvalidModel(f"{name}: {len(array)} {what} are over the limit of {most}", "too_large")
    if faces.dtype.kind not in "iu":
        raise InvalidModel(f"{name}: faces must be whole numbers; got {faces.dtype}")
    if vertices.dtype.kind not in "iuf":
        raise InvalidModel(f"{name}: vertices must be numbers; got {vertices.dtype}")
    return _engine.ply_of_arrays(name, vertices.astype(np.float64, copy=False), faces.astype(np.int64, copy=False))
