"""Calibration: estimates properties of the sensor from a stream, and parameters from them.

:mod:`.sensor` measures noise and steps. :mod:`.implied` counts support and background at all
thresholds, and derives parameters from both.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from prc_cli.config import LoadedConfig, RunConfig, resolve
from prc_cli.core.blocks import regroup
from prc_cli.core.config import build, merge
from prc_cli.core.errors import InputError
from prc_cli.core.findings import Doubted, Finding
from prc_cli.core.stream import FAR_M, ScanStream
from prc_cli.jobs.calibrate.implied import Advice, CurveCounter, Curves, imply
from prc_cli.jobs.calibrate.sensor import SensorEstimate, SensorMeter
from prc_cli.jobs.choice import decide
from prc_cli.jobs.classify import open_for_method
from prc_cli.jobs.progress import advance
from prc_cli.jobs.run import Progress
from prc_cli.streams.evidence.watch import watched

SHOTS_AT_ONCE = 1 << 18
"""Shots measured at a time; it changes only the pairs of lines across two chunks."""
LEAST_LINES = 3
"""Scan lines that a support decision needs: the line of the shot and both neighbours."""
NOTHING = (
    "fused measures the sensor in every run: there is nothing to calibrate, "
    "and the configuration changes nothing"
)
STAYS_OPEN = (
    "the configuration leaves the method open: "
    "where the angles of the beams are known, fused is taken all the same"
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(Doubted):
    """Result of a calibration."""

    path: str
    sensor: SensorEstimate
    curves: Curves
    advice: tuple[Advice, ...]
    """Values to write, with reasons."""
    config: LoadedConfig
    """The calibrated configuration; its sources hold the reasons."""
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    """Results of all checks of the stream."""

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values for JSON."""
        support = self.config.config.prc.support
        # the published figure fixes the other threshold at 1 m
        return {
            "path": self.path,
            "sensor": self.sensor.as_dict(),
            "curves": self.curves.as_dict(1.0, 1.0),
            "supported_share": self.curves.share(support.zeta_p, support.zeta_s),
            "advice": [asdict(item) for item in self.advice],
            "notes": list(self.notes),
            "doubts": [doubt.as_dict() for doubt in self.doubts],
        }


def calibrate(
    source: Path | str,
    config: LoadedConfig | None = None,
    *,
    progress: Progress | None = None,
) -> Calibration:
    """Derive parameters from a stream.

    Parameters
    ----------
    source : path
        Any readable input.
    config : LoadedConfig, optional
        How the stream is read, and the initial parameters. If it names no method, the method that
        would be chosen is calibrated: the parameters of PRC, or nothing for ``fused``.
    progress : callable, optional
        Called with the number of lines that were just read.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the stream is damaged, has fewer than three lines or no range.
    EvidenceError
        If a check of the stream fails; ``input.accept_doubts`` lists accepted checks.
    """
    loaded = config if config is not None else LoadedConfig(RunConfig())
    scan, with_layout = resolve(source, loaded)
    decided = decide(scan, with_layout)
    run = decided.config
    stream = open_for_method(scan, run)
    watch = watched(stream, run.input)
    sensor, curves = _measure(watch, run, progress)
    advice, notes = _implied(sensor, curves, decided)
    values = {item.key: item.value for item in advice}
    sources = {**loaded.sources, **{item.key: f"prc calibrate: {item.reason}" for item in advice}}
    calibrated = replace(loaded, config=_with_values(loaded.config, values), sources=sources)
    return Calibration(
        str(scan), sensor, curves, advice, calibrated, notes, tuple(watch.observed.findings)
    )


def _with_values(config: RunConfig, values: dict[str, Any]) -> RunConfig:
    """Return a configuration with dotted keys replaced."""
    table = config.to_table()
    for key, value in values.items():
        layer: Any = value
        for name in reversed(key.split(".")):
            layer = {name: layer}
        table = merge(table, layer)
    return build(RunConfig, table, "calibration")


def _implied(
    sensor: SensorEstimate, curves: Curves, decided: LoadedConfig
) -> tuple[tuple[Advice, ...], tuple[str, ...]]:
    # advice for the method (none for fused), and notes
    run = decided.config
    choice = decided.choice
    if run.method == "fused":
        why = "" if choice is None else f" (taken because {choice.why})"
        return (), (f"{NOTHING}{why}; for PRC's parameters give --method prc", *_notes(sensor))
    notes = _notes(sensor)
    if choice is not None:
        notes = (f"{choice.why}: PRC is calibrated; {STAYS_OPEN}", *notes)
    return imply(sensor, curves, run.prc, run.sequential_angle.angles.range_noise_m), notes


def _measure(
    stream: ScanStream, config: RunConfig, progress: Progress | None
) -> tuple[SensorEstimate, Curves]:
    meter = SensorMeter(stream.info)
    counter = CurveCounter(config.prc)
    lines: dict[int, int] = {}
    info = stream.info
    for block in regroup(
        stream.blocks(), max(LEAST_LINES, SHOTS_AT_ONCE // stream.info.points_per_line)
    ):
        meter.add(block)
        counter.add(block)
        lines[block.scanner] = lines.get(block.scanner, 0) + block.n_lines
        advance(progress, block, info, config.input.window)
    path = stream.info.path
    if max(lines.values(), default=0) < LEAST_LINES:
        problem = (
            f"found {sum(lines.values())} scan lines, expected {LEAST_LINES} or more: "
            "support needs lines around"
        )
        raise InputError(path, problem, "check -M and --lines, or calibrate on a longer piece")
    if meter.n_missing == meter.n_shots:
        problem = f"all of {meter.n_shots} shots are missing, expected ranges"
        raise InputError(path, problem, "check --range and the layout; see prc info")
    return meter.finish(), counter.finish()


def _notes(sensor: SensorEstimate) -> tuple[str, ...]:
    notes = []
    if (middle := sensor.range_quantiles_m["50%"]) > FAR_M:
        notes.append(
            f"the median range is some {middle / 1000:.0f} km: beyond {FAR_M / 1000:g} km the "
            "origin of the scanner is wrong, or the unit; see prc info, and do not use these "
            "parameters"
        )
    if sensor.sigma_m is None:
        notes.append("no stretch of the stream is flat: the noise of the sensor was not measured")
    if sensor.step_rad is None:
        notes.append(f"the angular step was not measured: {sensor.step_source}")
    return tuple(notes)


__all__ = ["Calibration", "calibrate"]
