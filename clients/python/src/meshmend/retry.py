"""Time limits, and the pauses between retries."""

from __future__ import annotations

import random
import time

from .errors import Problem

#: Longest pause between two attempts in seconds, unless the service asks for a longer one.
MAX_PAUSE = 15.0


class Deadline:
    """The end of a time limit."""

    def __init__(self, seconds: float) -> None:
        self._at = time.monotonic() + seconds

    def left(self) -> float:
        """Remaining seconds, at least 0."""
        return max(0.0, self._at - time.monotonic())


def pause_after(failures: int, problem: Problem) -> float:
    """Seconds to wait: exponential with jitter, and at least the ``Retry-After`` of the service."""
    steps = min(0.25 * 2.0 ** min(failures - 1, 8), MAX_PAUSE)
    return (problem.retry_after or 0) + steps * random.uniform(0.5, 1)
