"""Classifying one file: the same labels for every format and by either engine, no files left after
failures."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import prc_cli
from prc_cli.cli import main
from prc_cli.config import load_config
from prc_cli.core.errors import EvidenceError, InputError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.stream import ExtraReturns, ReadTally
from prc_cli.core.types import F32
from prc_cli.jobs.classify import classify, threads_of
from prc_cli.jobs.run import FAR_M, Counts
from tests import patience
from tests.formats.common import labelled
from tests.messages import folded
from tests.street import POINTS_PER_LINE, street, write_npz, write_raw

WITH_M = {"input": {"points_per_line": POINTS_PER_LINE}}


@pytest.mark.parametrize("change", ["longer", "edited in place"])
def test_an_input_that_changes_while_it_is_read_is_refused(tmp_path, change):
    """Also where its size stays and its time was put back."""
    if change == "edited in place" and os.name == "nt":
        pytest.skip("a file has no time of its last change there")
    source = write_raw(tmp_path / "drive.bin", street())
    status = source.stat()

    def edit(n_lines: int) -> None:
        with source.open("ab" if change == "longer" else "rb+") as handle:
            handle.write(b"\0" * 4)
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))

    with pytest.raises(InputError, match="changed while it was read"):
        classify(source, tmp_path / "labels.npy", load_config(options=WITH_M), progress=edit)
    assert os.listdir(tmp_path) == ["drive.bin"]


def test_an_image_in_memory_is_judged_as_a_file_is():
    image = street()
    shuffled = np.random.default_rng(3).permuted(image, axis=1)
    with pytest.raises(EvidenceError, match="range_m: ranges of neighbouring shots"):
        prc_cli.classify_ranges(shuffled)
    # too few shots to tell
    prc_cli.classify_ranges(shuffled[:80])
    few = street(400)[:, ::2]  # too few columns to measure their angles
    moves = load_config(options={"input": {"accept_doubts": ["standing"]}})
    with pytest.warns(prc_cli.DoubtWarning, match="range_m: method: .*, so prc chose PRC 2019"):
        prc_cli.classify_ranges(few, moves)
    thin = np.full((137, 18_000), np.nan, np.float32)
    thin[:, :POINTS_PER_LINE] = image
    with pytest.warns(
        prc_cli.DoubtWarning, match="range_m: returns: .*input.accept_doubts = ..returns"
    ) as warned:
        prc_cli.classify_ranges(thin, load_config(preset="prc-2019-urban"))
    assert warned[0].filename == __file__
    for odd in (thin, shuffled):
        accepting = load_config(options={"input": {"accept_doubts": CHECK_NAMES}})
        prc_cli.classify_ranges(odd, accepting)


@pytest.mark.parametrize("only_records", [False, True])
def test_counts_of_two_streams_add_up(only_records):
    rng = np.random.default_rng(2)
    record = rng.integers(-1, 2, (9, 7))
    record[:2] = -1
    range_m = rng.uniform(0, 2 * FAR_M, (9, 7)).astype(np.float32)
    extra = ExtraReturns(*np.zeros((2, 3), np.int32), np.ones(3, "f4"), np.array([-1, 4, 5]))
    options = {"range_m": range_m, "record": record, "extra": extra}
    options |= {"extra_labels": np.ones(3, np.uint8), "tally": ReadTally(n_records=5)}
    blocks = [
        labelled(np.full((9, 7), 2, np.uint8), scanner=scanner, **options) for scanner in (0, 3)
    ]
    first, second = (Counts.none().add(block, only_records=only_records) for block in blocks)
    both = first + second
    is_counted = (record >= 0) | (not only_records)
    n_shots = 2 * np.count_nonzero(is_counted)
    n_far = 2 * np.count_nonzero(is_counted & (range_m > FAR_M))
    n_lines, n_extra = (14, 4) if only_records else (18, 6)
    assert (both.n_lines, both.n_shots, both.n_extra) == (n_lines, n_shots, n_extra)
    assert (both.n_far, both.tally.n_records, both.scanners) == (n_far, 10, {0: 7, 3: 7})
    assert both.labels.tolist()[:4] == [0, n_extra, n_shots, 0]


LINES = slice(50, 90)
WITHOUT_NUMBA = """
import json, sys
sys.modules["numba"] = sys.modules["llvmlite"] = None
from prc_cli.cli import main
for words in json.loads(sys.argv[1]):
    try:
        main(words)
    except SystemExit as stop:
        print(stop.code)
"""


def piece() -> F32:
    """A few lines of the street, (40, M) float32 [m]; one of them has no returns."""
    return street()[LINES]


def prc(*words: str | Path) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    return int(stop.value.code or 0)


def test_the_reference_has_one_thread():
    assert threads_of("reference", 8) == 1


@pytest.mark.slow
def test_without_numba_the_reference_classifies(tmp_path):
    made = {"npz": write_npz(tmp_path / "drive.npz", piece()), "laz": tmp_path / "drive.laz"}
    assert prc("convert", made["npz"], made["laz"], "-q") == 0
    commands = [
        ["classify", made["npz"], tmp_path / "compiled.npy"],
        *(
            ["classify", path, tmp_path / f"{name}.out.npy", "--engine", "reference", "-q"]
            for name, path in made.items()
        ),
    ]
    command = [sys.executable, "-c", WITHOUT_NUMBA, json.dumps(commands, default=str)]
    done = patience.run(command, capture_output=True, text=True)
    assert done.stdout.split() == ["1", "0", "0"]
    assert folded(done.stderr).count("\n") == 1
    assert done.stderr.startswith("error: numba: cannot be loaded")
    assert "prc classify --engine reference" in done.stderr
    assert not (tmp_path / "compiled.npy").exists()
    for name in made:
        expected = classify(
            made[name], tmp_path / f"{name}.expected.npy", load_config(preset="prc-2019-urban")
        ).output
        assert (tmp_path / f"{name}.out.npy").read_bytes() == expected.read_bytes()
