"""The walk of a new user: from a file to a classified, evaluated, drawn result in three commands
(docs, First hour).

Every command after the first is the one that the program itself said to type."""

from __future__ import annotations

import csv
import re
import shlex
import shutil
from pathlib import Path
from xml.etree import ElementTree

import laspy
import pytest

from prc_cli.cli import cli
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.config import samples_folder
from tests.runner import runner

pytestmark = pytest.mark.slow

MOST_COMMANDS = 3


class Walk:
    """Commands typed one after the other, each found in what the one before has printed."""

    def __init__(self) -> None:
        self.typed: list[str] = []
        self.said = ""

    def type(self, command: str, code: int = 0) -> str:
        """Run a command line; it must end with this exit code."""
        self.typed.append(command)
        result = runner().invoke(cli, shlex.split(command)[1:])
        assert result.exit_code == code, (
            f"{command}\n{result.output}\n{result.stderr}\n{result.exception!r}"
        )
        self.said = result.output + result.stderr
        return self.said

    def command_after(self, what: str) -> str:
        """Return the command that the program offers."""
        match = re.search(rf"^{what}: (prc .*)$", self.said, re.MULTILINE)
        assert match, f"no {what!r} in:\n{self.said}"
        return match[1]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in an empty folder, where the file is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def is_drawn(path: Path) -> bool:
    return path.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.data
def test_profiler_ply(here: Path, real_data: Path) -> None:
    shutil.copy(real_data / "riegl/sample_riegl_18_03.ply", here / "drive.ply")
    walk = Walk()
    walk.type("prc info drive.ply")
    # fourteen lines are too few to judge
    walk.type(walk.command_after("type"), code=4)
    assert "compare it: prc evaluate drive_classified.ply REFERENCE" in walk.said
    walk.type(walk.command_after("draw it"))
    assert is_drawn(here / "drive_classified.png")
    assert len(walk.typed) <= MOST_COMMANDS


def test_text_in_millimetres_with_decimal_commas(here: Path) -> None:
    assert (
        runner()
        .invoke(cli, shlex.split("simulate street truth.csv --lines 48 --seed 3 -q"))
        .exit_code
        == 0
    )
    with (here / "truth.csv").open() as truth, (here / "drive.csv").open("w") as drive:
        drive.write("line;column;angle_deg;range_mm;time_s\n")
        for row in csv.DictReader(truth):
            range_mm = f"{1000 * float(row['range_m']):.1f}" if row["range_m"] else ""
            cells = (
                row["line"],
                row["column"],
                f"{float(row['angle_deg']):.4f}",
                range_mm,
                row["time_s"],
            )
            drive.write(";".join(cells).replace(".", ",") + "\n")
    walk = Walk()
    walk.type("prc classify drive.csv labels.csv")
    assert "decimals stand behind a comma" in walk.said
    assert "range in mm" in walk.said
    draw = walk.command_after("draw it")
    compare = walk.command_after("compare it")
    walk.type(compare.replace("REFERENCE", "truth.csv"))
    accuracy = re.search(r"accuracy ([0-9.]+)", walk.said)
    assert accuracy
    assert float(accuracy[1]) > 0.9
    walk.type(draw)
    assert is_drawn(here / "labels.png")
    assert len(walk.typed) <= MOST_COMMANDS


@pytest.mark.data
def test_kitti_frame(here: Path, real_data: Path) -> None:
    for suffix in (".bin", ".label"):
        shutil.copy(real_data / f"kitti/000000{suffix}", here)
    walk = Walk()
    walk.type("prc classify 000000.bin labels.npy")
    assert "look like x, y, z and intensity of a frame" in walk.said
    draw = walk.command_after("draw it")
    compare = walk.command_after("compare it")
    assert compare == "prc evaluate labels.npy 000000.label"
    walk.type(compare)
    assert "mapping: street_kitti" in walk.said
    kappa = re.search(r"kappa ([0-9.]+)", walk.said)
    assert kappa
    assert float(kappa[1]) > 0.7
    walk.type(draw)
    assert is_drawn(here / "labels.png")
    assert len(walk.typed) <= MOST_COMMANDS


ROOT = Path(__file__).resolve().parent.parent


def test_styles_of_viewers_hold_every_code() -> None:
    codes = {ClassCodes().code(label) for label in Label} | {0, 18}
    style = ElementTree.parse(samples_folder() / "viewers/prc_classes.qml").getroot()
    assert {int(category.get("value", "-1")) for category in style.iter("category")} == codes
    script = (samples_folder() / "viewers/prc_classes_potree.js").read_text(encoding="utf-8")
    assert {int(code) for code in re.findall(r"^ +(\d+):", script, re.MULTILINE)} == codes


@pytest.mark.parametrize("crs", ["", "EPSG:32635"])
def test_a_simulated_cloud_carries_the_coordinate_system_that_it_announces(
    tmp_path: Path, crs: str
) -> None:
    words = ["simulate", "street", str(tmp_path / "drive.laz"), "--lines", "2"]
    result = runner().invoke(cli, [*words, *(["--set", f"frame.crs={crs}"] if crs else [])])
    assert result.exit_code == 0
    assert ("coordinates are those of" in result.stderr) == bool(crs)
    with laspy.open(tmp_path / "drive.laz") as file:
        header_crs = file.header.parse_crs()
        # the flag says how a system would be written; point formats 6 to 10 must have it
        assert file.header.global_encoding.wkt
        assert abs(file.header.mins[1] - (6_671_000 if crs else 0)) < 2000
    assert (
        (header_crs is None)
        if not crs
        else (header_crs is not None and header_crs.to_epsg() == 32635)
    )
