"""Small simulated scans as arrays, made once per session."""

from functools import cache

import numpy as np

from prc_cli.core.blocks import join
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import U8
from prc_cli.simulation.drive import SimulatedScan
from prc_cli.simulation.settings import Kind, Simulation, load_settings, open_simulation

FIELD_DEG = 125.12
"""Elevations that the static scanner covers [degrees]."""


def static_scan(
    elevation_step: float,
    azimuth_step: float,
    seed: int,
    *,
    turn: float = 360.0,
) -> SimulatedScan:
    """A tripod in a street, steps in degrees."""
    scanner = {
        "azimuth_step_deg": azimuth_step,
        "points_per_line": round(FIELD_DEG / elevation_step),
    }
    options = {"seed": seed, "scanner": scanner, "station": {"turn_deg": turn}}
    return _open("street-scan", options).scan


@cache
def static_arrays(
    elevation_step: float,
    azimuth_step: float,
    seed: int,
    *,
    turn: float = 360.0,
) -> tuple[ScanBlock, U8]:
    """The same as one block with ranges, coordinates and beams, and its reference labels."""
    return _whole(static_scan(elevation_step, azimuth_step, seed, turn=turn))


def drive_scan(n_lines: int, points_per_line: int, seed: int) -> SimulatedScan:
    """A drive down a street with the scanner of Lehtola et al. (2019)."""
    scanner = {"points_per_line": points_per_line}
    return _open("street", {"seed": seed, "lines": n_lines, "scanner": scanner}).scan


@cache
def drive_arrays(n_lines: int, points_per_line: int, seed: int) -> tuple[ScanBlock, U8]:
    """The same as one block, and its reference labels."""
    return _whole(drive_scan(n_lines, points_per_line, seed))


def _open(kind: Kind, options: dict[str, object]) -> Simulation:
    return open_simulation(kind, load_settings(kind, options=options), threads=1)


def _whole(scan: SimulatedScan) -> tuple[ScanBlock, U8]:
    items = list(scan.labelled_blocks())
    return join([item.block for item in items]), np.concatenate([item.labels for item in items])
