# SPDX-License-Identifier: MIT
"""Three brokers over three NATS servers on hosts of their own (tests/backbone/hosts.py), with senders and viewers."""
import asyncio
import ctypes
import itertools
import json
import os
import pathlib
import shutil
import signal
import struct
import subprocess
import sys
import time
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/support"), str(ROOT / "tests/backbone"), str(pathlib.Path(__file__).parent)]
import clients
import hosts
import nemesis
import recordings

NATS, BROKERS = ["n1", "n2", "n3"], ["b1", "b2", "b3"]
DISK = 512 << 20
STREAMS = 4
KEYS_PER_S = 15
# docs/protocol.md, "Profile query".
PROFILES = ["rate=raw", "", "scheme=catmull-rom", "rate=estimated", "scheme=hermite", "rate=estimated&bands=1", "k=5&scheme=catmull-rom",
            "k=2&scheme=hermite", "rate=raw&bands=1", "rate=estimated&scheme=linear", "k=4&bands=1", "rate=5"]
LIBC = ctypes.CDLL(None, use_errno=True)


def has_velocities(number):
    """Two streams, so that at each broker with two senders these might be mistaken for each other."""
    return number < 2


def channels_of(stream):
    """Of a stream whose poses carry tags; 0: of another."""
    _, is_ours, number = stream.partition("cluster/s")
    return 0 if not is_ours else 6 if has_velocities(int(number)) else 3


def unavailable():
    """Why there can be no cluster here; empty where there can."""
    return hosts.available() or ("" if shutil.which("nats-server") else "no nats-server")


def alone_with_mounts():
    """Mounts of this process are its own from here on; why not, where that fails. REQUIRES: one thread."""
    if LIBC.unshare(0x00020000) != 0:  # CLONE_NEWNS
        return f"no mounts of its own: {os.strerror(ctypes.get_errno())}"
    pathlib.Path("/run/netns").mkdir(exist_ok=True)
    for mount in (["mount", "--make-rprivate", "/"], ["mount", "-t", "tmpfs", "netns", "/run/netns"]):  # Nobody sees what stays there.
        if why := subprocess.run(mount, capture_output=True, text=True).stderr.strip():
            return why
    return ""


class Machine:
    """A host that runs one program."""

    def __init__(self, cluster, name):
        self.cluster, self.name, self.process = cluster, name, None
        self.host = cluster.network.hosts[name]
        self.log = cluster.folder / f"{name}.log"

    def environment(self):
        return {}

    def start(self):
        if self.process is None:
            with open(self.log, "a") as log:
                self.process = self.host.run(*self.command(), stdout=log, stderr=log, env={**os.environ, **self.environment()})

    def restart_if_dead(self):
        status = self.process.poll() if self.process is not None else None
        if status is not None:
            self.cluster.record("exit", program=self.name, status=status, asked=False)
            self.process = None
            self.start()

    def signal(self, number):
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(number)

    def kill(self):
        self.restart_if_dead()
        self.signal(signal.SIGKILL)
        self.process.wait()
        self.process = None

    async def stop(self):
        if self.process is None:
            return
        self.restart_if_dead()
        process, self.process = self.process, None
        process.send_signal(signal.SIGTERM)
        until = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < until:
            await asyncio.sleep(0.02)
        if process.poll() is None:
            process.kill()
        self.on_stopped(process.wait())

    def on_stopped(self, status):
        pass


class Nats(Machine):
    def command(self):
        routes = ", ".join(f'"nats://{self.cluster.network.hosts[other].address}:6222"' for other in NATS)
        config = self.cluster.folder / f"{self.name}.conf"
        config.write_text(f"""
server_name: {self.name}
listen: "{self.host.address}:4222"
jetstream {{ store_dir: "{self.cluster.folder / self.name}", max_memory_store: 64MB, max_file_store: 256MB }}
cluster {{ name: eigencast, listen: "{self.host.address}:6222", no_advertise: true, routes: [{routes}] }}
""")
        return ["nats-server", "-c", config]


