# SPDX-License-Identifier: MIT
"""Senders and viewers in one asyncio loop, on sockets of any host's network, and links that can be slow. They record what happens as events
(history.py)."""
import asyncio
import base64
import contextlib
import hashlib
import itertools
import json
import os
import re
import socket
import struct
import time

import poses
from said import KEYS, said_after
from websocket_peer import BINARY, CLOSE, PING, PONG, TEXT, frame

PORT = 7490
CHANGE_S = 7.0
PATIENCE_S = 4.0  # Without a byte for so long a client connects anew.
CONNECT_S = 2.0
RETRY_S = 0.2


class Gone(Exception):
    """The connection is over."""


def monotonic_us():
    return time.monotonic_ns() // 1000


async def connected(host, address, port):
    with host.within():
        sock = socket.socket()
    sock.setblocking(False)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        async with asyncio.timeout(CONNECT_S):
            await asyncio.get_running_loop().sock_connect(sock, (address, port))
    except BaseException:
        sock.close()
        raise
    return sock


class WebSocket:
    """One client's connection: messages in, frames out."""

    def __init__(self, sock, path):
        self.sock, self.path, self.buffer, self.last = sock, path, b"", time.monotonic()
        self.loop = asyncio.get_running_loop()

    async def open(self):
        key = base64.b64encode(os.urandom(16)).decode()
        await self.send_raw((f"GET {self.path} HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                             f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: eigencast.v2\r\n\r\n").encode())
        while b"\r\n\r\n" not in self.buffer:
            await self.more()
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        if b" 101 " not in head.split(b"\r\n")[0]:
            raise Gone(head.split(b"\r\n")[0].decode())

    async def more(self):
        try:
            async with asyncio.timeout(PATIENCE_S):
                piece = await self.loop.sock_recv(self.sock, 1 << 17)
        except TimeoutError:
            raise Gone("silent") from None
        if not piece:
            raise Gone("closed")
        self.buffer += piece

    async def send_raw(self, data):
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self.loop.sock_sendall(self.sock, data)
        except TimeoutError:
            raise Gone("does not read") from None

    async def send(self, message):
        await self.send_raw(frame(TEXT, json.dumps(message).encode()) if isinstance(message, dict) else frame(BINARY, message))

    async def messages(self):
        """Whole messages, several of one read at once: lists of (opcode, payload)."""
        while True:
            data, at, found = self.buffer, 0, []
            while len(data) - at >= 2:
                size, head = data[at + 1] & 0x7F, 2
                if size == 126 and len(data) - at >= 4:
                    size, head = struct.unpack_from(">H", data, at + 2)[0], 4
                elif size == 127 and len(data) - at >= 10:
                    size, head = struct.unpack_from(">Q", data, at + 2)[0], 10
                elif size > 125:
                    break
                if len(data) - at < head + size:
                    break
                found.append((data[at] & 15, data[at + head: at + head + size]))
                at += head + size
            self.buffer = data[at:]
            for opcode, payload in found:
                if opcode == PING:
                    await self.send_raw(frame(PONG, payload))
            if found:
                yield found
            if any(opcode == CLOSE for opcode, _ in found):
                raise Gone("told to go")
            await self.more()

    def close(self):
        with contextlib.suppress(OSError):
            self.sock.send(frame(CLOSE, struct.pack(">H", 1000)))
            self.sock.shutdown(socket.SHUT_WR)

    def abort(self):
        """By a reset."""
        try:
            self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        except OSError:
            pass
        self.sock.close()


