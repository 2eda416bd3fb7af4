"""The examples of the documentation, run as a user runs them."""

from __future__ import annotations

import os
import subprocess
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from conftest import box, example

from meshmend import Client


def run(name: str, *arguments: str, cwd: Path) -> tuple[int, str, str]:
    process = example(name, *arguments, cwd=cwd)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def test_the_examples_repair_analyse_and_report_progress_and_errors(service: str, tmp_path: Path) -> None:
    (tmp_path / "open.stl").write_bytes(box(without=1))
    (tmp_path / "box.stl").write_bytes(box())
    (tmp_path / "notes.txt").write_text("no model at all")
    code, out, err = run("repair", service, "open.stl", "plain.stl", cwd=tmp_path)
    assert code == 0 and out.startswith("repaired: "), err
    code, out, err = run("careful", service, "open.stl", "careful.stl", cwd=tmp_path)
    assert (code, out) == (0, "repaired\n") and " %" in err, err
    assert (tmp_path / "plain.stl").read_bytes() == (tmp_path / "careful.stl").read_bytes()
    code, _, err = run("careful", service, "notes.txt", "none.stl", cwd=tmp_path)
    assert code == 1 and err.startswith("refused: unsupported_model: "), err
    code, out, err = run("analyze", service, "box.stl", "open.stl", cwd=tmp_path)
    assert code == 0 and out.startswith("box.stl: printable\nopen.stl: not printable 1 hole"), (out, err)


def test_the_examples_repair_without_a_service_and_several_models_at_once(service: str, tmp_path: Path) -> None:
    (tmp_path / "open.stl").write_bytes(box(without=1))
    (tmp_path / "box.stl").write_bytes(box())
    (tmp_path / "notes.txt").write_text("no model at all")
    code, out, err = run("engine", "open.stl", "engine.stl", cwd=tmp_path)
    assert code == 0 and out.startswith("repaired: ") and out.endswith("8 vertices, 12 faces\n"), (out, err)
    code, _, err = run("engine", "notes.txt", "none.stl", cwd=tmp_path)
    assert code == 1 and err.startswith("refused: unknown_format: notes.txt: "), err
    code, out, err = run("several", service, "open.stl", "box.stl", cwd=tmp_path)
    assert (code, out) == (0, "open.stl: repaired\nbox.stl: already_printable\n"), (out, err)
    assert (tmp_path / "open.stl.repaired.stl").read_bytes() == (tmp_path / "engine.stl").read_bytes()


def test_a_webhook_is_verified_and_a_forged_one_is_rejected(service: str, tmp_path: Path) -> None:
    client = Client(service)
    secret = client.webhooks.secret()["secret"]
    process: subprocess.Popen[str] = example("webhook", "0", cwd=tmp_path, env={"WEBHOOK_SECRET": secret})
    assert process.stdout is not None
    try:
        port = process.stdout.readline().split()[-1]
        url = f"http://127.0.0.1:{port}/"
        headers = {"webhook-id": "msg_1", "webhook-timestamp": "1", "webhook-signature": "v1,bm8="}
        with pytest.raises(urllib.error.HTTPError, match="400"):
            urllib.request.urlopen(urllib.request.Request(url, b"{}", headers))
        job = client.repair(box(), {"pictures": False}, callback_url=url)
        assert process.stdout.readline() == f"job.succeeded {job.id} already_printable\n"
    finally:
        process.terminate()
        process.communicate(timeout=10)
    assert os.listdir(tmp_path) == []
