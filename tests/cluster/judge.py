# SPDX-License-Identifier: MIT
"""Holds the history of a cluster against what it promises. No sockets, no clocks: events in, violations out.

An event is a dict with `what` and `t` (seconds, never falling):

    fault      number, kind, phase (begin, over), apart (brokers that may be without NATS meanwhile)
    announced  stream, epoch, broker, said: a sender was told its epoch; `said` is what its poses carry from here on
    viewer     viewer, stream, number: there is one, which must move in the end
    link       viewer, stream, number, run: a viewer is connected to a broker's run (its session id); `number` is the stream's
    state      viewer, stream, id, epoch, profile: a `stream` message
    frame      viewer, kind, id, epoch, sequence, at, of, ahead, capture, said: a binary message; `said` = (stream, announcement,
               position) as its pose carries it, None where it carries none
    healed     from here on there are no faults: everything must move again
    exit       who, status, told: a program ended; `told`: it was asked to, politely
    recording  file, whole, said, why: one file after the brokers' last start; `said` = list of (stream, announcement) sets, one for
               each announcement in it, `why` = what is wrong with its bytes, or ""
"""
import collections
import dataclasses
import itertools

KEY, JOIN, SYNTHETIC, STEP, ESTIMATE = 1, 2, 3, 4, 5
MOVES = 10  # So many newer poses in a row are motion.
# Senders are granted without the directory after 12 s without its answer; heartbeats and reconnections are in it.
APART_S = 20.0
STOOD_S = 0.5
MOST_KEPT = 1000


@dataclasses.dataclass
class Violation:
    code: str
    t: float
    text: str

    def __str__(self):
        return f"{self.t:9.3f} s  {self.code}: {self.text}"


@dataclasses.dataclass
class Link:
    """What one connection of a viewer has shown."""
    stream: str
    number: int
    run: str
    id: int = None
    epoch: int = 0
    profile: dict = None
    newest: int = None  # Sequence of the newest key.
    key_capture: int = -1
    shown: int = -1  # Capture time of the newest pose shown.
    moves: int = 0


@dataclasses.dataclass
class Seen:
    """The newest that a viewer has seen of one run of a broker."""
    epoch: int = 0
    newest: int = -1


@dataclasses.dataclass
class Time:
    """From the end of a fault to the next motion of a viewer."""
    kind: str
    since: float
    stood: bool  # The viewer stood still when the fault was over.
    alone: bool  # No other fault was under way then, or befell the cluster before it moved.
    seconds: float = None


