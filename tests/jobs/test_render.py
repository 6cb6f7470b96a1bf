"""Pictures of files: content, legend, scale and errors.

Pages: their shots, and that a browser shows them.
"""

from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import InputError
from prc_cli.jobs.classify import classify
from prc_cli.jobs.render import RenderOptions
from prc_cli.jobs.render.colours import RecordClasses
from prc_cli.jobs.render.viewer import render_viewer
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings
from tests.imaging.test_pictures import decoded
from tests.simulated import static_arrays
from tests.street import N_LINES, POINTS_PER_LINE, street, write_npz


@pytest.fixture(scope="module")
def static(tmp_path_factory):
    """A static scan and its reference."""
    folder = tmp_path_factory.mktemp("static")
    block, labels = static_arrays(1.0, 4.0, 1)
    assert block.beam_rad is not None
    assert block.xyz_m is not None
    np.savez(
        folder / "static.npz",
        range_m=block.range_m,
        xyz=block.xyz_m,
        zenith_deg=180.0 - np.rad2deg(block.beam_rad),
    )
    np.save(folder / "reference.npy", ClassCodes().lookup()[labels].ravel())
    return folder / "static.npz", folder / "reference.npy"


def test_cells_without_a_record_have_no_class():
    classes = RecordClasses("labels.npy", np.array([3, 4, 5], np.uint8))
    assert classes.look_up(np.array([[0, -1], [2, 1]])).tolist() == [[3, 0], [5, 4]]
    with pytest.raises(InputError, match="found 3 labels, but the input has record 3"):
        classes.look_up(np.array([3]))


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_classes_and_ranges_of_a_drive(tmp_path):
    source = write_npz(tmp_path / "drive.npz", street())
    config = load_config(preset="prc-2019-urban")
    result = render_viewer(source, tmp_path / "a.html", config)
    about, planes = decoded(read(tmp_path / "a.html"))
    classify(source, tmp_path / "labels.npy", config)
    codes = np.load(tmp_path / "labels.npy").reshape(N_LINES, POINTS_PER_LINE)
    lookup = ClassCodes().lookup()
    assert np.array_equal(lookup[np.nan_to_num(planes["class"]).astype(int)], codes)
    assert np.allclose(
        planes["range"], np.where(codes > 0, street(), np.nan), atol=0.001, equal_nan=True
    )
    assert result.counts is not None
    assert {entry["name"]: entry["place"] for entry in about["classes"]}["ground"] == Label.GROUND
    assert (result.lines, result.thinned_by) == ((0, N_LINES), (1, 1))
    assert "preset prc-2019-urban · all" in result.drawn
    # a result beside its input is shown, not made again
    options = RenderOptions(labels=tmp_path / "labels.npy")
    render_viewer(source, tmp_path / "b.html", config, options)
    assert np.array_equal(
        decoded(read(tmp_path / "b.html"))[1]["class"], planes["class"], equal_nan=True
    )


def test_a_static_scan_is_where_it_was_measured_and_stages_are_shown(static, tmp_path):
    config = load_config(preset="street-scan")
    render_viewer(static[0], tmp_path / "a.html", config, RenderOptions())
    about, planes = decoded(read(tmp_path / "a.html"))
    with np.load(static[0]) as scan:
        seen = np.isfinite(planes["x"])
        assert seen.mean() > 0.3
        for k, axis in enumerate("xyz"):
            assert np.allclose(planes[axis][seen], scan["xyz"][..., k][seen], atol=0.01)
    assert {"surface", "dense_vegetation", "ground_height", "height_above_ground"} <= set(planes)
    assert about["planes"]["surface"]["words"]["3"] == "vertical"
    # the values of a result that was written with its stages
    stages = load_config(preset="street-scan", options={"output": {"stages": True}})
    classify(static[0], tmp_path / "out.csv", stages)
    render_viewer(
        static[0], tmp_path / "b.html", config, RenderOptions(labels=tmp_path / "out.csv")
    )
    again = decoded(read(tmp_path / "b.html"))[1]
    assert np.array_equal(again["class"], planes["class"], equal_nan=True)
    assert np.allclose(
        again["height_above_ground"], planes["height_above_ground"], atol=0.002, equal_nan=True
    )
    assert np.array_equal(again["surface"], planes["surface"], equal_nan=True)


def test_poses_place_the_shots_of_a_leaning_scanner(tmp_path):
    """As the demo draws its drive: planes that lean, drawn upright, would shear the facades."""
    settings = load_settings("street", options={"lines": 8})
    drive, truth, path, codes = (
        tmp_path / name for name in ("a.npz", "a.csv", "path.csv", "codes.npy")
    )
    simulate("street", drive, settings, beside=Beside(trajectory=path, labels=codes))
    simulate("street", truth, settings)
    options = RenderOptions(
        labels=codes, trajectory=path, mount=(0.0, settings.scanner.slant_deg, 0.0)
    )
    render_viewer(drive, tmp_path / "a.html", load_config(preset="fused"), options)
    _, planes = decoded(read(tmp_path / "a.html"))
    assert "no trajectory" not in read(tmp_path / "a.html")
    table = np.loadtxt(
        truth,
        delimiter=",",
        skiprows=1,
        usecols=(5, 6, 7),
        converters=lambda cell: float(cell or "nan"),
    )
    shown = np.stack([planes[axis].ravel() for axis in "xyz"], axis=1)
    apart = shown - table
    apart = apart[np.isfinite(apart).all(axis=1)]
    assert len(apart) > 10_000
    assert np.abs(apart - np.median(apart, axis=0)).max() < 0.05
