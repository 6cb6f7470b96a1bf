"""``prc objects`` on the command line."""

import csv
import json

import numpy as np
import pytest

from prc_cli.jobs.objects import COLUMNS


@pytest.fixture(scope="module")
def forest(tmp_path_factory):
    """A short walk with its registered coordinates, and the list of its stems."""
    folder = tmp_path_factory.mktemp("forest")
    from prc_cli.jobs.simulate import Beside, simulate
    from prc_cli.simulation.settings import load_settings

    options = {"lines": 120, "sight_m": 25.0, "seed": 930, "scanner": {"points_per_line": 1424}}
    simulate(
        "forest",
        folder / "walk.laz",
        load_settings("forest", options=options),
        beside=Beside(stems=folder / "s.csv"),
    )
    return folder


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


@pytest.mark.slow
def test_stems_are_where_the_simulator_has_them(prc, forest):
    result = prc(
        f"objects {forest}/walk.laz --preset fused-forest -o {forest}/o.csv --overwrite",
    )
    assert result.code == 0, result.err
    assert "stems in 120 lines" in result.err
    listed = rows((forest / "o.csv").read_text())
    assert list(listed[0]) == list(COLUMNS)
    assert [int(row["id"]) for row in listed] == list(range(len(listed)))
    assert {row["kind"] for row in listed} == {"stem"}
    stems = np.array(
        [[float(row["x_m"]), float(row["y_m"])] for row in rows((forest / "s.csv").read_text())]
    )
    stem_xy = np.array([[float(row["x"]), float(row["y"])] for row in listed])
    off = np.linalg.norm(stem_xy[:, None] - stems[None], axis=2).min(axis=1)
    assert np.median(off) < 0.5
    record = json.loads((forest / "o.csv.prc.json").read_text())
    assert record["config"]["fused"]["environment"] == "forest"
