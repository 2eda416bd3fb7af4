"""A job and its files."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import httpx

from .. import shapes
from ..errors import DamagedDownload, MeshmendError, Problem
from ..events import ProgressEvent
from ..retry import Deadline
from .retries import retry_with_backoff

if TYPE_CHECKING:
    from .client import AsyncClient


class AsyncJob:
    """A job as in the latest response; `data` has the whole JSON of the service."""

    def __init__(self, client: AsyncClient, data: shapes.Job) -> None:
        self._client = client
        self.data = data

    def __repr__(self) -> str:
        return f"<Job {self.id} {self.outcome or self.status}>"

    @property
    def id(self) -> str:
        return self.data["id"]

    @property
    def status(self) -> shapes.Status:
        return self.data["status"]

    @property
    def outcome(self) -> shapes.JobOutcome | None:
        """The outcome, once the job succeeded, or failed because of ``require``."""
        return self.data["outcome"]

    @property
    def is_printable(self) -> bool:
        """Whether the model is printable; for an analysis, whether every file is."""
        return self.outcome in ("already_printable", "repaired", "printable")

    @property
    def quote(self) -> shapes.Quote | None:
        """What a shop needs to price the model, such as size and volume. None before the job has a report."""
        return self.data.get("quote")

    @property
    def progress(self) -> shapes.Progress | None:
        return self.data["progress"]

    @property
    def problem(self) -> shapes.JobProblem | None:
        """The reason why the job failed."""
        return self.data["problem"]

    @property
    def artifacts(self) -> Mapping[str, shapes.ArtifactLink]:
        """The files to download, by name."""
        return self.data["artifacts"]

    @property
    def report(self) -> shapes.RepairReport:
        """The report of an ended repair."""
        report = self.data.get("report")
        if report is None or report["mode"] != "repair":
            raise MeshmendError(f"The job '{self.id}' has no repair report.")
        return report

    @property
    def analysis(self) -> shapes.AnalyzeReport:
        """The report of an ended analysis."""
        report = self.data.get("report")
        if report is None or report["mode"] != "analyze":
            raise MeshmendError(f"The job '{self.id}' has no analysis report.")
        return report

    async def wait(
        self, *, on_progress: Callable[[ProgressEvent], object] | None = None, timeout: float | None = None
    ) -> AsyncJob:
        """Waits until the job ends, and returns it whatever its status."""
        return await self._client.wait(self.id, on_progress=on_progress, timeout=timeout)

    async def cancel(self) -> AsyncJob:
        return await self._client.cancel(self.id)

    async def delete(self) -> None:
        """Deletes the job's files and its report."""
        await self._client.delete(self.id)

    async def download(self, name: str = "model", *, timeout: float | None = None) -> bytes:
        """Downloads a file of the job, such as ``report.json``, and verifies its SHA-256."""
        pieces: list[bytes] = []
        await self._fetch(name, pieces.clear, pieces.append, timeout)
        return b"".join(pieces)

    async def save(self, path: str | os.PathLike[str], name: str = "model", *, timeout: float | None = None) -> None:
        """Streams a file of the job to the disk and verifies its SHA-256. An error leaves no partial file."""
        part = f"{os.fspath(path)}.part"
        try:
            with open(part, "wb") as file:

                def restart() -> None:
                    file.seek(0)
                    file.truncate()

                await self._fetch(name, restart, file.write, timeout)
            os.replace(part, path)
        except BaseException:
            if os.path.exists(part):
                os.remove(part)
            raise

    async def _fetch(
        self, name: str, restart: Callable[[], object], write: Callable[[bytes], object], timeout: float | None
    ) -> None:
        artifact = self.artifacts.get(name)
        if artifact is None:
            names = ", ".join(self.artifacts) or "none"
            raise MeshmendError(f"The job '{self.id}' has no file '{name}'; it has {names}.")
        href = artifact["href"]

        async def fetch(_: int) -> str:
            restart()
            found = hashlib.sha256()
            async with self._client.server.stream("GET", href) as response:
                try:
                    async for piece in response.aiter_bytes():
                        found.update(piece)
                        write(piece)
                except httpx.TransportError as error:
                    raise Problem.unreachable(error) from error
            return found.hexdigest()

        found = await retry_with_backoff(fetch, Deadline(self._client.timeout if timeout is None else timeout))
        # Pictures have no SHA-256.
        if found != artifact.get("sha256", found):
            raise DamagedDownload(
                f"The download of '{artifact['filename']}' is damaged: its SHA-256 differs from the job's."
            )
