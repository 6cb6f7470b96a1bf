"""Thinned streams: dropped shots become missing, others stay unchanged, and all are counted."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.errors import ConfigError, InputError, OutputExistsError
from prc_cli.formats.las.rewrite import read_las
from prc_cli.jobs.classify import classify
from prc_cli.jobs.thin import CLASSIFY, parse_rules, thin
from prc_cli.jobs.thin.rules import keep_by_pattern, keep_by_spacing
from tests.jobs.test_convert import config, same_bits, scans, two_scanners
from tests.street import angles, street


@pytest.fixture
def drive(tmp_path):
    path = tmp_path / "drive.npz"
    np.savez(path, range_m=street(), angle_deg=np.rad2deg(angles()))
    return path


@pytest.fixture
def labelled(drive, tmp_path):
    """The street as classified LAZ."""
    classify(drive, tmp_path / "drive.laz")
    return tmp_path / "drive.laz"


def codes(drive: Path, tmp_path: Path) -> Any:
    if not (tmp_path / "labels.npy").exists():
        classify(drive, tmp_path / "labels.npy")
    return np.load(tmp_path / "labels.npy").reshape(street().shape)


def expected(drive: Path, tmp_path: Path) -> Any:
    """The street without noise and with a quarter of its ground, said in another way."""
    image = street()
    file_codes = codes(drive, tmp_path)
    for line, column in np.argwhere(~np.isnan(image)):
        quarter = (column + 2 * line) % 4 == 0
        if file_codes[line, column] == 7 or (file_codes[line, column] == 2 and not quarter):
            image[line, column] = np.nan
    return image


QUARTER = parse_rules(["ground=1/4"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "source, suffix",
    [(".npz", ".las"), (".npz", ".npy"), (".npz", ".bin"), (".laz", ".csv.gz"), (".laz", ".npz")],
)
def test_what_is_dropped_is_missing(
    drive,
    labelled,
    tmp_path,
    suffix,
    source,
):
    out = tmp_path / f"thin{suffix}"
    summary = (
        thin(drive, out, QUARTER, labels=CLASSIFY)
        if source == ".npz"
        else thin(labelled, out, QUARTER)
    )
    (block,) = scans(out, config(out)).values()
    assert same_bits(block.range_m, expected(drive, tmp_path))
    (noise,) = [item for item in summary.classes if item.name == "noise"]
    assert (noise.n_kept, noise.n_input) == (0, int((codes(drive, tmp_path) == 7).sum()))
    (ground,) = [item for item in summary.classes if item.name == "ground"]
    assert ground.n_kept / ground.n_input == pytest.approx(0.25, abs=0.02)
    note = json.loads((tmp_path / f"thin{suffix}.prc.json").read_text())["notices"]
    assert any(text.startswith("thinned: ") for text in note)
    assert any("(ground=1/4)" in text for text in note)


def test_las_keeps_everything_else(labelled, tmp_path):
    summary = thin(labelled, tmp_path / "thin.laz", QUARTER)
    before = laspy.read(labelled)
    after = laspy.read(tmp_path / "thin.laz")
    code, line, column = (
        np.asarray(before[name]) for name in ("classification", "scan_line", "column")
    )
    stays = (code != 7) & ((code != 2) | keep_by_pattern(line, column, Fraction(1, 4)))
    assert np.array_equal(before.points.array[stays], after.points.array)
    assert sum(item.n_kept for item in summary.classes) == len(after) == int(stays.sum())
    header = after.header
    assert header.point_count == len(after)
    assert list(header.number_of_points_by_return[:2]) == [len(after), 0]
    xyz = np.asarray(after.xyz)
    assert np.allclose(header.mins, xyz.min(axis=0), atol=1e-9)
    assert np.allclose(header.maxs, xyz.max(axis=0), atol=1e-9)
    left = read_las(labelled)
    right = read_las(tmp_path / "thin.laz")
    kept = [vlr.raw for vlr in right.vlrs if vlr.key[0] != "prc-cli"]
    assert kept == [vlr.raw for vlr in left.vlrs]
    assert [vlr.key for vlr in right.vlrs][-1] == ("prc-cli", 1)
    assert "thinned: " in right.vlrs[-1].raw.decode("latin-1")
    assert summary.bytes_output < summary.bytes_input
    assert sum(item.n_bytes for item in summary.classes) == pytest.approx(
        summary.bytes_input - summary.bytes_output, abs=len(summary.classes)
    )


@given(st.integers(0, 30), st.integers(1, 30), st.integers(0, 10**6))
def test_a_share_is_exact_along_every_line(part, whole, line):
    share = Fraction(min(part, whole), whole)
    columns = np.arange(share.denominator * 5)
    kept = keep_by_pattern(np.full(len(columns), line), columns, share)
    assert kept.sum() == share.numerator * 5
    for start in range(len(columns) - share.denominator):  # evenly: in every window of a period
        assert kept[start : start + share.denominator].sum() == share.numerator


@given(st.lists(st.floats(0, 100), min_size=1, max_size=60), st.floats(0.1, 20))
def test_spacing_against_a_plain_loop(places, spacing):
    position = np.array(places)[None, :, None]
    chosen = np.ones((1, len(places)), np.bool_)
    wanted = []
    last = np.inf
    for place in places:
        taken = bool((place - last) ** 2 >= spacing**2)
        wanted.append(taken)
        last = place if taken else last
    assert keep_by_spacing(position, chosen, spacing)[0].tolist() == wanted


@pytest.mark.parametrize("suffix", [".las", ".csv"])
def test_several_scanners_and_returns(tmp_path, suffix):
    source = two_scanners(tmp_path / "two.las")
    loaded = config(scanner="point_source_id")
    rules = parse_rules(["2=1/3", "5=0"])
    out = tmp_path / f"out{suffix}"
    thin(source, out, rules, loaded)
    before = laspy.read(source)
    code, line, column = (
        np.asarray(before[name]) for name in ("classification", "scan_line", "column")
    )
    first = [block.first_line for block in scans(source, loaded).values()]
    assert first == [0, 0]
    stays = (code != 5) & ((code != 2) | keep_by_pattern(line, column, Fraction(1, 3)))
    if suffix == ".las":
        assert np.array_equal(laspy.read(out).points.array, before.points.array[stays])
    after = scans(out, loaded)
    n_after = sum(
        int((~np.isnan(block.range_m)).sum()) + len(block.extra) for block in after.values()
    )
    assert n_after == int(stays.sum())
    if suffix == ".csv":  # a table keeps its empty cells
        assert [block.points_per_line for block in after.values()] == [20, 33]
    assert (np.asarray(before["number_of_returns"])[stays] > 1).any()


@pytest.mark.parametrize(
    "rules, said",
    [
        ({"keep": ["gruond=1/4"]}, "unknown class 'gruond'; did you mean 'ground'?"),
        (
            {"spacing": ["xyzzy=1"]},
            "unknown class 'xyzzy'; known classes: unclassified, noise, ground",
        ),
        ({"keep": ["vegitation=0"]}, "did you mean 'vegetation'?"),
        ({"keep": ["2147483648=0"]}, "unknown class '2147483648'"),
        ({"keep": ["ground=5/4"]}, "found 'ground=5/4', expected a fraction from 0 to 1"),
        ({"keep": ["ground=-1/4"]}, "expected a fraction from 0 to 1"),
        ({"keep": ["ground=1/0"]}, "expected a fraction from 0 to 1"),
        ({"keep": ["ground=nan"]}, "expected a fraction from 0 to 1"),
        ({"keep": ["ground=1/9999999"]}, "denominator up to 1000000"),
        ({"keep": ["ground"]}, "found 'ground', expected CLASS=FRACTION"),
        ({"keep": ["=1/4"]}, "expected CLASS=FRACTION"),
        ({"spacing": ["ground=0"]}, "expected a distance above 0"),
        ({"spacing": ["ground=inf"]}, "expected a distance above 0"),
        ({"spacing": ["ground=ten"]}, "expected a distance above 0"),
        ({"keep": ["ground=1/4"], "spacing": ["ground=1"]}, "class code 2 is named twice"),
        ({"keep": ["ground=1/4", "2=1/2"]}, "class code 2 is named twice"),
    ],
)
def test_rules_that_make_no_sense(rules, said):
    with pytest.raises(ConfigError) as caught:
        parse_rules(**rules)
    assert said in str(caught.value)


def test_bad_input_is_one_line_and_leaves_nothing(drive, labelled, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    np.save(tmp_path / "short.npy", np.ones(77, np.uint8))
    with pytest.raises(
        InputError, match=r"short.npy: found 77 labels, expected 24660, one a record of drive.npz"
    ):
        thin(drive, out / "a.npz", labels=tmp_path / "short.npy")
    with pytest.raises(InputError, match="found 77 labels, expected"):
        thin(labelled, out / "a.laz", labels=tmp_path / "short.npy")
    names = ("ground", "building", "vegetation", "unclassified", "car", "curb", "pole")
    everything = parse_rules([f"{name}=0" for name in names])
    with pytest.raises(ConfigError, match="returns would be dropped, expected some to stay"):
        thin(labelled, out / "a.laz", everything)
    with pytest.raises(ConfigError, match="the cell of a shot depends on the order of the records"):
        thin(labelled, out / "a.laz", config=config(columns="order"))
    np.savez(tmp_path / "bare.npz", range_m=street()[:, ::2])
    with pytest.raises(ConfigError, match="neither scan angles nor coordinates"):
        thin(
            tmp_path / "bare.npz", out / "a.npz", parse_rules(spacing=["ground=1"]), labels=CLASSIFY
        )
    with pytest.raises(OutputExistsError, match="the output is the input itself"):
        thin(labelled, labelled, overwrite=True)
    with pytest.raises(OutputExistsError, match="the output is the input itself"):
        thin(drive, tmp_path / "short.npy", labels=tmp_path / "short.npy", overwrite=True)
    assert list(out.iterdir()) == []


def frame(path: Path) -> Any:
    """A frame of 16 rings as KITTI stores it, with points that share a cell.

    x, y, z and intensity of every record.
    """
    turn, ring = np.meshgrid(np.linspace(-np.pi, np.pi, 720, endpoint=False), np.arange(16))
    turn, ring = (
        np.insert(part.ravel(), [5, 900], part.ravel()[[5, 900]]) for part in (turn, ring)
    )
    up = np.deg2rad(2.0 - ring * 2.0)
    far = 8 + np.sin(turn * 3)
    level = far * np.cos(up)
    points = np.stack(
        [level * np.cos(turn), -level * np.sin(turn), far * np.sin(up), np.arange(len(turn)) % 7],
        axis=1,
    )
    points[[5, 901], :3] *= 1.01
    points.astype("<f4").tofile(path)
    return points.astype("<f4")
