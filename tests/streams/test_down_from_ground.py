"""Straight down from level ground."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.classify import classify, classify_ranges, open_stream
from prc_cli.streams.beams import with_beams
from prc_cli.streams.down import guess_down
from tests.methods.fused.street_lines import BEAM, street_lines


def off_deg(found: float, true: float = 0.0) -> float:
    """Return how far a direction is off [deg]."""
    return abs(math.degrees(math.remainder(found - true, 2 * math.pi)))


@pytest.mark.parametrize("turned_deg", [0.0, 75.0, 180.0, -120.0])
@pytest.mark.parametrize("way", [1, -1])
def test_a_street_tells_where_down_is(turned_deg: float, way: int) -> None:
    ranges, _ = street_lines(20)
    found = guess_down(way * BEAM + np.deg2rad(turned_deg), ranges)
    assert found is not None
    assert found.is_sure
    assert off_deg(found.down_rad, math.radians(turned_deg)) < 1.5


AROUND = np.deg2rad(np.arange(-180.0, 180.0, 0.5))


def road(n_lines: int, van: slice, dead_deg: float, *, house_m: float = 9.0) -> F32:
    """Lines of a road between a house and the open sky, with a van beside it for some lines; nothing seen below."""
    rng = np.random.default_rng(1)
    down, aside = np.cos(AROUND), np.sin(AROUND)
    lines = np.full((n_lines, len(AROUND)), 100.0)
    lines[:, down > 0] = (2.0 / np.maximum(down, 1e-3))[down > 0]
    top = np.where(aside > 0, house_m / np.maximum(aside, 1e-3), np.inf)
    lines = np.minimum(lines, np.where(-top * down < 8.0, top, np.inf))
    flank = np.where(aside < 0, 1.8 / np.maximum(-aside, 1e-3), np.inf)
    lines[van] = np.minimum(lines[van], np.where(-flank * down < 2.4, flank, np.inf))
    lines += rng.normal(0.0, 0.005, lines.shape)
    lines[(lines > 60.0) | (np.abs(AROUND) < np.deg2rad(dead_deg / 2))] = np.nan
    found: F32 = lines.astype(np.float32)
    return found


def test_a_van_beside_a_scanner_that_does_not_see_below_is_not_the_ground() -> None:
    beside = guess_down(AROUND, road(64, slice(None), 70.0))
    assert beside is None or not beside.is_sure or off_deg(beside.down_rad) < 5
    passed = guess_down(AROUND, road(640, slice(0, 250), 70.0))
    assert passed is not None
    assert passed.is_sure
    assert off_deg(passed.down_rad) < 2
    assert passed.depth_m == pytest.approx(2.0, abs=0.05)


def test_two_planes_that_are_as_good_are_no_guess() -> None:
    """A corner: nothing tells the ground from the wall."""
    seen = np.deg2rad(np.arange(-60.0, 150.0, 0.5))
    corner = np.minimum(4.0 / np.maximum(np.cos(seen), 1e-3), 4.0 / np.maximum(np.sin(seen), 1e-3))
    found = guess_down(seen, np.tile(corner, (20, 1)).astype(np.float32))
    assert found is not None
    assert not found.is_sure
    assert found.rival_rad is not None
    assert sorted(round(math.degrees(one)) for one in (found.down_rad, found.rival_rad)) == [0, 90]
    block = ScanBlock(0, np.tile(corner, (20, 1)).astype(np.float32), angle_rad=seen, is_last=True)
    info = StreamInfo("corner.npz", "array", len(seen), None, 20, angle_rad=seen)
    with pytest.raises(
        InputError, match=r"level ground may be at (0|90) deg of the scan angle or at (0|90)"
    ) as refused:
        with_beams(Lines(info, block), InputConfig())
    assert "--set input.nadir=0" in refused.value.hint
    assert "--set input.nadir=90" in refused.value.hint


def test_what_tells_nothing_gives_nothing() -> None:
    rng = np.random.default_rng(1)
    ranges, _ = street_lines(20)
    assert guess_down(BEAM, ranges[:2]) is None
    assert guess_down(BEAM, np.full_like(ranges, np.nan)) is None
    assert guess_down(BEAM, rng.uniform(1, 60, (1, len(BEAM))).repeat(20, axis=0).astype(np.float32)) is None


@dataclass(frozen=True)
class Lines:
    """A stream of one block."""

    info: StreamInfo
    block: ScanBlock

    def blocks(self) -> Iterator[ScanBlock]:
        yield replace(self.block)


def street() -> Lines:
    ranges, _ = street_lines(20)
    angle = BEAM + 1.0
    info = StreamInfo("street.npz", "array", len(BEAM), None, 20, angle_rad=angle)
    return Lines(info, ScanBlock(0, ranges, angle_rad=angle, is_last=True))


def test_beams_come_from_the_ground_where_nothing_else_tells() -> None:
    directed = with_beams(street(), InputConfig())
    beams = next(iter(directed.blocks())).beam_rad
    assert beams is not None
    assert np.abs(beams - BEAM).max() < np.deg2rad(1.5)
    said = [one for one in directed.info.assumptions if one.key == "input.nadir"]
    assert "level ground" in said[0].why
    assert "guessed from level ground" in said[0].value
    (note,) = directed.info.facts.notes
    assert note.startswith("straight down is taken to be at scan angle 5")


@pytest.mark.parametrize("preset", ["fused", "fused-forest"])
def test_the_refusal_asks_for_what_is_enough(tmp_path: Path, preset: str) -> None:
    np.save(tmp_path / "drive.npy", np.random.default_rng(1).uniform(1, 60, (20, 500)).astype(np.float32))
    with pytest.raises(InputError, match=r"give scan angles \(.*and input\.nadir if known"):
        open_stream(tmp_path / "drive.npy", load_config(preset=preset))


def test_a_guess_is_in_the_record_of_the_run(tmp_path: Path) -> None:
    np.savez(tmp_path / "street.npz", range_m=street_lines(40)[0], angle_deg=np.rad2deg(BEAM) + 20.0)
    loaded = load_config(preset="fused")
    guessed = classify(tmp_path / "street.npz", tmp_path / "labels.npy", loaded)
    (note,) = [one for one in guessed.record.notices if "straight down" in one]
    assert "20." in note or "19." in note
    told = load_config(preset="fused", options={"input": {"nadir": 20.0}})
    exact = classify(tmp_path / "street.npz", tmp_path / "exact.npy", told)
    assert not any("straight down" in one for one in exact.record.notices)


@pytest.mark.parametrize("first", [3, 150, 400])
def test_labels_do_not_depend_on_where_column_0_lies(first: int) -> None:
    """But for shots whose neighbours are at the other end of the line then."""
    side = np.rad2deg(BEAM) > 10
    ranges, beam = street_lines(40)[0][:, side], BEAM[side]
    loaded = load_config(preset="fused")
    labels = classify_ranges(ranges, loaded, beam_rad=beam).labels
    rolled = classify_ranges(np.roll(ranges, first, axis=1), loaded, beam_rad=np.roll(beam, first)).labels
    differ = np.roll(rolled, -first, axis=1) != labels
    assert differ.mean() < 0.01
    far = np.abs(np.arange(len(beam)) - (len(beam) - first)) > 60
    assert not differ[:, far].any()
