"""Tries an image that `make image` wrote: starts its root file system as its user, read-only, and repairs models in it.

    check-image.py ARCHIVE full|slim

Needs root, or user namespaces, but no container engine: the image's layers are unpacked, and its entry point runs with its
variables in namespaces of its own, so that the image's ports are free there. Only /data and /tmp can be written.
"""

import array
import fcntl
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tarfile
import tempfile
import time
import urllib.request
from pathlib import Path

MOST_BYTES = {"full": 900_000_000, "slim": 70_000_000}
# A box without a lid, with an unwelded corner.
BROKEN = b"""OFF
9 5 0
0 0 0
10 0 0
10 10 0
0 10 0
0 0 30
10 0 30
10 10 30
0 10 30
10 10 30
4 3 2 1 0
4 0 1 5 4
4 1 2 6 5
4 2 3 7 8
4 3 0 4 7
"""
# Longest wait for the service, for a job, and for its end.
PATIENCE_S = 120


def fail(message):
    sys.exit(f"check-image: {message}")


def unpack(archive, root):
    """Unpacks the layers of an archive of `docker save`; returns its configuration and the bytes of all layers."""
    size = 0
    with tarfile.open(archive) as outer:
        manifest = json.load(outer.extractfile("manifest.json"))[0]
        config = json.load(outer.extractfile(manifest["Config"]))
        for name in manifest["Layers"]:
            layer = outer.extractfile(name)
            # A second entry of the same layer is a link to the first.
            with tarfile.open(fileobj=layer, mode="r:*") as inner:
                for member in inner:
                    size += member.size
                    folder, file = os.path.split(member.name)
                    if file.startswith(".wh."):
                        gone = root / folder / file.removeprefix(".wh.")
                        if gone.is_dir() and not gone.is_symlink():
                            shutil.rmtree(gone)
                        else:
                            gone.unlink(missing_ok=True)
                    elif not member.isdev():
                        inner.extract(member, root, numeric_owner=True)
    return config["config"], size


def mount(*words):
    subprocess.run(["mount", *words], check=True)


def confine(root):
    """Makes the root file system read-only, except for /data and /tmp, as an orchestrator does."""
    mount("--make-rprivate", "/")
    for name in ["proc", "dev", "data", "tmp"]:
        (root / name).mkdir(exist_ok=True)
    mount("--bind", str(root), str(root))
    mount("-t", "proc", "proc", str(root / "proc"))
    mount("-t", "tmpfs", "-o", "mode=0755", "tmpfs", str(root / "dev"))
    for device in ["null", "zero", "random", "urandom", "full"]:
        (root / "dev" / device).touch()
        mount("--bind", f"/dev/{device}", str(root / "dev" / device))
    for folder in ["data", "tmp"]:
        mount("-t", "tmpfs", "-o", "mode=1777,size=1g", "tmpfs", str(root / folder))
    mount("-o", "remount,bind,ro", str(root), str(root))


def raise_loopback():
    """Turns the loopback interface of the new network namespace on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = array.array("B", struct.pack("16sh", b"lo", 0x1))  # IFF_UP
        fcntl.ioctl(any_socket, 0x8914, request)  # SIOCSIFFLAGS


class Container:
    """The unpacked image."""

    def __init__(self, root, config):
        self.root, self.config = root, config
        user, group = config["User"].split(":")
        if "0" in (user, group):
            fail(f"the image runs as {config['User']}")
        # The image's PATH need not have it.
        prefix = [shutil.which("chroot"), f"--userspec={user}:{group}", "--groups=", str(root)]
        self.prefix = ["setpriv", "--no-new-privs", *prefix]
        # Here tini is not the first process of a container, as it would be elsewhere.
        self.variables = {**dict(pair.split("=", 1) for pair in config["Env"]), "TINI_SUBREAPER": "1"}

    def command(self, words, **more):
        """The arguments of a process in the container, for subprocess. Programs are found on the image's PATH."""
        path = self.variables["PATH"].split(":")
        program = next((f"{folder}/{words[0]}" for folder in path if (self.root / f"{folder}/{words[0]}".lstrip("/")).exists()), None)
        if program is None:
            fail(f"the image has no {words[0]}")
        return {"args": [*self.prefix, program, *words[1:]], "env": self.variables, **more}

    def run(self, *words, expected=0):
        ran = subprocess.run(**self.command(words, capture_output=True, text=True))
        if ran.returncode != expected:
            fail(f"{' '.join(words)}: exit code {ran.returncode}\n{ran.stdout}{ran.stderr}")
        return ran.stdout


def request(path, key, body=None, **headers):
    headers["Authorization"] = f"Bearer {key}"
    with urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:8080{path}", body, headers), timeout=60) as response:
        return json.load(response)


