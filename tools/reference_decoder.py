#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A second decoder of Eigencast frames, written from docs/protocol.md alone: plain, slow, standard library only.

    reference_decoder.py FILE.frames       decodes hexadecimal frames (tests/golden/README.md) to one line of JSON each
    reference_decoder.py --check FOLDER    decodes every *.frames of a folder, compares with the *.jsonl beside it,
                                           and makes sure that no truncation or extension of a frame is taken
"""

import copy
import json
import pathlib
import struct
import sys

from reference_bits import Bits, Bytes, ProtocolError, RangeDecoder, more, require

MAX_VALUE = 2**30
MAX_TIME = 2**62 - 1
KINDS = {1: "key", 2: "join", 3: "step", 4: "estimate"}
CODECS = {"float64": 0, "float32": 1, "quantised": 2}
NEXT_STATE = [(0, 2), (2, 0), (1, 3), (3, 1)]
FOURTH_ROOTS = [1073741824, 1276901417, 1518500250, 1805811301]


def rescale(q, a, b):
    """None when the result is out of range."""
    e, f = divmod(a - b, 4)
    s = 30 - e
    if a == b or q == 0:
        return q
    if s > 61:
        return 0
    if s < 0:
        return None
    product = abs(q) * FOURTH_ROOTS[f]
    magnitude = product if s == 0 else (product + 2 ** (s - 1)) >> s
    if magnitude > MAX_VALUE:
        return None
    return magnitude if q > 0 else -magnitude


class Key:
    def __init__(self, layout, bands, step):
        self.bands, self.step = bands, step
        self.values = [0] * (layout["rows"] * layout["channels"])

    def json(self):
        # JSON has one kind of number: absent values of float codecs are 0, not 0.0.
        return {"bands": self.bands, "step": self.step, "values": self.values}


def band_range(layout, band):
    ends = [0] + layout["band_ends"]
    return range(ends[band] * layout["channels"], ends[band + 1] * layout["channels"])


def references(layout, key, band, step):
    """The band's values of a key at another step, or None where it has none."""
    if key is None or not key.bands >> band & 1:
        return None
    values = [rescale(key.values[i], key.step, step) for i in band_range(layout, band)]
    return None if None in values else values


