"""Exceptions of this package."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias

import httpx

from .shapes import FieldError, ProblemCode

if TYPE_CHECKING:
    from .asynchronous.job import AsyncJob
    from .synchronous.job import Job

#: What is wrong with a model, for programs.
ReadErrorKind: TypeAlias = Literal[
    "empty",
    "unknown_format",
    "unsupported_format",
    "truncated",
    "malformed",
    "index_out_of_range",
    "too_large",
    "no_faces",
]

#: The service's error codes, and two codes of this package. A later service may send further codes.
Code: TypeAlias = ProblemCode | Literal["unreachable", "unexplained"]


class MeshmendError(Exception):
    """Base class of all exceptions of this package."""


class Problem(MeshmendError):
    """An error response of the service (RFC 9457), or the reason why there was no response."""

    def __init__(
        self,
        status: int,
        code: Code,
        title: str = "",
        detail: str = "",
        *,
        retry_after: int | None = None,
        request_id: str | None = None,
        errors: list[FieldError] | None = None,
    ) -> None:
        super().__init__(f"{detail or title or 'the service cannot be reached'} ({code})")
        #: The HTTP status; 0 without a response.
        self.status = status
        self.code = code
        self.title = title
        self.detail = detail
        #: Seconds to wait before a retry, if the service states them.
        self.retry_after = retry_after
        self.request_id = request_id
        #: The invalid fields of the request, and the error of each.
        self.errors = errors or []

    @property
    def is_transient(self) -> bool:
        """Whether the same request may succeed later."""
        return self.code in ("unreachable", "idempotency_key_in_use") or self.status in (429, 502, 503, 504)

    @classmethod
    def unreachable(cls, error: Exception) -> Problem:
        return cls(0, "unreachable", detail=str(error))

    @classmethod
    def of(cls, response: httpx.Response) -> Problem:
        """Creates the problem of an error response whose body has been read."""
        after = response.headers.get("retry-after", "")
        retry_after = int(after) if after.isdecimal() else None
        try:
            body = response.json()
            code = body["code"]
        except (ValueError, KeyError, TypeError):
            # The response of a proxy.
            return cls(response.status_code, "unexplained", f"HTTP {response.status_code}", retry_after=retry_after)
        return cls(
            response.status_code,
            code,
            body.get("title", ""),
            body.get("detail", ""),
            retry_after=retry_after,
            request_id=body.get("request_id"),
            errors=body.get("errors"),
        )


class JobFailed(MeshmendError):
    """A job did not succeed: it failed, was canceled, or its files have expired.

    A job also fails if its result does not meet the option ``require``. Then ``job.report`` lists the remaining
    defects.
    """

    def __init__(self, job: Job | AsyncJob) -> None:
        super().__init__(job.problem["detail"] if job.problem else f"The job '{job.id}' is {job.status}.")
        self.job = job


class JobTimeout(MeshmendError, TimeoutError):
    """A job did not end within the time limit."""


class DamagedDownload(MeshmendError):
    """The SHA-256 of a downloaded file differs from the one in the job."""


class InvalidOption(MeshmendError, ValueError):
    """An option of a call to the engine has an unknown name, a wrong type, or a value out of range."""

    def __init__(self, message: str, option: str) -> None:
        super().__init__(message)
        #: The option's name.
        self.option = option


class InvalidModel(MeshmendError, ValueError):
    """A model that the engine cannot read."""

    def __init__(
        self, message: str, kind: ReadErrorKind = "malformed", byte: int | None = None, line: int | None = None
    ) -> None:
        super().__init__(message)
        #: What is wrong, for programs.
        self.kind = kind
        #: Where in the file, as an offset in bytes; None if unknown.
        self.byte = byte
        #: Where in the file, as a line counted from 1; None if unknown.
        self.line = line


class DeadlineExceeded(MeshmendError, TimeoutError):
    """The deadline of a call to the engine passed before there was a result."""


class Cancellation(MeshmendError):
    """The ``cancel`` event of a call to the engine was set."""


class EngineFailure(MeshmendError):
    """The engine has no result for another reason, for example because the output format cannot hold the model."""
