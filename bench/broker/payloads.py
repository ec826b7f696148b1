# SPDX-License-Identifier: MIT
"""Frames and control messages that a sender would send (docs/protocol.md), for driving a broker without the SDK."""
import hashlib
import json
import struct

ENVELOPE = "<BBBIIQQ"
KEY, JOIN = 1, 2


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def announce(asset, rows, codec, bands=None, rate=30):
    return json.dumps({"op": "announce", "asset": asset, "key_rate_hz": rate,
                       "format": {"rows": rows, "channels": 3, "band_ends": bands or [rows], "codec": codec}})


def asset():
    """Some bytes, and the name that the broker knows them by."""
    body = b"any bytes will do: the broker moves them, and knows no geometry"
    return body, hashlib.sha256(body).hexdigest()


def float_join(size):
    """A valid join frame of `size` bytes of one band of float32: returns it and its rows."""
    rows = (size - 27 - 5 - 2) // 12
    run = b"".join(struct.pack("<f", (i * 37 % 101) / 101) for i in range(rows * 3))
    head = 27 + 4 + len(varint(len(run))) + len(run)
    age = size - head  # A varint of as many bytes as are left over.
    if not 1 <= age <= 8:
        raise ValueError(f"no join frame of {size} bytes")
    age_us = 0 if age == 1 else 1 << (7 * (age - 1))
    payload = bytes([1, 0, 0, 0]) + varint(age_us) + varint(len(run)) + run
    frame = struct.pack(ENVELOPE, JOIN, 1, 0, 0, 0, 0, 0) + payload
    assert len(frame) == size
    return frame, rows


def float_frame(kind, sequence, capture_us, values_of_band):
    """One section of float32 for each band."""
    runs = [struct.pack(f"<{len(values)}f", *values) for values in values_of_band]
    head = bytes([1, 0]) + (bytes([0, 0]) + varint(0) if kind == JOIN else b"")
    sections = b"".join(varint(len(run)) + run for run in runs)
    return struct.pack(ENVELOPE, kind, (1 << len(runs)) - 1, 0, 0, 0, sequence, capture_us) + head + sections
