"""A library that ends its process costs one line and exit code 1, and leaves nothing behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import COMMANDS, watching
from prc_cli.core.interrupts import REPEATED_S
from tests import patience
from tests.fuzz.crafted import huge_page, overflowing
from tests.fuzz.seeds import seed
from tests.messages import folded
from tests.patience import HANGS_S

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the guard is for Linux")
ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
URBAN = ("--preset", "prc-2019-urban", "--trust-order")
STREAM = [sys.executable, *["-m", "prc_cli", "stream", "-M", "40", "--preset", "prc-2019-urban"]]

CRASH = """
import os, signal, sys
from pathlib import Path
from prc_cli import cli
from prc_cli.core.files import temporary_folder, temporary_name

def crash(arguments, debug):
    temporary_name(Path(sys.argv[-1])).write_bytes(b"half")
    with temporary_folder("prc-trial-") as folder:
        print(folder, flush=True)
        os.write(2, b"thread overflowed\\x1b[2J its stack\\n")
        print("from Python", file=sys.stderr)
        os.kill(os.getpid(), int(sys.argv[1]))

number = sys.argv[1]
sys.argv = ["prc", *sys.argv[2:]]

def run(arguments, debug):
    sys.argv = [None, number, *sys.argv[1:]]
    crash(arguments, debug)

cli._run = run
cli.main()
"""


def prc(
    *words: str | Path, guarded: bool = True, **options: object
) -> subprocess.CompletedProcess[str]:
    environment = {**ENVIRONMENT, watching.SWITCH: "1" if guarded else "0"}
    command = [sys.executable, "-m", "prc_cli", *map(str, words)]
    return patience.run(
        command, capture_output=True, text=True, env=environment, cwd=ROOT, **options
    )


def crashed(number: int, *words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", CRASH, str(number), *map(str, words)]
    return patience.run(command, capture_output=True, text=True, env=ENVIRONMENT)


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGABRT, signal.SIGKILL])
def test_a_signal_becomes_a_line(tmp_path, number):
    (tmp_path / "a\x1b.laz").touch()
    ended = crashed(number, "classify", tmp_path / "a\x1b.laz", tmp_path / "o.laz")
    assert ended.returncode == 1
    first, line, *rest = folded(ended.stderr).splitlines()
    assert (first, rest) == ("from Python", [])
    assert line.startswith(
        f"error: {tmp_path}/a\\x1b.laz: the process that read it was ended by signal {int(number)}"
    )
    assert "it printed: thread overflowed\\x1b[2J its stack; no output was left behind; " in line
    assert ("too little memory" in line) == (number == signal.SIGKILL)
    assert os.listdir(tmp_path) == ["a\x1b.laz"]
    assert not Path(ended.stdout.strip()).exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGUSR1])
def test_a_signal_of_somebody_ends_it_as_it_would_without(tmp_path, number):
    ended = crashed(number, "classify", tmp_path / "a.laz", tmp_path / "o.laz")
    assert (ended.returncode, ended.stderr) == (-number, "from Python\n")
    assert os.listdir(tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("info", "{case}"),
        ("classify", "{case}", "{out}/o.laz", *URBAN),
        ("convert", "{case}", "{out}/o.las"),
    ],
)
def test_laz_made_to_end_a_process(tmp_path, words):
    case = tmp_path / "a.laz"
    out = tmp_path / "out"
    case.write_bytes(overflowing())
    out.mkdir()
    ended = prc(*(word.format(case=case, out=out) for word in words))
    if words[0] == "info":  # what does not decode the times does not fail
        assert ended.returncode in (0, 1, 4)
    else:
        assert ended.returncode == 1
        # a busy machine is told that loading takes long
        (line,) = [
            message
            for message in folded(ended.stderr).splitlines()
            if not message.startswith("loading the classifier")
        ]
        assert line.startswith(f"error: {case}: the process that read it was ended by signal")
    assert os.listdir(out) == []
    if words[0] == "convert":
        assert (
            prc(*(word.format(case=case, out=out) for word in words), guarded=False).returncode < 0
        )


@pytest.mark.slow
def test_a_panic_of_a_library_is_not_shown(tmp_path):
    """A bad block: lazrs panics or overflows its stack; either way the damage is one line."""
    sound = seed("pf6.laz")
    case = tmp_path / "a.laz"
    case.write_bytes(sound[:1700] + b"\xff" * 1400 + sound[3100:])
    ended = prc("convert", case, tmp_path / "o.las")
    assert (ended.returncode, folded(ended.stderr).count("\n")) == (1, 1)
    assert ended.stderr.startswith(f"error: {case}: ")


@pytest.mark.slow
def test_exit_codes_and_output_pass(tmp_path):
    (tmp_path / "a.npz").write_bytes(seed("a.npz"))
    runs = [prc("info", tmp_path / "a.npz", "--json", guarded=guarded) for guarded in (True, False)]
    assert runs[0].stdout == runs[1].stdout != ""
    assert prc("info", "--no-such-option").returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "number, to_all", [(signal.SIGTERM, False), (signal.SIGTERM, True), (signal.SIGINT, True)]
)
def test_signals_reach_the_work_once(number, to_all):
    """As ``kill`` and a scheduler send them.

    To the process that was started, or to all of its group.
    """
    with patience.start(
        STREAM,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=ENVIRONMENT,
    ) as process:
        assert process.stdin is not None
        process.stdin.write(np.ones((400, 40), "<f4").tobytes())
        process.stdin.flush()
        assert process.stdout is not None
        process.stdout.read(1)  # it works
        (os.killpg if to_all else os.kill)(process.pid, number)
        _, said = process.communicate()
        assert process.returncode == {signal.SIGTERM: 143, signal.SIGINT: 130}[number], said
        assert b"Traceback" not in said


ENDLESS = """
import contextlib, sqlite3, sys, threading
from pathlib import Path
from prc_cli import cli
from prc_cli.cli import watching
from prc_cli.core import process

