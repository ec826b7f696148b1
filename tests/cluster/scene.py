# SPDX-License-Identifier: MIT
"""Three brokers over three NATS servers on hosts of their own (tests/backbone/hosts.py), and what can befall them (faults.py)."""
import asyncio
import collections
import ctypes
import itertools
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
import hosts
import peers
import recordings

NATS, BROKERS = ["n1", "n2", "n3"], ["b1", "b2", "b3"]
DISK = 128 << 20
STREAMS = 4
KEYS_PER_S = 15
# docs/protocol.md, "Profile query".
PROFILES = ["rate=raw", "", "form=compact", "rate=estimated", "scheme=hermite", "rate=estimated&form=compact&bands=1", "k=5&scheme=catmull-rom",
            "k=2&form=compact&scheme=hermite", "rate=raw&bands=1", "rate=estimated&scheme=linear", "k=4&bands=1", "rate=5"]
LIBC = ctypes.CDLL(None, use_errno=True)


def has_velocities(number):
    """Two streams, so that at each broker with two senders these might be mistaken for each other."""
    return number < 2


def channels_of(stream):
    """Of a stream whose poses say who they are; 0: of another."""
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
    for mount in (["mount", "--make-rprivate", "/"], ["mount", "-t", "tmpfs", "netns", "/run/netns"]):  # What is left there, nobody sees.
        if why := subprocess.run(mount, capture_output=True, text=True).stderr.strip():
            return why
    return ""


class Machine:
    """A host that runs one program."""

    def __init__(self, world, name):
        self.world, self.name, self.process, self.told, self.paused = world, name, None, False, False
        self.host = world.network.hosts[name]
        self.log = world.folder / f"{name}.log"

    def start(self):
        if self.process is None:
            with open(self.log, "a") as log:
                self.process = self.host.run(*self.command(), stdout=log, stderr=log, env={**os.environ, **self.environment()})

    def environment(self):
        return {}

    def signal(self, number):
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(number)

    def kill(self):
        self.expect()
        self.signal(signal.SIGKILL)
        self.process.wait()
        self.process = None

    def expect(self):
        """Notes an end that nobody asked for."""
        status = self.process.poll() if self.process is not None else None
        if status is not None:
            self.world.note("exit", who=self.name, status=status, told=False)

    async def stop(self):
        if self.process is None:
            return
        self.expect()
        process, self.process = self.process, None
        process.send_signal(signal.SIGTERM)
        until = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < until:
            await asyncio.sleep(0.02)
        if process.poll() is None:
            process.kill()
        self.ended(process.wait())

    def ended(self, status):
        pass


class Nats(Machine):
    def command(self):
        routes = ", ".join(f'"nats://{self.world.network.hosts[other].address}:6222"' for other in NATS)
        config = self.world.folder / f"{self.name}.conf"
        config.write_text(f"""
server_name: {self.name}
listen: "{self.host.address}:4222"
http: "{self.host.address}:8222"
jetstream {{ store_dir: "{self.world.folder / self.name}", max_memory_store: 64MB, max_file_store: 256MB }}
cluster {{ name: eigencast, listen: "{self.host.address}:6222", no_advertise: true, routes: [{routes}] }}
""")
        return ["nats-server", "-c", config]


class Broker(Machine):
    def __init__(self, world, name):
        super().__init__(world, name)
        self.data = world.folder / name
        self.data.mkdir()
        self.has_disk = world.mounts and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "disk", self.data], capture_output=True).returncode == 0
        self.clock = world.folder / f"{name}.clock"
        self.clock.write_bytes(bytes(8))
        # Its links to NATS and those of some of its viewers.
        self.backbone = [peers.Relay(self.host, 4222 + number, (self.host, world.network.hosts[n].address, 4222))
                         for number, n in enumerate(NATS)]
        self.slow = peers.Relay(world.away, peers.PORT + 10 + BROKERS.index(name), (world.away, self.host.address, peers.PORT))

    def command(self):
        return [self.world.programs / "eigencast-broker", f"--listen=0.0.0.0:{peers.PORT}", "--admin-listen=127.0.0.1:7491",
                "--access-anonymous=anywhere", f"--data-dir={self.data}", "--recording-streams=**", "--recording-include-asset=true",
                "--backbone-servers=" + ",".join(f"nats://127.0.0.1:{4222 + n}" for n in range(len(NATS))), "--backbone-replicas=3"]

    def environment(self):
        return {"LD_PRELOAD": self.world.clock, "EIGENCAST_TEST_CLOCK": str(self.clock)} if self.world.clock else {}

    def ended(self, status):
        self.world.note("exit", who=self.name, status=status, told=True)

    def reached_from(self, peer):
        if getattr(peer, "by_relay", False):
            return self.world.away, "127.0.0.1", peers.PORT + 10 + BROKERS.index(self.name)
        return (self.host, "127.0.0.1", peers.PORT) if peer.host is self.host else (self.world.away, self.host.address, peers.PORT)

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


