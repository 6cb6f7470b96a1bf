"""Transfer of classes from a raw run to registered points.

Correct classes, all else unchanged, errors.
"""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray

from prc_cli.core.errors import InputError, PrcError
from prc_cli.jobs.transfer import TransferSummary, transfer
from prc_cli.jobs.transfer.options import TransferOptions

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
    header.scales = [0.001] * 3
    header.offsets = [0.0] * 3
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


def write_raw(
    path: Path, drive: Drive, *, missing: int = 7, digits: int | None = None, **columns: Any
) -> Path:
    """A raw CSV in which every ``missing``-th row more is a shot without return.

    Its labels go to ``.npy`` beside.
    """
    rows = []
    codes = []
    named = {"time": drive.time, "return_number": drive.returns, **columns}
    named = {name: values for name, values in named.items() if values is not None}
    rows.append(",".join([*named, "range_m"]))
    for i in range(len(drive)):
        cells = [
            repr(float(values[i]))
            if digits is None or name != "time"
            else f"{values[i]:.{digits}f}"
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
def drive():
    return Drive()


def run(
    folder: Path, drive: Drive, record: NDArray[np.int64], *, codes: Any = 0, **options: Any
) -> TransferSummary:
    raw = write_raw(folder / "drive.csv", drive)
    registered = write_las(folder / "registered.las", drive, record, codes=codes)
    return transfer(
        raw.with_suffix(".npy"),
        registered,
        folder / "out.las",
        TransferOptions(**options),
        points=raw,
    )


def test_points_whose_labels_are_not_sure_keep_their_class(drive, tmp_path):
    record = drive.registered()
    confidence = RNG(4).integers(0, 101, N).astype(np.uint8)
    source = (tmp_path / "labels.las", drive, np.arange(N))
    labels = write_las(*source, codes=drive.codes, confidence=confidence)
    registered = write_las(tmp_path / "registered.las", drive, record, codes=9)
    options = TransferOptions(min_confidence=60, carry=("confidence",))
    summary = transfer(labels, registered, tmp_path / "out.las", options)
    sure = confidence[record] >= 60
    assert np.array_equal(codes_of(tmp_path / "out.las"), np.where(sure, drive.codes[record], 9))
    carried = laspy.read(tmp_path / "out.las")["confidence"]
    assert np.array_equal(carried, np.where(sure, confidence[record], 0))
    assert f"{np.count_nonzero(~sure):,} points keep their class" in summary.record.notices[0]
    assert summary.counts.n_changed == np.count_nonzero(sure)


def test_points_without_partner_keep_their_class(drive, tmp_path):
    record = drive.registered()
    half = Drive()
    raw = write_raw(tmp_path / "drive.csv", half)
    codes = np.load(raw.with_suffix(".npy"))
    codes[len(codes) // 2 :] = 0  # as if those shots had no return
    np.save(raw.with_suffix(".npy"), codes)
    registered = write_las(tmp_path / "registered.las", drive, record, codes=17)
    summary = transfer(raw.with_suffix(".npy"), registered, tmp_path / "out.las", points=raw)
    written = codes_of(tmp_path / "out.las")
    kept = written == 17
    assert 0 < summary.counts.n_matched < len(record)
    assert np.count_nonzero(kept) == len(record) - summary.counts.n_matched
    assert np.array_equal(written[~kept], drive.codes[record][~kept])
    assert drive.time[record][kept].min() >= drive.time[record][~kept].max()


# --- keys


def test_seconds_of_week_against_adjusted_standard_time(drive, tmp_path):
    offset = 2300 * 604_800.0 - 1e9
    record = drive.registered()
    raw = write_raw(tmp_path / "drive.csv", drive)
    registered = write_las(
        tmp_path / "registered.las", drive, record, time=drive.time[record] + offset
    )
    labels = raw.with_suffix(".npy")
    with pytest.raises(
        InputError,
        match=r"they do not overlap; .*seconds of the GPS week: --time-offset 391040000$",
    ):
        transfer(labels, registered, tmp_path / "out.las", points=raw)
    transfer(
        labels, registered, tmp_path / "out.las", TransferOptions(time_offset_s=offset), points=raw
    )
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])


def test_labels_without_returns_give_every_return_of_a_shot_its_class(drive, tmp_path):
    first = drive.returns == 1
    shots = Drive()
    shots.time = drive.time[first]
    shots.codes = drive.codes[first]
    shots.returns = drive.returns[first]
    raw = write_raw(tmp_path / "drive.csv", shots, return_number=None)
    record = drive.registered()
    registered = write_las(tmp_path / "registered.las", drive, record)
    summary = transfer(raw.with_suffix(".npy"), registered, tmp_path / "out.las", points=raw)
    of_shot = shots.codes[np.searchsorted(shots.time, drive.time[record])]
    assert np.array_equal(codes_of(tmp_path / "out.las"), of_shot)
    assert summary.counts.n_repeated > 0
    assert "have the key of another point" in " ".join(summary.record.notices)