def work(arguments, debug):
    begun, ended = threading.Event(), threading.Event()
    threading.Thread(target=decode, args=(Path(arguments[1]), begun, ended)).start()
    with contextlib.suppress(KeyboardInterrupt, SystemExit):
        begun.set()  # a signal before this would end the work
        ended.wait()
    ended.wait()

def decode(path, begun, ended):
    begun.wait()
    base = sqlite3.connect(":memory:", check_same_thread=False)
    print("works", flush=True)
    with process.step(path):
        base.execute("SELECT instr(hex(zeroblob(4000000)), hex(zeroblob(2000000)) || 1)").fetchall()
    ended.set()

watching.PATIENCE_S = 1.0
process.STEP_CPU_S = int(sys.argv.pop(1))
cli._run = work
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "numbers", [(signal.SIGTERM,), (signal.SIGINT,), (signal.SIGINT, signal.SIGTERM)]
)
def test_a_library_that_never_returns_ends_all_the_same(tmp_path, numbers):
    """After one signal and some patience, or at once after the second."""
    (tmp_path / "a.db3").touch()
    command = [sys.executable, "-c", ENDLESS, "600", "info", str(tmp_path / "a.db3")]
    with patience.start(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT
    ) as process:
        assert process.stdout is not None
        process.stdout.read(1)
        for number in numbers:
            os.kill(process.pid, number)
            time.sleep(2 * REPEATED_S)
        _, said = process.communicate()
        assert (process.returncode, said) == (
            128 + numbers[0],
            b"error: interrupted\n  no output was left behind\n",
        )


@pytest.mark.slow
def test_a_step_has_a_limit_of_processor_time(tmp_path):
    (tmp_path / "a.db3").touch()
    command = [sys.executable, "-c", ENDLESS, "1", "info", str(tmp_path / "a.db3")]
    ended = patience.run(command, capture_output=True, text=True, env=ENVIRONMENT)
    said = (
        f"error: {tmp_path}/a.db3: decoding it made no progress in 1 s of processor time\n"
        "  no output was left behind\n"
    )
    assert (ended.returncode, ended.stderr.startswith(said)) == (1, True), ended.stderr


@pytest.mark.slow
def test_a_page_that_says_two_gigabytes_is_one_line(tmp_path):
    path = huge_page(tmp_path / "a.parquet")
    ended = prc("evaluate", path, path, "--dimension", "range", "--dimension", "reference=range")
    assert (ended.returncode, folded(ended.stderr).count("\n")) == (1, 1), ended.stderr
    assert f"{path}: record 0 and on cannot be read (malloc of size" in ended.stderr


@pytest.mark.slow
def test_the_work_ends_with_its_guard():
    with patience.start(
        STREAM, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=ENVIRONMENT
    ) as process:
        place = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        patience.wait_until(lambda: place.read_text().split(), "the child")
        (child,) = place.read_text().split()
        time.sleep(0.2)  # it asks to be ended with its parent first of all
        process.kill()
        patience.wait_until(
            lambda: not Path(f"/proc/{child}/cmdline").exists() or not _runs(child), "its end"
        )


def _runs(process: str) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_every_command_that_reads_files_is_guarded():
    assert set(COMMANDS) > watching.UNGUARDED
    assert not watching.UNGUARDED & {
        "info",
        "classify",
        "batch",
        "stream",
        "evaluate",
        "transfer",
        "convert",
        "thin",
    }


def run(redirection: str, *arguments: str) -> tuple[int, bytes, str]:
    command = [sys.executable, "-m", "prc_cli", *arguments]
    done = patience.run(
        ["sh", "-c", f'"$@" {redirection}', "sh", *command],
        input=bytes(4 * 90),
        capture_output=True,
    )
    return done.returncode, done.stdout, done.stderr.decode()


@pytest.mark.slow
@pytest.mark.parametrize("redirection, name", [("<&-", "stdin"), (">&-", "stdout")])
def test_a_live_stream_needs_both_ends(redirection, name):
    code, out, err = run(redirection, "stream", "-M", "9")
    assert (code, out) == (2, b"")
    assert f"{name} is closed" in err
    assert folded(err).count("\n") == 1


@pytest.mark.slow
def test_files_are_written_though_nobody_listens(tmp_path):
    source = tmp_path / "drive.bin"
    output = tmp_path / "labels.npy"
    np.full((20, 9), 7.0, np.float32).tofile(source)
    code, _, _ = run("<&- >&- 2>&-", "classify", str(source), str(output), "-M", "9", "--json")
    assert code == 0
    assert np.load(output).size == 180


PROGRAM = """
import os, signal, time
from prc_cli.cli import _leave_on_signals
_leave_on_signals()

class Deleted:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        sum(range(100))

Deleted()
time.sleep({hangs})
print("still running")
"""


@pytest.mark.skipif(os.name != "posix", reason="sends itself a signal")
@pytest.mark.parametrize("name, code", [("SIGTERM", 143), ("SIGINT", -2)])
def test_it_comes_again(name, code):
    program = PROGRAM.format(name=name, hangs=HANGS_S)
    done = patience.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (code, "")
