"""Runs commands on damaged files, each in a forked process that is limited and watched.

The server is a process that loads everything once. For each job, a line of JSON on stdin, it forks
a child that runs the command in the program's own functions and judges it.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

from prc_cli.cli import COMMANDS, _run, cli
from prc_cli.core import process as limits
from prc_cli.core.files import cache_folder
from prc_cli.core.loop_cache import writable_cache
from prc_cli.core.loops import load_loops
from prc_cli.jobs.doctor import every_loop
from tests.fuzz.guard import unprintable, watch
from tests.fuzz.oracles import judge_content
from tests.fuzz.targets import STATE, arguments
from tests.messages import folded

LIMITS = {
    resource.RLIMIT_CPU: 15,
    resource.RLIMIT_AS: 3 << 30,
    resource.RLIMIT_FSIZE: 1 << 30,
    resource.RLIMIT_CORE: 0,
}
"""Processor time [s], memory that may be mapped and longest file [bytes] of a command."""
DECODER_BYTES = 200 << 20
"""Of which a library may take so much for a step of decoding."""
GROWTH_BYTES = 400 << 20
GROWTH_FACTOR = 40
"""A command may take so much memory, or so many times the size of its file, beyond what the process
held before."""
DONE = (0, 4)


class Server:
    """The process that runs commands; files in ``folder/seeds`` are read."""

    def __init__(self, folder: Path) -> None:
        # to compile them, once after installation, is no hang of the command that needs them first
        load_loops(every_loop())
        self._folder = folder
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.server", str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # a module that no process imported before is no file that a case writes
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"},
            start_new_session=True,
        )

    def run(self, command: str, case: Path) -> dict[str, Any]:
        """Run a command on a case; the answer has ``code``, ``faults`` and what was ``printed``."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        job = {"command": command, "case": str(case)}
        self._process.stdin.write((json.dumps(job) + "\n").encode())
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        if answer["code"] == -signal.SIGXCPU:
            answer["faults"].append("hang: its processor time is used up")
        elif (answer["code"] or 0) < 0 or "panicked at" in answer["printed"]:
            answer["faults"] += self._faults_as_users_see_them(command, case)
        return answer

    def _faults_as_users_see_them(self, command: str, case: Path) -> list[str]:
        """Run what ended the child under the guard of the program: one line, exit code 1 and
        nothing left are as they should be."""
        with tempfile.TemporaryDirectory(prefix="out-", dir=self._folder) as out:
            words = arguments(command, case, out, self._folder / "seeds")
            ended = subprocess.run(
                [sys.executable, "-m", "prc_cli", *words],
                stdin=case.open("rb") if words[0] == "stream" else subprocess.DEVNULL,
                capture_output=True,
                check=False,
            )
            left = os.listdir(out)
        lines = folded(ended.stderr.decode("utf-8", "replace")).splitlines()
        is_refused = len(lines) == 1 and lines[0].startswith("error: ") and not left
        # what a library tried and failed at
        is_done = "panicked at" not in "".join(lines)
        if (ended.returncode in (1, 2) and is_refused) or (ended.returncode in DONE and is_done):
            return []
        return [f"under the guard: exit code {ended.returncode}, {lines[:3]}, left {left}"]

    def close(self) -> None:
        """End the process and its child."""
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.communicate()


def serve(folder: Path) -> None:
    """Do one job after the other, each in a child."""
    for command in COMMANDS:
        cli.get_command(
            cli.make_context("prc", [command, "--help"], resilient_parsing=True), command
        )
    load_loops(every_loop())
    for line in sys.stdin:
        reader, writer = os.pipe()
        with tempfile.TemporaryDirectory(prefix="job-", dir=folder) as place:
            child = os.fork()
            if not child:
                answer = run(json.loads(line), folder, Path(place))
                os.write(writer, json.dumps(answer).encode())
                os._exit(0)
            os.close(writer)
            with os.fdopen(reader) as pipe:
                text = pipe.read()
            _, status = os.waitpid(child, 0)
            code = os.waitstatus_to_exitcode(status)
        print(text or json.dumps({"code": code, "faults": [], "printed": ""}), flush=True)


def run(job: dict[str, str], folder: Path, place: Path) -> dict[str, Any]:
    """Run a command in this process, which is limited and watched from now on, and judge it."""
    case = Path(job["case"])
    out = place / "out"
    scratch = place / "scratch"
    for made in (out, scratch):
        made.mkdir()
    tempfile.tempdir = os.environ["TMPDIR"] = str(scratch)
    words = arguments(job["command"], case, out, folder / "seeds")
    is_stream = words[0] == "stream"
    source = (case if is_stream else Path(os.devnull)).open("rb")
    printed = (scratch / "printed").open("w+b")
    binary = (scratch / "binary").open("wb")
    for descriptor, file in enumerate((source, binary if is_stream else printed, printed)):
        os.dup2(file.fileno(), descriptor)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
    for name, value in LIMITS.items():
        resource.setrlimit(name, (value, value))
    limits.hold_limits()
    limits.SPARE_BYTES = DECODER_BYTES
    held = peak()
    seen = watch((out, scratch, folder / STATE, cache_folder(), writable_cache() or scratch))
    faults: list[str] = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            code: Any = _run(words, debug=False)
        except SystemExit as left:
            code = left.code
        except BaseException:
            code = None
            faults.append("".join(traceback.format_exc().splitlines(True)[-14:]))
    grown = peak() - held
    sys.stdout.flush()
    sys.stderr.flush()
    faults += [f"guard: {event}" for event in seen]
    faults += [
        f"warning: {warning.message}\nFile {warning.filename} line {warning.lineno}"
        for warning in warned
        if "prc_cli" in warning.filename or issubclass(warning.category, RuntimeWarning)
    ]
    if grown > max(GROWTH_BYTES, GROWTH_FACTOR * case.stat().st_size):
        faults.append(f"memory: grew by {grown >> 20} MiB")
    printed.seek(0)
    text = printed.read(4 << 20).decode("utf-8", "surrogateescape")
    faults += judge_text(text, code)
    left_names = sorted(os.listdir(out))
    if code in DONE:
        faults += judge_content(job["command"], case, out, scratch)
        left_names = [name for name in left_names if name.startswith(".") or ".part" in name]
    if left_names:
        faults.append(f"exit code {code} left {left_names}")
    return {"code": code, "faults": faults, "printed": text[-3000:]}


def judge_text(text: str, code: Any) -> list[str]:
    """Judge what was printed, also by libraries; the guard is to keep that from the terminal."""
    faults = []
    if bad := unprintable(text):
        place = min(text.index(character) for character in bad)
        faults.append(f"printed {bad!r}: {text[max(0, place - 60) : place + 40]!r}")
    if "Traceback (most recent" in text:
        faults.append("printed " + text[:500])
    has_doubts = '"doubts": [' in text and '"doubts": []' not in text  # by --json
    is_said = {
        0: True,
        4: "warning: " in text or has_doubts,
        **dict.fromkeys((1, 2, 5), "error: " in text),
    }
    if not is_said.get(code):
        faults.append(f"exit code {code} without a message: {text[-200:]!r}")
    return faults


def peak() -> int:
    """Return the largest resident size of this process [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
