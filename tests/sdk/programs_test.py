#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Builds the programs of examples/ against an installed tree; each watches one of another language.

Usage: programs_test.py BUILD_DIR SOURCE_DIR. Exits with 77 where numpy is missing.
"""
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import zlib

try:
    import numpy  # noqa: F401, the Python programs need it
except ImportError:
    print("SKIPPED: numpy is not installed for this interpreter")
    sys.exit(77)

BUILD, SOURCE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
WATCHED_BY = {"publish.c": "subscribe.py", "publish.cpp": "subscribe.c", "publish.py": "subscribe.cpp"}
SHOWN = {"stress.py", "painted.py"}  # watched by eigencast-client
ARGUMENTS = {"publish.cpp": ["10"], "subscribe.cpp": ["30"]}  # seconds, poses


def run(command, **more):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=100, check=False, **more)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


def commands(folder, prefix, environment):
    """Name of each program -> its command, built where needed."""
    flags = run(["pkg-config", "--cflags", "--libs", "eigencast"], env=environment).split()
    made = {}
    for name in sorted({*WATCHED_BY, *WATCHED_BY.values(), *SHOWN}):
        source = SOURCE / "examples" / name
        if name.endswith(".py"):
            made[name] = [sys.executable, source]
            continue
        program = folder / name.replace(".", "_")
        compiler = ["cc", "-std=gnu11"] if name.endswith(".c") else ["c++", "-std=c++20"]
        run(compiler + ["-Wall", "-Wextra", "-Werror", source, "-o", program] + flags + ["-lm"], env=environment)
        made[name] = [program]
    return made


def rgb_of(png):
    """Rows of r, g, b of an 8-bit PNG picture without interlacing."""
    data, at, packed = png.read_bytes(), 8, b""
    while at < len(data):
        length, kind = int.from_bytes(data[at:at + 4], "big"), data[at + 4:at + 8]
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, samples = int.from_bytes(body[:4], "big"), int.from_bytes(body[4:8], "big"), {2: 3, 6: 4}[body[9]]
        packed += body if kind == b"IDAT" else b""
        at += length + 12
    raw, stride = zlib.decompress(packed), samples * width
    picture = numpy.zeros((height + 1, stride + samples), dtype=int)  # a row above and a pixel before, of zeros
    for y in range(height):
        kind, line = raw[y * (stride + 1)], raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)]
        row, up = picture[y + 1], picture[y]
        for i, value in enumerate(line, samples):
            a, b, c = row[i - samples], up[i], up[i - samples]
            nearest = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            row[i] = value + (0, a, b, (a + b) // 2, nearest)[kind] & 255
    return picture[1:, samples:].reshape(height, width, samples)[:, :, :3]


def write_png(path, rgb):
    """rgb: rows of pixels of three bytes."""
    def chunk(kind, body):
        return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")

    size = rgb.shape[1].to_bytes(4, "big") + rgb.shape[0].to_bytes(4, "big")
    rows = b"".join(b"\0" + row.astype("uint8").tobytes() for row in rgb)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size + bytes([8, 2, 0, 0, 0])) + chunk(b"IDAT", zlib.compress(rows)) +
                     chunk(b"IEND", b""))


def pictures_of(command, url, prefix, environment, folder, colours):
    """What eigencast-client shows of a program's stream, coloured by each of `colours`: rows of r, g, b."""
    viewer = prefix / "bin/eigencast-client"
    if not viewer.exists():
        print("SKIPPED: no viewer in this build")
        sys.exit(77)
    shown = {}
    with subprocess.Popen(command[:2] + [url] + command[2:], env=environment) as sender:
        for colour in colours:
            pictures = folder / (url.rsplit("/", 1)[1] + "-" + colour.replace(":", "-"))
            run([viewer, url, "--headless", "--frames", "10", "--out", pictures, "--size", "160x120", "--colour", colour], env=environment)
            shown[colour] = rgb_of(sorted(pictures.glob("*.png"))[-1])
        sender.terminate()
    return shown


