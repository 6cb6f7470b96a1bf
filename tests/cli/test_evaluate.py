"""``prc evaluate`` on the command line: files of every format, folders, gates, errors."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.cli.conftest import Result
from tests.formats.las.lasbytes import make_las

Prc = Callable[..., Result]


@pytest.fixture
def prc(prc):
    """Run ``prc evaluate``."""
    return lambda line, *arguments: prc(f"evaluate {line}", *arguments)


def save(
    folder: Path,
    name: str,
    predicted: list[int],
    reference: list[int],
) -> tuple[Path, Path]:
    """A predicted and a reference file of one name in two folders."""
    paths = folder / "run" / f"{name}.npy", folder / "reference" / f"{name}.csv"
    for path in paths:
        path.parent.mkdir(exist_ok=True)
    np.save(paths[0], np.array(predicted, np.uint8))
    with paths[1].open("w", encoding="utf-8") as handle:
        csv.writer(handle).writerows([["class"], *([code] for code in reference)])
    return paths


def record(path: Path, method: str, **tables: object) -> None:
    """Put the run record of a method beside a predicted file."""
    made = {"program": "prc-cli", "config": {"method": method, **tables}}
    path.with_name(f"{path.name}.prc.json").write_text(json.dumps(made))


@pytest.mark.parametrize(
    "method, tables, mapping",
    [
        ("fused", {"fused": {"environment": "urban"}}, "street"),
        ("fused", {"fused": {"environment": "forest"}}, "prc"),
        ("sequential-angle", {}, "street_scan"),
        ("prc", {}, "prc"),
        ("fused", {"fused": 3}, "prc"),
        (["fused"], {}, "prc"),
    ],
)
def test_the_run_record_beside_the_predicted_file_names_the_mapping(
    prc,
    tmp_path,
    method,
    tables,
    mapping,
):
    paths = save(tmp_path, "a", [2, 2, 65, 66, 5, 0], [2, 2, 65, 5, 5, 0])
    record(paths[0], method, **tables)
    code, out, err = prc(*paths, "--json")
    assert (code, json.loads(out)["mapping"]) == (0, mapping)
    said = f"mapping: {mapping} (the run record says {method}); --mapping names another\n"
    assert err == ("" if mapping == "prc" else said)
    code, out, err = prc(*paths, "--json", "--mapping", "prc")
    assert (code, json.loads(out)["mapping"], err) == (0, "prc", "")
    assert prc(*paths, "-q") == (0, "", "")


def test_codes_of_one_kind_of_data_have_the_mapping_of_the_method(prc, tmp_path):
    np.save(tmp_path / "a.npy", np.array([2, 5, 65], np.uint8))
    np.array([40, 70, 10], "<u4").tofile(tmp_path / "a.label")
    np.save(tmp_path / "oakland.npy", np.array([1203, 1300, 1501], np.uint16))
    for method, kind in ((None, ""), ("fused", "street_"), ("sequential-angle", "street_scan_")):
        if method:
            record(tmp_path / "a.npy", method, fused={"environment": "urban"})
        for name, mapping in (
            ("a.label", f"{kind or 'semantic_'}kitti"),
            ("oakland.npy", f"{kind}oakland"),
        ):
            code, out, err = prc(f"{tmp_path}/a.npy {tmp_path}/{name} --json")
            assert (code, json.loads(out)["mapping"], "it lists the reference's codes" in err) == (
                0,
                mapping,
                True,
            )
    np.save(tmp_path / "a.npy", np.zeros(3, np.uint8))
    assert "none of 3 records has a class to score" in prc(f"{tmp_path}/a.npy {tmp_path}/a.npy")[2]


def test_files_of_different_methods_are_compared_in_the_classes_of_prc(prc, tmp_path):
    for name in ("a", "b"):
        save(tmp_path, name, [2, 2, 65, 66], [2, 2, 65, 5])
        record(tmp_path / "run" / f"{name}.npy", "fused", fused={"environment": "urban"})
    result = prc(f"{tmp_path}/run {tmp_path}/reference --json")
    assert json.loads(result[1])["mapping"] == "street"
    record(tmp_path / "run" / "b.npy", "prc")
    result = prc(f"{tmp_path}/run {tmp_path}/reference --json")
    assert (json.loads(result[1])["mapping"], result[2]) == ("prc", "")
    (tmp_path / "run" / "b.npy.prc.json").write_text("[" * 100_000)
    assert json.loads(prc(f"{tmp_path}/run {tmp_path}/reference --json")[1])["mapping"] == "prc"


@pytest.mark.parametrize(
    "methods, mapping",
    [
        (("prc", "sequential-angle"), "street_scan"),
        (("sequential-angle", "prc"), "street_scan"),
        (("fused", "sequential-angle"), "street_scan"),
        (("fused", "prc"), "prc"),
        (("prc", "rings"), "prc"),
        (("fused", "rings"), "street"),
    ],
)
def test_two_methods_are_compared_in_the_classes_of_both(
    prc,
    tmp_path,
    methods,
    mapping,
):
    paths = save(tmp_path, "a", [2, 6, 6, 65], [2, 6, 66, 65])
    for path, method in zip(paths, methods, strict=True):
        record(path, method, fused={"environment": "urban"})
    code, out, err = prc(*paths, "--json")
    assert (code, json.loads(out)["mapping"]) == (0, mapping)
    if mapping != "street":
        said = (
            f"mapping: {mapping} (the run records say {methods[0]} and {methods[1]}: it has "
            "the classes of both)"
        )
        assert err == f"{said}; --mapping names another\n"


def test_a_reference_of_class_names_is_read(prc, tmp_path):
    np.save(tmp_path / "a.npy", np.array([2, 6, 65], np.uint8))
    (tmp_path / "names.csv").write_text(
        "record,class\n0,ground\n1,building\n2,car\n", encoding="utf-8"
    )
    code, out, _ = prc(f"{tmp_path}/a.npy {tmp_path}/names.csv --mapping street --json")
    assert (code, json.loads(out)["overall"]["accuracy"]) == (0, 1.0)


def rows(
    path: Path,
    codes: list[int],
    order: list[int],
    first: int = 0,
) -> Path:
    lines = [f"{first + record},{codes[record]}" for record in order]
    path.write_text("\n".join(["record,class", *lines, ""]), encoding="utf-8")
    return path


CODES = [2, 6, 7, 2, 2, 6, 7, 2]
SHUFFLED = [5, 2, 0, 7, 1, 3, 6, 4]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_rows_with_record_numbers_are_paired_by_them(prc, tmp_path, form):
    np.save(tmp_path / "r.npy", np.array(CODES, np.uint8))
    path = rows(tmp_path / "p.csv", CODES, SHUFFLED)
    if form == "parquet":
        columns = {"record": SHUFFLED, "class": [CODES[record] for record in SHUFFLED]}
        pq.write_table(pa.table(columns), path := tmp_path / "p.parquet")
    code, out, _ = prc(f"{path} {tmp_path}/r.npy")
    assert code == 0
    assert "accuracy 1.000" in out
    assert "matched by record number" in out


def test_numbers_from_one_and_two_files_in_one_other_order_are_in_order(prc, tmp_path):
    np.save(tmp_path / "r.npy", np.array(CODES, np.uint8))
    assert (
        "Matched by order"
        in prc(rows(tmp_path / "p.csv", CODES, list(range(8)), 1), tmp_path / "r.npy")[1]
    )
    both = rows(tmp_path / "p.csv", CODES, SHUFFLED), rows(tmp_path / "r.csv", CODES, SHUFFLED)
    assert "accuracy 1.000" in prc(*both)[1]


def test_record_numbers_that_a_file_of_points_lacks(prc, tmp_path):
    make_las(tmp_path / "r.las", 6, n=8)
    code, _, err = prc(rows(tmp_path / "p.csv", CODES, SHUFFLED), tmp_path / "r.las")
    assert code == 1
    assert "rows are not in the order of their record numbers" in err


def test_lengths_are_compared_before_anything_is_read(prc, tmp_path, monkeypatch):
    """Equal labels take no bytes in a table: a small file may hold any number."""
    np.save(tmp_path / "r.npy", np.array(CODES, np.uint8))
    pq.write_table(pa.table({"class": np.full(9, 2, np.uint8)}), tmp_path / "p.parquet")
    monkeypatch.setattr(
        "prc_cli.formats.tables.read.read_batches", lambda *arguments: pytest.fail("it is read")
    )
    code, _, err = prc(f"{tmp_path}/p.parquet {tmp_path}/r.npy --mapping prc")
    assert code == 1
    assert "9 records, but" in err


TREES = {
    "x,y,radius\nnan,1,1\n": "row 1: a number that is not finite",
    "x,y,radius\n1,1,1\n1,1,-2\n": "row 2: a number that is not finite, or a width below 0",
    'x,y,radius\n"' + "1" * 200_000 + '",1,1\n': "field larger than field limit",
}
AREAS = {
    "[" * 100_000: "no GeoJSON",
    '{"type":"Polygon","coordinates":[[[1' + "0" * 400 + ",0],[1,0],[1,1],[0,0]]]}": "no GeoJSON",
    '{"type":"Polygon","coordinates":[[[NaN,0],[1,0],[1,1],[NaN,0]]]}': "no GeoJSON",
}


@pytest.mark.parametrize(
    "option, name, text, message",
    [
        *(("--trees", "t.csv", text, message) for text, message in TREES.items()),
        *(("--inside", "a.geojson", text, message) for text, message in AREAS.items()),
    ],
)
def test_odd_trees_and_areas_are_refused_in_one_line(
    prc,
    tmp_path,
    option,
    name,
    text,
    message,
):
    make_las(tmp_path / "a.las", 6, n=20)
    (tmp_path / name).write_text(text)
    code, _, err = prc(
        f"{tmp_path}/a.las {tmp_path}/a.las --match nearest {option} {tmp_path}/{name}"
    )
    assert code == 1
    assert message in err
    assert err.count("\n") == 1
