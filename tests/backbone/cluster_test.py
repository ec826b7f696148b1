#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Three brokers over three NATS servers, each on a host of its own, while machines die, cables are pulled and senders move.

    cluster_test.py FOLDER-OF-PROGRAMS [-v]

Skipped without root, network namespaces or nats-server.
"""
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "bench/broker"), str(pathlib.Path(__file__).parent)]
import cases
import hosts
from viewer import Viewer

PROGRAMS = None
DATA_PORT, ADMIN_PORT = 7490, 7491


class Cluster(unittest.TestCase):
    NATS = ["n1", "n2", "n3"]
    BROKERS = ["b1", "b2", "b3"]

    def setUp(self):
        why = hosts.available() or ("" if shutil.which("nats-server") else "no nats-server")
        if why:
            self.skipTest(f"{why}")
        self.folder = tempfile.TemporaryDirectory(prefix="eigencast-cluster-")
        self.addCleanup(self.clean_folder)
        self.network = hosts.Network(self.NATS + self.BROKERS).__enter__()
        self.addCleanup(self.network.__exit__)  # Ends what runs on them.
        self.hosts = self.network.hosts
        self.processes, self.viewers, self.senders = {}, [], []
        self.addCleanup(self.end_viewers)
        for name in self.NATS:
            self.start_nats(name)
        for name in self.BROKERS:
            self.start_broker(name)
        for name in self.BROKERS:
            self.wait_for(lambda: self.metric(name, "eigencast_broker_backbone_connected") == 1 and
                          self.metric(name, "eigencast_broker_backbone_brokers") == len(self.BROKERS), 60, f"{name} meets the others")

    def end_viewers(self):
        for viewer in self.viewers:
            viewer.over = True

    def clean_folder(self):
        if os.environ.get("KEEP"):
            print("kept", shutil.copytree(self.folder.name, "/tmp/eigencast-cluster-kept", dirs_exist_ok=True))
        self.folder.cleanup()

    # ---- Machines ----

    def path(self, name):
        return pathlib.Path(self.folder.name) / name

    def log_of(self, name):
        return open(self.path(name.replace("/", "-") + ".log"), "a")

    def start_nats(self, name):
        routes = ", ".join(f'"nats://{self.hosts[other].address}:6222"' for other in self.NATS)
        config = self.path(f"{name}.conf")
        config.write_text(f"""
