"""Each command once per mode, on the command line: output, exit code, files."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.cli import main, report
from prc_cli.core.findings import CHECK_NAMES
from tests import patience
from tests.patience import HANGS_S, wait_until
from tests.street import N_LINES, POINTS_PER_LINE, angles, street, write_endless, write_npz, write_raw


class Result:
    """Exit code and what was printed."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err


class Prc:
    """Runs ``prc`` in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> Result:
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        captured = self._capsys.readouterr()
        code = stop.value.code
        return Result(int(code) if code is not None else 0, captured.out, captured.err)


@pytest.fixture
def prc(capsys: pytest.CaptureFixture[str]) -> Prc:
    return Prc(capsys)


def test_options_reach_the_classifier(prc: Prc, tmp_path: Path) -> None:
    source = write_raw(tmp_path / "drive.bin", street())
    layout = tmp_path / "layout.toml"
    layout.write_text('[layout]\nfields = [{name = "range", type = "f4"}]\n')
    options = ["--set", "prc.support.zeta_p=0.25", "--segment-ids", "--max-range", "80", "--layout", layout]
    options += ["-M", POINTS_PER_LINE]
    result = prc("classify", source, tmp_path / "out.las", "--json", "-q", *options)
    config = json.loads(result.out)["config"]
    assert config["prc"]["support"]["zeta_p"] == 0.25
    assert config["output"]["segment_ids"] is True
    assert config["input"]["max_range"] == 80
    assert config["layout"]["fields"] == [{"name": "range", "type": "f4", "scale": 1.0, "offset": 0.0, "unit": ""}]
    las = laspy.read(tmp_path / "out.las")
    assert las["segment_id"].max() > 1
    assert las["range"].max() <= 80


@pytest.mark.parametrize("told", [(), ("-M", POINTS_PER_LINE - 1), ("-M", 7)])
def test_info_types_the_m_that_it_found(prc: Prc, tmp_path: Path, told: tuple[object, ...]) -> None:
    """Where the number of records speaks against M, or none is given, the command to type has the estimate."""
    source = write_raw(tmp_path / "drive.bin", street())
    found = json.loads(prc("info", source, "--json", *told).out)
    assert found["classifiable"] is False
    words = found["command"].split()
    assert words[-2:] == ["-M", str(POINTS_PER_LINE)]
    assert prc(*words[1:]).code == 0


def test_info_doubts_what_classify_doubts_where_heights_explain_it(prc: Prc, tmp_path: Path) -> None:
    """Ranges in feet beside heights in metres look like a leaning plane; PRC does not ask for directions."""
    made, feet = tmp_path / "drive.laz", tmp_path / "feet.laz"
    assert prc("simulate", "street", "-o", made, "--lines", 60, "--seed", 72, "-q").code == 0
    points = laspy.read(made)
    points["range"] = points["range"] / 0.3048
    points.write(feet)
    found = json.loads(prc("info", feet, "--json").out)
    assert found["doubts"] == ["units", "method"]
    assert prc("classify", feet, tmp_path / "o.npy", "-q").code == 4
    assert "--set input.range_scale=0.3048" in found["command"]
    assert prc(*found["command"].split()[1:], "-q").code == 0


def test_info_types_no_command_that_would_be_refused(prc: Prc, tmp_path: Path) -> None:
    """An option that mends one finding does not help where another speaks against the input."""
    image = street().ravel()
    image[np.isnan(image)] = 500.0
    np.random.default_rng(3).shuffle(image)
    source = write_raw(tmp_path / "drive.bin", image.reshape(N_LINES, POINTS_PER_LINE))
    found = json.loads(prc("info", source, "--json", "-M", POINTS_PER_LINE).out)
    assert set(found["doubts"]) >= {"missing-code", "shot-order"}
    assert found["command"] == ""


def test_info_goes_on_after_a_bad_file(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    result = prc("info", tmp_path / "none.las", source, "--json")
    found = json.loads(result.out)
    assert result.code == 1
    assert "no such file" in found[0]["error"]
    assert found[1]["classifiable"] is True


def test_demo_makes_every_file(prc: Prc, tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    result = prc("demo", "--output", folder, "--lines", "200", "--json", "--quiet")
    assert result.code == 0, result.err
    found = json.loads(result.out)
    # found: .89, .996, .88 and .95; .98 and .58; .99, .86 and .38; with seed 1 .88, .90 and .91 in the forest
    assert list(found) == ["default", "prc", "sequential-angle", "default, forest"]
    floors = {
        "prc": {"ground": 0.9, "building": 0.2},
        "default": {"noise": 0.7, "ground": 0.95, "building": 0.85, "vegetation": 0.6},
        "sequential-angle": {"horizontal": 0.9, "vertical": 0.75, "car": 0.25},
        "default, forest": {"ground": 0.8, "vegetation": 0.8, "stem": 0.85},
    }
    for method, least in floors.items():
        for name, recall in least.items():
            assert found[method]["classes"][name]["recall"] > recall, (method, name)
            assert found[method]["classes"][name]["precision"] > 0.6, (method, name)
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "street.npz", "street.npz.prc.json", "street.laz", "street.laz.prc.json", "street.png", "street.html",
        "street_report.html", "more",
    }  # fmt: skip
    more = {path.name for path in (folder / "more").iterdir()}
    for stem in ("urban", "static_scan", "forest"):
        assert more >= {f"{stem}.png", f"{stem}_labels.npy", f"{stem}_report.html", f"{stem}.toml"}
    assert more >= {"static_scan.laz", "forest.laz", "street_labels.npy", "street_reference.npy"}
    page = (folder / "street_report.html").read_text(encoding="utf-8")
    assert "fused (--preset fused) · input street.npz" in page
    assert str(folder) not in page
    assert "height_above_ground" in (folder / "street.html").read_text(encoding="utf-8")
    result = prc("demo", "--output", folder)
    assert result.code == 2
    assert "holds files already" in result.err


def test_a_terminal_gets_a_progress_bar_and_a_pipe_none(tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    command = [sys.executable, "-m", "prc_cli", "classify", str(source), str(tmp_path / "a.npy")]
    piped = patience.run(command, capture_output=True, text=True, check=True)
    assert "lines/s" not in piped.stderr
    assert "\r" not in piped.stderr
    if os.name != "posix":
        return
    import pty

    master, slave = pty.openpty()
    patience.run([*command, "--overwrite"], stderr=slave, check=True)
    os.close(slave)
    shown = b""
    while chunk := _read(master):
        shown += chunk
    assert b"drive.npz" in shown
    assert b"lines" in shown


def _read(handle: int) -> bytes:
    try:
        return os.read(handle, 65536)
    except OSError:  # Linux ends a pseudo terminal this way
        return b""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_sigterm_leaves_nothing(tmp_path: Path) -> None:
    import signal

    source = write_endless(tmp_path / "drive.bin")
    command = [sys.executable, "-m", "prc_cli", "classify", str(source), str(tmp_path / "a.laz"), "-M", "2000", "-q"]
    with patience.start(command) as run:
        wait_until(lambda: list(tmp_path.glob(".a.laz.*")) or run.poll() is not None)
        run.send_signal(signal.SIGTERM)
        assert run.wait(HANGS_S) == 128 + signal.SIGTERM
    assert sorted(os.listdir(tmp_path)) == ["drive.bin"]


def test_what_takes_long_is_explained(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(report, "COMPILING_S", 0.0)
    with report.compiling_note(quiet=False):
        wait_until(lambda: "it is compiled, once" in capsys.readouterr().err)


def test_files_that_a_run_reads_are_never_its_output(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    config = tmp_path / "run.csv"
    config.write_text("[prc.surfaces]\ngamma = 1\n")
    result = prc("classify", source, config, "--config", config, "--overwrite")
    assert result.code == 2
    assert "the output is the input itself" in result.err
    prc("classify", source, tmp_path / "drive.las")
    track = tmp_path / "track.csv"
    track.write_text("time,x,y,z\n0,0,0,0\n1,0,0,0\n")
    result = prc("classify", tmp_path / "drive.las", track, "--overwrite", "--range", f"trajectory:{track}")
    assert result.code == 2
    assert "the output is the input itself" in result.err
    assert track.read_text().startswith("time,x,y,z")


def test_a_trajectory_starts_where_it_was_named(prc: Prc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "run.toml").write_text('[input]\nrange = "trajectory:track.csv"\n')
    monkeypatch.chdir(tmp_path)
    shown = json.loads(prc("config", "show", "--config", "conf/run.toml", "--json").out)
    assert Path(shown["config"]["input"]["range"].partition(":")[2]) == tmp_path / "conf" / "track.csv"
    option = ["--range", "trajectory:track.csv"]
    shown = json.loads(prc("config", "show", "--config", "conf/run.toml", "--json", *option).out)
    assert shown["config"]["input"]["range"] == "trajectory:track.csv"


def test_signs_of_wrong_rules_are_warned_of(prc: Prc, tmp_path: Path) -> None:
    rows = [f"{line},{column},{5 + column / 100}" for line in range(20) for column in range(30)]
    source = tmp_path / "drive.csv"
    source.write_text("\n".join(["scan_line,column,range", *rows]) + "\n")
    assert "warning" not in prc("classify", source, tmp_path / "a.npy").err
    result = prc("classify", source, tmp_path / "b.npy", "-M", "27", "-q")
    assert result.err.startswith("warning: unplaced: 10.0% of the records found no cell")
    assert (result.code, np.load(tmp_path / "b.npy").size) == (4, 600)
    result = prc("classify", source, tmp_path / "b2.npy", "-M", "20")
    assert (result.code, (tmp_path / "b2.npy").exists()) == (1, False)
    assert "33.3% of the records found no cell" in result.err
    assert "or insist with --accept-doubt unplaced" in result.err
    result = prc("classify", source, tmp_path / "b2.npy", "-M", "20", "--accept-doubt", "unplaced")
    assert (result.code, np.load(tmp_path / "b2.npy").size) == (0, 600)
    assert "warning" not in result.err
    source.write_text("\n".join(["scan_line,column,range", *rows, *rows[-60:]]) + "\n")
    assert "9.1% of the records met another shot" in prc("classify", source, tmp_path / "c.npy", "--trust-order").err
    source.write_text("scan_line,column,range\n" + "".join(f"{n},0,\n{n},1,\n" for n in range(90)))
    result = prc("classify", source, tmp_path / "d.npy", "-q")
    assert (result.code, "warning: returns: 0.00% of the shots have a range" in result.err) == (4, True)
    source.write_text("scan_line,column,range\n" + "".join(f"{n},0,6650338\n{n},1,6650339\n" for n in range(90)))
    result = prc("classify", source, tmp_path / "e.npy", "-q")
    assert (result.code, "100.00% of the ranges lie beyond 20 km" in result.err) == (1, True)


def test_info_fits_one_screen(prc: Prc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The verdict, what to type, facts, and how many checks are fine; nothing says two lengths of a line."""
    monkeypatch.setenv("COLUMNS", "100")
    assert prc("simulate", "street", "-o", tmp_path / "drive.laz", "--lines", 60, "-q").code == 0
    said = prc("info", tmp_path / "drive.laz").out.splitlines()
    assert said[0] == f"{tmp_path / 'drive.laz'}: yes, fused can classify it as it is"
    assert said[1].startswith("type: prc classify ")
    assert said[-1].startswith("checks ")
    assert said[-1].endswith(" fine (--checks lists them)")
    assert len(said) <= 24
    assert max(map(len, said[2:])) <= 100
    assert not any("M estimated" in line for line in said)
    listed = prc("info", tmp_path / "drive.laz", "--checks").out
    assert re.findall(r"^check: (\S+)", listed, re.MULTILINE) == list(CHECK_NAMES)
    assert len(re.findall(r"^check: \S+ +fine: ", listed, re.MULTILINE)) == int(said[-1].split()[1])
    assert "asked of the labels, by prc classify. Doubtful above" in " ".join(listed.split())


def test_info_says_doubts_behind_the_command(prc: Prc, tmp_path: Path) -> None:
    np.savez(tmp_path / "drive.npz", range_m=street() / 0.3048, angle_deg=np.rad2deg(angles()))
    said = prc("info", tmp_path / "drive.npz").out.splitlines()
    doubts = json.loads(prc("info", tmp_path / "drive.npz", "--json").out)["doubts"]
    assert doubts
    assert said[0].endswith(f"can classify it, but look at {', '.join(doubts)}")
    assert said[1].startswith("type: ")
    assert [line.split(":")[0] for line in said[2 : 2 + len(doubts)]] == [f"look at {name}" for name in doubts]
