#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Breaks a cluster of three brokers over three NATS servers for as long as asked, and holds what its viewers saw and its recordings
kept against what it promises (judge.py).

    checker.py FOLDER-OF-PROGRAMS [--seconds 35] [--seed N] [--only KIND,KIND] [--every 1.5] [--clock LIBRARY] [--broker FILE]
               [--history FILE] [--keep FOLDER]

Prints every fault, then one line of JSON: faults survived, and how soon motion came back. The seed names the faults and their times; what
else the machine did meanwhile, it cannot. Needs root, network namespaces and nats-server, else it says SKIPPED.
"""
import argparse
import asyncio
import collections
import contextlib
import itertools
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import faults
import judge
import scene

SKIPPED = 77
RECOVERY_S = 180.0  # No promise: a bound, so that a broken cluster ends the test.


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", help="folder of eigencast-broker and eigencast-sender")
    parser.add_argument("--seconds", type=float, default=35, help="how long faults befall it")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--only", default="", help=f"kinds of faults: {', '.join(faults.KINDS)}")
    parser.add_argument("--every", type=float, default=1.5, help="seconds from one fault to the next, on average")
    parser.add_argument("--clock", default="-", help="tests/support/stepped_clock.cpp's library; without it (-) clocks are not stepped")
    parser.add_argument("--broker", default="", help="a broker other than FOLDER-OF-PROGRAMS/eigencast-broker")
    parser.add_argument("--history", default="", help="every event, for reading")
    parser.add_argument("--keep", default="", help="where logs and recordings of a failure go")
    return parser.parse_args()


async def check(world, plan):
    await world.start()
    await world.wait_for(lambda: not world.judge.still(), "all viewers move before the first fault", RECOVERY_S)
    print(f"all {len(world.peers)} viewers move after {time.monotonic() - world.began:.1f} s", flush=True)
    began, tasks = time.monotonic(), []
    for fault in plan:
        await asyncio.sleep(max(0, began + fault.at - time.monotonic()))
        print(fault, flush=True)
        tasks.append(asyncio.get_running_loop().create_task(world.befall(fault)))
        tasks = [task for task in tasks if not task.done() or task.result()]
    for task in tasks:
        await task
    world.note("healed")
    healed = time.monotonic()
    with contextlib.suppress(TimeoutError):  # finish() says who does not.
        await world.wait_for(lambda: not world.judge.still(), "all viewers move again", RECOVERY_S)
    again_s = time.monotonic() - healed
    world.judge.finish(time.monotonic() - world.began)
    for machine in world.machines.values():
        machine.expect()
    await world.end_peers()
    await world.start_and_stop_brokers()
    return again_s, world.read_recordings()


def played(world, files, dice):
    """Recordings of real coefficients go through eigencast-sender replay. Returns why one does not."""
    real = [file for file in files if file.name.startswith("r.") and file.stat().st_size > 20_000]
    if not real:
        return ""
    file = dice.choice(real)
    broker = world.brokers["b1"]
    broker.start()
    try:
        until = time.monotonic() + 60
        while not broker.asks("/livez") and time.monotonic() < until:
            time.sleep(0.1)
        run = world.away.run(world.programs / "eigencast-sender", "--no-progress", "replay", file, "--duration", "1", "--to",
                             f"ws://{broker.host.address}:{scene.peers.PORT}/again", stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        output = run.communicate(timeout=60)[0]
        return "" if run.returncode == 0 else f"{file.name}: replay ends with {run.returncode}: {output[-500:]}"
    finally:
        broker.signal(9)
        broker.process.wait()
        broker.process = None


def main():
    options = arguments()
    why = scene.unavailable()
    if why:
        print(f"SKIPPED: {why}")
        return SKIPPED
    seed = options.seed if options.seed is not None else int.from_bytes(os.urandom(3), "big")
    folder = pathlib.Path(tempfile.mkdtemp(prefix="eigencast-checker-"))
    programs = pathlib.Path(options.programs).resolve()
    if options.broker:
        (folder / "bin").mkdir()
        for name, file in (("eigencast-broker", pathlib.Path(options.broker).resolve()), ("eigencast-sender", programs / "eigencast-sender")):
            (folder / "bin" / name).symlink_to(file)
        programs = folder / "bin"
    judged = judge.Judge()
    history = open(options.history, "w") if options.history else None
    world = scene.World(programs, folder, options.clock.strip("-"), judged, history)
    only = set(options.only.split(",")) - {""}
    assert only <= set(faults.KINDS), f"--only: {sorted(only - set(faults.KINDS))} are no kinds of faults"
    plan = faults.schedule(seed, options.seconds, world.targets(), [kind for kind in world.kinds() if not only or kind in only], options.every)
    print(f"seed {seed}, {len(plan)} faults in {options.seconds:.0f} s", flush=True)
    for left in world.left_out:
        print(f"left out: {left}")
    failed = True
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # Ends what runs on the hosts.
    try:
        again_s, files = asyncio.run(check(world, plan))
        if why := played(world, files, random.Random(seed)):
            judged.take({"what": "recording", "t": time.monotonic() - world.began, "file": "", "why": why})
        failed = bool(judged.violations)
        spread = lambda wanted: judge.distribution([time.seconds for time in judged.times if wanted(time)])
        print(json.dumps({
            "seed": seed, "seconds": options.seconds, "faults": dict(collections.Counter(fault.kind for fault in plan)), "faults_survived": len(plan),
            "violations": len(judged.violations), "codes": dict(collections.Counter(violation.code for violation in judged.violations)),
            "viewers": len(world.peers), "frames": judged.counts["frame"], "links": judged.counts["link"], "announcements": judged.counts["announced"], "recordings": len(files), "last_viewer_moves_after_s": round(again_s, 2),
            "to_motion": spread(lambda time: True), "of_one_fault_at_a_time": spread(lambda time: time.alone),
            "of_viewers_that_stood": spread(lambda time: time.stood), "of_both": spread(lambda time: time.alone and time.stood),
            "of_both_by_kind": {kind: spread(lambda time: time.alone and time.stood and time.kind == kind) for kind in faults.KINDS}}))
    finally:
        if failed:
            print(f"FAILED: {len(judged.violations)} violations; again with --seed {seed} --seconds {options.seconds:g} --every {options.every:g}"
                  + (f" --only {options.only}" if only else ""))
            for viewer, reason in judged.still().items():
                print(f"stands still: {viewer}, {reason}")
            for same in itertools.groupby(sorted(judged.violations, key=lambda violation: violation.code), lambda violation: violation.code):
                print("\n".join(map(str, itertools.islice(same[1], 10))))
            for log in sorted(folder.glob("*.log")):
                print(f"--- {log.name}\n{log.read_text(errors='replace')[-1500:]}")
            if options.keep:
                shutil.copytree(folder, options.keep, dirs_exist_ok=True)
        world.close()
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
