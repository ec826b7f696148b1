# SPDX-License-Identifier: MIT
"""What reference_decoder.py reads frames with: bytes, bits and the range coder of docs/protocol.md; plain, slow, standard library only."""

CURVE = [  # for contexts 59 to 151
    97, 158, 238, 339, 460, 600, 936, 1336, 1787, 2277, 2795, 3333, 3881, 4435, 5538, 6616, 7652, 8638, 9570,
    10450, 11277, 12055, 13471, 14724, 15834, 16824, 17709, 18505, 19223, 19875, 21010, 21965, 22778, 23479,
    24089, 24624, 25098, 25520, 26239, 26828, 27320, 27738, 28095, 28406, 28678, 28918, 29322, 29650, 29920,
    30148, 30342, 30509, 30655, 30783, 30997, 31170, 31312, 31431, 31532, 31618, 31694, 31760, 31870, 31959,
    32032, 32092, 32144, 32188, 32226, 32260, 32316, 32361, 32398, 32428, 32454, 32477, 32496, 32513, 32541,
    32564, 32582, 32598, 32611, 32622, 32632, 32640, 32654, 32666, 32675, 32683, 32689, 32695, 32700,
]


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
    """Bits of an exact run, the most significant first."""

    def __init__(self, data):
        self.text = "".join(f"{byte:08b}" for byte in data)
        self.at = 0

    def take(self, count):
        require(count <= len(self.text) - self.at, "bits end early")
        self.at += count
        return self.text[self.at - count : self.at]

    def number(self, count):
        return int(self.take(count), 2) if count else 0


class RangeDecoder:
    def __init__(self, data):
        self.data, self.next, self.range, self.code = data, 0, 0xFF000000, 0
        for _ in range(4):
            self.shift()

    def shift(self):
        self.code = (self.code << 8 | (self.data[self.next] if self.next < len(self.data) else 0)) % 2**32
        self.next += 1

    def decision(self, probability=2**14):
        bound = (self.range >> 15) * probability
        taken = self.code < bound
        if taken:
            self.range = bound
        else:
            self.code -= bound
            self.range -= bound
        while self.range < 2**24:
            self.range <<= 8
            self.shift()
        return taken

    def number(self, count):
        value = 0
        for _ in range(count):
            value = value << 1 | self.decision()
        return value

    def scale(self, expected):
        if not self.decision(26000):
            return expected
        less, off = self.decision(), 1
        while off <= 30 and self.decision(19000):
            off += 1
        return expected - off if less else expected + off

    def level(self, beyond_0, beyond_1, later):
        if not self.decision(beyond_0):
            return 0
        if not self.decision(beyond_1):
            return 1
        level = 2
        while level < 24 and self.decision(later):
            level += 1
        if level < 24:
            return level
        bits, rest = 0, 1
        while bits < 31 and self.decision():
            bits += 1
        for _ in range(bits):
            rest = rest << 1 | self.decision()
        return level + rest - 1

    def finish(self):
        require(len(self.data) <= self.next and (not self.data or self.data[-1]), "bytes left over")


def more(context):
    """The curve of the protocol: exp(-1 / (4 s)) for the magnitude s of a context, in units of 2^-15."""
    index = min(max(context - 59, -1), len(CURVE))
    return 64 if index < 0 else CURVE[index] if index < len(CURVE) else 2**15 - 64
