# SPDX-License-Identifier: MIT
"""Debian machines with systemd, each on a host of its own (hosts.py): a clean root, made once, under a writable layer per machine.

Needs root, network namespaces, overlayfs, mmdebstrap, systemd-nspawn and a package mirror, which is asked once, while the root is made.
"""
import contextlib
import os
import pathlib
import shutil
import signal
import subprocess
import time

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
HOME = "opt"  # Where commands run, below a machine's root.
APT = """APT::Get::Assume-Yes "true";
APT::Install-Recommends "false";
Binary::apt::APT::Keep-Downloaded-Packages "true";
Dpkg::Options { "--force-confold"; };
"""


def missing():
    """Why there can be no machines; empty where there can."""
    return ", ".join(f"no {tool}" for tool in ("mmdebstrap", "systemd-nspawn", "nsenter") if not shutil.which(tool))


class NoRoot(Exception):
    """No clean root could be made: no mirror."""


def make_root(folder, packages, also=()):
    """A clean root in `folder`, in whose cache is all that installing `packages` (.deb files, kept in its home) and the Debian packages
    `also` takes: its machines need no network."""
    if not (folder / "etc/apt/apt.conf.d/90test").exists():
        bootstrap(folder)
    for package in packages:
        shutil.copy(package, folder / HOME)
    names = [f"/{HOME}/{package.name}" for package in packages]
    for words in (["update", "-qq"], ["install", "-qq", "--download-only", *names, *also]):
        done = subprocess.run(["chroot", folder, "apt-get", *words], env={**os.environ, "PATH": PATH}, capture_output=True, text=True)
        if done.returncode != 0:
            raise NoRoot(f"apt-get {words[0]}: {done.stderr.strip()}")


def bootstrap(folder):
    made = subprocess.run(["mmdebstrap", "--quiet", "--variant=apt", "--include=systemd", "bookworm", folder], capture_output=True, text=True)
    if made.returncode != 0:
        raise NoRoot(made.stderr.strip().splitlines()[-1])
    for proxy in pathlib.Path("/etc/apt/apt.conf.d").glob("*proxy*"):
        shutil.copy(proxy, folder / "etc/apt/apt.conf.d")
    shutil.copy("/etc/resolv.conf", folder / "etc/resolv.conf")
    (folder / "etc/apt/apt.conf.d/90test").write_text(APT)


class Machine:
    """with Machine(root, folder, host) as machine: machine.run("systemctl status")"""

    def __init__(self, root, folder, host):
        """root: clean, stays so; folder: for what this machine writes; host: of hosts.Network."""
        self.host, self.name = host, host.name
        self.layers = [folder / f"{host.name}-{layer}" for layer in ("upper", "work")]
        self.root = folder / host.name
        self.home = self.root / HOME
        for made in (*self.layers, self.root):
            made.mkdir()
        self.options = f"lowerdir={root},upperdir={self.layers[0]},workdir={self.layers[1]}"
        self.nspawn = None
        self.log = folder / f"{host.name}-nspawn.log"

    def __enter__(self):
        subprocess.run(["mount", "-t", "overlay", "overlay", "-o", self.options, self.root], check=True, capture_output=True)
        try:
            self.boot()
        except BaseException:
            self.__exit__()
            raise
        return self

    def boot(self):
        addresses = "".join(f"{host.address} {host.name}.example.org {host.name}\n" for host in self.host.network.hosts.values())
        (self.root / "etc/hosts").write_text("127.0.0.1 localhost\n" + addresses)
        with open(self.log, "w") as log:
            self.nspawn = subprocess.Popen(
                ["systemd-nspawn", "--quiet", f"--directory={self.root}", "--boot", "--register=no", "--keep-unit", "--resolv-conf=off",
                 f"--network-namespace-path=/run/netns/{self.host.space}", "--console=read-only", f"--machine={self.name}"],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        for _ in range(600):
            if self.init() and self.run("systemctl is-system-running", check=False).stdout.strip() in ("running", "degraded"):
                return
            if self.nspawn.poll() is not None:
                raise RuntimeError(f"systemd-nspawn ended with {self.nspawn.returncode}: {self.log.read_text()[-1000:]}")
            time.sleep(0.1)
        raise RuntimeError(f"{self.name} does not come up: {self.run('systemctl list-jobs', check=False).stdout}")

    def init(self):
        children = pathlib.Path(f"/proc/{self.nspawn.pid}/task/{self.nspawn.pid}/children").read_text().split()
        return children[0] if children else None

    def command(self, text):
        return ["nsenter", f"--target={self.init()}", "--all", "--", "env", "-i", f"PATH={PATH}", f"HOME=/{HOME}", "DEBIAN_FRONTEND=noninteractive",
                "sh", "-ec", f"cd; {text}"]

    def run(self, text, check=True, timeout=240):
        """What a shell of root says, at home, to `text`."""
        done = subprocess.run(self.command(text), capture_output=True, text=True, timeout=timeout, stdin=subprocess.DEVNULL)
        if check and done.returncode != 0:
            raise AssertionError(f"{self.name}: {text}\nended with {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
        return done

    def start(self, text, log):
        return subprocess.Popen(self.command(text), stdout=log, stderr=log, stdin=subprocess.DEVNULL)

    def __exit__(self, *_):
        if self.nspawn and self.nspawn.poll() is None:
            init = self.init()
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(init or self.nspawn.pid), signal.SIGKILL)  # With its first process a machine's others end.
            self.nspawn.wait()
        subprocess.run(["umount", "--lazy", self.root], capture_output=True)
