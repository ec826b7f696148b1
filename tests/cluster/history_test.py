#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Made-up histories: a good one passes, and each broken promise is named. The same for the schedule of faults and the reader of
recordings."""
import copy
import json
import struct
import unittest

import nemesis
import poses
import recordings
from history import ESTIMATE, JOIN, KEY, MOTION, STEP, checked, distribution
from said import said_after

RAW, LINEAR, CURVED, ESTIMATED = ({"rate": "raw"}, {"rate": "interpolated", "k": 2}, {"rate": "interpolated", "k": 2, "scheme": "catmull-rom"},
                                  {"rate": "estimated"})
INTERVAL = 50_000


class History:
    """A cluster as a viewer sees it, an event each 0.1 s."""

    def __init__(self):
        self.events, self.t = [], 0.0

    def record(self, what, **fields):
        self.t = round(self.t + 0.1, 3)
        self.events.append({"what": what, "t": self.t, **fields})
        return self

    def announced(self, epoch, announcement=None, broker="b1", stream="s", continues=False):
        return self.record("announced", stream=stream, epoch=epoch, broker=broker, announcement=epoch if announcement is None else announcement,
                           continues=continues)

    def connected(self, profile, epoch=5, viewer="v", run="first", broker="b1"):
        self.epoch, self.viewer, self.profile = epoch, viewer, profile
        self.record("connected", viewer=viewer, stream="s", number=1, broker=broker, run=run)
        return self.state(epoch, profile)

    def state(self, epoch, profile=None, stream="s"):
        self.epoch, self.profile = epoch, profile or self.profile
        return self.record("state", viewer=self.viewer, stream=stream, id=7, epoch=epoch, profile=self.profile, state="live")

    def frame(self, kind, sequence, at=0, of=0, ahead=False, **other):
        position = sequence + (at / of if kind == ESTIMATE else 0 if kind != STEP and not at else at / of - 1)
        fields = {"viewer": self.viewer, "kind": kind, "id": 7, "epoch": self.epoch, "sequence": sequence, "at": at, "of": of, "ahead": ahead,
                  "capture": round(position * INTERVAL), "tag": None if kind == ESTIMATE else (1, self.epoch, position if kind == STEP else sequence)}
        return self.record("frame", **{**fields, **other})

    def keys(self, first, last):
        self.frame(JOIN, first)
        for sequence in range(first + 1, last + 1):
            self.frame(KEY, sequence)
        return self

    def said(self, person, times):
        return self.record("said", person=person, times=times)

    def entered(self, person, id, run="first", broker="b1"):
        return self.record("entered", person=person, broker=broker, run=run, id=id)

    def heard(self, person, id, name, times, **other):
        return self.record("heard", person=person, id=id, name=name, values={**(said_after(times) if times else {}), **other})

    def fault(self, kind, disturbs=(), isolates=(), number=1):
        return self.record("fault", number=number, kind=kind, phase="begin", disturbs=disturbs, isolates=isolates)

    def over(self, number=1):
        return self.record("fault", number=number, kind="", phase="over")

    def wait(self, seconds):
        self.t += seconds
        return self

    def moves(self, first=100):
        """Enough to be counted as motion."""
        return self.keys(first, first + MOTION)

    def checked(self):
        return checked(copy.deepcopy(self.events))

    def codes(self):
        return [violation.code for violation in self.checked().violations]


def good():
    return History().announced(5).connected(RAW).moves()


class Histories(unittest.TestCase):
    def assert_codes(self, history, *codes):
        self.assertEqual(sorted(set(history.codes())), sorted(codes))

    def test_motion_of_every_profile_is_good(self):
        self.assert_codes(good())
        for profile, frames in ((LINEAR, lambda h, s: h.frame(KEY, s, 1, 2, ahead=True).frame(STEP, s, 2, 2, tag=None)),
                                (CURVED, lambda h, s: h.frame(KEY, s, ahead=True).frame(STEP, s, 1, 2).frame(STEP, s, 2, 2, tag=None)),
                                (ESTIMATED, lambda h, s: h.frame(KEY, s).frame(ESTIMATE, s, 1, 2))):
            history = History().announced(5).connected(profile).frame(JOIN, 0, ahead=profile is CURVED)
            for sequence in range(1, 20):
                frames(history, sequence)
            self.assert_codes(history)

    def test_a_takeover_is_good(self):
        self.assert_codes(good().announced(6, broker="b2").state(6).moves(0))

    def test_poses_go_on_where_an_epoch_continues(self):
        changed = lambda profile=RAW: (History().announced(5).connected(profile).moves().announced(6, continues=True).frame(KEY, 111)
                                       .state(6))
        self.assert_codes(changed().moves(112))
        self.assert_codes(changed().frame(JOIN, 112, capture=110 * INTERVAL).moves(113), "stale")
        self.assert_codes(good().announced(6).state(6).frame(JOIN, 0, capture=5).moves(1))  # Of another sender's clock.
        self.assert_codes(changed().frame(JOIN, 112, tag=(1, 5, 112)).moves(113), "foreign")

    def test_keys_of_a_memory_that_nobody_holds(self):
        held = lambda why="": good().record("memory", viewer="v", generation=1, segments=1, why=why)
        self.assert_codes(held().frame(KEY, 111, recalled=True))
        self.assert_codes(good().frame(KEY, 111, recalled=True), "undecodable")
        self.assert_codes(held().connected(RAW).frame(JOIN, 111, recalled=True).moves(112), "undecodable")
        self.assert_codes(held().announced(6).state(6).frame(JOIN, 0, recalled=True).moves(1), "undecodable")
        self.assert_codes(held("other bytes"), "memory")

    def test_a_room(self):
        room = lambda: good().entered("p", 1).entered("q", 2).said("p", 7).said("p", 8).heard("q", 1, "p", 7).said("q", 3).heard("p", 2, "q", 3)
        self.assert_codes(room().heard("q", 1, "p", 8).heard("q", 1, "p", 0))  # In the end it has left.
        self.assert_codes(room().heard("q", 1, "p", 8).heard("q", 1, "p", 7), "stale")
        self.assert_codes(room().heard("q", 1, "p", 8).entered("q", 2).heard("q", 1, "p", 7), "stale")  # It came back to the same run.
        self.assert_codes(room().heard("q", 1, "p", 8).entered("q", 4, "second").heard("q", 1, "p", 7))
        self.assert_codes(room().heard("q", 1, "p", 9), "foreign")
        self.assert_codes(room().heard("q", 1, "r", 1), "foreign")
        self.assert_codes(room().heard("q", 1, "p", 8, k4=4), "other-values")  # Which had been removed.

    def test_somebody_who_hears_nothing_any_more(self):
        room = lambda: good().entered("p", 1).entered("q", 2).said("p", 7).said("q", 3).record("healed").moves(111)
        self.assert_codes(room().heard("q", 1, "p", 7).heard("p", 2, "q", 3), "stalled")
        room_heard = room().said("p", 8).said("q", 4).heard("q", 1, "p", 8).heard("p", 2, "q", 4)
        self.assert_codes(room_heard)
        self.assert_codes(room_heard.entered("p", 3), "stalled")
        self.assert_codes(good().entered("p", 1).said("p", 7).entered("q", 2, broker="b2").said("q", 3))  # Of two brokers: two rooms.

    def test_a_viewer_that_skips_gets_a_join(self):
        self.assert_codes(good().frame(JOIN, 150).frame(KEY, 151))
        self.assert_codes(good().frame(KEY, 150), "undecodable")
        self.assert_codes(History().announced(5).connected(RAW).frame(KEY, 1).moves(), "undecodable")

    def test_frames_out_of_order(self):
        self.assert_codes(good().frame(KEY, 112).frame(KEY, 111), "undecodable", "stale")
        self.assert_codes(good().frame(JOIN, 105), "stale")
        self.assert_codes(good().frame(KEY, 111, capture=5), "stale")

    def test_a_pose_after_a_newer_one(self):
        history = History().announced(5).connected(LINEAR).moves()
        self.assert_codes(copy.deepcopy(history).frame(KEY, 111, 2, 3, ahead=True).frame(STEP, 111, 1, 3, tag=None), "stale")
        self.assert_codes(history.frame(KEY, 111, 2, 3, ahead=True).frame(KEY, 112, 1, 9, ahead=True, capture=5), "stale")
        history = History().announced(5).connected(CURVED).moves()
        self.assert_codes(history.frame(KEY, 111, ahead=True).frame(STEP, 111, 2, 2, tag=None).frame(STEP, 111, 1, 2, tag=None), "stale")

    def test_a_key_corrects_an_estimate_and_no_estimate_goes_back(self):
        history = History().announced(5).connected(ESTIMATED).moves().frame(ESTIMATE, 110, 3, 1)
        self.assert_codes(copy.deepcopy(history).frame(KEY, 111).frame(ESTIMATE, 111, 3, 1))
        self.assert_codes(history.frame(KEY, 111).frame(ESTIMATE, 111, 1, 1), "stale")

    def test_a_profile_that_is_further_behind_may_go_back(self):
        self.assert_codes(good().state(5, LINEAR).frame(JOIN, 110, capture=110 * INTERVAL - 9))
        self.assert_codes(good().frame(JOIN, 110, capture=110 * INTERVAL - 9), "stale")
        ahead = History().announced(5).connected(CURVED).moves().frame(KEY, 111, ahead=True)
        self.assert_codes(copy.deepcopy(ahead).state(5, LINEAR).frame(JOIN, 110))
        shown = ahead.frame(STEP, 111, 1, 1, tag=None)
        self.assert_codes(shown.state(5, LINEAR).frame(JOIN, 110), "stale")

    def test_stale_after_a_reconnection_to_the_same_run(self):
        self.assert_codes(good().connected(RAW).moves(90), "stale")
        self.assert_codes(good().connected(RAW, run="second").moves(90))

    def test_an_epoch_that_falls_at_a_viewer(self):
        history = good().announced(6).state(6).moves()
        self.assert_codes(history.state(5).moves().announced(7).state(7).moves(), "epoch-fell")
        self.assert_codes(good().announced(6).state(6).moves().state(0).state(6).moves(111))  # Forgotten, and followed again.

    def test_an_epoch_that_is_not_grown_at_a_sender(self):
        self.assert_codes(good().announced(5, 9), "epoch-twice")
        self.assert_codes(good().announced(6).announced(4).state(6).announced(7).state(7).moves(), "epoch-fell")
        self.assert_codes(good().announced(6).announced(4, broker="b2").announced(7).state(7).moves(), "epoch-fell")

    def test_brokers_that_are_apart_may_fall_back_but_not_repeat(self):
        apart = lambda: good().fault("cut-broker", isolates=["b2"]).announced(6)
        self.assert_codes(apart().announced(4, broker="b2").announced(7).state(7).moves())
        self.assert_codes(apart().announced(6, 9, broker="b2").announced(7).state(7).moves(), "epoch-twice")

    def test_a_frame_of_another_epoch_than_was_said(self):
        self.assert_codes(good().frame(KEY, 111, epoch=4), "unannounced")
        self.assert_codes(good().frame(KEY, 111, id=8), "unannounced")

    def test_foreign_poses(self):
        self.assert_codes(good().frame(KEY, 111, tag=(2, 5, 111.0)), "foreign")
        self.assert_codes(good().frame(KEY, 111, tag=(1, 4, 111.0)), "foreign")  # Of an earlier announcement.
        self.assert_codes(good().state(5, stream="t"), "foreign")
        self.assert_codes(good().frame(KEY, 111, tag=(1, 5, 104.0)), "other-pose")
        history = History().announced(5).connected(LINEAR).moves().frame(STEP, 110, 1, 2, capture=111 * INTERVAL, tag=(1, 5, 111.5))
        self.assert_codes(history, "other-pose")

    def test_a_viewer_that_never_comes(self):
        self.assert_codes(good().record("viewer", viewer="w", stream="s", number=1), "stalled")

    def test_a_viewer_that_stands_still(self):
        self.assert_codes(good().record("healed"), "stalled")
        self.assert_codes(good().record("healed").frame(KEY, 111), "stalled")
        self.assert_codes(good().record("healed").moves(111))
        self.assert_codes(good().announced(6), "stalled")  # It watches on what the sender left.
        self.assert_codes(good().connected(RAW, viewer="other").moves().state(6).moves(), "stalled")  # Two epochs at once.

    def test_repeating_the_last_pose_is_no_motion(self):
        history = good().record("healed")
        for _ in range(20):
            history.frame(JOIN, 110)
        self.assert_codes(history, "stalled")

    def test_ends(self):
        self.assert_codes(good().record("exit", program="b1", status=0, asked=True))
        self.assert_codes(good().record("exit", program="b1", status=1, asked=True), "ended-badly")
        self.assert_codes(good().record("exit", program="b1", status=-11, asked=False), "died")

    def test_recordings(self):
        kept = {"file": "f", "stream": "s", "number": 1, "whole": True, "tags": [[(1, 5)], []], "why": ""}
        one = lambda **other: good().record("recording", **{**kept, **other})
        self.assert_codes(one())
        self.assert_codes(one(whole=False), "recording")
        self.assert_codes(one(why="torn"), "recording")
        self.assert_codes(one(tags=[[(2, 5)]]), "foreign")
        self.assert_codes(one(tags=[[(1, 5), (1, 4)]]), "foreign")

    def test_an_outage_counts_without_the_times_of_faults_that_disturb_it(self):
        def recovery(history):
            return [(outage.kind, round(outage.recovery_s, 1)) for outage in history.checked().outages]
        after = lambda history: history.frame(JOIN, 150)
        self.assertEqual(recovery(after(good().wait(0.3))), [])
        self.assertEqual(recovery(after(good().wait(3))), [("", 3.1)])
        # 0.1 s before the fault, 2 s after it.
        paused = lambda what: good().fault("pause", [what]).wait(5).over().wait(1.9)
        self.assertEqual(recovery(after(paused("b1"))), [("pause", 2.1)])
        self.assertEqual(recovery(after(paused("s"))), [("pause", 2.1)])
        self.assertEqual(recovery(after(paused("b2"))), [("", 7.2)])  # The viewer and the sender are at b1.
        self.assertEqual(recovery(after(paused("nats"))), [("", 7.2)])
        self.assertEqual(recovery(after(paused("b1").fault("kill", ["b1"], number=2).wait(4).over(2))), [("kill", 2.2)])
        overlapping = good().fault("pause", ["b1"]).wait(5).fault("kill", ["b1"], number=2).wait(5).over().wait(5).over(2)
        self.assertEqual(recovery(after(overlapping)), [("kill", 0.2)])
        remote = lambda what: (History().announced(5).connected(RAW, broker="b2").moves().fault("pause", [what]).wait(5).over().wait(1.9))
        for what in ("b1", "b2", "nats"):
            self.assertEqual(recovery(after(remote(what))), [("pause", 2.1)])
        moved = good().fault("pause", ["b1"]).wait(5).announced(6, broker="b2").state(6).frame(JOIN, 0)
        self.assertEqual(recovery(moved.frame(KEY, 1)), [("pause", 0.1)])

    def test_what_a_broker_held_is_no_motion(self):
        history = good().wait(5).connected(RAW, run="second").frame(JOIN, 110).wait(5)
        self.assertEqual([outage.ended - outage.began > 10 for outage in history.frame(KEY, 111).checked().outages], [True])

    def test_shares_and_percentiles(self):
        self.assertEqual(distribution([1.0] * 19 + [3.0])["within_2_s"], 0.95)
        self.assertEqual(distribution([])["count"], 0)


class Schedule(unittest.TestCase):
    TARGETS = {"brokers": ["b1", "b2", "b3"], "nats": ["n1", "n2", "n3"], "senders": ["s0", "s1"]}

    def test_the_same_seed_gives_the_same_faults(self):
        self.assertEqual(nemesis.schedule(7, 60, self.TARGETS), nemesis.schedule(7, 60, self.TARGETS))
        self.assertNotEqual(nemesis.schedule(7, 60, self.TARGETS), nemesis.schedule(8, 60, self.TARGETS))

    def test_all_are_over_in_time_and_none_befalls_who_suffers_one(self):
        plan = nemesis.schedule(1, 3600, self.TARGETS)
        self.assertEqual({fault.kind for fault in plan}, set(nemesis.KINDS))
        until = {}
        for fault in plan:
            self.assertGreaterEqual(fault.at, until.get(fault.target, 0))
            self.assertLessEqual(fault.at + fault.lasts, 3600.001)
            until[fault.target] = fault.at + fault.lasts

    def test_kinds_can_be_chosen(self):
        self.assertEqual({fault.kind for fault in nemesis.schedule(1, 600, self.TARGETS, ["kill-nats"])}, {"kill-nats"})


def record(kind, time, body):
    head = struct.pack("<IBQ", len(body), kind, time)
    return head + struct.pack("<I", recordings.crc32c(head + body)) + body


def recording(end=True):
    """Three keys of sender 1, its announcement 5."""
    out = recordings.MAGIC + struct.pack("<I", 2) + record(recordings.START, 0, bytes(8) + b"\1s" + b"\4test")
    announce = len(out)
    out += record(recordings.ANNOUNCE, 0, json.dumps({"format": poses.form(False)}).encode())
    checkpoint = len(out)
    chain = poses.Chain()
    pose = lambda kind, sequence: chain.write(kind, 3, sequence, sequence + 1) + poses.payload(kind, 1, 5, sequence, 30, False)
    out += record(recordings.CHECKPOINT, 0, pose(JOIN, 0))
    out += b"".join(record(recordings.FRAME, s, pose(KEY, s)) for s in (1, 2, 3))
    index = len(out)
    out += record(recordings.INDEX, 3, struct.pack("<QQQQ", 0, 0, checkpoint, announce))
    return out + (record(recordings.END, 3, struct.pack("<QQQ", index, 3, 0)) if end else b"")


class Recordings(unittest.TestCase):
    def read(self, data):
        return recordings.read(data, lambda stream: 3)

    def test_the_sum_is_castagnolis(self):
        self.assertEqual(recordings.crc32c(b"123456789"), 0xE3069283)

    def test_a_whole_one(self):
        self.assertEqual(self.read(recording()), {"stream": "s", "whole": True, "tags": [{(1, 5)}], "frames": 3, "why": ""})

    def test_a_torn_one_is_not_whole(self):
        whole = recording()
        for data in (recording(end=False), whole[:-1], whole + b"x", whole[:200] + b"\xff" + whole[201:]):
            self.assertFalse(self.read(data)["whole"])

    def test_what_begins_with_nothing_is_named(self):
        for data in (b"", b"ECRECOR\n\2\0\0\0", recording()[:30]):
            self.assertTrue(self.read(data)["why"])


if __name__ == "__main__":
    unittest.main()
