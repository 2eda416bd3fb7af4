"""The synchronous client of the HTTP API."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, TypeAlias, cast
from urllib.parse import quote

import httpx

from . import shapes
from .errors import JobFailed, Problem
from .events import ENDED, JobEvent, ProgressEvent, follow, job_path, listen_to
from .job import Job
from .model import File, Model
from .retry import Deadline, retry_with_backoff
from .transport import Transport
from .webhooks import Webhooks

#: A job's options: ``mode``, which is ``repair`` by default, and the options of that mode.
JobOptions: TypeAlias = shapes.Options | shapes.AnalyzeOptions | Mapping[str, object]

#: Default time limit of a job in seconds, from its submission to its end.
RUN = 900.0
#: Time limit in seconds to cancel a job after its caller gave up.
CANCEL_TIMEOUT = 5.0


class Client:
    """A client of one service. Threads may share a client.

    ``timeout`` is the time in seconds for a request with all its retries. ``transport`` is passed to httpx, for example
    for a proxy or for tests.
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
        """Repairs a file: submits it, waits until the job ends, and returns the job.

        A partial or failed repair is not an error: check the job's ``outcome``. Raises `JobFailed` if the job did not
        succeed. Raises `JobTimeout` if the job takes longer than ``timeout``, and cancels the job.
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
        """Analyses one or several files without changing them, and returns the job like `repair`."""
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
        """Submits one or several files as a job, and returns without waiting for the job.

        Submitting again with the same ``idempotency_key`` creates no second job. By default each call has a new key.
        ``fresh`` ignores the stored result of an earlier job.
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
        """Submits a job for a file on the service: an upload, or a file of an earlier job."""
        asked: dict[str, object] = {"source": source, "options": options or {}, "metadata": metadata or {}}
        asked |= {key: value for key, value in (("callback_url", callback_url), ("name", name)) if value is not None}
        headers = _headers(idempotency_key, fresh)
        return self._job(lambda: self.server.json("POST", "/v1/jobs", json=asked, headers=headers), timeout)

    def upload(self, file: File, *, name: str | None = None, timeout: float | None = None) -> shapes.Upload:
        """Uploads a file without a job, directly to the bucket if the service uses one.

        `submit_from` creates the job.
        """
        model = Model(file, name)
        deadline = self._deadline(timeout)
        size = model.size()
        announced = {"name": model.name, "bytes": size}
        place: shapes.Upload = retry_with_backoff(
            lambda _: self.server.json("POST", "/v1/uploads", json=announced), deadline
        )
        put = place["put"]
        # A bucket rejects a body without Content-Length.
        headers = {**put["headers"], "content-length": str(size)}

        def send(tries: int) -> None:
            try:
                with model.open() as content:
                    self.server.put(put["url"], headers, content)
            except Problem as problem:
                # The first attempt arrived, and only its response was lost.
                if tries == 1 or problem.code != "upload_used":
                    raise

        retry_with_backoff(send, deadline)
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
        """Waits until a job ends, and returns it whatever its status. The job goes on after a `JobTimeout`."""
        deadline = Deadline(RUN if timeout is None else timeout)
        return Job(self, follow(self.server, _id(job), deadline, on_progress))

    def events(self, job: Job | str, *, timeout: float = RUN) -> Iterator[JobEvent]:
        """Yields a job's progress, and at the end the job. Reconnects after a lost connection."""
        return listen_to(self.server, _id(job), Deadline(timeout))

    def list(
        self, *, status: shapes.Status | None = None, page_size: int = 50, timeout: float | None = None
    ) -> Iterator[Job]:
        """Yields all jobs without their reports, newest first."""
        asked: dict[str, Any] = {"limit": page_size, **({"status": status} if status else {})}
        while True:
            found: shapes.JobPage = retry_with_backoff(
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
        retry_with_backoff(lambda _: self.server.ask("DELETE", job_path(_id(job))), self._deadline(timeout))

    def capabilities(self, *, timeout: float | None = None) -> shapes.Capabilities:
        """Returns the formats, presets, tiers and limits of the service."""
        found: shapes.Capabilities = retry_with_backoff(
            lambda _: self.server.json("GET", "/v1/capabilities"), self._deadline(timeout)
        )
        return found

    def profiles(self, *, timeout: float | None = None) -> Sequence[shapes.ProcessProfile]:
        """Lists the built-in process profiles, then your own."""
        found: shapes.ProcessProfiles = retry_with_backoff(
            lambda _: self.server.json("GET", "/v1/profiles"), self._deadline(timeout)
        )
        return found["profiles"]

    def set_profile(
        self, name: str, limits: shapes.ProcessLimits, *, timeout: float | None = None
    ) -> shapes.ProcessProfile:
        """Creates or replaces a process profile of your own."""
        stored: shapes.ProcessProfile = retry_with_backoff(
            lambda _: self.server.json("PUT", f"/v1/profiles/{quote(name, safe='')}", json=limits),
            self._deadline(timeout),
        )
        return stored

    def delete_profile(self, name: str, *, timeout: float | None = None) -> None:
        """Deletes a process profile of your own."""
        retry_with_backoff(
            lambda _: self.server.ask("DELETE", f"/v1/profiles/{quote(name, safe='')}"), self._deadline(timeout)
        )

    def browser_token(self, asked: shapes.NewBrowserToken, *, timeout: float | None = None) -> shapes.BrowserToken:
        """Creates a token for your web page. The token gives access only to the jobs that it created."""
        made: shapes.BrowserToken = retry_with_backoff(
            lambda _: self.server.json("POST", "/v1/browser-tokens", json=asked), self._deadline(timeout)
        )
        return made

    def _deadline(self, timeout: float | None) -> Deadline:
        return Deadline(self.timeout if timeout is None else timeout)

    def _job(self, ask: Callable[[], Any], timeout: float | None) -> Job:
        return Job(self, retry_with_backoff(lambda _: ask(), self._deadline(timeout)))

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
                # The service reads the options before the files.
                parts: list[tuple[str, Any]] = [(key, (None, value)) for key, value in fields.items()]
                parts += [("file", (model.name, opened.enter_context(model.open()))) for model in models]
                made: shapes.Job = self.server.json("POST", "/v1/jobs", files=parts, headers=headers)
                return made

        return Job(self, retry_with_backoff(send, deadline))

    def _run(self, job: Job, deadline: Deadline, on_progress: Callable[[ProgressEvent], object] | None) -> Job:
        try:
            # Also for an ended job: a job with a reused result has no report in this response.
            ended = Job(self, follow(self.server, job.id, deadline, on_progress))
        except BaseException:
            if job.status not in ENDED:
                self._cancel_abandoned(job)
            raise
        if ended.status != "succeeded":
            raise JobFailed(ended)
        return ended

    def _cancel_abandoned(self, job: Job) -> None:
        # The job may have ended in the meantime, or the service may be unreachable.
        with suppress(Problem):
            self.server.ask("POST", f"{job_path(job.id)}/cancel", timeout=CANCEL_TIMEOUT)


def _id(job: Job | str) -> str:
    return job if isinstance(job, str) else job.id


def _headers(idempotency_key: str | None, fresh: bool) -> dict[str, str]:
    headers = {"idempotency-key": idempotency_key or secrets.token_hex(16)}
    return {**headers, "cache-control": "no-cache"} if fresh else headers
