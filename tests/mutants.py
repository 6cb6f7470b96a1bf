"""Put single faults into the program and see which of them no test notices.

``python -m tests.mutants --count 200 --seed 14 --coverage /tmp/mutants.sqlite`` measures once which
test and which golden case runs which line (files kept from an earlier run are taken as they are),
then takes seeded places in the rooms named by ``--rooms``, changes one operator or number at a
time, and runs the tests, then the golden cases, that reach its statement. It prints what became of
each and the share that was killed, by room; what failed is run once more without a fault, and does
not count if it fails again. ``--list`` shows the places alone, ``--skip`` and ``--only`` run a part
of them. A change elsewhere leaves the draw as it is. No file is changed: the fault is in the code
of a forked process. Compiled loops are left out, as their twins hold them bit for bit; so are the
constants named by ``SIZES``."""

from __future__ import annotations

import argparse
import ast
import gc
import hashlib
import importlib
import itertools
import json
import os
import re
import runpy
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

from tests.golden.run import TOLD

ROOT = Path(__file__).resolve().parent.parent
ROOMS = (
    "methods",
    "formats",
    "streams",
    "matching",
    "jobs",
    "cli",
    "evaluation",
    "imaging",
    "simulation",
    "core",
    "reference",
)
LEFT_OUT = ("tests/golden", "tests/faults", "tests/fuzz")
"""Tests that take long, or that run no line of the rooms in their own process, as most that are
``slow``."""
SIZES = re.compile(
    r"_?(MAX|CHUNK|BLOCK|BUFFER|BATCH|COPY|READ|WRITE|PAGE|KEPT|HEAD|LOOK|FLUSH|RUN|CHECK|PROBE|SORT|MERGE|STEP|LARGE"
    r"|SHARED|SERIAL|PLAIN|TOGETHER|TEXT)(_[A-Z]+)*_(BYTES|RECORDS|SHOTS|POINTS|ITEMS|ROWS|CELLS)(_EACH)?|_?BATCH"
    r"|[A-Z]+_AT_ONCE"
    r"|_?(GATE|LOOK|STATUS|POLL|BEAT|SILENT|PATIENCE|PROGRESS|STOP|AGAIN|CONNECT|WORKERS|CHECK|SHARE|START|KILL|ABANDON"
    r"|WAIT|LONGEST_CHECK|COPY_PAUSE)_S"
)
"""Names of constants that only say how much is read, kept or worked on at a time, or how long is
waited."""
TIMEOUT_S = 300.0
"""A mutant that runs so long hangs, which is noticed."""
GOLDEN = "golden::"
"""Begins the names of golden cases among those of tests."""
FIRST = 60
"""So many tests, the nearest ones, are run before the others are looked at."""
BUDGET_S = 15.0
"""Tests of a statement that many share are taken, the nearest and then the quickest first, until
they take so long."""

_AT_START = {name: value for name, value in TOLD.items() if name[:4] in ("NPY_", "OPEN")}
"""What NumPy reads when it is imported."""

COMPARED = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
CALCULATED = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
}
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
    reach: tuple[int, int]
    """First and last line of what runs when the fault does."""
    in_body: bool
    """Whether that is in the body of a function, not on import."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.before!r} -> {self.after!r}"


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield every fault of a module that is an operator or a number changed."""
    raw = path.read_bytes()
    begins = [0]
    for line in raw.split(b"\n"):
        begins.append(begins[-1] + len(line) + 1)
    for node, reach, in_body in _code(ast.parse(raw), (1, len(begins))):
        changed = _changed(node)
        if changed is None:
            continue
        start = begins[node.lineno - 1] + node.col_offset
        stop = begins[node.end_lineno - 1] + node.end_col_offset
        file = str(path.relative_to(ROOT))
        before = raw[start:stop].decode()
        yield Mutant(file, node.lineno, start, stop, before, changed, reach, in_body)


