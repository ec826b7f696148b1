#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A second decoder of pose memories, written from common/codec/pose_memory.h: plain, slow, standard library only.

    reference_memory.py --check FILE.jsonl   reads the segments and keys of tests/golden/memory.jsonl, compares, and makes
                                             sure that no truncation or extension is taken
"""

import json
import sys

from reference_bits import Bytes, ProtocolError, RangeDecoder, require
from reference_decoder import (
    MAX_VALUE, Contexts, Key, Receiver, band_range, expected_scale, read_exact, read_levels, references, rescale)


def read_recalled(section, m, channels, c1, c2, e, e1, where, values):
    require(c1 is not None, "coarse run without the newer key")
    c2, e1 = c2 or c1, e1 or e
    speeds = [abs(a - b) for a, b in zip(c1, c2)]
    expected = expected_scale(speeds, m)
    coder = RangeDecoder(section.take(len(section.data) - section.at))
    scale = coder.scale(min(expected, 5))
    require(0 <= scale <= 30, "scale")
    hold = 1 + coder.number(2) if coder.decision() else 0
    speed = coder.number(4) if coder.decision() else 4
    shift = max(0, expected - scale) // 2
    contexts = Contexts(m, channels, scale, [speed_of >> shift for speed_of in speeds])
    read_levels(coder, contexts, m, values, where,
                lambda n: e[n] + ((2 * hold * (c1[n] - e1[n]) + (speed - 4) * (c1[n] - c2[n]) + 4) >> 3))


class Memory(Receiver):
    """A receiver whose keys may be predicted from segments of poses."""

    def __init__(self, layout, asset):
        super().__init__(layout)
        self.asset, self.segments, self.phase = asset, [], None

    def pose_count(self):
        return sum(len(poses) for _, poses in self.segments)

    def add_segment(self, data):
        reader = Bytes(data)
        require(reader.take(4) == b"ECPM" and reader.u8() == 1, "no segment of version 1")
        require(reader.take(32) == self.asset, "another asset")
        ends = self.layout["band_ends"]
        require([reader.u8(), reader.u8()] == [self.layout["channels"], len(ends)], "another layout")
        require([reader.varint() for _ in ends] == ends, "another layout")
        count = reader.varint()
        total = self.pose_count() + count
        require(count > 0 and total <= 1024 and 4 * total * self.layout["rows"] * self.layout["channels"] <= 2**23, "size")
        writer = Receiver(self.layout)
        everything = 2 ** len(ends) - 1
        poses = []
        for number in range(count):
            payload = Bytes(reader.take(reader.varint()))
            if number == 0:
                writer.read_join(everything, payload)
            else:
                writer.older, writer.newer = writer.newer, writer.read_key(everything, payload, writer.newer, writer.older)
            require(not poses or writer.newer.step == poses[0].step, "a pose of another step")
            poses.append(writer.newer)
        reader.finish()
        self.segments.append((poses[0].step, [pose.values for pose in poses]))

    def has(self, phase):
        first = 0
        for _, poses in self.segments:
            if first <= phase // 8 < first + len(poses):
                return phase % 8 == 0 or phase // 8 + 1 < first + len(poses)
            first += len(poses)
        return False

    def recall(self, phase, step, where):
        first = 0
        for own_step, poses in self.segments:
            i, f, end = phase // 8 - first, phase % 8, len(poses) - 1
            if i <= end:
                break
            first += len(poses)
        before, start, to, after = (poses[min(max(i + n, 0), end)] for n in (-1, 0, 1, 2))
        weights = -f * (8 - f) ** 2, (3 * f - 40) * f * f + 1024, (32 - 3 * f) * f * f + 64 * f, -f * f * (8 - f)
        out = []
        for k in where:
            value = sum(w * pose[k] for w, pose in zip(weights, (before, start, to, after))) + 512 >> 10 if f else start[k]
            value = rescale(value, own_step, step) if abs(value) <= MAX_VALUE else None
            require(value is not None, "the memory leaves the range")
            out.append(value)
        return out

    def join(self, bands, data, recalled):
        payload = Bytes(data)
        if recalled:  # The phase lies behind the four bytes of the head.
            head = payload.take(4)
            phase = payload.varint()
            payload = Bytes(head + payload.take(len(data) - payload.at))
        require(not recalled or self.has(phase), "phase")
        self.read_join(bands, payload)
        self.phase = phase if recalled else None
        return self.newer

    def key(self, bands, data, recalled):
        payload = Bytes(data)
        phase = None
        if not recalled:
            key = self.read_key(bands, payload, self.newer, self.older)
        else:
            m, step = self.read_codec(payload, self.newer)
            require(m, "exact, and from a memory")
            code, last = payload.varint(), self.phase
            phase = (last or 0) + (code // 2 if code % 2 == 0 else -(code + 1) // 2)
            require(phase >= 0 and self.has(phase) and (last is None or self.has(last)), "phase")
            key = Key(self.layout, bands, step)
            for band, section in self.sections(bands, payload):
                where = band_range(self.layout, band)
                c1 = references(self.layout, self.newer, band, step)
                c2 = references(self.layout, self.older, band, step)
                e = self.recall(phase, step, where) if c1 else None
                e1 = self.recall(last, step, where) if c1 and last is not None else None
                if section.data[:1] == b"\xff":
                    section.u8()
                    read_exact(section, section.u8(), c1, where, key.values)
                    continue
                read_recalled(section, m, self.layout["channels"], c1, c2, e, e1, where, key.values)
        self.older, self.newer, self.phase = self.newer, key, phase
        return key


def rejects_damage(memory, act, data):
    """Whether nothing but `data` itself is taken."""
    for damaged in [data[:size] for size in range(len(data))] + [data + b"\0"]:
        probe = Memory(memory.layout, memory.asset)
        probe.__dict__.update(memory.__dict__, segments=list(memory.segments))
        try:
            act(probe, damaged)
        except ProtocolError:
            continue
        return False
    return True


def check(path):
    with open(path, encoding="utf-8") as file:
        head, *lines = [json.loads(line) for line in file]
    memory = Memory(head["format"], bytes.fromhex(head["asset"]))
    same = safe = True
    for line in lines:
        kind, data = next((kind, bytes.fromhex(line[kind])) for kind in ("segment", "join", "key") if kind in line)
        if kind == "segment":
            safe = safe and rejects_damage(memory, lambda probe, damaged: probe.add_segment(damaged), data)
            memory.add_segment(data)
            same = same and memory.segments[-1] == (line["step"], line["poses"])
            continue
        act = getattr(Memory, kind)
        safe = safe and rejects_damage(memory, lambda probe, bad: act(probe, line["bands"], bad, "phase" in line), data)
        got = act(memory, line["bands"], data, "phase" in line)
        same = same and (got.step, got.values, memory.phase) == (line["step"], line["values"], line.get("phase"))
    print(f"{len(lines)} lines, {'as expected' if same else 'DIFFERENT'}, damage {'rejected' if safe else 'TAKEN'}")
    return 0 if same and safe else 1


if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[1] != "--check":
        sys.exit(__doc__)
    sys.exit(check(sys.argv[2]))
