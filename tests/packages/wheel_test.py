#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The wheel of deploy/wheel.py in a clean environment without a network: its tag tells the truth, and what it publishes arrives.

Usage: wheel_test.py BROKER LIBRARY VERSION. Exits with 77 where numpy, venv or patchelf is missing.
"""
import hashlib
import importlib.util
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
SYSTEM = re.compile(r"^(linux-vdso|/lib64/ld-linux|ld-linux|lib(c|m|dl|rt|pthread|gcc_s|stdc\+\+)\.so)")
PROGRAM = '''
import hashlib, ssl, sys, numpy, eigencast
assert eigencast.library_path().startswith(sys.prefix), eigencast.library_path()
side = 20
y, x = (a.ravel() / side for a in numpy.mgrid[0:side, 0:side])
corner = (numpy.arange(side - 1)[:, None] * side + numpy.arange(side - 1)).ravel()
squares = numpy.stack([corner, corner + 1, corner + side + 1, corner + side], axis=1)
with eigencast.Stream(sys.argv[1], rank=60, cache_dir="", max_rate_hz=1e6) as stream, \\
        eigencast.Subscriber(sys.argv[1] + "?rate=raw", cache_dir="") as viewer:
    for i in range(31):
        points = numpy.stack([x + i, y, 0.1 * numpy.sin(5 * x)], axis=1)
        stream.send(points, squares)
        while (pose := viewer.next(timeout=1)) is None or len(pose.positions) < side * side:
            pass
        assert numpy.abs(pose.in_source_order() - points).max() < 0.01, i
    stats = stream.stats
print(stats.poses_taken, stats.poses_sent)
print("\\n".join({line.split()[-1] for line in open("/proc/self/maps") if "eigencast" in line and ".so" in line}))
'''


def run(*command, **more):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=200, check=False, **more)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


def check_files(wheel, folder):
    """All that its libraries need is inside or of the system; no symbol is newer than the tag says."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    allowed = tuple(map(int, re.search(r"manylinux_(\d+)_(\d+)_\w+\.whl$", wheel.name).groups()))
    newest = (0, 0)
    for library in sorted((folder / "eigencast").glob("*.so*")):
        for line in run("ldd", library).splitlines():
            name, where = line.split()[0], re.search(r"=> (\S+)", line)
            assert SYSTEM.match(name) or (where and where[1].startswith(str(folder))), f"{library.name} needs {line}"
        versions = re.findall(r"GLIBC_(\d+)\.(\d+)", run("objdump", "-T", library))
        newest = max([newest, *(tuple(map(int, v)) for v in versions)])
    assert newest == allowed, f"its symbols are of glibc {newest}, its tag says {allowed}"
    for line in next(folder.glob("*.dist-info/RECORD")).read_text().splitlines():
        assert (folder / line.split(",")[0]).is_file(), line
    assert len(list(folder.glob("*.dist-info/LICENSE.*"))) == len(list((folder / "eigencast").glob("libeigencast-*"))), "a licence each"


def main():
    broker_program, library, version = sys.argv[1:]
    missing = [module for module in ("numpy", "ensurepip") if not importlib.util.find_spec(module)]
    missing += [tool for tool in ("patchelf", "objdump") if not shutil.which(tool)]
    if missing:
        print(f"SKIPPED: {', '.join(missing)} missing: deploy/install-packages.sh tests")
        sys.exit(77)
    with tempfile.TemporaryDirectory(prefix="eigencast-wheel-") as name:
        folder = pathlib.Path(name)
        for out in ("a", "b"):
            (folder / out).mkdir()
            wheel = pathlib.Path(run(sys.executable, ROOT / "deploy/wheel.py", library, version, folder / out).strip())
        digests = {hashlib.sha256((folder / out / wheel.name).read_bytes()).hexdigest() for out in ("a", "b")}
        assert len(digests) == 1, "the same library makes the same wheel"
        check_files(wheel, folder / "files")
        clean = {key: value for key, value in os.environ.items() if not key.startswith(("EIGENCAST_", "PYTHON", "LD_", "PIP_"))}
        run(sys.executable, "-m", "venv", "--system-site-packages", folder / "venv", env=clean)
        python = folder / "venv/bin/python"
        run(python, "-m", "pip", "install", "--no-index", "--no-cache-dir", "--disable-pip-version-check", wheel, env=clean)
        port = folder / "port"
        broker = subprocess.Popen([broker_program, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                                   folder / "assets"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            end = time.monotonic() + 60
            while not port.exists() or not port.read_text().endswith("\n"):
                if time.monotonic() > end:
                    sys.exit("the broker did not start")
                time.sleep(0.02)
            counts, *loaded = run(python, "-c", PROGRAM, f"http://127.0.0.1:{port.read_text().split()[0]}/wheel", env=clean, cwd=folder).splitlines()
        finally:
            broker.terminate()
            broker.wait()
        assert counts == "31 31", counts
        assert loaded and all(path.startswith(str(folder / "venv")) for path in loaded), loaded
        run(python, "-m", "pip", "uninstall", "-y", "eigencast", env=clean)
        assert not list((folder / "venv").rglob("*eigencast*")), "nothing of it is left"
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {counts} poses taken and sent, all received")


main()
