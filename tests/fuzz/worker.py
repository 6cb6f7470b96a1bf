"""A process that reads damaged files and runs commands on them, one after the other, and reports
what happened.

Jobs are lines of JSON on stdin, answers go to the original stdout; output of the program and of
libraries goes to a file. The process that is started loads everything once and forks the one that
works; when that dies, or has done enough jobs to have leaked, it answers for it and forks another
one."""

from __future__ import annotations

import contextlib
import ctypes
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

from prc_cli.core import process as limits
from prc_cli.core.errors import PrcError
from prc_cli.core.files import cache_folder
from prc_cli.core.loop_cache import writable_cache
from prc_cli.core.loops import load_loops
from prc_cli.jobs.doctor import every_loop
from tests.fuzz.guard import Guard, unprintable
from tests.fuzz.oracles import BLOCKS, judge_labels, judge_las
from tests.fuzz.reads import READS, blocks
from tests.fuzz.targets import LABELLED, STATE, arguments

ADDRESS_SPACE = 3 << 30
"""Most memory that a worker may map [bytes]."""
DECODER_BYTES = 200 << 20
"""Of which a library may take so much for a step of decoding."""
GROWTH_BYTES = 400 << 20
GROWTH_FACTOR = 40
"""A command may take so much memory, and so many times the size of its file, beyond what the
process held before."""

JOBS_PER_PROCESS = 3000
LOOK = 4
DONE = (0, LOOK)
ENDS = (0, 1, 2, LOOK, 5)
"""Exit codes of commands that leave an output, and of all commands.

4 is done, but look at it; 5 is that somebody else
is at work."""


