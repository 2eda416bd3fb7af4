"""The client."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, TypeAlias, cast

import httpx

from . import shapes
from .errors import JobFailed, Problem
from .events import ENDED, JobEvent, ProgressEvent, follow, job_path, listen_to
from .job import Job
from .model import File, Model
from .retry import Deadline, patiently
from .transport import Transport
from .webhooks import Webhooks

#: What a job is told: a mode, ``repair`` where it is left out, and that mode's options.
JobOptions: TypeAlias = shapes.Options | shapes.AnalyzeOptions | Mapping[str, object]

#: Seconds for a job from its submission to its end, where the call says nothing.
RUN = 900.0
#: Seconds for canceling a job that nobody waits for any more.
FAREWELL = 5.0


class Client:
    """A service, and who asks it. Threads may share one.

    ``timeout`` is the number of seconds within which a request that fails may be tried again; ``transport`` is httpx'
    own, for proxies, reasons and tests.
    """

    def __init__(
        self,
        base_url: str,
        api_key: str | None = None,
        *,
        timeout: float = 60.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self.server = Transport(base_url, api_key, transport)
        self.timeout = timeout
        self.webhooks = Webhooks(self.server, timeout)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self.server.close()

    def repair(
        self,
        file: File,
        options: shapes.Options | None = None,
        *,
        on_progress: Callable[[ProgressEvent], object] | None = None,
        timeout: float = RUN,
        idempotency_key: str | None = None,
        metadata: Mapping[str, str] | None = None,
        callback_url: str | None = None,
        fresh: bool = False,
        name: str | None = None,
    ) -> Job:
        """Sends a file, waits for the end of its repair, and returns the job.

        That a model could be repaired in part only, or not at all, is the job's ``outcome``. `JobFailed` is raised
        where it ends without one, `JobTimeout` where the time is over before; then the job is canceled.
        """
        asked = {**(options or {}), "mode": "repair"}
        deadline = Deadline(timeout)
        job = self._submit([Model(file, name)], asked, deadline, idempotency_key, metadata, callback_url, fresh)
        return self._run(job, deadline, on_progress)

    def analyze(
        self,
        *files: File,
        options: shapes.AnalyzeOptions | None = None,
        on_progress: Callable[[ProgressEvent], object] | None = None,
        timeout: float = RUN,
        idempotency_key: str | None = None,
        metadata: Mapping[str, str] | None = None,
        callback_url: str | None = None,
    ) -> Job:
        """The same for an analysis of one file or several, which are not changed."""
        asked = {**(options or {}), "mode": "analyze"}
        deadline = Deadline(timeout)
        models = [Model(file, None) for file in files]
        job = self._submit(models, asked, deadline, idempotency_key, metadata, callback_url, False)
        return self._run(job, deadline, on_progress)

    def submit(
        self,
        files: File | Sequence[File],
        options: JobOptions | None = None,
        *,
        timeout: float | None = None,
        idempotency_key: str | None = None,
        metadata: Mapping[str, str] | None = None,
        callback_url: str | None = None,
        fresh: bool = False,
        name: str | None = None,
    ) -> Job:
        """Makes a job of one file or several, and returns as soon as the service has them.

        A submission sent again with the same ``idempotency_key`` makes no second job; one is made for each call where
        none is given. ``fresh`` has the work done even where an earlier job has the result.
        """
        several = cast("Sequence[File]", files if isinstance(files, (list, tuple)) else [files])
        models = [Model(file, name) for file in several]
        deadline = self._deadline(timeout)
        return self._submit(models, options or {}, deadline, idempotency_key, metadata, callback_url, fresh)

    def submit_from(
        self,
        source: shapes.Source,
        options: JobOptions | None = None,
        *,
        timeout: float | None = None,
        idempotency_key: str | None = None,
        metadata: Mapping[str, str] | None = None,
        callback_url: str | None = None,
        fresh: bool = False,
        name: str | None = None,
    ) -> Job:
        """Makes a job of a file that the service has: an upload, or a file of an earlier job."""
        asked: dict[str, object] = {"source": source, "options": options or {}, "metadata": metadata or {}}
        asked |= {key: it for key, it in (("callback_url", callback_url), ("name", name)) if it is not None}
        headers = _headers(idempotency_key, fresh)
        return self._job(lambda: self.server.json("POST", "/v1/jobs", json=asked, headers=headers), timeout)

    def upload(self, file: File, *, name: str | None = None, timeout: float | None = None) -> shapes.Upload:
        """Sends a file before there is a job of it, straight to the bucket where there is one.

        `submit_from` makes the job.
        """
        model = Model(file, name)
        deadline = self._deadline(timeout)
        size = model.size()
        announced = {"name": model.name, "bytes": size}
        place: shapes.Upload = patiently(lambda _: self.server.json("POST", "/v1/uploads", json=announced), deadline)
        put = place["put"]
        # A bucket takes no body whose length it is not told.
        headers = {**put["headers"], "content-length": str(size)}

        def send(tries: int) -> None:
            try:
                with model.open() as content:
                    self.server.put(put["url"], headers, content)
            except Problem as problem:
                # It had come, and only the answer was lost.
                if tries == 1 or problem.code != "upload_used":
                    raise

        patiently(send, deadline)
        return place

    def get(self, job: Job | str, *, timeout: float | None = None) -> Job:
        return self._job(lambda: self.server.json("GET", job_path(_id(job)), params={"include": "report"}), timeout)

    def wait(
        self,
        job: Job | str,
        *,
        on_progress: Callable[[ProgressEvent], object] | None = None,
        timeout: float | None = None,
    ) -> Job:
        """The job as it ended, however it ended. A job may be named by its id. `JobTimeout` leaves the job running."""
        deadline = Deadline(RUN if timeout is None else timeout)
        return Job(self, follow(self.server, _id(job), deadline, on_progress))

    def events(self, job: Job | str, *, timeout: float = RUN) -> Iterator[JobEvent]:
        """A job's progress as it comes, and at last the job; a connection that breaks is made again."""
        return listen_to(self.server, _id(job), Deadline(timeout))

    def list(
        self, *, status: shapes.Status | None = None, page_size: int = 50, timeout: float | None = None
    ) -> Iterator[Job]:
        """All jobs, the newest first; without their reports."""
        asked: dict[str, Any] = {"limit": page_size, **({"status": status} if status else {})}
        while True:
            found: shapes.JobPage = patiently(
                lambda _: self.server.json("GET", "/v1/jobs", params=asked), self._deadline(timeout)
            )
            for data in found["jobs"]:
                yield Job(self, data)
            if found["next"] is None:
                return
            asked["cursor"] = found["next"]

    def cancel(self, job: Job | str, *, timeout: float | None = None) -> Job:
        return self._job(lambda: self.server.json("POST", f"{job_path(_id(job))}/cancel"), timeout)

    def delete(self, job: Job | str, *, timeout: float | None = None) -> None:
        """Deletes a job's files and its report."""
        patiently(lambda _: self.server.ask("DELETE", job_path(_id(job))), self._deadline(timeout))

    def capabilities(self, *, timeout: float | None = None) -> shapes.Capabilities:
        """What the service can do now: formats, presets, tiers, limits."""
        found: shapes.Capabilities = patiently(
            lambda _: self.server.json("GET", "/v1/capabilities"), self._deadline(timeout)
        )
        return found

    def browser_token(self, asked: shapes.NewBrowserToken, *, timeout: float | None = None) -> shapes.BrowserToken:
        """A token for a page of yours, which shows only the jobs that were made with it."""
        made: shapes.BrowserToken = patiently(
            lambda _: self.server.json("POST", "/v1/browser-tokens", json=asked), self._deadline(timeout)
        )
        return made

    def _deadline(self, timeout: float | None) -> Deadline:
        return Deadline(self.timeout if timeout is None else timeout)

    def _job(self, ask: Callable[[], Any], timeout: float | None) -> Job:
        return Job(self, patiently(lambda _: ask(), self._deadline(timeout)))

    def _submit(
        self,
        models: Sequence[Model],
        options: Mapping[str, object],
        deadline: Deadline,
        idempotency_key: str | None,
        metadata: Mapping[str, str] | None,
        callback_url: str | None,
        fresh: bool,
    ) -> Job:
        headers = _headers(idempotency_key, fresh)
        fields = {"options": json.dumps(options)}
        if metadata:
            fields["metadata"] = json.dumps(dict(metadata))
        if callback_url is not None:
            fields["callback_url"] = callback_url

        def send(_: int) -> shapes.Job:
            with ExitStack() as opened:
                # The service reads the options before it takes a file.
                parts: list[tuple[str, Any]] = [(key, (None, value)) for key, value in fields.items()]
                parts += [("file", (it.name, opened.enter_context(it.open()))) for it in models]
                made: shapes.Job = self.server.json("POST", "/v1/jobs", files=parts, headers=headers)
                return made

        return Job(self, patiently(send, deadline))

    def _run(self, job: Job, deadline: Deadline, on_progress: Callable[[ProgressEvent], object] | None) -> Job:
        try:
            # Also where it has ended: what was taken from an earlier job has no report here yet.
            ended = Job(self, follow(self.server, job.id, deadline, on_progress))
        except BaseException:
            if job.status not in ENDED:
                self._farewell(job)
            raise
        if ended.status != "succeeded":
            raise JobFailed(ended)
        return ended

    def _farewell(self, job: Job) -> None:
        # It may have ended meanwhile, or nobody can tell the service.
        with suppress(Problem):
            self.server.ask("POST", f"{job_path(job.id)}/cancel", timeout=FAREWELL)


def _id(job: Job | str) -> str:
    return job if isinstance(job, str) else job.id


def _headers(idempotency_key: str | None, fresh: bool) -> dict[str, str]:
    headers = {"idempotency-key": idempotency_key or secrets.token_hex(16)}
    return {**headers, "cache-control": "no-cache"} if fresh else headers
