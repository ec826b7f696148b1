# SPDX-License-Identifier: MIT
"""Checks a history of a cluster against what it promises. No sockets, no clocks: events in, violations and outages out.

An event is a dict with `what` and `t` (seconds, never falling):

    fault      number, kind, phase (begin, over); at its begin also disturbs (the brokers, the stream or "nats") and isolates (brokers
               that may be without NATS meanwhile)
    healed     from here on there are no faults: everything must move again
    announced  stream, epoch, broker, announcement, continues: a sender was granted an epoch; `announcement` is in the tags of its poses
               from here on; `continues`: on the connection of the one before, whose poses go on
    viewer     viewer, stream, number: there is one, which must move in the end
    connected  viewer, stream, number, broker, run: a viewer reached a broker's run (its session id); `number` is the stream's
    state      viewer, stream, id, epoch, profile: a `stream` message
    frame      viewer, kind, id, epoch, sequence, at, of, ahead, capture (of what it shows), tag: a binary message; `tag` = (stream, announcement,
               position) as its pose carries it, None where it carries none; `recalled`: a memory is needed to decode it
    memory     viewer, generation, segments, why: a viewer holds one, and says so from here on; `why`: what is wrong with its bytes
    said       person, times: somebody in a room says what said_after(times) has (said.py)
    entered    person, broker, run, id: is in the room of a broker, as this member
    heard      person, id, name, values: what it knows now of a member of which it was told something
    exit       program, status, asked: a program ended; `asked`: by SIGTERM
    recording  file, stream, number, whole, tags, why: one file after the brokers' last start; `tags` = list of (stream, announcement)
               sets, one for each announcement in it, `why` = what is wrong with its bytes, or ""
"""
import collections
import dataclasses

from said import said_after

KEY, JOIN, STEP, ESTIMATE = 1, 2, 3, 4
MOTION = 10  # So many newer poses in a row are motion.
STALL_S = 0.5  # An outage is a longer wait for a newer pose.
# A broker without the directory grants senders after 12 s; heartbeats and reconnections are in it.
ISOLATED_S = 20.0
MAX_KEPT = 1000


@dataclasses.dataclass
class Violation:
    code: str
    t: float
    text: str

    def __str__(self):
        return f"{self.t:9.3f} s  {self.code}: {self.text}"


@dataclasses.dataclass
class Outage:
    viewer: str
    began: float
    ended: float
    kind: str  # Of the last fault that disturbed the viewer meanwhile; "": none did.
    recovery_s: float  # Without the times at which such a fault was in force.


@dataclasses.dataclass
class Connection:
    """What one connection of a viewer has shown."""
    stream: str
    number: int
    broker: str = ""
    run: str = ""
    id: int = None
    epoch: int = 0
    profile: dict = None
    newest: int = None  # Sequence of the newest key.
    key_capture: int = -1
    shown: int = -1  # Capture time of the newest pose shown.
    poses: int = 0  # Newer ones of this epoch.
    remembers: bool = False  # It has held a memory of this epoch.


@dataclasses.dataclass
class Presence:
    """What somebody in a room has heard."""
    broker: str
    run: str
    id: int
    heard: dict = dataclasses.field(default_factory=dict)  # Name -> times, on this connection.


@dataclasses.dataclass
class Seen:
    """The newest that a viewer has seen of one run of a broker."""
    epoch: int = 0
    newest: int = -1


@dataclasses.dataclass
class Fault:
    kind: str
    disturbs: frozenset
    began: float
    ended: float = float("inf")


