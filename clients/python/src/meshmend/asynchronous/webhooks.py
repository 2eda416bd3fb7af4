"""Webhook endpoints and deliveries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast
from urllib.parse import quote

from .. import shapes
from ..retry import Deadline
from .retries import retry_with_backoff
from .transport import AsyncTransport

ENDPOINTS = "/v1/webhook-endpoints"


class AsyncWebhooks:
    """The webhook endpoints and deliveries of the account.

    Requests that create something are not retried after a lost response. List the endpoints to see the result.
    """

    def __init__(self, server: AsyncTransport, timeout: float) -> None:
        self._server = server
        self._timeout = timeout

    async def list(self) -> Sequence[shapes.WebhookEndpoint]:
        return cast(shapes.WebhookEndpoints, await self._ask("GET", ENDPOINTS))["endpoints"]

    async def create(self, endpoint: shapes.NewWebhookEndpoint) -> shapes.WebhookEndpoint:
        """Creates an endpoint. Only this response contains the secret."""
        return cast(shapes.WebhookEndpoint, await self._ask("POST", ENDPOINTS, json=endpoint))

    async def get(self, endpoint_id: str) -> shapes.WebhookEndpoint:
        return cast(shapes.WebhookEndpoint, await self._ask("GET", _path(endpoint_id)))

    async def change(self, endpoint_id: str, change: shapes.WebhookEndpointChange) -> shapes.WebhookEndpoint:
        return cast(shapes.WebhookEndpoint, await self._ask("PATCH", _path(endpoint_id), json=change))

    async def delete(self, endpoint_id: str) -> None:
        await retry_with_backoff(
            lambda _: self._server.ask("DELETE", _path(endpoint_id)), Deadline(self._timeout), repeatable=False
        )

    async def rotate(self, endpoint_id: str) -> shapes.WebhookEndpoint:
        """Gives the endpoint a new secret. The old secret stays valid for a while."""
        return cast(shapes.WebhookEndpoint, await self._ask("POST", f"{_path(endpoint_id)}/rotate"))

    async def test(self, endpoint_id: str) -> shapes.WebhookDelivery:
        """Sends a test message to the endpoint."""
        return cast(shapes.WebhookDelivery, await self._ask("POST", f"{_path(endpoint_id)}/test"))

    async def deliveries(
        self, *, endpoint_id: str | None = None, job_id: str | None = None, cursor: str | None = None, limit: int = 50
    ) -> shapes.WebhookDeliveries:
        """Returns the deliveries to an endpoint or for a job."""
        path = "/v1/webhook-deliveries" if endpoint_id is None else f"{_path(endpoint_id)}/deliveries"
        asked = {"job": job_id, "cursor": cursor, "limit": limit}
        params = {key: value for key, value in asked.items() if value is not None}
        return cast(shapes.WebhookDeliveries, await self._ask("GET", path, params=params))

    async def redeliver(self, delivery_id: str) -> shapes.WebhookDelivery:
        path = f"/v1/webhook-deliveries/{quote(delivery_id, safe='')}/redeliver"
        return cast(shapes.WebhookDelivery, await self._ask("POST", path))

    async def secret(self) -> shapes.WebhookSecret:
        """Returns the secret that signs messages to a job's ``callback_url``."""
        return cast(shapes.WebhookSecret, await self._ask("GET", "/v1/webhook-secret"))

    async def rotate_secret(self) -> shapes.WebhookSecret:
        return cast(shapes.WebhookSecret, await self._ask("POST", "/v1/webhook-secret/rotate"))

    async def _ask(self, method: str, path: str, **request: Any) -> Any:
        repeatable = method == "GET"
        deadline = Deadline(self._timeout)
        return await retry_with_backoff(
            lambda _: self._server.json(method, path, **request), deadline, repeatable=repeatable
        )


def _path(endpoint_id: str) -> str:
    return f"{ENDPOINTS}/{quote(endpoint_id, safe='')}"
