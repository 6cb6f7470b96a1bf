"""``prc info --draft``: a layout that writes itself reads its file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.cli import main
from prc_cli.config import load_config
from prc_cli.jobs.draft import draft
from tests.golden.inputs import N_LINES, M, image
from tests.streams.evidence.test_estimates import drive


def run(*words: Any) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    return int(str(left.value.code))


def drafted(path: Path, *options: str) -> dict[str, Any]:
    """The draft, read as TOML; classifying with it must work."""
    target = path.with_name("draft.toml")
    assert run("info", path, "--draft", target, "-q", *options) == 0
    return tomllib.loads(target.read_text(encoding="utf-8"))


def ranges_read(path: Path) -> Any:
    out = path.with_name("again.npz")
    # a short file is doubted: few lines
    assert run(
        "convert", path, out, "-q", "--config", path.with_name("draft.toml"), "--overwrite"
    ) in (0, 4)
    assert run(
        "classify", path, path.with_name("l.npy"), "-q", "--config", path.with_name("draft.toml")
    ) in (0, 4)
    with np.load(out) as arrays:
        return arrays["range_m"]


@pytest.mark.slow
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize(
    "header", [b"", bytes(np.random.default_rng(0).integers(32, 127, 128, np.uint8)), bytes(128)]
)
def test_a_dump_with_a_header(tmp_path: Path, endian: str, header: bytes) -> None:
    """int32 millimetres, uint16 intensity, float64 seconds."""
    order = "<" if endian == "little" else ">"
    shots = np.zeros(
        N_LINES * M, np.dtype([("r", f"{order}i4"), ("i", f"{order}u2"), ("t", f"{order}f8")])
    )
    shots["r"] = np.nan_to_num(image() * 1000).ravel()
    shots["i"] = 300 + 50 * np.sin(np.arange(len(shots)) / 9)
    shots["t"] = 4000 + np.arange(len(shots)) / (50 * M)
    path = tmp_path / "d.bin"
    path.write_bytes(header + shots.tobytes())
    config = drafted(path)
    layout = config["layout"]
    assert (layout["header_bytes"], layout["endian"]) == (len(header), endian)
    assert [(field["name"], field["type"]) for field in layout["fields"]] == [
        ("range", "i4"),
        ("field_4", "u2"),
        ("time", "f8"),
    ]
    assert config["input"]["points_per_line"] == M
    np.testing.assert_allclose(ranges_read(path), image(), atol=1e-3)
    assert run("info", path, "--draft", path.with_name("draft.toml"), "-q") == 2
    assert run("info", path, "--draft", path.with_name("draft.toml"), "-q", "--overwrite") == 0


@pytest.mark.parametrize("n_lines", [24, N_LINES])
def test_a_dump_of_ranges_alone(tmp_path: Path, n_lines: int) -> None:
    path = tmp_path / "d.bin"
    image()[:n_lines].tofile(path)
    config = drafted(path)
    assert [(field["name"], field["type"]) for field in config["layout"]["fields"]] == [
        ("range", "f4")
    ]
    np.testing.assert_array_equal(ranges_read(path), image()[:n_lines])


def test_empty_cells_are_missing_by_themselves(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    cells = ["" if np.isnan(metres) else f"{1000 * metres:.0f}" for metres in image().ravel()]
    path.write_text(
        "".join(f"{cell};{4000 + shot / 4500:.6f}\n" for shot, cell in enumerate(cells))
    )
    assert drafted(path)["layout"]["fields"][0] == {"name": "range", "source": 0, "scale": 0.001}


def test_noise_is_no_dump(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "d.bin"
    path.write_bytes(np.random.default_rng(0).bytes(50_000))
    assert run("info", path, "--draft", tmp_path / "draft.toml") == 1
    assert "found no records of one size in its bytes" in capsys.readouterr().err
    assert not (tmp_path / "draft.toml").exists()


@pytest.mark.data
def test_the_profiler_of_ign(real_data: Path, tmp_path: Path) -> None:
    path = tmp_path / "p.ply"
    path.write_bytes((real_data / "riegl" / "sample_riegl_18_02.ply").read_bytes())
    config = drafted(path)
    assert config["input"] == {
        "lines": "angle-wrap",
        "columns": "angle",
        "range": "dimension:range",
    }
    assert {"name": "angle", "source": "theta", "unit": "rad"} in config["layout"]["fields"]
    ranges_read(path)


@pytest.mark.parametrize("offset_m", [0.0, 650_000.0])
@pytest.mark.parametrize("decimals", [6, 4])
def test_coordinates_and_times_without_names(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    offset_m: float,
    decimals: int,
) -> None:
    """Eastings were drafted as ranges, and the refusal did not name the draft."""
    time_s, _, column = drive(50.0, 300, 60)
    height = 2 + np.sin(column / 30)
    place = 8.0 * time_s
    rows = np.column_stack(
        [place + 3 * np.sin(time_s * 300) + offset_m, place - 9 - height + offset_m, height, time_s]
    )
    path = tmp_path / "tile.txt"
    np.savetxt(path, rows, fmt=f"%.{decimals}f")
    assert run("classify", path, tmp_path / "o.npy") == 1
    assert capsys.readouterr().err.rstrip().endswith("--draft FILE.toml, then --config FILE.toml")
    assert run("info", path, "--draft", tmp_path / "draft.toml", "-q") == 0
    fields = tomllib.loads((tmp_path / "draft.toml").read_text(encoding="utf-8"))["layout"][
        "fields"
    ]
    assert [(field["name"], field["source"]) for field in fields] == [
        ("x", 0),
        ("y", 1),
        ("z", 2),
        ("time", 3),
    ]


def test_a_dump_of_an_odd_number_of_small_numbers_is_drafted(tmp_path: Path) -> None:
    range_mm = np.rint(1000 * (6 + 2 * np.sin(np.arange(6001) % 60 / 9.0))).astype("<u2")
    range_mm.tofile(tmp_path / "a.bin")
    text = draft(tmp_path / "a.bin", tmp_path / "a.toml", load_config())
    assert 'type = "u2"' in text
