# SPDX-License-Identifier: MIT
"""Pictures of streams, and streams in notebooks."""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request

from ._library import Error, Status

PATIENCE_S = 30  # Beyond `timeout`: to begin, draw and write.
WHY = {1: Status.IO, 2: Status.INVALID_ARGUMENT, 4: Status.NOT_FOUND}  # eigencast-client's exit statuses.


def picture(url, size=(640, 360), *, view="iso", colour="auto", transparent=False, timeout=30.0, token=None, ca_file=None,
            certificate_file=None, key_file=None, insecure=False):
    """What a stream shows now, as the bytes of a PNG file. Takes about half a second.

      size         (width, height) in pixels
      view         "iso", "front", "back", "left", "right", "top", "bottom"
      colour       as --colour of eigencast-client; transparent: without a background
      timeout      seconds without news after which it gives up
    It is drawn by the program eigencast-client (package eigencast-tools, or EIGENCAST_CLIENT), which needs no display: the picture is the
    viewer's own, no OpenGL comes into this process, and a driver that fails takes nothing with it. Raises Error (NOT_FOUND: there is no such
    program, or no pose came).
    """
    program = os.environ.get("EIGENCAST_CLIENT") or shutil.which("eigencast-client")
    if not program:
        raise Error(Status.NOT_FOUND, "eigencast-client, which draws pictures, is not installed: install eigencast-tools, or name it in EIGENCAST_CLIENT")
    width, height = (int(number) for number in size)
    words = [program, "--headless", "--frames", "1", "--size", f"{width}x{height}", "--view", str(view), "--colour", str(colour), "--wait", str(float(timeout))]
    words += ["--transparent"] * bool(transparent) + ["--insecure"] * bool(insecure)
    for flag, file in (("--ca", ca_file), ("--cert", certificate_file), ("--key", key_file)):
        words += [flag, os.fspath(file)] if file is not None else []
    environment = dict(os.environ) if token is None else {**os.environ, "EIGENCAST_TOKEN": str(token)}  # Others see a program's words.
    with tempfile.TemporaryDirectory(prefix="eigencast-") as folder:
        file = pathlib.Path(folder) / "picture.png"
        try:
            done = subprocess.run([*words, "--screenshot", file, "--", str(url)], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.PIPE, timeout=timeout + PATIENCE_S, check=False)
        except OSError as error:
            raise Error(Status.NOT_FOUND, f"{program} cannot be run: {error}") from error
        except subprocess.TimeoutExpired as error:
            raise Error(Status.IO, f"{program} drew nothing in {timeout + PATIENCE_S:.0f} s") from error
        if done.returncode == 0:
            return file.read_bytes()
        said = done.stderr.decode("utf-8", "replace").strip().splitlines()
        why = next((line for line in reversed(said) if " error " in line), said[-1] if said else f"exit status {done.returncode}")
        raise Error(WHY.get(done.returncode, Status.INTERNAL), f"eigencast-client: {re.sub('^[0-9:.]+ error ', '', why)}")


def _page(url):
    """Of a stream: http://host:port/stream?...&embed=1"""
    scheme, _, rest = str(url).rpartition("://")
    brokers, slash, stream = rest.partition("/")
    first = brokers.split(",")[0]
    if not scheme and not re.search(r":\d+$", first):
        first += ":7490"
    secure = scheme in ("https", "wss")
    return f"http{'s' * secure}://{first}{slash}{stream}{'&' if '?' in stream else '?'}embed=1"


def _takes_frames(page, timeout):
    """Whether the broker lets pages of other origins, such as a notebook's, show its own in a frame (access.origins)."""
    try:
        with urllib.request.urlopen(urllib.request.Request(page, headers={"Accept": "text/html"}), timeout=timeout) as answer:
            policy = answer.headers.get("Content-Security-Policy", "")
    except (urllib.error.URLError, OSError, ValueError):
        return False
    allowed = re.search(r"frame-ancestors([^;]*)", policy)
    return bool(allowed and set(allowed[1].split()) - {"'self'", "'none'"})


class Shown:
    """Pictures in a notebook, each in the place of the one before, drawn by a thread."""

    def __init__(self, url, size, rate_hz, seconds, options):
        from IPython.display import Image, display
        self.pictures = 1  #: So far.
        self.ended = ""  #: Why there are no more.
        self._stop = threading.Event()
        width, height = size

        def image(png):
            return Image(data=png, format="png", width=width, height=height)

        place = display(image(picture(url, size, **options)), display_id=True)

        def draw():
            end = time.monotonic() + seconds
            while not self._stop.wait(1 / rate_hz) and time.monotonic() < end:
                try:
                    place.update(image(picture(url, size, **options)))
                except Error as error:
                    self.ended = str(error)
                    print(f"eigencast.show: {error}", file=sys.stderr)
                    return
                self.pictures += 1
            self.ended = "stopped" if self._stop.is_set() else f"{seconds:g} s are over"

        self._thread = threading.Thread(target=draw, daemon=True)
        self._thread.start()

    def stop(self):
        self._stop.set()

    def wait(self):
        """Until there are no more."""
        self._thread.join()

    def __repr__(self):
        return f"<eigencast.show: {self.pictures} pictures, {self.ended or 'more come until .stop()'}>"


def show(url, size=(640, 360), *, how=None, rate_hz=1.0, seconds=60.0, **options):
    """Shows a stream in a Jupyter notebook.

      how      "page": the broker's page in a frame, live, to turn and zoom; the browser must reach the broker by this URL, and the broker must let
               the notebook's origin: eigencast-broker --access-origins http://localhost:8888
               "pictures": drawn here, so that no browser needs to reach the broker; they replace each other and the last one stays in the notebook
               (default: the page where the broker lets others frame it and no token is needed, else pictures)
      rate_hz, seconds  of pictures: at most so many a second, for so long; math.inf: until .stop()
      options  as of picture()
    Returns an IFrame or a Shown. Raises Error; ValueError (a page cannot be given a token, which the notebook would keep).
    """
    if how not in (None, "page", "pictures"):
        raise ValueError("how must be page or pictures")
    if not rate_hz > 0:
        raise ValueError("rate_hz must be above 0")
    token = options.get("token")
    if how == "page" and token is not None:
        raise ValueError("a page with a token would keep it in the notebook: show pictures")
    page = _page(url)
    if how == "page" or (how is None and token is None and _takes_frames(page, options.get("timeout", 30.0))):
        from IPython.display import IFrame
        return IFrame(page, *size)
    return Shown(url, size, rate_hz, seconds, options)
