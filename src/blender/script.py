"""One action of tier 3, run by Blender's Python or by a Python that has bpy.

Arguments after `--`: action (voxel or union), input, output, voxel sizes, most faces, most bytes of memory (0: no limit),
process id of the program that asked.

Voxel sizes are one or more with commas between, coarsest first. Each is a stage: its result is written as soon as it is
there, that of the last under the name of the output and those before it with a dot and their number, from 0, so that what was
finished is there whatever comes after. A file is there as a whole or not at all.

Input and output are little-endian: the magic below, counts of vertices and of triangles as u64, positions as f32, corners
as u32. A result with too many triangles is given as its header alone. A failure is told on a line of its own that
begins with ERROR, with a non-zero exit code. Nothing of Blender's importers and exporters is used: they differ from
version to version.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
try:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
except (AttributeError, OSError):
    pass

import array
import resource
import struct

MAGIC = b"MMSOUP01"
HEADER = struct.Struct("<8sQQ")
ERROR = "meshmend-error: "


def fail(message):
    # Blender may have left a line unfinished.
    print("\n" + ERROR + message, flush=True)
    sys.stderr.flush()
    os._exit(4)


def ancestors():
    """Process ids from the parent up; ends early where /proc can't be read."""
    pid = os.getppid()
    while pid > 0:
        yield pid
        try:
            with open(f"/proc/{pid}/stat", "rb") as stat:
                pid = int(stat.read().rpartition(b")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            return


def end_if_orphaned(asker):
    """Ends where the asker died before its death could be signalled."""
    if os.path.isdir("/proc/self") and asker not in ancestors():
        fail("the program that asked has ended")


def address_space():
    try:
        with open("/proc/self/statm", "rb") as statm:
            return int(statm.read().split()[0]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return 0


def lower(limit, value):
    """Lowers a limit, never above what is already in force."""
    soft, hard = resource.getrlimit(limit)
    known = [bound for bound in (soft, hard) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(limit, (min([value] + known), hard))


def limit_resources(memory, output_bytes):
    lower(resource.RLIMIT_CORE, 0)
    lower(resource.RLIMIT_FSIZE, output_bytes)
    if memory > 0:
        # What is mapped already differs by gigabytes between builds, so the limit is on growth.
        lower(resource.RLIMIT_AS, address_space() + memory)


def little_endian(values):
    if sys.byteorder == "big":
        values.byteswap()
    return values


def read_mesh(bpy, path):
    with open(path, "rb") as file:
        magic, vertices, faces = HEADER.unpack(file.read(HEADER.size))
        if magic != MAGIC:
            fail("the input file is not one of ours")
        positions = array.array("f")
        corners = array.array("i")
        positions.fromfile(file, 3 * vertices)
        corners.fromfile(file, 3 * faces)
    little_endian(positions)
    little_endian(corners)

    mesh = bpy.data.meshes.new("input")
    mesh.vertices.add(vertices)
    mesh.vertices.foreach_set("co", positions)
    mesh.loops.add(3 * faces)
    mesh.loops.foreach_set("vertex_index", corners)
    mesh.polygons.add(faces)
    mesh.polygons.foreach_set("loop_start", array.array("i", range(0, 3 * faces, 3)))
    if not mesh.polygons[0].bl_rna.properties["loop_total"].is_readonly:
        mesh.polygons.foreach_set("loop_total", array.array("i", [3]) * faces)
    mesh.update(calc_edges=True)
    # Drops what Blender's own data structure can't hold, such as a face given twice.
    if mesh.validate():
        print(f"Blender dropped {faces - len(mesh.polygons)} of {faces} faces that were there twice", flush=True)
    return mesh


def add_object(bpy, mesh):
    thing = bpy.data.objects.new("input", mesh)
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = thing
    return thing


def voxel_remesh(thing, voxel_size):
    modifier = thing.modifiers.get("remesh") or thing.modifiers.new("remesh", "REMESH")
    modifier.mode = "VOXEL"
    modifier.voxel_size = voxel_size
    modifier.adaptivity = 0.0
    modifier.use_smooth_shade = False


def union_with_itself(bpy, thing):
    # The whole mesh is one operand: taken apart, an inner shell that bounds a cavity would be a body of negative volume.
    thing.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.intersect_boolean(operation="UNION", use_swap=False, use_self=True, solver="EXACT")
    bpy.ops.object.mode_set(mode="OBJECT")


def write_result(bpy, thing, path, most_faces):
    half = path + ".half"
    write_mesh(bpy, thing, half, most_faces)
    os.rename(half, path)


def write_mesh(bpy, thing, path, most_faces):
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = len(mesh.vertices)
    faces = len(mesh.loop_triangles)
    with open(path, "wb") as file:
        file.write(HEADER.pack(MAGIC, vertices, faces))
        if faces > most_faces:
            return
        positions = array.array("f", bytes(12 * vertices))
        corners = array.array("i", bytes(12 * faces))
        mesh.vertices.foreach_get("co", positions)
        mesh.loop_triangles.foreach_get("vertices", corners)
        little_endian(positions).tofile(file)
        little_endian(corners).tofile(file)
    evaluated.to_mesh_clear()


def main():
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    if len(arguments) != 7:
        fail(f"expected 7 arguments, found {len(arguments)}")
    action, source, target = arguments[:3]
    voxel_sizes = [float(text) for text in arguments[3].split(",")]
    most_faces, memory, asker = (int(text) for text in arguments[4:])

    end_if_orphaned(asker)
    import bpy

    # Vertices: at most three for each face.
    limit_resources(memory, max(1 << 20, HEADER.size + 48 * most_faces))
    mesh = read_mesh(bpy, source)
    thing = add_object(bpy, mesh)
    if action == "voxel":
        for stage, voxel_size in enumerate(voxel_sizes):
            voxel_remesh(thing, voxel_size)
            last = stage == len(voxel_sizes) - 1
            write_result(bpy, thing, target if last else f"{target}.{stage}", most_faces)
    elif action == "union":
        union_with_itself(bpy, thing)
        write_result(bpy, thing, target, most_faces)
    else:
        fail(f"the action is '{action}'; expected voxel or union")
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender's own teardown can crash and costs time; everything is written.
    os._exit(0)


try:
    main()
except MemoryError:
    fail("out of memory")
