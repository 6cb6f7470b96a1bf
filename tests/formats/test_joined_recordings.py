"""Bags, and captures, of one drive are one stream."""

from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.formats.input import Input
from prc_cli.formats.joined import JoinedInput, JoinedRecordings
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.drive import classify_drive
from tests.formats.bags import recordings as bags
from tests.formats.bags.test_times import messages
from tests.formats.packets import captures


def check_joined(whole: Path, parts: list[Path]) -> list[int]:
    """Compare the stream of some files with that of all in one.

    Return the first record of every file.
    """
    drive = JoinedInput(tuple(Input.of(part) for part in parts))
    assert drive.are_recordings
    config = InputConfig()
    expected = join(list(Input.of(whole).images(config).blocks()))
    joined = join(list(drive.images(config).blocks()))
    np.testing.assert_array_equal(joined.range_m, expected.range_m)
    np.testing.assert_array_equal(joined.records(), expected.records())
    firsts = JoinedRecordings(drive.parts, config).firsts()
    assert firsts[-1] == expected.tally.n_records
    return firsts


def test_bags_of_one_drive(tmp_path):
    sent = messages(bags.drive(800))
    whole = bags.write_bag(tmp_path / "a.bag", sent)
    parts = [bags.write_bag(tmp_path / f"a_{k}.bag", sent[2 * k : 2 * k + 2]) for k in range(2)]
    n_first = sum(message.message.width for message in sent[:2])
    assert check_joined(whole, parts)[1] == n_first


def test_captures_of_one_drive(tmp_path):
    frames = captures.framed(captures.vlp16())
    whole = captures.write_pcap(tmp_path / "a.pcap", frames)
    parts = [
        captures.write_pcap(tmp_path / f"a_{k}.pcap", frames[10 * k : 10 * k + 10])
        for k in range(2)
    ]
    assert check_joined(whole, parts) == [0, 10 * 384, 20 * 384]


def test_files_that_cannot_be_joined_leave_no_folder(tmp_path):
    parts = [tmp_path / "a.npy", tmp_path / "b.npy"]
    for part in parts:
        np.save(part, np.ones((40, 50), np.float32))
    with pytest.raises(InputError, match="only bags, or only captures"):
        classify_drive(parts, tmp_path / "out", load_config())
    assert not (tmp_path / "out").exists()
