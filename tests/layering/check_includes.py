#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Holds the walls between the folders: reads every #include of the tree and compares it with the tables below.

docs/architecture.md says in words what these tables say in code. Usage: check_includes.py ROOT
"""
import pathlib
import re
import sys

# room -> rooms of this project whose headers it may include (itself is always allowed).
ROOMS = {
    "common/core": set(),
    "common/core/hash": {"common/core"},
    "common/command_line": {"common/core", "common/net"},  # Credentials
    "common/wire": {"common/core"},
    "common/codec": {"common/core"},
    "common/motion": {"common/core"},
    "common/recording": {"common/core"},
    "common/surface": {"common/core"},
    "common/surface/checks": {"common/core", "common/surface"},
    "common/surface/formats": {"common/core", "common/surface"},
    "common/surface/shapes": {"common/core", "common/surface"},
    "common/spectral": {"common/core", "common/surface", "common/surface/checks"},
    "common/progressive": {"common/core", "common/surface"},
    "common/asset": {"common/core"},
    "common/asset/tiles": {"common/core", "common/codec", "common/asset"},  # codec: its range coder
    "common/asset/format": {"common/core", "common/core/hash", "common/asset", "common/asset/tiles"},
    "common/reconstruction": {"common/core", "common/asset"},
    "common/net": {"common/core", "common/wire"},
    # The relay decides: no sockets, no clock, no other room of the broker.
    "broker/relay": {"common/core", "common/wire", "common/codec", "common/motion", "broker/websocket"},
    # RFC 6455 as bytes: no sockets, no clock.
    "broker/websocket": {"common/core"},
    "broker": {"common/core", "common/command_line", "common/core/hash", "common/wire", "common/codec", "common/motion", "common/recording"},
    "sdk": {"common/core", "common/core/hash", "common/wire", "common/codec", "common/motion", "common/surface", "common/spectral",
            "common/progressive", "common/asset", "common/reconstruction", "common/net", "common/surface/checks", "common/asset/format", "common/asset/tiles"},
    # Surfaces and handles: no window, no network.
    "sender/deform": {"common/core", "common/surface", "common/asset", "common/reconstruction", "common/surface/checks"},
    # The window over them.
    "sender/studio": {"common/core", "common/surface", "common/asset", "common/reconstruction", "common/net", "sdk", "sender/deform", "view"},
    "sender": {"common/core", "common/command_line", "common/core/hash", "common/wire", "common/codec", "common/motion", "common/surface",
               "common/spectral", "common/progressive", "common/asset", "common/reconstruction", "common/net", "common/recording", "sdk", "sender/deform", "sender/studio", "view", "common/surface/checks", "common/surface/formats", "common/surface/shapes"},
    # Streams as pictures, for every program that draws.
    "view": {"common/core", "common/motion", "common/surface", "common/asset", "common/reconstruction", "common/wire", "sdk"},
    "client": {"view", "common/core", "common/command_line", "common/core/hash", "common/wire", "common/codec", "common/motion", "common/surface",
               "common/asset", "common/reconstruction", "common/net", "sdk", "common/surface/formats", "common/surface/shapes"},
    "tools/latency": {"view", "common/core", "common/command_line", "common/wire", "common/codec", "common/surface", "common/asset", "common/reconstruction",
                      "common/net", "sdk", "common/surface/shapes"},
    "tools/compare": {"common/core", "common/surface", "common/asset", "sender"},
    "examples": {"sdk/include"},
}

# third-party library -> (pattern of its includes, rooms that may include it, how many files at most).
LIBRARIES = {
    "Eigen": (r"Eigen/", {"common/spectral", "sdk", "sender", "sender/deform"}, 24),
    "OpenMesh": (r"OpenMesh/", {"common/surface/checks"}, 1),
    "assimp": (r"assimp/", {"common/surface/formats"}, 1),
    "tinygltf": (r"tiny_gltf\.h", {"common/surface/formats"}, 1),
    "METIS": (r"metis\.h", {"common/spectral"}, 1),
    "Spectra": (r"Spectra/", {"common/spectral"}, 1),
    "nanoflann": (r"nanoflann\.hpp", {"common/spectral", "common/progressive"}, 4),
    "zstd": (r"zstd\.h", {"common/asset/tiles"}, 2),
    "OpenSSL": (r"openssl/", {"common/core/hash", "common/net", "broker", "broker/websocket"}, 10),
    "Boost": (r"boost/", {"common/net", "broker"}, 36),
    "libnats": (r"nats/", {"broker"}, 1),
    "liburing": (r"liburing\.h", {"broker"}, 1),
    "nlohmann_json": (r"nlohmann/", {"common/wire", "broker", "sdk", "sender", "sender/deform", "client", "tools/compare", "tools/latency"}, 30),
    "CLI11": (r"CLI/", {"common/command_line", "broker", "sender", "client", "tools/compare", "tools/latency"}, 10),
    "prometheus-cpp": (r"prometheus/", {"broker"}, 3),
    "systemd": (r"systemd/", {"broker"}, 1),
    "spdlog": (r"spdlog/", {"common/command_line", "sender"}, 12),
    "toml++": (r"toml(\+\+|plusplus)", {"broker"}, 2),
    "GL and windows": (r"(epoxy|GLFW|EGL|GL|imgui[a-z_0-9]*\.h|imgui)(/|$)", {"view", "client", "sender/studio"}, 20),
    "GLM": (r"glm/", {"view", "client", "sender/studio"}, 28),
    "zlib": (r"zlib\.h", {"tools/latency"}, 1),
    "libpng": (r"png\.h", {"view"}, 2),
    "libjpeg": (r"jpeglib\.h", {"view"}, 1),
}

INCLUDE = re.compile(r'^\s*#\s*include\s*(["<])([^">]+)[">]')
SOURCES = {".h", ".hpp", ".cpp", ".cc", ".c"}


def room_of(path):
    """The longest room that the path lies in."""
    parts = path.split("/")
    for length in range(len(parts) - 1, 0, -1):
        room = "/".join(parts[:length])
        if room in ROOMS:
            return room
    return None


def check(root):
    complaints, users, files = [], {name: set() for name in LIBRARIES}, 0
    for top in ("common", "broker", "sender", "view", "client", "sdk", "tools", "examples"):
        for source in sorted((root / top).rglob("*")):
            if source.suffix not in SOURCES:
                continue
            files += 1
            path = source.relative_to(root).as_posix()
            room = room_of(path)
            if room is None:
                complaints.append(f"{path}: lies in no room; add one to tests/layering/check_includes.py")
                continue
            public = path.startswith("sdk/include/")
            for number, line in enumerate(source.read_text(encoding="utf-8").splitlines(), 1):
                match = INCLUDE.match(line)
                if not match:
                    continue
                quote, target = match.groups()
                where = f"{path}:{number}: #include {target}:"
                for name, (pattern, rooms, _) in LIBRARIES.items():
                    if re.match(pattern, target) and not (root / target).exists():
                        users[name].add(path)
                        if room not in rooms:
                            complaints.append(f"{where} {room} must not know {name}")
                if target.startswith("eigencast/"):
                    if room not in ("examples", "sdk"):
                        complaints.append(f"{where} <eigencast/...> is for embedders; include the room's own header")
                    continue
                if public and (quote == '"' or "/" in target or ".h" in target.replace("std", "")):
                    if target not in ("stdint.h", "stddef.h"):
                        complaints.append(f"{where} installed headers include only std and each other")
                if not (root / target).exists():
                    if quote == '"':
                        complaints.append(f"{where} project headers are included by their path from the root")
                    continue
                used = room_of(target)
                if used != room and used not in ROOMS[room] and not (room == "broker" and used.startswith("broker/")):
                    complaints.append(f"{where} {room} must not know {used}")
    for name, (_, _, limit) in LIBRARIES.items():
        if len(users[name]) > limit:
            complaints.append(f"{name} is included by {len(users[name])} files, at most {limit}: {', '.join(sorted(users[name]))}")
    if files < 10:
        complaints.append(f"{root}: only {files} source files found; is this the root of the tree?")
    return complaints, files


def self_test(root):
    """The checker itself: a forbidden include must be found, or the walls are paper."""
    import shutil
    import tempfile
    cases = {
        "broker/x.cpp": '#include "common/surface/surface.h"\n',
        "broker/relay/x.cpp": "#include <boost/asio/io_context.hpp>\n",
        "client/x.cpp": "#include <OpenMesh/Core/IO/MeshIO.hh>\n",
        "common/codec/x.cpp": "#include <Eigen/Core>\n",
        "common/core/x.cpp": '#include "common/wire/limits.h"\n',
        "sender/x.cpp": '#include "client/session.h"\n',
        "view/x.cpp": '#include "client/session.h"\n',
        "sdk/include/eigencast/x.h": "#include <nlohmann/json.hpp>\n",
        "common/wire/x.cpp": '#include "limits.h"\n',
    }
    for path, text in cases.items():
        with tempfile.TemporaryDirectory() as folder:
            copy = pathlib.Path(folder)
            for top in ("common", "broker", "sender", "view", "client", "sdk", "tools", "examples"):
                shutil.copytree(root / top, copy / top)
            (copy / "view/camera.h").touch()
            before = set(check(copy)[0])
            (copy / path).write_text(text)
            if not set(check(copy)[0]) - before:
                return [f"self-test: {path} with {text.strip()} was not noticed"]
    return []


def check_scripts(root):
    """The documents call scripts by their names."""
    complaints = []
    for top in ("bench", "deploy", "examples", "tests"):
        for file in sorted((root / top).rglob("*")):
            if file.is_file() and file.stat().st_mode & 0o111 == 0:
                with file.open("rb") as content:
                    if content.read(2) == b"#!":
                        complaints.append(f"{file.relative_to(root)}: begins with #! and cannot be run: chmod +x")
    return complaints


def main():
    root = pathlib.Path(sys.argv[1])
    complaints, files = check(root)
    complaints += check_scripts(root)
    complaints += self_test(root)
    for complaint in complaints:
        print(complaint)
    print(f"{files} files read, {len(complaints)} complaints")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
