"""The engine's operations on this machine: `repair`, `inspect` and `compare`."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Sequence
from typing import Any, cast

from typing_extensions import Unpack

from . import _engine, shapes
from .calls import ProgressCallback, changed, limits_of, settings_of
from .comparison import Comparison
from .inputs import ModelLike, engine_model
from .results import Inspection, Result


def repair(
    model: ModelLike,
    *,
    with_: Sequence[shapes.Operator] | None = None,
    name: str | None = None,
    blender: bool | str | os.PathLike[str] = True,
    threads: int | None = None,
    progress: ProgressCallback | bool | None = None,
    cancel: threading.Event | None = None,
    max_file_mib: int | None = None,
    max_file_faces: int | None = None,
    max_file_vertices: int | None = None,
    **options: Unpack[shapes.Options],
) -> Result:
    """Repairs a model with the engine, on this machine, and verifies the file that it returns.

    ``model`` is a path, the bytes of a file, a pair of arrays ``(vertices, faces)``, or a mesh of trimesh, meshio,
    open3d or pyvista. The content decides a file's format.

    >>> import meshmend
    >>> corners = [(x, y, z) for x in (0, 9) for y in (0, 9) for z in (0, 9)]
    >>> sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    >>> faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    >>> result = meshmend.repair((corners, faces[1:]))
    >>> result.outcome, result.is_printable
    ('repaired', True)
    >>> result.faces.shape, result.report["before"]["boundary_edges"]
    ((12, 3), 3)

    ``options`` are the options of the HTTP API, such as ``output``, ``max_tier``, ``deadline_s`` or ``require``. The
    option ``with``, a word of Python, is ``with_`` here. A mesh is returned as PLY by default, which holds its
    coordinates exactly; a file is returned as by the API, which writes STL unless that loses something. A model that
    cannot be repaired is a result, not an error.

    >>> meshmend.repair((corners, faces), max_tier=9)
    Traceback (most recent call last):
    meshmend.errors.InvalidOption: `max_tier` must be 1, 2 or 3; got 9.

    Other threads of Python run meanwhile. Ctrl-C cancels the repair, and so does ``cancel`` once it is set. The same
    model and options give the same bytes, for any number of ``threads``; by default there are as many as processors.
    ``progress`` gets the stage and the finished fraction; True shows a bar of tqdm. ``blender`` names the program of
    tier 3; by default it is looked for as in the command line (``MESHMEND_BLENDER``, then PATH), and False turns
    tier 3 off.

    Raises `InvalidModel` and `InvalidOption`, which are ValueErrors, OSError for a file that cannot be opened,
    `DeadlineExceeded`, `Cancellation`, and `EngineFailure`.
    """
    limits = limits_of(max_file_mib, max_file_faces, max_file_vertices)
    given, is_mesh = engine_model(model, limits, name)
    asked = changed({**options, "with": options.get("with", None if with_ is None else list(with_))})
    if is_mesh:
        asked.setdefault("output", "ply")
    with settings_of(limits, threads, progress, cancel) as settings:
        return Result(_engine.repair(given, json.dumps(asked), _program(blender), settings))


def inspect(
    *models: ModelLike,
    threads: int | None = None,
    progress: ProgressCallback | bool | None = None,
    cancel: threading.Event | None = None,
    max_file_mib: int | None = None,
    max_file_faces: int | None = None,
    max_file_vertices: int | None = None,
    **options: Unpack[shapes.AnalyzeOptions],
) -> Inspection:
    """Inspects one model or several without changing them. Takes the same models and arguments as `repair`.

    ``options`` are the options of the HTTP API's mode ``analyze``.

    >>> import meshmend
    >>> corner = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]], [[0, 2, 1], [0, 1, 3], [0, 3, 2]]
    >>> inspection = meshmend.inspect(corner)
    >>> inspection.is_printable, inspection.measures["boundary_loops"]
    (False, 1)
    """
    limits = limits_of(max_file_mib, max_file_faces, max_file_vertices)
    names = [None] if len(models) == 1 else [_numbered(model, at) for at, model in enumerate(models)]
    given = [engine_model(model, limits, name)[0] for model, name in zip(models, names, strict=True)]
    asked = changed(cast("dict[str, Any]", options))
    with settings_of(limits, threads, progress, cancel) as settings:
        return Inspection(_engine.inspect(given, json.dumps(asked), settings))


def compare(
    before: ModelLike,
    after: ModelLike,
    *,
    samples: int | None = None,
    deadline_s: float | None = None,
    threads: int | None = None,
    progress: ProgressCallback | bool | None = None,
    cancel: threading.Event | None = None,
    max_file_mib: int | None = None,
    max_file_faces: int | None = None,
    max_file_vertices: int | None = None,
) -> Comparison:
    """Measures how a model differs from another, like ``meshmend compare --json``.

    >>> import meshmend
    >>> faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    >>> corner = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]]
    >>> higher = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 11]]
    >>> comparison = meshmend.compare((corner, faces), (higher, faces))
    >>> comparison["comparison"]["faithful"], round(comparison["comparison"]["volume_change_pct"])
    (False, 10)
    """
    limits = limits_of(max_file_mib, max_file_faces, max_file_vertices)
    first, _ = engine_model(before, limits, None if isinstance(before, (str, os.PathLike)) else "before")
    second, _ = engine_model(after, limits, None if isinstance(after, (str, os.PathLike)) else "after")
    with settings_of(limits, threads, progress, cancel) as settings:
        return cast(Comparison, json.loads(_engine.compare((first, second), samples, deadline_s, settings)))


def _program(blender: bool | str | os.PathLike[str]) -> str | os.PathLike[str] | None:
    """The program for the engine: none without tier 3, and an empty one to look for it."""
    if blender is False:
        return None
    return os.environ.get("MESHMEND_BLENDER", "") if blender is True else blender


def _numbered(model: ModelLike, at: int) -> str | None:
    return None if isinstance(model, (str, os.PathLike)) else f"model {at + 1}"
