#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What a room costs the broker: people who each say their pointer and camera so often, and are told of all others.

    bench/broker/rooms.py --broker build/release/bin/eigencast-broker [--people 50] [--rate 10] [--seconds 20]

Prints a line of JSON: part of a core (the broker's processor time over the wall's), messages and bytes to each person a
second, and the time from saying a pointer to its arrival at all others (which the beat of 100 ms is a part of).
"""
import argparse
import json
import os
import pathlib
import selectors
import statistics
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests/support"))
from websocket_peer import PING, PONG, TEXT, Broker, Peer, frame


def cpu_seconds(pid):
    tasks = f"/proc/{pid}/task"
    return sum(int(pathlib.Path(tasks, task, "schedstat").read_text().split()[0]) for task in os.listdir(tasks)) / 1e9


class Person:
    def __init__(self, port, number, rate):
        self.number, self.messages, self.bytes = number, 0, 0
        self.peer = Peer(port, "/v1/subscribe", "eigencast.v2")
        self.tell({"op": "enter", "room": "lab/horse", "name": f"Person {number}", "colour": "#e69f00"})
        self.due = time.monotonic() + number / 50 / rate

    def tell(self, message):
        self.peer.send(frame(TEXT, json.dumps(message, separators=(",", ":")).encode()))

    def say(self):
        stamp = time.monotonic_ns() // 1000
        pointer = {"stream": "lab/horse", "corners": [stamp % 8431, 1234, 4321], "weights": [0.2512, 0.4987, 0.2501], "t": stamp}
        camera = {"eye": [1.2345, 2.3456, 3.4567 + stamp % 100 / 1e4], "target": [0.1234, 0.2345, 0.3456]}
        self.tell({"op": "say", "room": "lab/horse", "values": {"pointer": pointer, "camera": camera}})

    def read(self):
        """Delays of the others' pointers in what has come."""
        self.peer.more()
        delays, now = [], time.monotonic_ns() // 1000
        while len(self.peer.buffer) >= 2:
            length, head = self.peer.buffer[1] & 0x7F, 2
            if length >= 126:
                head += 2 if length == 126 else 8
                length = int.from_bytes(self.peer.buffer[2:head], "big")
            if len(self.peer.buffer) < head + length:
                break
            opcode, payload = self.peer.receive()
            if opcode == PING:
                self.peer.send(frame(PONG, payload))
            if opcode != TEXT:
                continue
            self.messages += 1
            self.bytes += len(payload)
            if self.number:  # One of them looks into it; the others' time is the load generator's only.
                continue
            for member in json.loads(payload).get("members", []):
                pointer = member.get("values", {}).get("pointer")
                if pointer:
                    delays.append((now - pointer["t"]) / 1000)
        return delays


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--broker", required=True)
    parser.add_argument("--people", type=int, default=50)
    parser.add_argument("--rate", type=float, default=10)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    with Broker(options.broker, f"--threads={options.threads}") as broker:
        people = [Person(broker.port, number, options.rate) for number in range(options.people)]
        selector = selectors.DefaultSelector()
        for person in people:
            selector.register(person.peer.sock, selectors.EVENT_READ, person)
        delays, began, cpu, said = [], None, 0, 0
        start = time.monotonic()
        while True:
            now = time.monotonic()
            if began is None and now - start > 2:  # All are in.
                began, cpu, said, delays = now, cpu_seconds(broker.process.pid), 0, []
                for person in people:
                    person.messages = person.bytes = 0
            if began is not None and now - began > options.seconds:
                break
            for person in people:
                if now >= person.due:
                    person.due += 1 / options.rate
                    person.say()
                    said += 1
            wait = max(0, min(person.due for person in people) - time.monotonic())
            for key, _ in selector.select(wait):
                delays += key.data.read()
        wall = time.monotonic() - began
        used = cpu_seconds(broker.process.pid) - cpu
    delays.sort()
    print(json.dumps({"people": options.people, "said_per_s": round(said / wall, 1), "part_of_a_core": round(used / wall, 4),
                      "messages_per_s_each": round(statistics.mean(p.messages for p in people) / wall, 2),
                      "kbyte_per_s_each": round(statistics.mean(p.bytes for p in people) / wall / 1000, 1),
                      "delay_ms": {"p50": round(delays[len(delays) // 2], 1), "p95": round(delays[int(0.95 * len(delays))], 1),
                                   "max": round(delays[-1], 1)}}))


if __name__ == "__main__":
    main()
