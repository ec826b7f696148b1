#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""eigencast-latency against delays that are known: a relay between broker and viewer holds everything that the viewer gets for so
many milliseconds, and the tool must read them, within the error that it states.

With one clock (loop) the error is 0, and what the relay itself costs is taken off by a run through it without delay. With two
(pair: sender and viewer know each other's clock through the broker's alone) the asymmetry of the link cannot be seen: what is read
may be off by the error stated, half the least round trip. Ends with status 1 if a reading is further off than that and
--tolerance-ms.
"""
import json
import subprocess
import sys

from common import Stage, parser, write_table

DELAYS_MS = (0, 5, 25, 100)
HEADER = ["mode", "added_ms", "keys", "read_ms", "stated_error_ms", "clock_offset_ms", "pose_to_surface_p50_ms"]


def relay(stage, delay_ms):
    port_file = stage.folder / f"relay-{len(stage.running)}"
    stage.start("eigencast-impaired-relay", "--to", stage.port, "--delay-ms", delay_ms, "--direction", "down", "--port-file", port_file)
    return stage.port_from(port_file)


def run(stage, *arguments):
    report = stage.folder / "latency.json"
    done = subprocess.run([str(a) for a in (stage.program("eigencast-latency"), *arguments, "--no-progress", "--json", report)],
                          capture_output=True, text=True, timeout=90)
    if done.returncode != 0:
        sys.exit(f"eigencast-latency ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return json.loads(report.read_text())


def one_clock(options, stage, delay_ms):
    name = f"loop-{delay_ms}"
    return run(stage, "loop", stage.url(name), "--viewer-url", stage.url(name, relay(stage, delay_ms)), "--duration",
               options.seconds, "--warmup", 1)


def two_clocks(options, stage, delay_ms):
    name = f"pair-{delay_ms}"
    sender = stage.start("eigencast-latency", "pair", "--publish", stage.url(name), "--duration", options.seconds + 6, "--warmup", 0,
                         "--no-progress")
    report = run(stage, "pair", "--subscribe", stage.url(name, relay(stage, delay_ms)), "--duration", options.seconds, "--warmup", 2)
    sender.terminate()
    sender.wait(20)
    return report


def main():
    p = parser(__doc__)
    p.add_argument("--seconds", type=float, default=4, help="of each run")
    p.add_argument("--tolerance-ms", type=float, default=1, help="of what the machine itself varies by")
    options = p.parse_args()
    rows, worst = [], 0
    with Stage(options) as stage:
        for mode, measure in (("one clock", one_clock), ("two clocks", two_clocks)):
            without_ms = None
            for delay_ms in DELAYS_MS:
                report = measure(options, stage, delay_ms)
                to_client, clock = report["traced"]["keys"]["stages"]["to_client"], report["clocks"]["viewer_to_broker"]
                error_ms = to_client["error_us"] / 1000
                # Below its error a reading is unknown, which is right, and nothing to compare.
                read_ms = None if to_client["p50_us"] is None else to_client["p50_us"] / 1000
                if delay_ms == 0:
                    without_ms = read_ms or 0.0
                off_ms = None if read_ms is None else read_ms - without_ms - delay_ms
                worst = max(worst, 0 if off_ms is None else abs(off_ms) - error_ms)
                rows.append([mode, delay_ms, report["keys"]["count"],
                             "unknown" if read_ms is None else f"{read_ms - without_ms:.3f}", f"{error_ms:.3f}",
                             f"{clock['offset_us'] / 1000:+.3f}", report["keys"]["p50_us"] and report["keys"]["p50_us"] / 1000])
    write_table(options, "known_delay", HEADER, rows)
    print(f"worst: {worst:.3f} ms beyond the error stated")
    return 0 if worst <= options.tolerance_ms else 1


if __name__ == "__main__":
    sys.exit(main())
