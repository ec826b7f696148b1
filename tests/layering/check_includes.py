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
    "common/levels": {"common/core"},
    "common/recording": {"common/core"},
    "common/surface": {"common/core"},
    "common/surface/checks": {"common/core", "common/surface"},
    "common/surface/formats": {"common/core", "common/surface"},
    "common/surface/shapes": {"common/surface"},
    "common/spectral": {"common/core", "common/surface", "common/surface/checks"},
    "common/progressive": {"common/core", "common/surface"},
    "common/asset": {"common/core"},
    "common/asset/tiles": {"common/core", "common/codec", "common/asset"},  # codec: its range coder
    "common/asset/format": {"common/core", "common/core/hash", "common/asset", "common/asset/tiles"},
    "common/reconstruction": {"common/core", "common/asset"},
    "common/net": {"common/core", "common/wire"},
    # The broker's rooms, from the inside out; its main program and class Broker lie in "broker" itself.
    "broker/websocket": {"common/core"},  # RFC 6455 as bytes: no sockets, no clock.
    # Decides what is sent when: no sockets, no clock.
    "broker/relay": {"common/core", "common/wire", "common/codec", "common/motion", "broker/websocket"},
    "broker/config": {"common/core", "common/wire"},
    "broker/access": {"common/core", "common/core/hash", "broker/config"},
    "broker/command_line": {"common/core", "common/command_line", "broker/config", "broker/access"},
    "broker/sockets": {"common/core", "broker/config"},
    "broker/storage": {"common/core", "common/core/hash", "common/asset", "common/asset/format", "common/recording", "common/wire", "broker/access", "broker/relay"},
    "broker/backbone": {"common/core", "common/core/hash", "common/wire", "broker/access", "broker/config", "broker/relay", "broker/storage"},
    "broker/context": {"common/core", "broker/config"},
    "broker/connections": {"common/core", "common/wire", "broker/access", "broker/context", "broker/relay",
                           "broker/sockets", "broker/storage", "broker/websocket"},
    "broker/loops": {"common/core", "broker/connections", "broker/context", "broker/relay", "broker/sockets"},
    "broker/http": {"common/core", "common/core/hash", "common/wire", "broker/access", "broker/connections", "broker/context",
                    "broker/loops", "broker/relay", "broker/sockets", "broker/storage", "broker/websocket"},
    "broker/operation": {"common/core", "common/command_line", "common/wire", "broker/access", "broker/backbone", "broker/config", "broker/connections", "broker/context",
                         "broker/http", "broker/loops", "broker/relay", "broker/sockets", "broker/storage"},
    "broker": {"common/core", "broker/access", "broker/backbone", "broker/command_line", "broker/config", "broker/connections", "broker/http",
               "broker/loops", "broker/operation", "broker/relay", "broker/sockets", "broker/storage"},
    "sdk": {"common/core", "common/core/hash", "common/wire", "common/codec", "common/motion", "common/surface", "common/spectral",
            "common/progressive", "common/asset", "common/reconstruction", "common/recording", "common/net", "common/surface/checks", "common/asset/format", "common/asset/tiles"},
    # Surfaces and handles: no window, no network.
    "sender/deform": {"common/core", "common/surface", "common/asset", "common/reconstruction", "common/surface/checks"},
    # The window over them.
    "sender/studio": {"common/core", "common/surface", "common/asset", "common/reconstruction", "common/net", "sdk", "sender/deform", "view"},
    "sender": {"common/core", "common/command_line", "common/core/hash", "common/wire", "common/codec", "common/surface",
               "common/spectral", "common/motion", "common/progressive", "common/asset", "common/reconstruction", "common/recording", "common/net", "sdk", "sender/deform", "sender/studio", "common/surface/checks", "common/surface/formats", "common/surface/shapes"},
    # Streams as pictures, for every program that draws.
    "view": {"common/core", "common/motion", "common/surface", "common/asset", "common/reconstruction", "sdk"},
    "client": {"view", "common/core", "common/command_line", "common/levels", "common/wire", "common/motion", "common/surface",
               "common/asset", "common/reconstruction", "common/net", "sdk", "common/surface/formats", "common/surface/shapes"},
    "tools/latency": {"view", "common/core", "common/command_line", "common/wire", "common/asset", "common/reconstruction",
                      "common/net", "sdk", "common/surface/shapes"},
    "tools/igtl": {"common/core", "common/command_line", "common/net"},  # Credentials; libeigencast, installed
    "tools/compare": {"common/core", "common/surface", "common/asset", "sender"},
    # What the browser's viewer shares with the native ones, compiled for WebAssembly.
    "web/core": {"common/core", "common/core/hash", "common/wire", "common/codec", "common/motion", "common/levels", "common/asset/format",
                 "common/reconstruction", "sdk"},
    "examples": set(),
}

