#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Reads an eigencast asset and prints it as JSON: a second reader, written from docs/asset-format.md alone.

    reference_asset_reader.py MANIFEST_FILE CHUNK_FILE...
    reference_asset_reader.py MANIFEST_FILE CHUNK_FILE... --expect JSON_FILE    (compares; fails on the first difference)

Standard library only; tiles compressed with zstd through the zstd program. It favours plainness over speed.
"""
import hashlib
import json
import math
import shutil
import struct
import subprocess
import sys


class Corrupt(Exception):
    """The bytes are not an asset of version 1."""


def need(condition, what):
    if not condition:
        raise Corrupt(what)


class Bytes:
    """Little-endian numbers one after the other."""

    def __init__(self, data):
        self.data = data
        self.at = 0

    def take(self, count):
        need(count <= len(self.data) - self.at, "ends too early")
        self.at += count
        return self.data[self.at - count:self.at]

    def numbers(self, kind, count):
        return list(struct.unpack(f"<{count}{kind}", self.take(count * struct.calcsize("<" + kind))))

    def number(self, kind):
        return self.numbers(kind, 1)[0]

    def varint(self):
        value, shift = 0, 0
        while True:
            byte = self.number("B")
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                need(value < 1 << 64 and (byte != 0 or shift == 0), "bad varint")
                return value
            shift += 7
            need(shift < 64, "varint too long")

    def zigzag(self):
        z = self.varint()
        return (z >> 1) ^ -(z & 1)

    def end(self):
        need(self.at == len(self.data), "bytes too many at the end")


def read_facts(b):
    """Everything in the manifest before the list of chunks."""
    need(b.take(8) == b"ECASSET\n", "not an asset manifest")
    need(b.number("I") == 1, "another version")
    m = dict(zip(("n", "r", "q", "F", "E"), b.numbers("I", 5)))
    need(1 <= m["n"] <= 16_000_000 and 1 <= m["r"] <= 4096, "vertex count or rank")
    need(4 * m["n"] * m["r"] <= 1 << 32 and 1 <= m["q"] <= m["n"] and m["F"] <= 32_000_000 and m["E"] <= m["r"], "counts")
    bands = b.number("B")
    need(1 <= bands <= 8, "number of bands")
    m["band_ends"] = b.numbers("I", bands)
    need(all(x < y for x, y in zip([0] + m["band_ends"], m["band_ends"])) and m["band_ends"][-1] == m["r"], "bands")
    up, handed = b.numbers("B", 2)
    need(up < 4 and handed < 2, "axes")
    m["up_axis"] = ("unknown", "x", "y", "z")[up]
    m["handedness"] = ("right", "left")[handed]
    m["metres_per_unit"], m["area"] = b.numbers("d", 2)
    m["box_low"], m["box_high"], m["origin"] = (b.numbers("d", 3) for _ in range(3))
    m["basis_kind"] = b.take(b.number("B")).decode()
    m["name"] = b.take(b.number("H")).decode()
    m["rest"] = b.numbers("d", 3 * m["r"])
    m["column_scales"] = b.numbers("f", m["r"] - m["E"])
    finite = [m["metres_per_unit"], m["area"], *m["box_low"], *m["box_high"], *m["origin"], *m["rest"], *m["column_scales"]]
    need(all(map(math.isfinite, finite)) and m["area"] > 0 and m["metres_per_unit"] >= 0, "a number is out of range")
    need(all(x <= y for x, y in zip(m["box_low"], m["box_high"])), "rest box")
    return m


def read_manifest(data):
    b = Bytes(data)
    m = read_facts(b)
    m["chunks"] = []
    row = face = 0
    for _ in range(b.number("I")):
        chunk = {"first_row": row, "first_face": face, "end_row": b.number("I"), "end_face": b.number("I"), "id": b.take(32), "tiles": []}
        for _ in range(b.number("B")):
            kind, index, required, compression, stored, raw = struct.unpack("<4B2I", b.take(12))
            need(required < 2, "reserved flag bits")
            chunk["tiles"].append({"kind": kind, "index": index, "required": required, "compression": compression,
                                   "stored": stored, "raw": raw, "hash": b.take(32)})
        known = [(t["kind"], t["index"], t["required"]) for t in chunk["tiles"][:1 + len(m["band_ends"])]]
        need(known == [(1, 0, 1)] + [(2, i, 1) for i in range(len(m["band_ends"]))], "tiles out of order")
        for tile in chunk["tiles"][len(known):]:
            need(tile["kind"] not in (0, 1, 2), "a structure or basis tile too many")
            need(not tile["required"], f"a required tile of unknown kind {tile['kind']}")
        need(row < chunk["end_row"] <= m["n"] and face <= chunk["end_face"] <= m["F"], "chunk range")
        row, face = chunk["end_row"], chunk["end_face"]
        m["chunks"].append(chunk)
    need(m["chunks"] and m["chunks"][0]["end_row"] >= m["q"] and row == m["n"] and face == m["F"], "chunks do not cover the asset")
    for _ in range(b.number("H")):
        kind, required = b.number("H"), b.number("B")
        b.number("Q"), b.take(32)
        need(required == 0, f"a required section of unknown kind {kind}")
    b.end()
    return m


def tile_bytes(chunk, data, position):
    offset = sum(t["stored"] for t in chunk["tiles"][:position])
    tile = chunk["tiles"][position]
    stored = data[offset:offset + tile["stored"]]
    need(len(stored) == tile["stored"] and hashlib.sha256(stored).digest() == tile["hash"], "a tile does not have its hash")
    if tile["compression"] == 2 and tile["kind"] == 2:
        return Coded(stored)
    need(tile["compression"] in (0, 1), "unknown compression")
    if tile["compression"] == 1:
        stored = unzstd(stored)
    need(tile["raw"] == len(stored), "its size is not the one stated")
    return Bytes(stored)


def unzstd(data):
    """Python's library has no zstd before 3.14; the zstd program (Debian package zstd) does it."""
    need(shutil.which("zstd"), "compressed: install the zstd program to read it")
    return subprocess.run(["zstd", "-d", "-c", "-q"], input=data, stdout=subprocess.PIPE, check=True).stdout


