#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Holds a running broker to RFC 6455, from outside: raw bytes, and Python's websockets, Node's ws and Chromium where they are
installed.

    rfc6455_test.py BROKER [-v]        the broker must be built with EIGENCAST_TEST_ENDPOINTS (for /echo)
"""
import asyncio
import base64
import hashlib
import http.server
import os
import pathlib
import queue
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
import cases
from websocket_peer import BINARY, CLOSE, PING, PONG, TEXT, Broker, Peer, close_frame, frame

BROKER = None


class Case(unittest.TestCase):
    FLAGS = []

    @classmethod
    def setUpClass(cls):
        cls.broker = Broker(BROKER, *cls.FLAGS)
        cls.port = cls.broker.port

    @classmethod
    def tearDownClass(cls):
        cls.broker.__exit__()

    def fails_with(self, code, *frames):
        for step in (None, 1):
            peer = Peer(self.port)
            try:
                peer.send(*frames, step=step)
            except OSError:
                pass  # It may have heard enough before all was said.
            self.assertEqual(peer.close_code(), code, f"pieces of {step}")


class Raw(Case):
    def test_handshake(self):
        peer = Peer(self.port)
        accept = base64.b64encode(hashlib.sha1((peer.key + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11").encode()).digest()).decode()
        self.assertEqual(peer.status, 101)
        self.assertIn(f"Sec-WebSocket-Accept: {accept}", peer.head)
        self.assertNotIn("Sec-WebSocket-Extensions", peer.head)
        self.assertEqual(Peer(self.port, "/v1/subscribe", "chat").status, 400)
        self.assertEqual(Peer(self.port, "/v1/subscribe").status, 400)
        self.assertIn("Sec-WebSocket-Protocol: eigencast.v2", Peer(self.port, "/v1/subscribe", "chat, eigencast.v2").head)

    def test_wrong_version_and_key(self):
        for version, key, status in (("8", "x3JJHMbDL1EzLkh9GBhXDw==", 426), ("13", "short", 400)):
            peer = Peer(self.port, upgrade=False)
            peer.sock.sendall((f"GET /echo HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
                               f"Sec-WebSocket-Version: {version}\r\n\r\n").encode())
            self.assertIn(f"HTTP/1.1 {status}", peer.sock.recv(4096).decode())

    def test_echo_of_every_size(self):
        peer = Peer(self.port)
        for size in (0, 1, 125, 126, 127, 128, 65535, 65536, 1 << 20, 16 << 20):
            for opcode in (TEXT, BINARY):
                payload = b"*" * size
                peer.send(frame(opcode, payload))
                while (answer := peer.receive())[0] == PING:
                    pass  # On a machine that is slow with the larger ones it asks whether somebody is there.
                self.assertEqual(answer, (opcode, payload), size)
        payload = b"abcdefgh" * 16
        peer.send(frame(TEXT, payload), step=1)
        self.assertEqual(peer.receive(), (TEXT, payload))

    def test_fragments_with_pings_between(self):
        peer = Peer(self.port)
        peer.send(frame(TEXT, b"a", fin=False), frame(PING, b"p"), frame(0, b"b", fin=False), frame(0, b"", fin=False), frame(0, b"c"))
        self.assertEqual(peer.receive(), (PONG, b"p"))
        self.assertEqual(peer.receive(), (TEXT, b"abc"))
        peer.send(frame(TEXT, b"\xce", fin=False), frame(0, b"\xba"))
        self.assertEqual(peer.receive(), (TEXT, b"\xce\xba"))

    def test_long_messages_in_small_fragments(self):
        peer = Peer(self.port)
        for opcode in (TEXT, BINARY):
            for size, piece in ((65536, 1300), (1 << 20, 64), (1 << 20, 1 << 18)):
                payload = b"*" * size
                starts = range(0, size, piece)
                peer.send(*(frame(opcode if at == 0 else 0, payload[at:at + piece], fin=at + piece >= size) for at in starts))
                self.assertEqual(peer.receive(), (opcode, payload), (size, piece))

    def test_pings_of_every_kind(self):
        peer = Peer(self.port)
        for payload in (b"", b"Hello", b"\x00\xff\xfe\xfd\xfc\xfb\x00\xff", b"\xfe" * 125):
            for step in (None, 1):
                peer.send(frame(PING, payload), step=step)
                self.assertEqual(peer.receive(), (PONG, payload))
        peer.send(frame(PONG, b""), frame(PONG, b"x" * 125), frame(PING, b"after"))
        self.assertEqual(peer.receive(), (PONG, b"after"))

    def test_valid_utf8_up_to_its_bounds(self):
        peer = Peer(self.port)
        bounds = [0x0, 0x7F, 0x80, 0x7FF, 0x800, 0xD7FF, 0xE000, 0xFFFD, 0xFFFE, 0xFFFF, 0x10000, 0x1FFFE, 0x10FFFF]
        for text in [*map(chr, bounds), "Hello-\u00b5@\u00df\u00f6\u00e4\u00fc\u00e0\u00e1-UTF-8!!", "\u03ba\u1f79\u03c3\u03bc\u03b5"]:
            payload = text.encode()
            for cut in range(len(payload) + 1):  # Also in the middle of a character.
                peer.send(frame(TEXT, payload[:cut], fin=False), frame(0, payload[cut:]))
                self.assertEqual(peer.receive(), (TEXT, payload), text)

    def test_ping_floods_are_answered_in_order(self):
        peer = Peer(self.port)
        pings = [frame(PING, b"%d" % i) for i in range(1000)]
        for step in (None, 7):
            peer.send(*pings, step=step)
            for i in range(1000):
                self.assertEqual(peer.receive(), (PONG, b"%d" % i))
        peer.send(frame(PONG, b"nobody asked"), frame(TEXT, b"on"))
        self.assertEqual(peer.receive(), (TEXT, b"on"))

    def test_protocol_errors_close_with_1002(self):
        self.fails_with(1002, frame(TEXT, b"a", masked=False))
        for reserved in (1, 2, 4, 7):
            self.fails_with(1002, frame(TEXT, b"a", reserved=reserved))
        for opcode in (3, 4, 5, 6, 7, 11, 12, 13, 14, 15):
            self.fails_with(1002, frame(opcode, b"a"))
        self.fails_with(1002, frame(PING, b"a", fin=False))
        self.fails_with(1002, frame(PONG, b"a", fin=False))
        self.fails_with(1002, frame(TEXT, b"a"), frame(0, b"b", fin=False))
        self.fails_with(1002, frame(TEXT, b"a", fin=False), frame(BINARY, b"b"))
        self.fails_with(1002, frame(PING, b"a" * 126))
        self.fails_with(1002, frame(0, b"a"))
        self.fails_with(1002, frame(TEXT, b"a", fin=False), frame(TEXT, b"b"))
        self.fails_with(1002, frame(CLOSE, b"a"))
        self.fails_with(1002, frame(CLOSE, b"a" * 126))
        for code in (0, 999, 1004, 1005, 1006, 1015, 1016, 1100, 2000, 2999, 5000, 65535):
            self.fails_with(1002, close_frame(code))

    def test_bad_utf8_closes_with_1007(self):
        for bad in (b"\x80", b"\xbf", b"\xc0\x80", b"\xc0\xaf", b"\xc1\xbf", b"\xe0\x80\xaf", b"\xe0\x9f\xbf", b"\xed\xa0\x80", b"\xed\xbf\xbf",
                    b"\xf0\x80\x80\xaf", b"\xf0\x8f\xbf\xbf", b"\xf4\x90\x80\x80", b"\xf5\x80\x80\x80", b"\xf8\x88\x80\x80\x80", b"\xfe", b"\xff",
                    b"\xce\xba\xe1\xbd\xb9\xcf\x83\xed\xa0\x80edited", b"good\xce", b"\xe1\x80", b"\xf0\x90\x80"):
            self.fails_with(1007, frame(TEXT, bad))
        self.fails_with(1007, frame(TEXT, b"\xce", fin=False), frame(0, b"a"))
        self.fails_with(1007, close_frame(1000, b"\xff"))

    def test_bad_utf8_is_found_before_the_frame_ends(self):
        peer = Peer(self.port)
        peer.send(frame(TEXT, b"abc\xf4\x90" + b"a" * 100)[:6 + 5])
        self.assertEqual(peer.close_code(), 1007)

    def test_closes_are_echoed(self):
        for code in (1000, 1001, 1002, 1003, 1007, 1008, 1009, 1010, 1011, 1012, 3000, 3999, 4000, 4999):
            peer = Peer(self.port)
            peer.send(close_frame(code, b"why"), frame(TEXT, b"nobody hears this"))
            self.assertEqual(peer.close_code(), code)
        for reason in (b"", b"*" * 123, "\u03ba".encode() * 61):
            peer = Peer(self.port)
            peer.send(close_frame(1000, reason), frame(PING, b"too late"), close_frame(1001))
            self.assertEqual(peer.close_code(), 1000)
        peer = Peer(self.port)
        peer.send(frame(TEXT, b"unfinished", fin=False), close_frame(1000))
        self.assertEqual(peer.close_code(), 1000)
        peer = Peer(self.port)
        peer.send(frame(CLOSE))
        self.assertIsNone(peer.close_code())

    def test_oversized_messages_close_with_1009(self):
        for data in (frame(TEXT, b"a" * 65537), frame(TEXT, b"a" * 40000, fin=False) + frame(0, b"a" * 40000),
                     frame(BINARY, b"a" * 3_000_000)):
            peer = Peer(self.port, "/v1/subscribe", "eigencast.v2")
            peer.send(data)
            self.assertEqual(peer.close_code(), 1009)

    def test_wrong_kinds_on_real_endpoints(self):
        peer = Peer(self.port, "/v1/subscribe", "eigencast.v2")
        peer.send(frame(BINARY, b"a"))
        self.assertEqual(peer.close_code(), 1003)
        peer = Peer(self.port, "/v1/subscribe", "eigencast.v2")
        peer.send(frame(TEXT, b"{nonsense"))
        self.assertEqual(peer.close_code(), 1007)

    def test_half_closed(self):
        peer = Peer(self.port)
        peer.send(frame(TEXT, b"last"))
        peer.sock.shutdown(socket.SHUT_WR)
        peer.sock.settimeout(30)
        try:
            while peer.sock.recv(4096):
                pass
        except ConnectionResetError:
            pass

    def test_an_unread_connection_harms_no_other(self):
        deaf = Peer(self.port, "/v1/subscribe", "eigencast.v2")
        deaf.sock.settimeout(0.5)
        try:
            for i in range(1_000):
                deaf.send(frame(PING, b"%0100d" % i) * 50)
        except OSError:
            pass
        peer = Peer(self.port)
        peer.send(frame(TEXT, b"alive"))
        self.assertEqual(peer.receive(), (TEXT, b"alive"))


class Strict(Case):
    """What the Autobahn test suite calls strict: what was whole is echoed first, and a fault ends the connection at once."""

    def echoes_then_fails_with(self, code, good, bad):
        for step in (None, 1):
            peer = Peer(self.port)
            peer.send(frame(TEXT, good), bad, step=step)
            self.assertEqual(peer.receive(), (TEXT, good))
            self.assertEqual(peer.close_code(), code)

    def test_what_came_before_a_fault_is_answered(self):
        for reserved in range(1, 8):
            for opcode in (TEXT, BINARY, CLOSE, PING, PONG):
                self.echoes_then_fails_with(1002, b"*", frame(opcode, b"*", reserved=reserved))
        for opcode in (3, 7, 11, 15):
            self.echoes_then_fails_with(1002, b"*", frame(opcode))
            self.echoes_then_fails_with(1002, b"*", frame(opcode, b"payload") + frame(PING))
        self.echoes_then_fails_with(1002, b"*", frame(0, b"no message has begun"))
        self.echoes_then_fails_with(1002, b"*", frame(0, b"no message has begun", fin=False))

    def test_a_message_in_fragments_at_every_boundary(self):
        peer = Peer(self.port)
        payload = "Hello-\u00b5\u20ac\U0001f600!".encode()
        for opcode in (TEXT, BINARY):
            for first in range(len(payload) + 1):
                for second in range(first, len(payload) + 1):
                    peer.send(frame(opcode, payload[:first], fin=False), frame(PING, b"p"), frame(0, payload[first:second], fin=False),
                              frame(PONG), frame(0, payload[second:]))
                    self.assertEqual(peer.receive(), (PONG, b"p"))
                    self.assertEqual(peer.receive(), (opcode, payload), (first, second))

    def test_bad_utf8_ends_at_its_octet(self):
        start = "\u03ba\u1f79\u03c3\u03bc\u03b5".encode()
        for bad in (b"\xf4\x90", b"\xed\xa0", b"\xc0", b"\xe0\x80", b"\xf0\x80", b"\xf5", b"\xff", b"\xce\x41", b"\xe1\x80\x41"):
            for cut in range(len(bad)):
                peer = Peer(self.port)
                # No fragment is the last, and the frame of the bad octet is not whole: it must be found all the same.
                peer.send(frame(TEXT, start + bad[:cut], fin=False), frame(0, bad[cut:] + b"never sent", fin=False)[:6 + len(bad) - cut])
                self.assertEqual(peer.close_code(), 1007, (bad, cut))

    def test_a_character_may_span_fragments(self):
        for unfinished in (b"\xce", b"\xe1\xbd", b"\xf0\x9f\x98"):
            peer = Peer(self.port)
            peer.send(frame(TEXT, unfinished, fin=False), frame(PING, b"still there"))
            self.assertEqual(peer.receive(), (PONG, b"still there"))
            peer.send(frame(0))
            self.assertEqual(peer.close_code(), 1007)

    def test_nothing_is_answered_after_a_close(self):
        for late in (frame(TEXT, b"late"), frame(PING, b"late"), frame(BINARY, b"*" * 200_000)):
            peer = Peer(self.port)
            peer.send(close_frame(1000), late)
            opcode, payload = peer.receive()
            self.assertEqual((opcode, payload[:2]), (CLOSE, b"\x03\xe8"))
            peer.sock.settimeout(30)
            try:
                self.assertEqual(peer.buffer + peer.sock.recv(4096), b"")
            except ConnectionResetError:
                pass  # It closed with the late bytes unread.

    def test_a_close_between_fragments_ends_the_message(self):
        for code in (1000, 3000, 4999):
            peer = Peer(self.port)
            peer.send(frame(TEXT, b"frag", fin=False), close_frame(code, b"enough"), frame(0, b"ment"))
            self.assertEqual(peer.close_code(), code)


class Timeouts(Case):
    FLAGS = ["--timeouts-header-ms=2000", "--timeouts-idle-ms=1500"]

    def test_slow_loris(self):
        peer = Peer(self.port, upgrade=False)
        with self.assertRaises(OSError, msg="a head that never ends is cut off"):
            for _ in range(600):
                peer.sock.sendall(b"G")
                time.sleep(0.1)

    def test_a_silent_peer_is_pinged_then_cut_off(self):
        peer = Peer(self.port)
        self.assertEqual(peer.receive()[0], PING)
        peer.sock.settimeout(60)
        with self.assertRaises((EOFError, ConnectionResetError)):
            peer.receive()


class PythonWebsockets(Case):
    def setUp(self):
        try:
            import websockets
        except ImportError:
            self.skipTest("python3-websockets is not installed")
        self.websockets = websockets

    def test_echo_and_close(self):
        async def talk():
            async with self.websockets.connect(f"ws://127.0.0.1:{self.port}/echo", max_size=None) as ws:
                for message in ("", "text", "\u03ba\U0001f600" * 1000, b"", b"\x00\xff" * 40000):
                    await ws.send(message)
                    self.assertEqual(await ws.recv(), message)
                await ws.send(["frag", "men", "ted"])
                self.assertEqual(await ws.recv(), "fragmented")
                await asyncio.wait_for(await ws.ping(), 5)
                await ws.close(4321, "bye")
                self.assertEqual(ws.close_code, 4321)
        asyncio.run(talk())


class NodeWs(Case):
    SCRIPT = """
