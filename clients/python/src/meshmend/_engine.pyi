"""Types of the engine's module. Use the functions of `meshmend` instead."""

import os
from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import numpy.typing as npt

__version__: str
#: Maximum size of a file in bytes, of its faces, and of its vertices.
DEFAULT_LIMITS: tuple[int, int, int]

_Model = tuple[str, bytes | str | os.PathLike[str]]

@final
class Settings:
    def __new__(
        cls,
        limits: tuple[int, int, int],
        threads: int,
        progress: Callable[[str, int | None, float], object] | None,
        log: Callable[[str], object] | None,
        is_cancelled: Callable[[], bool] | None,
    ) -> Settings: ...

@final
class Repaired:
    @property
    def format(self) -> str | None: ...
    def bytes(self) -> bytes: ...
    def report(self) -> str: ...

def repair(
    model: _Model, options: str, blender: str | os.PathLike[str] | None, settings: Settings
) -> tuple[Repaired, list[tuple[str, Repaired]]]: ...
def inspect(models: Sequence[_Model], options: str, settings: Settings) -> str: ...
def compare(
    models: tuple[_Model, _Model], samples: int | None, deadline_s: float | None, settings: Settings
) -> str: ...
def ply_of_arrays(name: str, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> bytes: ...
def read_arrays(bytes: bytes) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]: ...
