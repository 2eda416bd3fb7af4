#!/usr/bin/env python3
"""Times large models: meshmend's whole process, and the repair alone of other libraries where they are installed.

    giants.py [--program target/release/meshmend] [--faces 1500000] [--models FOLDER] [--large] [--rounds 1]

Without --models it makes three models in a temporary folder: a closed bumpy ball (clean), the same with 800 missing and 3,000
flipped faces (holes), and two of these that overlap (two). --large adds a ball of 10 million faces with 100 missing. With
--models it takes every STL file of a folder. Of several rounds it prints the least time.

A library gets the loaded mesh and is timed until it returns one. meshmend is timed from its start to its end: it reads, inspects,
repairs, verifies and writes. Needs numpy; uses pymeshfix, meshlib and manifold3d if they can be imported.
"""
import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def bumpy_ball(faces, shift=(0.0, 0.0, 0.0)):
    """A closed ball with about this many faces, outward, in rings around the z axis."""
    rings = max(3, int((faces / 4) ** 0.5))
    sectors = 2 * rings
    tilt = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    turn = np.linspace(0, 2 * np.pi, sectors, endpoint=False)[None, :]
    radius = 1 + 0.05 * np.sin(7 * tilt) * np.sin(5 * turn)
    around = np.stack([radius * np.sin(tilt) * np.cos(turn), radius * np.sin(tilt) * np.sin(turn), radius * np.cos(tilt) * np.ones_like(turn)], axis=-1)
    vertices = np.concatenate([around.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]]) + np.asarray(shift)
    at = np.arange((rings - 1) * sectors, dtype=np.uint32).reshape(rings - 1, sectors)
    nxt = np.roll(at, -1, axis=1)
    top, bottom = np.uint32(len(vertices) - 2), np.uint32(len(vertices) - 1)
    a, b, c, d = at[:-1].ravel(), at[1:].ravel(), nxt[1:].ravel(), nxt[:-1].ravel()
    caps = [np.stack([np.full(sectors, top), at[0], nxt[0]], axis=1), np.stack([np.full(sectors, bottom), nxt[-1], at[-1]], axis=1)]
    return vertices.astype(np.float32), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1), *caps])


def damaged(faces, missing, flipped, seed=5):
    """The faces without some of them, and with some of them turned over."""
    random = np.random.default_rng(seed)
    faces = faces.copy()
    turned = random.choice(len(faces), flipped, replace=False)
    faces[turned] = faces[turned][:, ::-1]
    keep = np.ones(len(faces), bool)
    keep[random.choice(len(faces), missing, replace=False)] = False
    return faces[keep]


def write_stl(path, vertices, faces):
    records = np.zeros(len(faces), STL_FACE)
    records["corners"] = vertices[faces]
    with open(path, "wb") as file:
        file.write(bytes(80) + np.uint32(len(faces)).tobytes())
        records.tofile(file)


def read_stl(path):
    """Vertices, merged where they are equal, and faces."""
    corners = np.fromfile(path, STL_FACE, offset=84)["corners"].reshape(-1, 3)
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.uint32)


def make_models(folder, faces, large):
    vertices, whole = bumpy_ball(faces)
    write_stl(f"{folder}/clean.stl", vertices, whole)
    broken = damaged(whole, 800, 3000)
    write_stl(f"{folder}/holes.stl", vertices, broken)
    other, second = bumpy_ball(faces, (0.6, 0.1, 0.05))
    write_stl(f"{folder}/two.stl", np.concatenate([vertices, other]), np.concatenate([broken, second + np.uint32(len(vertices))]))
    if large:
        vertices, whole = bumpy_ball(10_000_000)
        write_stl(f"{folder}/large.stl", vertices, damaged(whole, 100, 0))


def run(command):
    """Seconds, seconds of processor and the peak of memory in bytes of a process, and its exit status."""
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return time.perf_counter() - started, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024, process.returncode


def pymeshfix(vertices, faces):
    from pymeshfix import MeshFix

    fix = MeshFix(vertices.astype(float), faces.astype(np.int32))
    started = time.perf_counter()
    fix.repair(joincomp=True)
    return time.perf_counter() - started


def meshlib(vertices, faces):
    import meshlib.mrmeshnumpy as numbers
    import meshlib.mrmeshpy as meshes

    mesh = numbers.meshFromFacesVerts(faces.astype(np.int32), vertices, duplicateNonManifoldVertices=True)
    started = time.perf_counter()
    meshes.uniteCloseVertices(mesh, 0.0, True)
    size = mesh.computeBoundingBox().diagonal()
    degeneracies = meshes.FixMeshDegeneraciesParams()
    degeneracies.maxDeviation, degeneracies.tinyEdgeLength = 1e-4 * size, 1e-6 * size
    meshes.fixMeshDegeneracies(mesh, degeneracies)
    meshes.SelfIntersections.fix(mesh, meshes.SelfIntersections.Settings())
    for edge in mesh.topology.findHoleRepresentiveEdges():
        filling = meshes.FillHoleParams()
        filling.metric = meshes.getUniversalMetric(mesh)
        meshes.fillHole(mesh, edge, filling)
    return time.perf_counter() - started


def manifold3d(vertices, faces):
    import manifold3d as library

    mesh = library.Mesh(vertices, faces)
    started = time.perf_counter()
    mesh.merge()
    solid = library.Manifold(mesh)
    if solid.status() != library.Error.NoError:
        raise RuntimeError(solid.status())
    library.Manifold.batch_boolean(solid.decompose(), library.OpType.Add).to_mesh()
    return time.perf_counter() - started


PEERS = {"pymeshfix": pymeshfix, "meshlib": meshlib, "manifold3d": manifold3d}


def peer_column(name, path, rounds):
    """The least time of a library in a process of its own, which may crash or run out of time."""
    script = f"import sys; sys.path.insert(0, {os.path.dirname(os.path.abspath(__file__))!r}); import giants; print(giants.PEERS[{name!r}](*giants.read_stl({path!r})))"
    times = []
    for _ in range(rounds):
        try:
            done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=600)
        except subprocess.TimeoutExpired:
            return "> 600 s"
        if done.returncode != 0:
            return "missing" if "ModuleNotFoundError" in done.stderr else "fails"
        times.append(float(done.stdout.split()[-1]))
    return f"{min(times):.2f} s"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/release/meshmend")
    parser.add_argument("--faces", type=int, default=1_500_000)
    parser.add_argument("--models")
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if not options.models:
            make_models(folder, options.faces, options.large)
        models = options.models or folder
        print(f"{len(os.sched_getaffinity(0))} cores; least of {options.rounds}")
        print(f"{'model':12} {'faces':>10} {'meshmend':>10} {'processor':>10} {'memory':>9} {'status':>7}", *(f"{name:>11}" for name in PEERS))
        for name in sorted(name for name in os.listdir(models) if name.endswith(".stl")):
            path = f"{models}/{name}"
            command = [options.program, "repair", path, "-o", f"{folder}/result.stl", "--max-tier", "2"]
            runs = [run(command) for _ in range(options.rounds)]
            wall, processor, memory = (min(run[at] for run in runs) for at in range(3))
            faces = (os.path.getsize(path) - 84) // 50
            print(f"{name[:-4]:12} {faces:10} {wall:8.2f} s {processor:8.2f} s {memory / 1e6:6.0f} MB {runs[-1][3]:7}", *(f"{peer_column(peer, path, options.rounds):>11}" for peer in PEERS), flush=True)


if __name__ == "__main__":
    main()
