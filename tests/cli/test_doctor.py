"""``prc doctor`` finds faults, says what to do, and leaves no files."""

import errno
import importlib.metadata as metadata
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes
from prc_cli.core.types import F32
from prc_cli.jobs import doctor
from prc_cli.jobs.classify import ClassifiedRanges
from prc_cli.jobs.doctor import Check, examine
from tests import patience


def checks(out: Path | None = None) -> dict[str, Check]:
    return {check.name: check for check in examine(out, run=False)}


@pytest.mark.slow
def test_this_installation_is_sound_from_end_to_end(prc, tmp_path):
    result = prc(f"doctor --json {tmp_path}/new/folder")
    report = json.loads(result.out)
    by_name = {check["name"]: check for check in report["checks"]}
    assert result.code == 0, report
    assert report["counts"]["bad"] == 0
    assert by_name["end to end"]["details"]["scores"]["recall.ground"] > 0.95
    assert by_name["engines"]["details"]["different"] == {
        "prc-2019-urban": 0,
        "prc-2019-forest": 0,
        "street-scan": 0,
    }
    assert by_name["LAZ"]["status"] == "ok"
    # the folder is asked about, not made, and nothing stays in the one that is there
    assert list(tmp_path.iterdir()) == []


def test_every_check_is_a_line_and_says_what_to_do(prc, monkeypatch):
    made = [Check("memory", "ok", "8 GiB"), Check("locks in it", "bad", "none", "another disk")]
    monkeypatch.setattr(doctor, "examine", lambda *_, **__: made)
    wrong = """\
bad   locks in it       none
                        -> another disk
"""
    whole = f"ok    memory            8 GiB\n{wrong}"
    assert prc("doctor") == (1, whole, "1 ok, 0 warn, 1 bad\n")
    assert prc("doctor -q") == (1, wrong, "")
    names = ("name", "status", "found", "hint", "details")
    rows = [("memory", "ok", "8 GiB", "", {}), ("locks in it", "bad", "none", "another disk", {})]
    assert prc.json("doctor") == {
        "counts": {"ok": 1, "warn": 0, "bad": 1},
        "checks": [dict(zip(names, row, strict=True)) for row in rows],
    }


def test_bounds_come_from_the_installed_metadata():
    details = checks()["packages"].details
    for text in metadata.requires("prc-cli") or []:
        if "extra" not in text:
            name, _, bound = text.partition(">=")
            assert details[name]["at_least"] == bound
            assert details[name]["found"] == metadata.version(name)


def test_an_old_and_a_missing_package_are_bad_and_name_the_remedy(
    monkeypatch,
):
    monkeypatch.setattr(
        metadata, "requires", lambda name: ["numpy>=999.1", "no-such-thing>=2", "click>=8"]
    )
    check = checks()["packages"]
    assert check.status == "bad"
    assert "no-such-thing missing (expected 2 or newer)" in check.text
    assert check.hint == "pip install 'numpy>=999.1' 'no-such-thing>=2'"


def test_laz_that_comes_back_different_is_bad(monkeypatch):
    class Broken:
        def __init__(self, *_: object) -> None:
            pass

        def decompress_many(self, records: object) -> None:
            pass

    monkeypatch.setattr("prc_cli.formats.las.laz.lazrs.LasZipDecompressor", Broken)
    check = checks()["LAZ"]
    assert check.status == "bad"
    assert "differ" in check.text


def test_a_file_system_without_locks_is_said(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    assert checks(tmp_path)["locks in it"].status == "ok"

    def flock(handle: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", flock)
    check = checks(tmp_path)["locks in it"]
    assert check.status == "bad"
    assert "another disk" in check.hint


@pytest.mark.slow
@pytest.mark.parametrize("package", ["lazrs", "numba"])
def test_a_package_that_does_not_load_is_named_and_the_rest_is_looked_at(tmp_path, package):
    (tmp_path / f"{package}.py").write_text("raise ImportError('libwhatever.so.3 is not there')\n")
    command = [
        sys.executable,
        "-m",
        "prc_cli",
        "doctor",
        "--no-run",
        "--json",
        str(tmp_path / "out"),
    ]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = patience.run(command, env=environment, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (1, "")
    by_name = {check["name"]: check for check in json.loads(ended.stdout)["checks"]}
    assert by_name["packages"]["status"] == "bad"
    assert f"{package} cannot be loaded" in by_name["packages"]["found"]
    assert package in by_name["packages"]["hint"]
    assert by_name["LAZ" if package == "lazrs" else "compiled loops"]["status"] == "bad"
    assert by_name["journal in it"]["status"] == "ok"


def test_a_check_that_breaks_down_does_not_end_the_others(monkeypatch):
    def broken() -> Iterator[Check]:
        raise ZeroDivisionError
        yield

    monkeypatch.setattr(doctor, "_memory", broken)
    by_name = checks()
    assert by_name["memory"].status == "bad"
    assert "temporary files" in by_name


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_bad(tmp_path):
    tmp_path.chmod(0o500)
    try:
        assert checks(tmp_path)[f"output folder {tmp_path}"].status == "bad"
    finally:
        tmp_path.chmod(0o700)


def test_compiled_loops_that_give_other_labels_are_bad(monkeypatch):
    def wrong(range_m: F32, *_: object, engine: str = "compiled", **__: object) -> ClassifiedRanges:
        return ClassifiedRanges(
            np.full(range_m.shape, engine == "compiled", np.uint8), ClassCodes()
        )

    monkeypatch.setattr("prc_cli.jobs.classify.classify_ranges", wrong)
    monkeypatch.setattr(doctor, "COMPARED", {"prc-2019-forest": doctor.COMPARED["prc-2019-forest"]})
    (check,) = doctor._engines()
    assert (check.status, check.details["different"]) == ("bad", {"prc-2019-forest": 48_000})
    assert "labels differ (prc-2019-forest 48,000), expected the same" in check.text
    assert "prc classify --engine reference" in check.hint
