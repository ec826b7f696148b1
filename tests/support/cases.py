# SPDX-License-Identifier: MIT
"""unittest.main for tests that ctest runs: a skipped case is a skip of the whole test, with its reason."""
import sys
import unittest

SKIPPED = 77  # ctest's SKIP_RETURN_CODE of every test here.


def main(**options):
    result = unittest.main(verbosity=2, warnings="ignore", exit=False, **options).result
    for _, reason in result.skipped:
        print(f"SKIPPED: {reason}")
    sys.exit(1 if not result.wasSuccessful() or not result.testsRun else SKIPPED if result.skipped else 0)