class RealSender(Machine):
    """eigencast-sender, with real coefficients and all brokers; started again, the next broker first, whenever it ends."""

    def __init__(self, world, name):
        self.world, self.name, self.process, self.task = world, name, None, None
        self.host, self.log = world.away, world.folder / f"{name}.log"
        self.turns = itertools.count()
        self.over = False
        self.task = asyncio.get_running_loop().create_task(self.keep())

    def command(self):
        first = next(self.turns)
        brokers = ",".join(f"{self.world.network.hosts[BROKERS[(first + i) % len(BROKERS)]].address}:{peers.PORT}" for i in range(len(BROKERS)))
        return [self.world.programs / "eigencast-sender", "--no-progress", "play", "heart", "--velocities", "--rate", str(KEYS_PER_S), "--to",
                f"ws://{brokers}/{self.name}"]

    def environment(self):
        return {"XDG_CACHE_HOME": str(self.world.folder / "cache")}

    async def keep(self):
        while not self.over:
            if self.process is None or self.process.poll() is not None:
                self.process = None
                self.start()
            await asyncio.sleep(0.3)

    def drop(self):
        """As kill -9."""
        self.signal(signal.SIGKILL)

    async def end(self):
        self.over = True
        await self.task
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGKILL)
        self.process.wait()


