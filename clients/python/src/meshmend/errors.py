"""What may go wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias

import httpx

from .shapes import FieldError, ProblemCode

if TYPE_CHECKING:
    from .job import Job

#: The codes of the service, and two of ours. A later service may have more, which are plain text then.
Code: TypeAlias = ProblemCode | Literal["unreachable", "unexplained"]


class MeshmendError(Exception):
    """Whatever this package raises."""


class Problem(MeshmendError):
    """Why the service refused or failed, in its own words (RFC 9457), or in ours where it said nothing."""

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
        super().__init__(f"{detail or title or 'the service can not be reached'} ({code})")
        #: The HTTP status; 0 where there was no answer.
        self.status = status
        self.code = code
        self.title = title
        self.detail = detail
        #: Seconds after which to try again, if the service said so.
        self.retry_after = retry_after
        self.request_id = request_id
        #: What is wrong with each field, where fields are wrong.
        self.errors = errors or []

    @property
    def is_passing(self) -> bool:
        """Whether the same request may work a little later."""
        return self.code in ("unreachable", "idempotency_key_in_use") or self.status in (429, 502, 503, 504)

    @classmethod
    def unreachable(cls, error: Exception) -> Problem:
        return cls(0, "unreachable", detail=str(error))

    @classmethod
    def of(cls, response: httpx.Response) -> Problem:
        """Of an answer that is no success and was read."""
        after = response.headers.get("retry-after", "")
        retry_after = int(after) if after.isdecimal() else None
        try:
            body = response.json()
            code = body["code"]
        except (ValueError, KeyError, TypeError):
            # Some proxy's page.
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
    """That a job ended without a result: it failed, was canceled, or its files are gone.

    With the option ``require`` it also fails where its result is not what was required;
    then ``job.report`` says what is left.
    """

    def __init__(self, job: Job) -> None:
        super().__init__(job.problem["detail"] if job.problem else f"The job '{job.id}' is {job.status}.")
        self.job = job


class JobTimeout(MeshmendError, TimeoutError):
    """That a job did not end in the time that was given."""


class DamagedDownload(MeshmendError):
    """That bytes are not those that the job names."""
