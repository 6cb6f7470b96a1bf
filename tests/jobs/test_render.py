"""Pictures of files: content, legend, scale and errors.

Pages: their shots, and that a browser shows them.
"""

from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.classes import LABEL_COLOURS, ClassCodes, Label
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import U8
from prc_cli.formats.input import Input
from prc_cli.imaging.pictures import NOT_SCORED_COLOUR
from prc_cli.jobs.classify import classify, label_blocks, open_stream
from prc_cli.jobs.render import RenderOptions, render
from prc_cli.jobs.render.colours import RecordClasses
from prc_cli.jobs.render.scan import draw_scan
from prc_cli.jobs.render.viewer import render_viewer
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings
from tests.imaging.test_pictures import decoded
from tests.jobs.test_convert import config, two_scanners
from tests.simulated import static_arrays
from tests.street import N_LINES, POINTS_PER_LINE, street, write_csv, write_npz


@pytest.fixture(scope="module")
def urban():
    return load_config(preset="prc-2019-urban")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.npz"
    return write_npz(path, street())


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


def has(picture: U8, label: Label) -> bool:
    """Whether a picture holds more of a colour than its key does."""
    return bool(np.count_nonzero((picture == LABEL_COLOURS[label]).all(axis=2)) > 1500)


def labels_of(source: Path, config: LoadedConfig) -> U8:
    return np.concatenate(
        [
            i.labels
            for i in label_blocks(open_stream(source, config).blocks(), config.config.classifier)
        ]
    )


def test_returns_that_are_not_scored_are_not_drawn_as_missing(drive, urban, tmp_path):
    labels = labels_of(drive, urban)
    seen = labels != Label.MISSING
    codes = np.full(labels.shape, 1200)  # ground of oakland
    codes[:30] = 1305  # ignored there
    np.save(tmp_path / "codes.npy", codes.ravel())
    (tmp_path / "m.toml").write_text(
        "ignore = [1305]\n[predicted]\nbuilding = [6]\nground = [2]\n[reference]\nground = [1200]\n"
    )
    np.save(tmp_path / "labels.npy", np.full(labels.size, 6))
    chosen = RenderOptions(
        labels=tmp_path / "labels.npy",
        reference=tmp_path / "codes.npy",
        mapping=tmp_path / "m.toml",
        steps=("classes", "reference", "difference"),
    )
    classes, reference, difference = draw_scan(Input.of(drive), urban, chosen, tmp_path).panels
    assert (classes.picture == LABEL_COLOURS[Label.BUILDING]).all()
    for panel in (reference, difference):
        marked = (panel.picture == NOT_SCORED_COLOUR).all(axis=2)
        assert marked[:30][seen[:30]].all()
        assert not marked[30:].any()
        assert any(text.startswith("not scored") for text, _ in panel.key)
    assert [text for text, _ in classes.key] == ["building 100.0 %"]
    assert not any("%" in text for text, _ in difference.key if not text.startswith("no return"))


def test_the_headline_names_the_scanner_of_several(tmp_path):
    source = two_scanners(tmp_path / "two.las")
    read = config(preset="prc-2019-urban", scanner="point_source_id")
    for number, station in enumerate((None, 8)):
        picture = render(source, tmp_path / f"{number}.png", read, RenderOptions(station=station))
        assert f"scanner {station or 3} of 2" in picture.drawn, picture.drawn


@pytest.mark.parametrize(
    "preset, options, expected",
    [
        (
            "street-scan",
            {"steps": ("figure1",)},
            "--steps figure1: belongs to prc, .* sequential-angle; add --set method=prc",
        ),
        ("urban", {"station": 4}, r"render.station: found 4, but .*drive\.npz holds one, number 0"),
        ("urban", {"steps": ("intensity",)}, "--steps: found 'intensity', but the input has none"),
        (
            "urban",
            {"steps": ("top",), "lines": (0, 5)},
            "--only: belongs to lines and columns, found --steps top",
        ),
    ],
)
def test_options_that_contradict(
    drive,
    tmp_path,
    preset,
    options,
    expected,
):
    with pytest.raises(ConfigError, match=expected):
        render(drive, tmp_path / "a.png", load_config(preset=preset), RenderOptions(**options))  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("n", [N_LINES * POINTS_PER_LINE - 1, N_LINES * POINTS_PER_LINE + 1, 5])
@pytest.mark.parametrize("side", ["labels", "reference"])
@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_labels_of_another_length(
    urban,
    tmp_path,
    n,
    side,
    suffix,
):
    source = tmp_path / f"drive.{suffix}"
    (write_npz if suffix == "npz" else write_csv)(source, street())
    np.save(tmp_path / "labels.npy", np.full(n, 2, np.uint8))
    chosen = RenderOptions(**{side: tmp_path / "labels.npy"})  # type: ignore[arg-type]
    with pytest.raises(
        InputError, match=rf"labels\.npy: found {n:,} labels, .*; give the labels of this very file"
    ):
        render(source, tmp_path / "a.png", urban, chosen)
    assert not (tmp_path / "a.png").exists()


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
    few = render_viewer(source, tmp_path / "few.html", config, RenderOptions(shots=5000))
    assert few.thinned_by != (1, 1)
    assert "1 line of " in few.drawn
    assert any("--only A:B shows a part" in note for note in few.notes)
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
