"""A process that runs commands of the program on damaged files, one after the other, and reports what happened.

Jobs are lines of JSON on stdin, answers go to the original stdout; output of the program and of libraries goes to a
file.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from prc_cli.core.files import cache_folder
from prc_cli.kernels.cache import writable_cache
from tests.fuzz.guard import Guard, unprintable

ADDRESS_SPACE = 3 << 30
"""Most memory that a worker may map [bytes]."""
GROWTH_BYTES, GROWTH_FACTOR = 400 << 20, 40
"""A command may take so much memory, and so many times the size of its file, beyond what the process held before."""

LOOK = 4
DONE, ENDS = (0, LOOK), (0, 1, 2, LOOK)
"""Exit codes of commands that leave an output, and of all commands: 4 is done, but look at it."""


class Worker:
    """Runs commands in this process.

    Parameters
    ----------
    folder : Path
        ``seeds`` in it are read, ``out`` in it is written.
    """

    def __init__(self, folder: Path) -> None:
        self._seeds, self._out = folder / "seeds", folder / f"out-{os.getpid()}"
        self._scratch = folder / f"tmp-{os.getpid()}"
        for made in (self._out, self._scratch):
            made.mkdir(exist_ok=True)
        os.environ["TMPDIR"] = str(self._scratch)
        tempfile.tempdir = str(self._scratch)
        compiled = writable_cache()
        caches = () if compiled is None else (compiled,)
        self._guard = Guard((self._out, self._scratch, cache_folder(), *caches))
        self._printed = (folder / f"printed-{os.getpid()}").open("w+b")
        for descriptor in (1, 2):
            os.dup2(self._printed.fileno(), descriptor)

    def run(self, job: dict[str, Any]) -> dict[str, Any]:
        """Run one command and judge it."""
        from prc_cli.cli import _run
        from tests.fuzz.targets import arguments

        case = job["case"]
        given = arguments(tuple(job["command"]), case, str(self._out), str(self._seeds))
        faults: list[str] = []
        self._printed.seek(0)
        self._printed.truncate()
        before = _reset_peak()
        start = time.process_time()
        with self._streams(job), self._guard.armed() as seen, warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                code: Any = _run(given, debug=False)
                if code not in ENDS:
                    faults.append(f"exit code {code}")
            except SystemExit as left:
                code = left.code
                if code not in ENDS:
                    faults.append(f"exit code {code}")
            except BaseException as error:
                code = None
                faults.append(
                    f"{type(error).__name__}: {error}"[:300]
                    + "\n"
                    + "".join(traceback.format_exc().splitlines(True)[-14:])
                )
        seconds = time.process_time() - start
        faults += [
            f"warning: {one.message}\nFile {one.filename} line {one.lineno}"
            for one in warned
            if "prc_cli" in one.filename or issubclass(one.category, RuntimeWarning)
        ]
        faults += [f"guard: {event}" for event in seen[:3]]
        grown = _peak() - before
        if grown > max(GROWTH_BYTES, GROWTH_FACTOR * Path(case).stat().st_size):
            faults.append(f"memory: grew by {grown >> 20} MiB")
        faults += self._judge_output(job, code)
        return {"code": code, "seconds": seconds, "grown": grown, "faults": faults}

    @contextlib.contextmanager
    def _streams(self, job: dict[str, Any]) -> Any:
        held = sys.stdin, sys.stdout, sys.stderr
        is_stream = job["command"][0] == "stream"
        sink = self._scratch / "stdout"
        with Path(job["case"] if is_stream else os.devnull).open("rb") as source, sink.open("wb") as binary:
            sys.stdin = io.TextIOWrapper(source)
            sys.stdout = io.TextIOWrapper(binary) if is_stream else os.fdopen(os.dup(1), "w", encoding="utf-8")
            sys.stderr = os.fdopen(os.dup(2), "w", encoding="utf-8", errors="backslashreplace")
            try:
                yield
            finally:
                for stream in (sys.stdout, sys.stderr):
                    with contextlib.suppress(Exception):
                        stream.close()
                sys.stdin, sys.stdout, sys.stderr = held

    def _judge_output(self, job: dict[str, Any], code: Any) -> list[str]:
        faults = []
        self._printed.seek(0)
        text = self._printed.read(4 << 20).decode("utf-8", "surrogateescape")
        if bad := unprintable(text):
            at = min(text.index(character) for character in bad)
            faults.append(f"printed {bad!r}: {text[max(0, at - 60) : at + 40]!r}")
        if "Traceback (most recent" in text or "panicked at" in text:
            faults.append("printed " + text[:500])
        told = '"doubts": [' in text and '"doubts": []' not in text  # by --json
        if code == LOOK and "warning: " not in text and not told:
            faults.append(f"exit code {code} without a warning: {text[-200:]!r}")
        if code in (1, 2) and "error: " not in text:
            faults.append(f"exit code {code} without a message: {text[-200:]!r}")
        faults += _judge_las(job, self._out) if code in DONE else []
        left = sorted(path.name for path in self._out.iterdir())
        if any(name.startswith(".") or name.endswith(".part") for name in left) or (code not in DONE and left):
            faults.append(f"exit code {code} left {left}")
        for path in self._out.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        return faults

    def close(self) -> None:
        """Remove what was made."""
        for made in (self._out, self._scratch):
            shutil.rmtree(made, ignore_errors=True)
        with contextlib.suppress(OSError):
            Path(self._printed.name).unlink()


def _judge_las(job: dict[str, Any], out: Path) -> list[str]:
    """Read LAS and LAZ outputs with laspy; of a file that was copied everything but the class is as it was."""
    import laspy
    import numpy as np

    faults = []
    case = Path(job["case"])
    before, refusal = None, None
    if case.suffix in (".las", ".laz"):
        try:
            before = laspy.read(case)
        except BaseException as error:  # a panic of lazrs is no Exception
            refusal = error
    for path in (*out.glob("*.las"), *out.glob("*.laz")):
        try:
            found = laspy.read(path)
        except BaseException as error:
            # headers that it refuses and we do not are copied as they are; records must be sound
            if type(refusal) is not type(error) or "Lazrs" in type(error).__name__ or "Panic" in type(error).__name__:
                faults.append(f"laspy refuses the output: {type(error).__name__}: {error}"[:300])
            continue
        if before is None or job["command"][0] not in ("classify", "convert"):
            continue
        if len(before.points) != len(found.points):
            faults.append(f"{len(found.points)} records of {len(before.points)}")
        elif before.point_format.id == found.point_format.id:
            same = set(before.points.array.dtype.names) & set(found.points.array.dtype.names)
            for name in same - {"classification", "raw_classification"}:
                old, new = before.points.array[name], found.points.array[name]
                if old.tobytes() != new.tobytes() and old.dtype == new.dtype:
                    faults.append(f"{name} differs in {np.count_nonzero(old != new)} records")
    return faults


def _reset_peak() -> int:
    """Let the greatest resident size begin anew; return what the process holds [bytes]."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) << 10
    return 0


def main() -> None:
    """Serve jobs until stdin ends."""
    answers = os.fdopen(os.dup(1), "w")
    jobs = os.fdopen(os.dup(0))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
    worker = Worker(Path(sys.argv[1]))
    for line in jobs:
        answer = worker.run(json.loads(line))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    worker.close()


if __name__ == "__main__":
    main()
