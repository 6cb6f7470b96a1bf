"""What was a key once is a constant now, of the value that the error names."""

from __future__ import annotations

import pickle
import tomllib
from pathlib import Path
from typing import Any

import pytest

from prc_cli.config import load_config
from prc_cli.core.config import flatten
from prc_cli.core.errors import ConfigError
from prc_cli.methods.sequential_angle import thresholds

CONSTANTS = dict(flatten(tomllib.loads(Path(thresholds.__file__).with_name("constants.toml").read_text("utf-8"))))


@pytest.mark.parametrize("key", CONSTANTS)
def test_the_constant_is_that_of_the_thresholds(key: str) -> None:
    found: Any = thresholds.SequentialAngleThresholds()
    for name in key.split("."):
        found = getattr(found, name, None)
    if found is not None:
        assert found == (tuple(CONSTANTS[key]) if isinstance(CONSTANTS[key], list) else CONSTANTS[key])
    options: Any = CONSTANTS[key]
    for name in reversed(["sequential_angle", *key.split(".")]):
        options = {name: options}
    with pytest.raises(ConfigError, match=f"{key} is a constant now"):
        load_config(options=options)


def test_a_configuration_goes_to_another_process() -> None:
    loaded = load_config(preset="street-scan-published")
    assert pickle.loads(pickle.dumps(loaded)).config == loaded.config