class Worker:
    """Runs commands in this process.

    Parameters
    ----------
    folder : Path
        ``seeds`` in it are read, ``out`` in it is written.
    """

    def __init__(self, folder: Path) -> None:
        folder_name = f"of-{os.getppid()}"
        self._seeds = folder / "seeds"
        self._out = folder / f"out-{folder_name}"
        self._scratch = folder / f"tmp-{folder_name}"
        for made in (self._out, self._scratch):
            shutil.rmtree(made, ignore_errors=True)  # of one that died
            made.mkdir()
        os.environ["TMPDIR"] = str(self._scratch)
        tempfile.tempdir = str(self._scratch)
        compiled = writable_cache()
        caches = () if compiled is None else (compiled,)
        self._guard = Guard((self._out, self._scratch, folder / STATE, cache_folder(), *caches))
        self._printed = (folder / f"printed-{folder_name}").open("w+b")
        for descriptor in (1, 2):
            os.dup2(self._printed.fileno(), descriptor)

    def run(self, job: dict[str, Any]) -> dict[str, Any]:
        """Do one job and judge it."""
        begin = self._read if "read" in job else self._command
        self._printed.seek(0)
        self._printed.truncate()
        before = _reset_peak()
        start = time.process_time()
        faults: list[str] = []
        with self._guard.armed() as seen, warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                code: Any = begin(job)
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
            f"warning: {warning.message}\nFile {warning.filename} line {warning.lineno}"
            for warning in warned
            if "prc_cli" in warning.filename or issubclass(warning.category, RuntimeWarning)
        ]
        faults += [f"guard: {event}" for event in seen[:3]]
        grown = _peak() - before
        if grown > max(GROWTH_BYTES, GROWTH_FACTOR * Path(job["case"]).stat().st_size):
            faults.append(f"memory: grew by {grown >> 20} MiB")
        panicked = False
        said = ""
        if "command" in job:
            verdict, said = self._judge_output(job, code)
            panicked = "panicked at" in said
            faults += verdict
        return {
            "code": code,
            "seconds": seconds,
            "grown": grown,
            "faults": faults,
            "panicked": panicked,
            "said": said[-300:],
        }

    def _read(self, job: dict[str, Any]) -> int:
        try:
            READS.get(job["read"], blocks)(Path(job["case"]))
        except PrcError as error:
            # what a command prints
            str(error)
            return error.exit_code
        return 0

    def _command(self, job: dict[str, Any]) -> Any:
        from prc_cli.cli import _run

        words = arguments(tuple(job["command"]), job["case"], str(self._out), str(self._seeds))
        with self._streams(job):
            try:
                return _run(words, debug=False)
            except SystemExit as left:
                return left.code

    @contextlib.contextmanager
    def _streams(self, job: dict[str, Any]) -> Any:
        held = sys.stdin, sys.stdout, sys.stderr
        is_stream = job["command"][0] == "stream"
        sink = self._scratch / "stdout"
        with (
            Path(job["case"] if is_stream else os.devnull).open("rb") as source,
            sink.open("wb") as binary,
        ):
            sys.stdin = io.TextIOWrapper(source)
            sys.stdout = (
                io.TextIOWrapper(binary)
                if is_stream
                else os.fdopen(os.dup(1), "w", encoding="utf-8")
            )
            sys.stderr = os.fdopen(os.dup(2), "w", encoding="utf-8", errors="backslashreplace")
            try:
                yield
            finally:
                for stream in (sys.stdout, sys.stderr):
                    with contextlib.suppress(Exception):
                        stream.close()
                sys.stdin, sys.stdout, sys.stderr = held

    def _judge_output(self, job: dict[str, Any], code: Any) -> tuple[list[str], str]:
        """Return the faults, and what was printed, also by libraries.

        The guard is to keep that from the terminal.
        """
        faults = []
        self._printed.seek(0)
        text = self._printed.read(4 << 20).decode("utf-8", "surrogateescape")
        if bad := unprintable(text):
            place = min(text.index(character) for character in bad)
            faults.append(f"printed {bad!r}: {text[max(0, place - 60) : place + 40]!r}")
        if "Traceback (most recent" in text:
            faults.append("printed " + text[:500])
        has_doubts = '"doubts": [' in text and '"doubts": []' not in text  # by --json
        if code == LOOK and "warning: " not in text and not has_doubts:
            faults.append(f"exit code {code} without a warning: {text[-200:]!r}")
        if code in (1, 2, 5) and "error: " not in text:
            faults.append(f"exit code {code} without a message: {text[-200:]!r}")
        faults += self._judge_content(job) if code in DONE else []
        left = sorted(path.name for path in self._out.iterdir())
        if any(name.startswith(".") or name.endswith(".part") for name in left) or (
            code not in DONE and left
        ):
            faults.append(f"exit code {code} left {left}")
        for path in self._out.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        return faults, text

    def _judge_content(self, job: dict[str, Any]) -> list[str]:
        """Compare an output with what other ways to it give."""
        case = Path(job["case"])
        try:
            if faults := judge_las(job["command"][0], case, self._out):
                return faults
            if tuple(job["command"]) != LABELLED:
                return []
            return judge_labels(
                case, Path(job["sound"]), self._out / "o.npy", self._classify_again, self._scratch
            )
        except Exception:
            return ["not judged\n" + "".join(traceback.format_exc().splitlines(True)[-8:])]

    def _classify_again(self, source: str, labels: str) -> Any:
        return self._command({"command": ("classify", source, labels, *BLOCKS), "case": source})

    def close(self) -> None:
        """Remove what was made."""
        for made in (self._out, self._scratch):
            shutil.rmtree(made, ignore_errors=True)
        with contextlib.suppress(OSError):
            Path(self._printed.name).unlink()


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


def work(folder: Path) -> None:
    """Serve jobs until stdin ends or there were many; in the process that was forked."""
    # the one that forked may be killed
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, 9, 0, 0, 0)
    answers = os.fdopen(os.dup(1), "w")
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    limits.hold_limits()
    limits.SPARE_BYTES = DECODER_BYTES
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
    worker = Worker(folder)
    for _ in range(JOBS_PER_PROCESS):
        line = _next_line()
        if not line:
            break
        answer = worker.run(json.loads(line))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    worker.close()
    os._exit(0 if line else ENDED)


ENDED = 77
"""Exit code of a worker when there are no more jobs."""


def _next_line() -> bytes:
    """Return the next job; nothing of a later one is taken, which another process may have to
    read."""
    line = b""
    while not line.endswith(b"\n"):
        piece = os.read(0, 1 << 16)
        if not piece:
            break
        line += piece
    return line


def main() -> None:
    """Load what commands need, then fork one worker after the other."""
    import prc_cli.cli.batch
    import prc_cli.cli.classify
    import prc_cli.cli.evaluate
    import prc_cli.cli.info
    import prc_cli.jobs.render
    import prc_cli.jobs.thin
    import prc_cli.jobs.transfer  # noqa: F401 - loaded once for all workers

    load_loops(every_loop())
    folder = Path(sys.argv[1])
    while True:
        child = os.fork()
        if not child:
            work(folder)
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        if code == ENDED:
            return
        if code:
            os.write(1, json.dumps({"died": abs(code)}).encode() + b"\n")


if __name__ == "__main__":
    main()