class Client:
    """Connects, does its work, and when that ends connects again, for ever: see once()."""

    def __init__(self, cluster, host, brokers):
        self.cluster, self.host, self.brokers = cluster, host, brokers
        self.web = self.dropped = None
        self.away_s = RETRY_S
        self.task = asyncio.get_running_loop().create_task(self.run())
        self.task.add_done_callback(cluster.on_task_ended)

    async def run(self):
        for turn in itertools.count():
            broker = self.brokers[turn % len(self.brokers)]
            try:
                self.dropped = asyncio.get_running_loop().create_future()
                await self.once(broker)
            except (OSError, Gone, asyncio.IncompleteReadError):
                pass
            finally:
                if self.web is not None:
                    self.web.abort()
            away_s, self.away_s = self.away_s, RETRY_S
            await asyncio.sleep(away_s)

    def drop(self, away_s=RETRY_S):
        """Resets its connection, and comes back."""
        self.away_s = max(away_s, RETRY_S)
        if self.dropped is not None and not self.dropped.done():
            self.dropped.set_result(None)

    async def reach(self, broker, path):
        host, address, port = broker.reached_from(self)
        self.web = WebSocket(await connected(host, address, port), path)
        await self.web.open()

    async def pings(self):
        for number in itertools.count():
            await asyncio.sleep(1)
            await self.web.send({"op": "ping", "id": number, "time_us": monotonic_us()})

    async def both(self, *works):
        """Until one of them ends, which ends the others, or it is dropped."""
        tasks = [asyncio.get_running_loop().create_task(work) for work in works]
        try:
            done, _ = await asyncio.wait([*tasks, self.dropped], return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def end(self):
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)


    async def fetch(self, broker, path, body=None):
        """Status and body of a GET, or of a PUT of `body`."""
        host, address, port = broker.reached_from(self)
        reader, writer = await asyncio.open_connection(sock=await connected(host, address, port))
        try:
            what = f"GET {path}" if body is None else f"PUT {path}"
            length = "" if body is None else f"Content-Length: {len(body)}\r\n"
            writer.write(f"{what} HTTP/1.1\r\nHost: localhost\r\n{length}\r\n".encode() + (body or b""))
            async with asyncio.timeout(PATIENCE_S):
                head = await reader.readuntil(b"\r\n\r\n")
                answer = await reader.readexactly(int(re.search(rb"(?i)content-length: (\d+)", head)[1]))
        except TimeoutError:
            raise Gone("silent") from None
        finally:
            writer.transport.abort()  # Which closes the socket, once its loop knows no more of it.
        return head.split()[1], answer


class Sender(Client):
    """Sends one stream of poses with tags (poses.py), to the first broker that takes it."""

    def __init__(self, cluster, host, brokers, stream, number, velocities, rate):
        self.stream, self.number, self.velocities, self.rate = stream, number, velocities, rate
        self.paused_until, self.resume = 0.0, ""  # Times of the steady clock.
        super().__init__(cluster, host, brokers)

    def pause(self, seconds):
        self.paused_until = time.monotonic() + seconds

    def move(self):
        """Closes its connection, and goes on at the next broker."""
        if self.web is not None:
            self.web.close()
        self.drop()

    async def upload(self, broker, announcement):
        """The surface of an announcement; returns its name."""
        body = f"surface {announcement} of sender {self.number}, of which the broker knows nothing".encode()
        asset = hashlib.sha256(body).hexdigest()
        status, _ = await self.fetch(broker, f"/v1/assets/{asset}", body)
        if status not in (b"200", b"201"):
            raise Gone(f"upload: {status.decode()}")
        return asset

    async def once(self, broker):
        self.announcement, self.has_epoch = next(self.cluster.announcements), asyncio.Event()
        asset = await self.upload(broker, self.announcement)
        await self.reach(broker, f"/v1/publish/{self.stream}")
        granted = asyncio.Queue()
        await self.announce(asset)
        await self.both(self.listen(broker, granted), self.play(granted), self.pings(), self.changes(broker))

    async def announce(self, asset, **more):
        await self.web.send({"op": "announce", "asset": asset, "format": poses.form(self.velocities), "key_rate_hz": self.rate, **more,
                             "resume": self.resume})

    async def changes(self, broker):
        """Another surface now and then, to which the poses that come change over."""
        while True:
            await self.has_epoch.wait()
            await asyncio.sleep(CHANGE_S + self.number)
            announcement = next(self.cluster.announcements)
            try:
                asset = await self.upload(broker, announcement)
            except (OSError, Gone, asyncio.IncompleteReadError):
                continue  # Its disk is full, or it is paused.
            self.announcement = announcement
            self.has_epoch.clear()
            await self.announce(asset, **{"continues": True})

    async def listen(self, broker, granted):
        is_later = False
        async for messages in self.web.messages():
            for opcode, payload in messages:
                message = json.loads(payload) if opcode == TEXT else {}
                if message.get("op") == "announced":
                    self.cluster.record("announced", stream=self.stream, epoch=message["epoch"], broker=broker.name,
                                        announcement=self.announcement, continues=is_later)
                    self.resume, is_later = message.get("resume", ""), True
                    self.has_epoch.set()
                    granted.put_nowait((message["tag"], self.announcement))
                elif message.get("op") == "error":
                    raise Gone(f"{message['code']}: {message['message']}")

    async def play(self, granted):
        (tag, announcement), chain = await granted.get(), poses.Chain()
        began = time.monotonic()
        for sequence in itertools.count():
            kind, now_us, age_us = poses.KEY if sequence else poses.JOIN, monotonic_us(), 0
            if not granted.empty():  # The poses go on, after the last one in the new basis.
                (tag, announcement), kind, age_us = granted.get_nowait(), poses.JOIN, now_us - chain.capture_us
            head = chain.write(kind, 3, sequence, now_us, tag, age_us)
            await self.web.send(head + poses.payload(kind, self.number, announcement, sequence, self.rate, self.velocities,
                                                     sequence - 1 if age_us else None))
            due = began + (sequence + 1) / self.rate
            if due < time.monotonic() - 0.2:  # Behind: goes on from now.
                began = time.monotonic() - (sequence + 1) / self.rate
            await asyncio.sleep(max(due - time.monotonic(), self.paused_until - time.monotonic(), 0))


