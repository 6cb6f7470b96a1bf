"""Beams of scanners, made and real."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from prc_cli.config import load_config
from prc_cli.core.errors import InputError, PrcError
from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.choice import choose
from prc_cli.streams.beams import with_beams
from prc_cli.streams.down import wrap
from prc_cli.streams.evidence.figures import LineSample, Seen
from prc_cli.streams.evidence.geometry import check_angle_step, check_down, check_height
from prc_cli.streams.open import open_input
from prc_cli.streams.stream import Stream
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.streams.beam_lines import (
    GEOMETRIES,
    gone,
    is_strictly_monotone,
    lines,
    pieces,
    stream,
    worst_deg,
)
from tests.streams.record_lists import LINE_HZ, SHOT_HZ, M, open_records, scene

AUTO = InputConfig()


def beams_of(source: ScanStream, config: InputConfig = AUTO) -> F64:
    beams = [block.beam_rad for block in with_beams(source, config).blocks()]
    assert beams[0] is not None
    for beam in beams:
        assert beam is not None
        assert np.array_equal(beam, beams[0])
    return beams[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", GEOMETRIES)
def test_beams_do_not_depend_on_how_the_stream_is_cut(name):
    true = GEOMETRIES[name]
    # leading lines without returns do not count
    block = gone(lines(true, 150, seed=3, tilt_deg=2.0), slice(None), np.r_[0:30, 40:43])
    whole = beams_of(stream(block))
    assert worst_deg(whole, true) < 0.25
    for seed in range(6):
        assert np.array_equal(beams_of(stream(*pieces(block, np.random.default_rng(seed)))), whole)


def test_every_scanner_has_beams_of_its_own_however_late_it_is_met():
    names = ["whole circle", "low to high", "through the zenith"]
    parts = []
    for scanner, name in enumerate(names):
        block = lines(GEOMETRIES[name], 100, seed=scanner)
        parts += [
            replace(part, scanner=scanner) for part in pieces(block, np.random.default_rng(scanner))
        ]
    for source in (stream(*parts), stream(*parts[::2], *parts[1::2])):
        seen = set()
        n_lines = dict.fromkeys(range(3), 0)
        for block in with_beams(source, AUTO).blocks():
            assert block.beam_rad is not None
            assert worst_deg(block.beam_rad, GEOMETRIES[names[block.scanner]]) < 0.25
            seen.add((block.scanner, block.beam_rad.tobytes()))
            n_lines[block.scanner] += block.n_lines
        assert len(seen) == 3
        assert set(n_lines.values()) == {100}


def with_stray_shots(block: ScanBlock, n_lines: int) -> ScanBlock:
    """Return a block behind lines of one shot each."""
    assert block.xyz_m is not None
    range_m = np.full((n_lines, block.points_per_line), np.nan, np.float32)
    xyz_m = np.full((*range_m.shape, 3), np.nan, np.float32)
    range_m[:, 3] = block.range_m[0, 3]
    xyz_m[:, 3] = block.xyz_m[0, 3]
    return replace(
        block,
        range_m=np.concatenate([range_m, block.range_m]),
        xyz_m=np.concatenate([xyz_m, block.xyz_m]),
    )


def test_prc_for_want_of_beams_is_a_doubt_where_lines_have_returns(
    monkeypatch,
):
    block = lines(GEOMETRIES["through the zenith"], missing=0.0)
    source = stream(with_stray_shots(block, 200))
    monkeypatch.setattr("prc_cli.streams.beams.MAX_SAMPLE_CELLS", 70 * block.points_per_line)
    (doubt,) = choose(Stream.of(source), load_config().config)[0].findings
    assert "shots tell nothing" in doubt.found


def registered(with_angle: bool) -> ScanBlock:
    """Coordinates of a map, which are no directions."""
    true = GEOMETRIES["half circle"]
    block = lines(true, noise_m=0.0)
    assert block.xyz_m is not None
    xyz = block.xyz_m + np.array([400.0, 90.0, 250.0], np.float32)
    return replace(block, xyz_m=xyz, angle_rad=true + 1.0 if with_angle else None)


def test_registered_coordinates_are_refused_or_used_for_their_heights():
    with pytest.raises(
        InputError, match=r"xyz is not relative to the scanner: its length is .* m off the range"
    ) as got:
        with_beams(stream(registered(with_angle=False)), AUTO)
    assert "subtract the scanner's position" in got.value.hint
    directed = with_beams(stream(registered(with_angle=True)), AUTO)
    assert directed.info.assumptions[-1].value == f"{np.rad2deg(1.0):.2f} deg"
    assert "heights of xyz" in directed.info.assumptions[-1].why
    for block in directed.blocks():
        assert block.xyz_m is None
        assert block.beam_rad is not None
        assert worst_deg(block.beam_rad, GEOMETRIES["half circle"]) < 0.01
    # where down is known by the angles they are left out too, and told
    directed = with_beams(stream(registered(with_angle=True)), InputConfig(nadir=57.3))
    assert "xyz is not relative to the scanner" in directed.info.assumptions[-1].why
    assert next(iter(directed.blocks())).xyz_m is None
    wrong = registered(with_angle=True)
    assert wrong.angle_rad is not None
    wrong = replace(wrong, angle_rad=np.random.default_rng(0).permutation(wrong.angle_rad))
    with pytest.raises(InputError, match="xyz is not relative to the scanner: .*, and the heights"):
        with_beams(stream(wrong), AUTO)


def test_zenith_angles_and_coordinates_of_arrays(tmp_path):
    true = GEOMETRIES["low to high"]
    block = lines(true, 30)
    assert block.xyz_m is not None
    path = tmp_path / "scan.npz"
    np.savez(path, range_m=block.range_m, zenith_deg=180.0 - np.rad2deg(true))
    info = open_input(Input.of(path), AUTO).info
    assert info.down_rad == np.pi
    (read,) = with_beams(open_input(Input.of(path), AUTO), AUTO).blocks()
    assert read.beam_rad is not None
    assert worst_deg(read.beam_rad, true) < 1e-6
    # coordinates alone: their length is the range
    np.savez(path, xyz=block.xyz_m)
    config = InputConfig(max_range=30.0)
    (read,) = with_beams(open_input(Input.of(path), config), config).blocks()
    expected = np.where(block.range_m > 30, np.nan, block.range_m)
    np.testing.assert_allclose(read.range_m, expected, rtol=1e-6)
    assert read.xyz_m is not None
    assert np.array_equal(np.isnan(read.xyz_m).all(axis=-1), np.isnan(expected))
    assert read.tally.n_beyond == np.count_nonzero(block.range_m > 30)
    assert read.beam_rad is not None
    assert worst_deg(read.beam_rad, true) < 0.3
    np.savez(path, xyz=block.xyz_m, angle_deg=np.arange(len(true)))
    assert open_input(Input.of(path), AUTO).info.down_rad is None
    np.savez(path, xyz=np.zeros((3, 4, 2)))
    with pytest.raises(InputError, match="shape"):
        open_input(Input.of(path), AUTO)


def shown_beams(config: dict[str, Any], records: dict[str, NDArray[Any]]) -> F64:
    directed = with_beams(open_records(records, **config), InputConfig(**config))
    beam = next(iter(directed.blocks())).beam_rad
    assert beam is not None
    said = [
        assumption for assumption in directed.info.assumptions if assumption.key == "input.nadir"
    ]
    assert "found from z" in said[0].why
    assert not directed.info.facts.notes
    return beam


@pytest.mark.parametrize("start_deg", [-180.0, 33.0])
@pytest.mark.parametrize("how", ["dimensions", "order", "fixed", "time", "own angles", "z alone"])
def test_heights_tell_where_down_is_on_the_scale_of_given_angles(start_deg, how):
    """Nothing of the file but its heights says it, and no guess is made."""
    _, records = scene(missing=0.0 if how in ("order", "fixed") else 0.2)
    if how == "fixed":
        records = {name: values[records["scan_line"] != 9] for name, values in records.items()}
    records["z"] = records["z"] + 120.0 + 0.1 * records["scan_line"]
    records["x"] = records["x"] + 5000.0
    config: dict[str, Any] = {"angle_start": start_deg, "angle_step": 360 / M, "points_per_line": M}
    dropped = {
        "dimensions": ["angle", "time"],
        "order": ["angle", "time", "column"],
        "fixed": ["angle", "time", "column", "scan_line"],
        "time": ["angle", "column", "scan_line"],
        "own angles": ["time"],
        "z alone": ["angle", "time", "x", "y"],
    }[how]
    records = {name: values for name, values in records.items() if name not in dropped}
    if how == "time":
        config |= {"lines": f"time:{LINE_HZ}", "columns": f"time:{SHOT_HZ}"}
    expected = np.arange(M) * 2 * np.pi / M
    assert worst_deg(shown_beams(config, records), expected) < 0.1


def hostile(rng: np.random.Generator) -> ScanBlock:
    """Return lines of anything: noise, grids, one plane, tiny or huge, nearly empty, with ranges
    that lie."""
    n = int(rng.integers(1, 90))
    m = int(rng.integers(1, 40))
    xyz = rng.normal(size=(n, m, 3)) * rng.choice([[1.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    xyz = [xyz, np.round(xyz), np.tile(xyz[:1], (n, 1, 1))][int(rng.integers(3))]
    xyz = (xyz * 10.0 ** float(rng.integers(-20, 18))).astype(np.float32)
    xyz[rng.random((n, m)) < rng.choice([0.0, 0.3, 0.9, 0.99])] = np.nan
    range_m = np.linalg.norm(xyz.astype(np.float64), axis=-1).astype(np.float32)
    range_m[~(range_m > 0) | np.isinf(range_m)] = np.nan
    xyz[np.isnan(range_m)] = np.nan
    lie = np.float32(rng.choice([1.0, 1.5], p=[0.8, 0.2]))
    angle_rad = np.sort(rng.uniform(-10, 10, m)) if rng.random() < 0.3 else None
    return ScanBlock(0, range_m * lie, xyz_m=xyz, angle_rad=angle_rad)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_any_lines_have_proper_beams_or_are_refused_in_one_line():
    rng = np.random.default_rng(8)
    n_found = 0
    refusals = []
    for _ in range(400):
        block = hostile(rng)
        config = InputConfig(nadir=float(rng.uniform(-400, 400))) if rng.random() < 0.2 else AUTO
        try:
            (directed,) = with_beams(stream(block), config).blocks()
        except PrcError as refusal:
            refusals.append(str(refusal))
            continue
        beam = directed.beam_rad
        assert beam is not None
        assert beam.shape == (block.points_per_line,)
        assert np.all((beam > -np.pi) & (beam <= np.pi))
        assert is_strictly_monotone(beam)
        n_found += 1
    assert min(n_found, len(refusals)) > 20
    assert not any("\n" in message for message in refusals)


pytestmark = pytest.mark.data


STREET = street_lines(200)[0]


def seen(beam_rad: F64, range_m: F32, **more: float) -> Seen:
    sample = LineSample(range_m.shape[1])
    sample.add(ScanBlock(0, range_m))
    info = StreamInfo("drive.npz", "array", range_m.shape[1], None, None, **more)  # type: ignore[arg-type]
    return Seen(info, 0, sample.windows(), angle_rad=beam_rad, beam_rad=wrap(beam_rad.copy()))


def verdict(finding: Finding | None) -> Verdict | None:
    return None if finding is None else finding.verdict


@pytest.mark.filterwarnings("error")
def test_what_tells_nothing_gives_no_finding():
    rng = np.random.default_rng(2)
    nothing = [
        np.full((20, len(BEAM)), np.nan, np.float32),
        np.empty((0, len(BEAM)), np.float32),
        rng.uniform(0.1, 80.0, (20, len(BEAM))).astype(np.float32),
        np.where(rng.random((20, len(BEAM))) < 0.02, STREET[:20], np.nan).astype(np.float32),
    ]
    for check in (check_down, check_angle_step, check_height):
        for ranges in nothing:
            assert verdict(check(seen(BEAM, ranges))) in (None, Verdict.FINE)
        if check is not check_height:
            assert check(replace(seen(BEAM, STREET), beam_rad=None)) is None
        assert check(replace(seen(BEAM, STREET), windows=())) is None
        # columns of a single beam
        assert check(seen(np.array([0.1]), np.full((9, 1), 2.0, np.float32))) is None
