"""HTTP requests and responses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx

from .errors import Problem

#: Time limits in seconds to connect, and for silence of a connection.
TIMEOUT = httpx.Timeout(60, connect=10)


class Transport:
    """The address of the service and the key for it."""

    def __init__(self, base_url: str, api_key: str | None, transport: httpx.BaseTransport | None) -> None:
        headers = {"authorization": f"Bearer {api_key}"} if api_key else {}
        self.base_url = base_url.rstrip("/")
        self._http = httpx.Client(
            base_url=self.base_url, headers=headers, timeout=TIMEOUT, follow_redirects=True, transport=transport
        )

    def close(self) -> None:
        self._http.close()

    def ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        """Sends a request and reads the response. Raises a `Problem` unless the request succeeds."""
        with self.stream(method, path, **request) as response:
            try:
                response.read()
            except httpx.TransportError as error:
                raise Problem.unreachable(error) from error
            return response

    def json(self, method: str, path: str, **request: Any) -> Any:
        response = self.ask(method, path, **request)
        try:
            return response.json()
        except ValueError as error:
            raise Problem(response.status_code, "unexplained", "The response is not JSON.") from error

    @contextmanager
    def stream(self, method: str, path: str, **request: Any) -> Iterator[httpx.Response]:
        """Sends a request like `ask`, but leaves the body to the caller."""
        try:
            response = self._http.send(self._http.build_request(method, path, **request), stream=True)
        except httpx.TransportError as error:
            raise Problem.unreachable(error) from error
        try:
            if not response.is_success:
                try:
                    response.read()
                except httpx.TransportError as error:
                    raise Problem.unreachable(error) from error
                raise Problem.of(response)
            yield response
        finally:
            response.close()

    def put(self, url: str, headers: dict[str, str], content: Any) -> None:
        """Sends a file to a URL without the key. The URL may belong to a bucket."""
        request = self._http.build_request("PUT", url, headers=headers, content=content)
        request.headers.pop("authorization", None)
        try:
            response = self._http.send(request)
        except httpx.TransportError as error:
            raise Problem.unreachable(error) from error
        if not response.is_success:
            raise Problem.of(response)
