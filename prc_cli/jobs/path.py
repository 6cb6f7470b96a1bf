"""``prc info --path`` and ``--check-path``: writes the path found from points, or compares it."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from prc_cli.config import LoadedConfig, resolve
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import atomic_output, check_output, prepare_outputs, whole_set
from prc_cli.core.findings import Finding, Verdict, accept, doubts, refuse
from prc_cli.formats.clock import with_clock
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.formats.records import Source
from prc_cli.formats.systems import in_metres, refuse_degrees
from prc_cli.formats.trajectory.write import PathTable, check_path_suffix, write_path
from prc_cli.streams.ranges import metres_of
from prc_cli.streams.registered.comparison import (
    FAR_HEIGHT_M,
    FAR_M,
    Comparison,
    Positions,
    compare,
)
from prc_cli.streams.registered.drive import Drive
from prc_cli.streams.registered.scanner_paths import scanner_paths
from prc_cli.streams.registered.source import with_points
from prc_cli.streams.registered.spinning_drive import SpinningDrive
from prc_cli.streams.trajectory import Trajectory, load_trajectory

CHECK = "trajectory"
"""Name of the check."""
MOST_SPREAD_M = 0.1
"""If a lever arm varies more, it is not constant [m]."""
LEAST_LEVER_M = 0.1
"""Shorter lever arms are ignored [m]."""
FROM_POINTS = "--range points"
_KIND = "trajectory:"


def prepare_path(
    output: Path,
    loaded: LoadedConfig,
    path: Path,
    *,
    overwrite: bool,
) -> None:
    """Refuse an output for a path before any work is done."""
    check_path_suffix(output)
    prepare_outputs(output, overwrite=overwrite, inputs=(path, *loaded.files))


def save_path(
    output: Path,
    drive: Drive | SpinningDrive,
    loaded: LoadedConfig,
    path: Path,
    *,
    overwrite: bool,
) -> tuple[tuple[Path, ...], tuple[Finding, ...]]:
    """Write the path of every scanner of a drive; of several scanners, one file each.

    Parameters
    ----------
    output
        Name that ends in .csv, .txt, .sbet or .out.
    drive
        The paths found from the points. If the check ``path`` refuses them, nothing is written.
    loaded
        The configuration.
    path
        The cloud.
    overwrite
        Whether existing files are replaced.

    Returns
    -------
    tuple
        The files, and the warnings about the path.
    """
    findings = accept(drive.findings, loaded.config.input.accept_doubts or ())
    refuse(str(path), findings)
    paths = scanner_paths(drive)
    crs_wkt = _source(resolve(path, loaded)[0], loaded).facts.crs_wkt
    inputs = loaded.config.input
    scale = np.array(metres_of(inputs, crs_wkt))[[0, 0, 1]]
    names = [output]
    if len(paths) > 1:
        names = [
            output.with_stem(f"{output.stem}_scanner{path_found.scanner}") for path_found in paths
        ]
        for name in names:
            check_output(name, overwrite=overwrite, inputs=(path, *loaded.files))
    with ExitStack() as stack:
        stack.enter_context(whole_set())
        for name, path_found in zip(names, paths, strict=True):
            table = PathTable(
                path_found.time_s,
                path_found.xyz_m / scale,
                path_found.sigma_m / scale,
                path_found.axis,
                path_found.number,
            )
            temporary = stack.enter_context(atomic_output(name, overwrite=overwrite))
            _write(temporary, name, table, inputs.trajectory_crs or crs_wkt)
    return tuple(names), doubts(findings)


def _write(
    temporary: Path,
    name: Path,
    table: PathTable,
    crs: str | None,
) -> None:
    try:
        write_path(temporary, name, table, crs)
    except ConfigError as error:
        system = "--set input.trajectory_crs=EPSG:CODE (the projected system of the points)"
        raise ConfigError(error.where, error.problem, f"give {system}, or write .csv") from None


def _source(scan: Input, loaded: LoadedConfig) -> Source:
    source = scan.records()
    if source is None:
        raise InputError(
            str(scan), "contains no points with coordinates and times", "give a registered cloud"
        )
    return with_clock(source, loaded.config.input.time_unit)


def hold_against(
    scan: Input, loaded: LoadedConfig
) -> tuple[Drive | SpinningDrive, tuple[Comparison, ...], Finding]:
    """Find the path of every scanner from the points, and compare the given trajectory with it.

    Returns
    -------
    tuple
        The drive, one comparison per scanner, and the result of the check ``trajectory``.
    """
    inputs = loaded.config.input
    if not inputs.range.startswith(_KIND):
        problem = f"found range = {inputs.range}, expected a trajectory to compare"
        raise ConfigError("--check-path", problem, "give --range trajectory:FILE")
    source = _source(scan, loaded)
    refuse_degrees(source)
    trajectory = _positions(source, inputs)
    only_points: dict[str, object] = {
        "range": "points",
        "lines": "auto",
        "columns": "auto",
        "points_per_line": None,
    }
    cloud, _, _ = with_points(in_metres(source), inputs.model_copy(update=only_points))
    drive = cloud.facts.drive
    refuse(str(scan), drive.findings)
    comparisons = tuple(compare(path_found, trajectory) for path_found in scanner_paths(drive))
    findings = [_finding(comparison, inputs) for comparison in comparisons]
    worst = max(findings, key=lambda finding: finding.verdict)
    doubtful = [finding for finding in drive.findings if finding.verdict > Verdict.FINE]
    if doubtful:
        worst = replace(
            worst, hint=f"{worst.hint}; the path found has a warning: {doubtful[0].problem}"
        )
    return drive, comparisons, worst


def _positions(source: Source, inputs: InputConfig) -> Positions:
    """Return the given trajectory, with its orientation if it has one."""
    trajectory = _trajectory(source, inputs, with_turns=True) or _trajectory(
        source, inputs, with_turns=False
    )
    assert trajectory is not None
    frame = None
    if trajectory.quaternion is not None:
        from scipy.spatial.transform import Rotation

        frame = np.asarray(Rotation.from_quat(trajectory.quaternion).as_matrix(), np.float64)
    return Positions(trajectory.time_s, trajectory.xyz_m, frame)


def _trajectory(source: Source, inputs: InputConfig, *, with_turns: bool) -> Trajectory | None:
    """Read the trajectory; None if it has no orientation but ``with_turns`` asks for it."""
    xy_m, z_m = metres_of(inputs, source.facts.crs_wkt)
    try:
        return load_trajectory(
            Path(inputs.range.removeprefix(_KIND)).expanduser(),
            crs=inputs.trajectory_crs,
            source_crs_wkt=source.facts.crs_wkt,
            time_offset=inputs.trajectory_time_offset,
            max_gap=inputs.trajectory_max_gap,
            topic=inputs.trajectory_topic,
            lever_arm_m=inputs.trajectory_lever_arm,
            unit_m=(xy_m, xy_m, z_m),
            with_turns=with_turns,
        )
    except InputError:
        if with_turns:
            return None
        raise


def _finding(comparison: Comparison, inputs: InputConfig) -> Finding:
    if comparison.misfit:
        hint = "give the trajectory of this drive in the coordinates of the points, or use the path"
        hint += f" of the points: {FROM_POINTS}"
        limits = f"at most {FAR_M:g} m in plan and {FAR_HEIGHT_M:g} m in height"
        return Finding(CHECK, Verdict.AGAINST, comparison.misfit, limits, hint, FROM_POINTS)
    mends: list[str] = []
    troubles: list[str] = []
    if comparison.clock_s:
        troubles.append(
            f"its clock is {abs(comparison.clock_s):.4f} s "
            f"{'behind' if comparison.clock_s > 0 else 'ahead'}"
        )
        mends.append(
            "--set "
            f"input.trajectory_time_offset={_offset(comparison, inputs.trajectory_time_offset)}"
        )
    if comparison.lever_length_m > LEAST_LEVER_M:
        troubles.append(f"the scanner is not at its point: {_arm(comparison)}")
        arm = np.add(comparison.lever_m, inputs.trajectory_lever_arm or (0.0, 0.0, 0.0))
        if comparison.axes == "vehicle":
            mends.append(
                f"--set input.trajectory_lever_arm=[{','.join(f'{value:.3f}' for value in arm)}]"
            )
        else:
            mends = [FROM_POINTS]
    if comparison.spread_m > MOST_SPREAD_M:
        troubles.append(
            f"it differs from the path of the points by {comparison.spread_m:.2f} m, "
            "with any clock and lever arm"
        )
        mends = [FROM_POINTS]
    if troubles:
        option = " ".join(mends)
        said = f"the trajectory is not the path of the points: {'; '.join(troubles)}"
        return Finding(CHECK, Verdict.DOUBTFUL, said, "", f"give {option}", option)
    clock = (
        f"within {max(3 * comparison.clock_sigma_s, 5e-4):.4f} s"
        if comparison.tells_clock
        else "not measurable: the motion is too uniform"
    )
    said = f"the trajectory is the path of the points: {comparison.lever_length_m:.3f} m off"
    said += f", clock {clock}"
    return Finding(CHECK, Verdict.FINE, said, "")


def _offset(comparison: Comparison, told_s: float) -> str:
    """Return the total offset of the clock with its significant digits."""
    digits = min(max(math.floor(-math.log10(3.0 * max(comparison.clock_sigma_s, 1e-9))), 1), 6)
    return f"{told_s + comparison.clock_s:.{digits}f}"


def _arm(comparison: Comparison) -> str:
    # no minus before zeros
    first, left, up = (round(value, 3) + 0.0 for value in comparison.lever_m)
    arm = f"{first:.3f} m {comparison.forward}, {left:.3f} m left, {up:.3f} m up"
    return f"{arm} (spread {comparison.spread_m:.3f} m)"


def sentence(comparison: Comparison) -> str:
    """Return what a comparison found, for ``prc info``."""
    if comparison.misfit:
        return comparison.misfit
    clock = (
        f"{comparison.clock_s:+.6f} s"
        if comparison.tells_clock
        else "unknown: the motion is too uniform"
    )
    certain = f" (certain to {comparison.clock_sigma_s:.6f} s)" if comparison.tells_clock else ""
    arm = f"from its point to the scanner {_arm(comparison)}"
    return f"lacks {clock}{certain}; {arm}; covers {comparison.overlap:.0%} of the path"
