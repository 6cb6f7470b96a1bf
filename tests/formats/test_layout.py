"""Layouts, their options and the ranges that come out: which return of a shot stands."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.stream import ReadTally
from prc_cli.formats.options import Layout, LayoutField, decode
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.raw_binary.read import RawBinarySource
from prc_cli.formats.records import Source
from prc_cli.formats.text.read import TextSource


@given(
    stored=st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20),
    scale=st.sampled_from([1.0, 0.001, -2.5]),
    offset=st.sampled_from([0.0, 10.0]),
    missing=st.sampled_from([None, 0.0, -1.0]),
    order=st.sampled_from(["<i4", ">i4"]),
)
def test_value_is_stored_times_scale_plus_offset(
    stored,
    scale,
    offset,
    missing,
    order,
):
    item = LayoutField(name="range", type="i4", scale=scale, offset=offset, missing=missing)
    expected = [math.nan if value == missing else value * scale + offset for value in stored]
    np.testing.assert_array_equal(decode(np.array(stored, order), item), expected)


SAMPLES = Path(__file__).resolve().parents[2] / "sample_configs" / "layouts"


@pytest.mark.parametrize(
    "name, n, share_missing, value",
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
    tmp_path,
    monkeypatch,
    name,
    n,
    share_missing,
    value,
):
    sample = (SAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    sample_layout = Layout.model_validate(tomllib.loads(sample)["layout"])
    example = [line[6:] for line in sample.splitlines() if line.startswith("#     ")]
    monkeypatch.chdir(tmp_path)
    exec("\n".join(example), {})
    (path,) = tmp_path.iterdir()
    assert f"prc classify {path.name} " in sample or name == "csv_oakland"
    is_text = path.suffix in (".csv", ".txt")
    source: Source = (
        TextSource(path, sample_layout) if is_text else RawBinarySource(path, sample_layout)
    )
    assert set(source.dimensions) >= {item.name for item in sample_layout.fields}
    ranges = np.concatenate([chunk.values["range"] for chunk in source.chunks(("range",))])
    assert len(ranges) == n
    assert np.isnan(ranges).mean() == pytest.approx(share_missing, abs=1e-4)
    np.testing.assert_allclose(ranges[~np.isnan(ranges)], value, rtol=1e-7)


def test_every_sample_layout_is_tried_above():
    tried = test_the_example_in_a_sample_layout_makes_a_file_that_the_layout_reads.pytestmark[
        0
    ].args[1]  # type: ignore[attr-defined]
    assert {path.stem for path in SAMPLES.glob("*.toml")} == {case[0] for case in tried}


def test_every_reason_is_counted_once():
    stored = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, -5.0, 0.5, 1.0, 1.5, 100.0, 100.5])
    ranges, tally = clean_ranges(stored, min_range=1.0, max_range=100.0)
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(ranges)), [8, 9])
    assert tally == ReadTally(n_not_finite=2, n_not_positive=3, n_beyond=3)
