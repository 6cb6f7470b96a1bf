"""The fused presets and the sequential-angle classifier on the command line.

Every kind of input, and errors.
"""

import numpy as np
import pytest

Array = np.ndarray


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