def _code(
    node: ast.AST, reach: tuple[int, int], in_body: bool = False
) -> Iterator[tuple[Any, tuple[int, int], bool]]:
    """Yield what is calculated, and the lines of the statement; not types, texts and sizes.

    What is calculated on import counts as run by whatever runs the function or module that it
    belongs to."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if (
                not isinstance(child, ast.AST)
                or isinstance(child, ast.JoinedStr)
                or _is_size(child)
            ):
                continue
            if (
                field == "slice"
                and isinstance(node, ast.Subscript)
                and ast.unparse(node.value) == "Literal"
            ):
                continue
            inner = reach
            is_statement = isinstance(child, ast.stmt) and not isinstance(
                node, ast.ClassDef | ast.Module
            )
            inside = in_body or (is_statement and reach[0] != 1)
            if isinstance(child, ast.FunctionDef):
                inner = (child.lineno, child.end_lineno or child.lineno)
            elif isinstance(child, ast.stmt) and inside:
                body = getattr(child, "body", None)
                inner = (
                    child.lineno,
                    body[0].lineno - 1 if body else child.end_lineno or child.lineno,
                )
                inner = (inner[0], max(inner))
            yield child, inner, inside
            yield from _code(child, inner, inside)


def _is_size(node: ast.AST) -> bool:
    """Tell whether a statement is ``KEPT_BYTES = 32 << 20`` or the like."""
    if isinstance(node, ast.Assign | ast.AnnAssign):
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        return isinstance(target, ast.Name) and SIZES.fullmatch(target.id) is not None
    return False


def _changed(node: ast.AST) -> str | None:
    """Return the source of a node with one fault, None where it can have none."""
    replacement: ast.expr
    match node:
        case ast.Compare(left=left, ops=[operator], comparators=right) if (
            type(operator) in COMPARED
        ):
            replacement = ast.Compare(left, [COMPARED[type(operator)]()], right)
        case ast.BinOp(left=left, op=operator, right=right) if type(
            operator
        ) in CALCULATED and not _is_text(node):
            replacement = ast.BinOp(left, CALCULATED[type(operator)](), right)
        case ast.BoolOp(op=operator, values=values):
            replacement = ast.BoolOp(
                ast.Or() if isinstance(operator, ast.And) else ast.And(), values
            )
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            replacement = operand
        case ast.Constant(value=value) if type(value) in (int, float):
            return (
                repr(value + 1) if isinstance(value, int) else repr(float(str(value)) * 1.5 + 1e-3)
            )
        case ast.Call(func=ast.Name(id=name)) if name in SWAPPED:
            replacement = ast.Call(ast.Name(SWAPPED[name]), node.args, node.keywords)
        case _:
            return None
    return f"({ast.unparse(replacement)})"


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str | bytes))
        for side in (node.left, node.right)
    )


# -- which test runs which line: this module is a plug-in of the measured run

SECONDS: dict[str, float] = {}


def _context(name: str) -> None:
    from coverage import Coverage

    if (measuring := Coverage.current()) is not None:
        measuring.switch_context(name)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """What a test runs is counted for its function."""
    name = item.nodeid.partition("[")[0]
    begun = time.monotonic()
    _context(name)
    try:
        return (yield)
    finally:
        SECONDS[name] = SECONDS.get(name, 0.0) + time.monotonic() - begun
        _context("")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any, request: Any) -> Generator[None, object, object]:
    """What a fixture shared by several tests runs is counted for all tests of the file."""
    item = getattr(request, "_pyfuncitem", None)
    if fixturedef.scope == "function" or item is None:
        return (yield)
    _context(item.nodeid.partition("::")[0])
    try:
        return (yield)
    finally:
        _context(item.nodeid.partition("[")[0])


def pytest_sessionfinish() -> None:
    """Keep how long every test took."""
    if "PRC_MUTANTS_SECONDS" in os.environ:
        Path(os.environ["PRC_MUTANTS_SECONDS"]).write_text(json.dumps(SECONDS), encoding="utf-8")


def measure(data: Path) -> None:
    """Run the suite and the golden cases once.

    Keep which runs which line, and how long each takes.
    """
    setup = data.with_suffix(".ini")
    setup.write_text("[run]\nsource = prc_cli\nsigterm = true\n", encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "coverage",
        "run",
        f"--rcfile={setup}",
        f"--data-file={data}",
        "-m",
        "pytest",
        "-q",
        "-m",
        "not slow and not long",
        "-p",
        "tests.mutants",
        "-p",
        "no:cacheprovider",
        "tests",
        "prc_cli",
        *(f"--ignore={folder}" for folder in LEFT_OUT),
    ]
    environment = {**os.environ, "PRC_MUTANTS_SECONDS": str(data.with_suffix(".json"))}
    # a test that fails without a fault is told in the end
    subprocess.run(command, cwd=ROOT, check=False, stdin=subprocess.DEVNULL, env=environment)
    golden = [
        *command[: command.index("-m", 3)],
        "--append",
        "-m",
        "tests.mutants",
        "--golden",
        str(data),
    ]
    subprocess.run(golden, cwd=ROOT, check=True, stdin=subprocess.DEVNULL)


def measure_golden(data: Path) -> None:
    """Run the golden cases in this process and keep their folders, which cases read of each
    other."""
    from tests.golden import run as golden
    from tests.golden.cases import all_cases

    cases = all_cases()
    place = data.with_suffix(".golden")
    place.mkdir()
    _lay(place)
    depth = golden.needed(cases, list(cases))
    seconds = json.loads(data.with_suffix(".json").read_text("utf-8"))
    for name in sorted(depth, key=depth.__getitem__):
        _context(f"{GOLDEN}{name}")
        seconds[f"{GOLDEN}{name}"] = golden.run_case(name, cases[name], str(place))[2]
    _context("")
    data.with_suffix(".json").write_text(json.dumps(seconds), encoding="utf-8")


def _lay(place: Path) -> None:
    """Prepare a folder and this process as :mod:`tests.golden.run` does."""
    from tests.conftest import data_folder

    os.environ.update(TOLD)
    for name, target in (("data", data_folder()), ("repo", ROOT)):
        (place / name).symlink_to(target.resolve(), target_is_directory=True)


class Reached:
    """Which tests run a statement."""

    def __init__(self, data: Path) -> None:
        base = sqlite3.connect(data)
        names = dict(base.execute("select id, context from context"))
        paths = dict(base.execute("select id, path from file"))
        self._seconds: dict[str, float] = json.loads(
            data.with_suffix(".json").read_text(encoding="utf-8")
        )
        self._lines: dict[str, list[tuple[str, bytes]]] = {}
        for file, context, bits in base.execute(
            "select file_id, context_id, numbits from line_bits"
        ):
            if names[context]:
                self._lines.setdefault(paths[file], []).append((names[context], bits))

    def _found(self, mutant: Mutant) -> set[str]:
        first, last = mutant.reach
        return {
            name
            for name, bits in self._lines.get(str(ROOT / mutant.file), [])
            if any(
                line // 8 < len(bits) and bits[line // 8] >> line % 8 & 1
                for line in range(first, last + 1)
            )
        }

    def cases(self, mutant: Mutant) -> list[str]:
        """Return the golden cases that run a statement, the quickest first, as many as the budget
        allows."""
        names = sorted(
            (name for name in self._found(mutant) if name.startswith(GOLDEN)), key=self._took
        )
        total = itertools.accumulate(map(self._took, names))
        return [
            name.removeprefix(GOLDEN)
            for name, spent in zip(names, total, strict=True)
            if spent < BUDGET_S
        ]

    def tests(self, mutant: Mutant) -> list[str]:
        """Return the tests, or files of tests, that run a statement.

        The nearest first, of these the quickest first.
        """
        names = {name for name in self._found(mutant) if not name.startswith(GOLDEN)}
        names = {name for name in names if "::" not in name or name.partition("::")[0] not in names}
        ranked = sorted(
            names, key=lambda name: (_distance(mutant.file, name), self._took(name), name)
        )
        total = itertools.accumulate(map(self._took, ranked))
        return [
            name for name, spent in zip(ranked, total, strict=True) if spent < BUDGET_S
        ] or ranked[:1]

    def _took(self, name: str) -> float:
        if "::" in name:
            return self._seconds.get(name, 0.0)
        return sum(
            seconds for test, seconds in self._seconds.items() if test.startswith(f"{name}::")
        )


def _distance(file: str, test: str) -> int:
    """Return 0 for a module's doctests and the test file of its name, 1 for its folder, 2 for its
    room, 3 else."""
    source_path = Path(file)
    test_path = Path(test.partition("::")[0])
    stem = source_path.parent.name if source_path.stem == "__init__" else source_path.stem
    inside = source_path.parent.parts[1:]
    tested = test_path.parent.parts[1:]
    if source_path == test_path or (test_path.stem == f"test_{stem}" and tested[:1] == inside[:1]):
        return 0
    return 1 if tested == inside else 2 if tested[:1] == inside[:1] else 3


# -- one fault at a time


def judge(
    mutant: Mutant,
    tests: list[str],
    cases: list[str],
    golden: Path,
) -> tuple[bool, str]:
    """Return whether the check of the generated pages, the tests or the golden cases notice a
    fault, and which does."""
    if (ROOT / mutant.file).read_bytes()[mutant.start : mutant.stop].decode() != mutant.before:
        return False, "not run: the file was changed meanwhile"
    checks: list[Callable[[], int]] = [
        partial(_run_tests, chosen) for chosen in (tests[:FIRST], tests[FIRST:]) if chosen
    ]
    checks += [partial(_check_golden, cases, golden)] if cases else []
    # the number of a field or a default
    checks[:0] = [] if mutant.in_body else [_check_pages]
    for check in checks:
        code, failed = _fork(mutant, check)
        if code in (3, 4, 5):
            return False, f"not run: pytest ends with {code}"
        if code != 0:
            return True, "hangs" if code is None else failed[0] if failed else f"exit code {code}"
    return (
        False,
        f"survived {len(tests)} tests, {len(cases)} cases"
        if tests or cases
        else "reached by no test",
    )


def confirm(killers: list[str], golden: Path) -> set[str]:
    """Return which of the tests and golden cases that failed do so without a fault, too."""
    cases = [name.removeprefix(GOLDEN) for name in killers if name.startswith(GOLDEN)]
    tests = [name for name in killers if "::" in name and not name.startswith(GOLDEN)]
    checks = [partial(_check_golden, [name], golden) for name in cases]
    checks += [
        partial(_run_tests, tests[start : start + FIRST], "--maxfail=0")
        for start in range(0, len(tests), FIRST)
    ]
    return {name for check in checks for name in _fork(None, check)[1]}


def _run_tests(tests: list[str], *options: str) -> int:
    # pytest would import modules whose doctests are run by itself, without the fault, to rewrite
    # assertions
    return pytest.main(
        [
            "-q",
            "-x",
            "-rfE",
            "-m",
            "not long",
            "-p",
            "no:cacheprovider",
            "--randomly-dont-reorganize",
            "--tb=no",
            "--assert=plain",
            *options,
            *tests,
        ]
    )


def _check_golden(cases: list[str], kept: Path) -> int:
    """Run cases beside the kept folders of the others until one gives something else."""
    from tests.golden import run as golden
    from tests.golden.cases import all_cases

    expected = json.loads(golden.GOLDEN.read_text(encoding="utf-8"))
    printed = os.dup(1)
    for name in cases:
        with tempfile.TemporaryDirectory(prefix="prc-golden-") as folder:
            place = Path(folder)
            _lay(place)
            for case_folder in kept.iterdir():
                if (
                    case_folder.is_dir()
                    and not case_folder.is_symlink()
                    and case_folder.name != name
                ):
                    (place / case_folder.name).symlink_to(case_folder, target_is_directory=True)
            result = golden.run_case(name, all_cases()[name], folder)[1]
            os.chdir(ROOT)
        if golden.differences(expected, {name: result}):
            os.write(printed, f"FAILED {GOLDEN}{name}\n".encode())
            return 1
    return 0


def _check_pages() -> int:
    """Compare the reference pages, which list every default and bound of the configuration, as
    ``.ci/run`` does."""
    sys.argv = ["docs/generate.py", "--check"]
    return int(runpy.run_path("docs/generate.py")["main"]())


def _fork(mutant: Mutant | None, check: Callable[[], int]) -> tuple[int | None, list[str]]:
    """Return the exit code of a check with a fault in the program, None where it hangs, and what
    failed."""
    with tempfile.TemporaryFile() as printed:
        child = os.fork()
        if child == 0:
            os.setsid()
            silent = os.open(os.devnull, os.O_RDWR)
            for descriptor, target in enumerate((silent, printed.fileno(), silent)):
                os.dup2(target, descriptor)
            code = 1
            try:
                if mutant is not None:
                    _put_in(mutant)
                code = int(check())
            finally:
                sys.stdout.flush()
                os._exit(code)
        end = time.monotonic() + TIMEOUT_S
        done = 0
        status = 0
        while not done and time.monotonic() < end:
            done, status = os.waitpid(child, os.WNOHANG)
            time.sleep(0.05)
        if not done:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None, []
        printed.seek(0)
        failed = re.findall(
            r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", printed.read().decode(errors="replace"), re.M
        )
        return os.waitstatus_to_exitcode(status), failed


def _put_in(mutant: Mutant) -> None:
    """Put a fault into the functions of a module that was imported, or let this process import it
    so."""
    path = str(ROOT / mutant.file)
    sound = SourceFileLoader.get_code
    raw = Path(path).read_bytes()
    # lines behind it keep their numbers
    after = mutant.after[:-1] + "\n" * mutant.before.count("\n") + mutant.after[-1]
    faulty = compile(raw[: mutant.start] + after.encode() + raw[mutant.stop :], path, "exec")
    if any(getattr(module, "__file__", None) == path for module in list(sys.modules.values())):
        codes = dict(_codes(faulty))
        functions = gc.get_objects()
        for function in functions:
            if type(function) is FunctionType and function.__code__.co_filename == path:
                function.__code__ = codes.get(
                    (function.__code__.co_qualname, function.__code__.co_firstlineno),
                    function.__code__,
                )
        return

    def get_code(self: SourceFileLoader, fullname: str) -> Any:
        return faulty if self.path == path else sound(self, fullname)

    SourceFileLoader.get_code = get_code  # type: ignore[assignment, method-assign]


def _codes(code: CodeType) -> Iterator[tuple[tuple[str, int], CodeType]]:
    """Yield the code of all functions by name and line."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield (constant.co_qualname, constant.co_firstlineno), constant
            yield from _codes(constant)


