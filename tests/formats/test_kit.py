"""The kit that every format is tested with, and formats from outside."""

import tomllib
from pathlib import Path

import pytest

from prc_cli.formats.options import Layout
from prc_cli.formats.registry import Format, by_suffix
from prc_cli.formats.testing import check_damage, check_reads, check_round_trip
from tests.fuzz.seeds import LAYOUT, seed
from tests.fuzz.targets import suffix_of_seed

DUMP = Layout.model_validate(tomllib.loads(LAYOUT)["layout"])
SAMPLES = (
    "plain.las",
    "pf6.laz",
    "copc7.laz",
    "a.npy",
    "a.npz",
    "a.csv.gz",
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
def test_streams_are_written_alike_and_come_back(tmp_path, suffix):
    check_round_trip(by_suffix("streams")[suffix], suffix, tmp_path)


def laid(folder: Path, name: str) -> tuple[Format, Path, Layout | None]:
    """Write a sample; return its format, its place and its layout."""
    suffix = suffix_of_seed(name)
    form = by_suffix("scans")[suffix]
    path = folder / f"sample{suffix}"
    path.write_bytes(seed(name))
    return form, path, DUMP if form.is_dump else None


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_are_read_alike(tmp_path, name):
    assert check_reads(*laid(tmp_path, name)) > 0


# the hostile tests damage all others
@pytest.mark.slow
@pytest.mark.parametrize("name", ["pf6.laz", "a.npz", "a.csv.gz", "lzf.pcd", "a.ptx", "plain.mcap"])
def test_damaged_samples_are_read_or_refused(tmp_path, name):
    form, path, layout = laid(tmp_path, name)
    check_damage(form, path, tmp_path, layout, n_cases=30)
