"""Compares meshmend with other tools that repair meshes from Python, on the same models.

    pip install meshmend trimesh networkx scipy pymeshfix pymeshlab manifold3d meshlib
    python tools.py [--tools meshmend,trimesh] [--limit 120] MODEL ...
    python tools.py --program meshmend MODEL ...      the package's time for a file against that of the command line

Each tool runs in one process of its own, over all models one after another. A crash, or more than the limit of seconds,
counts as a failure; the process is then started again. Times are from arrays in memory to arrays in memory: on the
clock, and of the processor in all threads, which other load on the machine changes less. Both judgements of a result
are outside of them: whether ``meshmend.inspect`` calls it printable, and whether trimesh calls it watertight. Tier 3 of
meshmend is off: no tool uses Blender.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import subprocess
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

import meshmend

Arrays = tuple[Any, Any]


def repair_with_meshmend(vertices: Any, faces: Any) -> Arrays:
    result = meshmend.repair((vertices, faces), blender=False)
    return result.vertices, result.faces


def repair_with_trimesh(vertices: Any, faces: Any) -> Arrays:
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    mesh.fill_holes()
    mesh.fix_normals()
    return mesh.vertices, mesh.faces


def repair_with_pymeshfix(vertices: Any, faces: Any) -> Arrays:
    import pymeshfix

    fix = pymeshfix.MeshFix(vertices, faces)
    fix.repair(joincomp=True)
    return (fix.points if hasattr(fix, "points") else fix.v), (fix.faces if hasattr(fix, "faces") else fix.f)


def repair_with_pymeshlab(vertices: Any, faces: Any) -> Arrays:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    meshes.meshing_remove_duplicate_vertices()
    meshes.meshing_remove_duplicate_faces()
    meshes.meshing_remove_null_faces()
    meshes.meshing_repair_non_manifold_edges()
    meshes.meshing_repair_non_manifold_vertices()
    meshes.meshing_close_holes(maxholesize=100_000, selfintersection=True)
    meshes.meshing_re_orient_faces_coherently()
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix()


def repair_with_manifold(vertices: Any, faces: Any) -> Arrays:
    import manifold3d

    mesh = manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    mesh.merge()
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(solid.status())
    united = manifold3d.Manifold.batch_boolean(solid.decompose(), manifold3d.OpType.Add).to_mesh()
    return united.vert_properties[:, :3], united.tri_verts


def repair_with_meshlib(vertices: Any, faces: Any) -> Arrays:
    from meshlib import mrmeshnumpy, mrmeshpy

    mesh = mrmeshnumpy.meshFromFacesVerts(faces, vertices, duplicateNonManifoldVertices=True)
    mrmeshpy.uniteCloseVertices(mesh, 0.0, True)
    size = mesh.computeBoundingBox().diagonal()
    degeneracies = mrmeshpy.FixMeshDegeneraciesParams()
    degeneracies.maxDeviation, degeneracies.tinyEdgeLength = 1e-4 * size, 1e-6 * size
    mrmeshpy.fixMeshDegeneracies(mesh, degeneracies)
    mrmeshpy.SelfIntersections.fix(mesh, mrmeshpy.SelfIntersections.Settings())
    for edge in mesh.topology.findHoleRepresentiveEdges():
        filling = mrmeshpy.FillHoleParams()
        filling.metric = mrmeshpy.getUniversalMetric(mesh)
        mrmeshpy.fillHole(mesh, edge, filling)
    return mrmeshnumpy.getNumpyVerts(mesh), mrmeshnumpy.getNumpyFaces(mesh.topology)


TOOLS: dict[str, Callable[[Any, Any], Arrays]] = {
    "meshmend": repair_with_meshmend,
    "trimesh": repair_with_trimesh,
    "pymeshfix": repair_with_pymeshfix,
    "pymeshlab": repair_with_pymeshlab,
    "manifold3d": repair_with_manifold,
    "meshlib": repair_with_meshlib,
}


def arrays_of_file(path: str) -> Arrays:
    """The model as every tool gets it: vertices joined by position, without rows that are not finite."""
    # Without a repair, in a format that keeps indices.
    from meshmend import _engine

    vertices, faces = _engine.read_arrays(Path(path).read_bytes())
    finite: Any = np.isfinite(vertices).all(axis=1)
    faces = faces[finite[faces].all(axis=1)]
    unique, places = np.unique(np.where(finite[:, None], vertices, 0.0) + 0.0, axis=0, return_inverse=True)
    return np.ascontiguousarray(unique), np.ascontiguousarray(places.ravel()[faces].astype(np.int32))


def serve(tool: str, connection: Connection) -> None:
    """Repairs each model that comes, and answers with the time and the result."""
    repair = TOOLS[tool]
    corners = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9.0]])
    # Imports the tool, whatever it makes of an open model.
    with contextlib.suppress(ValueError):
        repair(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2]], "i4"))
    connection.send("ready")
    while True:
        vertices, faces = connection.recv()
        begun = np.array([time.perf_counter(), time.process_time()])
        try:
            repaired: Any = repair(vertices, faces)
        except Exception as error:
            repaired = f"{type(error).__name__}: {error}"
        spent = np.array([time.perf_counter(), time.process_time()]) - begun
        connection.send((spent, repaired if isinstance(repaired, str) else tuple(map(np.array, repaired))))


def judge(vertices: Any, faces: Any) -> tuple[bool, bool]:
    """Whether a result is printable, and whether trimesh calls it watertight."""
    import trimesh

    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if not len(faces):
        return False, False
    vertices = np.asarray(vertices, dtype=np.float64)
    printable = meshmend.inspect((vertices, faces), level="basic" if len(faces) > 3_000_000 else "full").is_printable
    return printable is True, bool(trimesh.Trimesh(vertices, faces).is_watertight)


class Worker:
    """A process of one tool."""

    def __init__(self, tool: str) -> None:
        self.tool = tool
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(self.tool, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.connection.recv()

    def repair(self, model: Arrays, limit: float) -> tuple[Any, Any]:
        """Returns the seconds of the clock and of the processor, and arrays or the reason why there are none."""
        begun = time.perf_counter()
        try:
            self.connection.send(model)
            if self.connection.poll(limit):
                answer: tuple[Any, Any] = self.connection.recv()
                return answer
            problem = f"more than {limit:.0f} s"
        except (EOFError, OSError):
            problem = "the process crashed"
        self.process.kill()
        self.process.join()
        self.start()
        spent = time.perf_counter() - begun
        return np.array([spent, spent]), problem


def compare_tools(tools: list[str], paths: list[str], limit: float) -> None:
    models = {path: arrays_of_file(path) for path in paths}
    print(f"{len(models)} models, {sum(len(faces) for _, faces in models.values())} faces\n")
    print("| Tool | Seconds | Processor | Slowest | Printable | Watertight | Failed |\n|---|---|---|---|---|---|---|")
    for tool in tools:
        worker = Worker(tool)
        seconds, printable, watertight, failed = [], 0, 0, 0
        for path, model in models.items():
            spent, result = worker.repair(model, limit)
            seconds.append(spent)
            if isinstance(result, str):
                failed += 1
                print(f"<!-- {tool}: {Path(path).name}: {result[:100]} -->")
                continue
            judged = judge(*result)
            printable, watertight = printable + judged[0], watertight + judged[1]
        worker.process.kill()
        clock, processor = np.sum(seconds, axis=0)
        slowest = np.max(seconds, axis=0)[0]
        figures = f"{clock:.2f} | {processor:.2f} | {slowest:.2f} | {printable} | {watertight} | {failed}"
        print(f"| {tool} | {figures} |", flush=True)


def compare_with_program(program: str, paths: list[str]) -> None:
    """Prints the time of a call against the engine's own time in the command line: the best of five each."""
    for path in paths:
        calls, runs = [], []
        for _ in range(5):
            begun = time.perf_counter()
            result = meshmend.repair(path, output="stl", blender=False)
            _ = result.vertices, result.faces
            calls.append(1000 * (time.perf_counter() - begun))
            with tempfile.TemporaryDirectory() as folder:
                out, report = f"{folder}/out.stl", f"{folder}/report.json"
                command = [program, "repair", path, "-o", out, "--report", report, "--blender", "/nonexistent"]
                subprocess.run(command, capture_output=True, check=False)
                runs.append(json.loads(Path(report).read_text())["milliseconds"])
        call, run = min(calls), min(runs)
        print(f"{Path(path).name}: call {call:.1f} ms, command line {run:.1f} ms, {call / run:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--tools", default=",".join(TOOLS))
    parser.add_argument("--limit", type=float, default=120)
    parser.add_argument("--program")
    given = parser.parse_args()
    if given.program:
        compare_with_program(given.program, given.models)
    else:
        compare_tools(given.tools.split(","), given.models, given.limit)


if __name__ == "__main__":
    main()
