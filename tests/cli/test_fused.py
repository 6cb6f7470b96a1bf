"""The fused presets on the command line: equal labels from every format, one line if something is missing."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from prc_cli import classify_ranges, load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.types import F32
from tests import patience
from tests.cli.conftest import Prc
from tests.methods.fused.street_lines import BEAM, street_lines

M = len(BEAM)
ANGLES = ("-M", str(M), "--set", "input.angle_start=-150", "--set", "input.angle_step=0.2")
PRESETS = ("fused", "fused-forest")


@pytest.fixture(scope="module")
def ranges() -> F32:
    return street_lines(70)[0]


@pytest.fixture
def dump(ranges: F32, tmp_path: Path) -> Path:
    """A raw dump of ranges, without angles."""
    path = tmp_path / "street.bin"
    path.write_bytes(ranges.tobytes())
    return path


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_file_array_and_pipe_give_the_same_labels(prc: Prc, ranges: F32, dump: Path, preset: str) -> None:
    given = ("--preset", preset, *ANGLES, "--set", "input.nadir=0", "--set", "fused.lines_per_block=32")
    out = dump.with_name("labels.npy")
    for threads in ("1", "3"):
        result = prc("classify", dump, out, "--overwrite", "--threads", threads, *given)
        assert result.code == 0, result.err
        config = load_config(preset=preset, options={"fused": {"lines_per_block": 32}})
        codes = config.config.classes.lookup()[classify_ranges(ranges, config, beam_rad=BEAM).labels]
        np.testing.assert_array_equal(np.load(out).reshape(ranges.shape), codes)
    command = [sys.executable, "-m", "prc_cli", "stream", "-q", *given]
    with dump.open("rb") as source:
        piped = patience.run(command, stdin=source, capture_output=True, check=True).stdout
    assert piped == np.load(out).tobytes()


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("shape", [(1, 61), (40, 1), (40, 2), (3, 61)])
@pytest.mark.parametrize("value", [np.nan, 5.0])
def test_small_and_dull_images_are_labelled(preset: str, shape: tuple[int, int], value: float) -> None:
    beam = np.deg2rad(np.linspace(-90, 90, shape[1]) if shape[1] > 1 else [0.0])
    found = classify_ranges(np.full(shape, value), load_config(preset=preset), beam_rad=beam).labels
    assert found.shape == shape
    assert ((found == 0) == np.isnan(value)).all()


@pytest.mark.data
def test_cars_of_a_real_street(prc: Prc, real_data: Path, tmp_path: Path) -> None:
    source, out = real_data / "oakland" / "oakland_1.csv.gz", tmp_path / "labels.npy"
    result = prc("classify", source, out, "--preset", "fused", "--set", "input.nadir=0")
    assert result.code == 0, result.err
    gates = [word for gate in ("f1.ground=0.99", "f1.car=0.6") for word in ("--fail-under", gate)]
    result = prc("evaluate", out, source, "--mapping", "street_oakland", *gates)
    assert result.code == 0, result.out + result.err
    # the mappings of the papers fold the codes back
    assert prc("evaluate", out, source, "--mapping", "oakland").code == 0


@pytest.mark.slow
@pytest.mark.data
def test_parked_cars_of_oakland_are_found(prc: Prc, real_data: Path, tmp_path: Path) -> None:
    lookup = ClassCodes().lookup()
    for strip, least in ((1, 0.75), (2, 0.8)):
        scan, output = real_data / "oakland" / f"oakland_{strip}.csv.gz", tmp_path / f"{strip}.npy"
        result = prc("classify", scan, output, "--preset", "fused")
        assert result.code in (0, 4), result.err
        rows = np.genfromtxt(scan, delimiter=",", names=True)
        cars, found = np.isin(rows["label"], (1500, 1501)), np.load(output).ravel() == lookup[Label.CAR]
        assert found[cars].mean() > least
        assert cars[found].mean() > 0.9


@pytest.mark.parametrize(
    ("file", "told"), [("ros/sick_lms1xx_ros1.bag", ("--set", "input.nadir=0")), ("organised/pumpA.e57", ())]
)
def test_rooms_are_doubted(prc: Prc, tmp_path: Path, real_data: Path, file: str, told: tuple[str, ...]) -> None:
    """A laser that turns level in a room, and a pump."""
    output = tmp_path / "labels.npy"
    result = prc("classify", real_data / file, output, "--preset", "fused", *told)
    assert result.code == 4
    assert "indoors" in result.err
    assert not (np.load(output) == 65).any()
