# SPDX-License-Identifier: MIT
"""Hosts on a network of their own: network namespaces joined by a bridge, in a namespace too. Needs root, leaves nothing behind."""
import contextlib
import ctypes
import os
import subprocess

LIBC = ctypes.CDLL(None, use_errno=True)
CLONE_NEWNET = 0x40000000


def ip(*words):
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def available():
    """Why there can be no hosts; empty where there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    probe = f"ec-probe-{os.getpid()}"
    try:
        ip("netns", "add", probe)
        ip("netns", "del", probe)
    except (OSError, subprocess.CalledProcessError) as error:
        return f"no network namespaces here: {error}"
    return ""


class Host:
    def __init__(self, network, name, address):
        self.network, self.name, self.address = network, name, address
        self.space = f"{network.prefix}-{name}"

    def run(self, *command, **options):
        """A process on this host."""
        return subprocess.Popen(["ip", "netns", "exec", self.space, *map(str, command)], **options)

    @contextlib.contextmanager
    def within(self):
        """This thread's sockets are of this host meanwhile."""
        before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        there = os.open(f"/run/netns/{self.space}", os.O_RDONLY)
        try:
            if LIBC.setns(there, CLONE_NEWNET) != 0:
                raise OSError(ctypes.get_errno(), "setns")
            yield
        finally:
            LIBC.setns(before, CLONE_NEWNET)
            os.close(before)
            os.close(there)

    def link(self, state):
        """Pulls the cable (down) or plugs it in (up)."""
        ip("-n", self.network.switch, "link", "set", f"p-{self.name}", state)


class Network:
    """with Network(["n1", "b1"]) as network: network.hosts["b1"]"""

    def __init__(self, names):
        self.prefix = f"ec{os.getpid()}"
        self.switch = f"{self.prefix}-switch"
        self.hosts = {name: Host(self, name, f"10.77.0.{i + 1}") for i, name in enumerate(names)}

    def __enter__(self):
        try:
            self.build()
        except BaseException:
            self.__exit__()
            raise
        return self

    def build(self):
        ip("netns", "add", self.switch)
        ip("-n", self.switch, "link", "add", "bridge", "type", "bridge")
        ip("-n", self.switch, "link", "set", "bridge", "up")
        for host in self.hosts.values():
            ip("netns", "add", host.space)
            ip("-n", self.switch, "link", "add", f"p-{host.name}", "type", "veth", "peer", "name", "eth0", "netns", host.space)
            ip("-n", self.switch, "link", "set", f"p-{host.name}", "master", "bridge", "up")
            ip("-n", host.space, "addr", "add", f"{host.address}/24", "dev", "eth0")
            ip("-n", host.space, "link", "set", "eth0", "up")
            ip("-n", host.space, "link", "set", "lo", "up")

    def __exit__(self, *_):
        for host in self.hosts.values():
            pids = subprocess.run(["ip", "netns", "pids", host.space], capture_output=True, text=True).stdout.split()
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(pid), 9)
            subprocess.run(["ip", "netns", "del", host.space], capture_output=True)
        subprocess.run(["ip", "netns", "del", self.switch], capture_output=True)
