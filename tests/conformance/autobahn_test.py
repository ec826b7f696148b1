#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The cases 1 to 7 and 10 of the Autobahn test suite by their numbers, each held to what it calls strictly OK: what was
whole is echoed first, in order, then the connection closes with the right code, and a fault closes it at once.

    autobahn_test.py BROKER [-v]        the broker must be built with EIGENCAST_TEST_ENDPOINTS (for /echo)
"""
import pathlib
import socket
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
import cases
from websocket_peer import BINARY, CLOSE, PING, PONG, TEXT, Broker, Peer, close_frame, frame

BROKER = None
HELLO = b"Hello, world!"
GREEK = "\u03ba\u1f79\u03c3\u03bc\u03b5".encode()
BEYOND = b"\xf4\x90\x80\x80"  # U+110000: the second octet shows that it cannot be.


def split(payload, size):
    """A text in fragments of `size` octets."""
    starts = range(0, len(payload), size) or [0]
    return b"".join(frame(TEXT if at == 0 else 0, payload[at:at + size], fin=at + size >= len(payload)) for at in starts)


def is_utf8(payload):
    try:
        payload.decode()
    except UnicodeDecodeError:
        return False
    return True


class Cases(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.broker = Broker(BROKER)

    @classmethod
    def tearDownClass(cls):
        cls.broker.__exit__()

    def case(self, number, data, answers, code=None, chop=None):
        """data   what is sent, in pieces of `chop` octets
        answers  what must come back, in order
        code     with what the broker must then close; None: it is asked to, and must agree with 1000"""
        with self.subTest(case=number, chop=chop):
            peer = Peer(self.broker.port)
            try:
                peer.send(data, step=chop)
            except OSError:
                self.assertIsNotNone(code, "closed while it was spoken to")  # It may have heard enough.
            self.ends(peer, answers, code)

    def ends(self, peer, answers, code):
        for answer in answers:
            self.assertEqual(peer.receive(), answer)
        if code is None:
            peer.send(close_frame(1000))
        opcode, payload = peer.receive()
        self.assertEqual((opcode, payload[:2]), (CLOSE, b"" if code == 1005 else (code or 1000).to_bytes(2, "big")))
        try:
            self.assertEqual(peer.buffer + peer.sock.recv(4096), b"", "nothing comes behind a close")
        except ConnectionResetError:
            pass  # It closed with what was sent too late unread.
        finally:
            peer.sock.close()

    def test_1_echoes(self):
        for i, (opcode, octet) in enumerate(((TEXT, b"*"), (BINARY, b"\xfe")), 1):
            for j, size in enumerate((0, 125, 126, 127, 128, 65535, 65536), 1):
                self.case(f"1.{i}.{j}", frame(opcode, octet * size), [(opcode, octet * size)])
            self.case(f"1.{i}.8", frame(opcode, octet * 65536), [(opcode, octet * 65536)], chop=997)

    def test_2_pings(self):
        for i, payload in enumerate((b"", HELLO, b"\x00\xff\xfe\xfd\xfc\xfb\x00\xff", b"\xfe" * 125), 1):
            self.case(f"2.{i}", frame(PING, payload), [(PONG, payload)])
        self.case("2.5", frame(PING, b"\xfe" * 126), [], 1002)
        self.case("2.6", frame(PING, b"\xfe" * 125), [(PONG, b"\xfe" * 125)], chop=1)
        self.case("2.7", frame(PONG), [])
        self.case("2.8", frame(PONG, b"unsolicited"), [])
        self.case("2.9", frame(PONG, b"unsolicited") + frame(PING, b"ping"), [(PONG, b"ping")])
        payloads = [b"payload-%d" % i for i in range(10)]
        for number, chop in (("2.10", None), ("2.11", 1)):
            self.case(number, b"".join(frame(PING, payload) for payload in payloads), [(PONG, payload) for payload in payloads], chop=chop)

    def test_3_reserved_bits(self):
        self.case("3.1", frame(TEXT, HELLO, reserved=1), [], 1002)
        for number, reserved, chop in (("3.2", 2, None), ("3.3", 3, len(frame(TEXT, HELLO))), ("3.4", 4, 1)):
            self.case(number, frame(TEXT, HELLO) + frame(TEXT, HELLO, reserved=reserved) + frame(PING), [(TEXT, HELLO)], 1002, chop)
        self.case("3.5", frame(BINARY, b"\x00\xff\xfe\xfd\xfc\xfb\x00\xff", reserved=5), [], 1002)
        self.case("3.6", frame(PING, HELLO, reserved=6), [], 1002)
        self.case("3.7", frame(CLOSE, reserved=7), [], 1002)

    def test_4_reserved_opcodes(self):
        for section, first in ((1, 3), (2, 11)):
            self.case(f"4.{section}.1", frame(first), [], 1002)
            self.case(f"4.{section}.2", frame(first + 1, b"reserved"), [], 1002)
            for i, (payload, chop) in enumerate(((b"", None), (HELLO, None), (HELLO, 1)), 3):
                data = frame(TEXT, HELLO) + frame(first + i - 1, payload) + frame(PING)
                self.case(f"4.{section}.{i}", data, [(TEXT, HELLO)], 1002, chop)

    def test_5_fragments(self):
        self.case("5.1", frame(PING, b"1", fin=False) + frame(0, b"2"), [], 1002)
        self.case("5.2", frame(PONG, b"1", fin=False) + frame(0, b"2"), [], 1002)
        first, second = frame(TEXT, b"fragment1", fin=False), frame(0, b"fragment2")
        whole, ping, pong = (TEXT, b"fragment1fragment2"), frame(PING, b"ping"), (PONG, b"ping")
        for i, chop in enumerate((None, len(first), 1), 3):
            self.case(f"5.{i}", first + second, [whole], chop=chop)
            self.case(f"5.{i + 3}", first + ping + second, [pong, whole], chop=chop)
            self.case(f"5.{i + 6}", frame(0, b"of nothing") + frame(TEXT, HELLO), [], 1002, chop)
            self.case(f"5.{i + 9}", frame(0, b"of nothing", fin=False) + frame(TEXT, HELLO), [], 1002, chop)
        self.case("5.15", first + second + frame(0, b"of nothing", fin=False) + frame(TEXT, HELLO), [whole], 1002)
        self.case("5.16", 2 * (frame(0, b"of nothing", fin=False) + first + second), [], 1002)
        self.case("5.17", 2 * (frame(0, b"of nothing") + first + second), [], 1002)
        self.case("5.18", first + frame(TEXT, b"fragment2"), [], 1002)
        parts = [b"fragment%d" % i for i in range(5)]
        begin = frame(TEXT, parts[0], fin=False) + frame(0, parts[1], fin=False) + frame(PING, b"one")
        end = frame(0, parts[2], fin=False) + frame(0, parts[3], fin=False) + frame(PING, b"two") + frame(0, parts[4])
        with self.subTest(case="5.19"):
            peer = Peer(self.broker.port)
            peer.send(begin)
            self.assertEqual(peer.receive(), (PONG, b"one"), "it is not held back until the message ends")
            peer.send(end)
            self.ends(peer, [(PONG, b"two"), (TEXT, b"".join(parts))], None)
        self.case("5.20", begin + end, [(PONG, b"one"), (PONG, b"two"), (TEXT, b"".join(parts))])

    def test_6_1_empty_texts(self):
        self.case("6.1.1", frame(TEXT), [(TEXT, b"")])
        for number, middle in (("6.1.2", b""), ("6.1.3", b"middle")):
            self.case(number, frame(TEXT, fin=False) + frame(0, middle, fin=False) + frame(0), [(TEXT, middle)])

    def test_6_2_valid_and_6_3_invalid_texts(self):
        hello = "Hello-\u00b5@\u00df\u00f6\u00e4\u00fc\u00e0\u00e1-UTF-8!!".encode()
        self.case("6.2.1", frame(TEXT, hello), [(TEXT, hello)])
        self.case("6.2.2", frame(TEXT, hello[:11], fin=False) + frame(0, hello[11:]), [(TEXT, hello)])
        self.case("6.2.3", split(hello, 1), [(TEXT, hello)])
        self.case("6.2.4", split(GREEK, 1), [(TEXT, GREEK)])
        bad = GREEK + b"\xed\xa0\x80edited"
        self.case("6.3.1", frame(TEXT, bad), [], 1007)
        self.case("6.3.2", split(bad, 1), [], 1007)

    def test_6_4_a_bad_octet_ends_the_connection(self):
        text = GREEK + BEYOND + b"edited"
        for number, first, second in (("6.4.1", 11, 15), ("6.4.2", 12, 13)):
            self.fails_fast(number, frame(TEXT, text[:first], fin=False), frame(0, text[first:second], fin=False))
        whole, head = frame(TEXT, text), len(frame(TEXT, text)) - len(text)
        for number, first, second in (("6.4.3", 11, 15), ("6.4.4", 12, 13)):
            self.fails_fast(number, whole[:head + first], whole[head + first:head + second])

    def fails_fast(self, number, good, bad):
        """`good` is borne; behind `bad`, which is not the end of the message, nothing is sent any more."""
        with self.subTest(case=number):
            peer = Peer(self.broker.port)
            peer.send(good)
            peer.sock.settimeout(0.05)
            with self.assertRaises(socket.timeout):
                peer.more()
            peer.sock.settimeout(10)
            peer.send(bad)
            self.ends(peer, [], 1007)

    def test_6_5_to_23_utf8_octet_by_octet(self):
        octets = [bytes([i]) for i in range(256)]
        unfinished = [b"\xc0", b"\xe0\x80", b"\xf0\x80\x80", b"\xf8\x80\x80\x80", b"\xfc\x80\x80\x80\x80", b"\xdf", b"\xef\xbf",
                      b"\xf7\xbf\xbf", b"\xfb\xbf\xbf\xbf", b"\xfd\xbf\xbf\xbf\xbf"]
        surrogates = [b"\xed\xa0\x80", b"\xed\xad\xbf", b"\xed\xae\x80", b"\xed\xaf\xbf", b"\xed\xb0\x80", b"\xed\xbe\x80", b"\xed\xbf\xbf"]
        overlong = lambda last: [b"\xc0" + last, b"\xe0\x80" + last, b"\xf0\x80\x80" + last, b"\xf8\x80\x80\x80" + last, b"\xfc\x80\x80\x80\x80" + last]
        sections = {
            5: [("hello" + c + "world").encode() for c in "\u0024\u00a2\u20ac\U00024b62"] + [GREEK],
            6: [GREEK[:end] for end in range(1, len(GREEK) + 1)],
            7: [chr(c).encode() for c in (0, 0x80, 0x800, 0x10000)],
            8: [b"\xf8\x88\x80\x80\x80", b"\xfc\x84\x80\x80\x80\x80"],
            9: [chr(c).encode() for c in (0x7f, 0x7ff, 0xffff, 0x10ffff)],
            10: [b"\xf7\xbf\xbf\xbf", b"\xfb\xbf\xbf\xbf\xbf", b"\xfd\xbf\xbf\xbf\xbf\xbf"],
            11: [chr(c).encode() for c in (0xd7ff, 0xe000, 0xfffd, 0x10ffff)] + [BEYOND],
            12: [b"\x80", b"\xbf", *((b"\x80\xbf" * 3)[:size] for size in range(2, 7)), b"".join(octets[0x80:0xbf])],
            13: [b" ".join(octets[a:b]) + b" " for a, b in ((0xc0, 0xdf), (0xe0, 0xef), (0xf0, 0xf7), (0xf8, 0xfb), (0xfc, 0xfd))],
            14: unfinished,
            15: [b"".join(unfinished)],
            16: [b"\xfe", b"\xff", b"\xfe\xfe\xff\xff"],
            17: overlong(b"\xaf"),
            18: [b"\xc1\xbf", b"\xe0\x9f\xbf", b"\xf0\x8f\xbf\xbf", b"\xf8\x87\xbf\xbf\xbf", b"\xfc\x83\xbf\xbf\xbf\xbf"],
            19: overlong(b"\x80"),
            20: surrogates,
            21: [high + low for high in surrogates[:4] for low in (b"\xed\xb0\x80", b"\xed\xbf\xbf")],
            22: [chr(plane << 16 | last).encode() for plane in range(17) for last in (0xfffe, 0xffff)],
            23: [chr(c).encode() for c in range(0xfff9, 0x10000)],
        }
        for section, texts in sections.items():
            for i, text in enumerate(texts, 1):
                good = is_utf8(text)
                for data in (frame(TEXT, text), split(text, 1)):
                    self.case(f"6.{section}.{i}", data, [(TEXT, text)] if good else [], None if good else 1007)

    def test_7_closes(self):
        bye = close_frame(1000)
        self.case("7.1.1", frame(TEXT, HELLO) + bye, [(TEXT, HELLO)], 1000)
        self.case("7.1.2", bye + bye, [], 1000)
        self.case("7.1.3", bye + frame(PING), [], 1000)
        self.case("7.1.4", bye + frame(TEXT, HELLO), [], 1000)
        self.case("7.1.5", frame(TEXT, b"fragment1", fin=False) + bye + frame(0, b"fragment2"), [], 1000)
        long = b"*" * (1 << 18)
        self.case("7.1.6", frame(TEXT, long) + frame(TEXT, HELLO) + bye + frame(PING), [(TEXT, long), (TEXT, HELLO)], 1000)
        self.case("7.3.1", frame(CLOSE), [], 1005)
        self.case("7.3.2", frame(CLOSE, b"a"), [], 1002)
        for i, reason in enumerate((b"", HELLO, b"*" * 123), 3):
            self.case(f"7.3.{i}", close_frame(1000, reason), [], 1000)
        self.case("7.3.6", close_frame(1000, b"*" * 124), [], 1002)
        self.case("7.5.1", close_frame(1000, GREEK + b"\xed\xa0\x80edited"), [], 1007)
        for i, code in enumerate((1000, 1001, 1002, 1003, 1007, 1008, 1009, 1010, 1011, 3000, 3999, 4000, 4999), 1):
            self.case(f"7.7.{i}", close_frame(code), [], code)
        for i, code in enumerate((0, 999, 1004, 1005, 1006, 1016, 1100, 2000, 2999), 1):
            self.case(f"7.9.{i}", close_frame(code), [], 1002)
        for i, code in enumerate((5000, 65535), 1):
            self.case(f"7.13.{i}", close_frame(code), [], 1002)

    def test_10_fragmented_by_a_library(self):
        self.case("10.1.1", split(b"*" * 65536, 1300), [(TEXT, b"*" * 65536)])


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