class Coded:
    """A range coder whose decisions' probabilities are learned."""

    def __init__(self, data):
        self.data, self.at, self.code, self.range = data, 4, int.from_bytes((data + bytes(4))[:4], "big"), 0xFF000000

    def decision(self, p):
        bound = (self.range >> 15) * p
        yes = self.code < bound
        if yes:
            self.range = bound
        else:
            self.code -= bound
            self.range -= bound
        while self.range < 1 << 24:
            self.range <<= 8
            self.code = self.code << 8 | (self.data[self.at] if self.at < len(self.data) else 0)
            self.at += 1
        return yes

    def learned(self, model, key):
        quick, slow, seen = model.get(key, (0x8000, 0x8000, 0))
        yes = self.decision((quick + slow) >> 2)
        seen = min(seen + 1, 7)
        at = min(seen, 4)
        if yes:
            model[key] = (quick + ((0xFFFF - quick) >> at), slow + ((0xFFFF - slow) >> seen), seen)
        else:
            model[key] = (quick - (quick >> at), slow - (slow >> seen), seen)
        return yes

    def signed(self, model):
        bits = 0
        while bits < 32 and self.learned(model, ("more", bits)):
            bits += 1
        if bits == 0:
            return 0
        number = 1
        for _ in range(bits - 1):
            bit = self.learned(model, ("bit", bits, number)) if number < 8 else self.decision(1 << 14)
            number = number << 1 | bit
        return -number if self.learned(model, "negative") else number

    def end(self):
        need(self.at >= len(self.data) and self.data[-1:] != b"\0", "bytes too many at the end")


def reference(m, asset, i):
    return asset["map"][i] if i >= m["q"] else i - 1


