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
    """Repairs a model on this machine, and verifies the file that the repair returns.

    ``model`` is a path, the bytes of a file, a pair of arrays ``(vertices, faces)``, or a trimesh, meshio, open3d or
    pyvista mesh. The format of a file is recognised by its content.

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
    option ``with`` is called ``with_`` here, because ``with`` is a keyword of Python. By default, the result of a mesh
    is a PLY file, which holds the coordinates exactly. The result of a file is an STL file, unless STL cannot store all
    that the input holds. A model that cannot be repaired is a result, not an error. With the option ``alternatives``,
    `Result.alternatives` has further results where the file leaves the model's intent open.

    >>> meshmend.repair((corners, faces), max_tier=9)
    Traceback (most recent call last):
    meshmend.errors.InvalidOption: `max_tier` must be 1, 2 or 3; got 9.

    The repair releases the GIL, so other Python threads keep running. Ctrl-C cancels the repair, and so does setting
    the event ``cancel``. The same model and options give the same bytes, for any number of ``threads``; the default is
    one thread per processor. ``progress`` is a function that receives the stage and the finished fraction; True shows a
    tqdm progress bar. ``blender`` is the path of the program for tier 3. By default, the variable ``MESHMEND_BLENDER``
    names the program, or PATH is searched, as by the command line. False turns tier 3 off.

    Raises `InvalidModel` and `InvalidOption`, which are ValueErrors, OSError for a file that cannot be opened,
    `DeadlineExceeded`, `Cancellation`, and `EngineFailure`.
    """
    limits = limits_of(max_file_mib, max_file_faces, max_file_vertices)
    given, is_mesh = engine_model(model, limits, name)
    given_options = changed({**options, "with": options.get("with", None if with_ is None else list(with_))})
    if is_mesh:
        given_options.setdefault("output", "ply")
    with settings_of(limits, threads, progress, cancel) as settings:
        repaired, others = _engine.repair(given, json.dumps(given_options), _program(blender), settings)
        return Result(repaired, {choice: Result(other) for choice, other in others})


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
    given_options = changed(cast("dict[str, Any]", options))
    with settings_of(limits, threads, progress, cancel) as settings:
        return Inspection(_engine.inspect(given, json.dumps(given_options), settings))


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
    """Returns the program for tier 3: None turns tier 3 off, and an empty text makes the engine search PATH."""
    if blender is False:
        return None
    return os.environ.get("MESHMEND_BLENDER", "") if blender is True else blender


def _numbered(model: ModelLike, at: int) -> str | None:
    return None if isinstance(model, (str, os.PathLike)) else f"model {at + 1}"
