"""Clients that common generators make from the OpenAPI document repair a model on the built program."""

from __future__ import annotations

import os
import re
import shutil
import struct
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).parent
PROGRAM = os.environ["MESHMEND_PROGRAM"]
#: Where the Rust client is built, so that its dependencies are compiled once.
WORKSPACE = Path(os.environ["GENERATORS_WORKSPACE"])


def run(*command: str | Path, cwd: Path) -> str:
    """The output of a command; the test fails with the command's errors if it fails."""
    done = subprocess.run(command, check=False, cwd=cwd, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("service")
    command = [PROGRAM, "serve", "--listen", "127.0.0.1:0", "--data-dir", folder, "--blender", "/nonexistent"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={"PATH": os.environ["PATH"]})
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if address := re.search(r"listening on (http://[^\s,]+)", line):
                break
        else:
            pytest.fail("the service does not start")
        # Read the pipe to its end, so that the service never blocks on it.
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield address[1]
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture(scope="session")
def documents(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both versions of the document, as the program prints them."""
    folder = tmp_path_factory.mktemp("documents")
    for spec in ("3.0", "3.1"):
        (folder / f"openapi-{spec}.json").write_text(run(PROGRAM, "openapi", "--spec", spec, cwd=folder))
    return folder


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A box of 40 by 30 by 20 mm with 12 by 12 squares on each side, one of which is missing."""
    sides, count, triangles = (40.0, 30.0, 20.0), 12, []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, 1):
            for i in range(count):
                for j in range(count):
                    if (axis, end, i, j) == (0, 0, 5, 5):
                        continue
                    corners = []
                    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        corner = [0.0, 0.0, 0.0]
                        corner[axis], corner[u], corner[v] = (
                            sides[axis] * end,
                            sides[u] * (i + a) / count,
                            sides[v] * (j + b) / count,
                        )
                        corners.append(corner)
                    a, b, c, d = corners if end else corners[::-1]
                    triangles += [(a, b, c), (a, c, d)]
    packed = [struct.pack("<12fH", 0, 0, 0, *(x for corner in it for x in corner), 0) for it in triangles]
    path = tmp_path / "box.stl"
    path.write_bytes(bytes(80) + struct.pack("<I", len(packed)) + b"".join(packed))
    return path


def is_closed(stl: Path) -> bool:
    """Whether each directed edge of the file has its opposite, so that every edge joins two faces."""
    data = stl.read_bytes()
    edges: Counter[tuple[bytes, bytes]] = Counter()
    for face in range(struct.unpack_from("<I", data, 80)[0]):
        start = 84 + 50 * face + 12
        a, b, c = (data[start + 12 * k : start + 12 * k + 12] for k in range(3))
        edges.update(((a, b), (b, c), (c, a)))
    return bool(edges) and all(count == 1 and edges[b, a] == 1 for (a, b), count in edges.items())


def test_the_broken_model_is_not_closed(model: Path) -> None:
    assert not is_closed(model)


@pytest.mark.parametrize("spec", ["3.0", "3.1"])
def test_openapi_spec_validator_accepts_the_document(documents: Path, spec: str) -> None:
    run(sys.executable, "-m", "openapi_spec_validator", documents / f"openapi-{spec}.json", cwd=documents)


@pytest.mark.skipif(shutil.which("npx") is None, reason="node is missing")
def test_redocly_has_nothing_to_say_about_the_document(documents: Path) -> None:
    redocly = HERE / "typescript/node_modules/.bin/redocly"
    run(
        redocly,
        "lint",
        "--config",
        HERE / "redocly.yaml",
        "--max-problems=100",
        documents / "openapi-3.1.json",
        cwd=documents,
    )


def test_a_client_of_openapi_python_client_repairs_a_model(
    service: str, documents: Path, model: Path, tmp_path: Path
) -> None:
    generator = Path(sys.executable).with_name("openapi-python-client")
    document = documents / "openapi-3.1.json"
    said = run(generator, "generate", "--path", document, "--meta", "none", "--output-path", "generated", cwd=tmp_path)
    assert "WARNING" not in said and "Unable" not in said, said
    shutil.copy(HERE / "python/repair.py", tmp_path)
    said = run(sys.executable, "repair.py", service, model, "result.stl", cwd=tmp_path)
    assert said.split() == ["succeeded", "repaired"]
    assert is_closed(tmp_path / "result.stl")


@pytest.mark.skipif(shutil.which("npx") is None, reason="node is missing")
def test_a_client_of_openapi_typescript_repairs_a_model(
    service: str, documents: Path, model: Path, tmp_path: Path
) -> None:
    for file in ("package.json", "tsconfig.json", "repair.ts"):
        shutil.copy(HERE / "typescript" / file, tmp_path)
    modules = HERE / "typescript/node_modules"
    (tmp_path / "node_modules").symlink_to(modules)
    generator = modules / ".bin/openapi-typescript"
    run(generator, documents / "openapi-3.1.json", "--default-non-nullable=false", "-o", "schema.d.ts", cwd=tmp_path)
    run(modules / ".bin/tsc", cwd=tmp_path)
    said = run("node", "built/repair.js", service, model, "result.stl", cwd=tmp_path)
    assert said.split() == ["succeeded", "repaired"]
    assert is_closed(tmp_path / "result.stl")


def test_a_client_of_progenitor_repairs_a_model(service: str, documents: Path, model: Path, tmp_path: Path) -> None:
    package = WORKSPACE / "rust"
    shutil.copytree(HERE / "rust", package, dirs_exist_ok=True, ignore=shutil.ignore_patterns("target"))
    shutil.copy(documents / "openapi-3.0.json", package)
    result = tmp_path / "result.stl"
    said = run(
        "cargo",
        "run",
        "--quiet",
        "--locked",
        "--target-dir",
        WORKSPACE / "target",
        "--",
        service,
        model,
        result,
        cwd=package,
    )
    assert said.split() == ["succeeded", "repaired"]
    assert is_closed(result)