class World:
    """`note(what, ...)` gets every event, in order. `clock`: stepped_clock's file, or empty: clocks are not stepped."""

    def __init__(self, programs, folder, clock, judge, history=None):
        self.programs, self.folder, self.clock = pathlib.Path(programs), pathlib.Path(folder), clock
        self.judge, self.history = judge, history
        self.began = time.monotonic()
        self.announcements = itertools.count(1)
        self.left_out = []
        why = alone_with_mounts()
        self.mounts = not why
        if why:
            self.left_out.append(f"full-disk ({why})")
        if not clock:
            self.left_out.append("step-clock (no library of stepped clocks)")
        self.network = hosts.Network(NATS + BROKERS + ["away"]).__enter__()
        self.away = self.network.hosts["away"]
        self.peers, self.broken = [], []
        self.turns = collections.defaultdict(asyncio.Lock)

    def note(self, what, **fields):
        event = {"what": what, "t": time.monotonic() - self.began, **fields}
        if self.history:
            self.history.write(repr(event) + "\n")
        self.judge.take(event)

    def note_end(self, task):
        """Of a peer, which never ends by itself."""
        if not task.cancelled() and task.exception():
            self.broken.append(task.exception())

    async def wait_for(self, condition, what, seconds=180):
        began = time.monotonic()
        while not condition():
            if self.broken:
                raise self.broken[0]
            if time.monotonic() - began > seconds:
                raise TimeoutError(f"{what}: not within {seconds} s")
            await asyncio.sleep(0.1)

    async def start(self):
        self.nats = {name: Nats(self, name) for name in NATS}
        for machine in self.nats.values():
            machine.start()
        self.brokers = {name: Broker(self, name) for name in BROKERS}
        if self.mounts and not all(broker.has_disk for broker in self.brokers.values()):
            self.left_out.append("full-disk (tmpfs cannot be mounted)")
        self.machines = {**self.nats, **self.brokers}
        for broker in self.brokers.values():
            broker.start()
        for broker in self.brokers.values():
            await self.wait_for(broker.is_ready, f"{broker.name} meets the others")
        self.start_peers()

    def start_peers(self):
        rotated = lambda first: [self.brokers[BROKERS[(first + i) % len(BROKERS)]] for i in range(len(BROKERS))]
        self.senders = {f"s{n}": peers.Sender(self, self.away, rotated(n // 2), f"cluster/s{n}", n, has_velocities(n), KEYS_PER_S)
                        for n in range(STREAMS)}
        self.senders["r"] = RealSender(self, "r")
        profiles = itertools.cycle(PROFILES)
        streams = [(f"cluster/s{n}", n, channels_of(f"cluster/s{n}")) for n in range(STREAMS)] + [("r", STREAMS, 0)]
        for number, ((stream, sender, channels), broker) in enumerate(itertools.product(streams, BROKERS)):
            # A third is beside its broker, a third away, a third away by a link that is slow at times.
            here, by_relay = number % 3 == 0, number % 3 == 1
            profile = next(profiles)
            name = f"v{number}@{broker} of {stream}"
            self.peers.append(peers.Viewer(self, self.network.hosts[broker] if here else self.away, [self.brokers[broker]], name, stream, sender,
                                           channels, profile, number % 4 == 1, by_relay))
        for number, (stream, sender, channels) in enumerate(streams[:3]):  # They go wherever they are let in.
            self.peers.append(peers.Viewer(self, self.away, rotated(number), f"w{number} of {stream}", stream, sender, channels, next(profiles),
                                           True, False))

    def kinds(self):
        from faults import KINDS
        return [kind for kind in KINDS if not any(left.startswith(kind) for left in self.left_out)]

    def targets(self):
        return {"brokers": BROKERS, "nats": NATS, "senders": [f"s{n}" for n in range(STREAMS)] + ["r"]}

    # ---- Faults ----

    async def befall(self, fault):
        """The whole of one fault, from its beginning to its end. Of one target after what befell it before: that may have taken longer."""
        async with self.turns[fault.target]:
            await self.befall_now(fault)

    async def befall_now(self, fault):
        what, _, _ = fault.kind.partition("-")
        machine = self.machines.get(fault.target)
        self.note("fault", number=fault.number, kind=fault.kind, phase="begin", apart=fault.apart(BROKERS))
        begin, end = {
            "kill": (lambda: machine.kill() if machine else self.senders[fault.target].drop(), lambda: machine and machine.start()),
            "pause": (lambda: self.pause(fault), lambda: machine and machine.signal(signal.SIGCONT)),
            "reload": (lambda: machine.signal(signal.SIGHUP), None),
            "cut": (lambda: machine.host.link("down"), lambda: machine.host.link("up")),
            "hold": (lambda: [relay.open.clear() for relay in machine.backbone], lambda: [relay.open.set() for relay in machine.backbone]),
            "slow": (lambda: self.slow(fault, 0.25, 4e4), lambda: self.slow(fault, 0.0, 0.0)),
            "full": (lambda: machine.fill_disk(True), lambda: machine.fill_disk(False)),
            "step": (lambda: self.step_clock(machine, fault.amount), lambda: self.step_clock(machine, 0)),
            "move": (lambda: self.senders[fault.target].drop(), None),
            "reset": (lambda: [peer.drop() for peer in self.peers if peer.brokers[0] is machine], None),
            "stop": (None, lambda: machine.start()),
        }[what]
        if what == "stop":
            await machine.stop()
        else:
            begin()
        await asyncio.sleep(fault.lasts)
        if end:
            end()
        self.note("fault", number=fault.number, kind=fault.kind, phase="over", apart=[])

    def pause(self, fault):
        if fault.target in self.machines:
            return self.machines[fault.target].signal(signal.SIGSTOP)
        sender = self.senders[fault.target]
        if isinstance(sender, RealSender):
            sender.signal(signal.SIGSTOP)
            asyncio.get_running_loop().call_later(fault.lasts, sender.signal, signal.SIGCONT)
        else:
            sender.paused_until = time.monotonic() + fault.lasts

    def slow(self, fault, delay_s, bytes_per_s):
        broker = self.machines[fault.target]
        for relay in [broker.slow] if fault.kind == "slow-viewers" else broker.backbone:
            relay.delay_s, relay.bytes_per_s = delay_s, bytes_per_s

    def step_clock(self, broker, seconds):
        with open(broker.clock, "r+b") as file:
            file.write(struct.pack("<q", seconds))

    # ---- The end ----

    async def end_peers(self):
        for peer in [*self.peers, *self.senders.values()]:
            await peer.end()

    async def start_and_stop_brokers(self):
        """What a kill tore is mended at the next start."""
        for broker in self.brokers.values():
            await broker.stop()
            broker.start()
        for broker in self.brokers.values():
            await self.wait_for(lambda: broker.asks("/livez"), f"{broker.name} lives")
            await broker.stop()

    def read_recordings(self):
        """Notes each; returns the files."""
        numbers = {f"cluster/s{n}": n for n in range(STREAMS)}
        files = sorted(file for broker in self.brokers.values() for file in (broker.data / "recordings").glob("*"))
        for file in files:
            found = recordings.read(file.read_bytes(), channels_of)
            self.note("recording", file=str(file.relative_to(self.folder)), stream=found["stream"], number=numbers.get(found["stream"], STREAMS),
                      whole=found["whole"], said=found["said"], why=found["why"], frames=found["frames"])
        return files

    def close(self):
        for machine in getattr(self, "machines", {}).values():
            machine.signal(signal.SIGKILL)
        self.network.__exit__()  # Ends what runs on the hosts.
        for broker in getattr(self, "brokers", {}).values():
            if broker.has_disk:
                subprocess.run(["umount", "-l", broker.data], capture_output=True)