class Viewer(Client):
    """Watches one stream in one profile."""

    def __init__(self, cluster, host, brokers, name, stream, number, channels, profile, acknowledges, by_relay):
        self.name, self.stream, self.number, self.channels, self.profile = name, stream, number, channels, profile
        self.acknowledges, self.by_relay = acknowledges, by_relay
        cluster.record("viewer", viewer=name, stream=stream, number=number)
        super().__init__(cluster, host, brokers)

    async def once(self, broker):
        await self.reach(broker, f"/v1/subscribe/{self.stream}?{self.profile}")
        self.newest = self.epoch = self.tag = None
        self.generation, memories = 0, asyncio.Queue()
        await self.both(self.watch(broker, memories), self.pings(), *([self.acks(), self.remember(broker, memories)] if self.acknowledges else []))

    async def acks(self):
        while True:
            await asyncio.sleep(0.1)
            if self.newest:
                id_, sequence, step = self.newest
                item = {"stream_id": id_, "sequence": sequence, "step": step, "generation": self.generation}
                await self.web.send({"op": "ack", "items": [item], "time_us": monotonic_us()})

    async def remember(self, broker, memories):
        """Fetches memories, and says so: keys may be predicted from them then. It decodes none."""
        segments = []
        while True:
            message = await memories.get()
            segments[message.get("kept", 0):] = message["segments"]
            why = ""
            for segment in message["segments"]:
                status, body = await self.fetch(broker, f"/v1/assets/{segment}")
                if status == b"200" and hashlib.sha256(body).hexdigest() != segment:
                    why = f"segment {segment} is other bytes"
                if status != b"200":
                    break
            else:
                self.cluster.record("memory", viewer=self.name, generation=message["generation"], segments=len(segments), why=why)
                self.generation = message["generation"]

    async def watch(self, broker, memories):
        record, viewer, chain = self.cluster.record, self.name, poses.Chain()
        async for messages in self.web.messages():
            for opcode, payload in messages:
                if opcode == BINARY:
                    head = chain.read(payload)
                    if head is None:  # One that it cannot use, which no stream announced.
                        record("frame", viewer=viewer, kind=poses.KEY, id=0, epoch=0, sequence=0, at=0, of=0, ahead=False, capture=0, tag=None)
                        continue
                    self.newest = (head.stream_id, head.sequence, head.at << 4 | head.of)
                    record("frame", viewer=viewer, kind=head.kind, recalled=bool(payload[0] & 32), id=head.stream_id,
                           epoch=self.epoch if head.tag == self.tag else 0, sequence=head.sequence, at=head.at, of=head.of, ahead=head.ahead, capture=head.shown_us,
                           tag=poses.tag_of(head.kind, head.bands, payload[head.size:], self.channels))
                    continue
                message = json.loads(payload) if opcode == TEXT else {}
                if message.get("op") == "welcome":
                    record("connected", viewer=viewer, stream=self.stream, number=self.number, broker=broker.name, run=message["session_id"])
                elif message.get("op") == "stream":
                    self.newest, self.epoch, self.tag = None, message["epoch"], message.get("tag")
                    record("state", viewer=viewer, stream=message["stream"], id=message["stream_id"], epoch=message["epoch"],
                           profile=message.get("profile", {}), state=message["state"])
                    if asset := message.get("next", {}).get("asset"):
                        await self.web.send({"op": "prepared", "stream": message["stream"], "asset": asset})
                elif message.get("op") == "remember":
                    memories.put_nowait(message)


