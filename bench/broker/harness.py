# SPDX-License-Identifier: MIT
"""Starts the servers that are compared and runs the load generator against them."""
import json
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request

import payloads

SERVER_CPU, LOAD_CPU = "0", "1"
SIZE = 600


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for_port(port, process):
    for _ in range(200):
        if process.poll() is not None:
            sys.exit(f"the server ended with {process.returncode} before it listened")
        try:
            socket.create_connection(("127.0.0.1", port), 0.2).close()
            return
        except OSError:
            time.sleep(0.02)
    sys.exit("the server does not listen")


class Tools:
    """The load generator and the bare server, compiled from EIGENCAST_WSLOAD, and what they need, in a temporary folder."""

    def __init__(self, broker):
        self.broker = pathlib.Path(broker).resolve()
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-bench-"))
        source = os.environ.get("EIGENCAST_WSLOAD")
        if not source:
            sys.exit("set EIGENCAST_WSLOAD to the folder that holds wsload.cpp and raw.cpp")
        for name, flags, libraries in (("wsload", ["-O2"], []), ("raw", ["-O3", "-march=native", "-DNDEBUG"], ["-luring"])):
            subprocess.run(["g++", "-std=c++20", *flags, f"{source}/{name}.cpp", "-o", self.folder / name, *libraries,
                            "-lssl", "-lcrypto"], check=True)
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                        "-keyout", "key.pem", "-out", "cert.pem", "-days", "2", "-subj", "/CN=localhost"],
                       cwd=self.folder, check=True, capture_output=True)
        frame, rows = payloads.float_join(SIZE)
        (self.folder / "frame.bin").write_bytes(frame)
        body, name = payloads.asset()
        self.asset_body, self.asset = body, name
        (self.folder / "announce.json").write_text(payloads.announce(name, rows, "float32"))


class Server:
    """One server, pinned to a core, in a with statement."""

    def __init__(self, tools, kind, wrap=(), **settings):
        self.tools, self.kind, self.wrap, self.settings = tools, kind, list(wrap), settings

    def __enter__(self):
        self.port = free_port()
        if self.kind.startswith("raw"):
            command = [self.tools.folder / "raw", str(self.port), self.kind.split()[1]]
        else:
            self.data = tempfile.mkdtemp(dir=self.tools.folder)
            flags = [f"--{name.replace('_', '-')}={value}" for name, value in self.settings.items()]
            command = [self.tools.broker, f"--listen=127.0.0.1:{self.port}", "--admin-listen=127.0.0.1:0",
                       f"--data-dir={self.data}", "--log-level=error", *flags]
        self.process = subprocess.Popen(["taskset", "-c", SERVER_CPU, *self.wrap, *command], cwd=self.tools.folder)
        wait_for_port(self.port, self.process)
        if not self.kind.startswith("raw"):
            self.put_asset()
        return self

    def put_asset(self):
        import ssl
        tls = "tls_certificate" in self.settings or "tls-certificate" in self.settings
        context = ssl._create_unverified_context() if tls else None
        request = urllib.request.Request(f"http{'s' if tls else ''}://127.0.0.1:{self.port}/v1/assets/{self.tools.asset}",
                                         data=self.tools.asset_body, method="PUT")
        urllib.request.urlopen(request, context=context).close()

    def __exit__(self, *_):
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def load(self, *flags, streams=1, several=False):
        """One run of wsload; its figures. `several`: each connection watches all streams."""
        out = self.tools.folder / "out.jsonl"
        out.unlink(missing_ok=True)
        command = ["taskset", "-c", LOAD_CPU, self.tools.folder / "wsload", "--port", str(self.port), "--pid",
                   str(self.process.pid), "--no-spin", "--quiet", "--json", out, "--streams", str(streams), "--us", "--template",
                   self.tools.folder / "frame.bin", "--magic-off", "-1", "--ts-off", "20", "--seq-off", "12", "--find-off", "20",
                   "--find-seq-off", "12", "--size", str(SIZE)]
        if several:
            command += ["--mesh"]
        if self.kind.startswith("raw"):
            command += ["--path", "/sub", "--pub-path", "/pub"]
        else:
            command += ["--subproto", "eigencast.v1", "--pub-subproto", "eigencast.v1", "--pub-path", "/v1/publish/s{s}",
                        "--pub-hello", f"text@{self.tools.folder}/announce.json", "--pub-ready", '"announced"']
            if several:
                command += ["--path", "/v1/subscribe"]
                for stream in range(streams):
                    hello = json.dumps({"op": "subscribe", "stream": f"s{stream}", "profile": {"rate": "raw"}})
                    command += ["--hello", f"text:{hello}", "--ready", f'"stream":"s{stream}"']
            else:
                command += ["--path", "/v1/subscribe/s{s}?rate=raw", "--ready", '"waiting"']
        done = subprocess.run([*command, *map(str, flags)], capture_output=True, text=True)
        if not out.exists():
            sys.exit(f"wsload failed: {done.stderr}{done.stdout}")
        return json.loads(out.read_text().splitlines()[-1])
