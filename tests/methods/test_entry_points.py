"""A method of another package goes through the commands as a built-in one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import patience

ROOT = Path(__file__).resolve().parents[2]
TOY = '''
"""Near shots are ground, far ones are building."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock
from prc_cli.methods.base import Classifier, Method, MethodParams, Needs


class ToyParams(MethodParams):
    """The parameters of the toy method."""

    near_m: float = Field(5.0, gt=0.0, description="largest range of the ground [m]")

    def method(self):
        return Toy(self)


@dataclass(frozen=True)
class State:
    """Nothing is handed on."""


@dataclass(frozen=True)
class Toy(Classifier):
    params: ToyParams

    @property
    def needs(self):
        return Needs(beams=False)

    def scanner(self, first):
        return None

    def initial_state(self, scanner):
        return State()

    def label(self, block, scanner, turn, wanted):
        return (LabelledBlock(block, self._of(block.range_m), self._of(block.extra.range_m)),)

    def _of(self, range_m):
        labels = np.where(range_m <= self.params.near_m, Label.GROUND, Label.BUILDING)
        return np.where(np.isnan(range_m), Label.MISSING, labels).astype(np.uint8)


PRESETS = (Path(__file__).with_name("toy_far.toml"),)
METHOD = Method("toy-of-a-test", ToyParams, "toy", mapping="street", presets=PRESETS)
'''


@pytest.fixture
def archive(tmp_path):
    """A folder with a drive and its reference; the method is installed beside it."""
    package = tmp_path / "installed"
    about = package / "toy_method-1.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-method\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[prc_cli.methods]\ntoy = toy_method:METHOD\n")
    (package / "toy_method.py").write_text(TOY)
    (package / "toy_far.toml").write_text(
        '# toy\nmethod = "toy-of-a-test"\n[toy_of_a_test]\nnear_m = 9\n'
    )
    folder = tmp_path / "archive"
    folder.mkdir()
    np.savez(folder / "drive.npz", range=ranges())
    return folder


def ranges() -> np.ndarray:
    range_m = np.linspace(1.0, 12.0, 40 * 30, dtype=np.float32).reshape(40, 30)
    range_m[3, 4] = np.nan
    return range_m


def prc(archive: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join((str(archive.parent / "installed"), str(ROOT)))
    ended = patience.run(
        [sys.executable, "-m", "prc_cli", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=archive.parent,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert ended.returncode in (0, 4), ended.stderr
    return ended


@pytest.mark.slow
def test_a_method_from_outside_goes_through_the_commands(archive):
    drive = archive / "drive.npz"
    assert json.loads(prc(archive, "info", drive, "--method", "toy-of-a-test", "--json").stdout)
    prc(archive, "classify", drive, "near.npy", "--method", "toy-of-a-test")
    prc(archive, "classify", drive, "far.npy", "--preset", "toy-far")
    prc(archive, "classify", drive, "far2.npy", "--set", "toy_of_a_test.near_m=9")
    prc(archive, "batch", archive, archive.parent / "out", "--method", "toy-of-a-test")
    range_m = ranges()
    for name, near_m in (("near.npy", 5.0), ("far.npy", 9.0), ("far2.npy", 9.0)):
        codes = np.load(archive.parent / name)
        is_ground = codes == 2
        assert np.array_equal(
            is_ground, range_m.ravel()[: codes.size].reshape(codes.shape) <= near_m
        )
    record = json.loads((archive.parent / "near.npy.prc.json").read_text())
    assert record["config"]["method"] == "toy-of-a-test"
    assert record["config"]["toy_of_a_test"] == {"near_m": 5.0}
    names = {count["name"] for count in record["classes"]}
    assert names == {"missing", "ground", "building"}
    scores = prc(
        archive, "evaluate", "near.npy", archive.parent / "out" / "drive.npz.labels.npy", "--json"
    )
    assert json.loads(scores.stdout)["overall"]["accuracy"] == 1.0
