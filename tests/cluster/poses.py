# SPDX-License-Identifier: MIT
"""Frames whose poses carry a tag: float32 coefficients, of which the first row is the number of the stream, that of the announcement, and
the sequence of the pose."""
import pathlib
import struct
import sys
import typing

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "bench/broker"))
from payloads import varint

KEY, JOIN, SYNTHETIC, STEP, ESTIMATE = 1, 2, 3, 4, 5
ENVELOPE = struct.Struct("<BBBIIQQ")
ROWS, BAND_ENDS = 4, [1, 4]


class Pose(typing.NamedTuple):
    kind: int
    ahead: bool
    at: int
    of: int
    id: int
    epoch: int
    sequence: int
    capture: int
    tag: tuple  # (stream, announcement, position), or None


def after_varint(data, at):
    while data[at] & 0x80:
        at += 1
    return at + 1


def parse(message, channels):
    """`channels` of a stream whose poses carry tags; 0: of another."""
    first, bands, step, of_stream, epoch, sequence, capture = ENVELOPE.unpack_from(message)
    kind = first & 7
    tag = None
    if channels and bands & 1 and len(message) > ENVELOPE.size:
        at = ENVELOPE.size + 2
        skipped = 0
        if kind == JOIN:
            skipped = 4 * channels * (message[at + 1] & 1)  # The older key's run comes first.
            at = after_varint(message, at + 2)
        at = after_varint(message, at) + skipped
        stream, announcement, position = struct.unpack_from("<3f", message, at)
        tag = (round(stream, 3), round(announcement, 3), position)
    return Pose(kind, bool(first & 8), step >> 4, step & 15, of_stream, epoch, sequence, capture, tag)


def frame(kind, stream, announcement, sequence, capture, rate, velocities):
    """A key, or a join of two equal ones."""
    row = [float(stream), float(announcement), float(sequence)] + ([0.0, 0.0, float(rate)] if velocities else [])
    still = [0.5] * len(row)
    sections = b""
    for rows in ([row], [still] * 3):
        run = b"".join(struct.pack(f"<{len(r)}f", *r) for r in rows)
        run *= 2 if kind == JOIN else 1
        sections += varint(len(run)) + run
    head = bytes([1, 0]) + (bytes([0, 3]) + varint(0) if kind == JOIN else b"")
    return ENVELOPE.pack(kind, 3, 0, 0, 0, sequence, capture) + head + sections


def form(velocities):
    """The `format` of an announcement."""
    return {"rows": ROWS, "channels": 6 if velocities else 3, "band_ends": BAND_ENDS, "codec": "float32",
            **({"velocity_channels": 3} if velocities else {})}
