"""Put single faults into the program and see which of them no test notices.

``python -m tests.mutants --count 200 --seed 14`` measures once which test runs which line, then takes seeded places in
the rooms named by ``--rooms``, changes one operator or number at a time in a copy of the checkout, and runs the tests
that reach its line. It prints every survivor and the share that was killed. Compiled loops are left out: their twins
hold them bit for bit.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("classifiers", "formats", "streams", "matching", "jobs")
TIMEOUT_S = 300.0
"""A mutant that runs so long hangs, which is noticed."""
MAX_TESTS = 400
"""Tests of a line that many share are taken from the files nearest to it."""

COMPARED = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
CALCULATED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Mod: "//"}
SWAPPED = {"max": "min", "min": "max", "any": "all", "all": "any"}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One fault: the text between two places of a file, and what stands there instead."""

    file: str
    line: int
    start: int
    stop: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.before!r} -> {self.after!r}"


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield every fault of a module that is an operator or a number changed."""
    text = path.read_text(encoding="utf-8")
    begins = [0]
    for line in text.split("\n"):
        begins.append(begins[-1] + len(line.encode()) + 1)
    raw = text.encode()
    for node in ast.walk(ast.parse(text)):
        changed = _changed(node)
        if changed is None:
            continue
        start = begins[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        stop = begins[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        before = raw[start:stop].decode()
        yield Mutant(str(path.relative_to(ROOT)), node.lineno, start, stop, before, changed)  # type: ignore[attr-defined]


def _changed(node: ast.AST) -> str | None:
    """Return the source of a node with one fault, None where it can have none."""
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in COMPARED:
            return f"({ast.unparse(node.left)} {COMPARED[type(operator)]} {ast.unparse(node.comparators[0])})"
        case ast.BinOp(op=operator) if type(operator) in CALCULATED and not _is_text(node):
            return f"({ast.unparse(node.left)} {CALCULATED[type(operator)]} {ast.unparse(node.right)})"
        case ast.BoolOp(op=ast.And()):
            return "(" + " or ".join(f"({ast.unparse(value)})" for value in node.values) + ")"
        case ast.BoolOp(op=ast.Or()):
            return "(" + " and ".join(f"({ast.unparse(value)})" for value in node.values) + ")"
        case ast.UnaryOp(op=ast.Not()):
            return f"({ast.unparse(node.operand)})"
        case ast.Constant(value=value) if type(value) in (int, float):
            return repr(value + 1) if isinstance(value, int) else repr(float(str(value)) * 1.5 + 1e-3)
        case ast.Call(func=ast.Name(id=name)) if name in SWAPPED:
            return SWAPPED[name] + ast.unparse(node)[len(name) :]
    return None


def _is_text(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    return any(isinstance(side, ast.JoinedStr | ast.Constant) and not _is_number(side) for side in sides) or (
        isinstance(node.op, ast.BitOr)
    )


def _is_number(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def measure(data: Path) -> None:
    """Run the suite once and keep which test runs which line."""
    setup = data.with_suffix(".ini")
    setup.write_text("[run]\nsource = prc_cli\ndynamic_context = test_function\ncore = ctrace\n", encoding="utf-8")
    command = [
        sys.executable, "-m", "coverage", "run", f"--rcfile={setup}", f"--data-file={data}",
        "-m", "pytest", "-q", "-x", "tests", "-p", "no:cacheprovider", "--ignore", "tests/golden",
    ]  # fmt: skip
    subprocess.run(command, cwd=ROOT, check=True, stdin=subprocess.DEVNULL)


class Reached:
    """Which tests run a line."""

    def __init__(self, data: Path) -> None:
        self._base = sqlite3.connect(data)
        rows = self._base.execute("select id, context from context")
        self._tests = {number: name for number, name in rows if name}

    def tests(self, file: str, line: int) -> list[str]:
        """Return the tests (files and functions) that run a line, those of the nearest files first."""
        rows = self._base.execute(
            "select context_id, numbits from line_bits join file on file.id = file_id where path = ?",
            (str(ROOT / file),),
        )
        names = {self._tests[number] for number, bits in rows if number in self._tests and _has(bits, line)}
        folder = Path(file).parent.name
        found = sorted({place for name in names if (place := _node(name)) is not None})
        return sorted(found, key=lambda name: (folder not in name, name))[:MAX_TESTS]


def _has(bits: bytes, line: int) -> bool:
    return line // 8 < len(bits) and bool(bits[line // 8] >> line % 8 & 1)


def _node(context: str) -> str | None:
    """Turn ``tests.streams.test_lines.test_wrap`` into pytest's name of it."""
    module, _, function = context.rpartition(".")
    while module and not (path := Path(*module.split("."))).with_suffix(".py").exists():
        module, _, outer = module.rpartition(".")
        function = f"{outer}::{function}"
    return f"{path.with_suffix('.py')}::{function}" if module.startswith("tests") and "test_" in function else None


def is_killed(mutant: Mutant, tests: list[str], copy: Path) -> bool:
    """Run tests on a copy of the checkout with one fault in it; leave the copy as it was."""
    path = copy / mutant.file
    sound = path.read_bytes()
    path.write_bytes(sound[: mutant.start] + mutant.after.encode() + sound[mutant.stop :])
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "no:randomly", *tests]
    try:
        return subprocess.run(
            command, cwd=copy, env={**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"},
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=TIMEOUT_S,
            check=False,
        ).returncode != 0  # fmt: skip
    except subprocess.TimeoutExpired:
        return True
    finally:
        path.write_bytes(sound)


def main() -> None:
    """Measure, mutate, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=14)
    parser.add_argument("--rooms", nargs="*", default=ROOMS)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--coverage", type=Path, help="kept from an earlier run")
    chosen = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="prc-mutants-"))
    data = chosen.coverage or work / "coverage.sqlite"
    if not data.exists():
        measure(data)
    reached = Reached(data)
    files = [path for room in chosen.rooms for path in sorted((ROOT / "prc_cli" / room).rglob("*.py"))]
    places = [mutant for path in files for mutant in mutants_of(path)]
    random.Random(chosen.seed).shuffle(places)
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(chosen.jobs):
        copy = work / f"copy{number}"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache", "site"))
        copies.put(copy)

    def judge(mutant: Mutant) -> tuple[Mutant, str]:
        tests = reached.tests(mutant.file, mutant.line)
        if not tests:
            return mutant, "reached by no test"
        copy, begun = copies.get(), time.monotonic()
        try:
            verdict = "killed" if is_killed(mutant, tests, copy) else "survived"
        finally:
            copies.put(copy)
        return mutant, f"{verdict} ({len(tests)} tests, {time.monotonic() - begun:.0f} s)"

    survivors = 0
    with ThreadPoolExecutor(chosen.jobs) as pool:
        for number, (mutant, verdict) in enumerate(pool.map(judge, places[: chosen.count]), 1):
            survivors += not verdict.startswith("killed")
            print(f"{number:4} {verdict:28} {mutant}", flush=True)
    n = min(chosen.count, len(places))
    print(f"{n} mutants of {len(places)}, {n - survivors} killed: {100 * (n - survivors) / max(n, 1):.1f} %")
    shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    main()
