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
    """The load generator and the bare server, compiled from EIGENCAST_WSLOAD, and what they need, in one folder."""

    def __init__(self, broker, folder=None):
        """folder  to keep for the next time; default: a new temporary one"""
        self.broker = pathlib.Path(broker).resolve()
        self.folder = pathlib.Path(folder or tempfile.mkdtemp(prefix="eigencast-bench-")).resolve()
        self.folder.mkdir(exist_ok=True)
        source = os.environ.get("EIGENCAST_WSLOAD")
        if not source:
            sys.exit("SKIPPED: set EIGENCAST_WSLOAD to the folder that holds wsload.cpp and raw.cpp")
        for name, flags, libraries in (("wsload", ["-O2"], []), ("raw", ["-O3", "-march=native", "-DNDEBUG"], ["-luring"])):
            if (self.folder / name).exists():
                continue
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

    def token(self, algorithm):
        return Token(self, algorithm)


class Token:
    """A signed token for everything, and what a broker must have in its environment to take it."""

    def __init__(self, tools, algorithm):
        self.environment = {"EIGENCAST_ACCESS__JWT_SECRET": "a secret of the benches, long enough"}
        key = []
        if algorithm != "HS256":
            file = tools.folder / "es256.pem"
            subprocess.run(["openssl", "ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", file], check=True)
            key = ["--key", f"bench ES256 {file}"]
            self.environment = {"EIGENCAST_ACCESS__JWT_KEYS": f"bench ES256 {file}"}
        made = subprocess.run([tools.broker, "token", "create", "--publish", "**", "--subscribe", "**", *key], check=True,
                              capture_output=True, text=True, env={**os.environ, **self.environment})
        self.text = made.stdout.strip()


def mqtt(kind, body):
    return "hex:" + (bytes([kind, len(body)]) + body).hex()


