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
    """The broker, the programs of preset bench beside it (fanout_load, bare_server), and what they need, in one folder."""

    def __init__(self, broker):
        self.broker = pathlib.Path(broker).resolve()
        self.programs = self.broker.parent.parent / "bench"
        for name in ("fanout_load", "bare_server"):
            if not (self.programs / name).exists():
                sys.exit(f"SKIPPED: {self.programs / name} is not built: cmake --preset bench && cmake --build --preset bench")
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-bench-"))
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                        "-keyout", "key.pem", "-out", "cert.pem", "-days", "2", "-subj", "/CN=localhost"],
                       cwd=self.folder, check=True, capture_output=True)
        self.frame, rows = payloads.float_join(SIZE)
        self.asset_body, self.asset = payloads.asset()
        self.announce = payloads.announce(self.asset, rows, "float32")

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


FRAME_FIELDS = {"sequence_at": payloads.SEQUENCE_AT, "time_at": payloads.TIME_AT}
SUBPROTOCOL = "Sec-WebSocket-Protocol: "


def mqtt(kind, body):
    return (bytes([kind, len(body)]) + body).hex()


def role(path, subprotocol=None, hello=(), ready=(), opcode=1, headers=()):
    """How one side speaks to a server, see fanout_load.cpp; hello and ready are hex."""
    return {"path": path, "headers": [*headers, *([SUBPROTOCOL + subprotocol] if subprotocol else [])], "hello": list(hello),
            "ready": list(ready), "opcode": opcode}


MAGIC = b"EIGCLOAD"
MQTT_CONNECT, MQTT_ACCEPTED = mqtt(0x10, b"\x00\x04MQTT\x04\x02\x00\x00\x00\x00"), mqtt(0x20, b"\x00\x00")
NATS_HELLO = b'CONNECT {"verbose":false}\r\n'
PEERS = {
    "mosquitto": {"subscriber": role("/mqtt", "mqtt", [MQTT_CONNECT, mqtt(0x82, b"\x00\x01\x00\x01t\x00")],
                                     [MQTT_ACCEPTED, mqtt(0x90, b"\x00\x01\x00")], opcode=2),
                  "publisher": role("/mqtt", "mqtt", [MQTT_CONNECT], [MQTT_ACCEPTED], opcode=2),
                  "prefix": "30" + bytes([(SIZE + 3) % 128 | 128, (SIZE + 3) // 128]).hex() + "000174"},
    "nats": {"subscriber": role("/", hello=[(NATS_HELLO + b"SUB t 1\r\nPING\r\n").hex()], ready=[b"PONG".hex()], opcode=2),
             "publisher": role("/", hello=[(NATS_HELLO + b"PING\r\n").hex()], ready=[b"PONG".hex()], opcode=2),
             "prefix": f"PUB t {SIZE}\r\n".encode().hex(), "suffix": "0d0a"},
}


class Server:
    """One server, pinned to a core, in a with statement."""

    def __init__(self, tools, kind, environment=None, **settings):
        """kind  broker, bare (settings: mode, threads), mosquitto, nats"""
        self.tools, self.kind, self.settings = tools, kind, settings
        self.environment = {**os.environ, **(environment or {})}

    def __enter__(self):
        self.port = free_port()
        if self.kind == "bare":
            command = [self.tools.programs / "bare_server", str(self.port), self.settings["mode"], str(self.settings.get("threads", 1))]
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
        self.process = subprocess.Popen(["taskset", "-c", SERVER_CPU, *command], cwd=self.tools.folder, env=self.environment,
                                        stderr=subprocess.DEVNULL if self.kind in PEERS else None)
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

    def load(self, headers=(), **scenario):
        """One run of fanout_load; its figures. Fields of the scenario: see fanout_load.cpp."""
        return self.started({**self.spoken(headers, **scenario), **scenario})()

    def started(self, scenario):
        """fanout_load at this server; call what is returned for its figures, when it has ended."""
        handle, file = tempfile.mkstemp(dir=self.tools.folder, suffix=".json")
        with open(handle, "w") as out:
            json.dump({"port": self.port, "pid": self.process.pid, "frame": self.tools.frame.hex(), **FRAME_FIELDS, **scenario}, out)
        process = subprocess.Popen(["taskset", "-c", LOAD_CPU, self.tools.programs / "fanout_load", file], stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)

        def figures():
            output, complaint = process.communicate()
            if not output:
                sys.exit(f"fanout_load failed: {complaint}")
            return json.loads(output)
        return figures

    def viewers(self, subscribers, seconds, warm_s):
        """Viewers of s0, whose sender is another process and comes later; see started()."""
        return self.started({"publish": False, "subscribers": subscribers, "seconds": seconds, "warm_s": warm_s,
                             "subscriber": role("/v1/subscribe/s0?rate=raw", "eigencast.v2", ready=[b'"waiting"'.hex()])})

    def spoken(self, headers, streams=1, several=False, **_):
        """How this server is spoken to. several: each connection watches all streams."""
        if self.kind in PEERS:
            return {**PEERS[self.kind], "frame": (MAGIC + self.tools.frame[len(MAGIC):]).hex(), "magic": MAGIC.hex()}
        if self.kind == "bare":
            return {"subscriber": role("/sub"), "publisher": role("/pub")}
        subscribe = role("/v1/subscribe/s{s}?rate=raw", "eigencast.v2", ready=[b'"waiting"'.hex()], headers=headers)
        if several:
            hello = [json.dumps({"op": "subscribe", "stream": f"s{stream}", "profile": {"rate": "raw"}}) for stream in range(streams)]
            subscribe = role("/v1/subscribe", "eigencast.v2", [text.encode().hex() for text in hello],
                             [f'"stream":"s{stream}"'.encode().hex() for stream in range(streams)])
        return {"subscriber": subscribe, "publisher": role("/v1/publish/s{s}", "eigencast.v2", [self.tools.announce.encode().hex()],
                                                           [b'"announced"'.hex()], headers=headers)}
