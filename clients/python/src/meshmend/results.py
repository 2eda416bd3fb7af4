"""Results of the engine: `Result` of a repair, and `Inspection`."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from . import _engine, shapes
from .errors import MeshmendError

if TYPE_CHECKING:
    import trimesh


class Result:
    """A repaired model. Each property is computed when it is first used."""

    def __init__(self, repaired: _engine.Repaired, alternatives: Mapping[str, Result] | None = None) -> None:
        self._repaired = repaired
        #: With the option ``alternatives``, the other results by their ids; see ``report["alternatives"]``.
        self.alternatives: Mapping[str, Result] = alternatives or {}

    def __repr__(self) -> str:
        return f"<Result {self.outcome}: {self.summary}>"

    @cached_property
    def report(self) -> shapes.RepairReport:
        """The report of the repair, as in the HTTP API and in ``meshmend repair --report``."""
        return cast(shapes.RepairReport, json.loads(self._repaired.report()))

    @property
    def outcome(self) -> shapes.Outcome:
        """``already_printable``, ``repaired``, ``partially_repaired`` or ``unrepairable``."""
        return self.report["outcome"]

    @property
    def is_printable(self) -> bool:
        """Whether the returned file was verified to be printable, without a red flag."""
        return self.report["verdict"]["printable"]

    @property
    def summary(self) -> str:
        """The outcome in one or two sentences."""
        return self.report["summary"]

    @property
    def format(self) -> shapes.Format | None:
        """The format of the file; None if the repair returns no file, for example because of ``require``."""
        return cast("shapes.Format | None", self._repaired.format)

    @cached_property
    def bytes(self) -> bytes:
        """The bytes of the verified file. Raises `MeshmendError` if the repair returns no file."""
        if self.format is None:
            raise MeshmendError(f"The repair returned no model: {self.summary}")
        return self._repaired.bytes()

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """The vertices of the result, as an array of n rows and 3 columns."""
        return self._arrays[0]

    @property
    def faces(self) -> npt.NDArray[np.int32]:
        """The triangles of the result: indices into `vertices`, as an array of n rows and 3 columns."""
        return self._arrays[1]

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The result as a trimesh mesh. The package trimesh must be installed."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the verified file. The path's extension must be that of the result's format.

        An error leaves no partial file.
        """
        extension = os.path.splitext(os.fspath(path))[1].removeprefix(".").lower()
        if self.format is not None and extension != self.format:
            raise ValueError(
                f"{os.fspath(path)}: the result is a file of format {self.format}; name it .{self.format}, "
                f"or repair with output={extension!r}"
            )
        save(path, self.bytes)

    @cached_property
    def _arrays(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
        return _engine.read_arrays(self.bytes)


class Inspection:
    """The inspection of one model or several."""

    def __init__(self, report: str) -> None:
        #: The report, in the form of the HTTP API.
        self.report: shapes.AnalyzeReport = json.loads(report)

    def __repr__(self) -> str:
        answer = {True: "printable", False: "not printable", None: "undecided"}[self.is_printable]
        return f"<Inspection of {len(self.files)} models: {answer}>"

    @property
    def is_printable(self) -> bool | None:
        """Whether every model is printable. None if the inspection was not complete enough to decide."""
        return self.report["printable"]

    @property
    def files(self) -> list[shapes.FileAnalysis]:
        """The results for each model, in the order of the arguments."""
        return self.report["files"]

    @property
    def measures(self) -> shapes.Inspection:
        """The measures and the defects of the first model."""
        return self.files[0]["inspection"]


def save(path: str | os.PathLike[str], content: bytes) -> None:
    """Writes a file atomically: to a temporary file in the same folder, which then replaces ``path``."""
    folder = os.path.dirname(os.path.abspath(path))
    file, part = tempfile.mkstemp(prefix=".meshmend-", dir=folder)
    try:
        with os.fdopen(file, "wb") as opened:
            opened.write(content)
        os.chmod(part, 0o644)
        os.replace(part, path)
    except BaseException:
        os.remove(part)
        raise
