"""Transfer of classes from a raw run to registered points: correct classes, all else unchanged, errors."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError, OutputExistsError, PrcError
from prc_cli.jobs.transfer import TransferSummary, sides, transfer
from prc_cli.jobs.transfer.options import TransferOptions
from prc_cli.matching.sides import Survey
from prc_cli.streams import order
from tests.formats.las.lasbytes import parse

N = 5000
SHOT_S = 1e-5
START_S = 318_000.25
RNG = np.random.default_rng


class Drive:
    """A raw run: a time and a class for every record, one or two returns a shot."""

    def __init__(self, n: int = N, seed: int = 0, start_s: float = START_S) -> None:
        rng = RNG(seed)
        returns = np.ones(n, np.int64)
        returns[1:][rng.random(n - 1) < 0.2] = 2
        returns[1:][returns[:-1] == 2] = 1
        shot = np.cumsum(returns == 1) - 1
        self.time = start_s + shot * SHOT_S
        self.returns = returns
        self.codes = rng.choice([1, 2, 5, 6, 7], n).astype(np.uint8)
        self.xyz = rng.uniform(0, 50, (n, 3))

    def __len__(self) -> int:
        return len(self.time)

    def registered(self, seed: int = 1, keep: float = 0.8) -> NDArray[np.int64]:
        """Records that are left, in the order of shuffled tiles."""
        rng = RNG(seed)
        left = np.flatnonzero(rng.random(len(self)) < keep)
        tile = (self.xyz[left, :2] // 10).astype(np.int64) @ [7, 1]
        return left[np.argsort(rng.permutation(60)[tile], kind="stable")]


def write_las(
    path: Path,
    drive: Drive,
    record: NDArray[np.int64],
    *,
    codes: Any = 0,
    form: int = 6,
    time: Any = None,
    **extra: Any,
) -> Path:
    """A registered file of some records; ``extra`` are extra bytes."""
    header = laspy.LasHeader(point_format=form, version="1.4" if form >= 6 else "1.2")
    header.scales, header.offsets = [0.001] * 3, [0.0] * 3
    for name, values in extra.items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, np.asarray(values).dtype))
    header.vlrs.append(laspy.VLR("other", 7, "theirs", b"payload"))
    las = laspy.LasData(header)
    las.x, las.y, las.z = drive.xyz[record].T
    if form not in (0, 2):
        las.gps_time = drive.time[record] if time is None else time
    las.return_number = drive.returns[record]
    las.number_of_returns = drive.returns[record]
    las.classification = np.broadcast_to(codes, len(record)).astype(np.uint8)
    las.intensity = np.arange(len(record)) % 60_000
    las.withheld = np.arange(len(record)) % 2
    for name, values in extra.items():
        las[name] = values
    las.write(path)
    return path


def write_raw(path: Path, drive: Drive, *, missing: int = 7, digits: int | None = None, **columns: Any) -> Path:
    """A raw CSV in which every ``missing``-th row more is a shot without return; its labels go to ``.npy`` beside."""
    rows, codes = [], []
    named = {"time": drive.time, "return_number": drive.returns, **columns}
    named = {name: values for name, values in named.items() if values is not None}
    rows.append(",".join([*named, "range_m"]))
    for i in range(len(drive)):
        cells = [
            repr(float(values[i])) if digits is None or name != "time" else f"{values[i]:.{digits}f}"
            for name, values in named.items()
        ]
        rows.append(",".join([*cells, "12.5"]))
        codes.append(drive.codes[i])
        if i % missing == 0:
            rows.append(",".join([*cells[:-1], "9" if "return_number" in named else cells[-1], ""]))
            codes.append(0)
    path.write_text("\n".join(rows) + "\n")
    np.save(path.with_suffix(".npy"), np.array(codes, np.uint8))
    return path


def codes_of(path: Path) -> NDArray[np.uint8]:
    return np.asarray(laspy.read(path).classification, np.uint8)


@pytest.fixture
def drive() -> Drive:
    return Drive()


def run(folder: Path, drive: Drive, record: NDArray[np.int64], *, codes: Any = 0, **options: Any) -> TransferSummary:
    raw = write_raw(folder / "drive.csv", drive)
    registered = write_las(folder / "registered.las", drive, record, codes=codes)
    return transfer(
        raw.with_suffix(".npy"), registered, folder / "out.las", TransferOptions(**options), points=raw
    )  # fmt: skip


def test_raw_text_and_shuffled_tiles_with_a_fifth_removed(drive: Drive, tmp_path: Path) -> None:
    record = drive.registered()
    summary = run(tmp_path, drive, record)
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])
    counts = summary.counts
    assert (counts.n_points, counts.n_matched, counts.n_labels) == (len(record), len(record), len(drive))
    assert counts.n_labels_matched == len(record)
    assert counts.n_repeated == counts.n_shared == counts.n_other_return == 0
    assert counts.n_changed == np.count_nonzero(drive.codes[record] != 0)


@pytest.mark.parametrize(("form", "suffix"), [(1, ".las"), (3, ".laz"), (6, ".laz"), (7, ".las")])
def test_everything_else_stays_bit_for_bit(drive: Drive, tmp_path: Path, form: int, suffix: str) -> None:
    record = drive.registered()
    raw = write_raw(tmp_path / "drive.csv", drive)
    source = write_las(
        tmp_path / f"registered{suffix}", drive, record, form=form, codes=12, mine=np.arange(len(record))
    )
    with source.open("ab") as handle:
        handle.write(b"bytes behind the points")
    output = tmp_path / f"out{suffix}"
    transfer(raw.with_suffix(".npy"), source, output, points=raw)
    old, new = parse(source), parse(output)
    class_byte = 16 if form >= 6 else 15
    mask = 0xFF if form >= 6 else 0x1F
    assert np.array_equal(new.records[:, class_byte] & mask, drive.codes[record])
    assert np.array_equal(new.records[:, class_byte] & (0xFF ^ mask), old.records[:, class_byte] & (0xFF ^ mask))
    new.records[:, class_byte] = old.records[:, class_byte]
    assert np.array_equal(new.records, old.records)
    assert new.kept_vlrs() == old.kept_vlrs()
    assert new.tail == old.tail


def test_points_without_partner_keep_their_class(drive: Drive, tmp_path: Path) -> None:
    record = drive.registered()
    half = Drive()
    raw = write_raw(tmp_path / "drive.csv", half)
    codes = np.load(raw.with_suffix(".npy"))
    codes[len(codes) // 2 :] = 0  # as if those shots had no return
    np.save(raw.with_suffix(".npy"), codes)
    registered = write_las(tmp_path / "registered.las", drive, record, codes=17)
    summary = transfer(raw.with_suffix(".npy"), registered, tmp_path / "out.las", points=raw)
    found = codes_of(tmp_path / "out.las")
    kept = found == 17
    assert 0 < summary.counts.n_matched < len(record)
    assert np.count_nonzero(kept) == len(record) - summary.counts.n_matched
    assert np.array_equal(found[~kept], drive.codes[record][~kept])
    assert drive.time[record][kept].min() >= drive.time[record][~kept].max()


def test_codes_above_31_upgrade_the_point_format(drive: Drive, tmp_path: Path) -> None:
    record = drive.registered()
    drive.codes[drive.codes == 6] = 64
    raw = write_raw(tmp_path / "drive.csv", drive)
    registered = write_las(tmp_path / "registered.las", drive, record, form=1)
    summary = transfer(raw.with_suffix(".npy"), registered, tmp_path / "out.las", points=raw)
    las = laspy.read(tmp_path / "out.las")
    assert las.point_format.id == 6
    assert np.array_equal(las.classification, drive.codes[record])
    assert np.array_equal(las.gps_time, drive.time[record])
    assert "upgraded to 6" in " ".join(summary.record.notices)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet", ".las"])
def test_every_kind_of_labels_gives_the_same(drive: Drive, tmp_path: Path, suffix: str) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    record = drive.registered()
    raw = write_raw(tmp_path / "drive.csv", drive)
    codes = np.load(raw.with_suffix(".npy"))
    labels = tmp_path / f"labels{suffix}"
    if suffix == ".parquet":
        parquet.write_table(pa.table({"record": np.arange(len(codes)), "class": codes}), labels)
    elif suffix == ".las":
        write_las(labels, drive, np.arange(len(drive)), codes=drive.codes)
    else:
        text = "record,class,name\n" + "".join(f"{i},{code},x\n" for i, code in enumerate(codes))
        labels.write_bytes(gzip.compress(text.encode()) if suffix.endswith(".gz") else text.encode())
    registered = write_las(tmp_path / "registered.las", drive, record)
    transfer(labels, registered, tmp_path / "out.las", points=None if suffix == ".las" else raw)
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def test_labels_of_a_raw_las_and_text_with_time_and_class(drive: Drive, tmp_path: Path) -> None:
    record = drive.registered()
    registered = write_las(tmp_path / "registered.laz", drive, record)
    np.save(tmp_path / "labels.npy", drive.codes)
    raw = write_las(tmp_path / "drive.laz", drive, np.arange(N))
    transfer(tmp_path / "labels.npy", registered, tmp_path / "a.las", points=raw)
    table = write_raw(tmp_path / "labels.csv", drive, missing=10**9, label=drive.codes)
    text = table.read_text().splitlines()
    table.write_text("\n".join([text[0], *(line for line in text[1:] if not line.endswith(","))]) + "\n")
    transfer(table, registered, tmp_path / "b.las")
    for name in ("a.las", "b.las"):
        assert np.array_equal(codes_of(tmp_path / name), drive.codes[record])


def test_raw_dump_with_a_layout(drive: Drive, tmp_path: Path) -> None:
    from prc_cli.formats.options import Layout

    raw = tmp_path / "drive.bin"
    fields = [("time", "f8"), ("return_number", "u1"), ("range", "f4")]
    records = np.zeros(len(drive), [(name, f"<{kind}") for name, kind in fields])
    records["time"], records["return_number"], records["range"] = drive.time, drive.returns, 5
    records.tofile(raw)
    np.save(tmp_path / "labels.npy", drive.codes)
    layout = Layout.model_validate({"fields": [{"name": name, "type": kind} for name, kind in fields]})
    record = drive.registered()
    registered = write_las(tmp_path / "registered.las", drive, record)
    transfer(tmp_path / "labels.npy", registered, tmp_path / "out.las", points=raw, layout=layout)
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def test_the_order_of_either_side_changes_nothing(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(order, "_SortedSource", _small_runs(order._SortedSource))
    shuffled = RNG(3).permutation(len(drive))
    record = drive.registered()
    registered = write_las(tmp_path / "registered.las", drive, record)
    labels = write_las(tmp_path / "labels.las", drive, shuffled, codes=drive.codes[shuffled])
    transfer(labels, registered, tmp_path / "out.las")
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def _small_runs(source: Callable[..., Any]) -> Callable[..., Any]:
    return lambda of, run_records, merge_records: source(of, 500, 1100)


# --- keys


def test_seconds_of_week_against_adjusted_standard_time(drive: Drive, tmp_path: Path) -> None:
    offset = 2300 * 604_800.0 - 1e9
    record = drive.registered()
    raw = write_raw(tmp_path / "drive.csv", drive)
    registered = write_las(tmp_path / "registered.las", drive, record, time=drive.time[record] + offset)
    labels = raw.with_suffix(".npy")
    with pytest.raises(InputError, match=r"nothing overlaps; .*seconds of the GPS week: --time-offset 391040000$"):
        transfer(labels, registered, tmp_path / "out.las", points=raw)
    transfer(labels, registered, tmp_path / "out.las", TransferOptions(time_offset_s=offset), points=raw)
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def test_the_offset_is_found_the_other_way_round_too(drive: Drive, tmp_path: Path) -> None:
    late = Drive(start_s=START_S + 2300 * 604_800.0 - 1e9)
    labels = write_las(tmp_path / "labels.las", late, np.arange(N), codes=late.codes)
    registered = write_las(tmp_path / "registered.las", drive, drive.registered())
    with pytest.raises(InputError, match=r"--time-offset -391040000$"):
        transfer(labels, registered, tmp_path / "out.las")


def test_a_week_that_ends_within_the_drive(tmp_path: Path) -> None:
    offset = 2300 * 604_800.0 - 1e9
    drive = Drive(start_s=604_800 - 1000 * SHOT_S)
    record = drive.registered()
    registered = write_las(tmp_path / "registered.las", drive, record, time=drive.time[record] + offset)
    drive.time = drive.time % 604_800
    raw = write_raw(tmp_path / "drive.csv", drive)
    options = TransferOptions(time_offset_s=offset, tolerance_s=1e-6)
    summary = transfer(raw.with_suffix(".npy"), registered, tmp_path / "out.las", options, points=raw)
    assert summary.counts.n_matched == len(record)
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def test_rounded_text_needs_a_tolerance_and_says_which(tmp_path: Path) -> None:
    drive = Drive(start_s=START_S + 0.123456789)
    record = drive.registered()
    raw = write_raw(tmp_path / "drive.csv", drive, digits=6)
    registered = write_las(tmp_path / "registered.las", drive, record)
    labels = raw.with_suffix(".npy")
    with pytest.raises(InputError, match=r"0 of .* points .* within 1e-06 s: --tolerance 1e-06$"):
        transfer(labels, registered, tmp_path / "out.las", points=raw)
    transfer(labels, registered, tmp_path / "out.las", TransferOptions(tolerance_s=1e-6), points=raw)
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def test_labels_without_returns_give_every_return_of_a_shot_its_class(drive: Drive, tmp_path: Path) -> None:
    first = drive.returns == 1
    shots = Drive()
    shots.time, shots.codes, shots.returns = drive.time[first], drive.codes[first], drive.returns[first]
    raw = write_raw(tmp_path / "drive.csv", shots, return_number=None)
    record = drive.registered()
    registered = write_las(tmp_path / "registered.las", drive, record)
    summary = transfer(raw.with_suffix(".npy"), registered, tmp_path / "out.las", points=raw)
    of_shot = shots.codes[np.searchsorted(shots.time, drive.time[record])]
    assert np.array_equal(codes_of(tmp_path / "out.las"), of_shot)
    assert summary.counts.n_repeated > 0
    assert "have the key of another point" in " ".join(summary.record.notices)


def test_other_returns_are_said_and_can_be_ignored(drive: Drive, tmp_path: Path) -> None:
    labels = write_las(tmp_path / "labels.las", drive, np.arange(N), codes=drive.codes)
    record = np.flatnonzero(drive.returns == 1)
    drive.returns[:] = 0  # as some programs leave it
    registered = write_las(tmp_path / "registered.las", drive, record)
    with pytest.raises(InputError, match=r"another return number: --ignore-return$"):
        transfer(labels, registered, tmp_path / "out.las")
    options = TransferOptions(ignore_return=True)
    assert transfer(labels, registered, tmp_path / "out.las", options).counts.n_matched == len(record)


def test_scanners_that_share_times_are_kept_apart(tmp_path: Path) -> None:
    drive = Drive()
    both = Drive()
    both.time, both.returns = np.concatenate([drive.time, drive.time]), np.concatenate([drive.returns, drive.returns])
    both.xyz, both.codes = np.concatenate([drive.xyz, drive.xyz]), RNG(5).choice([2, 5, 6], 2 * N).astype(np.uint8)
    scanner = np.repeat([0, 1], N).astype(np.uint16)
    labels = write_las(tmp_path / "labels.las", both, np.arange(2 * N), codes=both.codes, head=scanner)
    record = both.registered()
    registered = write_las(tmp_path / "registered.las", both, record, head=scanner[record])
    summary = transfer(labels, registered, tmp_path / "out.las", TransferOptions(same=("head",)))
    assert summary.counts.n_shared == 0
    assert np.array_equal(codes_of(tmp_path / "out.las"), both.codes[record])
    text = "have several labels of their key, which differ, expected at most 50%; .*--same"
    refused(tmp_path, text, labels, registered, tmp_path / "mixed.las")
    summary = transfer(labels, registered, tmp_path / "mixed.las", TransferOptions(min_matched=0.1))
    assert summary.counts.n_by_majority > 0
    assert "have several labels of their key, which differ for" in " ".join(summary.record.notices)


@pytest.mark.parametrize("by", ["record:raw_index", "dimension:raw_index"])
def test_by_record_index_and_by_dimension(drive: Drive, tmp_path: Path, by: str) -> None:
    record = drive.registered()
    index = (record + (0 if by.startswith("record") else 10**12)).astype(np.int64)
    registered = write_las(tmp_path / "registered.las", drive, record, form=0, raw_index=index)
    everything = np.arange(N, dtype=np.int64) + 10**12
    labels = write_las(tmp_path / "labels.las", drive, np.arange(N), codes=drive.codes, form=0, raw_index=everything)
    transfer(labels, registered, tmp_path / "out.las", TransferOptions(match=by))
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])
    if by.startswith("record"):  # labels alone have their order
        np.save(tmp_path / "labels.npy", drive.codes)
        transfer(tmp_path / "labels.npy", registered, tmp_path / "again.las", TransferOptions(match=by))
        assert np.array_equal(codes_of(tmp_path / "again.las"), drive.codes[record])


def test_by_equal_order_with_and_without_missing_shots(drive: Drive, tmp_path: Path) -> None:
    registered = write_las(tmp_path / "registered.las", drive, np.arange(N), form=2)
    np.save(tmp_path / "all.npy", drive.codes)
    raw = write_raw(tmp_path / "drive.csv", drive)
    for labels in (tmp_path / "all.npy", raw.with_suffix(".npy")):
        output = tmp_path / f"{labels.stem}.las"
        transfer(labels, registered, output, TransferOptions(match="record"))
        assert np.array_equal(codes_of(output), drive.codes)
    np.save(tmp_path / "short.npy", drive.codes[:-1])
    with pytest.raises(InputError, match="4,999 records .* expected 5,000 as .* to match by equal order"):
        transfer(tmp_path / "short.npy", registered, tmp_path / "out.las", TransferOptions(match="record"))


def test_segment_ids_can_go_along(drive: Drive, tmp_path: Path) -> None:
    record = drive.registered()
    segment = RNG(2).integers(1, 1 << 30, N).astype(np.uint32)
    labels = write_las(tmp_path / "labels.las", drive, np.arange(N // 2), codes=drive.codes[: N // 2],
                       segment_id=segment[: N // 2])  # fmt: skip
    registered = write_las(tmp_path / "registered.las", drive, record)
    transfer(labels, registered, tmp_path / "out.las", TransferOptions(carry=("segment_id",)))
    las = laspy.read(tmp_path / "out.las")
    assert np.array_equal(las["segment_id"], np.where(record < N // 2, segment[record], 0))


# --- the run record


def test_the_run_is_recorded_with_both_inputs(drive: Drive, tmp_path: Path) -> None:
    import hashlib

    summary = run(tmp_path, drive, drive.registered())
    beside = json.loads((tmp_path / "out.las.prc.json").read_text())
    assert beside == summary.record.as_dict()
    assert beside.pop("output")["size"] == (tmp_path / "out.las").stat().st_size
    assert beside == json.loads(parse(tmp_path / "out.las").record_payloads()[0])
    for name, found in (("drive.npy", beside["transfer"]["labels"]), ("drive.csv", beside["transfer"]["points"]),
                        ("registered.las", beside["input"])):  # fmt: skip
        assert found["name"] == name
        assert found["sha256"] == hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
    assert beside["transfer"]["counts"]["n_matched"] == summary.counts.n_matched
    assert beside["config"]["transfer"]["match"] == "time"
    assert sum(item["count"] for item in beside["classes"]) == summary.counts.n_points


def test_the_same_transfer_gives_the_same_bytes(drive: Drive, tmp_path: Path) -> None:
    run(tmp_path, drive, drive.registered())
    first = (tmp_path / "out.las").read_bytes()
    (tmp_path / "out.las").unlink()
    (tmp_path / "out.las.prc.json").unlink()
    run(tmp_path, drive, drive.registered())
    assert (tmp_path / "out.las").read_bytes() == first


# --- refusals


def bare(folder: Path, drive: Drive, **changes: Any) -> tuple[Path, Path, Path]:
    raw = write_raw(folder / "drive.csv", drive)
    registered = write_las(folder / "registered.las", drive, drive.registered(), **changes)
    return raw.with_suffix(".npy"), raw, registered


def refused(folder: Path, text: str, *arguments: Any, kind: type[PrcError] = InputError, **more: Any) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(kind, match=text) as error:
        transfer(*arguments, **more)
    assert "\n" not in str(error.value)
    assert sorted(folder.iterdir()) == before


def test_no_time_on_either_side(drive: Drive, tmp_path: Path) -> None:
    labels, raw, registered = bare(tmp_path, drive)
    no_time = write_las(tmp_path / "form0.las", drive, np.arange(N), form=0)
    zero = write_las(tmp_path / "zero.las", drive, np.arange(N), time=np.zeros(N))
    for path in (no_time, zero):
        refused(tmp_path, f"{path.name}: no time to match by", labels, path, tmp_path / "out.las", points=raw)
    text = tmp_path / "ranges.csv"
    text.write_text("range_m\n1.0\n2.0\n")
    refused(tmp_path, "ranges.csv: no time to match by, found: range", labels, registered, tmp_path / "out.las",
            points=text)  # fmt: skip
    refused(tmp_path, "holds classes alone.*--points RAW", labels, registered, tmp_path / "out.las")


def test_not_a_number_or_all_equal(drive: Drive, tmp_path: Path) -> None:
    labels, raw, _ = bare(tmp_path, drive)
    out = tmp_path / "out.las"
    time = drive.time.copy()
    time[11] = np.nan
    bad = write_las(tmp_path / "nan.las", drive, np.arange(N), time=time)
    refused(tmp_path, "nan.las: record 11: found time nan, expected a finite time", labels, bad, out, points=raw)
    bad = write_las(tmp_path / "equal.las", drive, np.arange(N), time=np.full(N, 5.0))
    refused(
        tmp_path, "equal.las: all 5,000 values of gps_time are 5, expected one a shot", labels, bad, out, points=raw
    )
    drive.time[20] = np.nan
    nan_labels = write_las(tmp_path / "labels.las", drive, np.arange(N), codes=2)
    refused(tmp_path, "labels.las: record 20: found time nan", nan_labels, tmp_path / "registered.las", out)


def test_lengths_that_differ(drive: Drive, tmp_path: Path) -> None:
    labels, raw, registered = bare(tmp_path, drive)
    codes = np.load(labels)
    for name, part in (("short", codes[:-5]), ("long", np.append(codes, [2, 2, 2]))):
        np.save(tmp_path / f"{name}.npy", part)
        text = f"found {len(part)} class codes, expected .*drive.csv"
        refused(tmp_path, text, tmp_path / f"{name}.npy", registered, tmp_path / "out.las", points=raw)


@pytest.mark.parametrize(
    ("times", "overlaps"), [((3.0, 5.0), True), ((-5.0, -2.0), True), ((3.1, 5.0), False), ((-5.0, -2.1), False)]
)
def test_times_overlap_where_they_touch_within_the_tolerance(times: tuple[float, float], overlaps: bool) -> None:
    """Labels from -1 to 2 s, with a tolerance of 1 s."""
    labels, points = Survey(9, 9, -1.0, 2.0, True), Survey(9, 9, *times, True)
    named = SimpleNamespace(path="drive.las")
    made = sides.TransferSides(named, named, (labels, points), 1.0, assumptions=[])  # type: ignore[arg-type]
    if overlaps:
        sides._refuse_apart(made, TransferOptions())
    else:
        with pytest.raises(InputError, match="from -1 to 2: nothing overlaps"):
            sides._refuse_apart(made, TransferOptions())


def test_nothing_in_common_and_too_little(drive: Drive, tmp_path: Path) -> None:
    labels, raw, _ = bare(tmp_path, drive)
    out = tmp_path / "out.las"
    other = write_las(tmp_path / "other.las", Drive(start_s=1000.0), np.arange(N))
    refused(tmp_path, "nothing overlaps; are these the same drive", labels, other, out, points=raw)
    shifted = write_las(tmp_path / "shifted.las", drive, np.arange(N), time=drive.time + SHOT_S * 3000)
    refused(tmp_path, r"points and .* labels of .*drive.csv match, expected at least 50% of the smaller side", labels,
            shifted, out, points=raw)  # fmt: skip
    summary = transfer(labels, shifted, out, TransferOptions(min_matched=0.1), points=raw)
    assert 0.1 < summary.counts.share < 0.5
    between = write_las(tmp_path / "between.las", drive, np.arange(N), time=drive.time + SHOT_S / 2)
    # a tolerance would match every point, with the wrong shot
    refused(tmp_path, "0 of 5,000 points .* fall between those of the labels", labels, between,
            tmp_path / "no.las", TransferOptions(min_matched=0.0), points=raw)  # fmt: skip
    summary = transfer(labels, between, tmp_path / "no.las", TransferOptions(tolerance_s=SHOT_S), points=raw)
    assert "exceeds half the mean step between the labels" in summary.record.notices[0]
    assert summary.counts.largest_difference == pytest.approx(SHOT_S / 2, rel=1e-3)


def test_files_of_the_wrong_kind(drive: Drive, tmp_path: Path) -> None:
    labels, raw, registered = bare(tmp_path, drive)
    out = tmp_path / "out.las"
    refused(tmp_path, "drive.csv: found suffix '.csv', expected the registered points as .las", labels, raw, out)
    fake = tmp_path / "fake.las"
    fake.write_bytes(b"x" * 1000)
    refused(tmp_path, "fake.las", labels, fake, out, points=raw)
    refused(tmp_path, "no such file", labels, tmp_path / "absent.las", out, points=raw)
    refused(tmp_path, "out.csv: found suffix '.csv', expected .las or .laz", labels, registered, tmp_path / "out.csv",
            kind=ConfigError)  # fmt: skip
    refused(tmp_path, "keys of its own", registered, registered, out, points=raw, kind=ConfigError)
    refused(tmp_path, "found suffix '.tif', expected classes", tmp_path / "a.tif", registered, out, points=raw)
    refused(tmp_path, "inputs are never modified", labels, registered, registered, points=raw, overwrite=True,
            kind=OutputExistsError)  # fmt: skip
    np.savez(tmp_path / "image.npz", range_m=np.ones((3, 4)))
    refused(tmp_path, "range image", labels, registered, out, points=tmp_path / "image.npz")
    with registered.open("r+b") as handle:
        handle.truncate(registered.stat().st_size - 500)
    refused(tmp_path, "registered.las", labels, registered, out, points=raw)


def test_codes_that_are_no_las_classes(drive: Drive, tmp_path: Path) -> None:
    labels, raw, registered = bare(tmp_path, drive)
    codes = np.load(labels).astype(np.int32)
    codes[2] = 1202
    np.save(labels, codes)
    text = "record 2: found the class code 1202, expected 0 to 255"
    refused(tmp_path, text, labels, registered, tmp_path / "out.las", points=raw)


def test_keys_that_are_no_whole_numbers(drive: Drive, tmp_path: Path) -> None:
    value = np.arange(N) + 0.5
    labels = write_las(tmp_path / "labels.las", drive, np.arange(N), key=value)
    refused(tmp_path, "record 0: found key 0.5, expected a whole number", labels, labels, tmp_path / "out.las",
            TransferOptions(match="dimension:key"))  # fmt: skip
    refused(tmp_path, "no dimension 'nope'", labels, labels, tmp_path / "out.las",
            TransferOptions(match="dimension:nope"), kind=ConfigError)  # fmt: skip


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"match": "space"}, "--match: found 'space', expected time, order, record"),
        ({"match": "dimension:"}, "--match"),
        ({"match": "order", "tolerance_s": 1.0}, "are for times"),
        ({"tolerance_s": -1.0}, "--tolerance: found -1.0"),
        ({"tolerance_s": float("nan")}, "--tolerance"),
        ({"time_offset_s": float("inf")}, "--time-offset"),
        ({"min_matched": 1.5}, "--min-matched"),
        ({"same": ("a", "b", "c")}, "--same: found 3"),
        ({"carry": ("height",)}, "--carry: found 'height', expected one of segment_id"),
    ],
)
def test_options_that_make_no_sense(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        TransferOptions(**options)


def test_other_coordinate_systems_are_said_but_do_not_matter(drive: Drive, tmp_path: Path) -> None:
    record = drive.registered()
    labels = write_las(tmp_path / "labels.las", drive, np.arange(N), codes=drive.codes)
    registered = write_las(tmp_path / "registered.las", drive, record)
    for path, code in ((labels, 32635), (registered, 3067)):
        las = laspy.read(path)
        keys = struct.pack("<8H", 1, 1, 0, 1, 3072, 0, 1, code)
        las.header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", keys))
        las.write(path)
    summary = transfer(labels, registered, tmp_path / "out.las")
    assert summary.record.notices == (
        "the coordinate systems of labels and points differ; the match does not use coordinates",
    )
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


# --- a real street


@pytest.mark.data
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_oakland_as_raw_text_and_as_shuffled_tiles(real_data: Path, tmp_path: Path, suffix: str) -> None:
    rows = np.genfromtxt(real_data / "oakland" / "oakland_1.csv.gz", delimiter=",", skip_header=1)
    time = 412_345.678901 + np.arange(len(rows)) / 9600.0
    raw = tmp_path / "drive.csv"
    lines = (f"{t!r},{row[0]:g},{row[1]:g}," + ("" if np.isnan(row[3]) else f"{row[3]!r}")
             for t, row in zip(time.tolist(), rows.tolist(), strict=True))  # fmt: skip
    with raw.open("w") as handle:
        handle.write("time,line,column,range_m\n")
        handle.writelines(f"{line}\n" for line in lines)
    from prc_cli import classify
    from prc_cli.config import load_config

    classify(raw, tmp_path / "labels.npy", load_config(preset="urban"))
    classify(raw, tmp_path / "labels.las", load_config(preset="urban"))
    labels = np.load(tmp_path / "labels.npy")
    rng = RNG(0)
    left = np.flatnonzero(np.isfinite(rows[:, 3]) & (rng.random(len(rows)) < 0.8))
    tile = np.floor(rows[left, 4] / 10) * 1000 + np.floor(rows[left, 5] / 10)
    _, tile = np.unique(tile, return_inverse=True)
    left = left[np.lexsort((rng.random(len(left)), rng.permutation(tile.max() + 1)[tile]))]
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [0.01] * 3, np.floor(rows[left, 4:7].min(axis=0))
    las = laspy.LasData(header)
    las.x, las.y, las.z = rows[left, 4:7].T
    las.gps_time = time[left]
    las.return_number = las.number_of_returns = np.ones(len(left), np.uint8)
    source = tmp_path / f"registered{suffix}"
    las.write(source)
    summary = transfer(tmp_path / "labels.npy", source, tmp_path / f"out{suffix}", points=raw)
    assert np.array_equal(codes_of(tmp_path / f"out{suffix}"), labels[left])
    assert summary.counts.n_matched == summary.counts.n_points == len(left)
    assert summary.counts.n_labels == np.count_nonzero(labels)
    old, new = parse(source), parse(tmp_path / f"out{suffix}")
    new.records[:, 15] = old.records[:, 15]
    assert np.array_equal(new.records, old.records)
    # a LAS file built from the same run has the times itself
    transfer(tmp_path / "labels.las", source, tmp_path / f"again{suffix}")
    assert np.array_equal(codes_of(tmp_path / f"again{suffix}"), labels[left])


@pytest.mark.data
@pytest.mark.parametrize("name", ["fullwave_pf10.laz", "mls_not_in_time_order.las", "plane.laz"])
def test_a_real_file_onto_itself_changes_nothing(real_data: Path, tmp_path: Path, name: str) -> None:
    """Of equally many points and labels of a key each gets its own."""
    source = real_data / "las" / name
    summary = transfer(source, source, tmp_path / name)
    assert summary.counts.n_matched == summary.counts.n_labels_matched == summary.counts.n_points
    assert summary.counts.n_changed == 0
    assert np.array_equal(parse(tmp_path / name).records, parse(source).records)


@pytest.mark.data
def test_coarse_time_stamps_of_a_profiler(real_data: Path, tmp_path: Path) -> None:
    """Four shots share a time stamp; intensity tells them apart."""
    labels = laspy.read(real_data / "profiler" / "jakarto_0.02s.las")
    codes = RNG(0).integers(1, 30, len(labels.points)).astype(np.uint8)
    labels.classification = codes
    labels.write(tmp_path / "labels.las")
    left = RNG(1).permutation(len(codes))[: len(codes) * 4 // 5]
    registered = laspy.LasData(labels.header)
    registered.points = labels.points[left].copy()
    registered.classification = np.zeros(len(left), np.uint8)
    registered.write(tmp_path / "registered.las")
    paths = tmp_path / "labels.las", tmp_path / "registered.las", tmp_path / "out.las"
    refused(tmp_path, "several labels of their key", *paths)
    transfer(*paths, TransferOptions(same=("intensity",)))
    assert np.mean(codes_of(tmp_path / "out.las") == codes[left]) > 0.995
