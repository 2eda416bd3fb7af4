"""Progress of running jobs."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import quote

from typing_extensions import NotRequired

from . import shapes

ENDED = frozenset(("succeeded", "failed", "canceled", "expired"))


class ProgressEvent(shapes.Progress):
    """Progress of a job."""

    status: NotRequired[shapes.Status]


@dataclass(frozen=True)
class JobEvent:
    """Either the progress of a job, or the ended job."""

    progress: ProgressEvent | None = None
    done: shapes.Job | None = None


def job_path(job_id: str) -> str:
    return f"/v1/jobs/{quote(job_id, safe='')}"
