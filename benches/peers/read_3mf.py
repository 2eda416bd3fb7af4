"""Seconds that a library takes to read a 3MF file into arrays of vertices and triangles: the least of several runs.

    read_3mf.py lib3mf|trimesh FILE RUNS
"""
import sys
import time


def lib3mf_read(path):
    from lib3mf import get_wrapper

    model = get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(path)
    objects = model.GetMeshObjects()
    count = 0
    while objects.MoveNext():
        count += objects.GetCurrentMeshObject().GetTriangleCount()
    return count


def trimesh_read(path):
    import trimesh

    scene = trimesh.load(path, process=False)
    return sum(len(mesh.faces) for mesh in scene.geometry.values())


def main():
    peer, path, runs = sys.argv[1], sys.argv[2], int(sys.argv[3])
    read = {"lib3mf": lib3mf_read, "trimesh": trimesh_read}[peer]
    least = float("inf")
    for _ in range(runs + 1):  # The first is to load the library.
        begin = time.perf_counter()
        assert read(path) == 1_000_000
        least = min(least, time.perf_counter() - begin)
    print(least)


main()
