"""``prc info`` of several files: one command for a drive, else one for each file."""

from tests.formats.bags import recordings as bags
from tests.formats.bags.test_times import messages
from tests.formats.packets import captures


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
