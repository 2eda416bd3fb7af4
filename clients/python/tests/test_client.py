"""The client against the built program."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import threading
from pathlib import Path

import pytest
from conftest import PROGRAM, box, flaky, serve

from meshmend import Client, DamagedDownload, Job, JobFailed, JobTimeout, MeshmendError, Problem, ProgressEvent, shapes

QUICK: shapes.Options = {"pictures": False}
#: A model whose defect only a full read finds.
LATE_BREAK = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"


@pytest.fixture
def client(service: str) -> Client:
    return Client(service)


def is_submission(method: str, path: str) -> bool:
    return (method, path) == ("POST", "/v1/jobs")


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_a_broken_model_is_repaired_with_progress_and_the_download_matches_its_sha256(
    client: Client, tmp_path: Path
) -> None:
    heard: list[ProgressEvent] = []
    broken = tmp_path / "box.stl"
    broken.write_bytes(box(without=1))
    job = client.repair(broken, {"output": "obj"}, on_progress=heard.append, metadata={"order": "7"})
    assert job.outcome == "repaired"
    after = job.report["after"]
    assert after is not None and after["closed"]
    assert (job.data["input"]["name"], job.data["metadata"]) == ("box.stl", {"order": "7"})
    assert heard and all(it["percent"] <= 100 and it["status"] in ("queued", "running") for it in heard)
    expected = job.artifacts["model"]["sha256"]
    assert sha256(job.download()) == expected
    job.save(tmp_path / "box.obj")
    assert sha256((tmp_path / "box.obj").read_bytes()) == expected
    assert json.loads(job.download("report.json"))["outcome"] == "repaired"
    with pytest.raises(MeshmendError, match="has no file 'none.png'; it has .*model"):
        job.download("none.png")
    with pytest.raises(MeshmendError, match="no analysis report"):
        _ = job.analysis
    link: shapes.ArtifactLink = {**job.artifacts["model"], "sha256": "0" * 64}
    other = Job(client, {**job.data, "artifacts": {"model": link}})
    with pytest.raises(DamagedDownload):
        other.download()
    with pytest.raises(DamagedDownload):
        other.save(tmp_path / "damaged.obj")
    assert sorted(it.name for it in tmp_path.iterdir()) == ["box.obj", "box.stl"]


def test_the_same_idempotency_key_creates_one_job_and_another_call_a_second(client: Client) -> None:
    first = client.submit(box(), QUICK, idempotency_key="order-1")
    assert client.submit(box(), QUICK, idempotency_key="order-1").id == first.id
    assert client.submit(box(), QUICK).id != first.id
    with pytest.raises(Problem) as refused:
        client.submit(box(without=1), QUICK, idempotency_key="order-1")
    assert (refused.value.status, refused.value.code) == (422, "idempotency_key_reused")


def test_a_submission_after_a_lost_request_a_503_and_a_lost_response_creates_one_job(service: str) -> None:
    with flaky(service, is_submission, "drop", 429, 503, "lose") as proxy:
        # From a file that is open, which is read again each time.
        file = io.BytesIO(box())
        job = Client(proxy.url).repair(file, QUICK, metadata={"is": "flaky"})
        assert job.outcome == "already_printable"
        times, keys = zip(*proxy.seen, strict=True)
        assert len(keys) == 5 and len(set(keys)) == 1
        assert times[2] - times[1] >= 1 and times[3] - times[2] >= 1, "the client waits as long as Retry-After says"
    assert len([it for it in Client(service).list() if it.data["metadata"].get("is") == "flaky"]) == 1


def test_retries_end_at_the_time_limit(service: str) -> None:
    with flaky(service, is_submission, *[503] * 100) as proxy:
        with pytest.raises(Problem) as busy:
            Client(proxy.url, timeout=1).submit(box())
        assert (busy.value.code, busy.value.retry_after, len(proxy.seen)) == ("unavailable", 1, 1)
        url = proxy.url
    with pytest.raises(Problem) as away:
        Client(url, timeout=1).capabilities()
    assert (away.value.status, away.value.code) == (0, "unreachable")


def is_stream(_: str, path: str) -> bool:
    return path.partition("?")[0].endswith("/events")


def test_a_broken_event_stream_is_resumed(tmp_path: Path) -> None:
    with serve(tmp_path, "--no-workers") as address, flaky(address, is_stream, "cut", "cut") as proxy:
        job = Client(proxy.url).submit(box())
        heard = []
        for event in Client(proxy.url).events(job.id):
            heard.append(event.done["status"] if event.done else event.progress and event.progress["status"])
            if len(heard) == 2:
                Client(address).cancel(job.id)
        assert heard == ["queued", "queued", "canceled"]
        assert len(proxy.seen) == 3


def test_a_job_is_polled_if_a_proxy_buffers_the_event_stream(tmp_path: Path) -> None:
    with serve(tmp_path, "--no-workers") as address, flaky(address, is_stream, *["drop"] * 100) as proxy:
        job = Client(proxy.url).submit(box())
        threading.Timer(1, Client(address).cancel, (job.id,)).start()
        assert job.wait(timeout=30).status == "canceled"
        assert len(proxy.seen) == 1


def test_a_rejected_file_raises_a_problem_without_a_retry(service: str) -> None:
    with flaky(service, is_submission) as proxy:
        with pytest.raises(Problem, match="unsupported_model") as refused:
            Client(proxy.url).repair(b"no model at all", name="notes.txt")
        assert refused.value.status == 415 and refused.value.detail and refused.value.request_id
        assert len(proxy.seen) == 1


def test_repair_raises_for_a_failed_job_and_wait_returns_the_job(client: Client) -> None:
    with pytest.raises(JobFailed) as failed:
        client.repair(LATE_BREAK)
    problem = failed.value.job.problem
    assert problem is not None and problem["code"] == "bad_input" and problem.get("place") == {"line": 6}
    assert client.wait(failed.value.job.id).status == "failed"


def test_several_files_are_analysed_in_one_job(client: Client) -> None:
    job = client.analyze(box(), box(without=1), options={"pictures": False})
    assert job.outcome == "not_printable"
    assert [file.get("printable") for file in job.analysis["files"]] == [True, False]


def test_an_upload_survives_a_lost_response_and_its_model_is_converted(service: str, tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    path.write_bytes(box())
    with flaky(service, lambda method, _: method == "PUT", "drop", "lose") as proxy:
        through = Client(proxy.url)
        upload = through.upload(path)
        job = through.submit_from({"upload_id": upload["id"]}, QUICK).wait()
    assert (job.status, job.data["input"]["name"]) == ("succeeded", "box.stl")
    again = Client(service).submit_from({"job_id": job.id, "file": "model"}, {**QUICK, "output": "off"}).wait()
    assert again.download().startswith(b"OFF")


def test_jobs_are_listed_across_pages_and_deleted(client: Client) -> None:
    made = [client.wait(client.submit(box(), QUICK)) for _ in range(3)]
    found = [job.id for job in client.list(status="succeeded", page_size=2)]
    assert {job.id for job in made} <= set(found) and len(set(found)) == len(found)
    made[0].delete()
    with pytest.raises(Problem, match="job_deleted"):
        client.get(made[0].id)


def test_a_job_is_canceled_by_a_call_and_after_a_timeout(tmp_path: Path) -> None:
    with serve(tmp_path, "--no-workers") as address:
        client = Client(address)
        assert client.submit(box()).cancel().status == "canceled"
        with pytest.raises(JobTimeout):
            client.repair(box(), timeout=0.5)

        def stop(_: ProgressEvent) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            client.repair(box(), on_progress=stop)
        assert [job.status for job in client.list()] == ["canceled"] * 3
        waiting = client.submit(box())
        threading.Timer(0.3, client.cancel, (waiting.id,)).start()
        assert waiting.wait(timeout=30).status == "canceled"


def test_a_missing_or_wrong_key_is_rejected(tmp_path: Path) -> None:
    made = subprocess.run(
        [PROGRAM, "keys", "create", "--data-dir", str(tmp_path)], capture_output=True, text=True, check=True
    )
    key = made.stdout.strip().splitlines()[-1]
    with serve(tmp_path, "--auth", "keys") as address:
        for wrong in (None, "mm_wrong"):
            with pytest.raises(Problem) as refused:
                Client(address, wrong).repair(box())
            assert (refused.value.status, refused.value.code) == (401, "unauthorized")
        with Client(address, key) as mine:
            assert mine.repair(box(), QUICK).outcome == "already_printable"
            assert mine.browser_token({"origin": "https://shop.example"})["origin"] == "https://shop.example"
            endpoint = mine.webhooks.create({"url": "https://shop.example/hooks"})
            assert endpoint.get("secret", "").startswith("whsec_")
            assert not mine.webhooks.change(endpoint["id"], {"enabled": False})["enabled"]
            assert [it["id"] for it in mine.webhooks.list()] == [endpoint["id"]]
            assert mine.webhooks.rotate(endpoint["id"]).get("secret", "").startswith("whsec_")
            assert mine.webhooks.deliveries(endpoint_id=endpoint["id"])["deliveries"] == []
            mine.webhooks.delete(endpoint["id"])
            with pytest.raises(Problem, match="webhook_not_found"):
                mine.webhooks.get(endpoint["id"])
