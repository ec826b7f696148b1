#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Builds the wheel of the Python package, with libeigencast and the libraries that it needs inside.

    wheel.py LIBRARY VERSION FOLDER      LIBRARY is libeigencast.so.0; the wheel goes into FOLDER, its path to standard output

Its tag is manylinux_2_N_PROCESSOR, where N is what the symbols of all its libraries ask of glibc: what PEP 600 means by it. Of others it
needs libstdc++ and libgcc_s alone. Needs patchelf and binutils.
"""
import base64
import hashlib
import pathlib
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
# What PEP 600 lets a wheel expect of a system.
SYSTEM = re.compile(r"^(ld-linux.*|lib(c|m|dl|rt|pthread|gcc_s|stdc\+\+)\.so\.\d+)$")


def output_of(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def needed_by(library):
    return re.findall(r"^\s+NEEDED\s+(\S+)", output_of("objdump", "-p", library), re.M)


def with_dependencies(library):
    """Name of each file -> its path: the library, and what it needs beside the system."""
    found, waiting = {}, [("libeigencast.so.0", pathlib.Path(library))]
    while waiting:
        name, path = waiting.pop()
        if name in found:
            continue
        found[name] = path.resolve()
        places = dict(re.findall(r"^\s+(\S+) => (\S+)", output_of("ldd", path), re.M))
        for needed in needed_by(path):
            if not SYSTEM.match(needed):
                waiting.append((needed, pathlib.Path(places[needed])))
    return found


def inside(name):
    """A name that no library of the system or of another wheel has: one process may load both."""
    return name if name.startswith("libeigencast") else "libeigencast-" + name


def tag_of(libraries):
    versions = [tuple(map(int, v.split("."))) for library in libraries for v in re.findall(r"GLIBC_([\d.]+)", output_of("objdump", "-T", library))]
    major, minor = max(v[:2] for v in versions)
    return f"py3-none-manylinux_{major}_{minor}_{platform.machine()}"


def licence_of(path):
    """The copyright file of the package that a library is of."""
    for name in (path, pathlib.Path(str(path).removeprefix("/usr"))):
        owner = subprocess.run(["dpkg", "-S", name], capture_output=True, text=True, check=False).stdout.split(":")[0]
        if owner:
            return pathlib.Path("/usr/share/doc") / owner / "copyright"
    sys.exit(f"wheel: {path} is of no package, so that its licence is not known")


def main():
    library, version, folder = sys.argv[1:]
    missing = [tool for tool in ("patchelf", "objdump", "ldd", "strip") if not shutil.which(tool)]
    if missing:
        sys.exit(f"wheel: {', '.join(missing)} missing: deploy/install-packages.sh packages")
    info = f"eigencast-{version}.dist-info"
    with tempfile.TemporaryDirectory() as made:
        top = pathlib.Path(made)
        shutil.copytree(ROOT / "sdk/python/eigencast", top / "eigencast", ignore=shutil.ignore_patterns("__pycache__"))
        (top / info).mkdir()
        shutil.copy(ROOT / "LICENSE", top / info / "LICENSE")
        libraries = []
        for name, path in with_dependencies(library).items():
            copy = top / "eigencast" / inside(name)
            shutil.copy(path, copy)
            subprocess.run(["strip", "--strip-unneeded", copy], check=True)
            changes = [("--replace-needed", needed, inside(needed)) for needed in needed_by(copy) if not SYSTEM.match(needed)]
            for change in (*changes, ("--set-soname", inside(name)), ("--set-rpath", "$ORIGIN")):  # one at a time: patchelf mixes them up
                subprocess.run(["patchelf", *change, copy], check=True)
            libraries.append(copy)
            if name != "libeigencast.so.0":
                shutil.copy(licence_of(path), top / info / f"LICENSE.{name}")
        tag = tag_of(libraries)
        (top / info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: eigencast\nVersion: {version}\nSummary: Publish and watch deforming 3D surfaces\nLicense: MIT\n"
            "Requires-Python: >=3.9\nRequires-Dist: numpy\nClassifier: Operating System :: POSIX :: Linux\n")
        (top / info / "WHEEL").write_text(f"Wheel-Version: 1.0\nGenerator: eigencast\nRoot-Is-Purelib: false\nTag: {tag}\n")
        wheel = pathlib.Path(folder) / f"eigencast-{version}-{tag}.whl"
        record = []
        with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            def add(name, data):
                entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))  # the same tree makes the same bytes
                entry.external_attr, entry.compress_type = 0o644 << 16, zipfile.ZIP_DEFLATED
                archive.writestr(entry, data)

            for file in sorted(p for p in top.rglob("*") if p.is_file()):
                name, data = file.relative_to(top).as_posix(), file.read_bytes()
                digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
                record.append(f"{name},sha256={digest},{len(data)}")
                add(name, data)
            add(f"{info}/RECORD", "\n".join([*record, f"{info}/RECORD,,", ""]))
    print(wheel)


main()
