#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Packs the add-on, and the Python package that it uses, into a zip that Blender installs. Usage: pack.py FILE.zip

libeigencast is found where it is installed (libeigencast0, or EIGENCAST_LIBRARY): the zip is the same for all machines.
"""
import ast
import pathlib
import re
import sys
import zipfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
ADD_ON, PACKAGE = ROOT / "tools/blender/add_on.py", ROOT / "sdk/python/eigencast"


def main(path):
    source = ADD_ON.read_text()
    stated = ast.literal_eval(re.search(r"^bl_info = (\{.*?^\})", source, re.M | re.S)[1])["version"]
    version = re.search(r"project\(eigencast VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text())[1]
    if ".".join(map(str, stated)) != version:
        sys.exit(f"{ADD_ON}: bl_info says version {stated}, the project is {version}")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for file, name in ((ADD_ON, "__init__.py"), *((file, f"eigencast/{file.name}") for file in sorted(PACKAGE.glob("*.py")))):
            entry = zipfile.ZipInfo(f"eigencast_blender/{name}")  # Of no date: the same files are the same zip.
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            out.writestr(entry, file.read_bytes())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
