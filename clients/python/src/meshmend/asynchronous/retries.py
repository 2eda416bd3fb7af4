"""Retries with backoff."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from ..errors import Problem
from ..retry import Deadline, pause_after

T = TypeVar("T")


async def retry_with_backoff(work: Callable[[int], Awaitable[T]], deadline: Deadline, *, repeatable: bool = True) -> T:
    """Calls ``work`` with the number of the attempt until it succeeds. Raises the last problem when the time is over.

    A request that is not ``repeatable`` is sent again only after a response with status 429 or 503.
    """
    tries = 1
    while True:
        try:
            return await work(tries)
        except Problem as problem:
            wait = pause_after(tries, problem)
            if not problem.is_transient or not (repeatable or problem.status in (429, 503)) or wait > deadline.left():
                raise
        await asyncio.sleep(wait)
        tries += 1
