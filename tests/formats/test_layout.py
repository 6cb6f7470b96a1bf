"""Layouts, their options and the ranges that come out."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import ReadTally
from prc_cli.formats.options import Layout, LayoutField, decode, record_dtype
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.raw_binary.read import RawBinarySource
from prc_cli.formats.records import RecordSource
from prc_cli.formats.text.read import TextSource


def layout(*fields: dict[str, Any], **keys: Any) -> Layout:
    return Layout(fields=tuple(LayoutField(**field) for field in fields), **keys)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        (Layout(), "layout.fields: none given, expected at least one field"),
        (
            layout({"name": "range", "type": "f8"}, record_bytes=7),
            "layout.record_bytes: found 7, but the fields take 8 bytes; leave it out or give 8 or more",
        ),
        (layout({"name": "range", "unit": "deg"}), "field 'range': found unit 'deg', expected m"),
        (layout({"name": "angle", "unit": "m"}), "field 'angle': found unit 'm', expected deg or rad"),
        (
            layout({"name": "range", "type": "u2", "missing": -1}),
            "field 'range': found missing = -1, which u2 cannot hold; give the value as it is stored",
        ),
        (layout({"name": "range", "type": "i4", "missing": 0.5}), "missing = 0.5, which i4 cannot hold"),
        (layout({"name": "range", "type": "f4", "missing": 1e39}), "missing = 1e+39, which f4 cannot hold"),
    ],
)
def test_layouts_that_contradict_themselves(given: Layout, found: str) -> None:
    with pytest.raises(ConfigError) as caught:
        record_dtype(given)
    assert found in str(caught.value)
    assert caught.value.exit_code == 2


@given(
    stored=st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20),
    scale=st.sampled_from([1.0, 0.001, -2.5]),
    offset=st.sampled_from([0.0, 10.0]),
    missing=st.sampled_from([None, 0.0, -1.0]),
    order=st.sampled_from(["<i4", ">i4"]),
)
def test_value_is_stored_times_scale_plus_offset(
    stored: list[int], scale: float, offset: float, missing: float | None, order: str
) -> None:
    item = LayoutField(name="range", type="i4", scale=scale, offset=offset, missing=missing)
    expected = [math.nan if value == missing else value * scale + offset for value in stored]
    np.testing.assert_array_equal(decode(np.array(stored, order), item), expected)


SAMPLES = Path(__file__).resolve().parents[2] / "sample_configs" / "layouts"


@pytest.mark.parametrize(
    ("name", "n", "share_missing", "value"),
    [
        ("ranges_f32", 100 * 2154, 200 / 2154, 5.0),
        ("faro_like_i4_mm", 20 * 5120, 1 / 3, 7.25),
        ("big_endian_u2_cm", 50 * 1080, 580 / 1080, 12.34),
        ("range_angle_time", 40 * 720, 1 / 5, 9.5),
        ("csv_oakland", 30 * 229, 33 / 229, 6.25),
        ("csv_no_header", 60 * 541, 1 / 4, 4.321),
    ],
)
def test_the_example_in_a_sample_layout_makes_a_file_that_the_layout_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, n: int, share_missing: float, value: float
) -> None:
    sample = (SAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    given = Layout.model_validate(tomllib.loads(sample)["layout"])
    example = [line[6:] for line in sample.splitlines() if line.startswith("#     ")]
    monkeypatch.chdir(tmp_path)
    exec("\n".join(example), {})
    (path,) = tmp_path.iterdir()
    assert f"prc classify {path.name} " in sample or name == "csv_oakland"
    is_text = path.suffix in (".csv", ".txt")
    source: RecordSource = TextSource(path, given) if is_text else RawBinarySource(path, given)
    assert set(source.dimensions) >= {item.name for item in given.fields}
    ranges = np.concatenate([chunk.values["range"] for chunk in source.chunks(("range",))])
    assert len(ranges) == n
    assert np.isnan(ranges).mean() == pytest.approx(share_missing, abs=1e-4)
    np.testing.assert_allclose(ranges[~np.isnan(ranges)], value, rtol=1e-7)


def test_every_sample_layout_is_tried_above() -> None:
    tried = test_the_example_in_a_sample_layout_makes_a_file_that_the_layout_reads.pytestmark[0].args[1]  # type: ignore[attr-defined]
    assert {path.stem for path in SAMPLES.glob("*.toml")} == {case[0] for case in tried}


def test_every_reason_is_counted_once() -> None:
    given = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, -5.0, 0.5, 1.0, 1.5, 100.0, 100.5])
    ranges, tally = clean_ranges(given, min_range=1.0, max_range=100.0)
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(ranges)), [8, 9])
    assert tally == ReadTally(n_not_finite=2, n_not_positive=3, n_beyond=3)


def test_bounds_are_judged_the_same_for_float32_float64_and_integers() -> None:
    rng = np.random.default_rng(1)
    millimetres = rng.integers(0, 40_000, 5_000)
    exact = millimetres / 1000.0
    for bound in (30.1, 17.003, 0.007):
        narrow, tally_narrow = clean_ranges(exact.astype(np.float32), bound, bound + 2.3)
        wide, tally_wide = clean_ranges(exact, bound, bound + 2.3)
        np.testing.assert_array_equal(narrow, wide)
        assert tally_narrow == tally_wide
    whole, _ = clean_ranges(millimetres, 5.0, 30_000.0)
    np.testing.assert_array_equal(whole, clean_ranges(millimetres.astype(np.float64), 5.0, 30_000.0)[0])
