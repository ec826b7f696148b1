#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The page that the broker serves, and where a stream's URL leads: by plain HTTP, below a path of a proxy, over TLS, to strangers.

    web_page_test.py BROKER [-v]
"""
import base64
import gzip
import hashlib
import http.client
import http.server
import json
import os
import pathlib
import pty
import re
import signal
import ssl
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import urllib.parse

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker")]
import cases
import payloads
from websocket_peer import TEXT, Broker, Peer, frame, ports_of

BROKER = None
HTML = {"Accept": "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"}  # As browsers send it.
JSON = {"Accept": "application/json"}
PAGE = '<!doctype html><link href="{web}page.css"></head><script type="module" src="{web}page.js"></script>'
SECRET = "a secret of the tests, of more than 32 bytes"


def ask(port, method, target, headers={}, body=None, tls=None, host="127.0.0.1", source=None):
    """Status, headers (names in lower case, doubled ones joined) and body."""
    make = http.client.HTTPSConnection if tls else http.client.HTTPConnection
    connection = make(host, port, timeout=60, source_address=(source, 0) if source else None, **({"context": tls} if tls else {}))
    try:
        connection.putrequest(method, target, skip_host="Host" in headers, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name, value)
        if body is not None:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        fields = {}
        for name, value in answer.getheaders():
            fields[name.lower()] = f"{fields[name.lower()]}, {value}" if name.lower() in fields else value
        return answer.status, fields, answer.read()
    finally:
        connection.close()


def directives(fields):
    """The content security policy, by directive; a directive that occurs twice is an error."""
    found = [part.split() for part in fields["content-security-policy"].split(";")]
    assert len({names[0] for names in found}) == len(found), found
    return {names[0]: names[1:] for names in found}


def urls_in(page):
    return re.findall(r'(?:href|src)="([^"]*)"', page.decode())


class Proxy(http.server.ThreadingHTTPServer):
    """Serves a broker below /tools/eigencast, which it takes off, as proxies of notebooks do."""

    PREFIX = "/tools/eigencast"

    def __init__(self, broker_port):
        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self):
                if not self.path.startswith(Proxy.PREFIX + "/"):
                    return self.send_error(404)
                status, fields, body = ask(broker_port, "GET", self.path[len(Proxy.PREFIX):], dict(self.headers))
                self.send_response(status)
                for name in ("content-type", "content-encoding", "content-security-policy"):
                    if name in fields:
                        self.send_header(name, fields[name])
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        super().__init__(("127.0.0.1", 0), Handler)
        self.port = self.server_address[1]
        threading.Thread(target=self.serve_forever, daemon=True).start()


class WebPageCase(unittest.TestCase):
    def start(self, *flags, page=True):
        """A broker, as a rule with a page of its own in a folder."""
        if page:
            self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
            (self.folder / "page.html").write_text(PAGE)
            (self.folder / "page.js").write_text("let script = 1;")
            (self.folder / "page.css").write_text("body {}")
            (self.folder / "core.wasm").write_bytes(b"\0asm")
            (self.folder / ".hidden").write_text("secret")
            (self.folder / "below").mkdir()
            (self.folder / "below/page.js").write_text("secret")
            flags = (f"--web-folder={self.folder}", *flags)
        self.broker = Broker(BROKER, *flags)
        self.addCleanup(self.broker.__exit__)
        self.port, self.admin = ports_of(pathlib.Path(self.broker.folder) / "port")
        return self.port

    def get(self, target, headers={}, **more):
        return ask(self.port, "GET", target, headers, **more)

    def announce(self, stream, *headers):
        body, name = payloads.asset()
        bearer = dict(line.split(": ") for line in headers)
        self.assertIn(ask(self.port, "PUT", f"/v1/assets/{name}", bearer, body)[0], (200, 201))
        sender = Peer(self.port, f"/v1/publish/{stream}", "eigencast.v2", headers)
        self.addCleanup(sender.sock.close)
        sender.send(frame(TEXT, payloads.announce(name, 4, "float32").encode()))
        while json.loads(sender.receive()[1])["op"] != "announced":
            pass
        return name


class WebPage(WebPageCase):
    # Where a stream's URL leads.

    def test_urls_lead_to_the_endpoints(self):
        self.start("--web-enabled=false", page=False)
        for stream in ("horse", "lab/horse", "a/b/c/d"):
            status, fields, body = self.get(f"/{stream}?k=3", JSON)
            self.assertEqual((status, fields["content-type"]), (200, "application/json"))
            self.assertEqual(fields["access-control-allow-origin"], "*")
            self.assertIn("accept", fields["vary"].lower())
            for base in ("http://h", "http://h/tools/eigencast"):
                found = {name: urllib.parse.urljoin(f"{base}/{stream}", url) for name, url in json.loads(body).items()}
                self.assertEqual(found, {"subscribe": f"{base}/v1/subscribe/{stream}", "publish": f"{base}/v1/publish/{stream}",
                                         "assets": f"{base}/v1/assets/", "streams": f"{base}/v1/streams"})
        status, _, body = self.get("/", JSON)
        self.assertEqual((status, json.loads(body)), (200, {"subscribe": "v1/subscribe", "assets": "v1/assets/", "streams": "v1/streams"}))

    def test_endpoints_do_not_say_what_exists(self):
        self.start("--access-anonymous=nowhere", f"--access-jwt-secret={SECRET}", page=False)
        made = subprocess.run([BROKER, "token", "create", "--subject=camera", "--publish=live/**"], check=True, capture_output=True, text=True,
                              env={**os.environ, "EIGENCAST_ACCESS__JWT_SECRET": SECRET})
        self.announce("live/horse", "Authorization: Bearer " + made.stdout.strip())
        self.assertEqual(self.get("/v1/streams")[0], 401, "strangers may not know")
        seen = set()
        for stream in ("live/horse", "live/crane", "else/horse"):
            for headers in (JSON, {**JSON, "Authorization": "Bearer wrong"}):
                status, fields, body = self.get("/" + stream, headers)
                seen.add((status, str(sorted(fields)), body.replace(stream.encode(), b"NAME")))
        self.assertEqual(len(seen), 1, seen)

    def test_names_of_the_protocol_are_no_streams(self):
        self.start()
        for accept in (JSON, HTML, {}):
            self.assertEqual(self.get("/v1/anything", accept)[0], 404)
        for target in ("/v1/publish/v1/streams", "/v1/subscribe/v1/web/page.js"):
            peer = Peer(self.port, target, "eigencast.v2")
            self.assertEqual(peer.status, 400)
            peer.sock.close()

    def test_what_is_asked_for_decides(self):
        self.start()
        page = "text/html; charset=utf-8"
        for accept, kind in ((HTML["Accept"], page), ("*/*", page), ("text/*", page), ("application/json;q=0.5, text/html", page), (None, page),
                             ("application/json", "application/json"), ("application/*", "application/json"), ("TEXT/HTML;Q=0.1, application/json", "application/json"),
                             ("application/json, text/plain, */*", "application/json"), ("text/html;q=0, application/json;q=0.1", "application/json"),
                             ("text/html;q=x, application/json;q=0.001", "application/json")):
            status, fields, _ = self.get("/lab/horse", {"Accept": accept} if accept else {})
            self.assertEqual((status, fields["content-type"]), (200, kind), accept)

    def test_a_stream_itself_is_no_websocket(self):
        self.start()
        peer = Peer(self.port, "/lab/horse", "eigencast.v2")
        self.addCleanup(peer.sock.close)
        self.assertEqual(peer.status, 404)

    # The page.

    def test_page_is_found_from_every_name(self):
        self.start()
        proxy = Proxy(self.port)
        self.addCleanup(proxy.server_close)
        self.addCleanup(proxy.shutdown)
        for port, prefix in ((self.port, ""), (proxy.port, Proxy.PREFIX)):
            for name in ("", "horse", "lab/horse", "a/b/c/d"):
                status, fields, body = ask(port, "GET", f"{prefix}/{name}?embed=1", HTML)
                self.assertEqual((status, fields["content-type"]), (200, "text/html; charset=utf-8"))
                script = [url for url in urls_in(body) if url.endswith("page.js")]
                path = urllib.parse.urljoin(f"{prefix}/{name}", script[0])
                status, fields, body = ask(port, "GET", path)
                self.assertEqual((status, fields["content-type"], body), (200, "text/javascript; charset=utf-8", b"let script = 1;"), path)

    def test_page_is_revalidated(self):
        self.start()
        for target in ("/lab/horse", "/v1/web/page.js"):
            _, fields, body = self.get(target, HTML)
            self.assertEqual(fields["cache-control"], "no-cache")
            for tag in (fields["etag"], f'"x", W/{fields["etag"]}', "*"):
                status, kept, nothing = self.get(target, {**HTML, "If-None-Match": tag})
                self.assertEqual((status, nothing, kept["etag"]), (304, b"", fields["etag"]))
            self.assertEqual(self.get(target, {**HTML, "If-None-Match": '"x"'})[2], body)
            status, head, nothing = ask(self.port, "HEAD", target, HTML)
            self.assertEqual((status, head["content-length"], nothing), (200, str(len(body)), b""))
            self.assertEqual(ask(self.port, "POST", target, HTML, b"x")[0], 405)
        etag = self.get("/", HTML)[1]["etag"]
        (self.folder / "page.html").write_text(PAGE + "<p>")
        self.assertEqual(self.get("/", {**HTML, "If-None-Match": etag})[0], 200)

    def test_page_may_do_only_what_it_needs(self):
        self.start("--access-origins=https://site.example,https://*.lab.example")
        _, fields, _ = self.get("/lab/horse", {**HTML, "Host": "localhost:7"})
        self.assertEqual(directives(fields), {
            "default-src": ["'none'"], "script-src": ["'self'", "'wasm-unsafe-eval'"], "style-src": ["'self'"], "img-src": ["'self'", "data:", "blob:"],
            "worker-src": ["'self'"], "connect-src": ["'self'", "ws://localhost:7", "wss://localhost:7"], "base-uri": ["'none'"], "form-action": ["'none'"],
            "frame-ancestors": ["'self'", "https://site.example", "https://*.lab.example"]})
        self.assertEqual((fields["referrer-policy"], fields["x-content-type-options"]), ("no-referrer", "nosniff"))

    def test_hosts_are_not_taken_at_their_word(self):
        self.start("--proxy-trusted=127.0.0.2")
        sources = lambda headers, source="127.0.0.1": directives(self.get("/", {**HTML, **headers}, source=source)[1])["connect-src"]
        for host in ("a;script-src*", "a,b", "a'b", "x!y", "*"):
            self.assertEqual(sources({"Host": host}), ["'self'"], host)
        self.assertEqual(sources({"X-Forwarded-Host": "evil.example", "Host": "h"}), ["'self'", "ws://h", "wss://h"])
        self.assertEqual(sources({"X-Forwarded-Host": "site.example", "Host": "h"}, "127.0.0.2"), ["'self'", "ws://site.example", "wss://site.example"])
        for host in ("x; script-src *", "a, b", "a\tb"):
            self.assertEqual(sources({"X-Forwarded-Host": host, "Host": "h"}, "127.0.0.2"), ["'self'"], host)

    def test_nothing_of_a_request_is_in_the_page(self):
        self.start()
        plain = self.get("/lab/horse", HTML)[2]
        self.assertEqual(self.get("/lab/other?x=<script>&access_token=T0KEN", HTML)[2], plain)
        for target in ("/<script>", "/lab/%3Cscript%3E", "//evil.example/", "//evil.example", "/\\evil.example", "/..", "/a/../b", "/a//b", "/a/", "/%2e%2e/x"):
            status, fields, body = self.get(target, HTML)
            self.assertEqual((status, fields["content-type"], fields["x-content-type-options"]), (400, "application/json", "nosniff"), target)
            self.assertNotIn("location", fields)

    def test_files_are_those_of_the_folder_alone(self):
        self.start()
        outside = pathlib.Path(self.broker.folder, "epoch")
        for rest in ("", ".", "..", ".hidden", "../" + outside.name, "%2e%2e/epoch", "..%2fepoch", "below/page.js", "below", "/etc/passwd", "//etc/passwd", "page.js/",
                     "./page.js", "page.js%00", "none.js", "x" * 5000, "0000000000000000/page.js"):
            status, fields, body = self.get("/v1/web/" + rest)
            self.assertEqual((status, fields["content-type"], fields["cache-control"]), (404, "application/json", "no-store"), rest)
            self.assertNotIn(b"secret", body)
            self.assertNotIn(str(self.folder).encode(), body)
        (self.folder / "large.js").touch()
        os.truncate(self.folder / "large.js", 17 << 20)
        self.assertEqual(self.get("/v1/web/large.js")[0], 404)
        status, fields, _ = self.get("/v1/web/core.wasm", {"Origin": "https://anywhere.example"})
        self.assertEqual((status, fields["content-type"], fields["access-control-allow-origin"]), (200, "application/wasm", "*"))

    def test_an_asset_is_never_a_script(self):
        self.start(page=False)
        body = b"alert(1)"
        target = "/v1/assets/" + hashlib.sha256(body).hexdigest()
        self.assertEqual(ask(self.port, "PUT", target, {}, body)[0], 201)
        _, fields, _ = self.get(target)
        self.assertEqual((fields["content-type"], fields["x-content-type-options"]), ("application/octet-stream", "nosniff"))

    def test_page_can_be_turned_off(self):
        self.start("--web-enabled=false")
        for target in ("/", "/lab/horse", "/v1/web/page.js"):
            status, fields, body = self.get(target, HTML)
            self.assertEqual((status, json.loads(body)["error"], fields["cache-control"]), (404, "not-found", "no-store"))

    def test_page_takes_no_rights_and_gives_none(self):
        self.start("--access-anonymous=nowhere", f"--access-jwt-secret={SECRET}")
        made = subprocess.run([BROKER, "token", "create", "--subject=camera", "--publish=**"], check=True, capture_output=True, text=True,
                              env={**os.environ, "EIGENCAST_ACCESS__JWT_SECRET": SECRET})
        asset = self.announce("lab/horse", "Authorization: Bearer " + made.stdout.strip())
        for headers in (HTML, {**HTML, "Host": "rebound.example"}, {**HTML, "X-Forwarded-For": "192.0.2.1"}, {**HTML, "Authorization": "Bearer wrong"}):
            status, _, body = self.get("/lab/horse", headers)
            self.assertEqual(status, 200)
            self.assertNotIn(asset.encode(), body)
        self.assertEqual(self.get("/v1/streams")[0], 401)
        self.assertEqual(self.get("/v1/assets/" + asset)[0], 401)

    def test_surface_is_preloaded_where_all_may_have_it(self):
        self.start("--access-anonymous-subscribe=lab/**")
        asset = self.announce("lab/horse")
        self.announce("hidden/horse")
        _, fields, body = self.get("/lab/horse", HTML)
        self.assertIn("../v1/assets/" + asset, urls_in(body))
        self.assertNotIn(b"v1/assets/", self.get("/lab/none", HTML)[2])
        for target, headers in (("/hidden/horse", {}), ("/lab/horse", {"Host": "rebound.example"}), ("/lab/horse", {"X-Forwarded-For": "192.0.2.1"}),
                                ("/lab/horse", {"Origin": "https://foreign.example"})):
            self.assertNotIn(asset.encode(), self.get(target, {**HTML, **headers})[2], (target, headers))
        self.assertEqual(self.get("/lab/horse", {**HTML, "If-None-Match": fields["etag"]})[0], 304)

    def test_strangers_pay_for_the_page(self):
        self.start("--per-address-download-bytes-per-hour=100")
        for target in ("/v1/web/page.js", "/lab/horse"):
            answers = [self.get(target, HTML) for _ in range(20)]
            self.assertEqual(answers[-1][0], 429, target)
            self.assertIn(b"per_address.download_bytes_per_hour", answers[-1][2])
        self.assertEqual(self.get("/lab/horse", HTML, source="127.0.0.2")[0], 200, "another address has its own")
        self.start("--per-address-requests-per-s=1")
        peers = [Peer(self.port, upgrade=False) for _ in range(40)]
        for peer in peers:
            peer.sock.sendall(b"GET /v1/web/page.js HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        answers = [b"".join(iter(lambda: peer.sock.recv(65536), b"")) for peer in peers]
        self.assertIn(b" 429 ", b"".join(answers))

    def test_page_over_tls(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2", "-subj", "/CN=localhost",
                        "-addext", "subjectAltName=DNS:localhost", "-keyout", folder / "key.pem", "-out", folder / "cert.pem"], check=True, capture_output=True)
        self.start(f"--tls-certificate={folder}/cert.pem", f"--tls-key={folder}/key.pem")
        tls = ssl.create_default_context(cafile=folder / "cert.pem")
        status, fields, body = self.get("/lab/horse", HTML, tls=tls, host="localhost")
        self.assertEqual((status, directives(fields)["connect-src"][2]), (200, f"wss://localhost:{self.port}"))
        self.assertEqual(self.get(urllib.parse.urljoin("/lab/horse", urls_in(body)[0]), tls=tls, host="localhost")[2], b"body {}")


class BuiltIn(WebPageCase):
    """What is built into the program."""

    def setUp(self):
        self.start(page=False)
        status, _, self.page = self.get("/lab/horse", HTML)
        if status == 404:
            self.assertIn(b"built without", self.page)
            self.skipTest("this broker was built without the page")

    def test_built_in_files_are_kept_for_ever(self):
        files = {name: urllib.parse.urljoin("/lab/horse", url) for url in urls_in(self.page) if "/v1/web/" in url for name in [url.split("/")[-1]]}
        self.assertIn("page.js", files)
        for name, path in files.items():
            status, fields, body = self.get(path)
            self.assertEqual((status, fields["cache-control"]), (200, "public, max-age=31536000, immutable"), path)
            self.assertNotIn("content-encoding", fields, "none was accepted")
            self.assertEqual((fields["vary"], fields["access-control-allow-origin"]), ("Accept-Encoding", "*"))
            for accepted, coding in (("gzip, deflate, br", ("br", "gzip")), ("gzip", ("gzip",)), ("br;q=0, gzip;q=0.1", ("gzip",)), ("*", ("br", "gzip")),
                                     ("identity, gzip;q=0.5", (None,)), ("gzip;q=0", (None,)), ("gzip;q=0, *", ("br",)), ("", (None,)), ("zstd", (None,)), ("GZIP", ("gzip",))):
                status, fields, packed = self.get(path, {"Accept-Encoding": accepted})
                self.assertEqual(status, 200)
                self.assertIn(fields.get("content-encoding"), coding, accepted)
                if fields.get("content-encoding") == "gzip":
                    self.assertLess(len(packed), len(body))
                    self.assertEqual(gzip.decompress(packed), body)
                self.assertEqual(self.get(path, {"Accept-Encoding": accepted, "If-None-Match": fields["etag"]})[0], 304)
            for accepted in ("identity;q=0", "*;q=0", "gzip;q=0, br;q=0, identity;q=0"):
                self.assertEqual(self.get(path, {"Accept-Encoding": accepted})[0], 406, accepted)
            status, fields, plain = self.get("/v1/web/" + name)
            self.assertEqual((status, fields["cache-control"], plain), (200, "no-cache", body), "for pages elsewhere")
            status, fields, _ = self.get(path.replace(path.split("/")[-2], "0123456789abcdef"))
            self.assertEqual((status, fields["cache-control"]), (404, "no-store"), "another version is not this one")

    def test_built_in_page_names_only_what_is_there(self):
        todo = [urllib.parse.urljoin("/lab/horse", url) for url in urls_in(self.page) if "/v1/web/" in url]
        seen = set()
        while todo:
            path = todo.pop()
            if path in seen:
                continue
            seen.add(path)
            status, fields, body = self.get(path)
            self.assertEqual(status, 200, path)
            if path.endswith(".js"):
                todo += [urllib.parse.urljoin(path, url) for url in re.findall(r'"(\./[\w.-]+)"', body.decode())]
        self.assertGreater(len(seen), 3)


class Share(unittest.TestCase):
    """eigencast-broker --share."""

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        (self.folder / "page.html").write_text(PAGE)

    def start(self, *flags, terminal=False):
        """Starts it and returns the link, with the lines before it."""
        out, inner = pty.openpty() if terminal else os.pipe()
        words = [BROKER, "--share", f"--data-dir={self.folder}/data", f"--port-file={self.folder}/port", "--log-level=error",
                 f"--web-folder={self.folder}", *flags]
        self.broker = subprocess.Popen(words, stdout=inner)
        os.close(inner)
        self.addCleanup(self.stop)
        self.addCleanup(os.close, out)
        text = b""
        while not text.endswith(b"\n") or b"#access_token=" not in text:
            piece = os.read(out, 65536)
            self.assertTrue(piece, "the broker ended")
            text += piece
        lines = text.decode().replace("\r", "").split("\n")[:-1]
        return urllib.parse.urlsplit(lines[-1]), lines[:-1]

    def stop(self):
        self.broker.terminate()
        self.assertEqual(self.broker.wait(60), 0)

    def test_link_lets_others_watch_and_nothing_else(self):
        link, _ = self.start("--listen=0.0.0.0:0", "--access-anonymous=nowhere")
        token = link.fragment.removeprefix("access_token=")
        bearer = {"Authorization": "Bearer " + token}
        there = lambda method, target, headers={}, body=None: ask(link.port, method, target, headers, body, host=link.hostname)
        self.assertEqual(there("GET", link.path, HTML)[0], 200, "the page")
        self.assertEqual([there("GET", "/v1/streams")[0], there("GET", "/v1/streams", bearer)[0]], [401, 200])
        self.assertEqual(there("GET", "/v1/subscribe/lab/horse", bearer)[0], 426, "may watch")
        self.assertEqual(there("GET", "/v1/publish/lab/horse", bearer)[0], 403)
        self.assertEqual(there("PUT", "/v1/assets/" + hashlib.sha256(b"x").hexdigest(), bearer, b"x")[0], 403)
        claims = json.loads(base64.urlsafe_b64decode(token.split(".")[1] + "=="))
        self.assertEqual(claims["eigencast"], {"sub": ["**"]})
        self.assertLessEqual(claims["exp"] - time.time(), 12 * 3600)
        self.broker.send_signal(signal.SIGHUP)
        for _ in range(20):
            self.assertEqual(there("GET", "/v1/streams", bearer)[0], 200, "a reload keeps it")

    def test_it_listens_beyond_this_machine(self):
        config = subprocess.run([BROKER, "--share", "--show-config"], check=True, capture_output=True, text=True).stdout
        self.assertRegex(config, r'listen = "0\.0\.0\.0:7490"')
        self.assertNotRegex(config, r'jwt_secret = "[0-9a-f]{8}')
        kept = subprocess.run([BROKER, "--share", "--listen=127.0.0.1:5", "--show-config"], check=True, capture_output=True, text=True).stdout
        self.assertRegex(kept, r'listen = "127\.0\.0\.1:5"')

    def test_without_the_page_it_says_so(self):
        ended = subprocess.run([BROKER, "--share", "--listen=127.0.0.1:0", f"--data-dir={self.folder}/data", "--web-enabled=false"], capture_output=True, text=True)
        self.assertEqual(ended.returncode, 2)
        self.assertIn("web.enabled", ended.stderr)

    def test_terminals_get_a_qr_code(self):
        link, before = self.start("--listen=127.0.0.1:0", terminal=True)
        drawn = [line for line in before if "\033[" in line]
        if not drawn:
            self.skipTest("this broker was built without libqrencode")
        dark = {" ": "00", "\u2584": "01", "\u2580": "10", "\u2588": "11"}
        cells = [[dark[c] for c in re.sub("\033\\[[0-9;]*m", "", line)] for line in drawn]
        rows = ["".join(cell[i] for cell in line) for line in cells for i in (0, 1)]
        width = len(rows[0]) - 8
        self.assertEqual(width % 4, 1, "17 + 4 times the version")
        self.assertTrue(all("1" not in row for row in rows[:4]), "the margin")
        corner = ["1111111", "1000001", "1011101", "1011101", "1011101", "1000001", "1111111"]
        for x, y in ((4, 4), (width - 3, 4), (4, width - 3)):
            self.assertEqual([row[x: x + 7] for row in rows[y: y + 7]], corner)
        self.assertLessEqual(len(rows[0]), 80, "fits a terminal")


if __name__ == "__main__":
    BROKER = str(pathlib.Path(sys.argv.pop(1)).resolve())
    cases.main()