class Person(Client):
    """Is in a room of one broker, and says there what said.py has."""
    ROOM, SAY_S = "cluster/room", 0.25

    def __init__(self, cluster, host, brokers, name, by_relay):
        self.name, self.by_relay, self.times, self.resume = name, by_relay, 0, ""
        super().__init__(cluster, host, brokers)

    async def once(self, broker):
        await self.reach(broker, "/v1/subscribe")
        self.speaks, self.is_fresh = asyncio.Event(), True
        await self.web.send({"op": "enter", "room": self.ROOM, "name": self.name, "resume": self.resume})
        await self.both(self.listen(broker), self.speak(), self.pings())

    async def speak(self):
        await self.speaks.wait()
        while True:
            self.times += 1
            self.cluster.record("said", person=self.name, times=self.times)
            values, changed = said_after(self.times), f"k{self.times % KEYS}"
            keys = [f"k{key}" for key in range(KEYS)] if self.is_fresh else [changed]
            self.is_fresh = False
            await self.web.send({"op": "say", "room": self.ROOM, "values": {key: values.get(key) for key in ["times", *keys]}})
            await asyncio.sleep(self.SAY_S)

    async def listen(self, broker):
        run, members = "", {}
        async for messages in self.web.messages():
            for opcode, payload in messages:
                message = json.loads(payload) if opcode == TEXT else {}
                if message.get("op") == "welcome":
                    run = message["session_id"]
                elif message.get("op") == "error":
                    raise Gone(f"{message['code']}: {message['message']}")
                elif message.get("op") == "room":
                    if "self" in message:
                        self.resume = message["resume"]
                        self.cluster.record("entered", person=self.name, broker=broker.name, run=run, id=message["self"])
                        self.speaks.set()
                    members = {} if message.get("whole") else members
                    for gone in message.get("gone", []):
                        members.pop(gone, None)
                    for change in message.get("members", []):
                        member = members.setdefault(change["id"], {"name": "", "values": {}})
                        member["name"] = change.get("name", member["name"])
                        for key, value in change.get("values", {}).items():
                            member["values"].pop(key, None) if value is None else member["values"].update({key: value})
                    for id_ in {change["id"] for change in message.get("members", [])}:
                        self.cluster.record("heard", person=self.name, id=id_, name=members[id_]["name"], values=dict(members[id_]["values"]))


class Relay:
    """A link through this process: passes all at once, little and late, or nothing. The kernel has no such link everywhere."""
    MAX_QUEUED = 1 << 18

    def __init__(self, host, port, target):
        self.target = target  # host, address, port
        self.host = host
        self.delay_s, self.bytes_per_s, self.open = 0.0, 0.0, asyncio.Event()
        self.open.set()
        with host.within():
            listener = socket.create_server(("127.0.0.1", port))
        listener.setblocking(False)
        self.listener = listener
        self.ends = set()
        self.task = asyncio.get_running_loop().create_task(self.run())

    def set_pace(self, delay_s, bytes_per_s):
        """0: no limit."""
        self.delay_s, self.bytes_per_s = delay_s, bytes_per_s

    async def run(self):
        loop = asyncio.get_running_loop()
        while True:
            near, _ = await loop.sock_accept(self.listener)
            near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            task = loop.create_task(self.carry(near))
            self.ends.add(task)
            task.add_done_callback(self.ends.discard)

    async def carry(self, near):
        near.setblocking(False)
        far = None
        try:
            await self.open.wait()
            far = await connected(*self.target)
            ways = [asyncio.get_running_loop().create_task(self.pass_on(a, b)) for a, b in ((near, far), (far, near))]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        except OSError:
            pass
        finally:
            near.close()
            if far is not None:
                far.close()

    async def pass_on(self, source, sink):
        loop = asyncio.get_running_loop()
        queue, room = asyncio.Queue(), asyncio.Event()
        room.set()
        waiting = free_at = 0

        async def write():
            nonlocal waiting
            while True:
                at, data = await queue.get()
                if at > time.monotonic():
                    await asyncio.sleep(at - time.monotonic())
                await self.open.wait()
                await loop.sock_sendall(sink, data)
                waiting -= len(data)
                if waiting < self.MAX_QUEUED:
                    room.set()
        me, writer = asyncio.current_task(), loop.create_task(write())
        end_with = lambda _: me.cancel()
        writer.add_done_callback(end_with)
        try:
            while data := await loop.sock_recv(source, 1 << 15):
                now = time.monotonic()
                free_at = max(free_at, now) + (len(data) / self.bytes_per_s if self.bytes_per_s else 0)
                queue.put_nowait((free_at + self.delay_s, data))
                waiting += len(data)
                if waiting >= self.MAX_QUEUED:
                    room.clear()
                    await room.wait()
        except OSError:
            pass
        finally:
            writer.remove_done_callback(end_with)
            writer.cancel()
            await asyncio.gather(writer, return_exceptions=True)
