#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Attacks a broker of its own as strangers would, and says what an innocent stream of 60 keys a second notices: milliseconds of
the broker's processor time between a key's sending and its coming (whatever else the machine does), and keys that did not come.

    attacks.py --broker build/release/bin/eigencast-broker [--seconds 4] [--bound-ms 20] [NAME...]
    attacks.py --broker BROKER --check       a moment of each; says what was refused and what came, not how soon

Strangers come by addresses of their own through a proxy that the broker trusts. Exits with 1 if one does not hold.
"""
import argparse
import contextlib
import functools
import hashlib
import http.client
import json
import multiprocessing
import os
import pathlib
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import payloads
from websocket_peer import BINARY, CLOSE, PING, PONG, TEXT, Broker, Peer, frame, ports_of

SUBPROTOCOL = "eigencast.v2"
SECRET = "a secret of the attacks, of more than 32 bytes"
ASSET, ASSET_ID = payloads.asset()
RATE = 60
KEY_HEAD = b'{"alg":"ES256","kid":"main"}'
KEYS = tempfile.TemporaryDirectory(prefix="eigencast-attacks-")
FLAGS = {"proxy-trusted": "127.0.0.0/8", "access-anonymous": "anywhere", "access-jwt-secret": SECRET, "threads": 1, "history-streams": "attack/seek"}
SMALL = {"rows": 64, "channels": 8, "band_ends": [64], "codec": "quantised"}
TINY = {**SMALL, "rows": 1, "channels": 1, "band_ends": [1]}
LARGE = {**SMALL, "rows": 4096, "band_ends": [4096]}  # 32,768 coefficients, the most of a stream.
EIGHT = {**LARGE, "band_ends": [1, 2, 3, 4, 5, 6, 7, 4096]}  # All but 56 of them in the last of eight bands.
PROFILES = [f"rate=raw&bands={bands}" for bands in range(1, 9)] + [f"rate=estimated&k={k}&bands={bands}" for k in range(2, 12) for bands in range(1, 9)]
RECALLED = 4 << 3  # In a frame's first byte.


def zeros(layout):
    """A join of a pose of zeros, and a key that changes nothing."""
    return bytes([2, 160, 160, 1, 2, 0x9F, 0x9F]), bytes([3, 1, 0xBF])


def ordinary_join(layout):
    """Of numbers up to 64, each in a byte, and a pose of others before it."""
    ends, bands = [0, *layout["band_ends"]], b""
    for begin, end in zip(ends, ends[1:]):
        run = b"".join(bytes([first]) + random.randbytes((end - begin) * layout["channels"]).translate(bytes(i & 0x7F for i in range(256))) for first in (0x87, 0xA7))
        bands += payloads.varint(len(run)) + run
    return bytes([2, 160, 160, 255]) + bands


def noise(phase_step):
    """Three bytes and a phase: a key from the memory that changes most coefficients by a little."""
    return bytes([7]) + payloads.varint(2 * phase_step) + bytes([1, 7])


def segment(layout, poses, end=b""):
    """Of poses of zeros but for the last one, and its name."""
    join, key = zeros(layout)
    body = b"ECPM\1" + bytes.fromhex(ASSET_ID) + bytes([layout["channels"], 1]) + payloads.varint(layout["rows"])
    coded = [join] + [key] * (poses - 1) + ([end] if end else [])
    body += payloads.varint(len(coded)) + b"".join(payloads.varint(len(pose)) + pose for pose in coded)
    return body, hashlib.sha256(body).hexdigest()


def ask(port, method, target, body=None, address="192.0.2.1", **headers):
    """Status and body."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        connection.request(method, target, body, {**({"X-Forwarded-For": address} if address else {}), **headers})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def put(port, body, address="192.0.2.1"):
    return ask(port, "PUT", "/v1/assets/" + hashlib.sha256(body).hexdigest(), body, address)[0]


def connect(port, path, address, *headers, **how):
    peer = Peer(port, path, SUBPROTOCOL, [f"X-Forwarded-For: {address}", *headers], **how)
    if peer.status != 101:
        raise ConnectionError(f"{path}: {peer.status}")
    return peer


def order(peer, op, **fields):
    peer.send(frame(TEXT, json.dumps({"op": op, **fields}).encode()))


def hear(peer, *ops):
    while True:
        opcode, payload = peer.receive()
        if opcode == CLOSE:
            raise EOFError(payload[2:].decode())
        message = json.loads(payload) if opcode == TEXT else {"op": ""}
        if message["op"] in ops:
            return message


