"""What every call to the engine has: limits, threads, progress and cancellation."""

from __future__ import annotations

import importlib
import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeAlias

from . import _engine
from .errors import InvalidOption

#: Gets the stage of the work (``read``, ``inspect``, ``repair``, ``wait``, ``verify`` or ``finish``) and the finished
#: fraction of the whole, from 0 to 1.
ProgressCallback: TypeAlias = Callable[[str, float], object]

logger = logging.getLogger("meshmend")


def limits_of(
    max_file_mib: int | None, max_file_faces: int | None, max_file_vertices: int | None
) -> tuple[int, int, int]:
    """The limits on a model; those not given have the command line's defaults."""
    size, faces, vertices = _engine.DEFAULT_LIMITS
    return (
        size if max_file_mib is None else _natural("max_file_mib", max_file_mib) << 20,
        faces if max_file_faces is None else _natural("max_file_faces", max_file_faces),
        vertices if max_file_vertices is None else _natural("max_file_vertices", max_file_vertices),
    )


@contextmanager
def settings_of(
    limits: tuple[int, int, int],
    threads: int | None,
    progress: ProgressCallback | bool | None,
    cancel: threading.Event | None,
) -> Iterator[_engine.Settings]:
    """The settings of one call. Closes the progress bar at the end."""
    count = 0 if threads is None else _natural("threads", threads)
    log = logger.debug if logger.isEnabledFor(logging.DEBUG) else None
    asked = None if cancel is None else cancel.is_set
    if progress is not True:
        callback = (lambda stage, _, fraction: progress(stage, fraction)) if callable(progress) else None
        yield _engine.Settings(limits, count, callback, log, asked)
        return
    try:
        tqdm = importlib.import_module("tqdm.auto").tqdm
    except ImportError as error:
        raise ImportError("progress=True needs tqdm: pip install 'meshmend[progress]'") from error
    with tqdm(total=100, unit="%", bar_format="{desc:10}{bar} {n:.0f} % {elapsed}") as bar:

        def show(stage: str, _: int | None, fraction: float) -> None:
            bar.set_description(stage, refresh=False)
            bar.update(100 * fraction - bar.n)

        yield _engine.Settings(limits, count, show, log, asked)


def changed(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are given. None stands for an option's default."""
    return {name: value for name, value in options.items() if value is not None}


def _natural(option: str, value: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InvalidOption(f"`{option}` must be a whole number of 1 or more; got {value!r}.", option)
    return value
