#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""A second decoder of Eigencast frames, written from docs/protocol.md alone: plain, slow, standard library only.

    reference_decoder.py FILE.frames       decodes hexadecimal frames (tests/golden/README.md) to one line of JSON each
    reference_decoder.py --check FOLDER    decodes every *.frames of a folder, compares with the *.jsonl beside it,
                                           and makes sure that no truncation or extension of a frame is taken
"""

import json
import pathlib
import struct
import sys

MAX_VALUE = 2**30
MAX_TIME = 2**62 - 1
KINDS = {1: "key", 2: "join", 3: "synthetic", 4: "step"}
CODECS = {"float64": 0, "float32": 1, "quantised": 2}
WEIGHTS = [None, 0, 2, 3, 4, 5, 6, 8]
FOURTH_ROOTS = [1073741824, 1276901417, 1518500250, 1805811301]


class ProtocolError(Exception):
    pass


def require(condition, what):
    if not condition:
        raise ProtocolError(what)


class Bytes:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        require(count <= len(self.data) - self.at, "ends early")
        self.at += count
        return self.data[self.at - count : self.at]

    def u8(self):
        return self.take(1)[0]

    def varint(self):
        value = shift = 0
        while True:
            byte = self.u8()
            value |= (byte & 127) << shift
            require(value < 2**64, "varint over 64 bits")
            if byte < 128:
                require(byte or not shift, "superfluous varint byte")
                return value
            shift += 7

    def finish(self):
        require(self.at == len(self.data), "bytes left over")


class Bits:
    def __init__(self, data):
        self.text = "".join(f"{byte:08b}" for byte in data)
        self.at = 0

    def take(self, count):
        require(count <= len(self.text) - self.at, "bits end early")
        self.at += count
        return self.text[self.at - count : self.at]

    def number(self, count):
        return int(self.take(count), 2) if count else 0


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


def predictions(p, c1, c2, count):
    if p == 0:
        return [0] * count
    require(c1 is not None, "predictor without the newer key")
    if p == 1:
        return c1
    require(c2 is not None, "predictor without the older key")
    return [a + ((WEIGHTS[p] * (a - b) + 4) >> 3) for a, b in zip(c1, c2)]


def read_quantised(section, c1, c2, where, values):
    head = section.u8()
    parameter, predictor = head & 31, head >> 5
    predicted = predictions(predictor, c1, c2, len(where))
    bits = Bits(section.data[section.at :])
    for i, pred in zip(where, predicted):
        value = pred
        if parameter != 31:
            q = 0
            while q < 24 and bits.take(1) == "1":
                q += 1
            if q < 24:
                z = (q << parameter) + bits.number(parameter)
                value = pred + (-(z + 1) // 2 if z & 1 else z // 2)
            else:
                value = bits.number(32)
                value -= 2**32 if value >= 2**31 else 0
        require(abs(value) <= MAX_VALUE, "value out of range")
        values[i] = value
    padding = bits.take(-bits.at % 8)
    require("1" not in padding, "padding set")
    section.take(bits.at // 8)


def read_floats(section, code, where, values):
    size = struct.calcsize(code)
    for i in where:
        values[i] = struct.unpack(code, section.take(size))[0]
        require(abs(values[i]) != float("inf") and values[i] == values[i], "not finite")


def read_run(layout, section, c1, c2, band, values):
    where = band_range(layout, band)
    if layout["codec"] == "quantised":
        read_quantised(section, c1, c2, where, values)
    else:
        read_floats(section, "<d" if layout["codec"] == "float64" else "<f", where, values)


def interpolate(layout, a, b, at, of):
    pose = Key(layout, a.bands & b.bands, b.step)
    for band in range(len(layout["band_ends"])):
        if not pose.bands >> band & 1:
            continue
        for i in band_range(layout, band):
            if layout["codec"] != "quantised":
                pose.values[i] = a.values[i] + (b.values[i] - a.values[i]) * at / of
                continue
            start = rescale(a.values[i], a.step, b.step)
            require(start is not None, "interpolation leaves the range")
            d = b.values[i] - start
            magnitude = (2 * abs(d) * at + of) // (2 * of)
            pose.values[i] = start + (magnitude if d >= 0 else -magnitude)
    return pose


class Receiver:
    """The state of section 5. decode() gives a dictionary, or None for a frame that has to wait for a join."""

    def __init__(self, layout):
        self.layout = layout
        self.older = self.newer = self.number = None

    def decode(self, frame):
        require(28 <= len(frame) <= 2**20, "size of the frame")
        kind, flags, bands, step, stream_id, epoch, sequence, capture = struct.unpack("<BBBBIIQQ", frame[:28])
        at, of = step >> 4, step & 15
        payload = Bytes(frame[28:])
        require(kind in KINDS, "kind")
        require(flags & ~(1 if kind in (1, 2) else 0) == 0, "flags")
        require(step == 0 if kind in (1, 2) else 1 <= at <= of, "step")
        require((bands == 0) == (kind == 4) and (len(payload.data) == 0) == (kind == 4), "bands or payload")
        require(bands < 2 ** len(self.layout["band_ends"]), "unknown bands")
        require(capture <= MAX_TIME, "capture time")
        out = {"kind": KINDS[kind], "flags": flags, "bands": bands, "at": at, "of": of, "stream_id": stream_id, "epoch": epoch}
        out.update(sequence=sequence, capture_us=capture)

        if kind == 2:
            age = self.read_join(bands, payload)
            self.number = sequence
            out.update(age_us=age, older=self.older.json(), newer=self.newer.json())
            return out
        if kind == 4:
            if self.number != sequence:
                return None
            out["pose"] = interpolate(self.layout, self.older, self.newer, at, of).json()
            return out
        if self.number != sequence - 1:
            return None
        pose = self.read_key(bands, payload)
        if kind == 1:
            self.older, self.newer, self.number = self.newer, pose, sequence
        out["pose"] = pose.json()
        return out

    def read_codec(self, payload):
        require(payload.u8() == CODECS[self.layout["codec"]], "codec")
        return self.read_step(payload)

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

    def read_key(self, bands, payload):
        key = Key(self.layout, bands, self.read_codec(payload))
        for band, section in self.sections(bands, payload):
            c1 = c2 = None
            if self.layout["codec"] == "quantised":
                c1 = references(self.layout, self.newer, band, key.step)
                c2 = references(self.layout, self.older, band, key.step)
            read_run(self.layout, section, c1, c2, band, key.values)
        return key

    def read_join(self, bands, payload):
        step = self.read_codec(payload)
        older_step = self.read_step(payload)
        older_bands = payload.u8()
        age = payload.varint()
        require(older_bands & ~bands == 0, "older bands")
        require(age <= MAX_TIME, "age")
        older, newer = Key(self.layout, older_bands, older_step), Key(self.layout, bands, step)
        for band, section in self.sections(bands, payload):
            c = None
            if older_bands >> band & 1:
                read_run(self.layout, section, None, None, band, older.values)
                if self.layout["codec"] == "quantised":
                    c = references(self.layout, older, band, step)
            read_run(self.layout, section, c, c, band, newer.values)
        self.older, self.newer = older, newer
        return age


def frames_of(path):
    lines = pathlib.Path(path).read_text().splitlines()
    require(lines and lines[0].startswith("format "), "the first line names the format")
    return json.loads(lines[0][7:]), [bytes.fromhex(line) for line in lines[1:]]


def decoded_lines(path):
    layout, frames = frames_of(path)
    receiver = Receiver(layout)
    return [json.dumps(receiver.decode(frame), separators=(",", ":")) for frame in frames]


def damaged_are_rejected(path):
    layout, frames = frames_of(path)
    receiver = Receiver(layout)
    for frame in frames:
        for damaged in [frame[:size] for size in range(len(frame))] + [frame + b"\0"]:
            probe = Receiver(layout)
            probe.older, probe.newer, probe.number = receiver.older, receiver.newer, receiver.number
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