# How the peers are spoken to: arguments of wsload. Each message of theirs is of SIZE bytes, too.
# Where a frame of the broker's holds its capture time and its sequence (docs/protocol.md, "Envelope").
FRAMES = ["--us", "--magic-off", "-1", "--ts-off", "19", "--seq-off", "11", "--find-off", "19", "--find-seq-off", "11"]
MQTT_CONNECT = mqtt(0x10, b"\x00\x04MQTT\x04\x02\x00\x00\x00\x00")
SPOKEN = {
    "mosquitto": ["--subproto", "mqtt", "--pub-subproto", "mqtt", "--path", "/mqtt", "--pub-path", "/mqtt",
                  "--hello", MQTT_CONNECT, "--ready", "hex:20020000", "--hello", mqtt(0x82, b"\x00\x01\x00\x01t\x00"), "--ready", "hex:9003000100",
                  "--pub-hello", MQTT_CONNECT, "--pub-ready", "hex:20020000",
                  "--prefix", "hex:30" + bytes([(SIZE + 3) % 128 | 128, (SIZE + 3) // 128]).hex() + "000174"],
    "nats": ["--path", "/", "--pub-path", "/", "--hello", "hex:" + b'CONNECT {"verbose":false}\r\nSUB t 1\r\nPING\r\n'.hex(),
             "--ready", "hex:" + b"PONG".hex(), "--pub-hello", "hex:" + b'CONNECT {"verbose":false}\r\nPING\r\n'.hex(),
             "--pub-ready", "hex:" + b"PONG".hex(), "--prefix", "hex:" + f"PUB t {SIZE}\r\n".encode().hex(), "--suffix", "hex:0d0a"],
}


class Server:
    """One server, pinned to a core, in a with statement."""

    def __init__(self, tools, kind, wrap=(), environment=None, **settings):
        self.tools, self.kind, self.wrap, self.settings = tools, kind, list(wrap), settings
        self.environment = {**os.environ, **(environment or {})}

    def __enter__(self):
        self.port = free_port()
        if self.kind.startswith("raw"):
            command = [self.tools.folder / "raw", str(self.port), self.kind.split()[1]]
        elif self.kind == "mosquitto":
            file = self.tools.folder / "mosquitto.conf"
            file.write_text(f"listener {free_port()} 127.0.0.1\nlistener {self.port} 127.0.0.1\nprotocol websockets\nallow_anonymous true\nset_tcp_nodelay true\nlog_type error\n")
            command = ["mosquitto", "-c", file]
        elif self.kind == "nats":
            file = self.tools.folder / "nats.conf"
            file.write_text(f"port: {free_port()}\nhost: 127.0.0.1\nwebsocket {{ host: 127.0.0.1, port: {self.port}, no_tls: true }}\n")
            command = ["nats-server", "-c", file]
        else:
            self.data = tempfile.mkdtemp(dir=self.tools.folder)
            flags = [f"--{name.replace('_', '-')}={value}" for name, value in self.settings.items()]
            command = [self.tools.broker, f"--listen=127.0.0.1:{self.port}", "--admin-listen=127.0.0.1:0",
                       f"--data-dir={self.data}", "--log-level=error", *flags]
        self.process = subprocess.Popen(["taskset", "-c", SERVER_CPU, *self.wrap, *command], cwd=self.tools.folder, env=self.environment,
                                        stderr=subprocess.DEVNULL if self.kind in SPOKEN else None)
        wait_for_port(self.port, self.process)
        if self.kind == "broker" and not any("JWT" in name for name in self.environment):
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

    def cpu_seconds(self):
        tasks = f"/proc/{self.process.pid}/task"
        return sum(int(pathlib.Path(tasks, task, "schedstat").read_text().split()[0]) for task in os.listdir(tasks)) / 1e9

    def load(self, *flags, streams=1, several=False):
        """One run of wsload; its figures. `several`: each connection watches all streams."""
        out = self.tools.folder / "out.jsonl"
        command = self.wsload(out, "--streams", streams, *(SPOKEN[self.kind] if self.kind in SPOKEN else self.spoken(streams, several)))
        done = subprocess.run([*command, *map(str, flags)], capture_output=True, text=True)
        if not out.exists():
            sys.exit(f"wsload failed: {done.stderr}{done.stdout}")
        return json.loads(out.read_text().splitlines()[-1])

    def wsload(self, out, *words):
        """The load generator at this server; its figures will be the last line of `out`."""
        out.unlink(missing_ok=True)
        return ["taskset", "-c", LOAD_CPU, self.tools.folder / "wsload", "--port", str(self.port), "--pid", str(self.process.pid), "--no-spin",
                "--quiet", "--json", out, "--size", str(SIZE), *map(str, words)]

    def viewers(self, subs, seconds, warm):
        """Viewers of s0, whose sender is another process and comes later; call what is returned for their figures, when they have ended."""
        out = pathlib.Path(tempfile.mkdtemp(dir=self.tools.folder)) / "viewers.jsonl"
        command = self.wsload(out, *FRAMES, "--no-pub", "--subs", subs, "--secs", seconds, "--warm", warm, "--rate", 1, "--subproto",
                              "eigencast.v1", "--path", "/v1/subscribe/s0?rate=raw", "--ready", '"waiting"')
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

        def figures():
            told, _ = process.communicate()
            if not out.exists():
                sys.exit(f"wsload failed: {told}")
            return json.loads(out.read_text().splitlines()[-1])
        return figures

    def spoken(self, streams, several):
        """Arguments of wsload for the bare server and the broker: frames of the broker's own format."""
        command = [*FRAMES, "--template", self.tools.folder / "frame.bin", *(["--mesh"] if several else [])]
        if self.kind.startswith("raw"):
            return command + ["--path", "/sub", "--pub-path", "/pub"]
        command += ["--subproto", "eigencast.v1", "--pub-subproto", "eigencast.v1", "--pub-path", "/v1/publish/s{s}",
                    "--pub-hello", f"text@{self.tools.folder}/announce.json", "--pub-ready", '"announced"']
        if not several:
            return command + ["--path", "/v1/subscribe/s{s}?rate=raw", "--ready", '"waiting"']
        command += ["--path", "/v1/subscribe"]
        for stream in range(streams):
            hello = json.dumps({"op": "subscribe", "stream": f"s{stream}", "profile": {"rate": "raw"}})
            command += ["--hello", f"text:{hello}", "--ready", f'"stream":"s{stream}"']
        return command
