"""``prc info`` of several files: one command for a drive, else one for each file."""

import json
import re
import shlex

import pytest

from tests.formats.bags import recordings as bags
from tests.formats.bags.test_times import messages
from tests.formats.packets import captures
from tests.jobs.test_drive import cut_laz, cut_raw


def commands(out: str) -> list[str]:
    return re.findall(r"^type: (.*)$", out, re.MULTILINE)


def test_a_drive_gets_one_command_that_runs(prc, tmp_path):
    _, parts = cut_laz(tmp_path)
    out = prc("info", *parts).out
    folder = tmp_path / "classified"
    assert commands(out) == [shlex.join(["prc", "classify", *map(str, parts), f"{folder}/"])]
    assert "the 3 files continue each other" in out
    prc(commands(out)[0].removeprefix("prc "))
    assert sorted(path.name for path in folder.glob("*.laz")) == [part.name for part in parts]
    reports = json.loads(prc("info", *parts, "--json").out)
    assert {report["drive_command"] for report in reports} == set(commands(out))


@pytest.mark.parametrize("gap_s", [0.0, 7.0])
def test_files_that_do_not_continue_each_other_get_a_command_each(prc, tmp_path, gap_s):
    """In another order, or with a gap of time."""
    _, parts = cut_laz(tmp_path, gap_s=gap_s)
    parts = parts if gap_s else parts[::-1]
    out = prc("info", *parts).out
    assert [shlex.split(line)[2] for line in commands(out)] == list(map(str, parts))
    assert "continue each other" not in out


def test_dumps_do_not_show_that_they_are_one_drive(prc, tmp_path):
    _, parts = cut_raw(tmp_path)
    assert "continue each other" not in prc("info", *parts, "-M", 180).out


def test_files_that_need_other_options_get_a_command_each(prc, tmp_path):
    _, parts = cut_laz(tmp_path)
    (tmp_path / "other").mkdir()
    twin = parts[1].rename(tmp_path / "other" / parts[0].name)
    out = prc("info", parts[0], twin, parts[2]).out
    assert "continue each other" in out
    assert len(commands(out)) == 3, "two outputs would have one name"


def test_bags_and_captures_of_a_drive(prc, tmp_path):
    sent = messages(bags.drive(800))
    parts = [bags.write_bag(tmp_path / f"a_{k}.bag", sent[2 * k : 2 * k + 2]) for k in range(2)]
    assert "the 2 files continue each other" in prc("info", *parts).out
    assert "continue each other" not in prc("info", *parts[::-1]).out
    frames = captures.framed(captures.vlp16())
    parts = [
        captures.write_pcap(tmp_path / f"a_{k}.pcap", frames[10 * k : 10 * k + 10])
        for k in range(2)
    ]
    assert "the 2 files continue each other" in prc("info", *parts).out


def test_rings_that_fire_in_turns_are_in_order(prc, tmp_path):
    """The verdict was no for a file that ``prc classify`` labels."""
    scan = tmp_path / "spin.laz"
    prc(f"simulate street {scan} --scanner vlp-32c --duration 0.3 --seed 1 -q")
    report = json.loads(prc(f"info {scan} --json").out)
    assert report["classifiable"], report["problem"]
    done = prc(shlex.join(shlex.split(report["command"])[1:]))
    assert done.code in (0, 4), done.err
