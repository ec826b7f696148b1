#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Checks every Markdown page of the tree, and that C and C++ sources fit in 120 columns. Usage: check_documents.py ROOT

Relative links and their #anchors resolve, lines fit in 120 columns outside code and tables, paths of the tree, headers and files of a
room that a page names exist, docs/architecture.md names every folder, pages that sources refer to exist, and each promise of
docs/guarantees.md names tests of the tree.
"""
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(sys.argv[1]).resolve()
WIDTH = 120
# Folders whose own folders architecture.md need not name.
WHOLE = ("web/src", "web/test", "tests/unit", "tests/cluster", "tests/fuzz", "tests/golden", "tests/install", "deploy/debian", "sdk/include", "sdk/python", ".ci", ".github")


def tracked():
    """Files of the tree; where it is not a git checkout, all that lie there but builds."""
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "-z"], capture_output=True, text=True, check=False)
    if listed.returncode == 0:
        return [pathlib.PurePath(name) for name in listed.stdout.split("\0") if name]
    return [path.relative_to(ROOT) for path in ROOT.rglob("*") if path.is_file() and path.relative_to(ROOT).parts[0] not in ("build", ".git")]


def prose_of(text):
    """A page without its code."""
    return re.sub(r"^```.*?^```$|^ {4}[^\n]*$|`[^`\n]*`", "", text, flags=re.M | re.S)


def anchors_of(text):
    """The anchors that a page's headings get."""
    found = set()
    for title in re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S), re.M):
        slug = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()).replace(" ", "-")
        found.add(next(name for name in [slug] + [f"{slug}-{i}" for i in range(1, 99)] if name not in found))
    return found


def link_faults(page, text):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose_of(text)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (ROOT / page).parent / path if path else ROOT / page
        if not file.exists():
            yield f"{target}: there is no such file"
        elif anchor and anchor not in anchors_of(file.read_text(encoding="utf-8")):
            yield f"{target}: there is no such heading"


def width_faults(text):
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        fenced ^= line.lstrip().startswith("```")
        if len(line) > WIDTH and not fenced and not line.startswith(("|", "    ", "```", "![", "#")):
            yield f"line {number}: {len(line)} columns"


def source_width_faults(files):
    for file in files:
        if file.suffix in (".c", ".cpp", ".h", ".hpp") and (ROOT / file).is_file():
            for number, line in enumerate((ROOT / file).read_text(encoding="utf-8").splitlines(), 1):
                if len(line) > WIDTH:
                    yield f"{file}:{number}: {len(line)} columns"


def path_faults(text, top):
    """Paths below a folder of the tree's root; an extension may be left out."""
    for name in sorted(set(re.findall(rf"(?<![\w./~-])(?:{'|'.join(map(re.escape, top))})/[\w./*-]*[\w*]", text))):
        if not (ROOT / name).exists() and not list(ROOT.glob(name)) and not list(ROOT.glob(name + ".*")):
            yield f"{name}: there is no such file or folder"


def header_faults(text, headers):
    """Headers that a page names without their folder."""
    for name in sorted(set(re.findall(r"`(\w+\.h)`", text)) - headers):
        yield f"{name}: there is no such header"


def file_faults(page, text):
    """The table of a folder's README, `file` or `room` first, names files of that folder; of a room its files, too."""
    rows = re.search(r"^\| (?:file|room) \|.*\n\|[-|]+\n((?:\|.*\n)*)", text, re.M)
    for row in rows[1].splitlines() if rows else ():
        first, second = row.strip("|").split("|")[:2]
        for name in re.findall(r"`([\w./*-]+)`", first):
            if not list((ROOT / page).parent.glob(name.rstrip("/") + ("" if "." in name or name.endswith("/") else ".*"))):
                yield f"{name}: there is no such file or folder"
        for name in re.findall(r"`([a-z_]+)`", second) if first.strip().endswith("/`") else ():
            if not list((ROOT / page).parent.glob(f"{first.strip().strip('`')}{name}.*")):
                yield f"{name}: there is no such file in {first.strip()}"


def reference_faults(files):
    """Pages and, in quotes after a comma, headings that sources refer to."""
    for file in files:
        if file.suffix in (".md", ".png", ".json") or file.parts[:2] == ("tests", "fuzz") or not (ROOT / file).is_file():
            continue
        text = re.sub(r"\n *(?:#|//+|\*) *", " ", (ROOT / file).read_bytes().decode("utf-8", "ignore"))
        for page, title in re.findall(r'\b(docs/[\w/-]+\.md)(?:, "([^"\\]+)")?', text):
            if not (ROOT / page).exists():
                yield f"{file}: {page}: there is no such page"
            elif title and not re.search(rf"^(?:#.*|.*\*\*){re.escape(title)}", (ROOT / page).read_text(encoding="utf-8"), re.M):
                yield f"{file}: {page} has no \"{title}\""


def promise_faults(files):
    """Each item and row of docs/guarantees.md names a test: `Suite.Name`, or `test_name` of a script; and there is such a test."""
    known = set()
    for file in files:
        if file.parts[0] == "tests" and file.suffix in (".cpp", ".h", ".py") and (ROOT / file).is_file():
            text = (ROOT / file).read_text(encoding="utf-8")
            known.update(f"{suite}.{name}" for suite, name in re.findall(r"^TEST(?:_[FP])?\(\s*(\w+),\s*(\w+)\)", text, re.M))
            known.update(re.findall(r"^ +def (test_\w+)\(", text, re.M))
    text = (ROOT / "docs/guarantees.md").read_text(encoding="utf-8")
    promises = re.findall(r"^- .*(?:\n  .*)*|(?<=\|\n)\| .*", text, re.M)
    if not promises:
        yield "docs/guarantees.md: makes no promise that can be checked"
    for promise in promises:
        named = re.findall(r"`([A-Z]\w+\.[A-Z]\w+|test_\w+)`", promise)
        if not named:
            yield f"docs/guarantees.md: names no test: {promise}"
        yield from (f"docs/guarantees.md: {name}: there is no such test" for name in named if name not in known)


def unnamed_folders(files):
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    folders = {str(parent) for file in files for parent in file.parents if str(parent) != "."}
    for folder in sorted(folders):
        if not folder.startswith(tuple(whole + "/" for whole in WHOLE)) and folder not in (".ci", ".github") and f"`{folder}`" not in text:
            yield f"docs/architecture.md: does not name `{folder}`"


def main():
    files = tracked()
    top = sorted({file.parts[0] for file in files if len(file.parts) > 1})
    headers = {file.name for file in files if file.suffix == ".h"}
    faults = [*unnamed_folders(files), *reference_faults(files), *source_width_faults(files), *promise_faults(files)]
    pages = [file for file in files if file.suffix == ".md"]
    for page in pages:
        text = (ROOT / page).read_text(encoding="utf-8")
        faults += [f"{page}: {fault}" for fault in [*link_faults(page, text), *width_faults(text), *path_faults(text, top),
                                             *header_faults(text, headers), *file_faults(page, text)]]
    print("\n".join(faults) or f"{len(pages)} pages are sound")
    return 1 if faults else 0


sys.exit(main())
