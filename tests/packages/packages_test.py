#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The Debian packages on clean machines with systemd: installed, configured, upgraded, removed, purged; and the path of docs/operations.md.

    packages_test.py FOLDER [-v]      FOLDER holds the .deb files of one version (deploy/packages.sh)

Needs what machines.py needs, and lintian. Ends with 77, loudly, where that is unavailable. EIGENCAST_CLEAN_ROOT=FOLDER keeps the clean root
there for the next time.
"""
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/backbone"), str(ROOT / "tests/packages")]
import hosts
import machines

SECTION = "## From packages to a viewer on another machine\n"
DEBS = []
FOLDER = CLEAN_ROOT = None


class OnMachines(unittest.TestCase):
    NAMES = ["broker"]

    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(dir=FOLDER))
        self.network = hosts.Network(self.NAMES).__enter__()
        self.addCleanup(self.network.__exit__)
        self.machines = []
        for host in self.network.hosts.values():
            machine = machines.Machine(CLEAN_ROOT, self.folder, host).__enter__()
            self.addCleanup(machine.__exit__)
            self.machines.append(machine)
        self.run_at = self.machines[0].run

    def says(self, text):
        return self.run_at(text).stdout.strip()

    def property(self, name):
        return self.says(f"systemctl show --value -p {name} eigencast-broker.service")

    def wait_for(self, condition, what, seconds=30):
        for _ in range(seconds * 10):
            if condition():
                return
            time.sleep(0.1)
        self.fail(what + "\n" + self.run_at("systemctl status --no-pager -l eigencast-broker eigencast-broker.socket", check=False).stdout)

    def drop_in(self, text):
        self.run_at("mkdir -p /etc/systemd/system/eigencast-broker.service.d")
        (self.machines[0].root / "etc/systemd/system/eigencast-broker.service.d/test.conf").write_text("[Service]\n" + text)
        self.run_at("systemctl daemon-reload")


class Files(unittest.TestCase):
    def test_lintian_finds_no_error(self):
        done = subprocess.run(["lintian", "--allow-root", "--fail-on", "error", *DEBS], capture_output=True, text=True)
        print(done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


class Packages(OnMachines):
    def test_what_is_installed(self):
        self.run_at("apt install ./*.deb")
        programs = self.says("dpkg -L eigencast-broker eigencast-tools eigencast-igtl | grep ^/usr/bin/eigencast-").split()
        self.assertGreaterEqual(len(programs), 5)
        for program in programs:
            self.assertRegex(self.says(f"{program} --version"), r"eigencast-\w+ \d")
            self.assertEqual(self.says(f"ldd {program} | grep 'not found' || true"), "")
        pages = self.says("dpkg -L eigencast-broker eigencast-tools eigencast-igtl | grep '/man1/.*gz$'").split()
        self.assertGreaterEqual(len(pages), 2)
        for page in pages:
            program = pathlib.Path(page).name.removesuffix(".1.gz")
            manual = self.says(f"zcat {page}").replace("\\-", "-")
            for option in set(re.findall(r"--[a-z-]+", self.says(f"{program} --help-all"))):
                self.assertIn(option, manual)
            for document in set(re.findall(r"(?:docs/|(?=client/|sender/))([\w/-]+\.md)", manual)):
                self.run_at(f"zcat /usr/share/doc/eigencast-*/{document}.gz")
            self.run_at(f"test -s /usr/share/bash-completion/completions/{program} -a -s /usr/share/zsh/vendor-completions/_{program}")
        self.assertEqual(self.says("stat -c '%U %a' /var/lib/eigencast"), "eigencast 750")
        self.assertEqual(self.says("dpkg --verify eigencast-broker eigencast-tools eigencast-igtl libeigencast0 libeigencast-dev python3-eigencast"), "")
        self.assertIn("eigencast-client.desktop", self.says("grep -l model/obj /usr/share/applications/*.desktop"))
        self.run_at("test -s /usr/share/icons/hicolor/scalable/apps/eigencast-client.svg")
        for document in ("operations", "scaling"):
            self.run_at(f"zcat /usr/share/doc/eigencast-broker/{document}.md.gz")
        # What the unit and the packages point at is there.
        for path in re.findall(r"/usr/share/doc/\S+", self.says("systemctl cat eigencast-broker.service")):
            self.run_at(f"test -e {path}")

    def test_python_publishes_and_watches(self):
        self.run_at("apt install ./eigencast-broker_*.deb ./python3-eigencast_*.deb ./libeigencast0_*.deb")
        for name in ("publish.py", "subscribe.py"):
            self.run_at(f"cp /usr/share/doc/python3-eigencast/examples/{name} .")
        self.assertEqual(self.says("python3 -c 'import eigencast; print(eigencast.library_path())'"), "libeigencast.so.0")
        with open(self.folder / "publish.log", "w") as log:
            publishing = self.machines[0].start("python3 publish.py ws://127.0.0.1:7490/lab/sheet", log)
        self.addCleanup(publishing.wait)
        self.addCleanup(publishing.kill)
        seen = self.says("timeout 60 python3 subscribe.py ws://127.0.0.1:7490/lab/sheet").splitlines()
        self.assertEqual(len(seen), 30)
        self.assertRegex(seen[-1], r"^\d+ vertices from .* captured \d+ us ago$")
        self.assertEqual(publishing.wait(30), 0)
        self.assertRegex((self.folder / "publish.log").read_text(), r"sent [1-9]\d* poses")
        self.run_at("apt remove python3-eigencast && test ! -e /usr/lib/python3/dist-packages/eigencast")

    def test_an_upgrade_keeps_what_the_administrator_changed(self):
        self.run_at("apt install ./eigencast-broker_*.deb")
        self.assertEqual(self.says("systemctl is-active eigencast-broker"), "active")
        before = self.property("MainPID")
        self.run_at("echo '# changed by the administrator' >>/etc/eigencast/eigencast.toml; touch /var/lib/eigencast/kept")
        tree = self.folder / "tree"
        subprocess.run(["dpkg-deb", "-R", next(d for d in DEBS if d.name.startswith("eigencast-broker")), tree], check=True)
        control = tree / "DEBIAN/control"
        control.write_text(re.sub(r"^Version: .*", "Version: 99.0-1", control.read_text(), flags=re.M))
        with open(tree / "etc/eigencast/eigencast.toml", "a") as file:
            file.write("# a new comment upstream\n")
        subprocess.run("md5sum $(find . -type f -not -path './DEBIAN/*' -printf '%P ') >DEBIAN/md5sums", shell=True, cwd=tree, check=True)
        subprocess.run(["dpkg-deb", "-b", tree, self.machines[0].home / "newer.deb"], check=True, capture_output=True)
        self.run_at("apt install ./newer.deb")
        self.assertEqual(self.says("systemctl is-active eigencast-broker"), "active")
        self.assertNotEqual(self.property("MainPID"), before, "the new program runs")
        self.assertIn("changed by the administrator", self.says("cat /etc/eigencast/eigencast.toml"))
        self.run_at("test -e /etc/eigencast/eigencast.toml.dpkg-dist; test -e /var/lib/eigencast/kept")

        self.run_at("apt remove eigencast-broker")
        self.run_at("test ! -e /usr/bin/eigencast-broker; test -e /etc/eigencast/eigencast.toml; test -e /var/lib/eigencast/kept")
        self.assertEqual(self.run_at("systemctl is-active eigencast-broker", check=False).stdout.strip(), "inactive")
        self.run_at("apt purge eigencast-broker")
        self.run_at("test ! -e /etc/eigencast; test ! -e /var/lib/eigencast; test ! -e /var/log/eigencast")
        self.assertEqual(self.run_at("systemctl list-unit-files --no-legend 'eigencast*'", check=False).stdout, "")
        self.assertEqual(self.says("find /etc/systemd -name 'eigencast*'"), "", "no dangling links")


class Unit(OnMachines):
    def setUp(self):
        super().setUp()
        self.run_at("apt install ./eigencast-broker_*.deb curl openssl")

    def ready(self):
        return self.run_at("curl -fsS http://127.0.0.1:7491/readyz", check=False).stdout.strip() == "ready"

    def test_it_runs_as_nobody_else_and_reloads(self):
        self.assertTrue(self.ready())
        pid = self.property("MainPID")
        status = self.says(f"cat /proc/{pid}/status")
        self.assertRegex(status, r"CapEff:\s0+\n")
        self.assertRegex(status, r"NoNewPrivs:\s1\n")
        self.assertEqual(self.says(f"stat -c %U /proc/{pid}"), "eigencast")
        self.assertEqual(self.property("NotifyAccess"), "main")
        self.assertIn("streams", self.property("StatusText"))
        self.assertRegex(self.says("systemd-analyze security --no-pager eigencast-broker | tail -n 1"), r"level.*: (0|1\.[0-7])\b")
        self.run_at("systemctl reload eigencast-broker")
        self.assertEqual(self.property("MainPID"), pid)
        self.assertTrue(self.ready())
        self.run_at("systemctl stop eigencast-broker")
        self.assertEqual(self.property("Result"), "success")

    def test_the_watchdog_restarts_a_broker_that_hangs(self):
        self.drop_in("WatchdogSec=2\n")
        self.run_at("systemctl restart eigencast-broker")
        pid = self.property("MainPID")
        time.sleep(5)
        self.assertEqual(self.property("MainPID"), pid, "it says that it turns")
        self.run_at(f"kill -STOP {pid}")
        self.wait_for(lambda: self.property("NRestarts") == "1" and self.property("MainPID") not in ("0", pid) and self.ready(), "no restart")

    def test_a_key_of_root_arrives_as_credential(self):
        self.run_at("umask 077; openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost "
                    "-addext subjectAltName=DNS:localhost -keyout own.key -out own.pem; cp own.pem /etc/eigencast/own.pem; "
                    "chmod 644 /etc/eigencast/own.pem; printf '[tls]\\ncertificate = \"own.pem\"\\nkey = \"tls.key\"\\n' >/etc/eigencast/eigencast.toml")
        self.drop_in(f"LoadCredential=tls.key:/{machines.HOME}/own.key\n")
        self.run_at("systemctl restart eigencast-broker")
        self.run_at("curl -fsS --cacert own.pem https://localhost:7490/v1/streams")

    def test_with_the_socket_a_restart_refuses_nobody(self):
        self.run_at("systemctl disable --now eigencast-broker.service && systemctl enable --now eigencast-broker.socket")
        self.assertEqual(self.run_at("systemctl is-active eigencast-broker.service", check=False).stdout.strip(), "inactive")
        self.run_at("curl -fsS http://127.0.0.1:7490/v1/streams")
        pid = self.property("MainPID")
        answers = self.says("(sleep 0.3; systemctl restart eigencast-broker.service) & for i in $(seq 60); do curl -s --max-time 10 -o /dev/null "
                            "-w '%{http_code}\\n' http://127.0.0.1:7490/v1/streams; sleep 0.02; done; wait")
        self.assertNotEqual(self.property("MainPID"), pid)
        self.assertEqual(set(answers.split()), {"200"})


def commands_of(text):
    """The indented lines of a text, as one script."""
    return "\n".join(line[4:] for line in text.splitlines() if line.startswith("    "))


class Stranger(OnMachines):
    """An operator that knows nothing but docs/operations.md."""

    NAMES = ["broker", "sender", "viewer"]

    def test_from_packages_to_a_viewer_on_another_machine(self):
        section = (ROOT / "docs/operations.md").read_text().split(SECTION, 1)[1].split("\n## ", 1)[0].split("\nThen point Prometheus", 1)[0]
        parts = re.split(r"\*\*On the (\w+)'s machine\*\*", section)
        script = {machine: commands_of(text) for machine, text in zip(parts[1::2], parts[2::2])}
        self.assertEqual(list(script), ["broker", "sender", "viewer"])
        broker, sender, viewer = self.machines
        copies = re.findall(r"((?:`[^`]+`(?: and )?)+) to the (\w+)'s", section)
        self.assertEqual([to for _, to in copies], ["sender", "viewer"])

        broker.run(script["broker"])
        for files, to in copies:
            for file in re.findall(r"`([^`]+)`", files):
                shutil.copy(broker.home / file, {"sender": sender, "viewer": viewer}[to].home)
        with open(self.folder / "sender.log", "w") as log:
            streaming = sender.start(script["sender"], log)
            self.addCleanup(streaming.wait)
            self.addCleanup(streaming.kill)
            self.wait_for(lambda: '"live"' in broker.run("curl -s http://127.0.0.1:7491/api/streams", check=False).stdout or
                          "live" in broker.run("journalctl -u eigencast-broker -n 50", check=False).stdout or streaming.poll() is not None,
                          "no stream", 120)
            self.assertIsNone(streaming.poll(), (self.folder / "sender.log").read_text())
            viewer.run(script["viewer"])
        pictures = sorted((viewer.home / "pictures").glob("*.png"))
        self.assertEqual(len(pictures), 30)
        self.assertGreater(pictures[-1].stat().st_size, 5_000, "a picture of something")
        report = json.loads((viewer.home / "report.json").read_text())
        print("  report of the viewer:", {k: report[k] for k in list(report)[:8]})

        # And nobody else: not without a token, not with the wrong one, not past an unknown authority.
        client = "eigencast-client wss://broker.example.org:7490/{} {} --headless --frames 1 --out none"
        for stream, words, complaint in (("lab/heart", "--ca tls.pem", "token"), ("other", "--token @anna.token --ca tls.pem", "subscribe|right"),
                                         ("lab/heart", "--token @anna.token", "authorit")):
            refused = viewer.run("timeout 20 " + client.format(stream, words), check=False)
            self.assertNotEqual(refused.returncode, 0)
            self.assertRegex(refused.stderr, complaint)


def main():
    global FOLDER, CLEAN_ROOT
    DEBS.extend(sorted(pathlib.Path(sys.argv.pop(1)).resolve().glob("*.deb")))
    if not DEBS:
        print("SKIPPED: no packages there; deploy/packages.sh makes them")
        return 77
    why = hosts.available() or machines.missing() or ("" if shutil.which("lintian") else "no lintian")
    if why:
        print(f"SKIPPED: {why}")
        return 77
    with tempfile.TemporaryDirectory(prefix="eigencast-packages-") as folder:
        FOLDER = pathlib.Path(folder)
        CLEAN_ROOT = pathlib.Path(os.environ.get("EIGENCAST_CLEAN_ROOT", FOLDER / "root"))
        try:
            machines.make_root(CLEAN_ROOT, DEBS, ["curl", "openssl", "libgl1-mesa-dri"])
        except machines.NoRoot as error:
            print(f"SKIPPED: no clean root could be made (no package mirror?): {error}")
            return 77
        return 0 if unittest.main(verbosity=2, warnings="ignore", exit=False).result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