# third-party library -> (pattern of its includes, rooms that may include it, how many files at most).
LIBRARIES = {
    "Eigen": (r"Eigen/", {"common/spectral", "sender/deform"}, 17),
    "OpenMesh": (r"OpenMesh/", {"common/surface/checks"}, 1),
    "assimp": (r"assimp/", {"common/surface/formats"}, 1),
    "tinygltf": (r"tiny_gltf\.h", {"common/surface/formats"}, 1),
    "METIS": (r"metis\.h", {"common/spectral"}, 1),
    "Spectra": (r"Spectra/", {"common/spectral"}, 1),
    "nanoflann": (r"nanoflann\.hpp", {"common/spectral", "common/progressive"}, 2),
    "OpenSSL": (r"openssl/", {"common/core/hash", "common/net", "broker/access", "broker/sockets", "broker/websocket"}, 9),
    "Boost": (r"boost/", {"common/net", "broker", "broker/access", "broker/backbone", "broker/config", "broker/connections", "broker/http", "broker/loops",
                         "broker/sockets"}, 22),
    "Boost.Beast": (r"boost/beast/", {"common/net", "broker/http"}, 7),
    "libnats": (r"nats/", {"broker/backbone"}, 1),
    "libqrencode": (r"qrencode\.h", {"broker/command_line"}, 1),
    "liburing": (r"liburing\.h", {"broker/sockets"}, 1),
    "nlohmann_json": (r"nlohmann/", {"common/wire", "broker/access", "broker/backbone", "broker/http", "broker/operation", "sdk", "sender",
                                     "sender/deform", "client", "tools/compare", "tools/latency"}, 31),
    "CLI11": (r"CLI/", {"common/command_line", "broker/command_line", "sender", "tools/compare", "tools/igtl", "tools/latency"}, 9),
    "prometheus-cpp": (r"prometheus/", {"broker/operation"}, 1),
    "systemd": (r"systemd/", {"broker/operation"}, 1),
    "spdlog": (r"spdlog/", {"common/command_line", "sender"}, 11),
    "toml++": (r"toml(\+\+|plusplus)", {"broker/config"}, 1),
    "GL and windows": (r"(epoxy|GLFW|EGL|GL|X11|imgui[a-z_0-9]*\.h|imgui)(/|$)", {"view", "client"}, 5),
    "GLM": (r"glm/", {"view", "client", "sender/studio"}, 27),
    "zlib": (r"zlib\.h", {"tools/latency"}, 1),
    "libpng": (r"png\.h", {"view"}, 1),
    "libjpeg": (r"jpeglib\.h", {"view"}, 1),
}

# In these rooms and those below them no files include or call each other in a circle: x.h and x.cpp count as one.
WITHOUT_CIRCLES = ("common/asset/", "common/progressive/", "common/surface/")

INCLUDE = re.compile(r'^\s*#\s*include\s*(["<])([^">]+)[">]')
SOURCES = {".def", ".h", ".hpp", ".cpp", ".cc", ".c"}


def room_of(path):
    """The longest room that the path lies in."""
    parts = path.split("/")
    for length in range(len(parts) - 1, 0, -1):
        room = "/".join(parts[:length])
        if room in ROOMS:
            return room
    return None


def read_tree(root):
    """The text of every source by its path."""
    tops = ("common", "broker", "sender", "view", "client", "sdk", "tools", "web/core", "examples")
    return {source.relative_to(root).as_posix(): source.read_text(encoding="utf-8")
            for top in tops for source in sorted((root / top).rglob("*")) if source.suffix in SOURCES}


def check_include(path, room, where, quote, target, sources, users):
    """What is wrong with one #include; notes in `users` which libraries the file uses."""
    complaints = []
    for name, (pattern, rooms, _) in LIBRARIES.items():
        if re.match(pattern, target) and target not in sources:
            users[name].add(path)
            if room not in rooms:
                complaints.append(f"{where} {room} must not know {name}")
    if target.startswith("eigencast/"):
        if room not in ("examples", "sdk", "tools/igtl"):
            complaints.append(f"{where} <eigencast/...> is for embedders; include the room's own header")
        return complaints
    if path.startswith("sdk/include/") and (quote == '"' or "/" in target or ".h" in target.replace("std", "")):
        if target not in ("stdint.h", "stddef.h"):
            complaints.append(f"{where} installed headers include only std and each other")
    if target not in sources:
        if quote == '"':
            complaints.append(f"{where} project headers are included by their path from the root")
        return complaints
    used = room_of(target)
    if used != room and used not in ROOMS[room]:
        complaints.append(f"{where} {room} must not know {used}")
    return complaints


def check(sources, known=None):
    """What is wrong with the includes of `sources`, in a tree of the files `known` (default: themselves)."""
    known = known or sources
    complaints, users = [], {name: set() for name in LIBRARIES}
    for path, text in sources.items():
        room = room_of(path)
        if room is None:
            complaints.append(f"{path}: lies in no room; add one to tests/layering/check_includes.py")
            continue
        for number, line in enumerate(text.splitlines(), 1):
            match = INCLUDE.match(line)
            if match:
                where = f"{path}:{number}: #include {match[2]}:"
                complaints += check_include(path, room, where, match[1], match[2], known, users)
    for name, (_, _, limit) in LIBRARIES.items():
        if len(users[name]) > limit:
            complaints.append(f"{name} is included by {len(users[name])} files, at most {limit}: {', '.join(sorted(users[name]))}")
    if len(known) < 10:
        complaints.append(f"only {len(known)} source files found; is this the root of the tree?")
    return complaints


