"""Coordinate systems of LAS files: reading, short names, comparison.

laspy's own ``parse_crs`` needs pyproj, an extra of this program, and gives up on what pyproj does not understand.
"""

from __future__ import annotations

import re

from prc_cli.formats.las.header import GEO_KEYS_KEY, WKT_KEY, LasHeader, Vlr, make_vlr, text_of

_NAME = re.compile(r'^\s*\w+\s*\[\s*"([^"]*)"')
_CODE = re.compile(r'(?:AUTHORITY|ID)\s*\[\s*"EPSG"\s*,\s*"?(\d+)"?\s*\]\s*\]\s*$', re.IGNORECASE)


_LIBLAS_WKT_KEY = ("liblas", 2112)
_USER_DEFINED = 32767
_GEOGRAPHIC, _PROJECTED, _VERTICAL = 2048, 3072, 4096
_VLR_LIMIT = 65_535


def find_crs(header: LasHeader) -> str | None:
    """Return the coordinate system: WKT as it stands, else ``EPSG:CODE`` from GeoTIFF keys, else None."""
    for data in header.find(WKT_KEY):
        if text := text_of(data):
            return text
    for data in header.find(GEO_KEYS_KEY):
        if code := _horizontal(_geo_keys(data)):
            return f"EPSG:{code}"
    for data in header.find(_LIBLAS_WKT_KEY):
        if text := text_of(data):
            return text
    return None


def _geo_keys(data: bytes) -> dict[int, int]:
    """Return the GeoTIFF keys with a value in the key directory itself."""
    from laspy.vlrs.known import GeoKeyDirectoryVlr, GeoKeysHeaderStructs

    if len(data) < GeoKeysHeaderStructs.size():
        return {}
    directory = GeoKeyDirectoryVlr()
    directory.parse_record_data(data)
    return {key.id: key.value_offset for key in directory.geo_keys if key.tiff_tag_location == 0}


def _horizontal(keys: dict[int, int]) -> int | None:
    """Return the EPSG code of the projected, else the geographic system; None if there is none."""
    code = keys.get(_PROJECTED) or keys.get(_GEOGRAPHIC)
    return code if code and code < _USER_DEFINED else None


_WKT_TEXT = "OGC COORDINATE SYSTEM WKT"


def with_wkt(vlrs: list[Vlr], point_format: int) -> tuple[list[Vlr], str | None]:
    """Return the VLRs with a WKT coordinate system, which point formats 6-10 need, and the notices about it.

    GeoTIFF keys stay; a WKT is derived from their EPSG codes where pyproj is installed.
    """
    keys = {vlr.key: vlr for vlr in vlrs}
    if WKT_KEY in keys:
        return vlrs, "the coordinate system is now read from the file's own WKT"
    if GEO_KEYS_KEY not in keys:
        return vlrs, None
    wkt, text = _wkt_of_geo_keys(keys[GEO_KEYS_KEY].data or b"")
    if wkt is None or len(wkt) > _VLR_LIMIT:
        return vlrs, (
            f"point format {point_format} wants its coordinate system as WKT, which could not be derived ({text}); "
            "the GeoTIFF keys were kept"
        )
    return [*vlrs, make_vlr(WKT_KEY, wkt, _WKT_TEXT)], f"coordinate system {text} added as WKT"


def _wkt_of_geo_keys(data: bytes) -> tuple[bytes | None, str]:
    """Return the WKT (null-terminated) of GeoTIFF keys, and the EPSG codes or the reason for none."""
    keys = _geo_keys(data)
    horizontal = _horizontal(keys)
    if horizontal is None:
        return None, "the GeoTIFF keys name no EPSG code"
    vertical = keys.get(_VERTICAL, _USER_DEFINED)
    try:
        import pyproj
    except ImportError:
        return None, "pyproj is not installed; pip install prc-cli[crs]"
    tries = [(f"EPSG:{horizontal}", "")]
    if vertical != _USER_DEFINED:
        # old files give the code of a vertical datum instead of a coordinate system
        tries = [
            (f"EPSG:{horizontal}+{vertical}", ""),
            (f"EPSG:{horizontal}", f" (vertical code {vertical} is no EPSG system and was left out)"),
        ]
    problem = ""
    for text, remark in tries:
        try:
            wkt = pyproj.CRS.from_user_input(text).to_wkt("WKT1_GDAL")
            return wkt.encode("ascii") + b"\0", text + remark
        except (pyproj.exceptions.CRSError, UnicodeEncodeError) as error:
            problem = f"{text}: {error}"
    return None, problem


def vlr_of_crs(crs: str) -> Vlr | None:
    """Return the record of a coordinate system as WKT; None without pyproj, or if it does not fit."""
    try:
        import pyproj
    except ImportError:
        return None
    try:
        wkt = pyproj.CRS.from_user_input(crs).to_wkt("WKT1_GDAL").encode("ascii") + b"\0"
    except (pyproj.exceptions.CRSError, UnicodeEncodeError):
        return None
    return make_vlr(WKT_KEY, wkt, _WKT_TEXT) if len(wkt) <= _VLR_LIMIT else None


def short_crs(crs: str) -> str:
    """Return the name of a coordinate system, with its EPSG code where it has one.

    >>> short_crs('PROJCS["UTM 35N", GEOGCS["WGS 84"], AUTHORITY["EPSG","32635"]]')
    'UTM 35N (EPSG:32635)'
    """
    name, code = _NAME.match(crs), _code(crs)
    text = name.group(1) if name else " ".join(crs.split())[:60]
    return text if code is None or code in text else f"{text} ({code})"


def same_crs(one: str, other: str) -> bool:
    """Compare two coordinate systems by text, by EPSG code, else with pyproj if installed.

    >>> same_crs('PROJCS["UTM 35N", AUTHORITY["EPSG","32635"]]', "EPSG:32635")
    True
    """
    if "".join(one.split()).lower() == "".join(other.split()).lower():
        return True
    codes = _code(one), _code(other)
    if None not in codes:
        return codes[0] == codes[1]
    try:
        import pyproj
    except ImportError:
        return False
    try:
        left, right = pyproj.CRS.from_user_input(one), pyproj.CRS.from_user_input(other)
    except pyproj.exceptions.CRSError:
        return False
    return bool(left.equals(right, ignore_axis_order=True))


def _code(crs: str) -> str | None:
    if re.fullmatch(r"EPSG:\d+", crs.strip(), re.IGNORECASE):
        return crs.strip().upper()
    found = _CODE.search(crs)
    return f"EPSG:{found.group(1)}" if found else None
