#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Lists by reason the tests that ctest skipped, says what failed tests said, then counts all.

    summary.py JUNIT.xml...        what ctest --output-junit wrote
"""
import collections
import re
import sys
import xml.etree.ElementTree

REASON = re.compile(r"^SKIPPED: (.*)|: Skipped\n(.*)", re.M)
# Of node's tests, GoogleTest, Python, sanitizers and shells.
TELLS = re.compile(r"not ok \d|^\s*error: |Error\b|: Failure$|Which is|FAILED|Expected|Actual|ERROR:|\bfailed\b")
TOLD_LINES, TOLD_CHARACTERS = 6, 200


def reasons_of(case):
    output = case.findtext("system-out") or ""
    return {(a or b).strip() for a, b in REASON.findall(output)} or {"no reason given"}


def told_by(case):
    lines = [line.strip()[:TOLD_CHARACTERS] for line in (case.findtext("system-out") or "").splitlines() if line.strip()]
    found = [line for line in lines if TELLS.search(line)] or lines[-TOLD_LINES:]
    return found[:TOLD_LINES]


def main():
    counts, skipped, failed = collections.Counter(), collections.defaultdict(list), []
    for path in sys.argv[1:]:
        for case in xml.etree.ElementTree.parse(path).iter("testcase"):
            skip = case.find("skipped")
            if skip is not None and skip.get("message", "").startswith("SKIP_"):
                outcome = "skipped"  # Others that did not run could not.
            else:
                outcome = "passed" if case.get("status") == "run" else "failed"
            counts[outcome] += 1
            if outcome == "failed":
                failed.append(case)
            if outcome == "skipped":
                for reason in reasons_of(case):
                    skipped[reason].append(case.get("name"))
    if skipped:
        print("Skipped:")
    for reason, names in sorted(skipped.items(), key=lambda item: (-len(item[1]), item[0])):
        shown = sorted(set(names))
        print(f"  {reason}: {', '.join(shown[:3])}{f' and {len(shown) - 3} more' if len(shown) > 3 else ''}")
    for case in failed:
        print(f"Failed: {case.get('name')}")
        for line in told_by(case):
            print(f"  {line}")
    print(f"{counts['passed']} passed, {counts['failed']} failed, {counts['skipped']} skipped")


if __name__ == "__main__":
    main()
