#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""eigencast.show() in the notebooks of Debian's Jupyter: pictures that replace each other, and the broker's page in a frame.

Usage: notebook_test.py BROKER LIBRARY PACKAGE_FOLDER CLIENT. Without Jupyter it fails: deploy/install-packages.sh full installs it.
"""
import base64
import hashlib
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import unittest

import numpy

BROKER, os.environ["EIGENCAST_LIBRARY"], PACKAGE, os.environ["EIGENCAST_CLIENT"] = sys.argv[1:5]
os.environ["PYTHONPATH"] = PACKAGE
os.environ["PATH"] = "/usr/bin:" + os.environ["PATH"]  # The python3 that the kernel's package means.
sys.dont_write_bytecode = True
sys.path.insert(0, PACKAGE)
import eigencast  # noqa: E402


class Notebook(unittest.TestCase):
    def setUp(self):
        self.folder_keeper = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder_keeper.cleanup)
        self.folder = pathlib.Path(self.folder_keeper.name)

    def start(self, *options):
        """A broker, and a sheet that turns from pose to pose; gives the URL."""
        port = self.folder / "port"
        broker = subprocess.Popen([BROKER, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--port-file", port, "--data-dir",
                                   self.folder / "assets", *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(broker.wait)
        self.addCleanup(broker.terminate)
        end = time.monotonic() + 60
        while not port.exists() or not port.read_text().endswith("\n"):
            self.assertLess(time.monotonic(), end, "the broker did not start")
            time.sleep(0.02)
        url = "http://127.0.0.1:" + port.read_text().split()[0] + "/sheet"
        y, x = numpy.mgrid[0:12, 0:12].astype(numpy.float32) / 12
        self.points = numpy.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
        corner = (numpy.arange(11)[:, None] * 12 + numpy.arange(11)).ravel()
        self.stream = eigencast.Stream(url, rank=40, cache_dir="")
        self.addCleanup(self.stream.close)
        self.stream.send(self.points, numpy.stack([corner, corner + 1, corner + 13, corner + 12], axis=1))
        self.assertTrue(self.stream.wait_live())
        return url

    def cells(self, *sources):
        """Runs a notebook, moving the sheet meanwhile; gives the outputs of each cell."""
        made, done = self.folder / "made.ipynb", self.folder / "done.ipynb"
        made.write_text(json.dumps({"nbformat": 4, "nbformat_minor": 5, "metadata": {"kernelspec": {"name": "python3", "display_name": "", "language": "python"}},
                                    "cells": [{"cell_type": "code", "id": f"c{i}", "metadata": {}, "execution_count": None, "outputs": [], "source": source}
                                              for i, source in enumerate(sources)]}))
        with subprocess.Popen(["jupyter", "nbconvert", "--to", "notebook", "--execute", made, "--output", done], stdin=subprocess.DEVNULL,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                              env={**os.environ, "HOME": str(self.folder)}) as running:
            angle = 0.0
            while running.poll() is None:
                angle += 0.1
                turned = self.points @ numpy.array([[numpy.cos(angle), 0, -numpy.sin(angle)], [0, 1, 0], [numpy.sin(angle), 0, numpy.cos(angle)]])
                self.stream.send(turned)
                time.sleep(0.05)
            self.assertEqual(running.returncode, 0, running.stdout.read())
        return [cell["outputs"] for cell in json.loads(done.read_text())["cells"]]

    def test_pictures_replace_each_other(self):
        url = self.start()
        shown, counted = self.cells("import hashlib, math, time, eigencast, eigencast._picture as module\ndraw, drawn = module.picture, []\n"
                                    "module.picture = lambda *given, **named: drawn.append(draw(*given, **named)) or drawn[-1]\n"
                                    f"shown = eigencast.show({url!r}, (160, 100), rate_hz=20, seconds=math.inf)\n"
                                    "while shown.pictures < 3 and not shown.ended: time.sleep(0.05)\nshown.stop(); shown.wait()\n"
                                    "print(shown.ended, len(set(drawn)) > 1, hashlib.sha256(drawn[-1]).hexdigest())",
                                    f"eigencast.picture({url!r}, (160, 100))[:4]")
        pictures = [output for output in shown if "image/png" in output.get("data", {})]
        self.assertEqual(len(pictures), 1, "in one place")
        png = base64.b64decode("".join(pictures[0]["data"]["image/png"]))
        self.assertEqual((png[:8], png[16:24]), (b"\x89PNG\r\n\x1a\n", (160).to_bytes(4, "big") + (100).to_bytes(4, "big")))
        self.assertEqual(["".join(output["text"]) for output in shown if output["output_type"] == "stream"], [f"stopped True {hashlib.sha256(png).hexdigest()}\n"])
        self.assertIn("PNG", "".join(counted[0]["data"]["text/plain"]))

    def test_the_page_is_framed_where_the_broker_lets_it(self):
        url = self.start("--access-origins", "http://localhost:8888")
        framed, refused = self.cells(f"import eigencast\neigencast.show({url!r}, (320, 200))",
                                     f"try:\n    eigencast.show({url!r}, how='page', token='secret')\nexcept ValueError as error:\n    print(error)")
        self.assertIn(f'src="{url}?embed=1"', "".join(framed[0]["data"]["text/html"]).replace("&amp;", "&"))
        self.assertIn("token", "".join(refused[0]["text"]))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
