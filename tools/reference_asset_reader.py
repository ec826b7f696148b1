#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Reads an eigencast asset and prints it as JSON: a second reader, written from docs/asset-format.md alone.

    reference_asset_reader.py MANIFEST_FILE CHUNK_FILE... [--columns SECTION_FILE] [--expect JSON_FILE]

--expect compares, and fails on the first difference.

Standard library only. It favours plainness over speed.
"""
import hashlib
import json
import math
import struct
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
    m["operator_kind"] = b.take(b.number("B")).decode()
    m["name"] = b.take(b.number("H")).decode()
    m["rest"] = b.numbers("d", 3 * m["r"])
    m["column_scales"] = b.numbers("f", m["r"] - m["E"])
    m["level_errors"] = [[b.number("I"), *b.numbers("f", 2)] for _ in range(b.number("B"))]
    for before, level in zip([[m["q"] - 1]] + m["level_errors"], m["level_errors"]):
        need(before[0] < level[0] < m["n"] and 0 <= level[1] <= level[2] < math.inf, "the error of a level")
    finite = [m["metres_per_unit"], m["area"], *m["box_low"], *m["box_high"], *m["origin"], *m["rest"], *m["column_scales"]]
    need(all(map(math.isfinite, finite)) and m["area"] > 0 and m["metres_per_unit"] >= 0, "a number is out of range")
    need(all(x <= y for x, y in zip(m["box_low"], m["box_high"])), "rest box")
    return m


def read_manifest(data):
    b = Bytes(data)
    m = read_facts(b)
    m["chunks"], m["columns"] = [], None
    row = face = 0
    for _ in range(b.number("I")):
        chunk = {"first_row": row, "first_face": face, "end_row": b.number("I"), "end_face": b.number("I"), "id": b.take(32), "tiles": []}
        for _ in range(b.number("B")):
            kind, index, required, size = struct.unpack("<3BI", b.take(7))
            need(required < 2, "reserved flag bits")
            chunk["tiles"].append({"kind": kind, "index": index, "required": required, "bytes": size, "hash": b.take(32)})
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
        section = b.number("Q"), b.take(32)
        if kind == 36:
            m["columns"] = section
        need(required == 0, f"a required section of unknown kind {kind}")
    b.end()
    return m


def tile_bytes(chunk, data, position):
    offset = sum(t["bytes"] for t in chunk["tiles"][:position])
    tile = chunk["tiles"][position]
    found = data[offset:offset + tile["bytes"]]
    need(len(found) == tile["bytes"] and hashlib.sha256(found).digest() == tile["hash"], "a tile does not have its hash")
    return Coded(found)


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

    def number(self, model):
        bits = 0
        while bits < 32 and self.learned(model, ("more", bits)):
            bits += 1
        if bits == 0:
            return 0
        number = 1
        for _ in range(bits - 1):
            bit = self.learned(model, ("bit", bits, number)) if number < 8 else self.decision(1 << 14)
            number = number << 1 | bit
        return number

    def signed(self, model):
        size = self.number(model)
        return -size if size and self.learned(model, "negative") else size

    def end(self):
        need(self.at >= len(self.data) and self.data[-1:] != b"\0", "bytes too many at the end")


def reference(m, asset, i):
    return asset["map"][i] if i >= m["q"] else i - 1


def arrivals_by(m, asset, v, level, first, end):
    """The rows from `level` on, of the chunk, that are v at that level; each behind those it contracts onto."""
    found = []
    for child in range(max(level, first, m["q"]), end):
        if asset["map"][child] == v:
            found += [child] + arrivals_by(m, asset, child, child + 1, first, end)
    return found


def add_structure(m, asset, chunk, b):
    first, end = chunk["first_row"], chunk["end_row"]
    kinds = [{} for _ in range(12)]
    parent, source, mass, deaths, order, third, corner, new_move, old_move, many, predictor, weight = kinds
    for i in range(first, end):
        up = b.number(parent) if i >= m["q"] else 0
        need((1 <= up <= i) if i >= m["q"] else True, "parent")
        asset["map"].append(i - up)
    for i in range(first, end):
        ref = reference(m, asset, i)
        known = asset["source_vertex"][ref] if ref >= 0 else 0
        asset["source_vertex"].append(known + b.signed(source))
        need(0 <= asset["source_vertex"][-1] < m["n"], "source vertex")
        bits = (bits_of(asset["mass"][ref] if ref >= 0 else 1.0) + b.signed(mass)) % (1 << 32)
        asset["mass"].append(struct.unpack("<f", struct.pack("<I", bits))[0])
        need(math.isfinite(asset["mass"][-1]) and asset["mass"][-1] > 0, "mass")
    new_deaths, total = [], chunk["end_face"] - chunk["first_face"]
    for i in range(first, end):
        if len(new_deaths) < total:
            new_deaths += [i] * b.number(deaths)
    need(len(new_deaths) == total, "number of faces")

    def moved(model, v, level):
        rows = arrivals_by(m, asset, v, level, first, end)
        move = b.number(model) if rows else 0
        need(move <= len(rows), "move")
        return rows[move - 1] if move else v

    new_faces = []
    for death in new_deaths:
        which = b.number(order)
        if which < 6:
            need(death >= m["q"], "a face of the base dies")
            stood = [death, asset["map"][death], death - b.number(third)]
            need(0 <= stood[2] < death, "corner")
            at = which // 2
            places = [at, (at + 1 + which % 2) % 3]
            face = [None] * 3
            for place, v in zip(places + [3 - sum(places)], stood):
                face[place] = moved(new_move, v, death + 1)
        else:
            need(which == 6, "order of corners")
            face = [b.number(corner) for _ in range(3)]
            need(max(face) < end, "corner")
        need(len(set(face)) == 3, "a face repeats a corner")
        new_faces.append(face)
    for face in asset["faces"]:
        face[:] = [moved(old_move, v, first) for v in face]
    chunk["predictors"] = []
    for i in range(first, end):
        count = b.number(many)
        need(count <= 8, "too many predictors of a row")
        pairs = [(i - b.number(predictor), b.signed(weight)) for _ in range(count)]
        need(all(0 <= row < i and -511 <= w <= 511 for row, w in pairs), "a predictor is out of range")
        chunk["predictors"].append(pairs)
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


def add_basis(m, asset, chunk, band, b):
    low = m["band_ends"][band - 1] if band else 0
    high = m["band_ends"][band]
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
    integers = range(min(max(m["E"], low), high), high)
    add_integers(b, first, end, [asset["columns"][k] for k in integers], chunk["predictors"])
    for k in integers:
        need(m["column_scales"][k - m["E"]] != 0 or not any(asset["columns"][k]), "a basis value is out of range")
    b.end()


def add_integers(b, first, end, columns, predictors):
    means = [32] * (end - first)
    contexts = [{} for _ in range(40)]
    for number, column in enumerate(columns, 1):
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
            means[i - first] = max(mean + int((size - mean) / min(number + 1, 10)), 1)
            predicted = (sum(weight * column[row] for row, weight in predictors[i - first]) + 32) >> 6
            need(abs(predicted + residual) <= 32767, "a basis value is out of range")
            column.append(predicted + residual)


def add_columns(m, asset, data):
    """The section of learnt columns: their values, and in the facts one band more."""
    need(m["columns"] == (len(data), hashlib.sha256(data).digest()), "the columns do not have their hash")
    b = Bytes(data)
    count = b.number("B")
    need(1 <= count <= 64 and m["r"] + count <= 4096 and len(m["band_ends"]) < 8, "number of columns")
    scales = b.numbers("f", count)
    need(all(1e-30 <= scale <= 1e34 for scale in scales), "a scale is out of range")
    columns = [[] for _ in range(count)]
    for chunk, size in zip(m["chunks"], b.numbers("I", len(m["chunks"]))):
        chunk["columns"] = size
    for chunk in m["chunks"]:
        first, end = chunk["first_row"], chunk["end_row"]
        tile = Coded(b.take(chunk["columns"]))
        add_integers(tile, first, end, columns, [[(asset["map"][i], 64)] if i >= m["q"] else [] for i in range(first, end)])
        tile.end()
    b.end()
    m["r"] += count
    m["band_ends"].append(m["r"])
    m["rest"] += [0.0] * 3 * count
    return [[as_f32(v * scale) for v in column] for column, scale in zip(columns, scales)]


def as_f32(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


def read_asset(manifest_bytes, chunk_bytes, column_bytes=None):
    m = read_manifest(manifest_bytes)
    need(len(chunk_bytes) == len(m["chunks"]), "number of chunks")
    asset = {"map": [], "source_vertex": [], "mass": [], "faces": [], "death": [], "columns": [[] for _ in range(m["r"])]}
    for chunk, data in zip(m["chunks"], chunk_bytes):
        need(len(data) == sum(t["bytes"] for t in chunk["tiles"]), "length of a chunk")
        need(hashlib.sha256(data).digest() == chunk["id"], "a chunk does not have its hash")
        add_structure(m, asset, chunk, tile_bytes(chunk, data, 0))
        for band in range(len(m["band_ends"])):
            add_basis(m, asset, chunk, band, tile_bytes(chunk, data, 1 + band))
    need(sorted(asset["source_vertex"]) == list(range(m["n"])), "source vertices are not a permutation")
    columns = asset.pop("columns")
    for k in range(m["E"], m["r"]):
        columns[k] = [as_f32(v * m["column_scales"][k - m["E"]]) for v in columns[k]]
    if column_bytes is not None:
        columns += add_columns(m, asset, column_bytes)
    facts = {key: m[key] for key in ("n", "r", "q", "F", "band_ends", "up_axis", "handedness", "metres_per_unit", "area",
                                     "box_low", "box_high", "origin", "basis_kind", "operator_kind", "name", "level_errors", "rest")}
    return {"id": hashlib.sha256(manifest_bytes).hexdigest(), **facts, **asset, "basis": [list(row) for row in zip(*columns)]}


def main(arguments):
    expected = columns = None
    if "--expect" in arguments:
        at = arguments.index("--expect")
        with open(arguments[at + 1], encoding="utf-8") as file:
            expected = json.load(file)
        arguments = arguments[:at]
    if "--columns" in arguments:
        at = arguments.index("--columns")
        with open(arguments[at + 1], "rb") as file:
            columns = file.read()
        arguments = arguments[:at]
    if not arguments:
        sys.exit(__doc__)
    contents = []
    for path in arguments:
        with open(path, "rb") as file:
            contents.append(file.read())
    try:
        asset = read_asset(contents[0], contents[1:], columns)
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
