"""Waiting for running jobs."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing

import httpx

from .. import shapes
from ..errors import JobTimeout, Problem
from ..events import ENDED, JobEvent, ProgressEvent, job_path
from ..retry import Deadline, pause_after
from .transport import AsyncTransport

#: Longest silence of a stream in seconds. The service sends at least one line every 15 seconds.
MAX_SILENCE = 45.0
#: Longest long poll in seconds.
HOLD = 20.0


async def listen_to(server: AsyncTransport, job_id: str, deadline: Deadline) -> AsyncGenerator[JobEvent, None]:
    """Yields the events of a job until it ends.

    The events come from the event stream, or from long polling if a proxy buffers the stream. Reconnects after a lost
    connection. The first event after that is the current state.
    """
    streaming, has_streamed, failures = True, False, 0
    while deadline.left() > 0:
        # The last seconds use long polling, since a poll can be limited to the remaining time.
        streaming = streaming and deadline.left() > HOLD
        heard = False
        try:
            async with aclosing((_stream if streaming else _ask)(server, job_id, deadline)) as events:
                async for event in events:
                    heard = True
                    has_streamed = has_streamed or streaming
                    yield event
                    if event.done is not None:
                        return
            failures, streaming = 0, has_streamed
        except Problem as problem:
            if not problem.is_transient:
                raise
            failures = 1 if heard else failures + 1
            # Without any event a proxy may buffer the stream, so the next attempt uses the other method.
            streaming = streaming if heard else not streaming
            await asyncio.sleep(min(pause_after(failures, problem), deadline.left()))
    raise JobTimeout(f"The job '{job_id}' did not end within the time limit.")


async def follow(
    server: AsyncTransport, job_id: str, deadline: Deadline, on_progress: Callable[[ProgressEvent], object] | None
) -> shapes.Job:
    """Waits until a job ends, and returns it."""
    async with aclosing(listen_to(server, job_id, deadline)) as events:
        async for event in events:
            if event.done is not None:
                return event.done
            if event.progress is not None and on_progress is not None:
                on_progress(event.progress)
    raise AssertionError("a stream ends with the job")


async def _ask(server: AsyncTransport, job_id: str, deadline: Deadline) -> AsyncGenerator[JobEvent, None]:
    """Requests the job once. The response arrives when the job's status changes."""
    wait = math.ceil(min(HOLD, deadline.left()))
    job: shapes.Job = await server.json("GET", job_path(job_id), params={"wait": wait, "include": "report"})
    progress = job.get("progress")
    if job["status"] in ENDED:
        yield JobEvent(done=job)
    elif progress is not None:
        heard: ProgressEvent = {**progress, "status": job["status"]}
        yield JobEvent(progress=heard)


async def _stream(server: AsyncTransport, job_id: str, deadline: Deadline) -> AsyncGenerator[JobEvent, None]:
    """Reads the event stream of a job (HTML standard, section 9.2.6) until it ends.

    Raises a `Problem` if the stream breaks before. Returns early when `HOLD` seconds are left.
    """
    timeout = httpx.Timeout(MAX_SILENCE, connect=10)
    headers, path = {"accept": "text/event-stream"}, f"{job_path(job_id)}/events?include=report"
    async with server.stream("GET", path, headers=headers, timeout=timeout) as response:
        name, data = "", list[str]()
        try:
            async for line in response.aiter_lines():
                field, _, value = line.partition(":")
                value = value.removeprefix(" ")
                if field == "event":
                    name = value
                elif field == "data":
                    data.append(value)
                elif not line and data:
                    if name == "done":
                        yield JobEvent(done=json.loads("\n".join(data)))
                    elif name == "progress":
                        yield JobEvent(progress=json.loads("\n".join(data)))
                    name, data = "", []
                if deadline.left() <= HOLD:
                    return
            raise httpx.RemoteProtocolError("the events ended before the job")
        except httpx.TransportError as error:
            raise Problem.unreachable(error) from error
