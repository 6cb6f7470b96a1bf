"""Reader, classifier and writer in parallel: equal bytes, clean shutdown, no thread left."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.errors import InputError
from prc_cli.formats.writing.base import StagedWriter
from prc_cli.jobs.classify import classify, load_classifier
from prc_cli.methods.prc.pipeline import Prc
from prc_cli.streams import grid
from tests import patience
from tests.messages import folded
from tests.patience import HANGS_S, wait_until
from tests.street import POINTS_PER_LINE, street, write_csv, write_endless, write_npz, write_raw

OPTIONS = {"input": {"points_per_line": POINTS_PER_LINE}, "prc": {"lines_per_block": 15}}
SHORT = load_config(preset="prc-2019-urban", options=OPTIONS)
OURS = ("read-ahead", "write-behind", "fingerprint", "ThreadPoolExecutor")


@pytest.fixture(scope="module")
def image():
    return street()


@pytest.fixture
def no_thread_left():
    yield
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith(OURS)]


@pytest.mark.slow
@pytest.mark.usefixtures("no_thread_left")
@pytest.mark.parametrize(
    "kind, suffix", [(".bin", ".npy"), (".csv", ".csv"), (".npz", ".parquet"), (".csv", ".laz")]
)
def test_bytes_are_equal_with_any_number_of_threads(
    tmp_path,
    image,
    kind,
    suffix,
):
    write = {".bin": write_raw, ".csv": write_csv, ".npz": write_npz}[kind]
    source = write(tmp_path / f"drive{kind}", image)
    outputs = []
    for threads in (1, 2, 3):
        output = tmp_path / f"{threads}{suffix}"
        record = classify(source, output, SHORT, threads=threads).record
        outputs.append((output.read_bytes(), record.as_dict()))
    assert outputs[0] == outputs[1] == outputs[2]


@pytest.mark.usefixtures("no_thread_left")
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_rewritten_clouds_are_equal_with_any_number_of_threads(tmp_path, image, suffix):
    source = tmp_path / f"drive{suffix}"
    classify(write_npz(tmp_path / "drive.npz", image), source, SHORT)
    outputs = [tmp_path / f"{threads}{suffix}" for threads in (1, 2, 3)]
    for threads, output in enumerate(outputs, 1):
        classify(source, output, SHORT, threads=threads)
    assert outputs[0].read_bytes() == outputs[1].read_bytes() == outputs[2].read_bytes()


def after(n: int, function: Callable[..., object], error: BaseException) -> Callable[..., object]:
    """Let a function work ``n`` times and then raise."""
    calls = iter(range(10_000))

    def call(*arguments: object, **named: object) -> object:
        if next(calls) >= n:
            raise error
        return function(*arguments, **named)

    return call


@pytest.mark.usefixtures("no_thread_left")
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("where", ["reader", "classifier", "writer", "progress"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("fault")])
def test_an_error_anywhere_ends_the_run_and_leaves_nothing(
    tmp_path,
    monkeypatch,
    image,
    where,
    threads,
    error,
):
    if isinstance(error, KeyboardInterrupt) and where == "classifier":
        pytest.skip("interrupts arrive in the main thread")
    source = write_raw(tmp_path / "drive.bin", image)
    out = tmp_path / "out"
    out.mkdir()
    progress = None
    if where == "reader":
        monkeypatch.setattr(grid, "dense_block", after(1, grid.dense_block, error))
        monkeypatch.setattr("prc_cli.formats.binary.CHUNK_BYTES", 4 * 20 * POINTS_PER_LINE)
    elif where == "classifier":
        monkeypatch.setattr(Prc, "label", after(2, Prc.label, error))
    elif where == "writer":
        monkeypatch.setattr(StagedWriter, "add", after(2, StagedWriter.add, error))
    else:
        progress = after(2, lambda n: None, error)
    with pytest.raises(type(error)):
        classify(source, out / "labels.npy", SHORT, threads=threads, progress=progress)  # type: ignore[arg-type]
    assert os.listdir(out) == []


def test_an_input_that_vanishes_from_the_fingerprint_is_refused(tmp_path, monkeypatch, image):
    source = write_raw(tmp_path / "drive.bin", image)
    (tmp_path / "out").mkdir()
    gone = InputError("drive.bin", "cannot be read", "check")
    monkeypatch.setattr(
        "prc_cli.formats.writing.record.FingerprintBeside._read", after(0, print, gone)
    )
    with pytest.raises(InputError, match="cannot be read"):
        classify(source, tmp_path / "out" / "labels.npy", SHORT, threads=2)
    assert os.listdir(tmp_path / "out") == []


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="limits of files")
@pytest.mark.parametrize("suffix", [".npy", ".laz"])
def test_a_full_disk_is_told_in_one_line(tmp_path, image, suffix):
    import resource

    source = write_raw(tmp_path / "drive.bin", np.tile(image, (4, 1)))
    (tmp_path / "out").mkdir()
    output = tmp_path / "out" / f"labels{suffix}"

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))

    # loops that are not in the cache yet could not be written there
    load_classifier(SHORT)
    words = (
        f"classify {source} {output} -M {POINTS_PER_LINE} -q --preset prc-2019-urban --threads 2"
    )
    command = [sys.executable, "-m", "prc_cli", *words.split()]
    run = patience.run(command, capture_output=True, text=True, preexec_fn=limit)
    assert run.returncode == 1, run.stderr
    assert folded(run.stderr).count("\n") == 1
    assert "the system's limit for the size of a file is too small" in run.stderr
    assert os.listdir(tmp_path / "out") == []


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("threads", ["1", "2"])
def test_ctrl_c_in_mid_run_ends_it_within_seconds(tmp_path, threads):
    source = write_endless(tmp_path / "drive.bin")
    out = tmp_path / "out"
    out.mkdir()
    words = f"classify {source} {out}/labels.npy -M 800 -q --preset prc-2019-urban"
    command = [sys.executable, "-m", "prc_cli", *words.split(), "--threads", threads]
    with patience.start(command, stderr=subprocess.PIPE, text=True) as run:
        # the run is in its midst when labels are there
        wait_until(
            lambda: (
                any(part.stat().st_size > 300_000 for part in out.iterdir())
                or run.poll() is not None
            )
        )
        assert run.poll() is None
        run.send_signal(signal.SIGINT)
        _, printed = run.communicate(timeout=HANGS_S)
    assert run.returncode == 130, printed
    assert "Traceback" not in printed
    assert list(out.iterdir()) == []