def submit(key, options):
    """Submits the broken box and waits for its end; returns its report."""
    boundary = "8c7e1f1c"
    parts = [('name="options"', json.dumps(options).encode()), ('name="file"; filename="box.off"', BROKEN)]
    lines = (f"--{boundary}\r\nContent-Disposition: form-data; {name}\r\n\r\n".encode() + body + b"\r\n" for name, body in parts)
    body = b"".join(lines) + f"--{boundary}--\r\n".encode()
    job = request("/v1/jobs", key, body, **{"Content-Type": f"multipart/form-data; boundary={boundary}"})
    deadline = time.monotonic() + PATIENCE_S
    while job["status"] not in ("succeeded", "failed", "canceled"):
        if time.monotonic() > deadline:
            fail(f"the job does not end: {job}")
        job = request(f"/v1/jobs/{job['id']}?wait=20", key)
    if job["status"] != "succeeded":
        fail(f"the job failed: {job}")
    return request(f"/v1/jobs/{job['id']}/artifacts/report.json", key)


def check_command_line(container):
    """Repairs a file in the container, and checks that nothing else can be written."""
    data = container.root / "data"
    (data / "broken.off").write_bytes(BROKEN)
    container.run("meshmend", "repair", "/data/broken.off", "-o", "/data/box.stl")
    container.run("meshmend", "inspect", "/data/box.stl")
    refused = subprocess.run(**container.command(["meshmend", "repair", "/data/broken.off", "-o", "/usr/box.stl"], capture_output=True, text=True))
    if refused.returncode == 0 or "Read-only" not in refused.stderr:
        fail(f"the root file system is not read-only: {refused.stderr}")


def check_service(container, kind):
    """Starts the image's own command, and repairs models through its API; with Blender where the image has one."""
    config = container.config
    log = container.root / "tmp" / "log"
    with log.open("wb") as sink:
        service = subprocess.Popen(**container.command([*config["Entrypoint"], *config["Cmd"]], stdout=sink, stderr=sink))
    try:
        health = config["Healthcheck"]["Test"]
        if health[0] != "CMD":
            fail(f"the health check is no command: {health}")
        deadline = time.monotonic() + PATIENCE_S
        while subprocess.run(**container.command(health[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)).returncode != 0:
            if time.monotonic() > deadline or service.poll() is not None:
                fail(f"the health check does not pass\n{log.read_text()}")
            time.sleep(0.2)
        status = Path(f"/proc/{service.pid}/status").read_text()
        ids = next(line for line in status.splitlines() if line.startswith("Uid:"))
        if "10001" not in ids:
            fail(f"the service runs as {ids}")
        key = container.run("meshmend", "keys", "create", "--tenant", "check", "--scopes", "jobs:read,jobs:write").strip()
        report = submit(key, {"output": "stl"})
        print(f"check-image: {kind}: the service repaired a box: {report['outcome']}")
        capabilities = request("/v1/capabilities", key)
        blender = capabilities["tiers"][2]
        if blender["available"] != (kind == "full"):
            fail(f"Blender: {blender}")
        if kind == "full":
            report = submit(key, {"preset": "blender-remesh", "voxel_size": 0.5})
            step = next((step for step in report["steps"] if step["action"] == "voxel_remesh"), None)
            if step is None or step["status"] != "done":
                fail(f"Blender did not remesh the box: {report['steps']}")
            print(f"check-image: {kind}: Blender {step['program']['version']} remeshed a box: {report['outcome']}")
    except BaseException:
        sys.stderr.write(log.read_text())
        raise
    finally:
        service.terminate()
        code = service.wait(timeout=PATIENCE_S)
    if code != 0:
        fail(f"after SIGTERM the service ended with {code}\n{log.read_text()}")


def main():
    archive, kind = sys.argv[1:3]
    if "inside" not in sys.argv:
        # New namespaces for mounts, processes and the network.
        rights = [] if os.geteuid() == 0 else ["--map-root-user"]
        again = [sys.executable, __file__, archive, kind, "inside"]
        os.execvp("unshare", ["unshare", *rights, "--mount", "--net", "--pid", "--fork", "--kill-child", *again])
    with tempfile.TemporaryDirectory(prefix="meshmend-image-") as folder:
        root = Path(folder) / "root"
        root.mkdir()
        config, size = unpack(archive, root)
        print(f"check-image: {kind}: {size / 1e6:.0f} MB")
        if size > MOST_BYTES[kind]:
            fail(f"{kind}: {size} bytes are more than {MOST_BYTES[kind]}")
        mount("-t", "proc", "proc", "/proc")
        raise_loopback()
        try:
            confine(root)
            container = Container(root, config)
            print(f"check-image: {kind}: {container.run('meshmend', '--version').strip()} as {config['User']}", flush=True)
            check_command_line(container)
            check_service(container, kind)
        finally:
            subprocess.run(["umount", "--recursive", str(root)], check=False)


main()
