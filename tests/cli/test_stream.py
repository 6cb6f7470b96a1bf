"""``prc stream`` through real pipes."""

import os
import select
import signal
import subprocess
import sys
import time

import pytest

from tests import patience
from tests.patience import HANGS_S
from tests.street import POINTS_PER_LINE, street

URBAN = f"--preset prc-2019-urban -M {POINTS_PER_LINE} --set prc.lines_per_block=16".split()


def start(*arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "prc_cli", "stream", *arguments]
    pipe = subprocess.PIPE
    return patience.popen(command, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0)


def run(data: bytes, *arguments: str) -> tuple[int, bytes, str]:
    process = start(*arguments)
    out, err = process.communicate(data, timeout=HANGS_S)
    return process.returncode, out, err.decode()


def take(process: subprocess.Popen[bytes], n_bytes: int) -> bytes:
    """Wait until so many labels have left, and give them."""
    assert process.stdout is not None
    received = b""
    while len(received) < n_bytes:
        ready, _, _ = select.select([process.stdout], [], [], HANGS_S)
        assert ready, "no labels come"
        received += os.read(process.stdout.fileno(), 1 << 16)
    return received


@pytest.mark.slow
def test_a_slow_reader_slows_the_writer_down():
    """The program holds a block and what the pipes hold, not the stream."""
    process = start(*URBAN, "-q")
    assert process.stdin is not None
    os.set_blocking(process.stdin.fileno(), False)
    data = street(137).tobytes() * 200
    taken = 0
    idle = time.monotonic()
    # it has begun to read when more was taken than fits into a pipe
    while taken < len(data) and (taken < 2 << 16 or time.monotonic() - idle < 1):
        try:
            written = os.write(process.stdin.fileno(), data[taken : taken + (1 << 16)])
            taken = taken + written
            idle = time.monotonic()
        except BlockingIOError:
            time.sleep(0.02)
        assert process.poll() is None
    assert taken < len(data) // 2, "nobody reads the labels, and yet all ranges were taken"
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_the_reader_of_the_labels_goes():
    process = start(*URBAN, "-q")
    assert process.stdout is not None
    process.stdout.close()
    _, err = process.communicate(street().tobytes() * 20, timeout=HANGS_S)
    assert process.returncode == 1
    assert err == b"error: stdout: its reader has gone\n  the labels of earlier shots are written\n"


@pytest.mark.slow
def test_a_block_leaves_when_two_more_lines_are_there_and_a_signal_ends_the_stream():
    process = start(*URBAN, "-q")
    assert process.stdin is not None
    process.stdin.write(street()[:18].tobytes())
    assert len(take(process, 16 * POINTS_PER_LINE)) == 16 * POINTS_PER_LINE
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=HANGS_S)
    assert (process.returncode, out) == (128 + signal.SIGTERM, b"")