def add_structure(m, asset, chunk, b):
    first, end = chunk["first_row"], chunk["end_row"]
    for i in range(first, end):
        up = b.varint() if i >= m["q"] else 0
        need((1 <= up <= i) if i >= m["q"] else True, "parent")
        asset["map"].append(i - up)
    for i in range(first, end):
        ref = reference(m, asset, i)
        source = b.zigzag() + (asset["source_vertex"][ref] if ref >= 0 else 0)
        need(0 <= source < m["n"], "source vertex")
        asset["source_vertex"].append(source)
    masses = b.numbers("f", end - first)
    need(all(math.isfinite(x) and x > 0 for x in masses), "mass")
    asset["mass"] += masses
    death = first
    new_deaths = []
    for _ in range(chunk["end_face"] - chunk["first_face"]):
        death += b.varint()
        need(death < end, "death")
        new_deaths.append(death)
    new_faces = []
    for death in new_deaths:
        face, corner = [], death
        for _ in range(3):
            corner += b.zigzag()
            need(0 <= corner < end, "corner")
            face.append(corner)
        need(len(set(face)) == 3, "a face repeats a corner")
        new_faces.append(face)
    stands_for = {}
    for i in range(first, end):
        v = i
        while v >= first and v != asset["map"][v]:
            v = asset["map"][v]
        if v < first:
            stands_for.setdefault(v, []).append(i)
    for face in asset["faces"]:
        for k, v in enumerate(face):
            if v in stands_for:
                move = b.varint()
                need(move <= len(stands_for[v]), "move")
                face[k] = stands_for[v][move - 1] if move else v
    counts = [b.varint() for _ in range(first, end)]
    need(all(count <= 8 for count in counts), "too many predictors of a row")
    rows = []
    for i, count in zip(range(first, end), counts):
        rows.append([i - b.varint() for _ in range(count)])
        need(all(0 <= row < i for row in rows[-1]), "a predictor does not come before its row")
    weights = [[b.zigzag() for _ in range(count)] for count in counts]
    need(all(-511 <= weight <= 511 for row in weights for weight in row), "a weight is out of range")
    chunk["predictors"] = [list(zip(*pair)) for pair in zip(rows, weights)]
    b.end()
    asset["faces"] += new_faces
    asset["death"] += new_deaths


def bits_of(value):
    return struct.unpack("<I", struct.pack("<f", value))[0]


def ordered(bits):
    return 0x7FFFFFFF - bits if bits >> 31 else bits


def predicted_float(column, row, predictors):
    weights = sum(weight for _, weight in predictors)
    if weights <= 0:
        return column[row - 1] if row else 0.0
    total = 0.0
    for at, weight in predictors:
        total += column[at] * weight
    largest = 3.4028234663852886e38
    return as_f32(min(max(total / weights, -largest), largest))


def add_coded_basis(m, asset, chunk, low, high, b):
    first, end = chunk["first_row"], chunk["end_row"]
    levels = [150] * (end - first)
    contexts = [{} for _ in range(40)]
    for k in range(low, min(max(m["E"], low), high)):
        column = asset["columns"][k]
        for i in range(first, end):
            predicted = bits_of(predicted_float(column, i, chunk["predictors"][i - first]))
            exponent = predicted >> 23 & 0xFF
            left = b.signed(contexts[min(max(levels[i - first] - exponent, 0), 39)])
            levels[i - first] = exponent + abs(left).bit_length()
            number = (ordered(predicted) + left + (1 << 31)) % (1 << 32) - (1 << 31)
            value = struct.unpack("<f", struct.pack("<I", (0x7FFFFFFF - number) % (1 << 32) if number < 0 else number))[0]
            need(math.isfinite(value), "a basis value is not finite")
            column.append(value)
    means = [32] * (end - first)
    contexts = [{} for _ in range(40)]
    for columns, k in enumerate(range(min(max(m["E"], low), high), high), 1):
        column = asset["columns"][k]
        met = expected = 1 << 10
        for i in range(first, end):
            mean = means[i - first]
            likely = mean * met // expected
            bits = likely.bit_length()
            residual = b.signed(contexts[bits if bits < 2 else min(2 * bits - 2 + (likely >> (bits - 2) & 1), 39)])
            size = 16 * min(abs(residual), 4095)
            met, expected = met + size, expected + mean
            if expected >= 1 << 16:
                met, expected = (met + 1) // 2, (expected + 1) // 2
            means[i - first] = max(mean + int((size - mean) / min(columns + 1, 10)), 1)
            predicted = (sum(weight * column[row] for row, weight in chunk["predictors"][i - first]) + 32) >> 6
            value = predicted + residual
            need(abs(value) <= 32767 and (value == 0 or m["column_scales"][k - m["E"]] != 0), "a basis value is out of range")
            column.append(value)
    b.end()


