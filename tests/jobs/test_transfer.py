"""Classes of a raw run on registered points: the right code at the right point, all else as it
was."""

import laspy
import numpy as np
import pytest

from prc_cli.jobs.transfer import transfer
from prc_cli.jobs.transfer.options import TransferOptions
from tests.clouds import write_las

N = 2000


@pytest.mark.parametrize(
    "options, apart",
    [
        ({}, "return_number"),
        ({"time_offset_s": 7.5}, "return_number"),
        ({"ignore_return": True}, "return_number"),
        ({"same": ("scanner_channel",)}, "scanner_channel"),
        ({"match": "record:shot"}, "user_data"),
        ({"match": "dimension:shot"}, "user_data"),
        ({"match": "nearest"}, "user_data"),
    ],
)
def test_every_point_has_the_code_of_its_shot_or_keeps_its_class(tmp_path, options, apart):
    """Two shots have one time; of the last ones nobody knows the class."""
    rng = np.random.default_rng(3)
    xyz = rng.uniform(0, 50, (N, 3))
    codes = rng.choice([2, 5, 6, 7], N)
    step = 2 if "ignore_return" in options else 1
    shift_s = options.get("time_offset_s", 0.0)
    for name, record, code, time_s in (
        ("labels", np.arange(0, N - 100, step), codes[: N - 100 : step], 1000 - shift_s),
        ("points", rng.permutation(N)[:1600], np.full(1600, 9), 1000),
    ):
        extra = {"shot": record.astype("u4")}
        columns = {"gps_time": time_s + record // 2 / 64, apart: record % 2 + 1}
        write_las(tmp_path / f"{name}.las", xyz[record], code, extra=extra, **columns)
    labels, points, out = (tmp_path / f"{name}.las" for name in ("labels", "points", "out"))
    summary = transfer(labels, points, out, TransferOptions(**options))
    before = laspy.read(points)
    after = laspy.read(out)
    shot = np.asarray(before["shot"])
    is_known = shot < N - 100
    np.testing.assert_array_equal(
        after.classification, np.where(is_known, codes[shot // step * step], 9)
    )
    assert summary.counts.n_matched == is_known.sum()
    before.classification = after.classification
    assert before.points.array.tobytes() == after.points.array.tobytes()
