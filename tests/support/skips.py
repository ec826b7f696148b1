#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Lists by reason the tests that ctest skipped, then counts all.

    skips.py JUNIT.xml...        what ctest --output-junit wrote
"""
import collections
import re
import sys
import xml.etree.ElementTree

REASON = re.compile(r"^SKIPPED: (.*)|: Skipped\n(.*)", re.M)


def reasons_of(case):
    output = case.findtext("system-out") or ""
    return {(a or b).strip() for a, b in REASON.findall(output)} or {"no reason given"}


def main():
    counts, skipped = collections.Counter(), collections.defaultdict(list)
    for path in sys.argv[1:]:
        for case in xml.etree.ElementTree.parse(path).iter("testcase"):
            skip = case.find("skipped")
            if skip is not None and skip.get("message", "").startswith("SKIP_"):
                outcome = "skipped"  # Others that did not run could not.
            else:
                outcome = "passed" if case.get("status") == "run" else "failed"
            counts[outcome] += 1
            if outcome == "skipped":
                for reason in reasons_of(case):
                    skipped[reason].append(case.get("name"))
    if skipped:
        print("Skipped:")
    for reason, names in sorted(skipped.items(), key=lambda item: (-len(item[1]), item[0])):
        shown = sorted(set(names))
        print(f"  {reason}: {', '.join(shown[:3])}{f' and {len(shown) - 3} more' if len(shown) > 3 else ''}")
    print(f"{counts['passed']} passed, {counts['failed']} failed, {counts['skipped']} skipped")


if __name__ == "__main__":
    main()