class Judge:
    """Events must come in order. Reads: violations, times, counts, still()."""

    def __init__(self):
        self.violations = []
        self.times = []  # Time for each fault and viewer.
        self.counts = collections.Counter()
        self._announced = collections.defaultdict(list)  # Stream -> announced events.
        self._links = {}
        self._seen = collections.defaultdict(Seen)
        self._apart = collections.defaultdict(list)  # Broker -> [begin, end].
        self._open = {}
        self._moved = {}  # Viewer -> time of its newest motion.
        self._pending = collections.defaultdict(list)  # Viewer -> Times that wait for its motion.

    def take(self, event):
        self.counts[event["what"]] += 1
        getattr(self, "_on_" + event["what"])(event)

    def still(self):
        """Viewers that have not moved since they were healed, connected or told of a new epoch, and why."""
        waiting = {}
        for viewer, link in self._links.items():
            newest = self._announced[link.stream][-1]["epoch"] if self._announced[link.stream] else link.epoch
            if link.epoch != newest:
                waiting[viewer] = f"{link.stream}: at epoch {link.epoch}, its sender at {newest}"
            elif link.moves < MOVES:
                waiting[viewer] = f"{link.stream}: epoch {link.epoch}, {link.moves} poses, the last at {self._moved.get(viewer)}"
        epochs = collections.defaultdict(set)
        for link in self._links.values():
            epochs[link.stream].add(link.epoch)
        for viewer, link in self._links.items():
            if len(epochs[link.stream]) > 1:
                waiting.setdefault(viewer, f"{link.stream}: epochs {sorted(epochs[link.stream])} at once")
        return waiting

    def finish(self, t):
        for viewer, why in sorted(self.still().items()):
            self._violate("still", t, f"{viewer} does not move again, {why}")

    # ---- Events ----

    def _on_fault(self, event):
        if event["phase"] == "begin":
            for time in itertools.chain(*self._pending.values()):
                time.alone = False
            self._open[event["number"]] = spans = [[event["t"], None] for _ in event["apart"]]
            for broker, span in zip(event["apart"], spans):
                self._apart[broker].append(span)
            return
        for span in self._open.pop(event["number"]):
            span[1] = event["t"]
        for viewer in self._links:
            stood = event["t"] - self._moved.get(viewer, event["t"]) > STOOD_S
            self._pending[viewer].append(Time(event["kind"], event["t"], stood, not self._open))

    def _on_healed(self, event):
        for link in self._links.values():
            link.moves = 0

    def _on_announced(self, event):
        stream, epoch = event["stream"], event["epoch"]
        for before in self._announced[stream]:
            if before["epoch"] == epoch:
                self._violate("epoch-twice", event["t"],
                              f"{stream}: {event['broker']} gives epoch {epoch}, which {before['broker']} gave at {before['t']:.3f} s")
            elif before["epoch"] > epoch and (before["broker"] == event["broker"] or self._calm(before) and self._calm(event)):
                self._violate("epoch-fell", event["t"],
                              f"{stream}: {event['broker']} gives epoch {epoch} after {before['epoch']} of {before['broker']} at {before['t']:.3f} s")
        self._announced[stream].append(event)

    def _on_viewer(self, event):
        self._links[event["viewer"]] = Link(event["stream"], event["number"], "")

    def _on_link(self, event):
        self._links[event["viewer"]] = Link(event["stream"], event["number"], event["run"])

    def _on_state(self, event):
        link = self._links[event["viewer"]]
        if event["stream"] != link.stream:
            return self._violate("foreign", event["t"], f"{event['viewer']} watches {link.stream} and is told of {event['stream']}")
        link.id = event["id"]
        seen = self._seen[event["viewer"], link.run]
        if event["epoch"] != link.epoch:
            if 0 < event["epoch"] < seen.epoch:
                self._violate("epoch-fell", event["t"], f"{event['viewer']}: epoch {event['epoch']} after {seen.epoch}")
            link.epoch, link.newest, link.key_capture, link.shown, link.moves = event["epoch"], None, -1, -1, 0
            if event["epoch"] > seen.epoch:
                seen.epoch, seen.newest = event["epoch"], -1
        if event["profile"] != link.profile:  # Profiles differ in how far they are behind.
            link.profile, link.shown = event["profile"], -1

    def _on_frame(self, event):
        viewer, t, kind, sequence = event["viewer"], event["t"], event["kind"], event["sequence"]
        link = self._links[viewer]
        where = f"{viewer}, {link.profile}: epoch {event['epoch']}, kind {kind} of {sequence} ({event['at']}/{event['of']})"
        if event["id"] != link.id or event["epoch"] != link.epoch:
            return self._violate("unannounced", t, f"{where} of stream {event['id']}: it was told of stream {link.id}, epoch {link.epoch}")
        self._check_chain(link, event, where)
        self._check_identity(link, event, where)
        if kind in (KEY, JOIN):
            seen = self._seen[viewer, link.run]
            if sequence < seen.newest and event["epoch"] == seen.epoch:
                self._violate("stale", t, f"{where}: after {seen.newest}")
            seen.newest = max(seen.newest, sequence)
            link.newest = sequence
        self._check_order(link, event, where)

    def _check_chain(self, link, event, where):
        """Section 5 of docs/protocol.md: what cannot be decoded need not be sent."""
        kind, sequence = event["kind"], event["sequence"]
        if kind == JOIN:
            return
        needed = sequence - 1 if kind in (KEY, SYNTHETIC) else sequence
        if link.newest != needed:
            code = "stale" if link.newest is not None and needed < link.newest else "undecodable"
            self._violate(code, event["t"], f"{where}: its newest key is {link.newest}")

    def _check_order(self, link, event, where):
        """No pose after a newer one; estimates are guesses, which the key that comes corrects."""
        if event["ahead"]:
            return
        kind, capture = event["kind"], event["capture"]
        of_key = kind in (KEY, JOIN)
        guessed = (link.profile or {}).get("rate") == "estimated"
        least = link.key_capture if guessed and of_key else link.shown
        if capture < least or capture == least and kind == KEY:
            self._violate("stale", event["t"], f"{where}: captured at {capture}, after {least}")
        if of_key:
            link.key_capture = max(link.key_capture, capture)
        if capture > link.shown:
            link.shown = capture
            link.moves += 1
            self._note_motion(event["viewer"], event["t"])

    def _check_identity(self, link, event, where):
        if event["said"] is None:
            return
        stream, announcement, position = event["said"]
        if stream != link.number:
            return self._violate("foreign", event["t"], f"{where}: the pose is of sender {stream}, not of {link.number}")
        given = [a for a in self._announced[link.stream] if a["epoch"] == event["epoch"]]
        if given and announcement not in [a["said"] for a in given]:
            return self._violate("foreign", event["t"], f"{where}: the pose is of announcement {announcement}, the epoch of {given[-1]['said']}")
        sequence = event["sequence"]
        straight = (link.profile or {}).get("scheme", "linear") == "linear"  # Others overshoot, the more uneven the keys in time.
        between = (-1.001, 0.001) if straight else (-float("inf"), float("inf"))
        least, most = {KEY: (0, 0), JOIN: (0, 0), SYNTHETIC: between, ESTIMATE: (-1, 16)}[event["kind"]]
        if not least <= position - sequence <= most:
            self._violate("other-pose", event["t"], f"{where}: the pose says {position}")

    def _on_exit(self, event):
        if not event["told"]:
            self._violate("died", event["t"], f"{event['who']} ended by itself with {event['status']}")
        elif event["status"] != 0:
            self._violate("ended-badly", event["t"], f"{event['who']} was told to end and did with {event['status']}")

    def _on_recording(self, event):
        if event["why"]:
            return self._violate("recording", event["t"], f"{event['file']}: {event['why']}")
        if not event["whole"]:
            self._violate("recording", event["t"], f"{event['file']}: has no end, after a new start of its broker")
        known = {announced["said"] for announced in self._announced[event["stream"]]}
        for said in event["said"]:
            if len(said) > 1 or any(stream != event["number"] or announcement not in known for stream, announcement in said):
                self._violate("foreign", event["t"], f"{event['file']}: poses of {sorted(said)} in a recording of sender {event['number']}")

    # ---- Parts ----

    def _calm(self, announced):
        """Whether its broker had the directory: no fault kept it from NATS for a while before."""
        t = announced["t"]
        return not any(begin <= t and (end is None or end > t - APART_S) for begin, end in self._apart[announced["broker"]])

    def _note_motion(self, viewer, t):
        self._moved[viewer] = t
        for time in self._pending.pop(viewer, ()):
            time.seconds = t - time.since
            self.times.append(time)

    def _violate(self, code, t, text):
        if len(self.violations) < MOST_KEPT:
            self.violations.append(Violation(code, t, text))


def judged(events):
    judge = Judge()
    t = 0.0
    for event in events:
        judge.take(event)
        t = event["t"]
    judge.finish(t)
    return judge.violations


def distribution(seconds):
    """Of times to motion: count, percentiles, the share within two seconds."""
    ordered = sorted(seconds)
    at = lambda share: round(ordered[min(int(share * len(ordered)), len(ordered) - 1)], 3) if ordered else None
    return {"count": len(ordered), "p50_s": at(0.5), "p95_s": at(0.95), "p99_s": at(0.99), "longest_s": at(1.0),
            "within_2_s": round(sum(s <= 2 for s in ordered) / len(ordered), 4) if ordered else None}
