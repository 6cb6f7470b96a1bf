"""``prc objects`` on the command line."""

import csv
import json

import numpy as np
import pyarrow.parquet as pq
import pytest

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
def test_every_form_holds_the_same(prc, forest):
    command = ("objects", forest / "walk.laz", "-q")
    printed = rows(prc(*command).out)
    for suffix in (".csv", ".geojson", ".parquet"):
        assert prc(*command, "-o", forest / f"e{suffix}").code == 0
    assert rows((forest / "e.csv").read_text()) == printed
    features = json.loads((forest / "e.geojson").read_text())["features"]
    assert [feature["properties"]["id"] for feature in features] == [
        int(row["id"]) for row in printed
    ]
    assert features[0]["geometry"]["coordinates"][0] == float(printed[0]["x"])
    table = pq.read_table(forest / "e.parquet").to_pylist()
    assert [row["n_shots"] for row in table] == [int(row["n_shots"]) for row in printed]
    lines = [json.loads(line) for line in prc(*command, "--json").out.splitlines()]
    assert [line["n_shots"] for line in lines] == [row["n_shots"] for row in table]


@pytest.mark.slow
def test_classes_that_are_there_are_taken_or_it_says_why_not(prc, forest):
    result = prc(f"objects {forest}/walk.laz")
    assert (result.code, "note: the classes of the file are taken" in result.err) == (0, True), (
        result.err
    )
    assert {row["kind"] for row in rows(result.out)} == {"stem"}
    assert (
        prc(
            f"classify {forest}/walk.laz {forest}/urban.laz --preset prc-2019-urban -q",
        ).code
        == 0
    )
    result = prc(f"objects {forest}/urban.laz")
    assert (
        "note: the file has classes, but none of: stem, pole, car, curb; it is classified again"
        in result.err
    )


def test_inputs_without_coordinates_have_none(prc, tmp_path):
    np.savez(tmp_path / "s.npz", range_m=street_lines(150)[0], angle_deg=np.rad2deg(BEAM))
    command = (
        "objects",
        tmp_path / "s.npz",
        "--preset",
        "street-scan",
        "--set",
        "input.nadir=0",
        "-q",
    )
    result = prc(*command, "--kind", "car")
    assert result.code == 0, result.err
    cars = rows(result.out)
    assert cars
    assert all(row["kind"] == "car" and not row["x"] for row in cars)
    big = max(cars, key=lambda row: int(row["n_shots"]))
    assert 1.5 < float(big["side_m"]) < 3.8
    assert prc(*command, "-o", tmp_path / "o.geojson").code == 0
    features = json.loads((tmp_path / "o.geojson").read_text())["features"]
    assert all(feature["geometry"] is None for feature in features)


@pytest.mark.data
def test_a_real_park_has_stems(prc, real_data):
    source = real_data / "forest" / "tls_park.npz"
    result = prc(f"objects {source} --preset fused-forest -q --kind stem")
    assert result.code in (0, 4), result.err
    assert rows(result.out)
