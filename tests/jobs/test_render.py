"""Pictures of files: content, legend and scale, and errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from PIL import Image

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.classes import LABEL_COLOURS, ClassCodes, Label
from prc_cli.core.errors import ConfigError, InputError, OutputExistsError
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import U8
from prc_cli.imaging.pictures import NOT_SCORED_COLOUR, TRIGGER_COLOUR, trigger_codes, trigger_picture
from prc_cli.imaging.sheet import Axis
from prc_cli.jobs.classify import classify, label_blocks, open_stream
from prc_cli.jobs.render import RenderOptions, _pages, render
from prc_cli.jobs.render.cloud import _draw_scale
from prc_cli.jobs.render.colours import LABEL_TABLE, Vocabulary
from prc_cli.jobs.render.options import FIGURE_1, choose_steps
from prc_cli.jobs.render.scan import INTERVALS, Part, _choose_layout, _elevations, choose_part, draw_scan, turns
from tests.formats.organised_files import grid_points, ptx_scan, write_text
from tests.simulated import static_arrays
from tests.street import N_LINES, POINTS_PER_LINE, street, write_csv, write_npz, write_raw


@pytest.fixture(scope="module")
def urban() -> LoadedConfig:
    return load_config(preset="urban")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.npz"
    return write_npz(path, street())


@pytest.fixture(scope="module")
def static(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
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


def pixels(path: Path) -> U8:
    with Image.open(path) as image:
        return np.asarray(image)


def has(picture: U8, label: Label) -> bool:
    """Whether a picture holds more of a colour than its key does."""
    return bool(np.count_nonzero((picture == LABEL_COLOURS[label]).all(axis=2)) > 1500)


def labels_of(source: Path, config: LoadedConfig) -> U8:
    return np.concatenate(
        [i.labels for i in label_blocks(open_stream(source, config).blocks(), config.config.classifier)]
    )


def test_the_whole_drive_shows_every_class_where_it_is(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    drawing = draw_scan(drive, urban, RenderOptions(steps=("range", "classes")), tmp_path)
    (strip,) = drawing.strips
    labels = labels_of(drive, urban)
    colours = np.array([LABEL_COLOURS[label] for label in Label], np.uint8)
    assert np.array_equal(strip[1].picture, colours[labels])
    assert drawing.counts == {label.name.lower(): n for label in Label if (n := int((labels == label).sum()))}
    assert drawing.thinned_by == (1, 1)
    shares = {text.split()[0]: text for text, _ in strip[1].key}
    assert not drawing.key
    seen = labels[labels != Label.MISSING]
    assert shares["ground"] == f"ground {100 * (seen == Label.GROUND).mean():.1f} %"
    assert shares["no"].startswith("no return")


@pytest.mark.parametrize("suffix", [".png", ".html"])
def test_a_picture_is_written_whole(drive: Path, urban: LoadedConfig, tmp_path: Path, suffix: str) -> None:
    result = render(drive, tmp_path / f"out{suffix}", urban)
    assert result.files == (tmp_path / f"out{suffix}",)
    assert [path.name for path in tmp_path.iterdir()] == [f"out{suffix}"]
    assert result.lines == (0, N_LINES)
    if suffix == ".png":
        picture = pixels(result.files[0])
        assert result.size == (picture.shape[1], picture.shape[0])
        assert has(picture, Label.GROUND)
    again = render(drive, tmp_path / f"again{suffix}", urban)
    assert again.files[0].read_bytes() == result.files[0].read_bytes()


def test_a_block_is_what_the_whole_run_made_of_it(drive: Path, tmp_path: Path) -> None:
    config = load_config(preset="urban", options={"prc": {"lines_per_block": 40}})
    drawing = draw_scan(drive, config, RenderOptions(block=2), tmp_path)
    assert (drawing.part.first, drawing.part.stop) == (80, 120)
    assert drawing.steps == FIGURE_1
    colours = np.array([LABEL_COLOURS[label] for label in Label], np.uint8)
    classes = drawing.strips[0][-1]
    assert np.array_equal(classes.picture, colours[labels_of(drive, config)[80:120]])
    assert (classes.y.first, classes.y.stop) == (80, 120)  # lines run down, as the paper prints them
    lines = draw_scan(drive, config, RenderOptions(lines=(80, 120), steps=("classes",)), tmp_path)
    assert np.array_equal(lines.strips[0][0].picture, classes.picture)


def test_figure_1_is_the_papers_sequence(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    drawing = draw_scan(drive, urban, RenderOptions(figure1=True), tmp_path)
    assert drawing.steps == (
        *("range", "support", "background", "components", "segments", "surfaces", "segmentation", "classes"),
    )
    assert (drawing.part.first, drawing.part.stop) == (99, N_LINES)
    support, background, components, segments, surfaces, segmentation, classes = (
        panel.picture for panel in drawing.strips[0][1:]
    )
    noise = (classes == LABEL_COLOURS[Label.NOISE]).all(axis=2) | (classes == 255).all(axis=2)
    assert np.array_equal((support == 0).all(axis=2), noise)  # what is not supported is noise or missing
    assert not (background.any(axis=2) & ~support.any(axis=2)).any()
    assert np.array_equal(components.any(axis=2), support.any(axis=2) & ~background.any(axis=2))  # before filling
    assert (segments.any(axis=2) & background.any(axis=2)).any()  # holes are filled
    assert surfaces.any()
    assert np.array_equal(segmentation.any(axis=2), support.any(axis=2))  # H and V together are all of S


def test_critical_thresholds_split_what_is_supported(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    drawing = draw_scan(drive, urban, RenderOptions(block=1, steps=("support", "critical")), tmp_path)
    support, critical = drawing.strips[0]
    assert critical.bar is not None
    never = (critical.picture == LABEL_COLOURS[Label.NOISE]).all(axis=2)
    assert not (never & support.picture.any(axis=2)).any()


def test_long_drives_are_folded_then_thinned_then_put_on_pages(urban: LoadedConfig, tmp_path: Path) -> None:
    source = write_raw(tmp_path / "drive.bin", np.tile(street(), (12, 1)))
    config = load_config(preset="urban", options={"input": {"points_per_line": POINTS_PER_LINE}})
    n = 12 * N_LINES
    folded = draw_scan(source, config, RenderOptions(width=500), tmp_path)
    assert (len(folded.strips), folded.thinned_by, folded.strips_per_page) == (4, (1, 1), 11)
    starts = [strip[0].x.first for strip in folded.strips]
    assert starts == [0, 411, 822, 1233]
    joined = np.concatenate([strip[1].picture for strip in folded.strips], axis=1)
    colours = np.array([LABEL_COLOURS[label] for label in Label], np.uint8)
    labels = labels_of(source, config)
    assert np.array_equal(joined.swapaxes(0, 1), colours[labels])
    thinned = draw_scan(source, config, RenderOptions(width=300, height=700), tmp_path)
    step = thinned.thinned_by[0]
    assert step == -(-n // 300)
    joined = np.concatenate([strip[1].picture for strip in thinned.strips], axis=1)
    assert np.array_equal(joined.swapaxes(0, 1), colours[labels[::step]])
    assert thinned.counts == folded.counts  # all lines are counted, thinned out or not
    result = render(source, tmp_path / "pages.png", config, RenderOptions(width=300, height=700, pages=3))
    assert [path.name for path in result.files] == ["pages.png", "pages_2.png", "pages_3.png"]
    assert all(path.exists() for path in result.files)
    with pytest.raises(OutputExistsError, match=r"pages_2\.png: exists already"):
        (tmp_path / "pages.png").unlink()
        render(source, tmp_path / "pages.png", config, RenderOptions(width=300, height=700, pages=3))
    assert not (tmp_path / "pages.png").exists()


def test_the_picture_does_not_depend_on_the_format(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    text = write_csv(tmp_path / "drive.csv.gz", street())
    chosen = RenderOptions(steps=("range", "classes"))
    pictures = [draw_scan(path, urban, chosen, tmp_path).strips[0] for path in (drive, text)]
    for one, other in zip(*pictures, strict=True):
        assert np.array_equal(one.picture, other.picture)


def test_existing_labels_are_drawn_without_a_classifier(
    drive: Path, urban: LoadedConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    classify(drive, tmp_path / "labels.npy", urban)
    expected = draw_scan(drive, urban, RenderOptions(steps=("range", "classes")), tmp_path)
    monkeypatch.setattr("prc_cli.jobs.render.scan.label_blocks", None)
    drawing = draw_scan(drive, urban, RenderOptions(labels=tmp_path / "labels.npy"), tmp_path)
    for one, other in zip(drawing.strips[0], expected.strips[0], strict=True):
        assert np.array_equal(one.picture, other.picture)
    with pytest.raises(ConfigError, match="found 'support', which a label file does not hold; possible here: range"):
        choose_steps("prc", RenderOptions(labels=tmp_path / "labels.npy", steps=("support",)))


def test_differences_are_counted_and_shown(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    labels = labels_of(drive, urban)
    reference = ClassCodes().lookup()[labels].copy()
    wrong = np.zeros(reference.shape, bool)
    wrong[100:120] = labels[100:120] == Label.GROUND
    reference[wrong] = ClassCodes().building
    np.save(tmp_path / "reference.npy", reference.ravel())
    chosen = RenderOptions(reference=tmp_path / "reference.npy", steps=("classes", "reference", "difference"))
    drawing = draw_scan(drive, urban, chosen, tmp_path)
    assert drawing.n_differing == wrong.sum() > 0
    assert drawing.n_compared == (labels != Label.MISSING).sum()
    difference = drawing.strips[0][2]
    wrong_ground = (difference.picture == LABEL_COLOURS[Label.GROUND]).all(axis=2)
    assert np.array_equal(wrong_ground, wrong)
    assert f"of {drawing.n_compared:,} shots differ" in difference.note


def test_returns_that_are_not_scored_are_not_drawn_as_missing(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
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
        labels=tmp_path / "labels.npy", reference=tmp_path / "codes.npy", mapping=tmp_path / "m.toml",
        steps=("classes", "reference", "difference"),
    )  # fmt: skip
    classes, reference, difference = draw_scan(drive, urban, chosen, tmp_path).strips[0]
    assert (classes.picture == LABEL_COLOURS[Label.BUILDING]).all()
    for panel in (reference, difference):
        marked = (panel.picture == NOT_SCORED_COLOUR).all(axis=2)
        assert marked[:30][seen[:30]].all()
        assert not marked[30:].any()
        assert any(text.startswith("not scored") for text, _ in panel.key)
    assert [text for text, _ in classes.key] == ["building 100.0 %"]
    assert not any("%" in text for text, _ in difference.key if not text.startswith("no return"))


def test_reference_codes_of_others_go_through_a_mapping(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    np.save(tmp_path / "codes.npy", np.full(N_LINES * POINTS_PER_LINE, 1200))
    chosen = RenderOptions(reference=tmp_path / "codes.npy", steps=("reference",))
    with pytest.raises(InputError, match=r"reference codes: found \d+ records with codes .* 1200; add --mapping"):
        draw_scan(drive, urban, chosen, tmp_path)
    mapped = RenderOptions(reference=tmp_path / "codes.npy", steps=("reference", "difference"), mapping="oakland")
    drawing = draw_scan(drive, urban, mapped, tmp_path)
    assert (drawing.strips[0][0].picture == LABEL_COLOURS[Label.GROUND]).all()


def test_static_scans_stand_upright(static: tuple[Path, Path], tmp_path: Path) -> None:
    source, reference = static
    drawing = draw_scan(source, load_config(preset="street-scan"), RenderOptions(reference=reference), tmp_path)
    assert drawing.steps == ("range", "coarse", "ground", "classes", "reference", "difference")
    ranges = drawing.strips[0][0]
    assert ranges.y.name == "elevation [°]"
    assert ranges.y.first > 60
    assert ranges.y.stop < -40
    missing = (ranges.picture == 255).all(axis=2)
    n = len(missing)
    assert missing[: n // 4].mean() > 0.5 > missing[-n // 4 :].mean()  # the sky is at the top
    assert ranges.x.first > ranges.x.stop  # lines turn to the left, so the first one stands on the right


def test_triggers_and_intervals_are_drawn(static: tuple[Path, Path], tmp_path: Path) -> None:
    steps = ("triggers", "dividers", "tests", "classes")
    drawing = draw_scan(static[0], load_config(preset="street-scan"), RenderOptions(steps=steps), tmp_path)
    triggers, dividers, tests, classes = (panel.picture for panel in drawing.strips[0])
    assert (triggers == TRIGGER_COLOUR).all(axis=2).any()
    car = (classes == LABEL_COLOURS[Label.CAR]).all(axis=2)
    assert car.any()
    assert np.array_equal((tests == LABEL_COLOURS[Label.CAR]).all(axis=2), car)
    inside = (dividers == INTERVALS.colours[2]).all(axis=2) | (dividers == INTERVALS.colours[3]).all(axis=2)
    assert inside[car].all()
    assert "trigger" in [name for name, _ in drawing.strips[0][0].key]
    assert any(name.startswith("in no interval") for name, _ in drawing.strips[0][1].key)


def test_triggers_survive_thinning() -> None:
    side = np.repeat(np.array([[1] * 50 + [2] + [3] * 49], np.uint8), 3, axis=0)
    whole = trigger_codes(np.full(side.shape, Label.HORIZONTAL, np.uint8), side)
    for step in (1, 3, 7):
        picture = trigger_picture(np.ascontiguousarray(whole[:, ::step]))
        marked = np.flatnonzero((picture[0] == TRIGGER_COLOUR).all(axis=1))
        assert marked.min() <= 50 / step <= marked.max()
        assert len(marked) <= 6
    none = trigger_picture(trigger_codes(np.full((2, 9), Label.HORIZONTAL, np.uint8), np.zeros((2, 9), np.uint8)))
    assert not (none == TRIGGER_COLOUR).all(axis=2).any()


def test_long_push_broom_drives_are_folded_upright(urban: LoadedConfig, tmp_path: Path) -> None:
    zenith = np.linspace(170.0, 60.0, 90)
    n = 1500
    ranges = np.where(zenith > 95, 2.0 / np.maximum(-np.cos(np.deg2rad(zenith)), 0.05), np.nan)
    np.savez(tmp_path / "drive.npz", range_m=np.tile(ranges, (n, 1)).astype(np.float32), zenith_deg=zenith)
    drawing = draw_scan(tmp_path / "drive.npz", urban, RenderOptions(width=400, steps=("range",)), tmp_path)
    assert [strip[0].x.first for strip in drawing.strips] == [0, 375, 750, 1125]
    for (panel,) in drawing.strips:
        assert panel.y.name == "elevation [°]"
        assert (panel.picture[0] == 255).all()  # sky
        assert not (panel.picture[-1] == 255).all()


def test_prc_draws_static_scans_upright_too(static: tuple[Path, Path], urban: LoadedConfig, tmp_path: Path) -> None:
    drawing = draw_scan(static[0], urban, RenderOptions(), tmp_path)
    assert drawing.strips[0][0].y.name == "elevation [°]"


def test_the_sense_of_rotation() -> None:
    azimuth = np.deg2rad(np.arange(0, 360, 5.0))[:, None] * np.ones((1, 4))
    for sign in (1, -1):
        xyz = np.stack([np.cos(sign * azimuth), np.sin(sign * azimuth), np.zeros_like(azimuth)], axis=2)
        block = ScanBlock(0, np.ones(azimuth.shape, np.float32), xyz_m=xyz.astype(np.float32))
        assert turns(block) == pytest.approx(sign * np.deg2rad(5.0), abs=1e-5)
    still = np.tile(xyz[:1], (9, 1, 1)).astype(np.float32)
    assert turns(ScanBlock(0, np.ones((9, 4), np.float32), xyz_m=still)) == 0
    assert turns(ScanBlock(0, np.ones((9, 4), np.float32))) == 0


@pytest.mark.parametrize(
    ("method", "options", "expected"),
    [
        ("prc", {"steps": ("coarse",)}, "--steps: found 'coarse', which is no step of prc; possible here: range, int"),
        ("sequential-angle", {"steps": ("support",)}, "'support', which is no step of sequential-angle; possible here"),
        ("prc", {"steps": ("supprot",)}, "found 'supprot', which is no step; possible here: range, intensity, support"),
        ("prc", {"steps": ("difference",)}, "'difference' needs a reference, expected --reference FILE"),
        ("prc", {"steps": ()}, "--steps: found none, expected at least one"),
    ],
)
def test_unknown_steps(method: str, options: dict[str, tuple[str, ...]], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        choose_steps(method, RenderOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"block": 2}, "--block: found 2, expected 0 to 1: 137 lines in blocks of 99"),
        ({"block": -1}, "--block: found -1, expected 0 to 1"),
        ({"lines": (137, 140)}, "--only-lines: found 137:140, expected A:B within 0:137 and A below B"),
        ({"lines": (9, 9)}, "--only-lines: found 9:9"),
    ],
)
def test_parts_that_are_not_there(drive: Path, options: dict[str, object], expected: str, urban: LoadedConfig) -> None:
    with pytest.raises(ConfigError, match=expected):
        choose_part(RenderOptions(**options), urban, open_stream(drive, urban))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("preset", "options", "expected"),
    [
        ("urban", {"block": 0, "lines": (0, 5)}, "--block: given together with --only-lines"),
        ("street-scan", {"block": 0}, "--block: the sequential-angle method has no blocks; give --only-lines A:B"),
        (
            "street-scan",
            {"figure1": True},
            "--figure1: belongs to prc, found the method sequential-angle; add --method prc",
        ),
        ("urban", {"station": 4}, r"--station: found 4, but .*drive\.npz holds one, number 0"),
        ("urban", {"steps": ("intensity",)}, "--steps: found 'intensity', but the input has none"),
        ("urban", {"view": "top", "block": 0}, "--block: belongs to the scan view, found --view top"),
    ],
)
def test_options_that_contradict(
    drive: Path, tmp_path: Path, preset: str, options: dict[str, object], expected: str
) -> None:  # fmt: skip
    with pytest.raises(ConfigError, match=expected):
        render(drive, tmp_path / "a.png", load_config(preset=preset), RenderOptions(**options))  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("n", [N_LINES * POINTS_PER_LINE - 1, N_LINES * POINTS_PER_LINE + 1, 5])
@pytest.mark.parametrize("side", ["labels", "reference"])
@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_labels_of_another_length(urban: LoadedConfig, tmp_path: Path, n: int, side: str, suffix: str) -> None:
    source = tmp_path / f"drive.{suffix}"
    (write_npz if suffix == "npz" else write_csv)(source, street())
    np.save(tmp_path / "labels.npy", np.full(n, 2, np.uint8))
    chosen = RenderOptions(**{side: tmp_path / "labels.npy"})  # type: ignore[arg-type]
    with pytest.raises(InputError, match=rf"labels\.npy: found {n:,} labels, .*; give the labels of this very file"):
        render(source, tmp_path / "a.png", urban, chosen)
    assert not (tmp_path / "a.png").exists()


def test_outputs_that_are_none(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"a\.pdf: found the suffix '\.pdf', expected one of: \.png \.html"):
        render(drive, tmp_path / "a.pdf", urban)
    (tmp_path / "a.png").write_bytes(b"old")
    with pytest.raises(OutputExistsError, match="exists already"):
        render(drive, tmp_path / "a.png", urban)
    assert (tmp_path / "a.png").read_bytes() == b"old"
    with pytest.raises(InputError, match="no such file"):
        render(tmp_path / "none.laz", tmp_path / "b.png", urban)


@pytest.mark.parametrize("view", ["top", "perspective"])
@pytest.mark.parametrize("colour", [None, "class", "height", "range"])
def test_clouds_of_static_scans(static: tuple[Path, Path], tmp_path: Path, view: str, colour: str | None) -> None:
    chosen = RenderOptions(view=view, colour=colour, width=600, height=600)  # type: ignore[arg-type]
    result = render(static[0], tmp_path / "a.png", load_config(preset="street-scan"), chosen)
    picture = pixels(tmp_path / "a.png")
    assert max(picture.shape) <= 1100
    assert result.n_points > 3000
    assert ("by class" in result.drawn) == (colour in (None, "class"))
    if view == "top":
        assert has(picture, Label.GROUND) == (colour in (None, "class"))


def write_cloud(path: Path, codes: U8) -> Path:
    """Write a registered cloud: a plain of 20 x 10 m with a block on it."""
    rng = np.random.default_rng(1)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.offsets, las.header.scales = [650_000.0, 6_860_000.0, 0.0], [0.001] * 3
    n = len(codes)
    las.x, las.y = 650_300 + rng.uniform(0, 20, n), 6_860_200 + rng.uniform(0, 10, n)
    las.z = np.where(las.x > 650_310, 5.0, 0.0)
    las.classification, las.intensity = codes, rng.integers(0, 1000, n)
    las.write(path)
    return path


def test_registered_clouds_show_the_classes_they_hold(urban: LoadedConfig, tmp_path: Path) -> None:
    codes = np.full(20_000, 2, np.uint8)
    codes[:50] = 3  # low vegetation: a code of ASPRS that the program itself does not write
    source = write_cloud(tmp_path / "cloud.laz", codes)
    result = render(source, tmp_path / "a.png", urban, RenderOptions(view="top", width=400, height=400))
    assert result.counts == {"ground": 19_950, "vegetation": 50}
    assert has(pixels(tmp_path / "a.png"), Label.GROUND)
    by = render(source, tmp_path / "b.png", urban, RenderOptions(view="top", colour="intensity"))
    assert by.counts is None
    with pytest.raises(InputError, match="the points have no range to be coloured by; choose another --colour"):
        render(source, tmp_path / "c.png", urban, RenderOptions(view="top", colour="range"))


def test_clouds_that_nobody_classified_show_heights(urban: LoadedConfig, tmp_path: Path) -> None:
    source = write_cloud(tmp_path / "cloud.las", np.ones(5_000, np.uint8))
    result = render(source, tmp_path / "a.png", urban, RenderOptions(view="perspective", width=400))
    assert "by height" in result.drawn
    np.save(tmp_path / "labels.npy", np.full(5_000, 5, np.uint8))
    chosen = RenderOptions(view="top", labels=tmp_path / "labels.npy")
    assert render(source, tmp_path / "b.png", urban, chosen).counts == {"vegetation": 5_000}
    np.save(tmp_path / "reference.npy", np.full(5_000, 1200))
    chosen = RenderOptions(view="top", reference=tmp_path / "reference.npy", mapping="oakland")
    assert render(source, tmp_path / "r.png", urban, chosen).counts == {"ground": 5_000}
    with pytest.raises(ConfigError, match="--reference: given together with --labels"):
        both = RenderOptions(view="top", reference=tmp_path / "reference.npy", labels=tmp_path / "labels.npy")
        render(source, tmp_path / "q.png", urban, both)
    np.save(tmp_path / "short.npy", np.full(4_999, 5, np.uint8))
    with pytest.raises(InputError, match=r"short\.npy: found 4,999 labels, expected 5,000, one a record"):
        render(source, tmp_path / "c.png", urban, RenderOptions(view="top", labels=tmp_path / "short.npy"))


@pytest.mark.parametrize("suffix", ["npz", "csv", "bin"])
def test_no_cloud_without_coordinates(tmp_path: Path, suffix: str) -> None:
    source = tmp_path / f"drive.{suffix}"
    {"npz": write_npz, "csv": write_csv, "bin": write_raw}[suffix](source, street())
    config = load_config(preset="urban", options={"input": {"points_per_line": POINTS_PER_LINE}})
    with pytest.raises(InputError, match="no coordinates for a cloud: .*; draw the scan .leave --view out.") as caught:
        render(source, tmp_path / "a.png", config, RenderOptions(view="top"))
    assert "sensor-xyz" not in str(caught.value)


def test_hairlines_from_above_have_room_beside_them(urban: LoadedConfig, tmp_path: Path) -> None:
    las = laspy.read(write_cloud(tmp_path / "cloud.las", np.full(5_000, 2, np.uint8)))
    las.x = 650_300 + 0.01 * (las.x - 650_300)
    las.write(tmp_path / "hairline.las")
    result = render(tmp_path / "hairline.las", tmp_path / "a.png", urban, RenderOptions(view="top", width=500))
    assert 0.2 < result.size[0] / result.size[1] < 1.0
    assert result.size[1] < 1200


def test_a_cloud_says_how_many_returns_it_leaves_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    azimuth = np.repeat(np.deg2rad(np.arange(0, 360, 1.0)), 2)
    xyz = np.column_stack([8 * np.cos(azimuth), 8 * np.sin(azimuth), np.full(azimuth.shape, -1.0)])
    rings = [xyz + np.array([0, 0, -0.06 * ring]) + rng.normal(0, 1e-5, xyz.shape) for ring in range(64)]
    points = np.column_stack([np.concatenate(rings), np.ones(64 * len(xyz))]).astype("<f4")
    points.tofile(tmp_path / "frame.bin")
    config = load_config(Path(__file__).parents[2] / "sample_configs" / "kitti_frame.toml")
    result = render(
        tmp_path / "frame.bin", tmp_path / "a.png", config, RenderOptions(view="top", colour="range", width=300)
    )
    (note,) = [note for note in result.notes if "not drawn" in note]
    left_out = int(note.split()[0].replace(",", ""))
    outside = sum(int(note.split()[0].replace(",", "")) for note in result.notes if "outside" in note)
    assert left_out > 0
    assert result.n_points + outside + left_out == len(points)


def test_columns_in_no_even_steps_of_elevation_are_counted() -> None:
    beam_rad = np.deg2rad(np.array([0.0, 1.0, 5.0, 6.0, 30.0]))
    order = np.arange(5)
    assert _elevations(beam_rad, order, 5) == Axis("column", 0, 5)
    assert _elevations(beam_rad, order[::-1], 5) == Axis("column", 5, 0)


def test_columns_nearly_in_even_steps_show_their_elevation() -> None:
    """Off by two steps at most, or by a fiftieth of all that is seen."""
    for n, step, limit in ((11, 1.0, 2.0), (1001, 0.05, 1.0)):
        elevation = -40.0 + step * np.arange(n)
        for off, is_even in ((0.95 * limit, True), (1.05 * limit, False)):
            moved = elevation.copy()
            moved[n // 2] += off
            axis = _elevations(np.deg2rad(moved + 90.0), np.arange(n), n)
            if is_even:
                assert axis.name == "elevation [°]"
                assert (axis.first, axis.stop) == pytest.approx((-40.0 - step / 2, -40.0 + (n - 0.5) * step))
            else:
                assert axis == Axis("column", 0, n)
    # from above to below
    axis = _elevations(np.deg2rad(90.0 + np.arange(5.0)), np.arange(5)[::-1], 5)
    assert (axis.first, axis.stop) == pytest.approx((4.5, -0.5))
    assert _elevations(np.deg2rad([90.0, 91.0]), np.arange(2), 2) == Axis("column", 0, 2)
    assert _elevations(np.deg2rad([90.0, 90.0, 90.0]), np.arange(3), 3) == Axis("column", 0, 3)


@pytest.mark.parametrize(("n", "kind"), [(400, "upright"), (401, "strips")])
def test_lines_of_twice_the_width_are_one_panorama(n: int, kind: str) -> None:
    first = ScanBlock(0, np.ones((9, 30), np.float32), beam_rad=np.deg2rad(np.linspace(20, 120, 30)))
    layout = _choose_layout(first, Part(0, n, n), 1, RenderOptions(width=200))
    assert layout.kind == kind
    assert layout.line_step == (2 if kind == "upright" else 1)


def test_a_scale_bar_is_as_long_as_it_says() -> None:
    before = np.full((100, 200, 3), 77, np.uint8)
    picture = before.copy()
    _draw_scale(picture, 50)
    changed = np.flatnonzero((picture != before).any(axis=(1, 2))), np.flatnonzero((picture != before).any(axis=(0, 2)))
    assert [(rows[0], rows[-1] + 1) for rows in changed] == [(56, 80), (20, 90)]
    dark = (picture == 20).all(axis=2)
    assert dark[71].sum() == 50
    assert np.flatnonzero(dark.any(axis=0))[[0, -1]].tolist() == [30, 79]
    # a tick at either end, higher than the bar and within the white box
    assert dark[:, 30].sum() == dark[:, 79].sum() == 18 > dark[:, 50].sum() == 6
    assert np.flatnonzero(dark.any(axis=1))[[0, -1]].tolist() == [62, 79]


@pytest.mark.parametrize(("height", "width", "is_drawn"), [(60, 110, True), (59, 110, False), (60, 109, False)])
def test_a_picture_without_room_has_no_scale_bar(height: int, width: int, is_drawn: bool) -> None:
    picture = np.full((height, width, 3), 77, np.uint8)
    _draw_scale(picture, 50)
    assert (picture != 77).any() == is_drawn


@pytest.mark.parametrize(("n", "end"), [(8, "207"), (9, "207, ...")])
def test_eight_codes_without_a_class_are_named(n: int, end: str) -> None:
    words = Vocabulary(LABEL_TABLE, None, ClassCodes())
    codes = np.repeat(np.arange(200, 200 + n), 3)
    with pytest.raises(
        InputError, match=f"found {3 * n} records with codes that are none of .classes.: 200, 201, "
    ) as said:
        words.turn(codes, "predicted")
    assert said.value.problem.endswith(end)


def test_codes_of_las_that_have_a_counterpart_are_shown_as_it(urban: LoadedConfig, tmp_path: Path) -> None:
    codes = np.repeat(np.array([2, 3, 4, 5, 6, 7, 11, 18], np.uint8), 100)
    result = render(write_cloud(tmp_path / "a.las", codes), tmp_path / "a.png", urban, RenderOptions(view="top"))
    assert result.counts == {"ground": 200, "vegetation": 300, "building": 100, "noise": 200}


def test_labels_of_an_organised_scan_are_one_a_record(urban: LoadedConfig, tmp_path: Path) -> None:
    """The file does not say how many records it has before it is read to its end."""
    source = write_text(tmp_path / "a.ptx", ptx_scan(grid_points(6, 30, missing=0)))
    for n, is_drawn in ((180, True), (179, False), (181, False)):
        np.save(tmp_path / "labels.npy", np.full(n, 2, np.uint8))
        chosen = RenderOptions(labels=tmp_path / "labels.npy")
        if is_drawn:
            assert render(source, tmp_path / "a.png", urban, chosen).counts is not None
        else:
            with pytest.raises(InputError, match=f"found {n} labels, expected 180, one a record"):
                render(source, tmp_path / "b.png", urban, chosen)


def test_a_sheet_of_strips_has_one_key_for_classes_and_differences(urban: LoadedConfig, tmp_path: Path) -> None:
    source = write_raw(tmp_path / "drive.bin", np.tile(street(), (4, 1)))
    config = load_config(preset="urban", options={"input": {"points_per_line": POINTS_PER_LINE}})
    reference = ClassCodes().lookup()[labels_of(source, config)].copy()
    reference[100:120] = np.where(reference[100:120] == ClassCodes().ground, ClassCodes().building, reference[100:120])
    np.save(tmp_path / "reference.npy", reference.ravel())
    chosen = RenderOptions(width=300, reference=tmp_path / "reference.npy", steps=("classes", "difference"))
    drawing = draw_scan(source, config, chosen, tmp_path)
    assert len(drawing.strips) > 1
    names = [name for name, _ in drawing.key]
    assert names[-2:] == ["both agree", "no return"]
    assert {"ground", "building", "noise"} <= set(names)
    assert len(set(names)) == len(names)
    assert [name for name, _ in draw_scan(source, config, replace(chosen, steps=("classes",)), tmp_path).key] != names


def test_headings_of_pages_go_on_to_the_last_line(urban: LoadedConfig, tmp_path: Path) -> None:
    """Where lines are thinned out, the last drawn one stands for fewer than the others."""
    source = write_raw(tmp_path / "drive.bin", np.tile(street(), (12, 1))[:1640])
    config = load_config(preset="urban", options={"input": {"points_per_line": POINTS_PER_LINE}})
    drawing = draw_scan(source, config, RenderOptions(width=300, height=500, pages=2, steps=("range",)), tmp_path)
    assert drawing.thinned_by[0] > 1
    assert 1640 % drawing.thinned_by[0]
    headings = [heading.removeprefix("lines ").replace(",", "").split(" to ") for heading, _ in _pages(drawing)]
    assert len(headings) > 1
    first, last = ([int(words[k]) for words in headings] for k in (0, 1))
    assert (first[0], last[-1]) == (0, 1639)
    assert first[1:] == [line + 1 for line in last[:-1]]


def test_noise_does_not_frame_a_cloud_and_can_be_hidden(urban: LoadedConfig, tmp_path: Path) -> None:
    las = laspy.read(write_cloud(tmp_path / "cloud.las", np.full(20_000, 2, np.uint8)))
    codes = np.array(las.classification)
    codes[::10] = 7
    las.classification = codes
    las.x = np.where(codes == 7, 650_000 + np.arange(20_000) % 997, las.x)
    las.write(tmp_path / "noisy.las")
    source = tmp_path / "noisy.las"
    alone = render(source, tmp_path / "a.png", urban, RenderOptions(view="top", width=400, hide=("noise",)))
    framed = render(source, tmp_path / "b.png", urban, RenderOptions(view="top", width=400))
    assert alone.size[0] == framed.size[0]
    assert alone.counts == framed.counts == {"ground": 18_000, "noise": 2_000}
    assert "18,000 points by class · without noise" in alone.drawn
    assert has(pixels(tmp_path / "a.png"), Label.GROUND)
    black = LABEL_COLOURS[Label.NOISE]
    n_black = [int((pixels(tmp_path / name) == black).all(axis=2).sum()) for name in ("a.png", "b.png")]
    assert n_black[0] < n_black[1]
    by_height = RenderOptions(view="top", width=400, hide=("noise",), colour="height")
    assert "18,000 points by height" in render(source, tmp_path / "c.png", urban, by_height).drawn
    with pytest.raises(ConfigError, match="--hide: found 'rain', expected classes: unclassified, noise, ground"):
        render(source, tmp_path / "d.png", urban, RenderOptions(view="top", hide=("rain",)))


def test_scan_plane_coordinates_lead_to_the_page(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    """Clouds of one height, as other programs and earlier versions write them; those that are built now have three."""
    classify(drive, tmp_path / "out.laz", urban)
    for is_flat in (False, True):
        las = laspy.read(tmp_path / "out.laz")
        las.Z[:] = 0 if is_flat else las.Z
        las.write(tmp_path / "flat.laz")
        picture = tmp_path / f"{is_flat}.png"
        result = render(tmp_path / "flat.laz", picture, urban, RenderOptions(view="top", width=300))
        assert any("--html draws lines one behind the other" in note for note in result.notes) is is_flat


def test_hidden_classes_are_white_in_scan_pictures(drive: Path, urban: LoadedConfig, tmp_path: Path) -> None:
    drawing = draw_scan(drive, urban, RenderOptions(steps=("classes",), hide=("ground",)), tmp_path)
    labels = labels_of(drive, urban)
    (panel,) = drawing.strips[0]
    assert (panel.picture[labels == Label.GROUND] == 255).all()
    assert not any(text.startswith("ground") for text, _ in panel.key)
    assert drawing.counts["ground"] == (labels == Label.GROUND).sum()


def test_a_headline_names_file_preset_lines_and_day(
    drive: Path, urban: LoadedConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    result = render(drive, tmp_path / "a.png", urban)
    assert result.drawn == f"drive.npz · preset urban · all {N_LINES} lines · 2023-11-14"
    classify(drive, tmp_path / "labels.npy", urban)
    shown = render(drive, tmp_path / "b.png", urban, RenderOptions(labels=tmp_path / "labels.npy", hide=("noise",)))
    assert shown.drawn == f"drive.npz · labels of labels.npy, prc · all {N_LINES} lines · without noise · 2023-11-14"
    (tmp_path / "labels.npy.prc.json").write_text("{", encoding="utf-8")
    again = render(drive, tmp_path / "c.png", urban, RenderOptions(labels=tmp_path / "labels.npy"))
    assert "labels of labels.npy · all" in again.drawn
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(ConfigError, match="SOURCE_DATE_EPOCH: found 'yesterday', expected whole seconds since 1970"):
        render(drive, tmp_path / "d.png", urban)
