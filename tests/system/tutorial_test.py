#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Runs docs/tutorial.md: saves its Python and runs its commands, in order, in a folder of their own, with a broker on a free port and clients
without a window for a few pictures. Usage: tutorial_test.py TUTORIAL BIN_FOLDER"""
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time


def steps_of(text):
    """("python" or "shell", what) in the order of the page."""
    steps, code = [], None
    for line in text.splitlines():
        if line.startswith("```"):
            if code is not None:
                steps.append(("python", "\n".join(code)))
            code = [] if code is None else None
        elif code is not None:
            code.append(line)
        elif line.startswith("    "):
            steps.append(("shell", line.strip()))
    return steps


def as_tested(command, port):
    command = command.replace("localhost:7490", f"127.0.0.1:{port}")
    if command.startswith("eigencast-client"):
        if command == "eigencast-client":
            return None  # the window's own tests press its buttons
        command = re.sub(r"--frames \d+", "--frames 3", re.sub(r"--seconds \d+", "--seconds 1", command))
        command += "" if "--headless" in command or "--film" in command else " --headless --frames 3"
        command += " --size 160x120" + (" --wait 90" if "http" in command else "")
    return command


def main():
    tutorial, programs = pathlib.Path(sys.argv[1]), str(pathlib.Path(sys.argv[2]).resolve())
    running, done = [], 0
    with tempfile.TemporaryDirectory() as folder:
        env = dict(os.environ, PATH=programs + ":" + os.environ["PATH"], XDG_CONFIG_HOME=folder + "/config", XDG_CACHE_HOME=folder + "/cache",
                   XDG_STATE_HOME=folder + "/state")
        port = None

        def start(command):
            running.append(subprocess.Popen(["bash", "-c", command], cwd=folder, env=env, start_new_session=True))

        try:
            for kind, what in steps_of(tutorial.read_text(encoding="utf-8")):
                if kind == "python":  # its first line names the file
                    pathlib.Path(folder, what.split()[1]).write_text(what, encoding="utf-8")
                elif what.startswith("eigencast-broker"):
                    start("exec eigencast-broker --listen 127.0.0.1:0 --admin-listen '' --port-file port")
                    until = time.monotonic() + 60
                    while not pathlib.Path(folder, "port").exists() and time.monotonic() < until:
                        time.sleep(0.05)
                    port = pathlib.Path(folder, "port").read_text(encoding="utf-8").strip()
                else:
                    command = as_tested(what, port)
                    if command is None:
                        continue
                    print("$", command, flush=True)
                    if command.endswith("&"):
                        start(command[:-1])
                    else:
                        subprocess.run(["bash", "-c", command], cwd=folder, env=env, check=True, timeout=120)
                done += 1
            pictures = len(list(pathlib.Path(folder).glob("pictures/*.png")))
            assert pictures == 3, f"pictures: {pictures}"
            assert pathlib.Path(folder, "demo.mp4").stat().st_size > 1000
            assert done >= 12, f"only {done} steps found: has the page another form?"
        finally:
            for process in running:
                try:
                    os.killpg(process.pid, signal.SIGTERM)
                except ProcessLookupError:
                    pass
                process.wait(20)
    print(f"{done} steps of the tutorial, all good")
    return 0


if __name__ == "__main__":
    sys.exit(main())
