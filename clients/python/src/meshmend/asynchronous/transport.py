"""HTTP requests and responses."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, BinaryIO

import httpx

from ..errors import Problem

#: Time limits in seconds to connect, and for silence of a connection.
TIMEOUT = httpx.Timeout(60, connect=10)
#: Bytes that an upload reads at once.
PIECE = 1 << 16


class AsyncTransport:
    """The address of the service and the key for it."""

    def __init__(self, base_url: str, api_key: str | None, transport: httpx.AsyncBaseTransport | None) -> None:
        headers = {"authorization": f"Bearer {api_key}"} if api_key else {}
        self.base_url = base_url.rstrip("/")
        self._http = httpx.AsyncClient(
            base_url=self.base_url, headers=headers, timeout=TIMEOUT, follow_redirects=True, transport=transport
        )

    async def close(self) -> None:
        await self._http.aclose()

    async def ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        """Sends a request and reads the response. Raises a `Problem` unless the request succeeds."""
        async with self.stream(method, path, **request) as response:
            try:
                await response.aread()
            except httpx.TransportError as error:
                raise Problem.unreachable(error) from error
            return response

    async def json(self, method: str, path: str, **request: Any) -> Any:
        response = await self.ask(method, path, **request)
        try:
            return response.json()
        except ValueError as error:
            raise Problem(response.status_code, "unexplained", "The response is not JSON.") from error

    @asynccontextmanager
    async def stream(self, method: str, path: str, **request: Any) -> AsyncIterator[httpx.Response]:
        """Sends a request like `ask`, but leaves the body to the caller."""
        try:
            response = await self._http.send(self._http.build_request(method, path, **request), stream=True)
        except httpx.TransportError as error:
            raise Problem.unreachable(error) from error
        try:
            if not response.is_success:
                try:
                    await response.aread()
                except httpx.TransportError as error:
                    raise Problem.unreachable(error) from error
                raise Problem.of(response)
            yield response
        finally:
            await response.aclose()

    async def put(self, url: str, headers: dict[str, str], file: BinaryIO) -> None:
        """Sends a file to a URL without the key. The URL may belong to a bucket."""
        request = self._http.build_request("PUT", url, headers=headers, content=_pieces(file))
        request.headers.pop("authorization", None)
        try:
            response = await self._http.send(request)
        except httpx.TransportError as error:
            raise Problem.unreachable(error) from error
        if not response.is_success:
            raise Problem.of(response)


async def _pieces(file: BinaryIO) -> AsyncIterator[bytes]:
    while piece := file.read(PIECE):
        yield piece
