"""One remesh action of tier 3, run by Blender's Python or by a Python that has bpy.

Arguments after `--`: action (voxel or union), input file, output file, voxel sizes, most faces, memory limit in bytes (0: none),
process id of the caller.

The voxel sizes are separated by commas, coarsest first. Each is a stage, whose result is written as soon as it is computed.
The last stage's result gets the name of the output file; the result of each stage before gets that name, a dot and the
stage's number, counted from 0. An interrupted run thus keeps the results of its finished stages. Each file is either whole or
missing.

Input and output are little-endian: the magic bytes below, the counts of vertices and of triangles as u64, positions as f32,
corners as u32. A result with too many triangles is written as its header alone. A failure is reported by a line that begins
with ERROR, and by a non-zero exit code. The script avoids Blender's importers and exporters, because they differ between
versions.
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
    # Blender may have printed a line without its end.
    print("\n" + ERROR + message, flush=True)
    sys.stderr.flush()
    os._exit(4)


def ancestors():
    """Yields process ids from the parent up; stops where /proc can't be read."""
    pid = os.getppid()
    while pid > 0:
        yield pid
        try:
            with open(f"/proc/{pid}/stat", "rb") as stat:
                pid = int(stat.read().rpartition(b")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            return


def end_if_orphaned(caller):
    """Exits if the caller ended before this process asked for a signal at its death."""
    if os.path.isdir("/proc/self") and caller not in ancestors():
        fail("the calling program has ended")


def address_space():
    try:
        with open("/proc/self/statm", "rb") as statm:
            return int(statm.read().split()[0]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return 0


def lower(limit, value):
    """Lowers a limit, never above the current limits."""
    soft, hard = resource.getrlimit(limit)
    known = [bound for bound in (soft, hard) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(limit, (min([value] + known), hard))


def limit_resources(memory, output_bytes):
    lower(resource.RLIMIT_CORE, 0)
    lower(resource.RLIMIT_FSIZE, output_bytes)
    if memory > 0:
        # The memory mapped at start differs by gigabytes between builds, so the limit applies to growth.
        lower(resource.RLIMIT_AS, address_space() + memory)


def little_endian(values):
    if sys.byteorder == "big":
        values.byteswap()
    return values


def read_mesh(bpy, path):
    with open(path, "rb") as file:
        magic, vertices, faces = HEADER.unpack(file.read(HEADER.size))
        if magic != MAGIC:
            fail("the input file does not begin with the expected bytes")
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
    # Drops faces that Blender's data structure can't hold, such as duplicates.
    if mesh.validate():
        print(f"Blender dropped {faces - len(mesh.polygons)} of {faces} faces as duplicate or invalid", flush=True)
    return mesh


def add_object(bpy, mesh):
    obj = bpy.data.objects.new("input", mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    return obj


def voxel_remesh(obj, voxel_size):
    modifier = obj.modifiers.get("remesh") or obj.modifiers.new("remesh", "REMESH")
    modifier.mode = "VOXEL"
    modifier.voxel_size = voxel_size
    modifier.adaptivity = 0.0
    modifier.use_smooth_shade = False


def union_with_itself(bpy, obj):
    # The whole mesh is one operand. As separate operands, an inner shell that bounds a cavity would have negative volume.
    obj.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.intersect_boolean(operation="UNION", use_swap=False, use_self=True, solver="EXACT")
    bpy.ops.object.mode_set(mode="OBJECT")


def write_result(bpy, obj, path, max_faces):
    temporary = path + ".half"
    write_mesh(bpy, obj, temporary, max_faces)
    os.rename(temporary, path)


def write_mesh(bpy, obj, path, max_faces):
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = len(mesh.vertices)
    faces = len(mesh.loop_triangles)
    with open(path, "wb") as file:
        file.write(HEADER.pack(MAGIC, vertices, faces))
        if faces > max_faces:
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
    max_faces, memory, caller = (int(text) for text in arguments[4:])

    end_if_orphaned(caller)
    import bpy

    # A result has at most three vertices per face.
    limit_resources(memory, max(1 << 20, HEADER.size + 48 * max_faces))
    mesh = read_mesh(bpy, source)
    obj = add_object(bpy, mesh)
    if action == "voxel":
        for stage, voxel_size in enumerate(voxel_sizes):
            voxel_remesh(obj, voxel_size)
            last = stage == len(voxel_sizes) - 1
            write_result(bpy, obj, target if last else f"{target}.{stage}", max_faces)
    elif action == "union":
        union_with_itself(bpy, obj)
        write_result(bpy, obj, target, max_faces)
    else:
        fail(f"the action must be voxel or union; got '{action}'")
    sys.stdout.flush()
    sys.stderr.flush()
    # All results are written. Blender's own teardown takes time and can crash.
    os._exit(0)


try:
    main()
except MemoryError:
    fail("out of memory")
