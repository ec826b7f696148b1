# SPDX-License-Identifier: MIT
"""Frames whose poses carry a tag: float32 coefficients, of which the first row is the number of the stream, that of the announcement, and
the sequence of the pose."""
import pathlib
import struct
import sys

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2] / "bench/broker"))  # Behind history.py of here.
from payloads import ESTIMATE, JOIN, KEY, STEP, Chain, varint, varint_at

ROWS, BAND_ENDS = 4, [1, 4]


def tag_of(kind, bands, payload, channels):
    """(stream, announcement, position), or None. `channels` of a stream whose poses carry tags; 0: of another."""
    if not channels or not bands & 1 or not payload:
        return None
    at, skipped = 2, 0
    if kind == JOIN:
        skipped = 4 * channels * (payload[at + 1] & 1)  # The older key's run comes first.
        at += 2
    at = varint_at(payload, at)[1] + skipped
    stream, announcement, position = struct.unpack_from("<3f", payload, at)
    return round(stream, 3), round(announcement, 3), position


def payload(kind, stream, announcement, sequence, rate, velocities, older=None):
    """Of a key, or of a join, whose older key is that of the sequence `older`, or equal."""
    row_of = lambda of: [float(stream), float(announcement), float(of)] + ([0.0, 0.0, float(rate)] if velocities else [])
    still = [0.5] * len(row_of(0))
    keys = ([sequence if older is None else older] if kind == JOIN else []) + [sequence]
    sections = b""
    for rows_of in (lambda of: [row_of(of)], lambda _: [still] * 3):
        run = b"".join(struct.pack(f"<{len(r)}f", *r) for of in keys for r in rows_of(of))
        sections += varint(len(run)) + run
    return bytes([1, 0]) + (bytes([0, 3]) if kind == JOIN else b"") + sections


def form(velocities):
    """The `format` of an announcement."""
    return {"rows": ROWS, "channels": 6 if velocities else 3, "band_ends": BAND_ENDS, "codec": "float32",
            **({"velocity_channels": 3} if velocities else {})}
