"""Sample configurations hold only differences from the defaults, with reasons.

``prc config presets`` lists them.
"""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from prc_cli.config import PRESETS, load_config, preset_file, preset_table
from prc_cli.core.config import flatten, merge, samples_folder
from prc_cli.jobs.batch.configs import BatchConfig
from prc_cli.jobs.batch.types import ConfigLayers

ROOT = Path(__file__).resolve().parent.parent
SAMPLES = ROOT / "sample_configs"
FILES = sorted(SAMPLES.glob("*.toml"))
REPEATED = {
    "prc_2019_urban.toml": {
        "prc.environment",
        "prc.lines_per_block",
        "prc.support.zeta_s",
        "prc.support.zeta_p",
        "prc.surfaces.area",
        "prc.surfaces.gamma",
    },
    "prc_2019_forest.toml": {"prc.surfaces.gamma"},
    "kitti_frame.toml": {"method"},
}
"""Defaults that a sample repeats.

Published values, which a change of the defaults must not change, and the method that
the table of one must not decide."""


def base(preset: str | None) -> dict[str, Any]:
    return dict(flatten(load_config(preset=preset).config.to_table()))


def tables(path: Path) -> list[tuple[str | None, dict[str, Any]]]:
    """Preset below, and keys, of a file and of each of its overrides."""
    whole = tomllib.loads(path.read_text(encoding="utf-8"))
    overrides = whole.pop("override", [])
    named = whole.pop("preset", None)
    pairs = [(named, whole)]
    for override in overrides:
        override.pop("match")
        pairs.append((override.pop("preset", named), merge(whole, override)))
    return pairs


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_sample_holds_only_what_differs_from_what_it_starts_from(path):
    same = set()
    for preset, table in tables(path):
        below = base(preset)
        same |= {key for key, value in flatten(table) if below.get(key) == value}
    assert same == REPEATED.get(path.name, set())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_value_of_a_sample_has_its_reason(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    for before, line in zip(["", *lines], lines, strict=False):
        if re.match(r"[A-Za-z_.]+ = ", line):
            assert re.search(r"  # \w", line) or re.match(r"# \w", before), line


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_sample_is_valid(path):
    BatchConfig(ConfigLayers(path))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_its_file(name):
    path = SAMPLES / f"{name.replace('-', '_')}.toml"
    assert preset_file(name) == path
    assert "preset" not in preset_table(name)
    loaded = load_config(preset=name)
    assert load_config(path).config == loaded.config
    assert loaded.sources == dict.fromkeys(dict(flatten(preset_table(name))), f"preset {name}")


def test_the_folder_inside_the_package_comes_first(tmp_path):
    package = tmp_path / "prc_cli"
    package.mkdir()
    assert samples_folder(package) == tmp_path / "sample_configs"
    (package / "sample_configs").mkdir()
    assert samples_folder(package) == package / "sample_configs"


def test_the_wheel_and_the_source_archive_take_the_samples_in():
    targets = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"][
        "build"
    ]["targets"]
    assert "sample_configs" in targets["wheel"]["only-include"]
    assert targets["wheel"]["sources"] == {"sample_configs": "prc_cli/sample_configs"}
    for name in targets["sdist"]["include"]:
        assert (ROOT / name).exists(), name
    assert "sample_configs" in targets["sdist"]["include"]
