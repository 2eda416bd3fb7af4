"""Doing it again while what stops it may pass."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import TypeVar

from .errors import Problem

T = TypeVar("T")

#: Longest pause between two tries that nobody asked for, in seconds.
LONGEST_PAUSE = 15.0


class Deadline:
    """A time by which something must be done."""

    def __init__(self, seconds: float) -> None:
        self._at = time.monotonic() + seconds

    def left(self) -> float:
        """Seconds until then, never below 0."""
        return max(0.0, self._at - time.monotonic())


def pause_after(failures: int, problem: Problem) -> float:
    """Seconds to wait: longer each time and never the same, and no less than the service asked for."""
    steps = min(0.25 * 2.0 ** min(failures - 1, 8), LONGEST_PAUSE)
    return (problem.retry_after or 0) + steps * random.uniform(0.5, 1)


def patiently(work: Callable[[int], T], deadline: Deadline, *, repeatable: bool = True) -> T:
    """Calls ``work`` with the number of the try. The last problem is raised where no time is left.

    What does harm when it is sent twice is sent again only where it was refused.
    """
    tries = 1
    while True:
        try:
            return work(tries)
        except Problem as problem:
            wait = pause_after(tries, problem)
            if not problem.is_passing or not (repeatable or problem.status in (429, 503)) or wait > deadline.left():
                raise
        time.sleep(wait)
        tries += 1
