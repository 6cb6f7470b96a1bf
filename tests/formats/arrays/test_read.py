"""Range images: shapes, arrays beside the ranges, and every kind of wrong array."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError, InputError, PrcError
from prc_cli.core.stream import ScanBlock, ScanStream
from prc_cli.formats.arrays.read import ArrayStream
from prc_cli.formats.options import InputConfig
from prc_cli.streams.filters import ordered
from prc_cli.streams.stream import Stream
from tests.clouds import seen

AUTO = InputConfig()


def image(n_lines: int = 7, m: int = 5) -> np.ndarray[Any, Any]:
    ranges = np.random.default_rng(2).uniform(1, 90, (n_lines, m)).astype(np.float32)
    ranges[1, 2] = np.nan
    return ranges


def whole(stream: ScanStream) -> ScanBlock:
    """The stream as one block; a typed parameter, so that mypy holds ArrayStream to the
    protocol."""
    blocks = list(stream.blocks())
    assert [block.first_line for block in blocks] == list(
        np.cumsum([0] + [b.n_lines for b in blocks])[:-1]
    )
    assert all(b.range_m.flags.c_contiguous and b.range_m.dtype == np.float32 for b in blocks)
    return join(blocks)


def save(folder: Path, array: np.ndarray[Any, Any], name: str = "scan.npy") -> Path:
    path = folder / name
    np.save(path, array)
    return path


def save_npz(folder: Path, *, compressed: bool = True, **arrays: Any) -> Path:
    path = folder / "scan.npz"
    (np.savez_compressed if compressed else np.savez)(path, **arrays)
    return path


def refused(path: Path, rules: InputConfig = AUTO) -> str:
    """The error of opening and reading, always one line, without the folder."""
    with pytest.raises(PrcError) as caught:
        whole(ordered(Stream.of(ArrayStream(path, rules)), rules.order))
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path.parent}/", "")


@pytest.mark.parametrize("chunk", [1, 200])
@pytest.mark.parametrize("clue", ["xyz", "angles", "M"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_rows_that_are_rings_are_exchanged(tmp_path, chunk, clue, order):
    """Rings x azimuth was taken for lines: PRC, or refused."""
    elevation = np.deg2rad(np.linspace(-25, 2, 16))
    azimuth = np.linspace(0, 2 * np.pi, 90)
    ranges = (np.arange(16 * 90).reshape(16, 90) / 100 + 2).astype(np.float32)
    xyz = seen(ranges, azimuth, elevation[:, None])
    beside = {"xyz": {"xyz": xyz}, "angles": {"zenith_deg": 90 - np.rad2deg(elevation)}, "M": {}}
    arrays = {"range_m": ranges, "intensity": 2 * ranges, **beside[clue]}
    path = tmp_path / "a.npz"
    np.savez(path, **{name: np.asarray(value, order=order) for name, value in arrays.items()})
    rules = InputConfig(points_per_line=16 if clue == "M" else None)
    stream = ArrayStream(path, rules, chunk_shots=chunk)
    assert (stream.info.n_lines, stream.info.points_per_line) == (90, 16)
    block = whole(stream)
    np.testing.assert_array_equal(block.range_m, ranges.T)
    np.testing.assert_array_equal(block.intensity, 2 * ranges.T)
    np.testing.assert_array_equal(ranges.ravel()[block.records()], ranges.T)
    assert any(assumption.key == "input.lines" for assumption in stream.info.assumptions)
    if clue == "xyz":
        np.testing.assert_array_equal(block.xyz_m, xyz.transpose(1, 0, 2).astype(np.float32))


@pytest.mark.parametrize(
    "array, message",
    [
        (
            np.ones((2, 3), complex),
            "scan.npy: found an array of complex numbers, expected floats or integers",
        ),
        (np.array([["a", "b"]]), "found an array of text, expected floats or integers"),
        (
            np.array([[None, 1]], object),
            "found an array of Python objects, expected floats or integers",
        ),
        (np.ones((2, 3), bool), "found an array of true/false values, expected floats or integers"),
        (
            np.zeros((2, 3), [("range", "f4"), ("t", "f8")]),
            "found an array of records with the fields range, t",
        ),
        (np.ones((2, 3, 4)), "found ranges of shape (2, 3, 4), expected (lines, points per line)"),
        (np.float32(3), "found ranges of shape (), expected (lines, points per line)"),
        (np.ones((0, 3)), "no shots, found shape (0, 3)"),
        (np.ones((3, 0)), "no shots, found shape (3, 0)"),
        (
            np.ones(6),
            "found 6 ranges in a row, expected (lines, points per line); set input.points_per_line",
        ),
    ],
)
def test_arrays_that_are_no_range_image(tmp_path, array, message):
    assert message in refused(save(tmp_path, array))
    name = "range_m"
    assert message.removeprefix("scan.npy: ") in refused(save_npz(tmp_path, **{name: array}))


@pytest.mark.parametrize(
    "beside, message",
    [
        (
            {"angle_deg": np.zeros(4)},
            "angle_deg: found shape (4,), expected (5,), one angle a column",
        ),
        (
            {"angle_deg": np.array([0, 1, np.nan, 3, 4])},
            "angle_deg: column 2: found nan, expected an angle in degrees",
        ),
        ({"angle_deg": np.array(["a"] * 5)}, "angle_deg: found an array of text"),
        (
            {"time_s": np.zeros(6)},
            "time_s: found shape (6,), expected (7,) or (7, 5), as the ranges have it",
        ),
        (
            {"xyz": np.zeros((7, 5, 2))},
            "xyz: found shape (7, 5, 2), expected (7, 5, 3), as the ranges have it",
        ),
        (
            {"intensity": np.zeros((5, 7))},
            "intensity: found shape (5, 7), expected (7, 5), as the ranges have it",
        ),
        ({"intensity": np.zeros((7, 5), object)}, "intensity: found an array of Python objects"),
    ],
)
def test_arrays_that_do_not_fit_the_ranges(tmp_path, beside, message):
    assert refused(save_npz(tmp_path, range_m=image(), **beside)).startswith(f"scan.npz: {message}")


@pytest.mark.parametrize(
    "keys",
    [
        {"lines": "angle-wrap"},
        {"columns": "angle"},
        {"scanner": "user_data"},
        {"order": "sort-time"},
        {"range": "sensor-xyz"},
        {"range": "dimension:range"},
    ],
)
def test_rules_that_an_image_cannot_follow(tmp_path, keys):
    with pytest.raises(ConfigError, match=f"input.{next(iter(keys))}: .*range image.*; leave"):
        ArrayStream(save(tmp_path, image()), InputConfig(**keys))


# --- damaged files


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda raw: raw[:50], "no npy header (EOF: reading array header"),
        (lambda raw: raw + b"\0", "found 141 bytes of numbers, expected 140 for shape (7, 5)"),
        (
            lambda raw: raw.replace(b"(7, 5)", b"(-7,5)"),
            "found shape (-7, 5), expected no negative size",
        ),
        (lambda raw: raw.replace(b"(7, 5), }", b"(99999999999, 99999999999), }", 1), "scan.npy: "),
        (
            lambda raw: raw.replace(b"'<f4'", b"'<q9'"),
            "no npy header (descr is not a valid dtype descriptor",
        ),
        (lambda raw: raw.replace(b"'<f4'", b"import"), "no npy header ("),
        (lambda raw: raw.replace(b"'<f4'", b"(((((").replace(b"}", b"\xbe"), "no npy header ("),
        (lambda raw: raw[:6] + b"\3\0" + raw[8:], "found npy format 3.0, expected 1.0 or 2.0"),
    ],
)
def test_damaged_npy(tmp_path, change, message):
    path = save(tmp_path, image())
    path.write_bytes(change(path.read_bytes()))
    assert message in refused(path)


def test_a_file_that_shrinks_while_it_is_read(tmp_path):
    path = save(tmp_path, np.ones((40_000, 5), np.float32))
    blocks = ArrayStream(path, AUTO, chunk_shots=5000).blocks()
    next(blocks)
    path.write_bytes(path.read_bytes()[:-100_000])
    with pytest.raises(InputError, match=r"the numbers end in row 35000, expected 40000 rows"):
        list(blocks)


def test_a_file_that_changes_between_opening_and_reading(tmp_path):
    path = save(tmp_path, image())
    stream = ArrayStream(path, AUTO)
    save(tmp_path, image(8))
    with pytest.raises(InputError, match="the array has changed since the file was opened"):
        whole(stream)
