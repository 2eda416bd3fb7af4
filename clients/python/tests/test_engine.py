"""The engine inside the package: models of every kind, options, errors, progress and cancellation."""

from __future__ import annotations

import importlib
import importlib.util
import json
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from conftest import PROGRAM, box

import meshmend

# Its wheel is large, so what its meshes have stands in for it where it is not installed.
pyvista = importlib.import_module("pyvista") if importlib.util.find_spec("pyvista") else None

Arrays = tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]


def torn_sphere(subdivisions: int = 2) -> Arrays:
    """A sphere of radius 10 with a hole of a few faces."""
    sphere = trimesh.creation.icosphere(subdivisions, 10.0)
    return np.array(sphere.vertices), np.array(sphere.faces)[5:]


def heavy() -> Arrays:
    """Many spheres that intersect: work for longer than the tests wait."""
    pieces = []
    for at in range(12):
        sphere = trimesh.creation.icosphere(5, 10.0)
        sphere.apply_translation([at * 3.3, at % 3 * 1.7, at % 5 * 2.1])
        pieces.append(sphere)
    whole = trimesh.util.concatenate(pieces)
    return np.array(whole.vertices), np.array(whole.faces)[3:]


def polygons(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> Any:
    """A mesh of pyvista, or an object with the same attributes."""
    corners = faces.shape[1]
    padded = np.hstack([np.full((len(faces), 1), corners), faces]).ravel()
    if pyvista is not None:
        return pyvista.PolyData(vertices, padded)
    split = faces if corners == 3 else faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return SimpleNamespace(
        points=vertices,
        faces=padded,
        is_all_triangles=corners == 3,
        extract_surface=lambda: None,
        triangulate=lambda: polygons(vertices, split),
    )


def grid_of(mesh: Any) -> Any:
    """A volume whose surface is the mesh."""
    if pyvista is not None:
        return mesh.cast_to_unstructured_grid()
    return SimpleNamespace(points=mesh.points, cells_dict={}, cells=[], extract_surface=lambda: mesh)


def command_line(*arguments: str) -> None:
    """Runs the built program without Blender."""
    given = [PROGRAM, *arguments, "--blender", "/nonexistent"]
    ended = subprocess.run(given, env={"PATH": os.environ["PATH"]}, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_a_file_is_repaired_and_saved_in_three_lines(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(box(without=1))
    result = meshmend.repair(tmp_path / "box.stl")
    result.save(tmp_path / "repaired.stl")
    assert (result.outcome, result.is_printable, result.format) == ("repaired", True, "stl")
    assert meshmend.inspect(str(tmp_path / "repaired.stl")).is_printable
    assert result.vertices.shape == (8, 3) and result.faces.shape == (12, 3)
    assert (result.vertices.dtype, result.faces.dtype) == (np.float64, np.int32)
    assert result.report["steps"] and repr(result).startswith("<Result repaired: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["box.stl", "repaired.stl"]
    with pytest.raises(ValueError, match=r"format stl; name it \.stl, or repair with output='3mf'"):
        result.save(tmp_path / "repaired.3mf")


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_files_have_the_bytes_of_the_command_line_for_any_threads(tmp_path: Path, threads: int) -> None:
    trimesh.Trimesh(*torn_sphere(), process=False).export(tmp_path / "torn.stl")
    for output in ("stl", "3mf"):
        command_line("repair", str(tmp_path / "torn.stl"), "-o", str(tmp_path / f"expected.{output}"))
        result = meshmend.repair(tmp_path / "torn.stl", output=output, threads=threads, blender=False)  # type: ignore[arg-type]
        assert result.bytes == (tmp_path / f"expected.{output}").read_bytes()


def test_arrays_keep_their_coordinates_exactly_and_are_not_changed() -> None:
    vertices, faces = torn_sphere()
    vertices *= 1 + 1e-12
    before = vertices.copy(), faces.copy()
    result = meshmend.repair((vertices, faces))
    assert (result.outcome, result.format) == ("repaired", "ply")
    assert {tuple(at) for at in vertices} == {tuple(at) for at in result.vertices}
    assert np.array_equal(before[0], vertices) and np.array_equal(before[1], faces)
    whole = meshmend.repair((result.vertices, result.faces))
    assert whole.outcome == "already_printable"
    assert np.array_equal(whole.vertices, result.vertices) and np.array_equal(whole.faces, result.faces)


def meshes() -> dict[str, Any]:
    vertices, faces = torn_sphere()
    tensors = SimpleNamespace(
        vertex=SimpleNamespace(positions=SimpleNamespace(numpy=lambda: vertices)),
        triangle=SimpleNamespace(indices=SimpleNamespace(numpy=lambda: faces)),
    )
    return {
        "lists": (vertices.tolist(), faces.tolist()),
        "float32 and uint32 in column order": (np.asfortranarray(vertices.astype("f4")), faces.astype("u4")[:, ::1]),
        "trimesh": trimesh.Trimesh(vertices, faces, process=False),
        "trimesh scene": trimesh.Scene(trimesh.Trimesh(vertices, faces, process=False)),
        "meshio": meshio.Mesh(vertices, [("triangle", faces)]),
        "pyvista": polygons(vertices, faces),
        "pyvista grid": grid_of(polygons(vertices, faces)),
        # What the classes of open3d have, whose wheel is large.
        "open3d": SimpleNamespace(vertices=vertices, triangles=faces),
        "open3d tensors": tensors,
        "bytes": trimesh.Trimesh(vertices, faces, process=False).export(file_type="off").encode(),
    }


@pytest.mark.parametrize("kind", list(meshes()))
def test_meshes_of_other_libraries_are_repaired(kind: str) -> None:
    result = meshmend.repair(meshes()[kind])
    assert result.outcome == "repaired", result.summary
    assert result.report["before"]["faces"] == len(torn_sphere()[1]) and result.report["before"]["boundary_loops"] == 1
    mesh = result.mesh
    assert mesh.is_watertight and abs(mesh.volume - 4 / 3 * np.pi * 1000) < 200


def test_quads_of_meshio_and_pyvista_are_split() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 9.0) for y in (0.0, 9.0) for z in (0.0, 9.0)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    for mesh in (meshio.Mesh(corners, [("quad", quads)]), polygons(corners, quads)):
        inspection = meshmend.inspect(mesh)
        assert inspection.is_printable and inspection.measures["faces"] == 12


def test_an_error_of_an_option_names_the_option() -> None:
    arrays = torn_sphere(1)
    calls: dict[str, tuple[str, Any]] = {
        "max_tier": ("must be 1, 2 or 3; got 9", lambda: meshmend.repair(arrays, max_tier=9)),
        "output": (
            "unknown variant `docx`, expected one of",
            lambda: meshmend.repair(arrays, output="docx"),  # type: ignore[arg-type]
        ),
        "max_teir": (
            "no option `max_teir`; the options are .*max_tier",
            lambda: meshmend.repair(arrays, max_teir=2),  # type: ignore[call-arg]
        ),
        "with": ("unknown operator `polish`", lambda: meshmend.repair(arrays, with_=["polish"])),  # type: ignore[list-item]
        "threads": ("whole number of 1 or more; got 0", lambda: meshmend.repair(arrays, threads=0)),
        "level": ("unknown variant", lambda: meshmend.inspect(arrays, level="deep")),  # type: ignore[arg-type]
        "samples": ("from 100 to 10000000; got 1", lambda: meshmend.compare(arrays, arrays, samples=1)),
    }
    for option, (message, call) in calls.items():
        with pytest.raises(meshmend.InvalidOption, match=message) as refused:
            call()
        assert refused.value.option == option and isinstance(refused.value, ValueError)
    assert meshmend.repair(arrays, max_tier=1, with_=["remove_overlapping_neighbours"]).is_printable


def test_an_error_of_a_model_says_what_is_wrong_and_where(tmp_path: Path) -> None:
    vertices, faces = torn_sphere(1)
    hollow, torn = vertices.copy(), faces.copy()
    hollow[7, 1], torn[3, 2] = np.nan, len(vertices)
    wrong: dict[str, tuple[Any, str]] = {
        "mesh: row 7 of the vertices is not finite": ((hollow, faces), "malformed"),
        "mesh: row 3 of the faces is .* below 42": ((vertices, torn), "index_out_of_range"),
        "mesh: row 0 of the faces is": ((vertices, faces - 99), "index_out_of_range"),
        "mesh: faces must be whole numbers; got float64": ((vertices, faces * 1.0), "malformed"),
        "mesh: vertices must be an array of n rows and 3 columns; got 42x2": ((vertices[:, :2], faces), "malformed"),
        "mesh: the mesh has no triangles and no quads, but line": (
            meshio.Mesh(vertices, [("line", faces[:, :2])]),
            "no_faces",
        ),
        "model: .*line 5": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 x 0\n3 0 1 2\n", "malformed"),
    }
    for message, (model, kind) in wrong.items():
        with pytest.raises(meshmend.InvalidModel, match=message) as refused:
            meshmend.repair(model)
        assert refused.value.kind == kind and isinstance(refused.value, ValueError)
    assert refused.value.line == 5
    with pytest.raises(TypeError, match="a model is a path, bytes"):
        meshmend.repair(7)
    with pytest.raises(FileNotFoundError) as missing:
        meshmend.repair(tmp_path / "none.stl")
    assert missing.value.filename == str(tmp_path / "none.stl")


def test_limits_hold_before_anything_is_copied(tmp_path: Path) -> None:
    vertices, faces = torn_sphere(1)
    # Arrays of a terabyte that exist in no memory.
    endless = np.broadcast_to(np.zeros(3, dtype=np.float32), (1 << 38, 3))
    with pytest.raises(meshmend.InvalidModel, match="over the limit of 30000000") as refused:
        meshmend.repair((endless, faces))
    assert refused.value.kind == "too_large"
    with pytest.raises(meshmend.InvalidModel, match="faces are over the limit of 10"):
        meshmend.inspect((vertices, faces), max_file_faces=10)
    with open(tmp_path / "sparse.stl", "wb") as file:
        file.truncate(3 << 20)
    with pytest.raises(meshmend.InvalidModel, match="sparse.stl: the file has more than 2097152 bytes"):
        meshmend.repair(tmp_path / "sparse.stl", max_file_mib=2)


def test_a_required_property_that_is_missed_gives_no_model() -> None:
    vertices, faces = torn_sphere(1)
    # Without any operator that closes holes the sphere stays open.
    result = meshmend.repair((vertices, faces), require="printable", max_tier=1, max_holes=0)
    assert not result.is_printable and result.format is None
    with pytest.raises(meshmend.MeshmendError, match="returned no model"):
        _ = result.vertices


def test_alternatives_are_results_by_their_ids() -> None:
    outer, inner = trimesh.creation.box((20, 20, 20)), trimesh.creation.box((10, 10, 10))
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    result = meshmend.repair(hollow, alternatives=True, max_tier=2)
    assert list(result.alternatives) == ["voids-fill"]
    filled = result.alternatives["voids-fill"]
    assert (len(result.faces), len(filled.faces), filled.is_printable) == (24, 12, True)
    offered = result.report["alternatives"]["offered"]
    assert [one["id"] for one in offered] == ["default", "voids-fill"]
    assert not meshmend.repair(hollow, max_tier=2).alternatives


def test_progress_rises_to_one_and_the_log_has_the_steps(caplog: pytest.LogCaptureFixture) -> None:
    heard: list[tuple[str, float]] = []
    with caplog.at_level(logging.DEBUG, "meshmend"):
        meshmend.repair(torn_sphere(), progress=lambda stage, fraction: heard.append((stage, fraction)))
    stages, fractions = zip(*heard, strict=True)
    assert {"read", "inspect", "verify", "finish"} <= set(stages)
    assert list(fractions) == sorted(fractions) and fractions[-1] == 1.0
    assert any("faces" in record.message for record in caplog.records)


def test_progress_true_shows_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    meshmend.repair(torn_sphere(), progress=True)
    assert "100 %" in capsys.readouterr().err


def test_an_exception_of_the_callback_cancels_and_is_raised() -> None:
    def stop(stage: str, fraction: float) -> None:
        raise LookupError(stage)

    with pytest.raises(LookupError, match="read"):
        meshmend.repair(heavy(), progress=stop)


def test_ctrl_c_cancels_within_a_second() -> None:
    begun = threading.Event()

    def interrupt() -> None:
        begun.wait()
        os.kill(os.getpid(), signal.SIGINT)

    # A shell's background jobs ignore the signal.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        thread = threading.Thread(target=interrupt)
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            meshmend.repair(heavy(), progress=lambda stage, _: stage == "inspect" and begun.set())
        sent = time.monotonic()
        thread.join()
        assert time.monotonic() - sent < 1
    finally:
        signal.signal(signal.SIGINT, handler)


def test_the_event_cancels_and_other_threads_run_meanwhile() -> None:
    cancel, turns = threading.Event(), 0

    def count() -> None:
        nonlocal turns
        while turns < 20:
            time.sleep(0.005)
            turns += 1
        cancel.set()

    thread = threading.Thread(target=count)
    thread.start()
    with pytest.raises(meshmend.Cancellation):
        meshmend.repair(heavy(), cancel=cancel)
    thread.join()
    assert turns == 20


def test_a_deadline_that_passes_raises_or_returns_a_verified_result() -> None:
    begun = time.monotonic()
    try:
        result = meshmend.repair(heavy(), deadline_s=1)
        assert result.report["omitted"]
    except meshmend.DeadlineExceeded as error:
        assert isinstance(error, TimeoutError) and "deadline_s" in str(error)
    assert time.monotonic() - begun < 10


def repaired_in_child(connection: Any) -> None:
    connection.send(meshmend.repair(torn_sphere(), threads=2).bytes)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_repairs_after_its_parent_did() -> None:
    expected = meshmend.repair(torn_sphere(), threads=2).bytes
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    child = context.Process(target=repaired_in_child, args=(theirs,))
    child.start()
    assert ours.poll(60) and ours.recv() == expected
    child.join(10)


def test_several_models_are_inspected_in_one_report(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(box())
    inspection = meshmend.inspect(tmp_path / "box.stl", torn_sphere(), level="basic")
    assert [file["name"] for file in inspection.files] == ["box.stl", "model 2"]
    assert "set" in inspection.report and inspection.is_printable is False
    assert "hole" in {group["kind"] for group in inspection.files[1]["inspection"]["defects"]}


def test_a_comparison_has_the_figures_of_the_command_line(tmp_path: Path) -> None:
    vertices, faces = torn_sphere()
    for name, factor in (("before", 1.0), ("after", 1.1)):
        trimesh.Trimesh(vertices * factor, faces, process=False).export(tmp_path / f"{name}.stl")
    comparison = meshmend.compare(tmp_path / "before.stl", tmp_path / "after.stl")
    printed = subprocess.run(
        [PROGRAM, "compare", "--json", str(tmp_path / "before.stl"), str(tmp_path / "after.stl")], capture_output=True
    ).stdout
    assert comparison == json.loads(printed)
    assert not comparison["comparison"]["faithful"]
