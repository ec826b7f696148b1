# SPDX-License-Identifier: MIT
"""Reads a recording as docs/recording-format.md describes it, and says what is wrong with it."""
import json
import struct

import poses

MAGIC = b"ECRECOR\n"
START, ANNOUNCE, FRAME, CHECKPOINT, OBJECT, INDEX, END, GAP = range(1, 9)
HEAD = struct.Struct("<IBQI")


def crc_table():
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


TABLE = crc_table()


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ TABLE[crc & 0xFF ^ byte]
    return crc ^ 0xFFFFFFFF


def records_of(data):
    """(offset, type, time, body) of each whole record in order; then the offset at which they end."""
    at, last = 12, 0
    while at + HEAD.size <= len(data):
        length, kind, time, crc = HEAD.unpack_from(data, at)
        body = data[at + HEAD.size: at + HEAD.size + length]
        if len(body) < length or time < last or crc32c(data[at: at + 13] + body) != crc:
            break
        yield at, kind, time, body
        last = time
        at += HEAD.size + length
    yield at, None, last, b""


def read(data, channels_of):
    """stream, whole (it has its end), tags (for each announcement the set of (stream, announcement) that its poses carry), frames, why (what
    is wrong, or ""). `channels_of`: of a stream's name, as poses.tag_of() takes them."""
    result = {"stream": "", "whole": False, "tags": [], "frames": 0, "why": ""}

    def wrong(why):
        result["why"] = why
        return result
    if data[:8] != MAGIC or data[8:12] != b"\2\0\0\0":
        return wrong(f"{len(data)} bytes that do not begin as a recording")
    records = list(records_of(data))
    end_of_records = records.pop()[0]
    if not records or records[0][1] != START:
        return wrong("no start record")
    start = records[0][3]
    result["stream"] = start[9: 9 + start[8]].decode()
    newest, announced, checkpoints, indexed = None, None, set(), None
    for at, kind, _, body in records[1:]:
        if kind == ANNOUNCE:
            announced, newest, chain = json.loads(body), None, poses.Chain()
            result["tags"].append(set())
        elif kind in (FRAME, CHECKPOINT):
            if announced is None:
                return wrong(f"byte {at}: a frame without an announcement")
            head = chain.read(body)
            if head is None:
                return wrong(f"byte {at}: a key that does not follow {newest}")
            if kind == CHECKPOINT and head.kind != poses.JOIN:
                return wrong(f"byte {at}: a checkpoint that is no join")
            if newest is not None and head.sequence < newest + (kind == FRAME):
                return wrong(f"byte {at}: frame {head.sequence} after {newest}")
            newest = head.sequence
            result["frames"] += kind == FRAME
            if kind == CHECKPOINT:
                checkpoints.add(at)
            tag = poses.tag_of(head.kind, head.bands, body[head.size:], channels_of(result["stream"]))
            if tag:
                result["tags"][-1].add(tag[:2])
        elif kind == INDEX:
            indexed = at
        elif kind == END:
            last_index, frames, _ = struct.unpack("<QQQ", body)
            result["whole"] = end_of_records == len(data) and at == records[-1][0] and last_index == (indexed or 0)
            if frames != result["frames"]:
                return wrong(f"its end counts {frames} frames of {result['frames']}")
    if result["whole"] and not indexed_checkpoints(data, indexed) <= checkpoints:
        return wrong("its index names what is no checkpoint")
    return result


def indexed_checkpoints(data, at):
    found = set()
    while at:
        length, = struct.unpack_from("<I", data, at)
        body = data[at + HEAD.size: at + HEAD.size + length]
        found |= {checkpoint for _, checkpoint, _ in struct.iter_unpack("<QQQ", body[8:])}
        at = min(struct.unpack_from("<Q", body)[0], at - 1 if at > 1 else 0)
    return found
