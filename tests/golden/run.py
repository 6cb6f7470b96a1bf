"""``python -m tests.golden make|check``.

Run the cases in a few processes and compare with ``golden.json``.
"""

import argparse
import difflib
import hashlib
import json
import multiprocessing
import os
import re
import shutil
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Collection
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from tests.conftest import data_folder
from tests.golden import inputs
from tests.golden.cases import EXIT_CODE_ONLY, ONE_LINE_A_FILE, all_cases, words_of
from tests.golden.inputs import ROOT, answer, make

GOLDEN = Path(__file__).with_name("golden.json")
SHORT = {"stdout": 1_000, "stderr": 3_000}
"""Printed text of so many characters is kept as it is, longer text as its hash."""
TOLD = {"TERM": "dumb", "PYTHONWARNINGS": "ignore", "SOURCE_DATE_EPOCH": "0"}
# last digits of NumPy's sines and of OpenBLAS's products are others with AVX-512: every machine
# does without
TOLD |= {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR", "OPENBLAS_CORETYPE": "Haswell"}
Result = dict[str, Any]

# What a run may say differently: when, where, how fast, on which machine. Files that hold labels
# hold none of it.
_NUMBER = r"(?<![\w.])[\d,]+(?:\.\d+)?(?:e[-+]?\d+)?"
_VARYING = [
    (re.compile(pattern), text)
    for pattern, text in [
        (r"\d{8}T\d{6}Z-[0-9a-f]{8}", "<run>"),
        (r"\d{8}T\d{6}\.\d+Z", "<when>"),
        (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(\+00:00|Z)?( UTC)?", "<when>"),
        # days beside the curves of a night's report
        (r"(?<!\d)20\d\d-\d\d-\d\d(?!\d)", "<day>"),
        # of other packages, wherever and in whatever version they are installed
        (r"(?<=Traceback \(most recent call last\):\n)(  .*\n)+", ""),
        (r"process \d+( of \S+ on \S+)?", "<process>"),
        (
            r'("(?:seconds|\w+_seconds|seconds_\w+|peak_mib|\w*mtime_ns|\w+_per_s|real_time\w*|longest_latency_s|free\w*'
            r'|owner|process)": ?)[^,\n}]+',
            r"\1<varies>",
        ),
        (_NUMBER + r"(?= (?:million|M/s|x real time)(?:\W|$))", "<rate>"),
        (r"\b(in|about|most) " + _NUMBER + r" (?:s|ms|min|h|µs)(?=[\s,;.)]|$)", r"\1 <time>"),
        (_NUMBER + r" (?:MiB|GiB|GB|MB)(?= (?:are|is|free|of memory))", "<size>"),
    ]
]


def plain(text: str, folder: Path) -> str:
    """Return what is printed or written without what differs between two runs of the same
    program."""
    places = (
        (folder.resolve(), "<root>"),
        (folder, "<root>"),
        (data_folder(), "<data>"),
        (ROOT, "<repo>"),
    )
    for place, name in places:
        text = text.replace(str(place), name)
    for pattern, replacement in _VARYING:
        text = pattern.sub(replacement, text)
    return text


def digest(data: bytes | str) -> str:
    return hashlib.sha256(
        data.encode(errors="surrogateescape") if isinstance(data, str) else data
    ).hexdigest()


def lines_or_digest(text: str, most: int) -> list[str] | str:
    if len(text) <= most:
        return text and text.split("\n")
    return f"sha256 {digest(text)}, {text.count(chr(10))} lines"


def digest_of_file(path: Path, folder: Path) -> str:
    """Return the hash of a file: of its bytes, but for the few that name times and machines."""
    if path.suffix == ".sqlite":
        with sqlite3.connect(path) as journal:
            rows = journal.execute(
                "SELECT name, state, config_sha256, version, attempts, owns_output, "
                "outcome FROM files ORDER BY name"
            ).fetchall()
        return digest(plain(repr(rows), folder))
    data = path.read_bytes()
    if (
        path.suffix in (".json", ".jsonl") and not path.name.endswith(".prc.json")
    ) or path.name == "report.html":
        return digest(plain(data.decode(errors="surrogateescape"), folder))
    return digest(data)


def _copy(source: str, target: str) -> None:
    if Path(source).is_dir():
        shutil.copytree(source, target, dirs_exist_ok=True)
        return
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def _poke(path: str, offset: str, data: str) -> None:
    """Overwrite bytes; size and time of the file do not show it."""
    before = Path(path).stat()
    with Path(path).open("r+b") as handle:
        handle.seek(int(offset))
        handle.write(bytes.fromhex(data))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def _write(path: str, text: str) -> None:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_bytes(text.encode().decode("unicode_escape").encode())


def _edit(source: str, target: str, old: str, new: str) -> None:
    """Copy a file with the first ``old`` replaced; bytes may be written ``\\xff``."""
    before, after = (
        text.encode().decode("unicode_escape").encode("latin-1") for text in (old, new)
    )
    data = Path(source).read_bytes()
    assert before in data, f"{source} does not hold {old}"
    Path(target).write_bytes(data.replace(before, after, 1))


STEPS: dict[str, Callable[..., object]] = {
    "@make": lambda: make(Path.cwd()),
    "@spoilt": inputs.make_spoilt,
    "@misread": inputs.make_misread,
    "@doubtful": inputs.make_doubtful,
    "@stored": inputs.make_stored,
    "@odd": lambda name, *sources: getattr(import_module("tests.golden.odd_files"), name)(*sources),
    "@cp": _copy,
    "@cut": lambda path, n: os.truncate(path, int(n)),
    "@half": lambda path: os.truncate(path, Path(path).stat().st_size // 2),
    "@poke": _poke,
    "@edit": _edit,
    "@write": _write,
    "@answer": answer,
    "@folder": lambda path: Path(path).mkdir(parents=True),
    "@rm": lambda path: Path(path).unlink(),
    "@py": lambda code: exec(code, {"np": np, "prc_cli": __import__("prc_cli"), "Path": Path}),
}
"""Steps of a case beside the commands.

Files are prepared, damaged, or the Python interface is called.
"""


def run_step(words: list[str], folder: Path) -> tuple[int, str, str]:
    """Run one command of a case in this process, with real files as its standard streams."""
    from prc_cli.cli import main

    stdin = os.devnull
    if "<" in words:
        stdin = words[words.index("<") + 1]
        words = words[: words.index("<")]
    code: object = 0
    streams = sys.stdin, sys.stdout, sys.stderr
    with tempfile.TemporaryDirectory() as scratch:
        names = [Path(scratch, name) for name in ("out", "err")]
        with (
            open(stdin, "rb") as taken,  # noqa: PTH123
            names[0].open("wb") as out,
            names[1].open("wb") as err,
        ):
            for number, handle in enumerate((taken, out, err)):
                os.dup2(handle.fileno(), number)
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        sys.stdout, sys.stderr = (open(fd, "w", encoding="utf-8", closefd=False) for fd in (1, 2))  # noqa: SIM115
        try:
            if words[0] in STEPS:
                STEPS[words[0]](*words[1:])
            else:
                main(words)
        except SystemExit as stop:
            code = stop.code
        except Exception as error:
            code = f"{type(error).__name__}: {error}"
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        with open(os.devnull, "r+b") as null:  # noqa: PTH123
            for number in range(3):
                os.dup2(null.fileno(), number)
        sys.stdin, sys.stdout, sys.stderr = streams
        contents = [name.read_bytes() for name in names]
    out_text = (
        f"<{len(contents[0])} bytes {digest(contents[0])}>"
        if words[0] == "stream"
        else contents[0].decode()
    )
    shown = code if isinstance(code, (int, str)) else int(code is not None)
    return shown, plain(out_text, folder), plain(contents[1].decode(), folder)  # type: ignore[return-value]


def run_case(name: str, commands: list[str], folder: str) -> tuple[str, Result, float]:
    """Run the commands of a case in its own folder."""
    from prc_cli.cli import report

    report.COMPILING_S = 1e6  # whether loading takes long depends on the machine
    begun = time.monotonic()
    place = Path(folder, name)
    place.mkdir(parents=True)
    os.chdir(place)
    codes = []
    out = ""
    err = ""
    for command in commands:
        step = words_of(command.replace("$DATA", "../data").replace("$REPO", "../repo"))
        code, more_out, more_err = run_step(step, Path(folder))
        out = out + more_out
        err = err + more_err
        if step[0] not in STEPS or code:
            codes.append(code)
    result: Result = {"exit": ", ".join(map(str, codes))}
    if not name.startswith(EXIT_CODE_ONLY):
        for stream, text in (("stdout", out), ("stderr", err)):
            # to look at, with --folder
            Path(folder, f"{name}.{stream}").write_text(text, encoding="utf-8")
            result[stream] = lines_or_digest(text, SHORT[stream])
        files = sorted(
            path
            for path in place.rglob("*")
            if path.is_file() and not path.name.endswith(("-wal", "-shm"))
        )
        kept_files = {
            plain(path.relative_to(place).as_posix(), Path(folder)): digest_of_file(
                path, Path(folder)
            )
            for path in files
        }
        result["files"] = (
            kept_files
            if len(kept_files) <= ONE_LINE_A_FILE
            else {f"{len(kept_files)} files": digest(repr(kept_files))}
        )
    return name, result, time.monotonic() - begun


def needed(cases: dict[str, list[str]], chosen: Collection[str]) -> dict[str, int]:
    """Return the chosen cases and those whose files they read, with how many cases lie before
    them."""
    depth: dict[str, int] = {}

    def visit(name: str) -> int:
        if name not in depth:
            others = set(re.findall(r"\.\./([\w.-]+)/", " ".join(cases[name]))) - {name}
            depth[name] = 1 + max(map(visit, others), default=-1)
        return depth[name]

    for name in chosen:
        visit(name)
    return depth


def run(
    only: Collection[str] = ("",),
    jobs: int = 2,
    folder: Path | None = None,
    *,
    exact: bool = False,
) -> tuple[dict[str, Result], list[str]]:
    """Run the cases whose names are in ``only``, or hold one of them.

    Return results, and the names without data.
    """
    cases = all_cases()
    chosen = [
        name for name in cases if (name in only if exact else any(part in name for part in only))
    ]
    skipped = [
        name for name in chosen if "$DATA" in " ".join(cases[name]) and not data_folder().is_dir()
    ]
    depth = needed(cases, [name for name in chosen if name not in skipped])
    place = folder or Path(tempfile.mkdtemp(prefix="prc-golden-"))
    results: dict[str, Result] = {}
    slow = []
    # the same short names wherever the checkout lies: tables are as wide as the names in them
    place.mkdir(exist_ok=True)
    for name, target in (("data", data_folder()), ("repo", ROOT)):
        (place / name).symlink_to(target.resolve(), target_is_directory=True)
    try:
        with (
            patch.dict(os.environ, TOLD),
            ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool,
        ):
            for level in range(max(depth.values(), default=-1) + 1):
                names = [name for name in depth if depth[name] == level]
                futures = [pool.submit(run_case, name, cases[name], str(place)) for name in names]
                for future in futures:
                    name, result, seconds = future.result()
                    results[name] = result
                    slow.append((seconds, name))
    finally:
        if folder is None:
            shutil.rmtree(place, ignore_errors=True)
    slow.sort(reverse=True)
    print("slowest: " + ", ".join(f"{name} {seconds:.1f} s" for seconds, name in slow[:8]))
    return {name: results[name] for name in chosen if name in results}, skipped


def lines_of(kept: list[str] | str) -> list[str]:
    return kept if isinstance(kept, list) else kept.splitlines()


def differences(kept: dict[str, Result], results: dict[str, Result]) -> list[str]:
    """Return a line for everything that is not as it was kept."""
    lines = []
    for name in sorted(results):
        if name not in kept:
            lines.append(f"{name}: not kept")
            continue
        old, new = (
            {**item, **{f"file {k}": v for k, v in item.get("files", {}).items()}}
            for item in (kept[name], results[name])
        )
        for key in sorted((old.keys() | new.keys()) - {"files"}):
            if old.get(key) != new.get(key):
                lines.append(f"{name}: {key}")
                before, after = (lines_of(item.get(key, "nothing")) for item in (old, new))
                lines += [
                    f"    {row}" for row in difflib.unified_diff(before, after, lineterm="", n=0)
                ][2:]
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("what", choices=["make", "check", "list"])
    parser.add_argument(
        "--only", action="append", help="cases whose name holds this; may be given several times"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 2)
    parser.add_argument("--folder", type=Path, help="new folder, which is kept")
    options = parser.parse_args()
    if options.what == "list":
        for name, commands in all_cases().items():
            print(name, *commands, sep="\n    ")
        return 0
    if options.folder:
        options.folder.mkdir(parents=True)
        options.folder = options.folder.absolute()
    begun = time.monotonic()
    results, skipped = run(options.only or ("",), options.jobs, options.folder)
    kept = json.loads(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.exists() else {}
    lines = differences(kept, results)
    if not options.only:
        lines += [
            f"{name}: kept, but no case any more"
            for name in sorted(kept.keys() - results.keys() - set(skipped))
        ]
    print("\n".join(lines))
    if skipped:
        print(f"skipped: {len(skipped)} cases on real scans, no folder {data_folder()}")
    n_other = len({line.split(":")[0] for line in lines if line[0] != " "})
    print(f"{len(results)} cases in {time.monotonic() - begun:.0f} s, {n_other} differ")
    if options.what == "make":
        kept = {name: kept[name] for name in all_cases() if name in kept} | results
        text = json.dumps(kept, indent=1, sort_keys=True, ensure_ascii=False)
        GOLDEN.write_text(text + "\n", encoding="utf-8")
        return 0
    return int(bool(lines))