def read_exact(section, head, c1, where, values):
    require(head >> 6 == 2, "reserved bits")
    require(not head & 32 or c1 is not None, "exact run without the newer key")
    parameter = head & 31
    bits = Bits(section.data[section.at :])
    for n, i in enumerate(where):
        value = c1[n] if head & 32 else 0
        if parameter != 31:
            q = 0
            while q < 24 and bits.take(1) == "1":
                q += 1
            if q < 24:
                z = (q << parameter) + bits.number(parameter)
                value += -(z + 1) // 2 if z & 1 else z // 2
            else:
                value = bits.number(32)
                value -= 2**32 if value >= 2**31 else 0
        require(abs(value) <= MAX_VALUE, "value out of range")
        values[i] = value
    padding = bits.take(-bits.at % 8)
    require("1" not in padding, "padding set")
    section.take(bits.at // 8)


def logarithm(x):
    whole = x.bit_length() - 1
    return 8 * whole + (x >> whole - 3) % 8


def magnitude_of(scale, m):
    return (2 * m * (23 if scale % 2 else 16) << scale // 2) >> 9


def expected_scale(speeds, m):
    scale = 0
    while scale < 30 and 27 * len(speeds) * magnitude_of(scale + 1, m) <= 32 * sum(speeds):
        scale += 1
    return scale


class Contexts:
    """Foretells magnitudes."""

    def __init__(self, m, channels, scale, speeds):
        self.m, self.channels, self.speeds = m, channels, speeds
        self.scale = magnitude_of(scale, m)
        self.recent = [16 * self.scale] * channels

    def next(self, n):
        total = 16 * (self.scale + self.speeds[n]) + 3 * self.recent[n % self.channels] + (self.m >> 1) + 8
        return min(max(logarithm(total) - logarithm(128 * self.m) + 96, 0), 159)

    def add(self, n, magnitude):
        self.recent[n % self.channels] += (16 * magnitude - self.recent[n % self.channels]) >> 3


def read_levels(coder, contexts, m, values, where, predicted):
    """The levels of a coarse run: values[where[n]] is what is predicted for n, and what a level leaves of it."""
    state = 0
    for n, i in enumerate(where):
        value = predicted(n)
        context, rule = contexts.next(n), state >> 1
        level = coder.level(more(context - (0 if rule else 12)), more(context - (19 if rule else 20)), more(context - 18))
        residual = m * (2 * level - rule) if level else 0
        if level:
            value += -residual if coder.decision() else residual
        contexts.add(n, residual)
        state = NEXT_STATE[state][level % 2]
        require(abs(value) <= MAX_VALUE, "value out of range")
        values[i] = value
    coder.finish()


def read_coarse(section, m, channels, c1, c2, where, values):
    require(c1 is not None, "coarse run without the newer key")
    c2 = c2 or c1
    speeds = [abs(a - b) for a, b in zip(c1, c2)]
    coder = RangeDecoder(section.take(len(section.data) - section.at))
    scale = coder.scale(expected_scale(speeds, m))
    require(0 <= scale <= 30, "scale")
    speed, restoring = coder.number(4), 12
    if coder.decision():
        restoring = coder.number(4)
    contexts = Contexts(m, channels, scale, speeds)
    read_levels(coder, contexts, m, values, where,
                lambda n: c1[n] + ((2 * (speed - 4) * (c1[n] - c2[n]) + (restoring - 12) * c1[n] + 8) >> 4))


def read_quantised(layout, section, m, c1, c2, where, values):
    if m and section.data[section.at : section.at + 1] != b"\xff":
        read_coarse(section, m, layout["channels"], c1, c2, where, values)
    else:
        if m:
            section.u8()
        read_exact(section, section.u8(), c1, where, values)


def read_floats(section, code, where, values):
    size = struct.calcsize(code)
    for i in where:
        values[i] = struct.unpack(code, section.take(size))[0]
        require(abs(values[i]) != float("inf") and values[i] == values[i], "not finite")


def read_run(layout, section, m, c1, c2, band, values):
    where = band_range(layout, band)
    if layout["codec"] == "quantised":
        read_quantised(layout, section, m, c1, c2, where, values)
    else:
        read_floats(section, "<d" if layout["codec"] == "float64" else "<f", where, values)


def interpolate(layout, a, b, at, of):
    pose = Key(layout, a.bands & b.bands, b.step)
    for band in range(len(layout["band_ends"])):
        if not pose.bands >> band & 1:
            continue
        for i in band_range(layout, band):
            if layout["codec"] != "quantised":
                pose.values[i] = b.values[i] if at == of else a.values[i] + (b.values[i] - a.values[i]) * at / of
                continue
            start = rescale(a.values[i], a.step, b.step)
            require(start is not None, "interpolation leaves the range")
            d = b.values[i] - start
            magnitude = (2 * abs(d) * at + of) // (2 * of)
            pose.values[i] = start + (magnitude if d >= 0 else -magnitude)
    return pose


def round_quotient(n, d):
    magnitude = (2 * abs(n) + d) // (2 * d)
    return magnitude if n >= 0 else -magnitude


def hermite(layout, a, b, age, at, of):
    pose = interpolate(layout, a, b, at, of)
    count, channels = layout.get("velocity_channels", 0), layout["channels"]
    if count == 0 or at == of or not 0 < age <= 1000000:
        return pose
    unit = layout.get("velocity_us", 1000000)
    share, slope0, slope1 = at * at * (3 * of - 2 * at), at * (of - at) ** 2, -at * at * (of - at)
    for band in range(len(layout["band_ends"])):
        if not pose.bands >> band & 1:
            continue
        for i in band_range(layout, band):
            if i % channels >= count:
                continue
            v = i + channels - count
            if layout["codec"] != "quantised":
                slopes = a.values[v] * slope0 + b.values[v] * slope1
                moved = (b.values[i] - a.values[i]) * share / of**3
                pose.values[i] = a.values[i] + moved + slopes * age / unit / of**3
                continue
            p, w = rescale(a.values[i], a.step, b.step), rescale(a.values[v], a.step, b.step)
            require(p is not None and w is not None, "interpolation leaves the range")
            bent = round_quotient((w * slope0 + b.values[v] * slope1) * age, unit)
            require(abs(bent) <= 2**50, "interpolation leaves the range")
            pose.values[i] = p + round_quotient((b.values[i] - p) * share + bent, of**3)
            require(abs(pose.values[i]) <= MAX_VALUE, "interpolation leaves the range")
    return pose


def estimate(layout, a, b, damped, at, of):
    weight, whole = 65536 * at, 65536 * of
    if damped:
        moved, interval = 0, 55296
        while at >= of:
            moved, interval, at = moved + interval * of, (27 * interval + 16) // 32, at - of
        weight = moved + interval * at
    pose = Key(layout, b.bands, b.step)
    pose.values = list(b.values)
    for band in range(len(layout["band_ends"])):
        if not (a.bands & b.bands) >> band & 1:
            continue
        for i in band_range(layout, band):
            if layout["codec"] != "quantised":
                pose.values[i] = b.values[i] + weight / whole * (b.values[i] - a.values[i])
                continue
            start = rescale(a.values[i], a.step, b.step)
            require(start is not None, "estimation leaves the range")
            pose.values[i] = b.values[i] + round_quotient((b.values[i] - start) * weight, whole)
            require(abs(pose.values[i]) <= MAX_VALUE, "estimation leaves the range")
    return pose


class Receiver:
    """The state of section 5. decode() gives a dictionary, or None for a frame that has to wait for a join."""

    def __init__(self, layout):
        self.layout = layout
        self.older = self.newer = self.number = self.age = self.capture = None

    def decode(self, frame):
        require(len(frame) <= 2**20, "size of the frame")
        reader = Bytes(frame)
        first = reader.u8()
        kind, flags = first & 7, first >> 3
        require(kind in KINDS, "kind")
        name = KINDS[kind]
        is_key = name in ("key", "join")
        require(flags & ~(5 if is_key else 2 if name == "step" else 0) == 0, "flags")
        stream_id, tag = reader.varint(), reader.u8()
        require(stream_id < 2**32, "stream id")
        check = None if name == "join" else reader.u8()
        step = 0 if is_key and not flags & 1 else reader.u8()
        at, of = step >> 4, step & 15
        between = at >= 1 and of >= 1 and (at < of or at == of and not is_key or name == "estimate")
        require(between or is_key and not step, "step")
        has_bands = is_key or flags == 2
        bands = reader.u8() if has_bands else 0
        require(bands < 2 ** len(self.layout["band_ends"]), "unknown bands")
        if name == "join":
            sequence, capture, age = reader.varint(), reader.varint(), reader.varint()
            require(age <= capture <= MAX_TIME, "capture time or age")
        code = reader.varint() if name == "key" else 0
        delay = code // 2 if code % 2 == 0 else -(code + 1) // 2
        require(abs(delay) <= MAX_TIME, "capture time")
        payload = Bytes(reader.data[reader.at :])
        require(has_bands == (bands != 0) == (len(payload.data) > 0), "bands or payload")

        if name != "join":
            resolved = self.resolved(name, check, at, of, delay)
            if resolved is None:
                self.number = None if name == "key" else self.number
                return None
            sequence, capture = resolved
        out = {"kind": name, "flags": flags if is_key else 0, "bands": bands, "at": at, "of": of, "stream_id": stream_id, "tag": tag}
        out.update(sequence=sequence, capture_us=capture)
        if name == "join":
            self.join(bands, payload.data, flags >= 4)
            self.number, self.capture, self.age = sequence, capture, age
            out.update(age_us=age, older=self.older.json(), newer=self.newer.json())
        elif name == "key":
            out["pose"] = self.key(bands, payload.data, flags >= 4).json()
            self.number, self.age, self.capture = sequence, capture - self.capture, capture
        elif name == "step":
            pose = self.interpolated(at, of)
            if bands:
                require(bands & ~pose.bands == 0, "residual of a band that the pose lacks")
                residual = self.read_key(bands, payload, pose, None)
                require(residual.step == pose.step, "step of a residual")
                for band in range(len(self.layout["band_ends"])):
                    if bands >> band & 1:
                        for i in band_range(self.layout, band):
                            pose.values[i] = residual.values[i]
            out["pose"] = pose.json()
        else:
            damped = self.layout.get("scheme") == "damped"
            out["pose"] = estimate(self.layout, self.older, self.newer, damped, at, of).json()
        if is_key and at:
            out["shown"] = self.interpolated(at, of).json()
        return out

    def join(self, bands, data, recalled):
        require(not recalled, "no memory")
        self.read_join(bands, Bytes(data))

    def key(self, bands, data, recalled):
        require(not recalled, "no memory")
        self.older, self.newer = self.newer, self.read_key(bands, Bytes(data), self.newer, self.older)
        return self.newer

    def interpolated(self, at, of):
        if self.layout.get("scheme") == "hermite":
            return hermite(self.layout, self.older, self.newer, self.age, at, of)
        return interpolate(self.layout, self.older, self.newer, at, of)

    def resolved(self, name, check, at, of, delay):
        """Sequence and capture time of a frame that follows the newest key, else None."""
        if self.number is None:
            return None
        sequence = self.number + (name == "key")
        part = self.age if name == "key" else self.age * at // of
        capture = self.capture + part + delay - (self.age if name == "step" else 0)
        in_range = 0 <= capture <= MAX_TIME and (name != "key" or capture > self.capture)
        return (sequence, capture) if sequence % 256 == check and sequence < 2**64 and in_range else None

    def read_codec(self, payload, newer=None):
        """m and step; `newer` is the key whose step holds where none is said."""
        first = payload.u8()
        if first & 3 == 3 and newer and self.layout["codec"] == "quantised":
            return first >> 2, newer.step
        require(first & 3 == CODECS[self.layout["codec"]], "codec")
        return first >> 2, self.read_step(payload)

    def read_step(self, payload):
        step = payload.u8()
        require(self.layout["codec"] == "quantised" or step == 0, "step of a float codec")
        return step

    def sections(self, bands, payload):
        for band in range(len(self.layout["band_ends"])):
            if bands >> band & 1:
                section = Bytes(payload.take(payload.varint()))
                yield band, section
                section.finish()
        payload.finish()

    def read_key(self, bands, payload, newer, older):
        m, step = self.read_codec(payload, newer)
        require(not m or self.layout["codec"] == "quantised", "spacing of a float codec")
        key = Key(self.layout, bands, step)
        for band, section in self.sections(bands, payload):
            c1 = c2 = None
            if self.layout["codec"] == "quantised":
                c1 = references(self.layout, newer, band, key.step)
                c2 = references(self.layout, older, band, key.step)
            read_run(self.layout, section, m, c1, c2, band, key.values)
        return key

    def read_join(self, bands, payload):
        m, step = self.read_codec(payload)
        require(not m, "spacing of a join")
        older_step = self.read_step(payload)
        older_bands = payload.u8()
        require(older_bands & ~bands == 0, "older bands")
        older, newer = Key(self.layout, older_bands, older_step), Key(self.layout, bands, step)
        for band, section in self.sections(bands, payload):
            c = None
            if older_bands >> band & 1:
                read_run(self.layout, section, 0, None, None, band, older.values)
                if self.layout["codec"] == "quantised":
                    c = references(self.layout, older, band, step)
            read_run(self.layout, section, 0, c, None, band, newer.values)
        self.older, self.newer = older, newer


def frames_of(path):
    lines = pathlib.Path(path).read_text().splitlines()
    require(lines and lines[0].startswith("format "), "the first line names the format")
    return json.loads(lines[0][7:]), [bytes.fromhex(line) for line in lines[1:]]


def receiver_of(layout):
    if "memory" not in layout:
        return Receiver(layout)
    from reference_memory import Memory

    receiver = Memory(layout, bytes.fromhex(layout["memory"]["asset"]))
    for segment in layout["memory"]["segments"]:
        receiver.add_segment(bytes.fromhex(segment))
    return receiver


def decoded_lines(path):
    layout, frames = frames_of(path)
    receiver = receiver_of(layout)
    return [json.dumps(receiver.decode(frame), separators=(",", ":")) for frame in frames]


def damaged_are_rejected(path):
    layout, frames = frames_of(path)
    receiver = receiver_of(layout)
    for frame in frames:
        for damaged in [frame[:size] for size in range(len(frame))] + [frame + b"\0"]:
            probe = copy.copy(receiver)
            try:
                probe.decode(damaged)
            except ProtocolError:
                continue
            return False
        receiver.decode(frame)
    return True


def check(folder):
    paths = sorted(pathlib.Path(folder).glob("*.frames"))
    failures = 0
    for path in paths:
        expected = path.with_suffix(".jsonl").read_text().splitlines()
        same = decoded_lines(path) == expected
        safe = damaged_are_rejected(path)
        print(f"{path.name}: {len(expected)} frames, {'as expected' if same else 'DIFFERENT'}, damage {'rejected' if safe else 'TAKEN'}")
        failures += not (same and safe)
    if not paths:
        print(f"no *.frames in {folder}")
    return 1 if failures or not paths else 0


def main(arguments):
    if len(arguments) == 2 and arguments[0] == "--check":
        return check(arguments[1])
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    print("\n".join(decoded_lines(arguments[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
