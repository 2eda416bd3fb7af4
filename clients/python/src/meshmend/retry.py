"""Retries with backoff."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import TypeVar

from .errors import Problem

T = TypeVar("T")

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


def retry_with_backoff(work: Callable[[int], T], deadline: Deadline, *, repeatable: bool = True) -> T:
    """Calls ``work`` with the number of the attempt until it succeeds. Raises the last problem when the time is over.

    A request that is not ``repeatable`` is sent again only after a response with status 429 or 503.
    """
    tries = 1
    while True:
        try:
            return work(tries)
        except Problem as problem:
            wait = pause_after(tries, problem)
            if not problem.is_transient or not (repeatable or problem.status in (429, 503)) or wait > deadline.left():
                raise
        time.sleep(wait)
        tries += 1
