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
import tomllib
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
sys.path.insert(0, str(ROOT / "tests/support"))
import cases
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


def image():
    """The command and the environment that the container's image brings."""
    text = (DEPLOY / "container/Containerfile").read_text()
    return json.loads(re.search(r"^ENTRYPOINT (.*)$", text, re.M)[1]), dict(re.findall(r"\b(EIGENCAST_\w+)=(\S+)", text))


def make_key(public):
    """The public half of a new key that signs tokens."""
    key = public + ".private"
    subprocess.run(["openssl", "ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", key], check=True, capture_output=True)
    subprocess.run(["openssl", "ec", "-in", key, "-pubout", "-out", public], check=True, capture_output=True)


def make_certificate(certificate, key):
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2", "-subj",
                    "/CN=localhost", "-keyout", key, "-out", certificate], check=True, capture_output=True)


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

    def test_every_alert_is_tested(self):
        named = lambda word, file: set(re.findall(rf"{word}: (Eigencast\w+)", (DEPLOY / "prometheus" / file).read_text()))
        self.assertEqual(named("alertname", "eigencast.rules.test.yml"), named("alert", "eigencast.rules.yml"))

    def test_rules_and_scraping_name_the_same_job(self):
        asked = set(re.findall(r'job="([\w-]+)"', (DEPLOY / "prometheus/eigencast.rules.yml").read_text()))
        self.assertEqual(len(asked), 1)
        for file in ("deploy/prometheus/prometheus.yml", "docs/operations.md"):
            self.assertEqual(set(re.findall(r"job_name: ([\w-]+)", (ROOT / file).read_text())), asked, file)

    def test_autoscaling_names_a_metric_that_exists(self):
        self.assert_known("the autoscaler", re.findall(r"metric: \{name: (\w+)\}", (DEPLOY / "kubernetes/hpa.yaml").read_text()))

    def settings_of(self, words, environment, folder):
        """What a broker has in force when started so, after it has found no fault with it."""
        where = {"env": {**os.environ, **environment}, "cwd": folder, "capture_output": True, "text": True}
        checked = subprocess.run([BROKER, *words, "--check-config"], **where)
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
        return tomllib.loads(subprocess.run([BROKER, *words, "--show-config"], **where).stdout)

    def test_a_pod_has_the_config_map_settings(self):
        text = (DEPLOY / "kubernetes/configmap.yaml").read_text().split("eigencast.toml: |\n", 1)[1]
        toml = "\n".join(line.removeprefix("    ") for line in text.splitlines())
        arguments = re.search(r"^ +args: (\[.*\])$", (DEPLOY / "kubernetes/statefulset.yaml").read_text(), re.M)
        entry, environment = image()
        words = entry[1:] + (json.loads(arguments[1]) if arguments else [])
        # Kubernetes adds its own for each service of the namespace.
        environment |= {"EIGENCAST_BROKER_SERVICE_HOST": "10.0.0.1", "EIGENCAST_BROKER_PORT": "tcp://10.0.0.1:7490", "EIGENCAST_BROKER_PORT_7490_TCP_PORT": "7490"}
        with tempfile.TemporaryDirectory() as folder:
            make_key(f"{folder}/main.pem")
            make_certificate(f"{folder}/nats-ca.pem", f"{folder}/nats-ca.key")
            (pathlib.Path(folder) / "nats.creds").touch(0o600)
            toml = toml.replace("/keys/", f"{folder}/")
            (pathlib.Path(folder) / "eigencast.toml").write_text(toml)
            shown = self.settings_of([word.replace("/etc/eigencast/", "") for word in words], environment, folder)
        wanted = tomllib.loads(toml)
        wanted["access"].pop("jwt_keys")
        for section, settings in wanted.items():
            self.assertEqual({key: shown[section][key] for key in settings}, settings, section)
        self.assertTrue(wanted["server"]["admin_listen"].startswith("0.0.0.0:"), "the kubelet asks from outside of the pod")
        self.assertTrue(wanted["access"]["monitors"], "Prometheus and the autoscaler read the admin port without a token")
        self.assertEqual(wanted["access"]["anonymous"], "nowhere")
        self.assertTrue(all(server.startswith("tls://") for server in wanted["backbone"]["servers"]))

    def test_a_pod_may_hold_what_the_quotas_let_in(self):
        defaults = tomllib.loads(subprocess.run([BROKER, "--default-config"], capture_output=True, text=True, check=True).stdout)
        limits = defaults["limits"]
        # As much again of streams is for what is encoded, and recorder and history have a queue each.
        quotas = (2 * limits["max_stream_bytes"] + limits["max_unfinished_bytes"] + defaults["memory"]["max_bytes"] +
                  defaults["rooms"]["max_bytes"] + 2 * defaults["recording"]["max_queued_bytes"])
        limit = re.search(r"limits: \{memory: (\d+)Gi\}", (DEPLOY / "kubernetes/statefulset.yaml").read_text())
        self.assertGreater(int(limit[1]) << 30, quotas)

    def test_a_container_has_the_compose_settings(self):
        entry, environment = image()
        said = dict(re.findall(r"^ +(EIGENCAST_\w+): (\S+)$", (DEPLOY / "container/compose.yaml").read_text(), re.M))
        with tempfile.TemporaryDirectory() as folder:
            make_key(f"{folder}/main.pem")
            given = {"EIGENCAST_ACCESS__JWT_KEYS": f"main ES256 {folder}/main.pem"}  # As the file's head tells people to.
            shutil.copy(DEPLOY / "eigencast.toml", folder)
            shown = self.settings_of([word.replace("/etc/eigencast/", "") for word in entry[1:]], environment | said | given, folder)
        self.assertEqual(shown["server"]["admin_listen"], said["EIGENCAST_SERVER__ADMIN_LISTEN"])
        self.assertEqual(shown["access"]["monitors"], [said["EIGENCAST_ACCESS__MONITORS"]])
        targets = re.search(r'targets: \["(\w+):7491"\]', (DEPLOY / "prometheus/prometheus.yml").read_text())
        self.assertEqual(shown["access"]["hosts"], [targets[1]], "Prometheus asks for the broker by this name")
        self.assertEqual(shown["proxy"]["trusted"], [said["EIGENCAST_PROXY__TRUSTED"]])


