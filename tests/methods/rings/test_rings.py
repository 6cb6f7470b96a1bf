"""The method for rings on a made scene.

Ground, a wall, a hedge, a car and a pole around a scanner of 32 rings.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
from pyarrow import csv, feather

from prc_cli import classify_ranges, load_config
from prc_cli.core.classes import LABELS_BY_REASON, Label, Reason
from prc_cli.core.frame import SensorFrame, turning
from prc_cli.core.stream import ExtraReturns, ScanBlock
from prc_cli.core.types import F32, F64, U8, Mask
from prc_cli.jobs.choice import choice_by_beams
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.plane import MANY_RINGS
from prc_cli.methods.rings.pipeline import RingsParams, is_fan, limits_of, upside_down
from prc_cli.methods.rings.thresholds import FEW, MANY
from tests.cli.conftest import Prc

N_LINES = 1800
N_RINGS = 32
HEIGHT_M = 1.8
ELEVATION = np.deg2rad(np.linspace(-25.0, 10.0, N_RINGS))
BEAM: F64 = np.pi / 2 + ELEVATION
AZIMUTH: F64 = 2 * np.pi * np.arange(N_LINES) / N_LINES
PARAMS = RingsParams()


class Scene(NamedTuple):
    """Shots of one turn."""

    ranges: F32
    """(lines, rings) float32 [m]."""
    xyz: F32
    """(lines, rings, 3) float32 [m]."""
    body: U8
    """(lines, rings) uint8: 1 ground, 2 wall, 3 hedge, 4 car, 5 pole, 6 ceiling."""


def scene(seed: int = 1, mount: F64 | None = None, ceiling_m: float = np.inf) -> Scene:
    random = np.random.default_rng(seed)
    directions = np.stack(
        [
            np.cos(ELEVATION) * np.cos(AZIMUTH)[:, None],
            np.cos(ELEVATION) * np.sin(AZIMUTH)[:, None],
            np.sin(ELEVATION) + 0 * AZIMUTH[:, None],
        ],
        axis=-1,
    )
    x, y, z = np.moveaxis(directions if mount is None else directions @ mount.T, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = np.where(z < 0, -HEIGHT_M / z, np.inf)
        body = np.where(ranges < 80, 1, 0).astype(np.uint8)
        for kind, distance in (
            (2, _box(x, y, z, (-30, 30), (12, 13), (0, 7))),
            (3, _box(x, y, z, (-30, 30), (-9, -8), (0, 2.5)) + random.exponential(0.35, x.shape)),
            (4, _box(x, y, z, (5, 9.2), (3, 4.7), (0.2, 0.9))),
            (4, _box(x, y, z, (5.8, 8.2), (3.1, 4.6), (0.9, 1.45))),
            (5, _box(x, y, z, (7.9, 8.1), (-4.1, -3.9), (0, 5))),
            (6, np.where(z > 0, (ceiling_m - HEIGHT_M) / z, np.inf)),
        ):
            nearer = distance < ranges
            body[nearer] = kind
            ranges[nearer] = distance[nearer]
    ranges = np.where(body > 0, ranges + random.normal(0, 0.01, ranges.shape), np.nan)
    xyz = ranges[..., None] * directions
    return Scene(ranges.astype(np.float32), xyz.astype(np.float32), body)


def _box(x: F64, y: F64, z: F64, *sides: tuple[float, float]) -> F64:
    """Distance of an upright box, sides in metres, heights above the ground."""
    near = np.full(x.shape, 0.0)
    far = np.full(x.shape, np.inf)
    for way, (low, high) in zip(
        (x, y, z), (*sides[:2], tuple(h - HEIGHT_M for h in sides[2])), strict=True
    ):
        to_low = low / way
        to_high = high / way
        near = np.maximum(near, np.minimum(to_low, to_high))
        far = np.minimum(far, np.maximum(to_low, to_high))
    return np.where(near < far, near, np.inf)


def labelled(
    ranges: F32,
    xyz: F32,
    *,
    chunk: int = 300,
    threads: int = 1,
    beam: F64 = BEAM,
    params: RingsParams = PARAMS,
    **changes: Any,
) -> U8:
    blocks = (
        ScanBlock(
            a,
            ranges[a : a + chunk],
            xyz_m=xyz[a : a + chunk],
            beam_rad=beam,
            is_last=a + chunk >= len(ranges),
            **changes,
        )
        for a in range(0, len(ranges), chunk)
    )
    return np.concatenate([item.labels for item in label_blocks(blocks, params, threads=threads)])


@pytest.fixture(scope="module")
def made():
    return scene()


@pytest.fixture(scope="module")
def labels(made):
    return labelled(*made[:2])


@pytest.mark.parametrize(
    "body, label, recall, precision",
    [
        (1, Label.GROUND, 0.97, 0.97),
        (2, Label.BUILDING, 0.95, 0.9),
        (3, Label.VEGETATION, 0.85, 0.9),
        (4, Label.CAR, 0.85, 0.95),
        (5, Label.POLE, 0.85, 0.9),
    ],
)
def test_bodies_have_their_class(
    made,
    labels,
    body,
    label,
    recall,
    precision,
):
    true = made[2] == body
    is_label = labels == label
    assert (true & is_label).sum() / true.sum() > recall
    assert (true & is_label).sum() / is_label.sum() > precision
    assert ((labels == Label.MISSING) == (made[2] == 0)).all()


@pytest.mark.parametrize("chunk, threads", [(1, 1), (7, 3), (1024, 2), (1800, 3)])
def test_labels_depend_neither_on_chunks_nor_on_threads(
    made,
    labels,
    chunk,
    threads,
):
    np.testing.assert_array_equal(labelled(*made[:2], chunk=chunk, threads=threads), labels)


def test_a_scanner_may_hang_upside_down(made, labels):
    """Its lowest ring is the highest then; what is written of its beams says where down is."""
    ranges, xyz, _ = made
    turned = xyz * np.array([1, -1, -1], np.float32)
    turned_labels = labelled(ranges, turned, beam=upside_down(BEAM))
    assert (turned_labels == labels).mean() > 0.999


@pytest.mark.parametrize("lean", [(0.0, 30.0), (-45.0, 0.0), (20.0, 25.0)])
def test_a_scanner_may_lean(lean):
    """The ground is level after it was turned; what stands on it is upright there."""
    mount = turning(np.deg2rad([*lean, 0.0]))
    ranges, xyz, body = scene(mount=mount)
    leaning_labels = labelled(ranges, xyz)
    for kind, label in ((1, Label.GROUND), (2, Label.BUILDING)):
        seen = body == kind
        assert not seen.any() or (leaning_labels[seen] == label).mean() > 0.9


def test_shots_are_labelled_in_the_frame_of_the_scanner(made, labels):
    frame = SensorFrame(tuple(map(tuple, turning(np.deg2rad([5.0, -8.0, 0.0])))), (0.8, -0.3, 1.7))  # type: ignore[arg-type]
    elsewhere = (made[1].astype(np.float64) @ np.array(frame.turn) + frame.apex_m).astype(
        np.float32
    )
    ranges = np.sqrt((elsewhere**2).sum(axis=2))
    assert (labelled(ranges, elsewhere, frame=frame) == labels).mean() > 0.999
    assert (labelled(ranges, elsewhere) == labels).mean() < 0.985


def test_z_is_up_where_a_floor_and_a_ceiling_are_level():
    ranges, xyz, body = scene(ceiling_m=2.4)
    down = labelled(ranges, xyz, params=RingsParams(up="-z"))
    for params in (PARAMS, RingsParams(up="z")):
        image = labelled(ranges, xyz, params=params)
        assert (image[body == 1] == Label.GROUND).mean() > 0.9
        assert (image[body == 6] == Label.GROUND).mean() < 0.1
    assert (down[body == 6] == Label.GROUND).mean() > 0.8


def test_a_short_block_takes_the_ground_of_those_before(made, labels):
    ranges, xyz = (np.concatenate([array, array[:12]]) for array in made[:2])
    image = labelled(ranges[: 1024 + 12], xyz[: 1024 + 12])
    np.testing.assert_array_equal(image[:1024], labels[:1024])
    assert (image[1024:] == Label.GROUND).mean() > 0.3


def snowy(made: Scene) -> tuple[F32, F32, F32, Mask]:
    """Put flakes before things; they are brighter."""
    ranges, xyz, body = made
    random = np.random.default_rng(3)
    flake = (random.random(ranges.shape) < 0.02) & (body > 0)
    near = np.minimum(
        random.exponential(4.0, ranges.shape) + 1.0, 0.7 * np.nan_to_num(ranges, nan=1.0)
    )
    light = (np.where(flake, 60.0, 10.0) * random.normal(1.0, 0.02, ranges.shape)).astype(
        np.float32
    )
    new = np.where(flake, near, ranges).astype(np.float32)
    return new, (xyz * (new / ranges)[..., None]).astype(np.float32), light, flake


@pytest.mark.parametrize("is_lit", [True, False])
def test_snow_is_noise(made, is_lit):
    ranges, xyz, light, flake = snowy(made)
    intensity = light if is_lit else None
    is_noise = labelled(ranges, xyz, chunk=len(ranges), intensity=intensity) == Label.NOISE
    assert (is_noise & flake).sum() / flake.sum() > (0.85 if is_lit else 0.7)
    assert (is_noise & flake).sum() / is_noise.sum() > (0.9 if is_lit else 0.8)


@pytest.mark.parametrize("light", [255.0, 0.0, np.nan, "steps"])
def test_intensities_that_tell_nothing_count_as_none(made, light):
    ranges, xyz, lit, _ = snowy(made)
    equal = (
        np.round(lit / 20) * 20 if light == "steps" else np.full(ranges.shape, light, np.float32)
    )
    none, with_equal = (
        labelled(ranges, xyz, chunk=len(ranges), intensity=intensity) for intensity in (None, equal)
    )
    np.testing.assert_array_equal(with_equal, none)


def test_mirror_images_below_the_ground_are_noise(made):
    ranges, xyz, body = made
    random = np.random.default_rng(4)
    mirrored = (body == 1) & (ranges > 5) & (ranges < 25) & (random.random(ranges.shape) < 0.05)
    factor = np.where(mirrored, random.uniform(1.4, 2.5, ranges.shape), 1.0).astype(np.float32)
    image = labelled(ranges * factor, xyz * factor[..., None])
    assert (image[mirrored] == Label.NOISE).mean() > 0.9
    road = (body == 1) & ~mirrored
    assert (image[road] == Label.GROUND).mean() > 0.95


def test_reasons_measures_and_further_returns(made):
    ranges, xyz, _ = made
    line, column = (np.array([n], np.int32) for n in (100, 3))
    extra = ExtraReturns(line, column, ranges[100, 3:4] + np.float32(0.1), np.array([7]))
    block = ScanBlock(0, ranges[:1024], xyz_m=xyz[:1024], beam_rad=BEAM, is_last=True, extra=extra)
    wanted = Wanted(reasons=True, stages=True, measures=True)
    (item,) = label_blocks(iter([block]), PARAMS, wanted=wanted)
    assert item.reasons is not None
    assert item.above_m is not None
    np.testing.assert_array_equal(LABELS_BY_REASON[item.reasons], item.labels)
    rules = {int(reason) for reason in Reason}
    assert set(np.unique(item.reasons).tolist()) <= rules
    assert item.extra_labels.tolist() == [item.labels[100, 3]]
    assert all(values.shape == ranges[:1024].shape for values in item.measures.values())
    assert np.nanmax(np.abs(item.above_m[item.labels == Label.GROUND])) < 0.5


@pytest.mark.parametrize("shape", [(1, 4), (3, 16), (40, 16)])
@pytest.mark.parametrize("value", [np.nan, 5.0, 300.0])
def test_small_and_dull_images_are_labelled(shape, value):
    beam = np.deg2rad(np.linspace(70, 100, shape[1]))
    classified = classify_ranges(
        np.full(shape, value), load_config(preset="rings"), beam_rad=beam
    ).labels
    assert ((classified == 0) == np.isnan(value)).all()


@pytest.mark.parametrize(
    "first_deg, last_deg, n, expected",
    [
        (65, 92, 64, True),
        (67.5, 112.5, 16, True),
        (64.9, 125.0, 64, False),
        (0, 180, 64, False),
        (-150, 150, 64, False),
        (-20, 20, 64, False),
        (90, 90, 1, False),
    ],
)
def test_narrow_level_beams_are_a_fan(
    first_deg,
    last_deg,
    n,
    expected,
):
    assert is_fan(np.deg2rad(np.linspace(first_deg, last_deg, n))) is expected


def test_rings_are_chosen_without_a_name(made, prc, tmp_path):
    ranges, xyz, _ = made
    np.savez(tmp_path / "scan.npz", range_m=ranges, xyz=xyz, zenith_deg=180.0 - np.rad2deg(BEAM))
    result = prc(f"classify {tmp_path}/scan.npz {tmp_path}/labels.npy")
    assert result.code == 4, result.err
    assert (
        "method: rings (--preset rings): columns are the rings of a spinning scanner" in result.err
    )
    assert "few-rings: 32 rings, expected at least 48" in result.err


@pytest.fixture
def prc(capsys):
    return Prc(capsys)


@pytest.mark.data
def test_a_sweep_of_two_scanners(prc, real_data, tmp_path):
    """One hangs upside down; the file is in the frame of the vehicle."""
    sweep = real_data / "av2" / "315966265259836000.feather"
    table = feather.read_table(sweep)
    csv.write_csv(table, tmp_path / "sweep.csv")
    output = tmp_path / "labels.npy"
    result = prc(f"classify {tmp_path}/sweep.csv {output} --range origin:1.35,0,1.585")
    assert result.code == 0, result.err
    is_ground = np.load(output).ravel() == 2
    ground = feather.read_table(sweep.with_name(f"{sweep.stem}_labels.feather"))[
        "is_ground"
    ].to_numpy()
    laser = table["laser_number"].to_numpy()
    for scanner in (laser < 32, laser >= 32):
        both = (is_ground & ground)[scanner].sum()
        assert both / is_ground[scanner].sum() > 0.95
        assert both / ground[scanner].sum() > 0.9


def test_rows_of_a_static_scan_are_no_rings():
    """They may see as little as rings do, where empty rows were cut off."""
    beam = np.deg2rad(np.linspace(65, 110, 200))
    block = ScanBlock(0, np.full((4, 200), 9.0, np.float32), beam_rad=beam)
    assert choice_by_beams(block, iter([block])).method == "rings"
    assert choice_by_beams(block, iter([block]), may_spin=False).method == "fused"
    assert not is_fan(np.deg2rad(np.linspace(65, 110, 497)))


def test_the_number_of_rings_chooses_the_limits():
    assert limits_of(np.zeros(MANY_RINGS)) is MANY
    assert limits_of(np.zeros(MANY_RINGS - 1)) is FEW
