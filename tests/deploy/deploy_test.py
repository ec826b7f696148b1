#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""What deploy/ ships, held against the broker and against outside checkers.

    deploy_test.py BROKER [-v]
"""
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
sys.path.insert(0, str(ROOT / "tests/support"))
from websocket_peer import ports_of

BROKER = None
SUFFIXES = ("_bucket", "_sum", "_count", "")
OURS = re.compile(r"\b((?:eigencast_broker|process)_[a-z_]+)\b")


def metrics_of_a_broker():
    with tempfile.TemporaryDirectory(prefix="eigencast-deploy-") as folder:
        ports = pathlib.Path(folder) / "ports"
        broker = subprocess.Popen([BROKER, "--listen=127.0.0.1:0", "--admin-listen=127.0.0.1:0", f"--data-dir={folder}",
                                   f"--port-file={ports}", "--log-level=error"])
        try:
            _, admin = ports_of(ports)
            text = urllib.request.urlopen(f"http://127.0.0.1:{admin}/metrics").read().decode()
        finally:
            broker.terminate()
            broker.wait(20)
    return {line.split()[2] for line in text.splitlines() if line.startswith("# TYPE")}


class Deploy(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.metrics = metrics_of_a_broker()

    def assert_known(self, where, expressions):
        used = {name for expression in expressions for name in OURS.findall(expression)}
        self.assertTrue(used)
        unknown = {name for name in used if not any(name.removesuffix(suffix) in self.metrics for suffix in SUFFIXES)}
        self.assertEqual(unknown, set(), f"{where} asks for metrics that the broker does not have")

    def test_dashboard_names_metrics_that_exist(self):
        board = json.loads((DEPLOY / "grafana/eigencast-broker.json").read_text())
        expressions = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
        expressions += [variable["query"] for variable in board["templating"]["list"] if variable["type"] == "query"]
        self.assert_known("the dashboard", expressions)

    def test_rules_name_metrics_that_exist(self):
        self.assert_known("the rules", re.findall(r"expr: (.*)", (DEPLOY / "prometheus/eigencast.rules.yml").read_text()))

    def test_autoscaling_names_a_metric_that_exists(self):
        self.assert_known("the autoscaler", re.findall(r"metric: \{name: (\w+)\}", (DEPLOY / "kubernetes/hpa.yaml").read_text()))

    def test_prometheus_takes_the_rules(self):
        if not shutil.which("promtool"):
            self.skipTest("SKIPPED: no promtool (Debian: prometheus)")
        for command in (["check", "rules", "eigencast.rules.yml"], ["test", "rules", "eigencast.rules.test.yml"]):
            done = subprocess.run(["promtool", *command], cwd=DEPLOY / "prometheus", capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_prometheus_takes_its_configuration(self):
        if not shutil.which("promtool"):
            self.skipTest("SKIPPED: no promtool (Debian: prometheus)")
        done = subprocess.run(["promtool", "check", "config", "prometheus.yml"], cwd=DEPLOY / "prometheus", capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_the_broker_takes_the_configuration_of_kubernetes(self):
        text = (DEPLOY / "kubernetes/configmap.yaml").read_text().split("eigencast.toml: |\n", 1)[1]
        toml = "\n".join(line.removeprefix("    ") for line in text.splitlines())
        with tempfile.TemporaryDirectory() as folder:
            key, public = f"{folder}/key.pem", f"{folder}/main.pem"
            subprocess.run(["openssl", "ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", key], check=True, capture_output=True)
            subprocess.run(["openssl", "ec", "-in", key, "-pubout", "-out", public], check=True, capture_output=True)
            file = pathlib.Path(folder) / "eigencast.toml"
            file.write_text(toml.replace("/keys/main.pem", public))
            done = subprocess.run([BROKER, "--config", file, "--check-config"], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
            shown = subprocess.run([BROKER, "--config", file, "--show-config"], capture_output=True, text=True).stdout
            self.assertRegex(shown, r'monitors = \["', "Prometheus and the autoscaler read the admin port without a token")

    def test_manifests_fit_published_schemas(self):
        if not shutil.which("node"):
            self.skipTest("SKIPPED: no node")
        done = subprocess.run(["node", ROOT / "tests/deploy/validate.mjs", DEPLOY], capture_output=True, text=True, env=os.environ)
        if done.returncode == 77:
            self.skipTest(f"{done.stdout.strip()} (tests/deploy/validate.mjs says what to install)")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    unittest.main(verbosity=2, warnings="ignore")
