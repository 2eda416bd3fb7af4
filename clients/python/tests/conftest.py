"""A running service, a proxy that injects faults, and models."""

from __future__ import annotations

import http.client
import json
import os
import re
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import pytest

PROGRAM = os.environ.get("MESHMEND_PROGRAM", str(Path(__file__).parents[3] / "target/debug/meshmend"))


@contextmanager
def serve(folder: Path, *arguments: str) -> Iterator[str]:
    """Starts the built program on a free port and yields its URL."""
    given = ["serve", "--listen", "127.0.0.1:0", "--data-dir", str(folder), "--blender", "/nonexistent", *arguments]
    process = subprocess.Popen([PROGRAM, *given], stderr=subprocess.PIPE, text=True, env={"PATH": os.environ["PATH"]})
    assert process.stderr is not None
    try:
        log = []
        for line in process.stderr:
            log.append(line)
            address = re.search(r"listening on (http://[^\s,]+)", line)
            if address:
                break
        else:
            pytest.fail("it does not listen:\n" + "".join(log))
        # So that it never waits for somebody to read.
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield address[1]
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with serve(tmp_path_factory.mktemp("service"), "--webhook-allow-private") as address:
        yield address


class Flaky(ThreadingHTTPServer):
    """Forwards requests. Each request that `hits` selects takes the next fault.

    A fault is "drop" (the connection breaks), "lose" (the service gets the request, and its response is lost), a
    status, or "cut" (the response breaks after its first piece).
    """

    daemon_threads = True

    def __init__(self, url: str, hits: Callable[[str, str], bool], faults: list[str | int]) -> None:
        super().__init__(("127.0.0.1", 0), _Passing)
        self.behind = urlsplit(url).netloc
        self.hits = hits
        self.faults = faults
        #: Of each request that was picked: when it came and its idempotency key.
        self.seen: list[tuple[float, str | None]] = []
        self.url = f"http://127.0.0.1:{self.server_port}"


class _Passing(BaseHTTPRequestHandler):
    server: Flaky
    protocol_version = "HTTP/1.1"

    def _pass(self) -> None:
        self.close_connection = True
        hit = self.server.hits(self.command, self.path)
        if hit:
            self.server.seen.append((time.monotonic(), self.headers.get("idempotency-key")))
        fault = self.server.faults.pop(0) if hit and self.server.faults else None
        if fault == "drop":
            return
        body = self._body()
        if isinstance(fault, int):
            self._refuse(fault)
            return
        on = http.client.HTTPConnection(self.server.behind)
        on.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
        for name, value in self.headers.items():
            if name.lower() not in ("transfer-encoding", "content-length"):
                on.putheader(name, value)
        on.putheader("content-length", str(len(body)))
        on.endheaders(body)
        answer = on.getresponse()
        if fault == "lose":
            on.close()
            return
        self.send_response(answer.status)
        for name, value in answer.getheaders():
            if name.lower() not in ("transfer-encoding", "connection"):
                self.send_header(name, value)
        self.send_header("connection", "close")
        self.end_headers()
        while piece := answer.read1(65536):
            self.wfile.write(piece)
            if fault == "cut":
                break
        on.close()

    def _body(self) -> bytes:
        if self.headers.get("transfer-encoding") != "chunked":
            return self.rfile.read(int(self.headers.get("content-length", 0)))
        whole = b""
        while size := int(self.rfile.readline(), 16):
            whole += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return whole

    def _refuse(self, status: int) -> None:
        code = "queue_full" if status == 429 else "unavailable"
        problem = {"type": "", "title": "busy", "status": status, "detail": "busy", "code": code}
        body = json.dumps(problem).encode()
        self.send_response(status)
        self.send_header("retry-after", "1")
        self.send_header("content-type", "application/problem+json")
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_GET = do_POST = do_PUT = do_DELETE = _pass

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def flaky(url: str, hits: Callable[[str, str], bool], *faults: str | int) -> Iterator[Flaky]:
    server = Flaky(url, hits, list(faults))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()


def box(without: int = 0) -> bytes:
    """A box of 40 by 30 by 20 mm as STL. Without its last triangles it has a hole."""
    sides = (40.0, 30.0, 20.0)
    corners = [tuple(side * (i >> axis & 1) for axis, side in enumerate(sides)) for i in range(8)]
    faces = ["023", "031", "457", "476", "015", "054", "267", "273", "046", "062", "137", "175"]
    triangles = [[corners[int(i)] for i in face] for face in faces[: len(faces) - without]]
    packed = [struct.pack("<12fH", 0, 0, 0, *(x for corner in it for x in corner), 0) for it in triangles]
    return bytes(80) + struct.pack("<I", len(packed)) + b"".join(packed)


def example(name: str, *arguments: str, cwd: Path, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
    """Starts an example of the documentation."""
    script = Path(__file__).parents[1] / "examples" / f"{name}.py"
    return subprocess.Popen(
        [sys.executable, str(script), *arguments],
        cwd=cwd,
        env={
            **os.environ,
            **(env or {}),
            "PYTHONUNBUFFERED": "1",
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