def test_scanners_that_share_times_are_kept_apart(tmp_path):
    drive = Drive()
    both = Drive()
    both.time = np.concatenate([drive.time, drive.time])
    both.returns = np.concatenate([drive.returns, drive.returns])
    both.xyz = np.concatenate([drive.xyz, drive.xyz])
    both.codes = RNG(5).choice([2, 5, 6], 2 * N).astype(np.uint8)
    scanner = np.repeat([0, 1], N).astype(np.uint16)
    labels = write_las(
        tmp_path / "labels.las", both, np.arange(2 * N), codes=both.codes, head=scanner
    )
    record = both.registered()
    registered = write_las(tmp_path / "registered.las", both, record, head=scanner[record])
    summary = transfer(labels, registered, tmp_path / "out.las", TransferOptions(same=("head",)))
    assert summary.counts.n_shared == 0
    assert np.array_equal(codes_of(tmp_path / "out.las"), both.codes[record])
    text = (
        "several labels of their key, which differ, expected at most 50%; .*--match time.intensity"
    )
    refused(tmp_path, text, labels, registered, tmp_path / "mixed.las")
    summary = transfer(labels, registered, tmp_path / "mixed.las", TransferOptions(min_matched=0.1))
    assert summary.counts.n_by_majority > 0
    assert "have several labels of their key, which differ for" in " ".join(summary.record.notices)


@pytest.mark.parametrize("by", ["record:raw_index", "dimension:raw_index"])
def test_by_record_index_and_by_dimension(drive, tmp_path, by):
    record = drive.registered()
    index = (record + (0 if by.startswith("record") else 10**12)).astype(np.int64)
    registered = write_las(tmp_path / "registered.las", drive, record, form=0, raw_index=index)
    everything = np.arange(N, dtype=np.int64) + 10**12
    labels = write_las(
        tmp_path / "labels.las",
        drive,
        np.arange(N),
        codes=drive.codes,
        form=0,
        raw_index=everything,
    )
    transfer(labels, registered, tmp_path / "out.las", TransferOptions(match=by))
    assert np.array_equal(codes_of(tmp_path / "out.las"), drive.codes[record])
    if by.startswith("record"):  # labels alone have their order
        np.save(tmp_path / "labels.npy", drive.codes)
        transfer(
            tmp_path / "labels.npy", registered, tmp_path / "again.las", TransferOptions(match=by)
        )
        assert np.array_equal(codes_of(tmp_path / "again.las"), drive.codes[record])


# --- the run record


# --- refusals


def bare(folder: Path, drive: Drive, **changes: Any) -> tuple[Path, Path, Path]:
    raw = write_raw(folder / "drive.csv", drive)
    registered = write_las(folder / "registered.las", drive, drive.registered(), **changes)
    return raw.with_suffix(".npy"), raw, registered


def refused(
    folder: Path, text: str, *arguments: Any, kind: type[PrcError] = InputError, **more: Any
) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(kind, match=text) as error:
        transfer(*arguments, **more)
    assert "\n" not in str(error.value)
    assert sorted(folder.iterdir()) == before


def test_no_time_on_either_side(drive, tmp_path):
    labels, raw, registered = bare(tmp_path, drive)
    no_time = write_las(tmp_path / "form0.las", drive, np.arange(N), form=0)
    zero = write_las(tmp_path / "zero.las", drive, np.arange(N), time=np.zeros(N))
    for path in (no_time, zero):
        refused(
            tmp_path,
            f"{path.name}: no time to match by",
            labels,
            path,
            tmp_path / "out.las",
            points=raw,
        )
    text = tmp_path / "ranges.csv"
    text.write_text("range_m\n1.0\n2.0\n")
    refused(
        tmp_path,
        "ranges.csv: no time to match by, found: range",
        labels,
        registered,
        tmp_path / "out.las",
        points=text,
    )
    refused(
        tmp_path, "contains only classes.*--points RAW", labels, registered, tmp_path / "out.las"
    )


# --- a real street


def test_a_tolerance_of_the_next_label_is_told(drive, tmp_path):
    step_s = (drive.time[-1] - drive.time[0]) / (len(drive) - 1)
    for tolerance_s, is_told in ((0.4 * step_s, False), (0.8 * step_s, True)):
        summary = run(tmp_path, drive, drive.registered(), tolerance_s=tolerance_s)
        assert any("half the mean step" in notice for notice in summary.record.notices) is is_told
        (tmp_path / "out.las").unlink()
        (tmp_path / "out.las.prc.json").unlink(missing_ok=True)


def test_one_time_for_all_labels_is_no_key(drive, tmp_path):
    drive.time[:] = START_S
    with pytest.raises(InputError, match="expected one a shot"):
        run(tmp_path, drive, drive.registered())
