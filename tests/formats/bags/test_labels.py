"""Bags with the classes of their scans: what was there stays, and the labels read back equal."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader

from prc_cli.cli import cli
from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import OutputError
from prc_cli.core.files import remove_stale, temporary_name
from prc_cli.core.stream import LabelledBlock, ReadTally
from prc_cli.core.types import U8
from prc_cli.formats.bags.containers import Bag
from prc_cli.formats.bags.labels import CloudCodec
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.labels import open_codes
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.classify import classify
from tests.formats import common
from tests.formats.bags import recordings as made
from tests.runner import runner

SENT: dict[str, Callable[[int], list[made.Sent]]] = {
    "lasers": lambda version: made.lasers(version),
    "echoes": lambda version: echoes(version),
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


def echoes(version: int) -> list[made.Sent]:
    lists = [[3.0, 5.0], [], [7.0], [4.0, 9.0, 0.0], [200.0], []]
    store = made.STORES[version]
    times = [made.START_NS + i * made.PERIOD_NS for i in range(3)]
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    return [
        made.Sent("/scan", kind, time_ns, made.echoes(store, time_ns, lists, lists))
        for time_ns in times
    ]


def recorded(folder: Path, name: str, suffix: str, **options: Any) -> Path:
    version = 1 if suffix == ".bag" else 2
    return WRITE[suffix](
        folder / f"in{suffix}", [*SENT[name](version), *made.strings(version)], **options
    )


def write(source: Path, output: Path, *, seed: int = 1, **options: Any) -> U8:
    """Write random classes of a bag; return those of every record."""
    rng = np.random.default_rng(seed)
    rules = InputConfig(**options)
    blocks = []
    tally = ReadTally()
    for block in BagStream(source, rules).blocks():
        labels = rng.choice(np.array(common.URBAN, np.uint8), block.range_m.shape)
        labels[np.isnan(block.range_m)] = Label.MISSING
        blocks.append(
            LabelledBlock(
                block, labels, rng.choice(np.array(common.URBAN, np.uint8), len(block.extra))
            )
        )
        tally = tally + block.tally
    record = common.run_record(n_records=tally.n_records)
    alone = output.with_name(f"{output.name}.npy")
    common.write(alone, source, blocks, record)
    written = common.write(output, source, blocks, record, rules=rules)
    codes: U8 = np.load(alone)
    assert {count.code: count.count for count in written.classes} == {
        int(code): int(n) for code, n in zip(*np.unique(codes, return_counts=True), strict=True)
    }
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


def out_folder(folder: Path) -> Path:
    (folder / "out").mkdir()
    return folder / "out"


@pytest.mark.parametrize("suffix", WRITE)
@pytest.mark.parametrize("name", SENT)
def test_labels_read_back_equal_and_all_else_stays(tmp_path: Path, name: str, suffix: str) -> None:
    source = recorded(tmp_path, name, suffix)
    output = out_folder(tmp_path) / f"drive{suffix}"
    codes = write(source, output)
    np.testing.assert_array_equal(read_codes(output), codes)
    before = by_topic(source)
    after = by_topic(output)
    added = {name for name in after if name.endswith("/labels")}
    assert added == {f"{topic}/labels" for topic in before if topic in ("/scan", "/a", "/b")}
    for topic in set(before) - {"/points"}:
        assert before[topic] == after[topic]
    # what is read of the scans is what was read before, and the labels are no scanner
    as_written, as_copied = (
        list(BagStream(path, InputConfig()).blocks()) for path in (source, output)
    )
    for first, second in zip(as_written, as_copied, strict=True):
        np.testing.assert_array_equal(first.range_m, second.range_m)
        np.testing.assert_array_equal(first.records(), second.records())
        assert first.scanner == second.scanner


def test_rows_lose_their_padding_and_a_label_of_the_input_its_values() -> None:
    table = np.zeros(6, np.dtype([*made.POINT.descr, ("label", "<u2")]))
    table["x"] = np.arange(6)
    table["label"] = 7
    message = made.cloud(2, 5, table, height=2)
    step = table.dtype.itemsize
    padded = np.zeros((2, 3 * step + 10), np.uint8)
    padded[:, : 3 * step] = np.frombuffer(table.tobytes(), np.uint8).reshape(2, -1)
    message.data = padded.ravel()
    message.row_step = 3 * step + 10
    store = made.STORES[2]
    data = bytes(store.serialize_cdr(message, message.__msgtype__))
    cloud = store.deserialize_cdr(
        CloudCodec(is_cdr=True).label(data, lambda n: np.arange(n, dtype=np.uint8)),
        message.__msgtype__,
    )
    table["label"] = np.arange(6)
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (2, 3, step, 3 * step)
    assert cloud.data.tobytes() == table.tobytes()
    assert cloud.fields == message.fields


@pytest.mark.parametrize("suffix", WRITE)
def test_nothing_is_left_of_a_run_that_ends_early(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    source = recorded(tmp_path, "lasers", suffix)
    folder = out_folder(tmp_path)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(rosbag1.Writer if suffix == ".bag" else rosbag2.Writer, "write", full)
    with pytest.raises(OutputError, match="the disk is full"):
        write(source, folder / f"a{suffix}")
    assert {path.name for path in folder.iterdir()} == {f"a{suffix}.npy", f"a{suffix}.npy.prc.json"}


def test_a_killed_run_leaves_nothing_for_long(tmp_path: Path) -> None:
    left = temporary_name(tmp_path / "a.db3")
    left = left.with_name(left.name.replace(f"-{os.getpid()}-", "-999999999-"))
    (left / "a").mkdir(parents=True)
    remove_stale(tmp_path / "a.db3")
    assert not left.exists()


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", ["ros/sick_lms1xx_ros1.bag", "cartographer/b0_short.bag"])
def test_real_bags(tmp_path: Path, real_data: Path, name: str) -> None:
    source = real_data / name
    output = tmp_path / "out.bag"
    codes = write(source, output)
    np.testing.assert_array_equal(read_codes(output), codes)
    before = by_topic(source)
    after = by_topic(output)
    assert {topic: after[topic] for topic in before} == before
    assert ClassCodes().code(Label.GROUND) in codes
    with AnyReader([output]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
    assert all(kinds[topic] == kinds[topic.removesuffix("/labels")] for topic in kinds)


@pytest.mark.parametrize(
    ("suffix", "packed"),
    [
        *((".bag", compression) for compression in ("", "bz2", "lz4")),
        *((".mcap", compression) for compression in ("", "lz4", "zstd")),
        (".db3", ""),
        (".db3", "zstd"),
    ],
)
def test_an_output_is_compressed_as_the_input_is(tmp_path: Path, suffix: str, packed: str) -> None:
    source = tmp_path / f"in{suffix}"
    output = out_folder(tmp_path) / f"out{suffix}"
    if suffix == ".bag":
        made.write_bag(source, made.lasers(1), packed)
    elif suffix == ".mcap":
        made.write_mcap(source, made.lasers(2), packed or "none")
    else:
        made.write_db3(source, made.lasers(2), packed=packed == "zstd")
    classify(source, output, load_config(preset="prc-2019-urban"))
    assert Bag(source).packed == packed
    assert Bag(output).packed == ("zstd" if packed and suffix != ".bag" else packed)
    assert len(read_codes(output)) == made.N_LINES * made.M


def test_a_recording_in_several_files_is_one_stream(tmp_path: Path) -> None:
    sent = made.lasers(2)
    whole = made.write_db3(tmp_path / "whole.db3", sent)
    folder = tmp_path / "split"
    folder.mkdir()
    names = [
        made.write_db3(folder / f"rec_{i}.db3", sent[5 * i : 5 * i + 5]).name for i in range(3)
    ]
    listed = "".join(f"    - {name}\n" for name in names)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}"
    )
    config = load_config(preset="prc-2019-urban")
    classify(whole, tmp_path / "whole.npy", config)
    classify(folder, tmp_path / "split.npy", config)
    assert np.array_equal(np.load(tmp_path / "whole.npy"), np.load(tmp_path / "split.npy"))
    # each part is a bag of its own where it is named
    classify(folder / names[2], tmp_path / "last.npy", config)
    assert len(np.load(tmp_path / "last.npy")) == 2 * made.M
    with pytest.raises(OutputError, match="found metadata.yaml"):
        classify(folder, tmp_path / "out.db3", config)
    (folder / names[1]).unlink()
    result = runner().invoke(cli, ["info", str(folder)])
    assert "name the file in this bag" in result.stderr
