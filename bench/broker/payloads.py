# SPDX-License-Identifier: MIT
"""Frames and control messages that a sender would send (docs/protocol.md), for driving a broker without the SDK."""
import hashlib
import json
import struct

import typing

KEY, JOIN, STEP, ESTIMATE = 1, 2, 3, 4
FIRST_TAG = 1  # Of a fresh broker's first epoch of a stream.
WIDE = 1 << 56  # Numbers from here to twice that are varints of nine bytes.


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def varint_at(data, at):
    """A varint, and where it ends."""
    value = shift = 0
    while data[at] & 0x80:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
    return value | data[at] << shift, at + 1


class Head(typing.NamedTuple):
    """An envelope in full."""
    kind: int
    ahead: bool
    at: int
    of: int
    bands: int
    stream_id: int
    tag: int
    sequence: int
    capture_us: int
    shown_us: int  # When the pose holds that it shows; keys sent ahead show one that leads up to them, or none (at is 0).
    size: int  # Where the payload begins.


class Chain:
    """The newest key of one stream at a sender or a viewer, from which the envelopes that follow are written and read."""

    def __init__(self):
        self.sequence, self.capture_us, self.age_us = None, 0, 0

    def write(self, kind, bands, sequence, capture_us, tag=FIRST_TAG, age_us=0):
        """Of a join, of two equal keys if `age_us` is 0, or of a key."""
        if kind == JOIN:
            head = bytes([kind, 0, tag, bands]) + varint(sequence) + varint(capture_us) + varint(age_us)
        else:
            delay = capture_us - self.capture_us - self.age_us
            head = bytes([kind, 0, tag, sequence & 255, bands]) + varint(2 * delay if delay >= 0 else -2 * delay - 1)
        self.note(kind, sequence, capture_us, age_us)
        return head

    def note(self, kind, sequence, capture_us, age_us):
        if kind in (KEY, JOIN):
            self.age_us = age_us if kind == JOIN else capture_us - self.capture_us
            self.sequence, self.capture_us = sequence, capture_us

    def read(self, message):
        """None: it does not follow the newest key."""
        kind, ahead, residual = message[0] & 7, message[0] & 8, message[0] & 16
        stream_id, at = varint_at(message, 1)
        tag, at = message[at], at + 1
        check, at = (None, at) if kind == JOIN else (message[at], at + 1)
        step, at = (message[at], at + 1) if kind > JOIN or ahead else (0, at)
        bands, at = (message[at], at + 1) if kind <= JOIN or residual else (0, at)
        age_us = 0
        if kind == JOIN:
            sequence, at = varint_at(message, at)
            capture_us, at = varint_at(message, at)
            age_us, at = varint_at(message, at)
        else:
            code, at = varint_at(message, at) if kind == KEY else (0, at)
            if self.sequence is None:
                return None
            sequence = self.sequence + (kind == KEY)
            if sequence & 255 != check:
                self.sequence = None if kind == KEY else self.sequence
                return None
            part = self.age_us if kind == KEY else self.age_us * (step >> 4) // (step & 15)
            delay = code // 2 if code % 2 == 0 else -(code + 1) // 2
            capture_us = self.capture_us + part + delay - (self.age_us if kind == STEP else 0)
        self.note(kind, sequence, capture_us, age_us)
        shown_us = capture_us - self.age_us + self.age_us * (step >> 4) // (step & 15) if ahead and step else capture_us
        return Head(kind, bool(ahead), step >> 4, step & 15, bands, stream_id, tag, sequence, capture_us, shown_us, at)


def announce(asset, rows, codec, bands=None, rate=30):
    return json.dumps({"op": "announce", "asset": asset, "key_rate_hz": rate,
                       "format": {"rows": rows, "channels": 3, "band_ends": bands or [rows], "codec": codec}})


def asset():
    """Some bytes, and the name that the broker knows them by."""
    body = b"any bytes will do: the broker moves them, and knows no geometry"
    return body, hashlib.sha256(body).hexdigest()


SEQUENCE_AT, TIME_AT = 4, 13  # In frames of float_join().


def float_join(size):
    """A valid join frame of `size` bytes of one band of float32, for stamped(): returns it and its rows."""
    rows = (size - 23 - 4 - 2) // 12
    run = b"".join(struct.pack("<f", (i * 37 % 101) / 101) for i in range(rows * 3))
    payload = bytes([1, 0, 0, 0]) + varint(len(run)) + run
    age = size - 22 - len(payload)  # A varint of as many bytes as are left over.
    if not 1 <= age <= 8:
        raise ValueError(f"no join frame of {size} bytes")
    age_us = 0 if age == 1 else 1 << (7 * (age - 1))
    frame = bytes([JOIN, 0, FIRST_TAG, 1]) + varint(WIDE) + varint(WIDE) + varint(age_us) + payload
    assert len(frame) == size
    return frame, rows


def stamped(join, sequence, capture_us, tag=FIRST_TAG):
    """A frame of float_join(); its numbers begin at WIDE, so that all have one size."""
    return join[:2] + bytes([tag, 1]) + varint(WIDE + sequence) + varint(WIDE + capture_us) + join[TIME_AT + 9:]


def float_frame(chain, kind, sequence, capture_us, values_of_band, tag=FIRST_TAG):
    """One section of float32 for each band."""
    runs = [struct.pack(f"<{len(values)}f", *values) for values in values_of_band]
    head = bytes([1, 0]) + (bytes([0, 0]) if kind == JOIN else b"")
    sections = b"".join(varint(len(run)) + run for run in runs)
    return chain.write(kind, (1 << len(runs)) - 1, sequence, capture_us, tag) + head + sections
