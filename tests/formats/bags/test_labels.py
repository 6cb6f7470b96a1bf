"""Bags with the classes of their scans: what was there stays, and the labels read back equal."""

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2

from prc_cli.core.classes import Label
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import LabelledBlock, ReadTally
from prc_cli.core.types import U8
from prc_cli.formats.bags.containers import Bag
from prc_cli.formats.bags.labels import CloudCodec
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.labels import open_codes
from prc_cli.formats.options import InputConfig
from tests.formats import common
from tests.formats.bags import recordings as made

ECHOES = [[3.0, 5.0], [], [7.0], [4.0, 9.0, 0.0], [200.0], []]
SENT: dict[str, Callable[[int], list[made.Sent]]] = {
    "lasers": lambda version: made.lasers(version),
    "echoes": lambda version: made.echoes(version, ECHOES),
    "clouds": lambda version: clouds(version, made.POINT),
    "packed clouds": lambda version: clouds(version, made.kind_of("t", "u4", ring="u1")),
    "big clouds": lambda version: clouds(version, made.kind_of("t", "u4", order=">")),
    "mixed": lambda version: [
        *made.lasers(version, "/b"),
        *clouds(version, made.POINT),
        *made.lasers(version, "/a", "other"),
    ],
}
WRITE = {".bag": made.write_bag, ".mcap": made.write_mcap, ".db3": made.write_db3}


def clouds(version: int, point: np.dtype[Any]) -> list[made.Sent]:
    return made.clouds(made.drive(), point, version=version)


def recorded(folder: Path, name: str, suffix: str, **options: Any) -> Path:
    version = 1 if suffix == ".bag" else 2
    return WRITE[suffix](
        folder / f"in{suffix}", [*SENT[name](version), *made.strings(version)], **options
    )


def write(source: Path, output: Path) -> U8:
    """Write random classes of a bag, also as an array; return those of every record."""
    rng = np.random.default_rng(1)
    classes = np.array(common.URBAN, np.uint8)
    rules = InputConfig()
    blocks = []
    tally = ReadTally()
    for block in BagStream(source, rules).blocks():
        labels = rng.choice(classes, block.range_m.shape)
        labels[np.isnan(block.range_m)] = Label.MISSING
        blocks.append(LabelledBlock(block, labels, rng.choice(classes, len(block.extra))))
        tally = tally + block.tally
    record = common.run_record(n_records=tally.n_records)
    array = output.with_name(f"{output.name}.npy")
    common.write(array, source, blocks, record)
    common.write(output, source, blocks, record, rules=rules)
    codes: U8 = np.load(array)
    assert len(codes) == tally.n_records
    return codes


def read_codes(path: Path) -> Any:
    return np.concatenate(list(open_codes(path, None).codes()))


def by_topic(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    messages: dict[str, list[tuple[int, bytes]]] = {}
    bag = Bag(path)
    for message in bag.messages(list(bag.counts)):
        messages.setdefault(message.topic.name, []).append((message.time_ns, message.data))
    return messages


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.mark.parametrize("suffix", WRITE)
@pytest.mark.parametrize("name", SENT)
def test_labels_read_back_equal_and_all_else_stays(tmp_path, out, name, suffix):
    source = recorded(tmp_path, name, suffix)
    output = out / f"drive{suffix}"
    codes = write(source, output)
    np.testing.assert_array_equal(read_codes(output), codes)
    before = by_topic(source)
    after = by_topic(output)
    lasers = set(before) - {"/points", "/talk"}
    assert set(after) - set(before) == {f"{topic}/labels" for topic in lasers}
    for topic in set(before) - {"/points"}:
        assert before[topic] == after[topic]
    # what is read of the scans is what was read before, and the labels are no scanner
    was, now = (list(BagStream(path, InputConfig()).blocks()) for path in (source, output))
    for first, second in zip(was, now, strict=True):
        np.testing.assert_array_equal(first.range_m, second.range_m)
        np.testing.assert_array_equal(first.records(), second.records())
        assert first.scanner == second.scanner


def test_rows_lose_their_padding_and_a_label_of_the_input_its_values():
    table = np.zeros(6, np.dtype([*made.POINT.descr, ("label", "<u2")]))
    table["x"] = np.arange(6)
    table["label"] = 7
    message = made.cloud(2, 5, table, height=2)
    step = table.dtype.itemsize
    message.row_step = 3 * step + 10
    rows = message.data.reshape(2, -1)
    message.data = np.hstack([rows, np.zeros((2, 10), np.uint8)]).ravel()
    store = made.STORES[2]
    data = bytes(store.serialize_cdr(message, made.CLOUD))
    copied = CloudCodec(is_cdr=True).label(data, lambda n: np.arange(n, dtype=np.uint8))
    cloud = store.deserialize_cdr(copied, made.CLOUD)
    table["label"] = np.arange(6)
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (2, 3, step, 3 * step)
    assert cloud.data.tobytes() == table.tobytes()
    assert cloud.fields == message.fields


@pytest.mark.parametrize("suffix", WRITE)
def test_nothing_is_left_of_a_run_that_ends_early(tmp_path, out, monkeypatch, suffix):
    source = recorded(tmp_path, "lasers", suffix)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(rosbag1.Writer if suffix == ".bag" else rosbag2.Writer, "write", full)
    with pytest.raises(OutputError, match="the disk is full"):
        write(source, out / f"a{suffix}")
    assert {path.name for path in out.iterdir()} == {f"a{suffix}.npy", f"a{suffix}.npy.prc.json"}


@pytest.mark.parametrize(
    "suffix, packed",
    [
        *((".bag", compression) for compression in ("", "bz2", "lz4")),
        *((".mcap", compression) for compression in ("", "lz4", "zstd")),
        (".db3", ""),
        (".db3", "zstd"),
    ],
)
def test_an_output_is_compressed_as_the_input_is(tmp_path, out, suffix, packed):
    source = tmp_path / f"in{suffix}"
    if suffix == ".bag":
        made.write_bag(source, made.lasers(1), packed)
    elif suffix == ".mcap":
        made.write_mcap(source, made.lasers(2), packed or "none")
    else:
        made.write_db3(source, made.lasers(2), packed=packed == "zstd")
    write(source, out / source.name)
    assert Bag(source).packed == packed
    assert Bag(out / source.name).packed == ("zstd" if packed and suffix != ".bag" else packed)
