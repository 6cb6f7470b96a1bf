"""The walk of a new user: from a file to a classified, evaluated, drawn result in three commands
(docs, First hour).

Every command after the first is the one that the program itself said to type."""

import csv
import re
import shutil

import pytest

from tests.journeys.shell import Shell

pytestmark = pytest.mark.slow


@pytest.fixture
def prc(tmp_path):
    return Shell(tmp_path)


def check_drawn(prc: Shell, command: str) -> None:
    said = prc(command)
    name = re.findall(r"\w+\.png", command + said.out)[0]
    assert (prc.here / name).read_bytes()[:4] == b"\x89PNG"


@pytest.mark.data
def test_profiler_ply(prc, real_data):
    shutil.copy(real_data / "riegl/sample_riegl_18_03.ply", prc.here / "drive.ply")
    # fourteen lines are too few to judge
    said = prc(prc("prc info drive.ply").command("type"), code=4)
    assert said.command("compare it") == "prc evaluate drive_classified.ply REFERENCE"
    check_drawn(prc, said.command("draw it"))


def test_text_in_millimetres_with_decimal_commas(prc):
    prc("prc simulate street truth.csv --lines 48 --seed 3 -q")
    with (prc.here / "truth.csv").open() as truth, (prc.here / "drive.csv").open("w") as drive:
        drive.write("line;column;angle_deg;range_mm;time_s\n")
        for row in csv.DictReader(truth):
            range_mm = f"{1000 * float(row['range_m']):.1f}" if row["range_m"] else ""
            angle_deg = f"{float(row['angle_deg']):.4f}"
            cells = row["line"], row["column"], angle_deg, range_mm, row["time_s"]
            drive.write(";".join(cells).replace(".", ",") + "\n")
    said = prc("prc classify drive.csv labels.csv")
    assert "decimals stand behind a comma" in said.err
    assert "range in mm" in said.err
    compared = prc(said.command("compare it").replace("REFERENCE", "truth.csv"))
    assert float(re.findall(r"accuracy ([0-9.]+)", compared.out)[0]) > 0.9
    check_drawn(prc, said.command("draw it"))


@pytest.mark.data
def test_kitti_frame(prc, real_data):
    for suffix in (".bin", ".label"):
        shutil.copy(real_data / f"kitti/000000{suffix}", prc.here)
    said = prc("prc classify 000000.bin labels.npy")
    assert "look like x, y, z and intensity of a frame" in said.err
    assert said.command("compare it") == "prc evaluate labels.npy 000000.label"
    compared = prc(said.command("compare it"))
    assert "mapping: street_kitti" in compared.out + compared.err
    assert float(re.findall(r"kappa ([0-9.]+)", compared.out)[0]) > 0.7
    check_drawn(prc, said.command("draw it"))