class Checker:
    """Events must come in order. Reads: violations, outages, counts, stalled()."""

    def __init__(self):
        self.violations = []
        self.outages = []
        self.counts = collections.Counter()
        self._announced = collections.defaultdict(list)  # Stream -> announced events.
        self._connections = {}  # Of each viewer the last one.
        self._seen = collections.defaultdict(Seen)
        self._faults = {}  # By number.
        self._isolated = collections.defaultdict(list)  # Broker -> Faults.
        self._said = collections.Counter()  # Person -> times.
        self._said_then = collections.Counter()  # When all was healed.
        self._presences = {}  # Of each person the last one.
        self._members = collections.Counter()  # Person, run, id of a member -> times heard of it.
        self._moved = {}  # Viewer -> time of its newest pose, what it needed then.

    def take(self, event):
        self.counts[event["what"]] += 1
        getattr(self, "_on_" + event["what"])(event)

    def stalled(self):
        """Viewers that have not moved since all was healed, they connected or a new epoch began, and why."""
        stalled = {}
        epochs = collections.defaultdict(set)
        for connection in self._connections.values():
            epochs[connection.stream].add(connection.epoch)
        for viewer, connection in self._connections.items():
            stream, epoch = connection.stream, connection.epoch
            announced = self._announced[stream]
            if announced and epoch != announced[-1]["epoch"]:
                stalled[viewer] = f"{stream}: at epoch {epoch}, its sender at {announced[-1]['epoch']}"
            elif connection.poses < MOTION:
                stalled[viewer] = f"{stream}: epoch {epoch}, {connection.poses} poses, the last at {self._moved.get(viewer, ('no time',))[0]}"
            elif len(epochs[stream]) > 1:
                stalled[viewer] = f"{stream}: epochs {sorted(epochs[stream])} at once"
        for person, presence in self._presences.items():
            for other, at in self._presences.items():
                heard = presence.heard.get(other, 0)
                if other != person and at.broker == presence.broker and heard <= self._said_then[other]:
                    stalled[person] = f"of {other} it has heard {heard} times, {self._said_then[other]} were said before all was healed"
        return stalled

    def finish(self, t):
        for viewer, why in sorted(self.stalled().items()):
            self._violate("stalled", t, f"{viewer} does not move again, {why}")

    # ---- Events ----

    def _on_fault(self, event):
        if event["phase"] == "over":
            self._faults[event["number"]].ended = event["t"]
            return
        self._faults[event["number"]] = fault = Fault(event["kind"], frozenset(event["disturbs"]), event["t"])
        for broker in event["isolates"]:
            self._isolated[broker].append(fault)

    def _on_healed(self, event):
        for connection in self._connections.values():
            connection.poses = 0
        self._said_then = self._said.copy()

    def _on_announced(self, event):
        stream, epoch = event["stream"], event["epoch"]
        self.counts["change-over"] += event.get("continues", False)
        for before in self._announced[stream]:
            if before["epoch"] == epoch:
                self._violate("epoch-twice", event["t"],
                              f"{stream}: {event['broker']} gives epoch {epoch}, which {before['broker']} gave at {before['t']:.3f} s")
            elif before["epoch"] > epoch and (before["broker"] == event["broker"] or not self._isolated_at(before) and not self._isolated_at(event)):
                self._violate("epoch-fell", event["t"],
                              f"{stream}: {event['broker']} gives epoch {epoch} after {before['epoch']} of {before['broker']} at {before['t']:.3f} s")
        self._announced[stream].append(event)

    def _on_viewer(self, event):
        self._connections[event["viewer"]] = Connection(event["stream"], event["number"])

    def _on_connected(self, event):
        self._connections[event["viewer"]] = Connection(event["stream"], event["number"], event["broker"], event["run"])

    def _on_state(self, event):
        connection = self._connections[event["viewer"]]
        if event["stream"] != connection.stream:
            return self._violate("foreign", event["t"], f"{event['viewer']} watches {connection.stream} and gets {event['stream']}")
        connection.id = event["id"]
        seen = self._seen[event["viewer"], connection.run]
        if event["epoch"] != connection.epoch:
            if 0 < event["epoch"] < seen.epoch:
                self._violate("epoch-fell", event["t"], f"{event['viewer']}: epoch {event['epoch']} after {seen.epoch}")
            goes_on = any(a["epoch"] == event["epoch"] and a.get("continues") for a in self._announced[connection.stream])
            if not goes_on or connection.epoch == 0 or (connection.profile or {}).get("rate") == "estimated":
                connection.key_capture = connection.shown = -1
            connection.epoch, connection.newest, connection.poses, connection.remembers = event["epoch"], None, 0, False
            if event["epoch"] > seen.epoch:
                seen.epoch, seen.newest = event["epoch"], -1
        if event["profile"] != connection.profile:  # Profiles differ in how far they are behind.
            connection.profile, connection.shown = event["profile"], -1

    def _on_frame(self, event):
        viewer, t, kind, sequence = event["viewer"], event["t"], event["kind"], event["sequence"]
        connection = self._connections[viewer]
        where = f"{viewer}, {connection.profile}: epoch {event['epoch']}, kind {kind} of {sequence} ({event['at']}/{event['of']})"
        if event["id"] != connection.id or event["epoch"] != connection.epoch:
            return self._violate("unannounced", t,
                                 f"{where} of stream {event['id']}: announced was stream {connection.id}, epoch {connection.epoch}")
        if event.get("recalled"):
            self.counts["recalled"] += 1
            if not connection.remembers:
                self._violate("undecodable", t, f"{where}: it needs a memory, of which the viewer has said nothing")
        self._check_chain(connection, event, where)
        self._check_tag(connection, event, where)
        seen = self._seen[viewer, connection.run]
        if kind in (KEY, JOIN):
            if sequence < seen.newest and event["epoch"] == seen.epoch:
                self._violate("stale", t, f"{where}: after {seen.newest}")
            connection.newest = sequence
        if event["at"] == event["of"] if kind == STEP else kind in (KEY, JOIN) and not event["ahead"]:  # It is shown.
            seen.newest = max(seen.newest, sequence)
        self._check_order(connection, event, where)

    def _check_chain(self, connection, event, where):
        """Section 5 of docs/protocol.md: what cannot be decoded need not be sent."""
        kind, sequence = event["kind"], event["sequence"]
        if kind == JOIN:
            return
        needed = sequence - 1 if kind == KEY else sequence
        if connection.newest != needed:
            code = "stale" if connection.newest is not None and needed < connection.newest else "undecodable"
            self._violate(code, event["t"], f"{where}: its newest key is {connection.newest}")

    def _check_order(self, connection, event, where):
        """No pose after a newer one; estimates are guesses, which the key that comes corrects."""
        if event["ahead"] and not event["at"]:
            return
        kind, capture = event["kind"], event["capture"]
        of_key = kind in (KEY, JOIN) and not event["ahead"]
        estimated = (connection.profile or {}).get("rate") == "estimated"
        least = connection.key_capture if estimated and of_key else connection.shown
        if capture < least or capture == least and kind == KEY:
            self._violate("stale", event["t"], f"{where}: captured at {capture}, after {least}")
        if of_key:
            connection.key_capture = max(connection.key_capture, capture)
        if capture > connection.shown:
            connection.shown = capture
            connection.poses += 1
            if connection.poses > 1:  # The first one may be what the broker held.
                self._end_outage(event["viewer"], event["t"])

    def _check_tag(self, connection, event, where):
        if event["tag"] is None:
            return
        stream, announcement, position = event["tag"]
        if stream != connection.number:
            return self._violate("foreign", event["t"], f"{where}: the pose is of sender {stream}, not of {connection.number}")
        given = [a for a in self._announced[connection.stream] if a["epoch"] == event["epoch"]]
        if given and announcement not in [a["announcement"] for a in given]:
            return self._violate("foreign", event["t"],
                                 f"{where}: the pose is of announcement {announcement}, the epoch of {given[-1]['announcement']}")
        straight = (connection.profile or {}).get("scheme", "linear") == "linear"  # Others overshoot, the more uneven the keys in time.
        between = (-1.001, 0.001) if straight else (-float("inf"), float("inf"))
        least, most = (0, 0) if event["kind"] in (KEY, JOIN) else between
        if not least <= position - event["sequence"] <= most:
            self._violate("other-pose", event["t"], f"{where}: the pose says {position}")

    def _on_memory(self, event):
        self._connections[event["viewer"]].remembers = True
        if event["why"]:
            self._violate("memory", event["t"], f"{event['viewer']}: generation {event['generation']}: {event['why']}")

    def _on_said(self, event):
        self._said[event["person"]] = event["times"]

    def _on_entered(self, event):
        self._presences[event["person"]] = Presence(event["broker"], event["run"], event["id"])

    def _on_heard(self, event):
        person, name, times = event["person"], event["name"], event["values"].get("times")
        presence = self._presences.get(person)
        where = f"{person} hears of member {event['id']} '{name}' {event['values']}"
        if presence is None or name not in self._said and times is not None:
            return self._violate("foreign", event["t"], f"{where}: nobody of that name has spoken")
        if times is None:  # It is silent, or has left.
            return
        if times > self._said[name]:
            self._violate("foreign", event["t"], f"{where}: it has spoken {self._said[name]} times")
        before = self._members[person, presence.run, event["id"]]
        if times < before:
            self._violate("stale", event["t"], f"{where}: after {before}")
        self._members[person, presence.run, event["id"]] = max(before, times)
        if event["values"] != said_after(times):
            self._violate("other-values", event["t"], f"{where}: it said {said_after(times)}")
        presence.heard[name] = max(presence.heard.get(name, 0), times)

    def _on_exit(self, event):
        if not event["asked"]:
            self._violate("died", event["t"], f"{event['program']} ended by itself with {event['status']}")
        elif event["status"] != 0:
            self._violate("ended-badly", event["t"], f"{event['program']} was asked to end and did with {event['status']}")

    def _on_recording(self, event):
        if event["why"]:
            return self._violate("recording", event["t"], f"{event['file']}: {event['why']}")
        if not event["whole"]:
            self._violate("recording", event["t"], f"{event['file']}: has no end, after a new start of its broker")
        known = {announced["announcement"] for announced in self._announced[event["stream"]]}
        for tags in event["tags"]:
            if len(tags) > 1 or any(stream != event["number"] or announcement not in known for stream, announcement in tags):
                self._violate("foreign", event["t"], f"{event['file']}: poses of {sorted(tags)} in a recording of sender {event['number']}")

    # ---- Parts ----

    def _isolated_at(self, announced):
        """Whether its broker may have been without the directory: a fault kept it from NATS then, or a while before."""
        return any(fault.began <= announced["t"] < fault.ended + ISOLATED_S for fault in self._isolated[announced["broker"]])

    def _needs(self, connection):
        """What frames pass on their way to it; None: of a sender that this program does not play, anything."""
        announced = self._announced[connection.stream]
        if not announced:
            return None
        source = announced[-1]["broker"]
        return {connection.stream, connection.broker, source} | ({"nats"} if source != connection.broker else set())

    def _end_outage(self, viewer, t):
        needs = self._needs(self._connections[viewer])
        began, needed = self._moved.get(viewer, (t, needs))
        self._moved[viewer] = t, needs
        if t - began <= STALL_S:
            return
        faults = [fault for fault in self._faults.values()
                  if fault.ended >= began and (needs is None or needed is None or fault.disturbs & (needs | needed))]
        recovery_s, at = 0.0, began
        for fault in sorted(faults, key=lambda fault: fault.began):
            recovery_s += max(0.0, fault.began - at)
            at = max(at, min(fault.ended, t))
        kind = max(faults, key=lambda fault: fault.began).kind if faults else ""
        self.outages.append(Outage(viewer, began, t, kind, recovery_s + t - at))

    def _violate(self, code, t, text):
        if len(self.violations) < MAX_KEPT:
            self.violations.append(Violation(code, t, text))


def checked(events):
    checker = Checker()
    t = 0.0
    for event in events:
        checker.take(event)
        t = event["t"]
    checker.finish(t)
    return checker


def distribution(seconds):
    """Count, percentiles, the share within two seconds."""
    ordered = sorted(seconds)
    at = lambda share: round(ordered[min(int(share * len(ordered)), len(ordered) - 1)], 3) if ordered else None
    return {"count": len(ordered), "p50_s": at(0.5), "p95_s": at(0.95), "p99_s": at(0.99), "longest_s": at(1.0),
            "within_2_s": round(sum(s <= 2 for s in ordered) / len(ordered), 4) if ordered else None}
