"""Every hint that can be typed is typed: one fault after the other, in LAS, text and PLY."""

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from prc_cli.cli import main
from prc_cli.streams.down import guess_down
from tests.cli.conftest import Result
from tests.formats.builders import write_csv, write_las
from tests.formats.cloud_files import ply
from tests.messages import folded
from tests.simulated import drive_arrays

LINES = 120
M = 720
LINE_HZ = 80.0
METRES_A_LINE = 0.05
Columns = dict[str, NDArray[Any]]

pytestmark = pytest.mark.slow


@cache
def street() -> Columns:
    """Return the shots of a drive, missing ones with the range 0."""
    block, _ = drive_arrays(LINES, M, 11)
    assert block.angle_rad is not None
    down = guess_down(block.angle_rad, block.range_m)
    assert down is not None
    line, column = (index.ravel() for index in np.indices((LINES, M)))
    range_m = np.nan_to_num(block.range_m.ravel()).astype(np.float64)
    beam_rad = block.angle_rad[column] - down.down_rad
    return {
        "scan_line": line.astype(np.int32),
        "column": column.astype(np.int32),
        "angle_deg": np.rad2deg(block.angle_rad)[column],
        "range": range_m,
        "time": (line * M + column) / (LINE_HZ * M),
        "x": METRES_A_LINE * line,
        "y": range_m * np.sin(beam_rad),
        "z": -range_m * np.cos(beam_rad),
    }


def write_ply(path: Path, columns: Columns) -> None:
    path.write_bytes(ply(columns))


WRITERS = {".las": write_las, ".csv": write_csv, ".ply": write_ply}


def without(columns: Columns, *names: str) -> Columns:
    return {name: values for name, values in columns.items() if name not in names}


def in_millimetres(columns: Columns) -> Columns:
    return {**without(columns, "x", "y", "z"), "range": 1000 * columns["range"]}


def coded_as_far(columns: Columns) -> Columns:
    code = np.where(columns["range"] == 0, 655.35, columns["range"])
    return {**without(columns, "x", "y", "z"), "range": code}


def coded_as_near(columns: Columns) -> Columns:
    code = np.random.default_rng(3).integers(1, 20, len(columns["range"])) / 1000
    near = np.where(columns["range"] == 0, code, columns["range"])
    return {**without(columns, "x", "y", "z"), "range": near}


def saturated(columns: Columns) -> Columns:
    return {**columns, "angle_deg": np.clip(columns["angle_deg"], -90, 90)}


def without_lines(columns: Columns) -> Columns:
    return without(columns, "scan_line", "column", "angle_deg", "x", "y", "z", "time")


def in_half_lines(columns: Columns) -> Columns:
    half = M // 2
    line = 2 * columns["scan_line"] + columns["column"] // half
    kept = without(columns, "angle_deg", "x", "y", "z")
    return {**kept, "scan_line": line, "column": columns["column"] % half}


def with_times_only(columns: Columns) -> Columns:
    """Keep returns, and of their order only the times."""
    returns = columns["range"] > 0
    kept = without(columns, "scan_line", "column", "angle_deg", "x", "y", "z")
    return {name: values[returns] for name, values in kept.items()}


def swapped_halves(columns: Columns) -> Columns:
    n = len(columns["range"]) // 2
    return {name: np.concatenate([values[n:], values[:n]]) for name, values in columns.items()}


def radians_as_degrees(columns: Columns) -> Columns:
    return {**without(columns, "x", "y", "z"), "angle_deg": np.deg2rad(columns["angle_deg"])}


def same(columns: Columns) -> Columns:
    return without(columns, "x", "y", "z")


@dataclass(frozen=True)
class Fault:
    """A fault of a file, and what is typed with it."""

    alter: Callable[[Columns], Columns]
    options: tuple[str, ...] = ()


FAULTS = {
    "millimetres": Fault(in_millimetres),
    "far code": Fault(coded_as_far),
    "near codes": Fault(coded_as_near),
    "saturated angles": Fault(saturated),
    "radians": Fault(radians_as_degrees),
    "no lines": Fault(without_lines),
    "wrong M": Fault(without_lines, ("-M", str(M + 1))),
    "half M": Fault(without_lines, ("-M", str(M // 2))),
    "halves of lines": Fault(in_half_lines),
    "only times": Fault(with_times_only),
    "halves swapped": Fault(swapped_halves),
    "wrong down": Fault(same, ("--set", "input.nadir=90")),
    "wrong angle step": Fault(
        without_lines,
        ("-M", str(M), "--set", "input.angle_start=-150", "--set", "input.angle_step=0.2"),
    ),
    "line rate of half a line": Fault(
        with_times_only,
        ("--lines", f"time:{2 * LINE_HZ}", "--columns", f"time:{LINE_HZ * M}"),
    ),
}
OPTION = re.compile(
    r"--trust-order|--sort-by-time|-M \d+|--[a-z-]+ (?![a-z-]*FILE)[^\s;,]+(?:,[^\s;,]+)*"
)
PLACEHOLDER = re.compile(r"\b[A-Z]{2,}\b|X,Y,Z")


def run(capsys: pytest.CaptureFixture[str], *words: object) -> Result:
    """Run ``prc``; the hint of a message is in its line."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    printed = capsys.readouterr()
    return Result(int(stop.value.code or 0), printed.out, folded(printed.err))


def problems_of(result: Result) -> set[str]:
    """Return refusals and warnings, without their figures."""
    lines = [line for line in result.err.splitlines() if line.startswith(("error", "warning"))]
    return {re.sub(r"[\d.,]+", "#", line.split("; ")[0].split(", expected")[0]) for line in lines}


def typed_by(said: str) -> list[list[str]]:
    """Return the options that refusals and warnings name, part by part, without placeholders."""
    hints = [
        line.split("; ", 1)[-1]
        for line in said.splitlines()
        if line.startswith(("error", "warning"))
    ]
    parts = [part for hint in hints for part in re.split(r"; |, or ", hint)]
    options = [OPTION.findall(part) for part in parts if "--accept-doubt" not in part]
    return [
        [word for option in named for word in shlex.split(option)]
        for named in options
        if named and not any(PLACEHOLDER.search(option) for option in named)
    ]


@pytest.mark.parametrize("suffix", [".las", ".csv", pytest.param(".ply", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", list(FAULTS))
def test_a_hint_leads_on_when_typed(name, suffix, tmp_path, capsys):
    fault = FAULTS[name]
    path = tmp_path / f"drive{suffix}"
    WRITERS[suffix](path, fault.alter(street()))
    output = tmp_path / "labels.npy"
    prc = partial(run, capsys)
    classify = ("classify", path, output, "--overwrite", *fault.options)
    first = prc(*classify)
    for options in typed_by(first.err) + proposed(prc("info", path, *fault.options).out):
        if set(options) <= set(fault.options):
            continue
        again = prc(*classify, *options)
        is_left = problems_of(first) <= problems_of(again)
        assert again.code == 0 or not is_left, (options, again.err)


def proposed(said: str) -> list[list[str]]:
    """Return the options of the command that ``prc info`` proposes."""
    lines = [line for line in said.splitlines() if line.startswith("type: prc classify")]
    return [words[5:] for words in map(shlex.split, lines) if len(words) > 5]
