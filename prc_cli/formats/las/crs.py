"""Coordinate systems as LAS files name them: short names, and whether two are the same."""

from __future__ import annotations

import re

_NAME = re.compile(r'^\s*\w+\s*\[\s*"([^"]*)"')
_CODE = re.compile(r'(?:AUTHORITY|ID)\s*\[\s*"EPSG"\s*,\s*"?(\d+)"?\s*\]\s*\]\s*$', re.IGNORECASE)


def short_crs(crs: str) -> str:
    """Return the name of a coordinate system, with its EPSG code where it has one.

    Parameters
    ----------
    crs : str
        WKT, or ``EPSG:CODE``.

    Examples
    --------
    >>> short_crs('PROJCS["UTM 35N", GEOGCS["WGS 84"], AUTHORITY["EPSG","32635"]]')
    'UTM 35N (EPSG:32635)'
    """
    name, code = _NAME.match(crs), _code(crs)
    text = name.group(1) if name else " ".join(crs.split())[:60]
    return text if code is None or code in text else f"{text} ({code})"


def same_crs(one: str, other: str) -> bool:
    """Whether two coordinate systems are the same, by their text, their EPSG codes, or else by pyproj if it is there.

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
