"""What is heard of a job while it runs."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from urllib.parse import quote

import httpx
from typing_extensions import NotRequired

from . import shapes
from .errors import JobTimeout, Problem
from .retry import Deadline, pause_after
from .transport import Transport

#: The service says something every 15 seconds; a stream that is silent for longer than this has broken without a word.
SILENCE = 45.0
#: Longest that an answer is held back.
HOLD = 20.0
ENDED = frozenset(("succeeded", "failed", "canceled", "expired"))


class ProgressEvent(shapes.Progress):
    """How far a job is."""

    status: NotRequired[shapes.Status]


@dataclass(frozen=True)
class JobEvent:
    """Progress, or at last the job as it ended: one of them."""

    progress: ProgressEvent | None = None
    done: shapes.Job | None = None


def listen_to(server: Transport, job_id: str, deadline: Deadline) -> Iterator[JobEvent]:
    """Listens to a job until its end: by its events, or where a proxy holds those back, by asking.

    A connection that breaks is made again, and then the present state is told first.
    """
    streaming, has_streamed, failures = True, False, 0
    while deadline.left() > 0:
        # The last seconds are for asking, which can be held for just as long.
        streaming = streaming and deadline.left() > HOLD
        heard = False
        try:
            for event in (_stream if streaming else _ask)(server, job_id, deadline):
                heard = True
                has_streamed = has_streamed or streaming
                yield event
                if event.done is not None:
                    return
            failures, streaming = 0, has_streamed
        except Problem as problem:
            if not problem.is_passing:
                raise
            failures = 1 if heard else failures + 1
            # Where nothing was heard something may hold it back, and the other way is tried.
            streaming = streaming if heard else not streaming
            time.sleep(min(pause_after(failures, problem), deadline.left()))
    raise JobTimeout(f"The job '{job_id}' did not end in time.")


def follow(
    server: Transport, job_id: str, deadline: Deadline, on_progress: Callable[[ProgressEvent], object] | None
) -> shapes.Job:
    """Follows a job to its end."""
    for event in listen_to(server, job_id, deadline):
        if event.done is not None:
            return event.done
        if event.progress is not None and on_progress is not None:
            on_progress(event.progress)
    raise AssertionError("a stream ends with the job")


def job_path(job_id: str) -> str:
    return f"/v1/jobs/{quote(job_id, safe='')}"


def _ask(server: Transport, job_id: str, deadline: Deadline) -> Iterator[JobEvent]:
    """Asks once, with an answer that is held until the job's status changes."""
    wait = math.ceil(min(HOLD, deadline.left()))
    job: shapes.Job = server.json("GET", job_path(job_id), params={"wait": wait, "include": "report"})
    progress = job.get("progress")
    if job["status"] in ENDED:
        yield JobEvent(done=job)
    elif progress is not None:
        heard: ProgressEvent = {**progress, "status": job["status"]}
        yield JobEvent(progress=heard)


def _stream(server: Transport, job_id: str, deadline: Deadline) -> Iterator[JobEvent]:
    """The stream of a job's events (HTML, 9.2.6), as far as the service uses them, to its end.

    A problem where it breaks before. It ends without a word when the last seconds have come.
    """
    timeout = httpx.Timeout(SILENCE, connect=10)
    headers, path = {"accept": "text/event-stream"}, f"{job_path(job_id)}/events?include=report"
    with server.stream("GET", path, headers=headers, timeout=timeout) as response:
        name, data = "", list[str]()
        try:
            for line in response.iter_lines():
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
