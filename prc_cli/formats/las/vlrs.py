"""The contents of VLRs: the run record, names of classes, coordinate systems.

laspy's own ``parse_crs`` needs pyproj, an extra of this program, and fails on systems that pyproj
does not know.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

from prc_cli.core.classes import FIRST_USER_CODE
from prc_cli.formats.las.header import (
    GEO_KEYS_KEY,
    RECORD_KEY,
    WKT_KEY,
    LasHeader,
    Vlr,
    VlrKey,
    make_vlr,
    open_bytes,
    read_header,
    text_of,
)
from prc_cli.formats.writing.record import RunRecord

VLR_LIMIT = 65_535
"""Largest content of a VLR [bytes]."""
RECORD_TEXT = "prc run record"
"""Description of the VLR of the run record."""
LOOKUP_KEY = VlrKey("LASF_Spec", 0)
"""LAS 1.4: names of classes in entries of 16 bytes, the class code and 15 characters.

The specification names the standard classes, this record the user codes, 64 and up.
"""
_ENTRY_BYTES = 16

_NAME = re.compile(r'^\s*\w+\s*\[\s*"([^"]*)"')
_CODE = re.compile(r'(?:AUTHORITY|ID)\s*\[\s*"EPSG"\s*,\s*"?(\d+)"?\s*\]\s*\]\s*$', re.IGNORECASE)
_LIBLAS_WKT_KEY = VlrKey("liblas", 2112)
_USER_DEFINED = 32767
_GEOGRAPHIC = 2048
_PROJECTED = 3072
_VERTICAL = 4096


def with_record(vlrs: list[Vlr], record: RunRecord) -> list[Vlr]:
    """Return the VLRs with a run record instead of an old one, shortened to fit into a VLR."""
    new = make_vlr(RECORD_KEY, record.to_json_within(VLR_LIMIT), RECORD_TEXT)
    place = next((index for index, vlr in enumerate(vlrs) if vlr.has(RECORD_KEY)), len(vlrs))
    vlrs = [vlr for vlr in vlrs if not vlr.has(RECORD_KEY)]
    return [*vlrs[:place], new, *vlrs[place:]]


def lookup_vlr(names: Mapping[int, str]) -> Vlr:
    """Return a new record of names.

    >>> len(lookup_vlr({64: "stem", 65: "car"}).data)
    32
    """
    entries = b"".join(_entry(code, name) for code, name in sorted(names.items()))
    return make_vlr(LOOKUP_KEY, entries, "Classification Lookup")


def names_of_file(path: Path) -> dict[int, str]:
    """Return the names of user codes in a LAS or LAZ file."""
    names: dict[int, str] = {}
    with open_bytes(path) as source:
        header = read_header(source)
    for data in header.find(LOOKUP_KEY):
        for code, name in _names(data).items():
            if code >= FIRST_USER_CODE and name:
                names.setdefault(code, name)
    return names


def with_lookup(
    las: LasHeader, vlrs: list[Vlr], names: Mapping[int, str]
) -> tuple[list[Vlr], tuple[str, ...]]:
    """Return VLRs with the names of classes, and notices; an existing record is extended."""
    if not names:
        return vlrs, ()
    if any(evlr.has(LOOKUP_KEY) for evlr in las.evlrs):
        return vlrs, ("the names of classes stand behind the points; they were left as they are",)
    place = next((index for index, vlr in enumerate(vlrs) if vlr.has(LOOKUP_KEY)), None)
    if place is None:
        return [*vlrs, lookup_vlr(names)], ()
    data = bytearray(vlrs[place].data or b"")
    notices = []
    if len(data) % _ENTRY_BYTES:
        return vlrs, (
            f"the names of classes take {len(data)} bytes, no multiple of 16; "
            "they were left as they are",
        )
    before = _names(bytes(data))
    for code, name in sorted(names.items()):
        entry = _entry(code, name)
        if code not in before:
            data += entry
        elif before[code] != (new := text_of(entry[1:])):
            start = bytes(data[::_ENTRY_BYTES]).index(code) * _ENTRY_BYTES
            data[start : start + _ENTRY_BYTES] = entry
            if before[code]:
                notices.append(
                    f"class {code} was named {before[code]!r} in the input; its name is now {new!r}"
                )
    if len(data) > VLR_LIMIT:
        return vlrs, ("the names of classes fill their record; they were left as they are",)
    return [*vlrs[:place], vlrs[place].with_data(bytes(data)), *vlrs[place + 1 :]], tuple(notices)


def _entry(code: int, name: str) -> bytes:
    return bytes([code]) + name.encode("ascii", "replace")[: _ENTRY_BYTES - 1].ljust(
        _ENTRY_BYTES - 1, b"\0"
    )


def _names(data: bytes) -> dict[int, str]:
    """Return the names by code; the first name of a code is used."""
    starts = range(len(data) // _ENTRY_BYTES * _ENTRY_BYTES - _ENTRY_BYTES, -1, -_ENTRY_BYTES)
    return {data[start]: text_of(data[start + 1 : start + _ENTRY_BYTES]) for start in starts}


def find_crs(header: LasHeader) -> str | None:
    """Return the coordinate system: WKT, else ``EPSG:CODE`` of GeoTIFF keys, else None."""
    codes = (_horizontal(_geo_keys(data)) for data in header.find(GEO_KEYS_KEY))
    named = (f"EPSG:{code}" for code in codes if code)
    texts = (map(text_of, header.find(key)) for key in (WKT_KEY, _LIBLAS_WKT_KEY))
    return next(filter(None, chain(next(texts), named, next(texts))), None)


def _geo_keys(data: bytes) -> dict[int, int]:
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


def with_wkt(vlrs: list[Vlr], point_format: int) -> tuple[list[Vlr], str | None]:
    """Return the VLRs with a WKT, which formats 6-10 need, made from EPSG codes, and a notice."""
    keys = {vlr.key: vlr for vlr in vlrs}
    if WKT_KEY in keys:
        return vlrs, "the coordinate system is now read from the file's own WKT"
    if GEO_KEYS_KEY not in keys:
        return vlrs, None
    geo_keys = _geo_keys(keys[GEO_KEYS_KEY].data or b"")
    horizontal = _horizontal(geo_keys)
    vertical = geo_keys.get(_VERTICAL, _USER_DEFINED)
    candidates = [(f"EPSG:{horizontal}", "")]
    if vertical != _USER_DEFINED:
        # old files give the code of a vertical datum instead of a coordinate system
        remark = f" (vertical code {vertical} is no EPSG system and was left out)"
        candidates = [(f"EPSG:{horizontal}+{vertical}", ""), (f"EPSG:{horizontal}", remark)]
    problem = "the GeoTIFF keys name no EPSG code"
    for text, remark in candidates if horizontal is not None else ():
        vlr, problem = vlr_of_crs(text)
        if vlr is not None:
            return [*vlrs, vlr], f"coordinate system {text}{remark} added as WKT"
    return vlrs, (
        f"point format {point_format} wants its coordinate system as WKT, "
        f"which could not be derived ({problem}); the GeoTIFF keys were kept"
    )


def vlr_of_crs(crs: str) -> tuple[Vlr | None, str]:
    """Return the record of a coordinate system as WKT, or None and why there is none."""
    try:
        import pyproj
    except ImportError:
        return None, 'pyproj is not installed; pip install ".[crs]"'
    try:
        wkt = pyproj.CRS.from_user_input(crs).to_wkt("WKT1_GDAL").encode("ascii") + b"\0"
    except (pyproj.exceptions.CRSError, UnicodeEncodeError) as error:
        return None, f"{crs}: {error}"
    if len(wkt) > VLR_LIMIT:
        return None, f"{crs}: {len(wkt)} bytes, more than a VLR holds"
    return make_vlr(WKT_KEY, wkt, "OGC COORDINATE SYSTEM WKT"), ""


def short_crs(crs: str) -> str:
    """Return the name of a coordinate system, with its EPSG code where it has one.

    >>> short_crs('PROJCS["UTM 35N", GEOGCS["WGS 84"], AUTHORITY["EPSG","32635"]]')
    'UTM 35N (EPSG:32635)'
    """
    name = _NAME.match(crs)
    code = epsg_of(crs)
    text = name.group(1) if name else " ".join(crs.split())[:60]
    return text if code is None or code in text else f"{text} ({code})"


def same_crs(left: str, right: str) -> bool:
    """Compare two coordinate systems by text, by EPSG code, else with pyproj if installed.

    >>> same_crs('PROJCS["UTM 35N", AUTHORITY["EPSG","32635"]]', "EPSG:32635")
    True
    """
    if "".join(left.split()).lower() == "".join(right.split()).lower():
        return True
    left_code = epsg_of(left)
    right_code = epsg_of(right)
    if left_code is not None and right_code is not None:
        return left_code == right_code
    try:
        import pyproj
    except ImportError:
        return False
    try:
        system = pyproj.CRS.from_user_input(left)
        other_system = pyproj.CRS.from_user_input(right)
    except pyproj.exceptions.CRSError:
        return False
    return bool(system.equals(other_system, ignore_axis_order=True))


def epsg_of(crs: str) -> str | None:
    """Return the EPSG code of a coordinate system, such as ``EPSG:32635``; None without one."""
    if re.fullmatch(r"EPSG:\d+", crs.strip(), re.IGNORECASE):
        return crs.strip().upper()
    match = _CODE.search(crs)
    return f"EPSG:{match.group(1)}" if match else None