class Broker(Machine):
    def __init__(self, cluster, name):
        super().__init__(cluster, name)
        self.data = cluster.folder / name
        self.data.mkdir()
        self.has_disk = cluster.has_mounts and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "disk", self.data], capture_output=True).returncode == 0
        self.clock = cluster.folder / f"{name}.clock"
        self.clock.write_bytes(bytes(8))
        # Its links to NATS and those of some of its viewers.
        self.backbone = [clients.Relay(self.host, 4222 + number, (self.host, cluster.network.hosts[n].address, 4222))
                         for number, n in enumerate(NATS)]
        self.slow_port = clients.PORT + 10 + BROKERS.index(name)
        self.slow = clients.Relay(cluster.away, self.slow_port, (cluster.away, self.host.address, clients.PORT))

    def command(self):
        return [self.cluster.programs / "eigencast-broker", f"--listen=0.0.0.0:{clients.PORT}", "--admin-listen=127.0.0.1:7491",
                "--access-anonymous=anywhere", f"--data-dir={self.data}", "--recording-streams=**", "--recording-include-asset=true",
                "--backbone-servers=" + ",".join(f"nats://127.0.0.1:{4222 + n}" for n in range(len(NATS))), "--backbone-replicas=3"]

    def environment(self):
        return {"LD_PRELOAD": self.cluster.clock, "EIGENCAST_TEST_CLOCK": str(self.clock)} if self.cluster.clock else {}

    def on_stopped(self, status):
        self.cluster.record("exit", program=self.name, status=status, asked=True)

    def reached_from(self, client):
        if getattr(client, "by_relay", False):
            return self.cluster.away, "127.0.0.1", self.slow_port
        return (self.host, "127.0.0.1", clients.PORT) if client.host is self.host else (self.cluster.away, self.host.address, clients.PORT)

    def asks(self, path):
        try:
            with self.host.within():
                return urllib.request.urlopen(f"http://127.0.0.1:7491{path}", timeout=2).read().decode()
        except OSError:
            return ""

    def is_ready(self):
        if self.process.poll() is not None:
            raise OSError(f"{self.name} ends with {self.process.poll()} at its start")
        return f"{len(BROKERS)} brokers" in self.asks("/api/broker") and self.asks("/readyz").strip() == "ready"

    def fill_disk(self, full):
        for more in range(100):  # It is written to meanwhile, and cannot be smaller than what it holds.
            used = os.statvfs(self.data)
            size = (used.f_blocks - used.f_bfree + more) * used.f_frsize if full else DISK
            if subprocess.run(["mount", "-o", f"remount,size={size}", self.data], capture_output=True).returncode == 0:
                return
        raise OSError(f"{self.data}: its size cannot be changed")

    def step_clock(self, seconds):
        with open(self.clock, "r+b") as file:  # Mapped by the broker: never shorter.
            file.write(struct.pack("<q", seconds))


class RealSender(Machine):
    """eigencast-sender, with real coefficients and all brokers; started again, the next broker first, whenever it ends."""

    def __init__(self, cluster, name):
        self.cluster, self.name, self.stream, self.process = cluster, name, name, None
        self.host, self.log = cluster.away, cluster.folder / f"{name}.log"
        self.turns = itertools.count()
        self.over = False
        self.task = asyncio.get_running_loop().create_task(self.keep())

    def command(self):
        first = next(self.turns)
        hosts_ = [self.cluster.network.hosts[BROKERS[(first + i) % len(BROKERS)]] for i in range(len(BROKERS))]
        brokers = ",".join(f"{host.address}:{clients.PORT}" for host in hosts_)
        return [self.cluster.programs / "eigencast-sender", "--no-progress", "play", "--wait", "heart", "--velocities", "--rate", str(KEYS_PER_S), "--to",
                f"ws://{brokers}/{self.name}"]

    def environment(self):
        return {"XDG_CACHE_HOME": str(self.cluster.folder / "cache")}

    async def keep(self):
        while not self.over:
            if self.process is None or self.process.poll() is not None:
                self.process = None
                self.start()
            await asyncio.sleep(clients.RETRY_S)

    def drop(self, away_s=0.0):
        """As kill -9; keep() starts it again."""
        self.signal(signal.SIGKILL)

    def move(self):
        self.signal(signal.SIGTERM)

    def pause(self, seconds):
        self.signal(signal.SIGSTOP)
        asyncio.get_running_loop().call_later(seconds, self.signal, signal.SIGCONT)

    async def end(self):
        self.over = True
        await self.task
        self.signal(signal.SIGKILL)
        self.process.wait()