def check_table(sources):
    """Rooms that may include each other would be one room; a room without sources is a leftover; a folder of the broker needs a row."""
    complaints, done = [], set()

    def visit(room, trail):
        if room in trail:
            complaints.append(f"rooms in a cycle: {' -> '.join(trail[trail.index(room):] + [room])}")
        elif room not in done:
            for used in sorted(ROOMS.get(room, ())):
                visit(used, trail + [room])
            done.add(room)

    for room in ROOMS:
        visit(room, [])
    used_rooms = {room_of(path) for path in sources}
    complaints += [f"room {room} has no sources" for room in ROOMS if room not in used_rooms]
    folders = {path.rpartition("/")[0] for path in sources if path.startswith("broker/")}
    complaints += [f"{folder}/ has no row in ROOMS" for folder in sorted(folders - set(ROOMS))]
    return complaints


def check_unused(sources):
    """Allowances of the tables that no #include needs."""
    rooms, libraries = set(), set()
    for path, text in sources.items():
        for target in (match[2] for match in map(INCLUDE.match, text.splitlines()) if match):
            rooms.add((room_of(path), room_of(target) if target in sources else None))
            libraries |= {(name, room_of(path)) for name, (pattern, _, _) in LIBRARIES.items()
                          if target not in sources and re.match(pattern, target)}
    return ([f"{room} includes nothing of {used}: take the allowance away" for room in ROOMS for used in sorted(ROOMS[room])
             if (room, used) not in rooms] +
            [f"{room} does not include {name}: take the allowance away" for name, (_, allowed, _) in LIBRARIES.items()
             for room in sorted(allowed) if (name, room) not in libraries])


def check_circles(sources):
    """Files of WITHOUT_CIRCLES that reach themselves over the headers that they and others include."""
    uses = {}
    for path, text in sources.items():
        if path.startswith(WITHOUT_CIRCLES):
            name = path.rpartition(".")[0]
            targets = {match.group(2).rpartition(".")[0] for match in map(INCLUDE.match, text.splitlines()) if match}
            uses.setdefault(name, set()).update(targets - {name})

    def reached(name):
        seen, front = set(), [name]
        while front:
            new = uses.get(front.pop(), set()) - seen
            seen |= new
            front.extend(new)
        return seen

    return [f"{name}: includes or calls itself over {', '.join(sorted(r for r in reached(name) if name in reached(r)))}"
            for name in sorted(uses) if name in reached(name)]


def self_test(sources):
    """The checker itself: a forbidden include must be found, or the walls are paper."""
    cases = [
        ("broker/x.cpp", '#include "common/surface/surface.h"'),
        ("broker/relay/x.cpp", "#include <boost/asio/io_context.hpp>"),
        ("broker/connections/x.cpp", "#include <boost/beast/http/parser.hpp>"),
        ("client/x.cpp", "#include <OpenMesh/Core/IO/MeshIO.hh>"),
        ("common/codec/x.cpp", "#include <Eigen/Core>"),
        ("common/core/x.cpp", '#include "common/wire/limits.h"'),
        ("sender/x.cpp", '#include "client/session.h"'),
        ("view/x.cpp", '#include "client/session.h"'),
        ("sdk/include/eigencast/x.h", "#include <nlohmann/json.hpp>"),
        ("common/wire/x.cpp", '#include "limits.h"'),
    ]
    # Every room of the broker against every other one that it must not know.
    header_of = {room_of(path): path for path in sources if path.startswith("broker/") and path.endswith(".h")}
    for room in (room for room in ROOMS if room.startswith("broker/")):
        cases += [(f"{room}/x.cpp", f'#include "{header}"') for used, header in header_of.items()
                  if used != room and used not in ROOMS[room]]
    for path, text in cases:
        if not check({path: text}, sources):
            return [f"self-test: {path} with {text} was not noticed"]
    if not check_unused({path: text for path, text in sources.items() if not path.startswith("common/asset/tiles/")}):
        return ["self-test: an allowance that nothing uses was not noticed"]
    if not check_circles({**sources, "common/surface/surface.cpp": '#include "common/surface/appearance.h"'}):
        return ["self-test: a circle of includes was not noticed"]
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
    sources = read_tree(root)
    complaints = check(sources) + check_table(sources) + check_unused(sources) + check_circles(sources) + check_scripts(root)
    complaints += self_test(sources) if not complaints else []
    for complaint in complaints:
        print(complaint)
    print(f"{len(sources)} files read, {len(complaints)} complaints")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
