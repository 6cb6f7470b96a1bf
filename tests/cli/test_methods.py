"""The fused presets and the sequential-angle classifier on the command line.

Every kind of input, and errors.
"""

import numpy as np
import pytest

from tests.formats.organised_files import ptx_scan, write_text
from tests.simulated import static_arrays


@pytest.mark.data
def test_cars_of_a_real_street(prc, real_data, tmp_path):
    source = real_data / "oakland" / "oakland_1.csv.gz"
    out = tmp_path / "labels.npy"
    result = prc(f"classify {source} {out} --preset fused --set input.nadir=0")
    assert result.code == 0, result.err
    gates = [word for gate in ("f1.ground=0.99", "f1.car=0.85") for word in ("--fail-under", gate)]
    result = prc(f"evaluate {out} {source} --mapping street_oakland", *gates)
    assert result.code == 0, result.out + result.err
    # the mappings of the papers fold the codes back
    assert prc(f"evaluate {out} {source} --mapping oakland").code == 0


@pytest.mark.slow
@pytest.mark.parametrize("n_points", [0, 1])
def test_a_scan_of_nothing_does_no_harm_to_another(prc, tmp_path, n_points):
    block, _ = static_arrays(0.5, 3.0, 2)
    grid = np.nan_to_num(np.insert(block.xyz_m, 3, 0.5, axis=2))
    nothing = np.zeros((20, 30, 4))
    nothing[3, 4] = n_points * np.array([3, 4, 1, 0.5])
    write_text(tmp_path / "one.ptx", ptx_scan(grid))
    write_text(tmp_path / "two.ptx", ptx_scan(grid) + ptx_scan(nothing))
    for name in ("one", "two"):
        files = f"{tmp_path}/{name}.ptx {tmp_path}/{name}.npy"
        prc(f"classify {files} --preset street-scan -q")
    alone, both = (np.load(tmp_path / f"{name}.npy") for name in ("one", "two"))
    np.testing.assert_array_equal(both[: len(alone)], alone)
    assert np.count_nonzero(both[len(alone) :]) == n_points
