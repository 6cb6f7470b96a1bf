"""``--engine reference``: the labels of the compiled loops bit for bit, from every format, and without numba."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from prc_cli import kernels
from prc_cli.cli import main
from prc_cli.config import load_config
from prc_cli.core.types import F32
from prc_cli.formats.writing.record import record_path
from prc_cli.jobs.classify import classify, threads_of
from tests import patience
from tests.street import street, write_csv, write_npz, write_raw

LINES = slice(50, 90)
SIMULATED = {
    "urban": "street --lines 60 --set scanner.points_per_line=200",
    "forest": "forest --lines 60 --set scanner.points_per_line=300 --set sight_m=20",
    "street-scan": "street-scan --seed 3 --set scanner.points_per_line=80 --set scanner.azimuth_step_deg=4 "
    "--set station.turn_deg=70",
}
WITHOUT_NUMBA = """
import json, sys
sys.modules["numba"] = sys.modules["llvmlite"] = None
from prc_cli.cli import main
for words in json.loads(sys.argv[1]):
    try:
        main(words)
    except SystemExit as stop:
        print(stop.code)
"""


def piece() -> F32:
    """A few lines of the street, (40, M) float32 [m]; one of them has no returns."""
    return street()[LINES]


def prc(*words: str | Path) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    return int(stop.value.code or 0)


def by_both(source: Path, suffix: str, *options: str) -> tuple[Path, Path]:
    """Classify with both engines through the command line."""
    outputs = []
    for engine in kernels.ENGINES:
        outputs.append(source.with_name(f"{source.name}.{engine}{suffix}"))
        assert prc("classify", source, outputs[-1], *options, "--engine", engine, "-q") == 0
    return outputs[0], outputs[1]


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["urban", "forest", "street-scan", "street-scan-published"])
def test_both_engines_give_the_same_labels_and_segments(tmp_path: Path, preset: str) -> None:
    source = tmp_path / "scan.npz"
    assert prc("simulate", *SIMULATED[preset.removesuffix("-published")].split(), source, "-q") == 0
    # too coarse for the forest preset: nearly all is noise, by both engines
    compiled, plain = by_both(source, ".csv", "--preset", preset, "--segment-ids", "--accept-doubt", "noise-share")
    assert compiled.read_bytes() == plain.read_bytes()
    assert len({line.split(",")[-2] for line in plain.read_text().splitlines()}) > 3


def test_the_record_names_the_reference_alone(tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", piece())
    compiled, plain = (
        json.loads(record_path(path).read_text()) for path in by_both(source, ".npy", "--preset", "urban")
    )
    assert plain.pop("engine") == "reference"
    assert plain == compiled
    assert threads_of("reference", 8) == 1


def every_format(folder: Path) -> dict[str, Path]:
    """Write the street in every format that is read, small."""
    image = piece()
    made = {"npz": write_npz(folder / "drive.npz", image), "csv": write_csv(folder / "drive.csv", image)}
    made["csv.gz"] = write_csv(folder / "drive.csv.gz", image)
    made["bin"] = write_raw(folder / "drive.bin", image)
    made["npy"] = folder / "drive.npy"
    np.save(made["npy"], image)
    for suffix in ("laz", "las", "csv.zst"):
        made[suffix] = folder / f"made.{suffix}"
        assert prc("convert", made["npz"], made[suffix], "-q") == 0
    return made


@pytest.mark.slow
def test_without_numba_the_reference_classifies(tmp_path: Path) -> None:
    made = every_format(tmp_path)
    commands = [
        ["classify", made["npz"], tmp_path / "compiled.npy"],
        *(
            ["classify", made[name], tmp_path / f"{name}.out.npy", "--engine", "reference", "-q"]
            for name in ("npz", "csv", "laz")
        ),
    ]
    command = [sys.executable, "-c", WITHOUT_NUMBA, json.dumps(commands, default=str)]
    done = patience.run(command, capture_output=True, text=True)
    assert done.stdout.split() == ["1", "0", "0", "0"]
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: numba: cannot be loaded")
    assert "prc classify --engine reference" in done.stderr
    assert not (tmp_path / "compiled.npy").exists()
    for name in ("npz", "csv", "laz"):
        expected = classify(made[name], tmp_path / f"{name}.expected.npy", load_config(preset="urban")).output
        assert (tmp_path / f"{name}.out.npy").read_bytes() == expected.read_bytes()
