#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The judge, on histories that were made up: a good one passes, and each promise that is broken is named. The same for the schedule of
faults and the reader of recordings."""
import copy
import json
import struct
import unittest

import faults
import judge
import poses
import recordings
from judge import ESTIMATE, JOIN, KEY, STEP, SYNTHETIC

RAW, INTERPOLATED, COMPACT, ESTIMATED = ({"rate": "raw"}, {"rate": "interpolated", "k": 2}, {"rate": "interpolated", "k": 2, "form": "compact"},
                                         {"rate": "estimated"})
INTERVAL = 50_000


class History:
    """A cluster as a viewer sees it; time is the number of the event."""

    def __init__(self):
        self.events = []

    def note(self, what, **fields):
        self.events.append({"what": what, "t": float(len(self.events)), **fields})
        return self

    def announced(self, epoch, said=None, broker="b1", stream="s"):
        return self.note("announced", stream=stream, epoch=epoch, broker=broker, said=epoch if said is None else said)

    def link(self, profile, epoch=5, viewer="v", run="first"):
        self.epoch, self.viewer, self.profile = epoch, viewer, profile
        self.note("link", viewer=viewer, stream="s", number=1, run=run)
        return self.state(epoch, profile)

    def state(self, epoch, profile=None, stream="s"):
        self.epoch, self.profile = epoch, profile or self.profile
        return self.note("state", viewer=self.viewer, stream=stream, id=7, epoch=epoch, profile=self.profile, state="live")

    def frame(self, kind, sequence, at=0, of=0, ahead=False, **other):
        position = sequence - 1 + at / of if kind in (SYNTHETIC, STEP) else sequence + (at / of if of else 0)
        fields = {"viewer": self.viewer, "kind": kind, "id": 7, "epoch": self.epoch, "sequence": sequence, "at": at, "of": of, "ahead": ahead,
                  "capture": round(position * INTERVAL), "said": (1, self.epoch, position)}
        return self.note("frame", **{**fields, **other})

    def keys(self, first, last):
        self.frame(JOIN, first)
        for sequence in range(first + 1, last + 1):
            self.frame(KEY, sequence)
        return self

    def fault(self, kind, apart):
        self.note("fault", number=1, kind=kind, phase="begin", apart=apart)
        return self.note("fault", number=1, kind=kind, phase="over", apart=[])

    def moves(self, first=100):
        """Enough to be counted as motion."""
        return self.keys(first, first + judge.MOVES)

    def codes(self):
        return [violation.code for violation in judge.judged(copy.deepcopy(self.events))]


def good():
    return History().announced(5).link(RAW).moves()


class Judge(unittest.TestCase):
    def assert_codes(self, history, *codes):
        self.assertEqual(sorted(set(history.codes())), sorted(codes))

    def test_motion_of_every_profile_is_good(self):
        self.assert_codes(good())
        for profile, frames in ((INTERPOLATED, lambda h, s: h.frame(SYNTHETIC, s, 1, 2).frame(KEY, s)),
                                (COMPACT, lambda h, s: h.frame(KEY, s, ahead=True).frame(STEP, s, 1, 2, said=None).frame(STEP, s, 2, 2, said=None)),
                                (ESTIMATED, lambda h, s: h.frame(KEY, s).frame(ESTIMATE, s, 1, 2))):
            history = History().announced(5).link(profile).frame(JOIN, 0, ahead=profile is COMPACT)
            for sequence in range(1, 20):
                frames(history, sequence)
            self.assert_codes(history)

    def test_a_takeover_is_good(self):
        self.assert_codes(good().announced(6, broker="b2").state(6).moves(0))

    def test_a_viewer_that_skips_gets_a_join(self):
        self.assert_codes(good().frame(JOIN, 150).frame(KEY, 151))
        self.assert_codes(good().frame(KEY, 150), "undecodable")
        self.assert_codes(History().announced(5).link(RAW).frame(KEY, 1).moves(), "undecodable")

    def test_frames_out_of_order(self):
        self.assert_codes(good().frame(KEY, 112).frame(KEY, 111), "undecodable", "stale")
        self.assert_codes(good().frame(JOIN, 105), "stale")
        self.assert_codes(good().frame(KEY, 111, capture=5), "stale")

    def test_a_pose_after_a_newer_one(self):
        history = History().announced(5).link(INTERPOLATED).moves()
        self.assert_codes(history.frame(SYNTHETIC, 111, 2, 3).frame(SYNTHETIC, 111, 1, 3), "stale")
        history = History().announced(5).link(COMPACT).moves()
        self.assert_codes(history.frame(KEY, 111, ahead=True).frame(STEP, 111, 2, 2, said=None).frame(STEP, 111, 1, 2, said=None), "stale")

    def test_a_key_corrects_an_estimate_and_no_estimate_goes_back(self):
        history = History().announced(5).link(ESTIMATED).moves().frame(ESTIMATE, 110, 3, 1)
        self.assert_codes(copy.deepcopy(history).frame(KEY, 111).frame(ESTIMATE, 111, 3, 1))
        self.assert_codes(history.frame(KEY, 111).frame(ESTIMATE, 111, 1, 1), "stale")

    def test_a_profile_that_is_further_behind_may_go_back(self):
        self.assert_codes(good().state(5, INTERPOLATED).frame(JOIN, 110, capture=110 * INTERVAL - 9))
        self.assert_codes(good().frame(JOIN, 110, capture=110 * INTERVAL - 9), "stale")

    def test_stale_after_a_reconnection_to_the_same_run(self):
        self.assert_codes(good().link(RAW).moves(90), "stale")
        self.assert_codes(good().link(RAW, run="second").moves(90))

    def test_an_epoch_that_falls_at_a_viewer(self):
        history = good().announced(6).state(6).moves()
        self.assert_codes(history.state(5).moves().announced(7).state(7).moves(), "epoch-fell")
        self.assert_codes(good().announced(6).state(6).moves().state(0).state(6).moves(111))  # Forgotten, and followed again.

    def test_an_epoch_that_is_not_grown_at_a_sender(self):
        self.assert_codes(good().announced(5, 9), "epoch-twice")
        self.assert_codes(good().announced(6).announced(4).state(6).announced(7).state(7).moves(), "epoch-fell")
        self.assert_codes(good().announced(6).announced(4, broker="b2").announced(7).state(7).moves(), "epoch-fell")

    def test_brokers_that_are_apart_may_fall_back_but_not_repeat(self):
        apart = lambda: good().note("fault", number=1, kind="cut-broker", phase="begin", apart=["b2"]).announced(6)
        self.assert_codes(apart().announced(4, broker="b2").announced(7).state(7).moves())
        self.assert_codes(apart().announced(6, 9, broker="b2").announced(7).state(7).moves(), "epoch-twice")

    def test_a_frame_of_another_epoch_than_was_said(self):
        self.assert_codes(good().frame(KEY, 111, epoch=4), "unannounced")
        self.assert_codes(good().frame(KEY, 111, id=8), "unannounced")

    def test_foreign_poses(self):
        self.assert_codes(good().frame(KEY, 111, said=(2, 5, 111.0)), "foreign")
        self.assert_codes(good().frame(KEY, 111, said=(1, 4, 111.0)), "foreign")  # Of an earlier announcement.
        self.assert_codes(good().state(5, stream="t"), "foreign")
        self.assert_codes(good().frame(KEY, 111, said=(1, 5, 104.0)), "other-pose")
        history = History().announced(5).link(INTERPOLATED).moves().frame(SYNTHETIC, 111, 1, 2, said=(1, 5, 111.5))
        self.assert_codes(history, "other-pose")

    def test_a_viewer_that_never_comes(self):
        self.assert_codes(good().note("viewer", viewer="w", stream="s", number=1), "still")

    def test_a_viewer_that_stands_still(self):
        fault = lambda history: history.fault("kill-nats", ["b1"])
        self.assert_codes(fault(good()).note("healed"), "still")
        self.assert_codes(fault(good()).note("healed").frame(KEY, 111), "still")
        self.assert_codes(fault(good()).note("healed").moves(111))
        self.assert_codes(good().announced(6), "still")  # It watches on what the sender left.
        self.assert_codes(good().link(RAW, viewer="other").moves().state(6).moves(), "still")  # Two epochs at once.

    def test_repeating_the_last_pose_is_no_motion(self):
        history = good().note("healed")
        for _ in range(20):
            history.frame(JOIN, 110)
        self.assert_codes(history, "still")

    def test_ends(self):
        self.assert_codes(good().note("exit", who="b1", status=0, told=True))
        self.assert_codes(good().note("exit", who="b1", status=1, told=True), "ended-badly")
        self.assert_codes(good().note("exit", who="b1", status=-11, told=False), "died")

    def test_recordings(self):
        kept = {"file": "f", "stream": "s", "number": 1, "whole": True, "said": [{(1, 5)}, set()], "why": ""}
        one = lambda **other: good().note("recording", **{**kept, **other})
        self.assert_codes(one())
        self.assert_codes(one(whole=False), "recording")
        self.assert_codes(one(why="torn"), "recording")
        self.assert_codes(one(said=[{(2, 5)}]), "foreign")
        self.assert_codes(one(said=[{(1, 5), (1, 4)}]), "foreign")

    def test_times_count_from_the_end_of_a_fault(self):
        judged = judge.Judge()
        for event in good().fault("kill-nats", []).note("healed").frame(KEY, 111).events:
            judged.take(event)
        self.assertEqual(judged.times, [judge.Time("kill-nats", judged.times[0].since, stood=True, alone=True, seconds=2.0)])
        self.assertEqual(judge.distribution([1.0] * 19 + [3.0])["within_2_s"], 0.95)
        self.assertEqual(judge.distribution([])["count"], 0)


class Schedule(unittest.TestCase):
    TARGETS = {"brokers": ["b1", "b2", "b3"], "nats": ["n1", "n2", "n3"], "senders": ["s0", "s1"]}

    def test_the_same_seed_gives_the_same_faults(self):
        self.assertEqual(faults.schedule(7, 60, self.TARGETS), faults.schedule(7, 60, self.TARGETS))
        self.assertNotEqual(faults.schedule(7, 60, self.TARGETS), faults.schedule(8, 60, self.TARGETS))

    def test_all_are_over_in_time_and_none_befalls_who_suffers_one(self):
        plan = faults.schedule(1, 3600, self.TARGETS)
        self.assertEqual({fault.kind for fault in plan}, set(faults.KINDS))
        until = {}
        for fault in plan:
            self.assertGreaterEqual(fault.at, until.get(fault.target, 0))
            self.assertLessEqual(fault.at + fault.lasts, 3600.001)
            until[fault.target] = fault.at + fault.lasts

    def test_kinds_can_be_chosen(self):
        self.assertEqual({fault.kind for fault in faults.schedule(1, 600, self.TARGETS, ["kill-nats"])}, {"kill-nats"})


def record(kind, time, body):
    head = struct.pack("<IBQ", len(body), kind, time)
    return head + struct.pack("<I", recordings.crc32c(head + body)) + body


def recording(end=True):
    """Three keys of sender 1, its announcement 5."""
    out = recordings.MAGIC + struct.pack("<I", 1) + record(recordings.START, 0, bytes(8) + b"\1s" + b"\4test")
    announce = len(out)
    out += record(recordings.ANNOUNCE, 0, json.dumps({"format": poses.form(False)}).encode())
    checkpoint = len(out)
    pose = lambda kind, sequence: poses.frame(kind, 1, 5, sequence, sequence + 1, 30, False)
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
        self.assertEqual(self.read(recording()), {"stream": "s", "whole": True, "said": [{(1, 5)}], "frames": 3, "why": ""})

    def test_a_torn_one_is_not_whole(self):
        whole = recording()
        for data in (recording(end=False), whole[:-1], whole + b"x", whole[:200] + b"\xff" + whole[201:]):
            self.assertFalse(self.read(data)["whole"])

    def test_what_begins_with_nothing_is_named(self):
        for data in (b"", b"ECRECOR\n\1\0\0\0", recording()[:30]):
            self.assertTrue(self.read(data)["why"])


if __name__ == "__main__":
    unittest.main()
