"""Units of coordinate systems.

Feet become metres, degrees are refused where ranges come from x, y, z.
"""

from dataclasses import replace

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import F64
from prc_cli.formats.systems import in_metres, looks_geographic, refuse_degrees, units_of_system
from tests.streams.record_lists import MemorySource

GEO = 'GEOGCS["WGS 84",DATUM["WGS_1984"],UNIT["degree",0.0174532925199433]]'
FOOT = f'PROJCS["NY",{GEO},PROJECTION["p"],UNIT["US survey foot",0.304800609601219]]'
METRE = f'PROJCS["UTM",{GEO},UNIT["metre",1]]'
MIXED = f'COMPD_CS["both",{METRE},VERT_CS["heights",VERT_DATUM["d",2005],UNIT["foot",0.3048]]]'
NEW = (
    'PROJCRS["x",BASEGEOGCRS["g",ANGLEUNIT["degree",0.0174]],'
    'CS[Cartesian,2],LENGTHUNIT["foot",0.3048]]'
)
BOUND = f'BOUNDCRS[SOURCECRS[{NEW}],TARGETCRS[GEOGCRS["WGS 84",ANGLEUNIT["degree",0.0174]]]]'


@pytest.mark.parametrize(
    "crs, xy_m, z_m",
    [
        (FOOT, 0.304800609601219, 0.304800609601219),
        (METRE, 1.0, 1.0),
        (MIXED, 1.0, 0.3048),
        (NEW, 0.3048, 0.3048),
        (BOUND, 0.3048, 0.3048),
        ("EPSG:2263", 1200 / 3937, 1200 / 3937),
        (GEO, np.nan, 1.0),
        ("EPSG:4326", np.nan, 1.0),
    ],
)
def test_units_of_systems(crs, xy_m, z_m):
    units = units_of_system(crs)
    assert units is not None
    np.testing.assert_allclose([units.xy_m, units.z_m], [xy_m, z_m], rtol=1e-9)


@pytest.mark.parametrize("crs", [None, "", "EPSG:0", "nonsense", 'LOCAL_CS["none"]'])
def test_unknown_systems_tell_nothing(crs):
    assert units_of_system(crs) is None


def points(scale: float) -> F64:
    rng = np.random.default_rng(1)
    return np.stack(
        [25 + scale * rng.random(500), 60 + scale * rng.random(500), 12 * rng.random(500)], axis=1
    )


def source_of(xyz: F64, crs: str | None) -> MemorySource:
    values = {axis: xyz[:, i] for i, axis in enumerate("xyz")}
    return MemorySource(values, facts=SourceFacts(crs_wkt=crs))


@pytest.mark.parametrize(
    "scale, crs, is_refused",
    [
        (1e-3, None, True),
        (1e-3, GEO, True),
        (30.0, GEO, True),
        (30.0, None, False),
        (1e-3, METRE, False),
    ],
)
def test_degrees_are_refused_with_the_reason(scale, crs, is_refused):
    source = source_of(points(scale), crs)
    assert looks_geographic(points(scale)) == (scale < 1)
    if not is_refused:
        refuse_degrees(source)
        return
    with pytest.raises(InputError, match="x and y are degrees.*reproject"):
        refuse_degrees(source)


def test_feet_become_metres_and_are_told():
    xyz = points(30.0)
    source = in_metres(source_of(xyz, FOOT))
    chunk = next(iter(source.chunks(("z", "x"))))
    np.testing.assert_allclose(chunk.values["x"], xyz[:, 0] * 0.304800609601219)
    np.testing.assert_allclose(chunk.values["z"], xyz[:, 2] * 0.304800609601219)
    assert "converted to metres" in source.facts.notes[0]
    metric = source_of(xyz, METRE)
    assert in_metres(metric) is metric
    assert in_metres(replace(metric, facts=SourceFacts())).facts.notes == ()
