"""A format of another package, found by its entry point, goes through the commands."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core import plugins
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.formats.registry import by_suffix, formats
from prc_cli.formats.testing import check_reads
from prc_cli.streams.open import open_input
from tests.street import angles, street

PACKAGE = """
import numpy as np
from prc_cli.core.facts import SourceFacts
from prc_cli.formats.records import CodeSource, RecordChunk
from prc_cli.formats.registry import Format
from prc_cli.formats.writing.base import ScatterWriter
from prc_cli.formats.writing.columns import asked_columns

CHUNK_RECORDS = 10_000

def stored(path):
    with path.open("rb") as handle:
        return np.load(handle)

class ToySource:
    format = "toy"
    facts = SourceFacts(line_hz=50.0, header={"made by": "a test"})

    def __init__(self, path, layout):
        self.path = str(path)
        self._values = stored(path)
        self.n_records = len(self._values)
        self.dimensions = self._values.dtype.names

    def chunks(self, names):
        for first in range(0, self.n_records, CHUNK_RECORDS):
            part = self._values[first : first + CHUNK_RECORDS]
            values = {name: part[name].astype(float) for name in names}
            yield RecordChunk(first, values, len(part))

    def with_reading(self, reading):
        return self

class ToyLabels(ScatterWriter):
    def __init__(self, labels):
        super().__init__(labels, asked_columns(labels.options), labels.n_records)

    def _write(self, record):
        codes = [item.codes for item in self._columns(self._total(record))]
        for part in codes:
            self._count(part)
        with self._temporary.open("wb") as handle:
            np.save(handle, np.concatenate(codes))
        return self._completed(record)

def open_codes(path, dimension):
    values = stored(path)
    codes = values[dimension or "class"] if values.dtype.names else values
    return CodeSource(path, len(codes), lambda: iter([codes]))

TOY = Format(
    name="toy",
    scans=(".toy",),
    records="toy_of_a_test:ToySource",
    labels=(".toylabels",),
    write_labels="toy_of_a_test:ToyLabels",
    codes=(".toy", ".toylabels"),
    open_codes="toy_of_a_test:open_codes",
)
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder of packages with the toy format."""
    folder = tmp_path_factory.mktemp("installed")
    about = folder / "toy_of_a_test-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-of-a-test\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[prc_cli.formats]\ntoy = toy_of_a_test:TOY\n")
    (folder / "toy_of_a_test.py").write_text(textwrap.dedent(PACKAGE))
    return folder


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive in the toy format, with classes: noise beyond 30 m, else surfaces."""
    range_m = street()
    line, column = np.indices(range_m.shape)
    columns = {
        "range": range_m,
        "scan_line": line,
        "column": column,
        "angle": np.broadcast_to(angles(), range_m.shape),
        "class": np.where(range_m > 30.0, 7, 2),
    }
    rows = np.rec.fromarrays([value.ravel() for value in columns.values()], names=list(columns))
    path = tmp_path_factory.mktemp("archive") / "drive.toy"
    with path.open("wb") as handle:
        np.save(handle, np.asarray(rows))
    return path


def run(installed: Path, *words: object) -> str:
    """Run a command in a process of its own, which finds the package."""
    folders = os.pathsep.join((str(installed), *sys.path))
    done = subprocess.run(
        [sys.executable, "-m", "prc_cli", *map(str, words)],
        env={**os.environ, "PYTHONPATH": folders},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (0, 4), done.stderr
    return done.stdout


def test_info_describes_it(installed, drive):
    info = json.loads(run(installed, "info", drive, "--json"))
    assert info["format"] == "toy"
    assert info["header"] == {"made by": "a test"}
    assert info["n_records"] == street().size


@pytest.fixture
def toy(installed, monkeypatch):
    """The format in this process."""
    monkeypatch.syspath_prepend(str(installed))
    plugins.installed.cache_clear()
    formats.cache_clear()
    by_suffix.cache_clear()
    yield by_suffix("scans")[".toy"]
    sys.modules.pop("toy_of_a_test", None)
    plugins.installed.cache_clear()
    formats.cache_clear()
    by_suffix.cache_clear()


def test_it_passes_the_kit(toy, drive):
    assert check_reads(toy, drive) == street().size


def test_the_line_frequency_of_a_header_gives_the_times_of_a_window(toy, drive):
    config = InputConfig(first="1s")
    stream = open_input(Input.of(drive), config)
    assert stream.info.line_hz == 50.0
    assert sum(block.n_lines for block in stream.blocks()) == 50


@pytest.mark.slow
def test_it_is_classified_alone_and_in_a_batch_and_evaluated(installed, drive, tmp_path):
    urban = ("--preset", "prc-2019-urban")
    archive = tmp_path / "out"
    run(installed, "classify", drive, tmp_path / "drive.toylabels", *urban)
    run(installed, "classify", drive, tmp_path / "drive.npy", *urban)
    run(installed, "batch", drive.parent, archive, *urban, "--jobs", "2", "--to", "toylabels")
    codes = np.load(tmp_path / "drive.npy")
    assert set(np.unique(codes)) > {2}
    batched = archive / "drive.toy.labels.toylabels"
    for path in (tmp_path / "drive.toylabels", batched):
        with path.open("rb") as handle:
            assert np.array_equal(codes, np.load(handle))
    evaluation = json.loads(run(installed, "evaluate", batched, drive, "--json"))
    assert np.sum(evaluation["confusion"]["counts"]) > street().size // 2
