#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Breaks a cluster of three brokers over three NATS servers for as long as asked (nemesis.py), and checks the history of what its viewers
saw and its recordings kept against what it promises (history.py).

    checker.py FOLDER-OF-PROGRAMS [--seconds 60] [--seed N] [--only KIND,KIND] [--every 1.5] [--clock LIBRARY] [--broker FILE]
               [--recovery 180] [--history FILE] [--keep FOLDER]

Prints every fault, then one line of JSON: the faults survived, and the recovery from outages of viewers. The seed names the faults and their
times; what else the machine did meanwhile, it cannot. Needs root, network namespaces and nats-server, else it says SKIPPED.
"""
import argparse
import asyncio
import collections
import contextlib
import datetime
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
import cluster
import history
import nemesis

SKIPPED = 77


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", help="folder of eigencast-broker and eigencast-sender")
    parser.add_argument("--seconds", type=float, default=60, help="how long there are faults")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--only", default="", help=f"kinds of faults: {', '.join(nemesis.KINDS)}")
    parser.add_argument("--every", type=float, default=1.5, help="seconds from one fault to the next, on average")
    parser.add_argument("--clock", default="-", help="tests/support/stepped_clock.cpp's library; without it (-) clocks are not stepped")
    parser.add_argument("--broker", default="", help="a broker other than FOLDER-OF-PROGRAMS/eigencast-broker")
    parser.add_argument("--recovery", type=float, default=180, help="seconds until all must move: no promise, a bound that ends the test")
    parser.add_argument("--history", default="", help="gets every event, a line of JSON each")
    parser.add_argument("--keep", default="", help="where logs and recordings of a failure go")
    return parser.parse_args()


async def run(system, plan, recovery_s):
    """Returns how long after the last fault all viewers moved, and the files of recordings."""
    await system.start()
    await system.wait_for(lambda: not system.checker.stalled(), "all viewers move before the first fault")
    print(f"all {len(system.viewers)} viewers move after {system.now():.1f} s", flush=True)
    loop, began, breaker = asyncio.get_running_loop(), time.monotonic(), nemesis.Nemesis(system)
    restarts, faults = loop.create_task(system.restart_the_dead()), []
    restarts.add_done_callback(system.on_task_ended)
    for fault in plan:
        await asyncio.sleep(max(0, began + fault.at - time.monotonic()))
        print(fault, flush=True)
        faults.append(loop.create_task(breaker.inject(fault)))
    await asyncio.gather(*faults)
    system.record("healed")
    healed = system.now()
    with contextlib.suppress(TimeoutError):  # finish() says which does not.
        await system.wait_for(lambda: not system.checker.stalled(), "all viewers move again", recovery_s)
    again_s = system.now() - healed
    system.checker.finish(system.now())
    restarts.cancel()
    await system.end_clients()
    await system.start_and_stop_brokers()
    return again_s, system.read_recordings()


def why_not_played(system, files, dice):
    """A recording of real coefficients goes through eigencast-sender replay."""
    real = [file for file in files if file.name.startswith("r.") and file.stat().st_size > 20_000]
    if not real:
        return ""
    file = dice.choice(real)
    broker = system.brokers["b1"]
    broker.start()
    try:
        until = time.monotonic() + 60
        while not broker.asks("/livez") and time.monotonic() < until:
            time.sleep(0.1)
        to = f"ws://{broker.host.address}:{cluster.clients.PORT}/again"
        replay = system.away.run(system.programs / "eigencast-sender", "--no-progress", "replay", file, "--duration", "1", "--to", to,
                                 stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        output = replay.communicate(timeout=60)[0]
        return "" if replay.returncode == 0 else f"{file.name}: replay ends with {replay.returncode}: {output[-500:]}"
    finally:
        broker.kill()


def summary(checker, plan, again_s):
    recovery = lambda outages: history.distribution([outage.recovery_s for outage in outages])
    kinds = sorted({outage.kind for outage in checker.outages})
    return {"faults_survived": len(plan), "faults": dict(collections.Counter(fault.kind for fault in plan).most_common()),
            "violations": len(checker.violations), "codes": dict(collections.Counter(violation.code for violation in checker.violations)),
            "frames": checker.counts["frame"], "connections": checker.counts["connected"], "announcements": checker.counts["announced"],
            "changes": checker.counts["change-over"], "recalled": checker.counts["recalled"], "heard_in_rooms": checker.counts["heard"],
            "recordings": checker.counts["recording"], "last_viewer_moves_after_s": round(again_s, 2), "recovery": recovery(checker.outages),
            "recovery_by_last_fault": {kind: recovery(outage for outage in checker.outages if outage.kind == kind) for kind in kinds}}


def print_failure(checker, folder):
    for viewer, why in checker.stalled().items():
        print(f"stalled: {viewer}, {why}")
    code = lambda violation: violation.code
    for _, same in itertools.groupby(sorted(checker.violations, key=code), code):
        print("\n".join(map(str, itertools.islice(same, 10))))
    for log in sorted(folder.glob("*.log")):
        print(f"--- {log.name}\n{log.read_text(errors='replace')[-1500:]}")


def main():
    options = arguments()
    if why := cluster.unavailable():
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
    checker = history.Checker()
    file = open(options.history, "w") if options.history else None
    system = cluster.Cluster(programs, folder, options.clock.strip("-"), checker, file)
    only = set(options.only.split(",")) - {""}
    assert only <= set(nemesis.KINDS), f"--only: {sorted(only - set(nemesis.KINDS))} are no kinds of faults"
    kinds = [kind for kind in system.kinds() if not only or kind in only]
    plan = nemesis.schedule(seed, options.seconds, system.targets(), kinds, options.every)
    print(f"seed {seed}, {len(plan)} faults in {options.seconds:.0f} s; time 0 is {datetime.datetime.now():%T.%f}", flush=True)
    for kind, why in system.left_out.items():
        print(f"left out: {kind} ({why})")
    failed = True
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # Ends what runs on the hosts.
    try:
        again_s, files = asyncio.run(run(system, plan, options.recovery))
        if why := why_not_played(system, files, random.Random(seed)):
            system.record("recording", file="", stream="r", number=0, whole=True, tags=[], why=why)
        failed = bool(checker.violations)
        print(json.dumps({"seed": seed, "seconds": options.seconds, **summary(checker, plan, again_s)}), flush=True)
    finally:
        if failed:
            print(f"FAILED: {len(checker.violations)} violations; again with --seed {seed} --seconds {options.seconds:g} --every {options.every:g}"
                  + (f" --only {options.only}" if only else ""))
            print_failure(checker, folder)
            if options.keep:
                shutil.copytree(folder, options.keep, dirs_exist_ok=True)
        system.close()
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
