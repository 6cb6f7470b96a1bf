"""The kit that every format is tested with, and formats from outside."""

from __future__ import annotations

import json
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from prc_cli.cli import cli
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.registry import by_suffix, formats
from prc_cli.formats.testing import check_damage, check_reads, check_round_trip
from prc_cli.streams.open import open_input
from tests.fuzz.seeds import LAYOUT, seed
from tests.fuzz.targets import suffix_of_seed
from tests.street import angles, street

DUMP = Layout.model_validate(tomllib.loads(LAYOUT)["layout"])
SAMPLES = (
    "plain.las",
    "pf6.laz",
    "copc7.laz",
    "a.npy",
    "a.npz",
    "a.csv.gz",
    "a.3d",
    "a.ply",
    "text.ply",
    "lzf.pcd",
    "a.xyz",
    "a.bin",
    "a.ptx",
    "a.e57",
    "plain.bag",
    "plain.mcap",
    "velodyne.pcap",
)


@pytest.mark.parametrize("suffix", by_suffix("streams"))
def test_streams_are_written_alike_and_come_back(tmp_path: Path, suffix: str) -> None:
    check_round_trip(by_suffix("streams")[suffix], suffix, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
def test_samples_are_read_and_damaged_ones_are_read_or_refused(tmp_path: Path, name: str) -> None:
    suffix = suffix_of_seed(name)
    form = by_suffix("scans")[suffix]
    path = tmp_path / f"sample{suffix}"
    path.write_bytes(seed(name))
    layout = DUMP if form.is_dump else None
    assert check_reads(form, path, layout) > 0
    check_damage(form, path, tmp_path, layout, n_cases=30)


PACKAGE = """
import numpy as np
from prc_cli.core.facts import SourceFacts
from prc_cli.formats.registry import Format
from prc_cli.formats.records import RecordChunk

class Toy:
    format = "toy"
    def __init__(self, path, layout):
        self.path, self.facts = str(path), SourceFacts(line_hz=50.0)
        with path.open("rb") as handle:
            self._values = np.load(handle)
    dimensions = ("range", "scan_line", "column", "angle")
    @property
    def n_records(self):
        return len(self._values)
    def with_reading(self, reading):
        return self
    def chunks(self, names):
        yield RecordChunk(0, {name: self._values[name].astype(float) for name in names},
        len(self._values))

TOY = Format(name="toy", scans=(".toy",), records="toy_of_a_test:Toy")
"""


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A scan in the toy format, which is installed."""
    package = tmp_path / "installed"
    about = package / "toy_of_a_test-1.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-of-a-test\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[prc_cli.formats]\ntoy = toy_of_a_test:TOY\n")
    (package / "toy_of_a_test.py").write_text(textwrap.dedent(PACKAGE))
    monkeypatch.syspath_prepend(str(package))
    forget()
    range_m = street()
    line, column = np.indices(range_m.shape)
    angle = np.broadcast_to(angles(), range_m.shape)
    columns = {"range": range_m, "scan_line": line, "column": column, "angle": angle}
    rows = np.rec.fromarrays([value.ravel() for value in columns.values()], names=list(columns))
    path = tmp_path / "archive" / "drive.toy"
    path.parent.mkdir()
    with path.open("wb") as handle:
        np.save(handle, np.asarray(rows))
    yield path
    sys.modules.pop("toy_of_a_test", None)
    forget()


def forget() -> None:
    formats.cache_clear()
    by_suffix.cache_clear()


def run(*words: object) -> str:
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code in (0, 4), result.output
    return result.stdout


def test_the_line_frequency_of_a_header_gives_the_times_of_a_window(toy: Path) -> None:
    config = InputConfig(first="1s")
    stream = open_input(Input.of(toy), config)
    assert stream.info.line_hz == 50.0
    assert sum(block.n_lines for block in stream.blocks()) == 50


@pytest.mark.slow
def test_a_format_from_outside_goes_through_the_commands(toy: Path, tmp_path: Path) -> None:
    assert check_reads(by_suffix("scans")[".toy"], toy) == street().size
    info = json.loads(run("info", toy, "--json"))
    assert info["format"] == "toy"
    run("classify", toy, tmp_path / "labels.npy", "--preset", "urban")
    run("convert", toy, tmp_path / "same.npz")
    run("classify", tmp_path / "same.npz", tmp_path / "same.npy", "--preset", "urban")
    run("batch", toy.parent, tmp_path / "out", "--preset", "urban", "--jobs", "1")
    labels = np.load(tmp_path / "labels.npy")
    assert set(np.unique(labels)) > {2}
    assert np.array_equal(labels, np.load(tmp_path / "same.npy").ravel())
    assert np.array_equal(labels, np.load(tmp_path / "out" / "drive.toy.labels.npy"))
