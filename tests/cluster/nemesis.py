# SPDX-License-Identifier: MIT
"""The faults of a cluster: when which comes, the same for the same seed, and how it is made."""
import asyncio
import collections
import dataclasses
import random
import signal

# Kind -> (weight, shortest and longest duration in seconds, what it comes to).
KINDS = {
    "kill-broker": (3, 0.0, 3.0, "brokers"),    # SIGKILL; started again after the duration.
    "stop-broker": (1, 0.0, 2.0, "brokers"),    # SIGTERM.
    "pause-broker": (2, 0.3, 7.0, "brokers"),   # SIGSTOP.
    "reload-broker": (1, 0.0, 0.0, "brokers"),  # SIGHUP.
    "cut-broker": (2, 0.3, 6.0, "brokers"),     # The cable of its machine.
    "hold-backbone": (2, 0.3, 6.0, "brokers"),  # Its link to NATS passes nothing.
    "slow-backbone": (2, 0.5, 5.0, "brokers"),  # The same passes little, late.
    "slow-viewers": (1, 0.5, 5.0, "brokers"),   # The same for some of its viewers.
    "full-disk": (2, 0.5, 5.0, "brokers"),
    "step-clock": (2, 0.5, 5.0, "brokers"),     # The wall clock is off by `amount` seconds meanwhile.
    "kill-nats": (2, 0.0, 3.0, "nats"),
    "stop-nats": (1, 0.0, 2.0, "nats"),
    "pause-nats": (2, 0.3, 5.0, "nats"),
    "cut-nats": (2, 0.3, 5.0, "nats"),
    "kill-sender": (2, 0.0, 1.0, "senders"),    # Resets its connection; comes back at another broker after the duration.
    "move-sender": (1, 0.0, 0.0, "senders"),    # Closes its connection, and goes on at another broker.
    "pause-sender": (1, 0.3, 4.0, "senders"),
    "reset-viewers": (1, 0.0, 0.0, "brokers"),  # All of one broker.
}
# Meanwhile a broker may be without NATS: it may grant senders without the directory.
ISOLATING = {"kill-broker", "stop-broker", "pause-broker", "cut-broker", "hold-backbone", "slow-backbone"}
# Ahead by less than the 12 days that brokers believe of each other, with room for the 1,024 epochs that each start takes.
CLOCK_STEPS = (-100_000_000, -86_400, -3_600, -5, 5, 3_600, 86_400, 500_000)


@dataclasses.dataclass(frozen=True)
class Fault:
    number: int
    at: float
    kind: str
    target: str
    lasts: float
    amount: int = 0

    def __str__(self):
        return f"{self.number:4d}  {self.at:8.2f} s  {self.kind} {self.target}" + (f" for {self.lasts:.2f} s" if self.lasts else "") + \
            (f", {self.amount:+d} s" if self.amount else "")


def schedule(seed, seconds, targets, kinds=None, every=1.5):
    """`targets`: the names of brokers, nats, senders. One fault in `every` seconds on average; of one target one at a time; all are over
    at `seconds`."""
    dice = random.Random(seed)
    kinds = [kind for kind in KINDS if kinds is None or kind in kinds]
    busy, faults, at = {}, [], 0.0
    while True:
        at += dice.uniform(0.4, 1.6) * every
        if at >= seconds:
            return faults
        kind = dice.choices(kinds, [KINDS[k][0] for k in kinds])[0]
        _, least, most, who = KINDS[kind]
        target, lasts = dice.choice(targets[who]), dice.uniform(least, most)
        amount = dice.choice(CLOCK_STEPS) if kind == "step-clock" else 0
        lasts = min(lasts, seconds - at)
        if busy.get(target, 0) > at:
            continue
        busy[target] = at + lasts + 0.2
        faults.append(Fault(len(faults) + 1, round(at, 3), kind, target, round(lasts, 3), amount))


class Nemesis:
    """Makes faults in a cluster (cluster.py)."""

    def __init__(self, cluster):
        self.cluster = cluster
        self.turns = collections.defaultdict(asyncio.Lock)

    async def inject(self, fault):
        """One fault from its begin to its end, after what its target suffers already."""
        async with self.turns[fault.target]:
            target = self.cluster.senders.get(fault.target) or self.cluster.machines[fault.target]
            of_nats = fault.kind.endswith("-nats")
            self.cluster.record("fault", number=fault.number, kind=fault.kind, phase="begin",
                                disturbs=["nats" if of_nats else getattr(target, "stream", fault.target)],
                                isolates=list(self.cluster.brokers) if of_nats else [fault.target] if fault.kind in ISOLATING else [])
            begin, end = self.effects(fault, target)
            waits = begin()
            if asyncio.iscoroutine(waits):
                await waits
            await asyncio.sleep(fault.lasts)
            if end:
                end()
            self.cluster.record("fault", number=fault.number, kind=fault.kind, phase="over")

    def effects(self, fault, target):
        """What begins it, and what ends it."""
        effect, _, of = fault.kind.partition("-")
        if of == "sender":
            return {"kill": lambda: target.drop(fault.lasts), "move": target.move, "pause": lambda: target.pause(fault.lasts)}[effect], None
        relays = lambda: [target.slow] if of == "viewers" else target.backbone
        of_relays = lambda change: lambda: [change(relay) for relay in relays()]
        return {
            "kill": (target.kill, target.start),
            "stop": (target.stop, target.start),
            "pause": (lambda: target.signal(signal.SIGSTOP), lambda: target.signal(signal.SIGCONT)),
            "reload": (lambda: target.signal(signal.SIGHUP), None),
            "cut": (lambda: target.host.link("down"), lambda: target.host.link("up")),
            "hold": (of_relays(lambda relay: relay.open.clear()), of_relays(lambda relay: relay.open.set())),
            "slow": (of_relays(lambda relay: relay.set_pace(0.25, 4e4)), of_relays(lambda relay: relay.set_pace(0.0, 0.0))),
            "full": (lambda: target.fill_disk(True), lambda: target.fill_disk(False)),
            "step": (lambda: target.step_clock(fault.amount), lambda: target.step_clock(0)),
            "reset": (lambda: [client.drop() for client in self.cluster.viewers + self.cluster.people if client.brokers[0] is target], None),
        }[effect]
