"""Simulated scans as files: every format gives back stream and reference, for any number of
threads."""

import tracemalloc
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.jobs.classify import open_stream
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import Kind, Settings, load_settings, open_simulation
from tests.runner import runner

SCANNER: dict[str, Any] = {"points_per_line": 240, "line_hz": 20.0}
LINES = 70


def small(kind: Kind, **options: Any) -> Settings:
    """A scan of a few thousand shots; more lines than are simulated together."""
    table: dict[str, Any] = {"seed": 3, "sight_m": 30.0, "lines": LINES, "scanner": SCANNER}
    if kind == "street-scan":
        table["scanner"] = {"points_per_line": 120, "azimuth_step_deg": 360 / LINES}
    return load_settings(kind, options=table | options)


def config(path: Path, preset: str | None = None, **inputs: Any) -> LoadedConfig:
    beside = path.with_name(f"{path.name}.toml") if path.suffix == ".bin" else None
    return load_config(beside, preset, {"input": inputs})


def whole(items: list[LabelledBlock]) -> tuple[ScanBlock, Any]:
    return join([item.block for item in items]), np.concatenate([item.labels for item in items])


def read(path: Path, **inputs: Any) -> ScanBlock:
    return join(list(open_stream(path, config(path, **inputs)).blocks()))


def same(left: Any, right: Any) -> bool:
    return np.array_equal(left, right, equal_nan=True)


@pytest.fixture(scope="module")
def drive():
    return whole(list(open_simulation("street", small("street"), threads=1).scan.labelled_blocks()))


@pytest.mark.parametrize("lines", [1, 7, 64, 1000])
def test_neither_blocks_nor_threads_change_anything(drive, lines):
    scan = open_simulation("street", small("street"), threads=2).scan
    items = list(scan.labelled_blocks(lines))
    assert max(item.block.n_lines for item in items) == min(lines, 64)
    block, labels = whole(items)
    assert same(labels, drive[1])
    for name in ("range_m", "time_s", "intensity"):
        assert same(getattr(block, name), getattr(drive[0], name))
    assert [item.block.is_last for item in items] == [False] * (len(items) - 1) + [True]
    with pytest.raises(ConfigError, match="found 0, expected at least 1 line"):
        next(scan.blocks(0))


@pytest.mark.parametrize(
    "crs, said",
    [("EPSG:4326", "is not a projected one in metres"), ("EPSG:99999", "cannot be used")],
)
@pytest.mark.parametrize("track", [None, "drive.sbet", "drive.csv"])
def test_a_frame_that_is_none_is_refused_by_the_name_of_its_file(
    tmp_path,
    track,
    crs,
    said,
):
    pytest.importorskip("pyproj")
    beside = Beside(trajectory=tmp_path / track if track else None)
    with pytest.raises(ConfigError, match=said) as error:
        simulate(
            "street", tmp_path / "drive.laz", small("street", frame={"crs": crs}), beside=beside
        )
    assert error.value.where == str(tmp_path / (track or "drive.laz"))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(tmp_path):
    def peak(lines: int) -> int:
        settings = small("street", lines=lines, trajectory={"stop_every_m": 0.0, "speed_m_s": 1.0})
        tracemalloc.start()
        simulate("street", tmp_path / "a.npz", settings, threads=1, overwrite=True)
        peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak_bytes

    peak(LINES)
    assert peak(12 * LINES) < 1.5 * peak(4 * LINES)


@pytest.mark.parametrize(
    "kind, options, said",
    [
        (
            "street",
            {"scanner": {"name": "photon"}},
            "scanner.name: found 'photon', expected one of: photon-80",
        ),
        (
            "street",
            {"scanner": {"slant": 3}},
            "unknown key 'scanner.slant'; did you mean 'scanner.slant_deg'",
        ),
        (
            "street",
            {"scanner": {"name": "scanstation2"}},
            "the scanner is static, expected one for a street",
        ),
        (
            "street-scan",
            {"scanner": {"name": "photon-80"}},
            "none for a tripod.*choose from: scanstation2",
        ),
        ("street-scan", {"trajectory": {}}, "unknown key 'trajectory'"),
        ("forest", {"scene": {"stems_per_ha": -1}}, "scene.stems_per_ha: found -1, expected: "),
        ("street", {"scene": 3}, "scene: found 3, expected: a table"),
        ("meadow", {}, "found 'meadow', expected one of: street, forest, street-scan"),
    ],
)
def test_wrong_parameters_are_named(kind, options, said):
    with pytest.raises(ConfigError, match=said):
        load_settings(kind, options=options)


@pytest.mark.parametrize(
    "kind, output, beside, said",
    [
        ("street", "a.npz", {"labels": "a.csv"}, "found suffix '.csv', expected .npy"),
        (
            "street",
            "a.npz",
            {"trajectory": "w.txt"},
            r"w.txt: found suffix '.txt', expected .csv or .sbet or .out",
        ),
        (
            "forest",
            "a.npz",
            {"trajectory": "w"},
            r"w: found suffix '', expected .csv or .sbet or .out",
        ),
        (
            "forest",
            "a.npz",
            {"stems": "stems.txt"},
            r"stems.txt: found suffix '.txt', expected .csv; write the stems",
        ),
        ("street", "a.npz", {"stems": "a.csv"}, "asked for in a street, which has none"),
        ("street-scan", "a.npz", {"trajectory": "a.csv"}, "asked for of a tripod"),
        ("street", "a.csv", {"trajectory": "a.csv"}, "two of the files .* have one name"),
        ("street", "a.xyz", {}, "found suffix '.xyz'"),
    ],
)
def test_what_cannot_be_written_is_refused_first(
    tmp_path,
    kind,
    output,
    beside,
    said,
):
    names = Beside(**{key: tmp_path / name for key, name in beside.items()})
    with pytest.raises(ConfigError, match=said):
        simulate(kind, tmp_path / output, small(kind), beside=names)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("crs", ["", "EPSG:32635"])
def test_a_simulated_cloud_carries_the_coordinate_system_that_it_announces(tmp_path, crs):
    words = ["simulate", "street", str(tmp_path / "drive.laz"), "--lines", "2"]
    result = runner().invoke(cli, [*words, *(["--set", f"frame.crs={crs}"] if crs else [])])
    assert result.exit_code == 0
    assert ("coordinates are those of" in result.stderr) == bool(crs)
    with laspy.open(tmp_path / "drive.laz") as file:
        header_crs = file.header.parse_crs()
        # the flag says how a system would be written; point formats 6 to 10 must have it
        assert file.header.global_encoding.wkt
        assert abs(file.header.mins[1] - (6_671_000 if crs else 0)) < 2000
    assert (header_crs.to_epsg() if header_crs else "") == (32635 if crs else "")
