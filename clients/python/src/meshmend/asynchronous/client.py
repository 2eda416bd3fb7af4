"""The asynchronous client of the HTTP API."""

from __future__ import annotations

import json
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, TypeAlias, cast
from urllib.parse import quote

import httpx

from .. import shapes
from ..errors import JobFailed, Problem
from ..events import ENDED, JobEvent, ProgressEvent, job_path
from ..model import File, Model
from ..retry import Deadline
from .job import AsyncJob
from .progress import follow, listen_to
from .retries import retry_with_backoff
from .transport import AsyncTransport
from .webhooks import AsyncWebhooks

#: A job's options: ``mode``, which is ``repair`` by default, and the options of that mode.
JobOptions: TypeAlias = shapes.Options | shapes.AnalyzeOptions | Mapping[str, object]

#: Default time limit of a job in seconds, from its submission to its end.
RUN = 900.0
#: Time limit in seconds to cancel a job after its caller gave up.
CANCEL_TIMEOUT = 5.0


class AsyncClient:
    """A client of one service. Tasks of one event loop may share a client.

    ``timeout`` is the time in seconds for a request with all its retries. ``transport`` is passed to httpx, for example
    for a proxy or for tests.
    """

    def __init__(
        self,
        base_url: str,
        api_key: str | None = None,
        *,
        timeout: float = 60.0,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        self.server = AsyncTransport(base_url, api_key, transport)
        self.timeout = timeout
        self.webhooks = AsyncWebhooks(self.server, timeout)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        await self.server.close()

    async def repair(
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
    ) -> AsyncJob:
        """Repairs a file: submits it, waits until the job ends, and returns the job.

        A partial or failed repair is not an error: check the job's ``outcome``. Raises `JobFailed` if the job did not
        succeed. Raises `JobTimeout` if the job takes longer than ``timeout``, and cancels the job.
        """
        asked = {**(options or {}), "mode": "repair"}
        deadline = Deadline(timeout)
        job = await self._submit([Model(file, name)], asked, deadline, idempotency_key, metadata, callback_url, fresh)
        return await self._run(job, deadline, on_progress)

    async def analyze(
        self,
        *files: File,
        options: shapes.AnalyzeOptions | None = None,
        on_progress: Callable[[ProgressEvent], object] | None = None,
        timeout: float = RUN,
        idempotency_key: str | None = None,
        metadata: Mapping[str, str] | None = None,
        callback_url: str | None = None,
    ) -> AsyncJob:
        """Analyses one or several files without changing them, and returns the job like `repair`."""
        asked = {**(options or {}), "mode": "analyze"}
        deadline = Deadline(timeout)
        models = [Model(file, None) for file in files]
        job = await self._submit(models, asked, deadline, idempotency_key, metadata, callback_url, False)
        return await self._run(job, deadline, on_progress)

    async def submit(
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
    ) -> AsyncJob:
        """Submits one or several files as a job, and returns without waiting for the job.

        Submitting again with the same ``idempotency_key`` creates no second job. By default each call has a new key.
        ``fresh`` ignores the stored result of an earlier job.
        """
        several = cast("Sequence[File]", files if isinstance(files, (list, tuple)) else [files])
        models = [Model(file, name) for file in several]
        deadline = self._deadline(timeout)
        return await self._submit(models, options or {}, deadline, idempotency_key, metadata, callback_url, fresh)

    async def submit_from(
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
    ) -> AsyncJob:
        """Submits a job for a file on the service: an upload, or a file of an earlier job."""
        asked: dict[str, object] = {"source": source, "options": options or {}, "metadata": metadata or {}}
        asked |= {key: value for key, value in (("callback_url", callback_url), ("name", name)) if value is not None}
        headers = _headers(idempotency_key, fresh)
        return await self._job(lambda: self.server.json("POST", "/v1/jobs", json=asked, headers=headers), timeout)

    async def upload(self, file: File, *, name: str | None = None, timeout: float | None = None) -> shapes.Upload:
        """Uploads a file without a job, directly to the bucket if the service uses one.

        `submit_from` creates the job.
        """
        model = Model(file, name)
        deadline = self._deadline(timeout)
        size = model.size()
        announced = {"name": model.name, "bytes": size}
        place: shapes.Upload = await retry_with_backoff(
            lambda _: self.server.json("POST", "/v1/uploads", json=announced), deadline
        )
        put = place["put"]
        # A bucket rejects a body without Content-Length.
        headers = {**put["headers"], "content-length": str(size)}

        async def send(tries: int) -> None:
            try:
                with model.open() as content:
                    await self.server.put(put["url"], headers, content)
            except Problem as problem:
                # The first attempt arrived, and only its response was lost.
                if tries == 1 or problem.code != "upload_used":
                    raise

        await retry_with_backoff(send, deadline)
        return place

    async def get(self, job: AsyncJob | str, *, timeout: float | None = None) -> AsyncJob:
        return await self._job(
            lambda: self.server.json("GET", job_path(_id(job)), params={"include": "report"}), timeout
        )

    async def wait(
        self,
        job: AsyncJob | str,
        *,
        on_progress: Callable[[ProgressEvent], object] | None = None,
        timeout: float | None = None,
    ) -> AsyncJob:
        """Waits until a job ends, and returns it whatever its status. The job goes on after a `JobTimeout`."""
        deadline = Deadline(RUN if timeout is None else timeout)
        return AsyncJob(self, await follow(self.server, _id(job), deadline, on_progress))

    def events(self, job: AsyncJob | str, *, timeout: float = RUN) -> AsyncIterator[JobEvent]:
        """Yields a job's progress, and at the end the job. Reconnects after a lost connection."""
        return listen_to(self.server, _id(job), Deadline(timeout))

    async def list(
        self, *, status: shapes.Status | None = None, page_size: int = 50, timeout: float | None = None
    ) -> AsyncIterator[AsyncJob]:
        """Yields all jobs without their reports, newest first."""
        asked: dict[str, Any] = {"limit": page_size, **({"status": status} if status else {})}
        while True:
            found: shapes.JobPage = await retry_with_backoff(
                lambda _: self.server.json("GET", "/v1/jobs", params=asked), self._deadline(timeout)
            )
            for data in found["jobs"]:
                yield AsyncJob(self, data)
            if found["next"] is None:
                return
            asked["cursor"] = found["next"]

    async def cancel(self, job: AsyncJob | str, *, timeout: float | None = None) -> AsyncJob:
        return await self._job(lambda: self.server.json("POST", f"{job_path(_id(job))}/cancel"), timeout)

    async def delete(self, job: AsyncJob | str, *, timeout: float | None = None) -> None:
        """Deletes a job's files and its report."""
        await retry_with_backoff(lambda _: self.server.ask("DELETE", job_path(_id(job))), self._deadline(timeout))

    async def capabilities(self, *, timeout: float | None = None) -> shapes.Capabilities:
        """Returns the formats, presets, tiers and limits of the service."""
        found: shapes.Capabilities = await retry_with_backoff(
            lambda _: self.server.json("GET", "/v1/capabilities"), self._deadline(timeout)
        )
        return found

    async def profiles(self, *, timeout: float | None = None) -> Sequence[shapes.ProcessProfile]:
        """Lists the built-in process profiles, then your own."""
        found: shapes.ProcessProfiles = await retry_with_backoff(
            lambda _: self.server.json("GET", "/v1/profiles"), self._deadline(timeout)
        )
        return found["profiles"]

    async def set_profile(
        self, name: str, limits: shapes.ProcessLimits, *, timeout: float | None = None
    ) -> shapes.ProcessProfile:
        """Creates or replaces a process profile of your own."""
        stored: shapes.ProcessProfile = await retry_with_backoff(
            lambda _: self.server.json("PUT", f"/v1/profiles/{quote(name, safe='')}", json=limits),
            self._deadline(timeout),
        )
        return stored

    async def delete_profile(self, name: str, *, timeout: float | None = None) -> None:
        """Deletes a process profile of your own."""
        await retry_with_backoff(
            lambda _: self.server.ask("DELETE", f"/v1/profiles/{quote(name, safe='')}"), self._deadline(timeout)
        )

    async def browser_token(
        self, asked: shapes.NewBrowserToken, *, timeout: float | None = None
    ) -> shapes.BrowserToken:
        """Creates a token for your web page. The token gives access only to the jobs that it created."""
        made: shapes.BrowserToken = await retry_with_backoff(
            lambda _: self.server.json("POST", "/v1/browser-tokens", json=asked), self._deadline(timeout)
        )
        return made

    def _deadline(self, timeout: float | None) -> Deadline:
        return Deadline(self.timeout if timeout is None else timeout)

    async def _job(self, ask: Callable[[], Awaitable[Any]], timeout: float | None) -> AsyncJob:
        return AsyncJob(self, await retry_with_backoff(lambda _: ask(), self._deadline(timeout)))

    async def _submit(
        self,
        models: Sequence[Model],
        options: Mapping[str, object],
        deadline: Deadline,
        idempotency_key: str | None,
        metadata: Mapping[str, str] | None,
        callback_url: str | None,
        fresh: bool,
    ) -> AsyncJob:
        headers = _headers(idempotency_key, fresh)
        fields = {"options": json.dumps(options)}
        if metadata:
            fields["metadata"] = json.dumps(dict(metadata))
        if callback_url is not None:
            fields["callback_url"] = callback_url

        async def send(_: int) -> shapes.Job:
            with ExitStack() as opened:
                # The service reads the options before the files.
                parts: list[tuple[str, Any]] = [(key, (None, value)) for key, value in fields.items()]
                parts += [("file", (model.name, opened.enter_context(model.open()))) for model in models]
                made: shapes.Job = await self.server.json("POST", "/v1/jobs", files=parts, headers=headers)
                return made

        return AsyncJob(self, await retry_with_backoff(send, deadline))

    async def _run(
        self, job: AsyncJob, deadline: Deadline, on_progress: Callable[[ProgressEvent], object] | None
    ) -> AsyncJob:
        try:
            # Also for an ended job: a job with a reused result has no report in this response.
            ended = AsyncJob(self, await follow(self.server, job.id, deadline, on_progress))
        except BaseException:
            if job.status not in ENDED:
                await self._cancel_abandoned(job)
            raise
        if ended.status != "succeeded":
            raise JobFailed(ended)
        return ended

    async def _cancel_abandoned(self, job: AsyncJob) -> None:
        # The job may have ended in the meantime, or the service may be unreachable.
        with suppress(Problem):
            await self.server.ask("POST", f"{job_path(job.id)}/cancel", timeout=CANCEL_TIMEOUT)


def _id(job: AsyncJob | str) -> str:
    return job if isinstance(job, str) else job.id


def _headers(idempotency_key: str | None, fresh: bool) -> dict[str, str]:
    headers = {"idempotency-key": idempotency_key or secrets.token_hex(16)}
    return {**headers, "cache-control": "no-cache"} if fresh else headers
