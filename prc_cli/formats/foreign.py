"""Files of other programs that prc cannot read: their maker, and an export that prc can read."""

from __future__ import annotations

import shlex
from pathlib import Path

from prc_cli.core.files import suffix_of

_SCANNERS = {
    (".rxp", ".rdbx", ".rdb", ".3dd"): (
        "RIEGL",
        "RiSCAN PRO or RiPROCESS",
        "LAS or LAZ with times, or PTX",
    ),
    (".zfs", ".zfc", ".zfprj"): (
        "Zoller+Fröhlich",
        "Z+F LaserControl",
        "a structured E57, PTX, or ASCII",
    ),
    (".fls", ".lsproj", ".fws", ".afr"): ("FARO", "FARO SCENE", "a structured E57 or PTX"),
    (".lgs", ".lgsx", ".imp"): ("Leica", "Cyclone or REGISTER 360", "a structured E57 or PTX"),
    (".tzf", ".tdx", ".rwp"): ("Trimble", "RealWorks", "a structured E57 or PTX"),
    (".cl3", ".clr"): ("Topcon", "ScanMaster", "a structured E57 or PTX"),
    (".rcp", ".rcs", ".rcc"): (
        "Autodesk ReCap",
        "the scanner's own program",
        "a structured E57 or PTX",
    ),
    (".pod",): ("Bentley Pointools", "the scanner's own program", "a structured E57 or PTX"),
}
_ARCHIVES = {
    ".zip": "unzip {}",
    ".7z": "7z x {}",
    ".rar": "unrar x {}",
    ".tar": "tar xf {}",
    ".tgz": "tar xzf {}",
}
_SHEETS = (".xlsx", ".xls", ".ods", ".numbers")
_LIVOX = (".lvx", ".lvx2", ".lvx3")
_PATHS = (".sbet", ".out", ".pos")
_FEATHER = (
    'python -c "from pyarrow import csv, feather; csv.write_csv(feather.read_table({name}), {out})"'
)
_UOS = 'awk \'BEGIN {{print "x,y,z"}} {{print $1/100 "," $3/100 "," $2/100}}\' {name} > {out}'
_ROW = (
    'python -c "import numpy, scipy.io; '
    "numpy.savez({out}, range_m=scipy.io.loadmat({name})['NAME'])\""
)


_NO_OUTPUTS = {".e57": "prc 2.0 writes no E57: write .laz for other programs, .npz for prc"}


def output_hint_of(suffix: str) -> str:
    """Return a hint for an output of a suffix that prc does not write.

    >>> output_hint_of(".e57")
    'prc 2.0 writes no E57: write .laz for other programs, .npz for prc'
    """
    return _NO_OUTPUTS.get(suffix, "choose an output name that ends in one of them")


def hint_of(path: Path) -> str | None:
    """Return a hint how to export a file of another program for prc; None if it is not known.

    >>> hint_of(Path("scan.fls"))
    'a scan of FARO: export a structured E57 or PTX with FARO SCENE'
    >>> hint_of(Path("drive.zip"))
    'an archive: unpack it, unzip drive.zip, and name the file in it'
    """
    suffix = path.suffix.lower()
    for suffixes, (maker, program, export) in _SCANNERS.items():
        if suffix in suffixes:
            return f"a scan of {maker}: export {export} with {program}"
    if suffix in _ARCHIVES:
        unpack = _ARCHIVES[suffix].format(shlex.quote(str(path)))
        return f"an archive: unpack it, {unpack}, and name the file in it"
    if suffix in _SHEETS:
        return "a spreadsheet: save the sheet as CSV (.csv)"
    if suffix in _LIVOX:
        return "a recording of Livox, whose scan has no lines: prc does not support it"
    if suffix in _PATHS:
        return f"a trajectory: give it beside the scan, --range trajectory:{shlex.quote(str(path))}"
    if suffix in (".feather", ".3d"):
        return _as_csv(path)
    if suffix == ".mat":
        row = _ROW.format(out=repr(f"{path.stem}.npz"), name=repr(path.name))
        write = f"write its ranges (lines x shots) as .npz, {row}"
        return f"a file of MATLAB: {write}, where NAME is the variable"
    if suffix in (".h5", ".hdf5"):
        write = "write its ranges (lines x shots) as .npz"
        return f"an HDF5 file: {write} with numpy.savez(FILE, range_m=...)"
    if suffix == ".osf":
        target = shlex.quote(path.stem + ".pcap")
        return f"a recording of Ouster: ouster-cli source {shlex.quote(str(path))} save {target}"
    if suffix_of(path) in (".gz", ".bz2", ".xz", ".zst"):
        return (
            "a compressed file: unpack it first; only .csv and .txt are read compressed (.gz, .zst)"
        )
    return None


def _as_csv(path: Path) -> str:
    """Return a hint how to write a file of Arrow or of 3DTK as CSV."""
    table = f"{path.stem}.csv"
    if path.suffix.lower() == ".feather":
        write = _FEATHER.format(name=repr(path.name), out=repr(table))
        return f"a table of Arrow: write it as CSV, {write}"
    write = _UOS.format(name=shlex.quote(path.name), out=shlex.quote(table))
    return f"a scan of 3DTK: write it as CSV in metres with z up, {write}"