def add_basis(m, asset, chunk, band, b):
    low = m["band_ends"][band - 1] if band else 0
    high = m["band_ends"][band]
    if isinstance(b, Coded):
        add_coded_basis(m, asset, chunk, low, high, b)
        return
    first_integer = min(max(m["E"], low), high)
    rows = chunk["end_row"] - chunk["first_row"]
    floats = rows * (first_integer - low)
    planes = [b.take(floats) for _ in range(4)]
    low_bytes, high_bytes = (b.take(rows * (high - first_integer)) for _ in range(2))
    b.end()
    at = 0
    for k in range(low, first_integer):
        for i in range(chunk["first_row"], chunk["end_row"]):
            value = struct.unpack("<f", bytes(plane[at] for plane in planes))[0]
            need(math.isfinite(value), "a basis value is not finite")
            asset["columns"][k].append(value)
            at += 1
    at = 0
    for k in range(first_integer, high):
        column = asset["columns"][k]
        for i in range(chunk["first_row"], chunk["end_row"]):
            z = low_bytes[at] | high_bytes[at] << 8
            predictors = chunk["predictors"][i - chunk["first_row"]]
            predicted = (sum(weight * column[row] for row, weight in predictors) + 32) >> 6
            value = ((z >> 1) ^ (0xFFFF if z & 1 else 0)) + predicted
            value = (value + 0x8000) % 0x10000 - 0x8000
            need(value != -32768 and (value == 0 or m["column_scales"][k - m["E"]] != 0), "a basis value is out of range")
            column.append(value)
            at += 1


def as_f32(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


def read_asset(manifest_bytes, chunk_bytes):
    m = read_manifest(manifest_bytes)
    need(len(chunk_bytes) == len(m["chunks"]), "number of chunks")
    asset = {"map": [], "source_vertex": [], "mass": [], "faces": [], "death": [], "columns": [[] for _ in range(m["r"])]}
    for chunk, data in zip(m["chunks"], chunk_bytes):
        need(len(data) == sum(t["stored"] for t in chunk["tiles"]), "length of a chunk")
        need(hashlib.sha256(data).digest() == chunk["id"], "a chunk does not have its hash")
        add_structure(m, asset, chunk, tile_bytes(chunk, data, 0))
        for band in range(len(m["band_ends"])):
            add_basis(m, asset, chunk, band, tile_bytes(chunk, data, 1 + band))
    need(sorted(asset["source_vertex"]) == list(range(m["n"])), "source vertices are not a permutation")
    columns = asset.pop("columns")
    for k in range(m["E"], m["r"]):
        columns[k] = [as_f32(v * m["column_scales"][k - m["E"]]) for v in columns[k]]
    facts = {key: m[key] for key in ("n", "r", "q", "F", "band_ends", "up_axis", "handedness", "metres_per_unit", "area",
                                     "box_low", "box_high", "origin", "basis_kind", "name", "rest")}
    return {"id": hashlib.sha256(manifest_bytes).hexdigest(), **facts, **asset, "basis": [list(row) for row in zip(*columns)]}


def main(arguments):
    expected = None
    if "--expect" in arguments:
        at = arguments.index("--expect")
        with open(arguments[at + 1], encoding="utf-8") as file:
            expected = json.load(file)
        arguments = arguments[:at]
    if not arguments:
        sys.exit(__doc__)
    contents = []
    for path in arguments:
        with open(path, "rb") as file:
            contents.append(file.read())
    try:
        asset = read_asset(contents[0], contents[1:])
    except Corrupt as error:
        sys.exit(f"{arguments[0]}: {error}")
    if expected is None:
        print("{\n" + ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in asset.items()) + "\n}")
        return
    for key in sorted(asset.keys() | expected.keys()):
        if asset.get(key) != expected.get(key):
            sys.exit(f"{key} differs: read {asset.get(key)}, expected {expected.get(key)}")
    print(f"{len(asset)} fields agree with the expected ones")


if __name__ == "__main__":
    main(sys.argv[1:])
