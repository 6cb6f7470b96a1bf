"""Hints name only what an input takes.

Every format with every key, and with every hint of the program.
"""

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import prc_cli
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.hints import fitting, named_keys
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.clouds import seen
from tests.formats.bags import recordings as made
from tests.formats.bags.test_times import messages
from tests.fuzz.seeds import seed
from tests.fuzz.targets import suffix_of_seed

TYPED = {
    "lines": "angle-wrap",
    "columns": "angle",
    "range": "dimension:x",
    "origin": "origin:1,2,3",
    "trajectory": "trajectory:way.csv",
    "scanner": "user_data",
    "order": "sort-time",
    "angle_start": 1.0,
    "angle_step": 0.5,
    "points_per_line": 7,
    "range_scale": 0.5,
    "min_range": 0.05,
    "max_range": 50.0,
}
"""Keys that hints name, and a value for each."""
SAMPLES = (
    "a.npy",
    "a.npz",
    "a.ptx",
    "a.e57",
    "plain.bag",
    "cloud.bag",
    "velodyne.pcap",
    "frame.bin",
)


def make_sample(folder: Path, name: str) -> Path:
    if name == "cloud.bag":
        return made.write_bag(folder / "cloud.bag", messages(made.drive(400)))
    if name == "frame.bin":
        return make_frame(folder / "frame.bin")
    path = folder / f"sample{suffix_of_seed(name)}"
    path.write_bytes(seed(name))
    return path


def make_frame(path: Path) -> Path:
    """A frame of 16 rings of 400 shots, ring after ring."""
    azimuth = np.tile(np.linspace(0, 2 * np.pi, 400, endpoint=False), 16)
    elevation = np.repeat(np.deg2rad(np.linspace(2, -24, 16)), 400)
    range_m = np.random.default_rng(2).uniform(5, 6, 6400)
    xyz = seen(range_m, azimuth, elevation)
    np.hstack([xyz, np.ones((6400, 1))]).astype("<f4").tofile(path)
    return path


def open_sample(path: Path, **changes: object) -> frozenset[str]:
    """Read a sample with a key; return what it says that it refuses."""
    from prc_cli.config import resolve

    scan, loaded = resolve(path)
    config = InputConfig.model_validate(
        {**loaded.config.input.model_dump(by_alias=True), **changes}
    )
    stream = open_input(scan, config)
    for _ in stream.blocks():
        pass
    return stream.info.facts.refuses


@pytest.mark.parametrize("name", SAMPLES)
def test_what_an_input_refuses_is_what_it_says_that_it_refuses(tmp_path, name):
    path = make_sample(tmp_path, name)
    refuses = open_sample(path)
    for key, typed in TYPED.items():
        # frames accept some values of --range
        value = "sensor-xyz" if (name, key) == ("frame.bin", "range") else typed
        try:
            # an angle needs the other one
            beside = {"angle_start": 1.0, "angle_step": 0.5} if key.startswith("angle_") else {}
            name_of_key = "range" if key in ("origin", "trajectory") else key
            open_sample(path, **{**beside, name_of_key: value})
            is_refused = False
        except (InputError, ConfigError):
            is_refused = True
        does_nothing = name == "frame.bin" and key.startswith("angle_")
        assert (is_refused or does_nothing) == (key in refuses), f"{name}: {key} = {value}"


@cache
def hints_of_the_program() -> tuple[str, ...]:
    """Return every text of the checks and of the search for beams that names a key or an option."""
    folder = Path(prc_cli.__file__).parent / "streams"
    texts = []
    for path in sorted([*folder.glob("evidence/*.py"), folder / "beams.py", folder / "order.py"]):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                texts.append(
                    "".join(
                        part.value if isinstance(part, ast.Constant) else "1"
                        for part in node.values
                    )
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return tuple(text for text in texts if named_keys(text))


@pytest.mark.parametrize("name", SAMPLES)
def test_no_hint_names_what_the_input_refuses(tmp_path, name):
    refuses = open_sample(make_sample(tmp_path, name))
    assert len(hints_of_the_program()) > 20
    for hint in hints_of_the_program():
        assert not named_keys(fitting(hint, refuses)) & refuses
