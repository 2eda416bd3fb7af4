"""The asynchronous client against the built program. The synchronous one, generated from it, has the other tests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from conftest import box, flaky, serve

from meshmend import AsyncClient, JobTimeout, MeshmendError, Problem, ProgressEvent, shapes

QUICK: shapes.Options = {"pictures": False}


def run(service: str, work: Callable[[AsyncClient], Awaitable[None]]) -> None:
    async def with_client() -> None:
        async with AsyncClient(service) as client:
            await work(client)

    asyncio.run(with_client())


def test_models_are_repaired_at_once_with_progress_and_saved(service: str, tmp_path: Path) -> None:
    heard: list[ProgressEvent] = []

    async def work(client: AsyncClient) -> None:
        calls = (client.repair(box(without=n), QUICK, on_progress=heard.append) for n in (0, 1))
        jobs = await asyncio.gather(*calls)
        assert [job.outcome for job in jobs] == ["already_printable", "repaired"]
        await jobs[0].save(tmp_path / "box.stl")
        assert (tmp_path / "box.stl").read_bytes() == await jobs[0].download()
        with pytest.raises(MeshmendError, match="has no file 'none.png'"):
            await jobs[0].download("none.png")
        found = [job.id async for job in client.list(page_size=1)]
        assert {job.id for job in jobs} <= set(found)
        events = [event async for event in client.events(jobs[1])]
        assert events[-1].done is not None and events[-1].done["id"] == jobs[1].id

    run(service, work)
    assert heard


def test_an_upload_is_sent_in_pieces_and_becomes_a_job(service: str) -> None:
    async def work(client: AsyncClient) -> None:
        place = await client.upload(box(), name="box.stl")
        job = await client.submit_from({"upload_id": place["id"]}, QUICK)
        assert (await job.wait()).outcome == "already_printable"
        with pytest.raises(Problem) as refused:
            await client.get("unknown")
        assert refused.value.status == 404
        assert isinstance(await client.webhooks.list(), list)

    run(service, work)


def test_lost_requests_and_responses_of_coroutines_create_one_job(service: str) -> None:
    with flaky(service, lambda method, path: (method, path) == ("POST", "/v1/jobs"), "drop", 503, "lose") as proxy:

        async def work(client: AsyncClient) -> None:
            assert (await client.repair(box(), QUICK)).outcome == "already_printable"

        run(proxy.url, work)
        assert len(proxy.seen) == 4 and len({key for _, key in proxy.seen}) == 1


def test_a_cancelled_task_cancels_its_job_and_so_does_a_timeout(tmp_path: Path) -> None:
    async def work(client: AsyncClient) -> None:
        task = asyncio.ensure_future(client.repair(box(), QUICK))
        while not [job async for job in client.list()]:
            await asyncio.sleep(0.02)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        with pytest.raises(JobTimeout):
            await client.repair(box(), QUICK, timeout=0.5)
        assert [job.status async for job in client.list()] == ["canceled", "canceled"]

    with serve(tmp_path, "--no-workers") as address:
        run(address, work)
