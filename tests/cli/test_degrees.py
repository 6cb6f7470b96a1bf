"""Points in longitude and latitude keep their place in a LAS output."""

import laspy
import numpy as np

from tests.street import angles, street


def test_degrees_are_written_in_steps_of_a_millimetre(prc, tmp_path):
    image = street(80)
    line, column = np.nonzero(np.isfinite(image))
    range_m = image[line, column].astype(np.float64)
    angle = angles()[column]
    lon = 25.0 + 0.1 * line / 55_000
    lat = 60.0 + range_m * np.sin(angle) / 111_000
    z = -range_m * np.cos(angle)
    source = tmp_path / "drive.csv"
    output = tmp_path / "drive.las"
    table = np.column_stack([line, column, range_m, np.rad2deg(angle), lon, lat, z])
    header = "scan_line,column,range,scan_angle,x,y,z"
    formats = ["%d", "%d", "%.4f", "%.4f", "%.10f", "%.10f", "%.4f"]
    np.savetxt(source, table, delimiter=",", header=header, comments="", fmt=formats)
    result = prc(f"classify {source} {output} -q --set input.nadir=0 --preset fused")
    assert result.code in (0, 4), result.err
    points = laspy.read(output)
    assert np.abs(np.asarray(points.y) - lat).max() < 2e-8
    assert np.abs(np.asarray(points.x) - lon).max() < 2e-8
    assert "coordinates" not in result.err