server_name: {name}
listen: "{self.hosts[name].address}:4222"
http: "{self.hosts[name].address}:8222"
jetstream {{ store_dir: "{self.path(name)}", max_memory_store: 64MB, max_file_store: 256MB }}
cluster {{ name: eigencast, listen: "{self.hosts[name].address}:6222", routes: [{routes}] }}
""")
        self.processes[name] = self.hosts[name].run("nats-server", "-c", config, stdout=self.log_of(name), stderr=self.log_of(name))

    def start_broker(self, name):
        servers = ",".join(f"nats://{self.hosts[n].address}:4222" for n in self.NATS)
        self.processes[name] = self.hosts[name].run(
            PROGRAMS / "eigencast-broker", f"--listen=127.0.0.1:{DATA_PORT}", f"--admin-listen=127.0.0.1:{ADMIN_PORT}",
            f"--data-dir={self.path(name)}", f"--backbone-servers={servers}", "--backbone-replicas=3", stdout=self.log_of(name),
            stderr=self.log_of(name))

    def nats_is_healthy(self, name):
        """Its part of JetStream has caught up with the others."""
        try:
            with self.hosts[name].within():
                return urllib.request.urlopen(f"http://{self.hosts[name].address}:8222/healthz", timeout=2).status == 200
        except OSError:
            return False

    def wait_for_nats(self):
        for name in self.NATS:
            self.wait_for(lambda: self.nats_is_healthy(name), 60, f"NATS server {name} is healthy")

    def kill(self, name):
        os.kill(self.processes[name].pid, signal.SIGKILL)
        self.processes[name].wait()

    def start_sender(self, broker, stream, surface="torus"):
        process = self.hosts[broker].run(PROGRAMS / "eigencast-sender", "--no-progress", "play", "--wait", surface, "--rate", "30", "--to",
                                         f"ws://127.0.0.1:{DATA_PORT}/{stream}", stdout=self.log_of(f"sender-{stream}"),
                                         stderr=self.log_of(f"sender-{stream}"), env={**os.environ, "XDG_CACHE_HOME": str(self.path("cache"))})
        self.senders.append(process)
        return process

    def watch(self, broker, stream):
        viewer = Viewer([DATA_PORT], stream, raw=True, within=self.hosts[broker].within)
        viewer.broker = broker
        self.viewers.append(viewer)
        return viewer

    def metric(self, broker, name):
        try:
            with self.hosts[broker].within():
                text = urllib.request.urlopen(f"http://127.0.0.1:{ADMIN_PORT}/metrics", timeout=2).read().decode()
        except OSError:
            return None
        return next((float(line.split()[-1]) for line in text.splitlines() if line.split()[:1] == [name]), None)

    def busiest_nats(self):
        """The NATS server at which most brokers are."""
        peers = "".join(subprocess.run(["ip", "netns", "exec", self.hosts[broker].space, "ss", "-tnH", "state", "established", "dport = :4222"],
                                       check=True, capture_output=True, text=True).stdout for broker in self.BROKERS)
        return max(self.NATS, key=lambda name: peers.count(f"{self.hosts[name].address}:4222"))

    def wait_for(self, condition, seconds, what):
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            if condition():
                return time.monotonic() - began
            time.sleep(0.05)
        logs = "\n".join(f"--- {p.name}\n{p.read_text()[-1500:]}" for p in sorted(pathlib.Path(self.folder.name).glob("*.log")))
        self.fail(f"{what}: not within {seconds} s\n{logs}")

    def goes_on(self, viewers, what):
        """Each gets two seconds' worth of frames more."""
        counts = [viewer.frames for viewer in viewers]
        took = self.wait_for(lambda: all(v.frames > n + 60 for v, n in zip(viewers, counts)), 60, f"{what}: all go on")
        print(f"  {what}: two seconds of frames more within {took:.1f} s")

    def assert_clean(self):
        for viewer in self.viewers:
            self.assertEqual(viewer.faults, [], f"{viewer.stream} at {viewer.broker}")

    # ---- What must hold ----

    def test_frames_go_on_whatever_dies(self):
        self.start_sender("b1", "lab/one")
        self.start_sender("b2", "lab/two", "heart")
        one = [self.watch(b, "lab/one") for b in self.BROKERS]
        two = [self.watch(b, "lab/two") for b in self.BROKERS]
        self.goes_on(one + two, "both streams at all brokers")
        self.assertEqual(len({v.epoch for v in one}), 1)

        for victim in self.NATS[:2]:
            self.kill(victim)
            self.goes_on(one + two, f"NATS server {victim} killed")
            self.start_nats(victim)
            self.wait_for_nats()  # The cluster heals before the next one dies.

        # A server that goes silent instead of dying: its brokers get no notice.
        victim = self.busiest_nats()
        self.hosts[victim].link("down")
        self.goes_on(one + two, f"cable of NATS server {victim} pulled")
        self.hosts[victim].link("up")
        self.wait_for_nats()

        self.kill("b3")
        self.goes_on([v for v in one + two if v.broker != "b3"], "broker b3 killed")
        self.start_broker("b3")
        self.goes_on(one + two, "broker b3 started again")

        # The streams of b2 go on at b2, others stop there and go on when the cable is plugged in again.
        self.hosts["b2"].link("down")
        self.wait_for(lambda: self.metric("b2", "eigencast_broker_backbone_connected") == 0, 60, "b2 notices")
        self.goes_on([one[0], one[2], two[1]], "cable of b2 pulled")
        self.hosts["b2"].link("up")
        self.goes_on(one + two, "cable of b2 plugged in")
        self.assert_clean()

    def test_a_sender_moves(self):
        sender = self.start_sender("b1", "lab/one")
        viewers = [self.watch(b, "lab/one") for b in self.BROKERS]
        self.goes_on(viewers, "one sender")
        for target in ("b2", "b3", "b1"):
            epoch = max(v.epoch for v in viewers)
            sender.send_signal(signal.SIGKILL)
            sender.wait()
            moved = time.monotonic()
            sender = self.start_sender(target, "lab/one")
            self.wait_for(lambda: all(v.epoch > epoch for v in viewers), 60, f"frames of the sender at {target}")
            print(f"  moved to {target}: seen by all after {time.monotonic() - moved:.1f} s")
        self.assertEqual(len({v.epoch for v in viewers}), 1)
        # Its broker dies, it goes elsewhere.
        epoch = viewers[1].epoch
        self.kill("b1")
        sender.kill()
        sender = self.start_sender("b2", "lab/one")
        tries = [sender]

        def moved_over():
            if tries[-1].poll() is not None:  # Refused while b1 may still be alive.
                tries.append(self.start_sender("b2", "lab/one"))
                time.sleep(0.5)
            return all(v.epoch > epoch for v in viewers[1:])
        took = self.wait_for(moved_over, 60, "the sender's new broker takes over")
        print(f"  its broker killed: taken over after {took:.1f} s")
        self.assert_clean()

    def test_two_senders_at_once(self):
        first, second = self.start_sender("b1", "lab/one"), self.start_sender("b2", "lab/one")
        viewers = [self.watch(b, "lab/one") for b in self.BROKERS]
        self.wait_for(lambda: all(v.frames for v in viewers) and len({v.epoch for v in viewers}) == 1, 60, "one of the two wins")
        self.goes_on(viewers, "one of two senders")
        self.assertEqual(len({v.epoch for v in viewers}), 1, "all watch the same of the two")
        owned = [self.metric(b, "eigencast_broker_backbone_frames_published_total") > 0 for b in self.BROKERS[:2]]
        self.assertEqual(sum(owned), 1)
        self.assert_clean()


class Undone(unittest.TestCase):
    def test_a_network_that_cannot_be_made_leaves_nothing(self):
        why = hosts.available()
        if why:
            self.skipTest(f"{why}")
        network = hosts.Network(["fine", "a-name-too-long-for-an-interface"])
        self.assertRaises(subprocess.CalledProcessError, network.__enter__)
        spaces = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True).stdout
        self.assertNotIn(network.prefix, spaces)


if __name__ == "__main__":
    PROGRAMS = pathlib.Path(sys.argv.pop(1)).resolve()
    cases.main()