def watch_scalar(command, url, prefix, environment, folder):
    """A viewer that is asked for the scalar paints the surface with it: viridis is far greener than clay and wall."""
    shown = pictures_of(command, url, prefix, environment, folder, ("clay", "channel:stress"))
    green = {colour: int((rgb[:, :, 1] - rgb[:, :, 0] > 50).sum()) for colour, rgb in shown.items()}
    if green["clay"] > 20 or green["channel:stress"] < 300:
        sys.exit(f"pixels in the colours of the scalar: {green}")
    print(f"stress.py, watched by eigencast-client: pixels in the colours of the scalar {green}")


def watch_looks(command, url, prefix, environment, folder):
    """The image lies on the surface the right way round (magenta above cyan); colours are where their vertices are (red grows to the right,
    green upwards)."""
    image = numpy.zeros((64, 64, 3))
    image[:32], image[32:] = (255, 0, 255), (0, 255, 255)
    write_png(folder / "image.png", image)

    def is_above(what, first, second):
        if min(first.sum(), second.sum()) < 150 or numpy.nonzero(first)[0].mean() + 5 > numpy.nonzero(second)[0].mean():
            sys.exit(f"{what}: {first.sum()} and {second.sum()} pixels, of which the first should be above and there be 150 of each")
        return f"{what} {first.sum()} and {second.sum()} pixels"

    textured = pictures_of(command + [folder / "image.png"], url + "-textured", prefix, environment, folder, ("textured",))
    coloured = pictures_of(command, url + "-coloured", prefix, environment, folder, ("own",))
    r, g, b = (textured["textured"][:, :, c] for c in range(3))
    lines = [is_above("magenta, cyan", (r > g + 60) & (b > g + 60), (g > r + 60) & (b > r + 60))]
    r, g, b = (coloured["own"][:, :, c] for c in range(3))
    lines.append(is_above("green, red", (g > r + 60) & (g > b + 60), (r > g + 60) & (r > b + 60)))
    print(f"painted.py, watched by eigencast-client: {'; '.join(lines)}")


def main():
    with tempfile.TemporaryDirectory(prefix="eigencast-sdk-") as name:
        folder = pathlib.Path(name)
        prefix = folder / "prefix"
        run(["cmake", "--install", BUILD, "--prefix", prefix])
        library = next(prefix.rglob("libeigencast.so.0"))
        package = next(prefix.rglob("eigencast/__init__.py"))
        environment = dict(os.environ, PKG_CONFIG_PATH=str(next(prefix.rglob("eigencast.pc")).parent), LD_LIBRARY_PATH=str(library.parent),
                           PYTHONPATH=str(package.parent.parent), EIGENCAST_CACHE=str(folder / "cache"), PYTHONDONTWRITEBYTECODE="1",
                           XDG_CACHE_HOME=str(folder / "cache"))
        made = commands(folder, prefix, environment)
        port_file = folder / "port"
        broker = subprocess.Popen([prefix / "bin/eigencast-broker", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file",
                                   port_file, "--data-dir", folder / "assets"], env=environment, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL)
        try:
            end = time.monotonic() + 60
            while not port_file.exists() or not port_file.read_text().endswith("\n"):
                if time.monotonic() > end or broker.poll() is not None:
                    sys.exit("the broker did not start")
                time.sleep(0.05)
            port = port_file.read_text().split()[0]
            for publisher, subscriber in WATCHED_BY.items():
                url = f"ws://127.0.0.1:{port}/sdk/{publisher}"
                with subprocess.Popen(made[publisher] + [url, *ARGUMENTS.get(publisher, [])], env=environment, stdout=subprocess.PIPE, text=True) as sender:
                    seen = run(made[subscriber] + [url, *ARGUMENTS.get(subscriber, [])], env=environment).splitlines()
                    said, _ = sender.communicate(timeout=60)
                if len(seen) < 30 or sender.returncode != 0 or "sent 0 poses" in said:
                    sys.exit(f"{publisher} watched by {subscriber}: {len(seen)} lines; {said}")
                print(f"{publisher}, watched by {subscriber}: {said.strip()}; {seen[-1]}")
            watch_scalar(made["stress.py"], f"ws://127.0.0.1:{port}/sdk/stress", prefix, environment, folder)
            watch_looks(made["painted.py"], f"ws://127.0.0.1:{port}/sdk/painted", prefix, environment, folder)
        finally:
            broker.terminate()
            broker.wait()


main()
