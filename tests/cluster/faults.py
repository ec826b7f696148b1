# SPDX-License-Identifier: MIT
"""Which faults befall a cluster, and when: the same for the same seed."""
import dataclasses
import random

# Kind -> (weight, shortest and longest duration in seconds, whom it befalls).
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
    "kill-sender": (2, 0.0, 1.0, "senders"),    # Gone without a word; comes back at another broker.
    "move-sender": (1, 0.0, 0.0, "senders"),    # Closes, and goes on at another broker.
    "pause-sender": (1, 0.3, 4.0, "senders"),
    "reset-viewers": (1, 0.0, 0.0, "brokers"),  # All of one broker.
}
# During these a broker may be without NATS: a sender may be granted without the directory.
APART = {"kill-broker", "stop-broker", "pause-broker", "cut-broker", "hold-backbone", "slow-backbone"}
APART_ALL = {"kill-nats", "stop-nats", "pause-nats", "cut-nats"}
CLOCK_STEPS = (-100_000_000, -86_400, -3_600, -5, 5, 3_600, 86_400, 100_000_000)


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

    def apart(self, brokers):
        return list(brokers) if self.kind in APART_ALL else [self.target] if self.kind in APART else []


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
        _, least, most, whom = KINDS[kind]
        target, lasts = dice.choice(targets[whom]), dice.uniform(least, most)
        amount = dice.choice(CLOCK_STEPS) if kind == "step-clock" else 0
        lasts = min(lasts, seconds - at)
        if busy.get(target, 0) > at:
            continue
        busy[target] = at + lasts + 0.2
        faults.append(Fault(len(faults) + 1, round(at, 3), kind, target, round(lasts, 3), amount))