class Sender:
    """One that attacks."""

    def __init__(self, port, stream, layout, address):
        self.peer, self.layout = connect(port, f"/v1/publish/{stream}", address), layout
        self.stream, self.chain, self.sequence, self.generation = stream, payloads.Chain(), 0, 0
        self.announce()

    def announce(self):
        order(self.peer, "announce", asset=ASSET_ID, key_rate_hz=50, format=self.layout)
        self.tag = hear(self.peer, "announced")["tag"]

    def frame(self, kind, payload, phase=None, recalled=False, bands=1):
        self.sequence += 1
        head = self.chain.write(kind, bands, self.sequence, self.sequence * 10_000, self.tag)
        if phase is not None:
            payload = payload[:4] + payloads.varint(phase) + payload[4:]
        return frame(BINARY, bytes([head[0] | (RECALLED if recalled or phase is not None else 0)]) + head[1:] + payload)

    def join(self, phase=None):
        self.peer.send(self.frame(payloads.JOIN, zeros(self.layout)[0], phase))

    def remember(self, *segments):
        self.generation += 1
        order(self.peer, "remember", stream=self.stream, generation=self.generation, kept=0, segments=list(segments))
        return hear(self.peer, "remembered")


class Innocent:
    """A sender and a viewer, who measure."""

    def __init__(self, port, pid):
        put(port, ASSET)
        self.clock = pathlib.Path(f"/proc/{pid}/task/{pid}/schedstat")
        self.sender, self.viewer = connect(port, "/v1/publish/innocent", "198.51.100.1"), connect(port, "/v1/subscribe/innocent?rate=raw", "198.51.100.2")
        self.sender.send(frame(TEXT, payloads.announce(ASSET_ID, 48, "float32", rate=RATE).encode()))
        self.tag = hear(self.sender, "announced")["tag"]
        self.sent, self.delays, self.stopped = {}, [], threading.Event()
        self.threads = [threading.Thread(target=run, daemon=True) for run in (self.send, self.receive)]
        for thread in self.threads:
            thread.start()

    def now_ms(self):
        return int(self.clock.read_text().split()[0]) / 1e6

    def send(self):
        chain, start, pose = payloads.Chain(), time.monotonic(), [[0.5] * 144]
        for sequence in range(1 << 30):
            if self.stopped.is_set():
                return
            kind = payloads.KEY if sequence else payloads.JOIN
            message = frame(BINARY, payloads.float_frame(chain, kind, sequence, sequence * 1_000_000 // RATE, pose, self.tag))
            self.sent[sequence] = self.now_ms()
            self.sender.send(message)
            time.sleep(max(0, start + (sequence + 1) / RATE - time.monotonic()))

    def receive(self):
        chain = payloads.Chain()
        with contextlib.suppress(OSError, EOFError):
            while not self.stopped.is_set():
                opcode, payload = self.viewer.receive()
                if opcode == PING:
                    self.viewer.send(frame(PONG, payload))
                head = chain.read(payload) if opcode == BINARY else None
                if head and head.sequence in self.sent:
                    self.delays.append((head.sequence, self.now_ms() - self.sent[head.sequence]))
                    order(self.viewer, "ack", items=[{"stream_id": head.stream_id, "sequence": head.sequence, "step": 0}], time_us=1)

    def measure(self, seconds):
        """Median and 99th percentile in milliseconds, the percentage of keys that did not come, that of a core which the loop got."""
        first, begun, before_ms = len(self.sent), time.monotonic(), self.now_ms()
        time.sleep(seconds)
        last, core = len(self.sent), (self.now_ms() - before_ms) / 10 / (time.monotonic() - begun)
        end = time.monotonic() + 30
        while time.monotonic() < end and not (self.delays and self.delays[-1][0] >= last - 1):
            time.sleep(0.01)
        delays = sorted(delay for sequence, delay in list(self.delays) if first <= sequence < last)
        if not delays:
            return float("inf"), float("inf"), 100.0, core
        return delays[len(delays) // 2], delays[len(delays) * 99 // 100], 100 - 100 * len(delays) / (last - first), core

    def stop(self):
        self.stopped.set()
        for thread in self.threads:
            thread.join(30)
        self.sender.sock.close()
        self.viewer.sock.close()


def read_all(peers):
    """Reads and drops what comes to viewers."""
    def run():
        import selectors
        selector, ignored = selectors.DefaultSelector(), bytearray(1 << 20)
        for peer in peers:
            selector.register(peer.sock, selectors.EVENT_READ)
        while selector.get_map():
            for key, _ in selector.select(1):
                with contextlib.suppress(OSError):
                    if key.fileobj.recv_into(ignored, 0, socket.MSG_TRUNC):
                        continue
                selector.unregister(key.fileobj)
    threading.Thread(target=run, daemon=True).start()
    return peers


def crowd(port, stream, count, addresses=8, profiles=("rate=raw",), **how):
    return read_all([connect(port, f"/v1/subscribe/{stream}?{profiles[i % len(profiles)]}", f"203.0.113.{i % addresses}", **how) for i in range(count)])


# Attacks on time: run until `go` is cleared, and return what they did in words.


def remember_flood(port, ready, go, stranger="203.0.113.200", viewers=300):
    """The memory of a stream with many viewers comes and goes."""
    body, name = segment(SMALL, 8)
    put(port, body)
    sender, count = Sender(port, "attack/remember", SMALL, stranger), 0
    watching = crowd(port, "attack/remember", viewers)
    sender.join()
    ready()
    while go():
        sender.remember(name)
        sender.join(phase=0)
        sender.remember()
        sender.join()
        count += 1
    return f"{count} times, {len(watching)} viewers"


def announce_flood(port, ready, go, viewers=300):
    """A stream with many viewers begins anew."""
    sender, count = Sender(port, "attack/announce", SMALL, "203.0.113.200"), 0
    watching = crowd(port, "attack/announce", viewers)
    ready()
    while go():
        sender.announce()
        sender.join()
        count += 1
    return f"{count} times, {len(watching)} viewers"


def anew_in_profiles(port, ready, go, viewers=1900):
    """A stream that says much of itself begins anew for viewers of more profiles than its budget. (B3 of the fifteenth audit)"""
    scalars = [{"name": f"{i:064}", "unit": "u" * 16, "low": -1.2345678901234567e-5, "high": 1.2345678901234567e29, "scale": 1.2345678901234567e-5} for i in range(13)]
    layout = {**EIGHT, "rows": 64, "channels": 16, "band_ends": [1, 2, 3, 4, 5, 6, 7, 64], "scalars": scalars}
    sender, count = Sender(port, "attack/anew", layout, "203.0.113.0"), 0
    watching = crowd(port, "attack/anew", viewers, 1, PROFILES, receive_buffer=1 << 20)
    ready()
    while go():
        sender.announce()
        count += 1
    return f"{count} times, {len(watching)} viewers of {len(PROFILES)} profiles"


def joins_in_profiles(port, ready, go):
    """The memory of a large stream comes and goes for viewers of ever other profiles: a join for each. (B1 of the fifteenth audit)"""
    poses = [bytes([2, 160, 160, 255]) + bytes([2, 0x9F, 0x9F]) * 8, bytes([3]) + bytes([1, 0xBF]) * 8]
    body = b"ECPM\1" + bytes.fromhex(ASSET_ID) + bytes([EIGHT["channels"], 8]) + b"".join(map(payloads.varint, EIGHT["band_ends"]))
    body += payloads.varint(2) + b"".join(payloads.varint(len(pose)) + pose for pose in poses)
    put(port, body)
    sender, join, count = Sender(port, "attack/joins", EIGHT, "203.0.113.0"), ordinary_join(EIGHT), 0
    sender.peer.send(sender.frame(payloads.JOIN, join, bands=255))
    watching = crowd(port, "attack/joins", len(PROFILES), 1, PROFILES)
    ready()
    while go():
        sender.remember(hashlib.sha256(body).hexdigest())
        sender.peer.send(sender.frame(payloads.JOIN, join, phase=0, bands=255))
        sender.remember()
        count += 1
    return f"{count} times {len(watching)} profiles, of joins of {len(join)} bytes"


def large_keys(port, ready, go, viewers=1500, hz=5):
    """Keys of the most bytes for a crowd of one address that reads them all. (B2 of the fifteenth audit)"""
    sender, count = Sender(port, "attack/large", {**LARGE, "codec": "float64"}, "203.0.113.0"), 0
    pose = bytes(8 * 32768)
    values = payloads.varint(len(pose)) + pose
    sender.peer.send(sender.frame(payloads.JOIN, bytes(4) + values))
    watching = crowd(port, "attack/large", viewers, 1, receive_buffer=2 << 20)
    ready()
    while go():
        sender.peer.send(sender.frame(payloads.KEY, bytes(2) + values))
        count += 1
        time.sleep(1 / hz)
    return f"{count} keys of {len(pose)} bytes, {len(watching)} viewers"


def trace_flood(port, ready, go, viewers=300):
    """Traces of one sender, which all viewers asked for."""
    sender, count = Sender(port, "attack/trace", SMALL, "203.0.113.200"), 0
    watching = crowd(port, "attack/trace", viewers)
    for viewer in watching:
        order(viewer, "trace_request", stream="attack/trace", every=1)
    text = frame(TEXT, b'{"op":"trace","stream_id":1,"sequence":1,"stages":[{"stage":"sent","time_us":1}]}') * 20
    ready()
    sender.peer.sock.settimeout(0.2)
    while go():
        with contextlib.suppress(TimeoutError):
            count += sender.peer.sock.send(text) * 20 // len(text)
    return f"{count} traces, {len(watching)} viewers"


def many_senders(port, ready, go, addresses=16):
    """Keys of 9 bytes and 32,768 coefficients from many addresses."""
    senders = [Sender(port, f"attack/many/{i}", LARGE, f"203.0.113.{i}") for i in range(addresses)]
    for sender in senders:
        sender.join()
        sender.peer.sock.settimeout(0)
    floods = [b"".join(sender.frame(payloads.KEY, zeros(LARGE)[1]) for _ in range(20_000)) for sender in senders]
    sent = [0] * addresses
    ready()
    while go():
        for i, sender in enumerate(senders):
            with contextlib.suppress(BlockingIOError):
                sent[i] += sender.peer.sock.send(floods[i][sent[i]:sent[i] + 4096])
        time.sleep(0.001)
    return f"{sum(sent) // (len(floods[0]) // 20_000)} keys, {addresses} addresses"


def recalled_keys(port, ready, go):
    """Keys of a few bytes that name poses, for viewers without the memory."""
    body, name = segment(LARGE, 60)
    put(port, body)
    sender, count = Sender(port, "attack/recalled", LARGE, "203.0.113.200"), 0
    watching = crowd(port, "attack/recalled", 3)
    sender.join()
    assert "code" not in (answer := sender.remember(name)), answer
    sender.join(phase=0)
    ready()
    sender.peer.sock.settimeout(0.2)
    while go():
        with contextlib.suppress(TimeoutError):
            sender.peer.send(sender.frame(payloads.KEY, noise(0), recalled=True))
            count += 1
    return f"{count} keys, {len(watching)} viewers"


def memory_reads(port, ready, go):
    """Memories whose last pose is broken, of many streams, as fast as they are refused."""
    body, name = segment(LARGE, 60, end=bytes([3, 1, 0]))
    put(port, body)
    senders = [Sender(port, f"attack/reads/{i}", LARGE, f"203.0.113.{100 + i % 4}") for i in range(8)]
    count = [0] * len(senders)

    def run(i):
        with contextlib.suppress(OSError, EOFError):
            while go():
                assert "code" in senders[i].remember(name)
                count[i] += 1
    ready()
    threads = [threading.Thread(target=run, args=[i]) for i in range(len(senders))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return f"{sum(count)} refused"


def seek_flood(port, ready, go, viewers=16):
    """Viewers of the past of a large stream, at eight addresses, seek without end, play it fast, and go on."""
    sender, chance = Sender(port, "attack/seek", LARGE, "203.0.113.200"), random.Random(1)
    sender.join()
    for _ in range(400):
        sender.peer.send(sender.frame(payloads.KEY, zeros(LARGE)[1]))
        time.sleep(0.005)
    time.sleep(1.5)
    peers = read_all([connect(port, "/v1/subscribe/attack/seek", f"203.0.113.{i % 8}") for i in range(viewers)])
    now_us, seeks, sent = int(time.time() * 1e6), 5000, [0] * viewers
    text = b"".join(frame(TEXT, json.dumps({"op": "seek", "stream": "attack/seek", "at_us": now_us - chance.randrange(5_000_000),
                                            "speed": chance.choice([0, 0.1, 0.9, 10])}).encode()) for _ in range(seeks))
    for peer in peers:
        peer.sock.setblocking(False)
    ready()
    while go():
        for i, peer in enumerate(peers):
            with contextlib.suppress(BlockingIOError):
                sent[i] += peer.sock.send(text[sent[i]:sent[i] + 4096])
        time.sleep(0.001)
    return f"{sum(sent) * seeks // len(text)} seeks, {viewers} viewers"


def list_flood(port, ready, go):
    """Eight connections of eight addresses ask for the list of 64 streams, which take no answer in between."""
    senders = [Sender(port, f"attack/list/{'x' * 100}{i}", SMALL, "203.0.113.200") for i in range(64)]
    asks = [b"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: 203.0.113.%d\r\n\r\n" % i * 20 for i in range(8)]
    peers = read_all([Peer(port, upgrade=False) for _ in asks])
    sent, turn = 0, 0
    for peer in peers:
        peer.sock.setblocking(False)
    ready()
    while go():
        for peer, text in zip(peers, asks):
            with contextlib.suppress(BlockingIOError, OSError):
                sent += peer.sock.send(text)
        time.sleep(0.001)
    return f"{sent // len(asks[0]) * 20} asked, {len(senders)} streams"


def first_reads(port, ready, go, count=800):
    """Many connections of many addresses speak first at one moment. (D9)"""
    head = "GET /v1/subscribe/attack HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: 203.0.113.{}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n" \
           "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: " + SUBPROTOCOL + "\r\n\r\n"
    rounds = 0
    ready()
    while go():
        with contextlib.ExitStack() as stack:
            sockets = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(count)]
            for i, one in enumerate(sockets):
                one.sendall(head.format(i % 250).encode())
            for one in sockets:
                one.settimeout(30)
                with contextlib.suppress(OSError):
                    one.recv(4096)
        rounds += 1
    return f"{rounds} times {count}"


def change_flood(port, ready, go, viewers=300):
    """A stream with many viewers, all of which say that they are ready, is to change over again and again."""
    sender, count, other = Sender(port, "attack/change", SMALL, "203.0.113.200"), 0, b"another surface"
    put(port, other)
    watching, asset = crowd(port, "attack/change", viewers), hashlib.sha256(other).hexdigest()
    sender.join()
    ready()
    while go():
        order(sender.peer, "announce", asset=asset, key_rate_hz=50, format=SMALL, **{"continues": True})
        for viewer in watching[count % 10::10]:
            order(viewer, "prepared", stream="attack/change", asset=asset)
        count += 1
    return f"{count} times, {len(watching)} viewers"


def full_rooms(port, ready, go, people=240):
    """People of 16 addresses, each in four rooms, say what takes long to write, and many words that they take back at once."""
    peers, said = [], 0
    dear = json.dumps([[]] * 600, separators=(",", ":"))
    many = [{f"k{i}": value for i in range(64)} for value in (1, None)]
    for i in range(people):
        peer = connect(port, "/v1/subscribe", f"203.0.113.{i % 16}")
        for room in range(4):
            order(peer, "enter", room=f"attack/{i % 2}/{room}", name=f"somebody {i}")
        peers.append(peer)
    read_all(peers)
    ready()
    while go():
        for i, peer in enumerate(peers):
            room = f"attack/{i % 2}/{said % 4}"
            with contextlib.suppress(OSError):
                if i % 4:
                    for values in many:
                        order(peer, "say", room=room, values=values)
                else:
                    peer.send(frame(TEXT, f'{{"op":"say","room":"{room}","values":{{"x{said % 3}":{dear},"y":{said}}}}}'.encode()))
            said += 1
    return f"{said} words, {people} people"


def moments(port, ready, go, viewers=100, streams=60):
    """A crowd wants one moment of many streams, and each says ever new lags."""
    for i in range(streams):
        Sender(port, f"attack/moment/{i}", SMALL, f"203.0.113.{i % 8}").join()
    peers, said = read_all([connect(port, "/v1/subscribe", f"203.0.113.{i % 8}") for i in range(viewers)]), 0
    for peer in peers:
        for i in range(streams):
            order(peer, "subscribe", stream=f"attack/moment/{i}", sync="all", profile={"rate": "raw"})
    ready()
    while go():
        for peer in peers:
            with contextlib.suppress(OSError):
                order(peer, "late", stream=f"attack/moment/{said % streams}", lag_us=said * 7919 % 300_000)
            said += 1
    return f"{said} lags, {viewers} viewers of {streams} streams"


def watch_all(port, streams, addresses, viewers, **how):
    """So many viewers of a few addresses, each of whom watches all streams; and how many they watch."""
    peers = [connect(port, "/v1/subscribe", f"203.0.113.{i % addresses}", **how) for i in range(viewers)]
    text = b"".join(frame(TEXT, json.dumps({"op": "subscribe", "stream": stream, "profile": {"rate": "raw"}}).encode()) for stream in streams)
    for peer in peers if how else read_all(peers):
        peer.send(text)
    until, watching = time.monotonic() + 120, 0
    while watching < len(streams) * viewers and time.monotonic() < until:
        time.sleep(0.5)
        listed = json.loads(ask(port, "GET", "/v1/streams", address="198.51.100.200")[1])["streams"]
        watching = sum(stream["subscribers"] for stream in listed if stream["stream"] in streams)
    return peers, watching


def named(kind, count):
    return [f"attack/{kind}/{i}" for i in range(count)]


def joined(port, streams, layout, addresses=1):
    senders = [Sender(port, stream, layout, f"203.0.113.{100 + i % addresses}") for i, stream in enumerate(streams)]
    for sender in senders:
        sender.join()
    return senders


def many_watched(port, ready, go, addresses=8, connections=24, streams=256):
    """Viewers of a few addresses watch all streams that there are, on each of many connections, and say nothing."""
    streams = named("watched", streams)
    joined(port, streams, SMALL, 8)
    peers, watching = watch_all(port, streams, addresses, addresses * connections)
    ready()
    while go():
        time.sleep(0.1)
    return f"{watching} watched, {len(peers)} connections"


def keys_at_once(port, ready, go, addresses=4, viewers=500, streams=126, hz=10):
    """The keys of many streams come at one moment for each of many viewers. (H2 of the thirteenth audit)"""
    streams = named("burst", streams)
    senders = joined(port, streams, TINY)
    _, watching = watch_all(port, streams, addresses, viewers)
    sent, due = 0, time.monotonic()
    ready()
    while go():
        for sender, key in [(sender, sender.frame(payloads.KEY, zeros(TINY)[1])) for sender in senders]:
            sender.peer.send(key)
        sent, due = sent + 1, max(due + 1 / hz, time.monotonic() - 1)
        time.sleep(max(0, due - time.monotonic()))
    return f"{watching} watched, {sent} times {len(streams)} keys"


def keys_for_crowds(port, ready, go):
    """A few streams of many keys for very many viewers of many addresses."""
    return keys_at_once(port, ready, go, addresses=16, viewers=1600, streams=16, hz=200)


def unread_keys(port, ready, go, streams=20, viewers=300):
    """Streams of one number and as many keys as come through, for viewers of one address that read nothing."""
    streams = named("unread", streams)
    senders = joined(port, streams, TINY)
    peers, _ = watch_all(port, streams, 1, viewers, receive_buffer=2048)
    keys, sent = [b"".join(sender.frame(payloads.KEY, zeros(TINY)[1]) for _ in range(256)) * 16 for sender in senders], [0] * len(streams)
    for sender in senders:
        sender.peer.sock.setblocking(False)
    ready()
    while go():
        for i, sender in enumerate(senders):
            with contextlib.suppress(BlockingIOError):
                at = sent[i] % len(keys[i])
                sent[i] += sender.peer.sock.send(keys[i][at:at + 16384])
        time.sleep(0.001)
    return f"{sum(sent) * 256 * 16 // len(keys[0])} keys, {len(peers)} viewers of {len(streams)} streams"


def joins_at_once(port, ready, go, streams=96, addresses=4):
    """Viewers, each with a profile of its own, let the windows of all streams close and open them all at one moment: each needs a join of each."""
    layout = {**SMALL, "rows": 2048, "band_ends": [256 * (i + 1) for i in range(8)]}
    streams = named("joins", streams)
    senders, ids, viewers = joined(port, streams, layout, addresses), {}, []
    for bands in range(3, 9):
        viewers.append(viewer := connect(port, "/v1/subscribe", "203.0.113.200"))
        for stream in streams:
            order(viewer, "subscribe", stream=stream, profile={"rate": "raw", "bands": bands})
            ids[stream] = hear(viewer, "stream")["stream_id"]
    read_all(viewers)

    def send(then_s):
        for sender in senders:
            sender.peer.send(sender.frame(payloads.KEY, zeros(layout)[1]))
        time.sleep(then_s)

    def acknowledge():
        items = [{"stream_id": ids[sender.stream], "sequence": sender.sequence - back, "step": 0} for sender in senders for back in (2, 1, 0)]
        for viewer in viewers:
            for i in range(0, len(items), 60):
                order(viewer, "ack", items=items[i:i + 60], time_us=1)
        time.sleep(0.05)
    for _ in range(4):
        send(0.05), acknowledge()
    ready()
    rounds = 0
    while go():
        send(0.22), send(0.03), send(0.05), acknowledge()
        rounds += 1
    return f"{rounds} times {len(streams)} joins for each of {len(viewers)} viewers"


def new_names(port, ready, go):
    """Two tokens announce streams under ever new names, of which all brokers keep a row. (D6)"""
    subjects = [f"Authorization: Bearer {token(name, pub=['**'])}" for name in ("a", "b")]
    done, why = 0, ""
    ready()
    while go():
        for subject in subjects:
            try:
                peer = connect(port, f"/v1/publish/attack/{os.urandom(8).hex()}", "203.0.113.200", subject)
                order(peer, "announce", asset=ASSET_ID, key_rate_hz=50, format=SMALL)
                done += (answer := hear(peer, "announced", "error"))["op"] == "announced"
                why = answer.get("message", why)
                peer.sock.close()
            except (OSError, EOFError) as error:
                why = str(error) or why
    return f"{done} names, {why[:60] or 'none refused'}"


def ask_again(port, go, connections, asks):
    """Connections that ask at once again when they have been answered; the bytes of the answers."""
    import selectors
    selector, buffer, taken = selectors.DefaultSelector(), bytearray(1 << 20), 0

    def begin(i):
        one = socket.create_connection(("127.0.0.1", port))
        one.sendall(next(asks))
        one.setblocking(False)
        selector.register(one, selectors.EVENT_READ, i)
    for i in range(connections):
        begin(i)
    while go():
        for key, _ in selector.select(0.5):
            with contextlib.suppress(OSError):
                if count := key.fileobj.recv_into(buffer):
                    taken += count
                    continue
            selector.unregister(key.fileobj)
            key.fileobj.close()
            begin(key.data)
    return taken


def wrong_tokens(port, ready, go, connections=200):
    """Tokens of wrong signatures from the networks of one site, ten from each. (A1)"""
    import base64
    text = lambda raw: base64.urlsafe_b64encode(raw).rstrip(b"=").decode()
    count = [0]

    def asks():
        while True:
            count[0] += 1
            yield f"GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: 2001:db8:7:{count[0] // 10 % 4000:x}::1\r\n" \
                  f"Authorization: Bearer {text(KEY_HEAD)}.{text(b'{}')}.{text(os.urandom(64))}\r\nConnection: close\r\n\r\n".encode()
    ready()
    ask_again(port, go, connections, asks())
    return f"{count[0]} tokens"


def body_flood(port, ready, go, bytes_each=8 << 20, connections=900):
    """An address downloads a large asset on as many connections as it may have. (A2, A3)"""
    body = os.urandom(bytes_each)
    put(port, body)
    text = f"GET /v1/assets/{hashlib.sha256(body).hexdigest()} HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: 203.0.113.1\r\nConnection: close\r\n\r\n"
    ready()
    taken = ask_again(port, go, connections, iter(lambda: text.encode(), None))
    return f"{taken / 1e6:.0f} MB, {connections} connections"


# Attacks on rights and places: return what they found and whether it is as it must be.


def token(subject, **rights):
    import base64
    import hmac
    text = lambda raw: base64.urlsafe_b64encode(raw).rstrip(b"=")
    claims = {"sub": subject, "aud": "eigencast", "exp": int(time.time()) + 3600, "eigencast": rights}
    signed = b".".join(text(json.dumps(part).encode()) for part in ({"alg": "HS256"}, claims))
    return (signed + b"." + text(hmac.digest(SECRET.encode(), signed, "sha256"))).decode()


def upload_slots(broker):
    """One address begins uploads and does not end them; another uploads."""
    with broker() as (_, port, _):
        held = []
        for _ in range(100):
            one = socket.create_connection(("127.0.0.1", port))
            one.sendall(b"PUT /v1/assets/" + hashlib.sha256(b"x").hexdigest().encode() + b" HTTP/1.1\r\nHost: localhost\r\n"
                        b"X-Forwarded-For: 203.0.113.1\r\nContent-Length: 1000000\r\nExpect: 100-continue\r\n\r\n")
            held.append(one)
        taken = sum(b" 100 " in one.recv(4096) for one in held)
        status = put(port, b"of another address", "198.51.100.1")
        for one in held:
            one.close()
        return f"{taken} of 100 begin, another's: {status}", taken == 8 and status == 201


def share_link(broker):
    """One who has the link of --share uses up what it allows; another who has it watches. (E2)"""
    with broker(access_anonymous="nowhere", per_token_streams=4, per_token_requests_per_s=50) as (_, port, _):
        link = f"?access_token={token('share', sub=['**'])}"
        greedy = [connect(port, f"/v1/subscribe/s{i}{link}", "203.0.113.1") for i in range(8)]
        kinds = [hear(peer, "stream", "error")["op"] for peer in greedy]
        statuses = [ask(port, "GET", f"/v1/streams{link}", address="198.51.100.1")[0] for _ in range(5)]
        other = hear(connect(port, f"/v1/subscribe/s0{link}", "198.51.100.1"), "stream", "error")["op"]
        return f"{kinds.count('stream')} of 8 streams, another's: {other}, lists {sorted(set(statuses))}", \
            kinds.count("stream") == 4 and other == "stream" and set(statuses) == {200}


CLAIMS = [{"Host": "evil.example"}, {"Host": "localhost.evil.example"}, {"Host": "127.0.0.1.evil.example:80"}, {"Host": "evil.example@localhost"},
          {"Host": "localhost", "Origin": "http://evil.example"}, {"Host": "localhost", "Origin": "null"}, {"Host": "localhost", "Origin": "http://localhost.evil.example"},
          {"Host": "localhost", "Origin": "http://evil.example#@localhost"}, {"Host": "localhost", "Origin": "http://localhost@evil.example"},
          {"X-Forwarded-For": "127.0.0.1"}, {"X-Forwarded-For": "::1"}, {"X-Forwarded-For": "127.0.0.1, 127.0.0.1"}, {"X-Forwarded-For": ""}, {"X-Forwarded-For": "::ffff:127.0.0.1"},
          {"Forwarded": "for=127.0.0.1"}, {"Forwarded": 'for="[::1]"'}, {"X-Real-IP": "127.0.0.1"}, {"Via": "1.1 x"}, {"X-Forwarded-Host": "localhost"}]


def claims_of_nearness(broker):
    """Requests that say they are this machine's, or another page's, at the data port and the admin port."""
    let_in = []
    for trusted in ("", "127.0.0.0/8"):
        with broker(proxy_trusted=trusted, access_anonymous="loopback") as (_, *ports):
            assert all(ask(port, "GET", path, address=None)[0] == 200 for port, path in zip(ports, ("/v1/streams", "/api/clients")))
            for claim in CLAIMS:
                for port, path in zip(ports, ("/v1/streams", "/api/clients")):
                    status = ask(port, "GET", path, address=None, **claim)[0]
                    if status == 200:
                        let_in.append(f"{claim} at {path}")
                upgrade = "".join(f"{name}: {value}\r\n" for name, value in {"Host": "localhost", **claim}.items())
                with socket.create_connection(("127.0.0.1", ports[0]), timeout=30) as one:
                    one.sendall(f"GET /v1/publish/s HTTP/1.1\r\n{upgrade}Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
                                f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n".encode())
                    if b" 101 " in one.recv(4096).split(b"\r\n")[0]:
                        let_in.append(f"{claim} at /v1/publish")
    return f"{len(let_in)} of {6 * len(CLAIMS)} let in{': ' if let_in else ''}{'; '.join(let_in)}", not let_in


def forged_addresses(broker):
    """An untrusted peer, or a client of the proxy, claims other addresses to have more than one address's share."""
    with broker(proxy_trusted="198.18.0.1", per_address_connections=4) as (_, port, _):
        direct = [ask_upgrade(port, f"203.0.113.{i}") for i in range(8)]
    with broker(per_address_connections=4) as (_, port, _):
        through = [ask_upgrade(port, f"203.0.113.{i}, 198.51.100.7") for i in range(8)]
    return f"{direct.count(101)} and {through.count(101)} of 8 connections", direct.count(101) <= 4 and through.count(101) <= 4


held_open = []


def ask_upgrade(port, forwarded):
    peer = Peer(port, "/v1/subscribe/s", SUBPROTOCOL, [f"X-Forwarded-For: {forwarded}"])
    held_open.append(peer)
    return peer.status


TIMED = [remember_flood, announce_flood, anew_in_profiles, joins_in_profiles, large_keys, trace_flood, recalled_keys, many_senders, memory_reads, seek_flood,
         list_flood, first_reads, change_flood, full_rooms, moments, many_watched, keys_at_once, keys_for_crowds, joins_at_once, unread_keys, new_names,
         wrong_tokens, body_flood]
RIGHTS = [upload_slots, share_link, claims_of_nearness, forged_addresses]


@contextlib.contextmanager
def started(program, **settings):
    flags = {**FLAGS, **{name.replace("_", "-"): value for name, value in settings.items()}}
    with Broker(program, *(f"--{name}={value}" for name, value in flags.items() if value)) as broker:
        yield broker, *ports_of(pathlib.Path(broker.folder) / "port")


def run_timed(attack, program, seconds):
    """Figures without and with the attack, and its words."""
    context = multiprocessing.get_context("fork")
    with started(program) as (broker, port, _):
        put(port, ASSET)
        innocent = Innocent(port, broker.process.pid)
        over, begun = context.Event(), context.Event()
        words, answer = context.Pipe(duplex=False)

        def attacker():
            try:
                answer.send(attack(port, begun.set, lambda: not over.is_set()))
            except Exception as error:  # Whatever it is, the table says it.
                answer.send(f"FAILED: {type(error).__name__} {error}")
            begun.set()
            os._exit(0)
        time.sleep(0.2)
        alone = innocent.measure(seconds / 2)
        process = context.Process(target=attacker)
        process.start()
        begun.wait(60)
        time.sleep(0.2)
        during = innocent.measure(seconds)
        over.set()
        said = words.recv() if words.poll(60) else "FAILED: it does not end"
        process.kill()
        process.join()
        innocent.stop()
        return alone, during, said


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--broker", required=True)
    parser.add_argument("--seconds", type=float, default=4)
    parser.add_argument("--bound-ms", type=float, default=20)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    key = KEYS.name + "/main.pem"
    subprocess.run(["openssl", "genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", key], check=True, stderr=subprocess.DEVNULL)
    FLAGS["access-jwt-keys"] = f"main ES256 {key}"
    chosen = lambda attacks: [attack for attack in attacks if not options.names or attack.__name__ in options.names]
    failed = 0
    print("| attack | without it: p50, p99 ms, keys lost %, core % | with it | verdict | |\n|-|-|-|-|-|", flush=True)
    for attack in chosen(TIMED):
        alone, during, said = run_timed(attack, options.broker, 0.5 if options.check else options.seconds)
        holds = not said.startswith("FAILED") and during[2] < 100 and (options.check or during[1] < options.bound_ms)
        failed += not holds
        text = lambda one: f"{one[0]:.1f}, {one[1]:.1f}, {one[2]:.0f}, {one[3]:.0f}"
        print(f"| {attack.__name__} | {text(alone)} | {text(during)} | {'holds' if holds else 'FAILS'} | {said} |", flush=True)
    for attack in chosen(RIGHTS):
        said, holds = attack(functools.partial(started, options.broker))
        failed += not holds
        print(f"| {attack.__name__} | | | {'holds' if holds else 'FAILS'} | {said} |", flush=True)
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
