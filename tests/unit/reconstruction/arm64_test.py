#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The kernels' unit tests for 64-bit ARM, cross-compiled and run by qemu: arm64_test.py ROOT WORK_FOLDER

Needs g++-aarch64-linux-gnu, qemu-user, the sources that libgtest-dev leaves in /usr/src, and libeigen3-dev (headers only).
Ends with status 77, and words, where one of them is absent.
"""
import pathlib
import shutil
import subprocess
import sys

GTEST = pathlib.Path("/usr/src/googletest/googletest")
EIGEN = pathlib.Path("/usr/include/eigen3")
# Kernels as eigencast_kernel_variants of cmake/EigencastTargets.cmake has them compiled.
KERNELS = ["common/reconstruction/kernel_baseline.cpp", "common/spectral/panel_kernel_baseline.cpp"]
REST = ["common/core/machine.cpp", "common/core/worker_team.cpp", "common/reconstruction/basis_tiles.cpp",
        "common/reconstruction/kernel.cpp", "common/reconstruction/reconstruct.cpp", "common/spectral/panels.cpp",
        "tests/unit/reconstruction/product_test.cpp", "tests/unit/spectral/panels_test.cpp"]


def skip(why):
    print(f"SKIPPED: {why}", file=sys.stderr)
    sys.exit(77)


def tool(package, *names):
    for name in names:
        found = shutil.which(name)
        if found:
            return found
    skip(f"{names[0]} is not there: apt-get install {package}")


def main():
    root, work = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    compiler = tool("g++-aarch64-linux-gnu", "aarch64-linux-gnu-g++")
    emulator = tool("qemu-user", "qemu-aarch64", "qemu-aarch64-static")
    for folder, package in ((GTEST, "libgtest-dev"), (EIGEN, "libeigen3-dev")):
        if not folder.exists():
            skip(f"{folder} is not there: apt-get install {package}")
    work.mkdir(parents=True, exist_ok=True)
    launcher = [shutil.which("ccache")] if shutil.which("ccache") else []
    flags = ["-std=c++20", "-O2", "-I", root, "-I", GTEST, "-I", GTEST / "include", "-isystem", EIGEN]
    sources = {root / source: ["-O3", "-ffp-contract=fast", "-Wall", "-Wextra", "-Werror"] for source in KERNELS}
    sources |= {root / source: ["-Wall", "-Wextra", "-Werror"] for source in REST}
    sources |= {GTEST / "src/gtest-all.cc": [], GTEST / "src/gtest_main.cc": []}
    objects = []
    for source, more in sources.items():
        objects.append(work / (source.stem + ".o"))
        subprocess.run([*launcher, compiler, *flags, *more, "-c", source, "-o", objects[-1]], check=True)
    program = work / "kernels_arm64"
    subprocess.run([compiler, "-static", *objects, "-pthread", "-o", program], check=True)
    symbols = subprocess.run([compiler.replace("g++", "objdump"), "-d", work / "kernel_baseline.o"], capture_output=True,
                             text=True).stdout
    if "smlal" not in symbols or "fmla" not in symbols:
        sys.exit("the kernels were compiled without NEON's multiply-add of floats or of 16-bit integers")
    sys.exit(subprocess.run([emulator, program]).returncode)


if __name__ == "__main__":
    main()