@unittest.skipUnless(shutil.which("promtool"), "no promtool (Debian: prometheus)")
class Prometheus(unittest.TestCase):
    def test_prometheus_takes_the_rules(self):
        for command in (["check", "rules", "eigencast.rules.yml"], ["test", "rules", "eigencast.rules.test.yml"]):
            done = subprocess.run(["promtool", *command], cwd=DEPLOY / "prometheus", capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_prometheus_takes_its_configuration(self):
        done = subprocess.run(["promtool", "check", "config", "prometheus.yml"], cwd=DEPLOY / "prometheus", capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


@unittest.skipUnless(shutil.which("nginx"), "no nginx")
class Nginx(unittest.TestCase):
    def test_nginx_takes_the_site_of_compose(self):
        with tempfile.TemporaryDirectory() as folder:
            make_certificate(f"{folder}/tls.crt", f"{folder}/tls.key")
            site = (DEPLOY / "container/nginx.conf").read_text()
            self.assertIn("http://broker:7490/", site)
            site = site.replace("http://broker:", "http://127.0.0.1:").replace("/etc/nginx/tls/", f"{folder}/")
            conf = pathlib.Path(folder, "nginx.conf")
            kept = "".join(f"{what}_temp_path {folder}/{what};\n" for what in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
            conf.write_text(f"pid {folder}/pid;\nevents {{}}\nhttp {{\naccess_log off;\n{kept}{site}}}\n")
            done = subprocess.run(["nginx", "-t", "-c", conf, "-e", "stderr", "-p", folder], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)


@unittest.skipUnless(shutil.which("node"), "no node")
class Manifests(unittest.TestCase):
    def test_manifests_fit_published_schemas(self):
        done = subprocess.run(["node", ROOT / "tests/deploy/validate.mjs", DEPLOY], capture_output=True, text=True,
                              env={**os.environ, "NODE_PATH": os.environ.get("NODE_PATH", str(ROOT / "build/tools/node/node_modules"))})
        if done.returncode == 77:
            self.skipTest(f"{done.stdout.strip()}; deploy/install-packages.sh fetches it with npm")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


if __name__ == "__main__":
    BROKER = sys.argv.pop(1)
    cases.main()
