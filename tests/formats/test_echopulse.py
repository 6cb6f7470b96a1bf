"""Folders of pulses and echoes: every pulse is a shot, its echoes are returns."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.formats import check_input, scan_file
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.cli.test_commands import Prc
from tests.formats.cloud_files import pulse_folder

ECHOES = "echo-float32-range.bin"


def test_every_pulse_is_a_shot(tmp_path: Path) -> None:
    path = pulse_folder(tmp_path / "p")
    count = np.fromfile(path, np.uint8)
    block = join(list(open_input(path, InputConfig.model_validate({"return": "last"})).blocks()))
    assert block.range_m.shape == (12, 60)
    np.testing.assert_array_equal(np.isfinite(block.range_m).ravel(), count > 0)
    ranges = np.fromfile(tmp_path / "p" / "echo-float32-range.bin", "<f4")
    last = np.cumsum(count, dtype=int)[count > 0] - 1
    np.testing.assert_array_equal(block.range_m[np.isfinite(block.range_m)], ranges[last])
    np.testing.assert_allclose(np.asarray(block.time_s).ravel(), 100 + 1e-5 * np.arange(720))
    assert len(block.extra) == count.sum() - np.count_nonzero(count)


def test_the_folder_names_the_file_to_give(tmp_path: Path) -> None:
    pulse_folder(tmp_path / "p")
    assert scan_file(tmp_path / "p") == tmp_path / "p" / "pulse-uint8-n_echo.bin"
    with pytest.raises(InputError, match="name the file in it: .*pulse-uint8-n_echo.bin"):
        check_input(tmp_path / "p")


def test_a_shot_without_return_that_meets_another_is_no_return(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = pulse_folder(tmp_path / "p")
    theta = np.fromfile(tmp_path / "p" / "pulse-float32-theta.bin", "<f4")
    count = np.fromfile(path, np.uint8)
    empty = int(np.flatnonzero(count == 0)[60])
    theta[empty] = theta[empty - 1]
    theta.tofile(tmp_path / "p" / "pulse-float32-theta.bin")
    for command in (["convert"], ["classify", "--preset", "urban"]):
        output = tmp_path / f"{command[0]}.laz"
        assert Prc(capsys)(*command, path, output).code in (0, 4)  # 4: such echoes are no street
        points = laspy.read(output)
        np.testing.assert_array_equal(np.sort(points["range"]), np.sort(np.fromfile(path.parent / ECHOES, "<f4")))


@pytest.mark.data
def test_the_standing_car(real_data: Path) -> None:
    folder = real_data / "echopulse"
    stream = open_input(folder / "pulse-uint8-n_echo.bin", InputConfig())
    blocks = list(stream.blocks())
    shots = sum(int(np.isfinite(block.range_m).sum()) for block in blocks)
    tally = sum((block.tally for block in blocks[1:]), blocks[0].tally)
    count = np.fromfile(folder / "pulse-uint8-n_echo.bin", np.uint8)
    assert stream.info.points_per_line == 2917
    assert abs(shots - np.count_nonzero(count)) <= 438  # of 291 970, shots that met another one
    assert tally.n_collisions <= 438
    ranges = np.sort(np.fromfile(folder / "echo-float32-range.bin", "<f4"))
    seen = [block.range_m[np.isfinite(block.range_m)] for block in blocks] + [block.extra.range_m for block in blocks]
    flat = np.concatenate(seen)
    np.testing.assert_array_equal(np.sort(flat[np.isfinite(flat)])[-1000:], ranges[-1000:])
