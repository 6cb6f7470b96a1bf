"""What other programs find in our files: codes, their names, and the styles for them (docs, Into my workflow)."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import laspy
import numpy as np
import pytest

import prc_cli
from prc_cli.cli import cli
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.samples import samples_folder
from tests.runner import runner
from tests.street import angles, street

ROOT = Path(__file__).resolve().parent.parent


def test_other_readers_find_codes_and_names(tmp_path: Path) -> None:
    np.savez(tmp_path / "drive.npz", range_m=street(), angle_deg=np.rad2deg(angles()))
    output = tmp_path / "out.laz"
    summary = prc_cli.classify(tmp_path / "drive.npz", output, prc_cli.load_config(preset="fused"))
    cloud = laspy.read(output)
    assert cloud.header.point_format.id >= 6
    codes = dict(zip(*(part.tolist() for part in np.unique(cloud.classification, return_counts=True)), strict=True))
    told = {one.code: one.count for one in summary.record.classes if one.count and one.name != "missing"}
    assert codes == told
    (record,) = [one for one in cloud.header.vlrs if (one.user_id, one.record_id) == ("LASF_Spec", 0)]
    names = record.lookups
    assert {65: "car", 66: "curb", 69: "pole"}.items() <= names.items()
    # what goes on in PDAL: docs/workflow.md
    page = (ROOT / "docs/workflow.md").read_text(encoding="utf-8")
    pipeline = json.loads(re.findall(r"```json\n(.*?)```", page, re.DOTALL)[0])
    wanted = [int(code) for code in re.findall(r"== (\d+)", pipeline[1]["expression"])]
    assert wanted == [2, 65, 66]
    assert np.isin(cloud.classification, wanted).sum() == sum(told.get(code, 0) for code in wanted)


def test_styles_of_viewers_hold_every_code() -> None:
    codes = {ClassCodes().code(label) for label in Label} | {0, 18}
    style = ElementTree.parse(samples_folder() / "viewers/prc_classes.qml").getroot()
    assert {int(one.get("value", "-1")) for one in style.iter("category")} == codes
    script = (samples_folder() / "viewers/prc_classes_potree.js").read_text(encoding="utf-8")
    assert {int(code) for code in re.findall(r"^ +(\d+):", script, re.MULTILINE)} == codes


@pytest.mark.parametrize("crs", ["", "EPSG:32635"])
def test_a_simulated_cloud_carries_the_coordinate_system_that_it_announces(tmp_path: Path, crs: str) -> None:
    words = ["simulate", "street", "-o", str(tmp_path / "drive.laz"), "--lines", "2"]
    result = runner().invoke(cli, [*words, *(["--set", f"frame.crs={crs}"] if crs else [])])
    assert result.exit_code == 0
    assert ("coordinates are those of" in result.stderr) == bool(crs)
    with laspy.open(tmp_path / "drive.laz") as file:
        found = file.header.parse_crs()
        # the flag says how a system would be written; point formats 6 to 10 must have it
        assert file.header.global_encoding.wkt
        assert abs(file.header.mins[1] - (6_671_000 if crs else 0)) < 2000
    assert (found is None) if not crs else (found is not None and found.to_epsg() == 32635)
