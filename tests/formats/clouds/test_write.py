"""PLY and PCD out: a drive written and read back, clouds with their classes added."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import main
from prc_cli.core.blocks import join
from prc_cli.formats import open_source
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.formats.cloud_files import pcd, ply

SUFFIXES = ("ply", "pcd")


def run(words: list[str]) -> int:
    """Run a command; return its exit code."""
    with pytest.raises(SystemExit) as left:
        main(words)
    return int(str(left.value.code))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated drive, as an archive of arrays, with its labels."""
    folder = tmp_path_factory.mktemp("drive")
    told = ["simulate", "street", "-o", str(folder / "s.npz"), "--lines", "40", "--scanner", "sick-push-broom", "-q"]
    assert run([*told, "--seed", "5"]) == 0
    assert run(["classify", str(folder / "s.npz"), str(folder / "s.npy"), "--preset", "urban", "-q"]) in (0, 4)
    return folder


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_drive_read_back_has_the_same_labels(drive: Path, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"s.{suffix}"
    assert run(["convert", str(drive / "s.npz"), str(path), "-q"]) == 0
    first, again = (join(list(open_input(one, InputConfig()).blocks())) for one in (drive / "s.npz", path))
    np.testing.assert_array_equal(first.range_m, again.range_m)
    assert run(["classify", str(path), str(tmp_path / "l.npy"), "--preset", "urban", "-q"]) in (0, 4)
    np.testing.assert_array_equal(np.load(tmp_path / "l.npy"), np.load(drive / "s.npy").ravel())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_classes_of_another_format(drive: Path, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"c.{suffix}"
    assert run(["classify", str(drive / "s.npz"), str(path), "--preset", "urban", "-q"]) in (0, 4)
    source = open_source(path)
    assert source is not None
    (chunk,) = source.chunks(("class", "scan_line", "column", "range"))
    labels = np.load(drive / "s.npy").reshape(40, -1)
    image = join(list(open_input(drive / "s.npz", InputConfig()).blocks())).range_m
    line, column = chunk.values["scan_line"].astype(int), chunk.values["column"].astype(int)
    np.testing.assert_array_equal(chunk.values["class"], labels[line, column])
    np.testing.assert_array_equal(chunk.values["range"], image[line, column])
    assert chunk.n == np.isfinite(image).sum()


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_cloud_keeps_its_properties(drive: Path, tmp_path: Path, form: str, suffix: str) -> None:
    """Class, line and column are added to what was there; plyfile reads it."""
    plyfile = pytest.importorskip("plyfile")
    image = join(list(open_input(drive / "s.npz", InputConfig()).blocks())).range_m[:, ::4]
    n_lines, m = image.shape
    line, column = np.divmod(np.arange(image.size, dtype=np.uint32), m)
    made = {
        "range": np.nan_to_num(image).ravel(), "scan_line": line, "column": column,
        "quality": np.arange(image.size, dtype=np.int16),
    }  # fmt: skip
    given = tmp_path / f"g.{suffix}"
    data = ply(made, form, ("a comment",)) if suffix == "ply" else pcd(made, "ascii" if form == "ascii" else "binary")
    given.write_bytes(data)
    out = tmp_path / "o.ply"
    assert run(["classify", str(given), str(out), "--preset", "urban", "-q"]) in (0, 4)
    vertex = plyfile.PlyData.read(str(out))
    names = [prop.name for prop in vertex["vertex"].properties]
    assert names == ["range", "quality", "scan_line", "column", "class"]
    np.testing.assert_array_equal(vertex["vertex"]["quality"], made["quality"])
    np.testing.assert_array_equal(vertex["vertex"]["scan_line"], line)
    assert run(["classify", str(out), str(tmp_path / "l.npy"), "--preset", "urban", "-q"]) in (0, 4)
    np.testing.assert_array_equal(np.load(tmp_path / "l.npy"), vertex["vertex"]["class"])
    assert n_lines == 40


@pytest.mark.data
def test_the_labels_of_a_profiler_and_a_frame(real_data: Path, tmp_path: Path) -> None:
    """Every row has its class, copies of returns too; the file written is classified as the first one was."""
    for name in ("riegl/sample_riegl_18_02.ply", "ouster/rellis_frame000104.ply"):
        out, again = tmp_path / "o.ply", tmp_path / "a.pcd"
        for source, target in ((real_data / name, out), (out, again)):
            told = ["classify", str(source), str(target), "--preset", "urban", "-q", "--overwrite"]
            assert run(told) in (0, 4)
        (first,), (second,) = (open_source(one).chunks(("class", "scan_line")) for one in (out, again))  # type: ignore[union-attr]
        np.testing.assert_array_equal(first.values["class"], second.values["class"])
        np.testing.assert_array_equal(first.values["scan_line"], second.values["scan_line"])
        assert np.mean(first.values["class"] > 0) > 0.55