const WebSocket = require('ws');
const ws = new WebSocket('ws://127.0.0.1:' + process.argv[2] + '/echo', {perMessageDeflate: true});
const sent = ['', 'text', 'x'.repeat(100000), Buffer.alloc(70000, 7)];
let at = 0;
ws.on('open', () => ws.send(sent[0]));
ws.on('message', (data, binary) => {
  const want = sent[at];
  if (binary !== Buffer.isBuffer(want) || Buffer.compare(Buffer.from(want), data) !== 0) process.exit(3);
  if (++at < sent.length) return ws.send(sent[at]);
  ws.ping('are you there');
});
ws.on('pong', (data) => { if (data.toString() !== 'are you there') process.exit(4); ws.close(4000, 'done'); });
ws.on('close', (code) => process.exit(code === 4000 ? 0 : 5));
ws.on('error', (error) => { console.error(error); process.exit(6); });
"""

    def test_echo_and_close(self):
        where = os.environ.get("NODE_PATH", "/usr/share/nodejs")  # Debian's node-ws.
        node = shutil.which("node")
        if not node or not (pathlib.Path(where) / "ws").is_dir():
            self.skipTest("no node, or no `ws` in its folder: npm install ws, and NODE_PATH names its node_modules")
        done = subprocess.run([node, "-e", self.SCRIPT, "node", str(self.port)], env={**os.environ, "NODE_PATH": where}, timeout=30)
        self.assertEqual(done.returncode, 0)


PAGE = """<!doctype html><script>
const base = 'ws://127.0.0.1:PORT', seen = [];
const told = (event) => new Promise((resolve, reject) => Object.assign(event[0], {['on' + event[1]]: resolve, onerror: () => reject(event[1] + ': error')}));
async function echo() {
  const ws = new WebSocket(base + '/echo');
  ws.binaryType = 'arraybuffer';
  await told([ws, 'open']);
  seen.push('extensions:' + ws.extensions);
  for (const size of [0, 1, 125, 126, 65535, 65536, 1 << 20]) {
    for (const sent of ['\u03ba'.repeat(size), new Uint8Array(size).fill(7)]) {
      ws.send(sent);
      const got = (await told([ws, 'message'])).data;
      const same = typeof sent === 'string' ? got === sent : new Uint8Array(got).every((byte) => byte === 7) && got.byteLength === size;
      if (!same) throw 'echo of ' + size;
    }
  }
  ws.close(4321, 'bye');
  const closed = await told([ws, 'close']);
  seen.push('echo:' + closed.code + closed.wasClean);
}
async function refused() {
  const ws = new WebSocket(base + '/v1/subscribe', 'eigencast.v2');
  seen.push('op:' + JSON.parse((await told([ws, 'message'])).data).op + ws.protocol);
  ws.send(new Uint8Array(3));
  const closed = await told([ws, 'close']);
  seen.push('refused:' + closed.code + closed.wasClean);
  const wrong = new WebSocket(base + '/v1/subscribe', 'chat');
  await told([wrong, 'open']).then(() => seen.push('opened'), () => seen.push('not opened'));
}
echo().then(refused).catch((error) => seen.push('' + error)).then(() => fetch('/done', {method: 'POST', body: seen.join(' ')}));
</script>"""


class Chromium(unittest.TestCase):
    def test_echo_closes_and_subprotocols(self):
        chromium = shutil.which("chromium")
        if not chromium:
            self.skipTest("chromium is not installed")
        done = queue.Queue()
        # The page is of another origin than the broker, which must be told that it may come.
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), lambda *args: Page(done, *args))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self.addCleanup(server.server_close)
        self.addCleanup(server.shutdown)
        page = f"http://127.0.0.1:{server.server_address[1]}"
        # The browser's children still write into its folder while they end.
        with Broker(BROKER, f"--access-origins={page}") as broker, tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            server.page = PAGE.replace("PORT", str(broker.port)).encode()
            browser = subprocess.Popen([chromium, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", f"--user-data-dir={folder}",
                                        page], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                self.assertEqual(done.get(timeout=60), "extensions: echo:4321true op:welcomeeigencast.v2 refused:1003true not opened")
            finally:
                browser.terminate()
                browser.wait(10)


class Page(http.server.BaseHTTPRequestHandler):
    def __init__(self, done, *args):
        self.done = done
        super().__init__(*args)

    def do_GET(self):
        self.answer(self.server.page)

    def do_POST(self):
        self.done.put(self.rfile.read(int(self.headers["Content-Length"])).decode())
        self.answer(b"")

    def answer(self, body):
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
