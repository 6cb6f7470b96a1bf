"""``prc objects`` on the command line."""

import csv
import json

import numpy as np
import pytest
from pyarrow import parquet

from prc_cli.jobs.objects import COLUMNS
from tests.methods.fused.street_lines import BEAM, street_lines


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


@pytest.mark.slow
@pytest.mark.parametrize("is_placed", [True, False])
def test_every_form_holds_the_same_objects(prc, forest, tmp_path, is_placed):
    np.savez(tmp_path / "s.npz", range_m=street_lines(150)[0], angle_deg=np.rad2deg(BEAM))
    bare = f"{tmp_path}/s.npz --preset street-scan --set input.nadir=0"
    command = f"objects {f'{forest}/walk.laz' if is_placed else bare} -q"
    objects = [json.loads(line) for line in prc(f"{command} --json").out.splitlines()]
    assert objects
    assert all((row["x"] is None) != is_placed for row in objects)
    printed = [{k: "" if v is None else str(v) for k, v in row.items()} for row in objects]
    assert rows(prc(command).out) == printed
    for suffix in ("csv", "parquet", "geojson"):
        assert prc(f"{command} -o {tmp_path}/o.{suffix}").code == 0
    assert rows((tmp_path / "o.csv").read_text()) == printed
    assert parquet.read_table(tmp_path / "o.parquet").to_pylist() == objects
    for feature, row in zip(
        json.loads((tmp_path / "o.geojson").read_text())["features"], objects, strict=True
    ):
        place = [row.pop(axis) for axis in "xyz"]
        assert feature["properties"] == row
        assert (feature["geometry"] or {}).get("coordinates", [None] * 3) == place
