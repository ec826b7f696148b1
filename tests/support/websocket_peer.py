# SPDX-License-Identifier: MIT
"""A WebSocket client of raw bytes, and a broker to try it on: for tests that must do what no library lets them do."""
import base64
import json
import os
import pathlib
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time

MASK = b"\x37\xfa\x21\x3d"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10


def frame(opcode, payload=b"", fin=True, masked=True, reserved=0):
    head = bytes([(0x80 if fin else 0) | reserved << 4 | opcode])
    bit = 0x80 if masked else 0
    if len(payload) < 126:
        head += bytes([bit | len(payload)])
    elif len(payload) < 65536:
        head += bytes([bit | 126]) + struct.pack(">H", len(payload))
    else:
        head += bytes([bit | 127]) + struct.pack(">Q", len(payload))
    if not masked:
        return head + payload
    repeated = MASK * (len(payload) // 4 + 1)
    body = (int.from_bytes(payload, "big") ^ int.from_bytes(repeated[: len(payload)], "big")).to_bytes(len(payload), "big")
    return head + MASK + body


def control(**message):
    return frame(TEXT, json.dumps(message).encode())


def next_control(peer, *ops):
    while True:
        opcode, payload = peer.receive()
        if opcode == TEXT and (message := json.loads(payload))["op"] in ops:
            return message


def close_frame(code, reason=b""):
    return frame(CLOSE, struct.pack(">H", code) + reason)


class Peer:
    """One raw connection."""

    def __init__(self, port, path="/echo", subprotocol=None, headers=(), upgrade=True, receive_buffer=0, tls=None):
        self.sock = socket.socket()
        self.sock.settimeout(60)
        if receive_buffer:
            self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.sock.connect(("127.0.0.1", port))
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if tls:  # An ssl.SSLContext.
            self.sock = tls.wrap_socket(self.sock)
        self.buffer = b""
        if not upgrade:
            return
        self.key = base64.b64encode(os.urandom(16)).decode()
        lines = [f"GET {path} HTTP/1.1", "Host: localhost", "Upgrade: websocket", "Connection: keep-alive, Upgrade",
                 f"Sec-WebSocket-Key: {self.key}", "Sec-WebSocket-Version: 13", *headers]
        if subprotocol:
            lines.append(f"Sec-WebSocket-Protocol: {subprotocol}")
        self.sock.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        while b"\r\n\r\n" not in self.buffer:
            self.more()
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        self.head = head.decode()
        self.status = int(self.head.split()[1])

    def more(self):
        piece = self.sock.recv(1 << 18)
        if not piece:
            raise EOFError
        self.buffer += piece

    def take(self, count):
        while len(self.buffer) < count:
            self.more()
        taken, self.buffer = self.buffer[:count], self.buffer[count:]
        return taken

    def send(self, *frames, step=None):
        data = b"".join(frames)
        for at in range(0, len(data), step or len(data) or 1):
            self.sock.sendall(data[at: at + (step or len(data))])

    def receive(self):
        """The next frame of the server: opcode and payload. A server's frames are whole and not masked."""
        first, second = self.take(2)
        assert first & 0xF0 == 0x80, f"first byte {first:02x}"
        assert second & 0x80 == 0, "masked"
        size = second & 0x7F
        if size == 126:
            size, = struct.unpack(">H", self.take(2))
        elif size == 127:
            size, = struct.unpack(">Q", self.take(8))
        return first & 15, self.take(size)

    def close_code(self):
        """Reads to the close frame, then to the end of the connection, which the server must bring about."""
        while True:
            opcode, payload = self.receive()
            if opcode == CLOSE:
                break
        self.sock.settimeout(60)
        while self.sock.recv(65536):
            pass
        return struct.unpack(">H", payload[:2])[0] if payload else None


def stay(peer):
    """Answers pings, and takes no notice of all else, until the connection ends: for a thread of its own."""
    try:
        while True:
            opcode, payload = peer.receive()
            if opcode == PING:
                peer.send(frame(PONG, payload))
    except (EOFError, OSError):
        pass


class Broker:
    """A broker on a free port of loopback, with a folder of its own, in a with statement; must end in good order."""

    def __init__(self, program, *flags, wrap=(), stderr=None):
        self.folder = tempfile.mkdtemp(prefix="eigencast-peer-")
        port_file = pathlib.Path(self.folder) / "port"
        defaults = ["--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--port-file={port_file}", f"--data-dir={self.folder}", "--log-level=error"]
        given = {flag.split("=")[0] for flag in flags}
        self.process = subprocess.Popen([*wrap, program, *(flag for flag in defaults if flag.split("=")[0] not in given), *flags], stderr=stderr)
        self.port = port_of(port_file)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for pid in self.children() or [self.process.pid]:  # What wraps it ends with it.
            os.kill(pid, signal.SIGTERM)
        ended = self.process.wait(60)
        shutil.rmtree(self.folder)
        assert ended == 0, f"the broker ended with {ended}"

    def children(self):
        return [int(pid) for pid in pathlib.Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()]


def port_of(file):
    """What a process that starts writes there once it listens."""
    return ports_of(file)[0]


def ports_of(file):
    """The same of a broker with an admin port: both."""
    for _ in range(1200):
        if file.exists() and file.read_text().strip():
            return [int(line) for line in file.read_text().split()]
        time.sleep(0.05)
    raise TimeoutError(f"{file} does not appear")


def free_ports(count):
    """Of loopback, for servers that cannot choose their own."""
    probes = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [probe.getsockname()[1] for probe in probes]
    for probe in probes:
        probe.close()
    return ports