class Cluster:
    """`checker` gets every event, in order, and `history`, a file, if there is one. `clock`: stepped_clock's library; empty: clocks are not
    stepped."""

    def __init__(self, programs, folder, clock, checker, history=None):
        self.programs, self.folder, self.clock = pathlib.Path(programs), pathlib.Path(folder), clock
        self.checker, self.history = checker, history
        self.began = time.monotonic()
        self.announcements = itertools.count(1)
        self.nats, self.brokers, self.machines, self.senders, self.viewers, self.people = {}, {}, {}, {}, [], []
        self.left_out = {} if clock else {"step-clock": "no library of stepped clocks"}
        why = alone_with_mounts()
        self.has_mounts = not why
        if why:
            self.left_out["full-disk"] = why
        self.network = hosts.Network(NATS + BROKERS + ["away"]).__enter__()
        self.away = self.network.hosts["away"]
        self.error = None  # Of a task: a bug of this program.

    def now(self):
        return time.monotonic() - self.began

    def record(self, what, **fields):
        event = {"what": what, "t": self.now(), **fields}
        if self.history:
            self.history.write(json.dumps(event) + "\n")
        self.checker.take(event)

    def on_task_ended(self, task):
        if not task.cancelled():
            self.error = task.exception()

    async def wait_for(self, condition, what, seconds=180):
        began = time.monotonic()
        while not condition():
            if self.error:
                raise self.error
            if time.monotonic() - began > seconds:
                raise TimeoutError(f"{what}: not within {seconds} s")
            await asyncio.sleep(0.1)

    async def start(self):
        self.nats = {name: Nats(self, name) for name in NATS}
        self.brokers = {name: Broker(self, name) for name in BROKERS}
        self.machines = {**self.nats, **self.brokers}
        if not all(broker.has_disk for broker in self.brokers.values()):
            self.left_out.setdefault("full-disk", "tmpfs cannot be mounted")
        for machine in self.machines.values():
            machine.start()
        for broker in self.brokers.values():
            await self.wait_for(broker.is_ready, f"{broker.name} meets the others")
        self.start_clients()

    def start_clients(self):
        rotated = lambda first: [self.brokers[BROKERS[(first + i) % len(BROKERS)]] for i in range(len(BROKERS))]
        self.senders = {f"s{n}": clients.Sender(self, self.away, rotated(n // 2), f"cluster/s{n}", n, has_velocities(n), KEYS_PER_S)
                        for n in range(STREAMS)}
        self.senders["r"] = RealSender(self, "r")
        profiles = itertools.cycle(PROFILES)
        streams = [(f"cluster/s{n}", n, channels_of(f"cluster/s{n}")) for n in range(STREAMS)] + [("r", STREAMS, 0)]
        for number, ((stream, sender, channels), broker) in enumerate(itertools.product(streams, BROKERS)):
            # A third is beside its broker, a third away, a third away by a link that is slow at times.
            here, by_relay = number % 3 == 0, number % 3 == 1
            host, name = self.network.hosts[broker] if here else self.away, f"v{number}@{broker} of {stream}"
            self.viewers.append(clients.Viewer(self, host, [self.brokers[broker]], name, stream, sender, channels, next(profiles),
                                               number % 4 == 1 or channels == 0, by_relay))
        for number, broker in itertools.product(range(3), BROKERS):
            here = [self.network.hosts[broker], self.away, self.away][number]
            self.people.append(clients.Person(self, here, [self.brokers[broker]], f"p{number}@{broker}", number == 2))
        for number, (stream, sender, channels) in enumerate(streams[:3]):  # They go to any broker.
            self.viewers.append(clients.Viewer(self, self.away, rotated(number), f"w{number} of {stream}", stream, sender, channels,
                                               next(profiles), True, False))

    def kinds(self):
        return [kind for kind in nemesis.KINDS if kind not in self.left_out]

    def targets(self):
        return {"brokers": BROKERS, "nats": NATS, "senders": [f"s{n}" for n in range(STREAMS)] + ["r"]}

    async def restart_the_dead(self):
        """For ever."""
        while True:
            for machine in self.machines.values():
                machine.restart_if_dead()
            await asyncio.sleep(0.1)

    # ---- The end ----

    async def end_clients(self):
        for client in [*self.viewers, *self.people, *self.senders.values()]:
            await client.end()

    async def start_and_stop_brokers(self):
        """What a kill tore is mended at the next start."""
        for broker in self.brokers.values():
            await broker.stop()
            broker.start()
        for broker in self.brokers.values():
            await self.wait_for(lambda: broker.asks("/livez"), f"{broker.name} lives")
            await broker.stop()

    def read_recordings(self):
        """Records what each holds; returns the files."""
        numbers = {f"cluster/s{n}": n for n in range(STREAMS)}
        files = sorted(file for broker in self.brokers.values() for file in (broker.data / "recordings").glob("*"))
        for file in files:
            found = recordings.read(file.read_bytes(), channels_of)
            self.record("recording", file=str(file.relative_to(self.folder)), stream=found["stream"],
                        number=numbers.get(found["stream"], STREAMS), whole=found["whole"], tags=[sorted(tags) for tags in found["tags"]],
                        why=found["why"])
        return files

    def close(self):
        for machine in self.machines.values():
            machine.signal(signal.SIGKILL)
        self.network.__exit__()  # Ends what runs on the hosts.
        for broker in self.brokers.values():
            if broker.has_disk:
                subprocess.run(["umount", "-l", broker.data], capture_output=True)