def load() -> None:
    """Import once, for all forked processes, the whole program."""
    for path in sorted((ROOT / "prc_cli").rglob("*.py")):
        if path.stem != "__main__":
            importlib.import_module(
                ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            )


def drawn(places: list[Mutant], seed: int) -> list[Mutant]:
    """Return places in an order that depends on the seed and on what each changes, not on the lines
    around it."""
    seen: Counter[tuple[str, str, str]] = Counter()
    keys = {}
    for mutant in places:
        what = mutant.file, mutant.before, mutant.after
        seen[what] += 1
        keys[mutant] = hashlib.sha256(repr((seed, *what, seen[what])).encode()).digest()
    return sorted(places, key=keys.__getitem__)


def source_line(mutant: Mutant) -> str:
    lines = (ROOT / mutant.file).read_text("utf-8").splitlines()
    return lines[mutant.line - 1].strip()


def main() -> None:
    """Measure, mutate, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--skip", type=int, default=0, help="so many were run before")
    parser.add_argument("--only", default="", help="part of the file names to put faults into")
    parser.add_argument(
        "--list", action="store_true", help="print the places with their lines, and run nothing"
    )
    parser.add_argument("--seed", type=int, default=14)
    parser.add_argument("--rooms", nargs="*", default=ROOMS)
    parser.add_argument("--golden", type=Path, help=argparse.SUPPRESS)
    parser.add_argument(
        "--coverage",
        type=Path,
        default=Path("mutants.sqlite"),
        help="measured if it does not exist",
    )
    chosen = parser.parse_args()
    os.chdir(ROOT)
    if not os.environ.items() >= _AT_START.items():
        os.execve(
            sys.executable,
            [sys.executable, "-m", "tests.mutants", *sys.argv[1:]],
            {**os.environ, **_AT_START},
        )
    if chosen.golden:
        measure_golden(chosen.golden)
        return
    files = [
        path for room in chosen.rooms for path in sorted((ROOT / "prc_cli" / room).rglob("*.py"))
    ]
    files = [path for path in files if not path.name.endswith("_loops.py")]
    places = drawn([mutant for path in files for mutant in mutants_of(path)], chosen.seed)
    numbered = [
        (number, mutant)
        for number, mutant in enumerate(places[: chosen.count], 1)
        if number > chosen.skip and chosen.only in mutant.file
    ]
    if chosen.list:
        for number, mutant in numbered:
            print(f"{number:4} {mutant} | {source_line(mutant)}")
        return
    if not chosen.coverage.exists():
        measure(chosen.coverage)
    reached = Reached(chosen.coverage)
    golden = chosen.coverage.with_suffix(".golden").absolute()
    verdicts: dict[Mutant, tuple[bool, str]] = {}
    # what is calculated on import is changed before it is imported, the body of a function when all
    # is
    for number, mutant in sorted(numbered, key=lambda item: item[1].in_body):
        if mutant.in_body and "prc_cli.cli" not in sys.modules:
            load()
        verdicts[mutant] = judge(mutant, reached.tests(mutant), reached.cases(mutant), golden)
        print(
            f"{number:4} {'killed by ' * verdicts[mutant][0]}{verdicts[mutant][1]} | {mutant}",
            flush=True,
        )
    unsound = confirm(sorted({by for is_killed, by in verdicts.values() if is_killed}), golden)
    print(*(f"fails without a fault: {name}" for name in sorted(unsound)), sep="\n")
    tried = Counter(Path(mutant.file).parts[1] for mutant in verdicts)
    killed = Counter(
        Path(mutant.file).parts[1]
        for mutant, (yes, by) in verdicts.items()
        if yes and by not in unsound
    )
    print(*(f"{room}: {killed[room]} of {tried[room]} killed" for room in sorted(tried)), sep="\n")
    total = killed.total()
    print(
        f"{len(verdicts)} mutants of {len(places)}, {total} killed: "
        f"{100 * total / max(len(verdicts), 1):.1f} %"
    )


if __name__ == "__main__":
    main()
