"""Layers, sources, and the messages for wrong keys and values."""

from collections.abc import Iterator
from typing import Any

import pytest

from prc_cli.config import PRESETS, RunConfig, load_config, to_toml
from prc_cli.core.config import model_in


def test_layers_override_each_other_and_name_their_source(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text('preset = "prc-2019-forest"\n[prc.support]\nzeta_p = 0.2\n')
    loaded = load_config(path, options={"prc": {"surfaces": {"gamma": 5}}})
    assert loaded.config.prc.support.zeta_p == 0.2
    assert loaded.config.prc.support.zeta_s == 0.01
    assert loaded.config.prc.surfaces.gamma == 5
    assert loaded.sources["prc.support.zeta_p"] == str(path)
    assert loaded.sources["prc.support.zeta_s"] == "preset prc-2019-forest"
    assert loaded.sources["prc.surfaces.gamma"] == "option"
    assert "prc.background.alpha" not in loaded.sources


@pytest.mark.parametrize("preset", [None, *PRESETS])
@pytest.mark.parametrize("comments", [True, False])
def test_what_is_shown_can_be_read_back(preset, comments, tmp_path):
    layout = {
        "fields": [{"name": "range", "type": "i4", "scale": 0.001, "missing": 0}],
        "endian": "big",
    }
    loaded = load_config(preset=preset, options={"layout": layout, "input": {"max_range": 99.5}})
    path = tmp_path / "shown.toml"
    path.write_text(to_toml(loaded, comments=comments))
    assert load_config(path).config == loaded.config


def whole_numbers(model: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, field in model.model_fields.items():
        inner = model_in(field.annotation)
        if inner is not None:
            yield from whole_numbers(inner, f"{prefix}{name}.")
        elif field.annotation in (int, int | None):
            yield f"{prefix}{name}", field


def test_every_whole_number_of_the_configuration_has_a_largest_value():
    """What is counted with it must not leave the integers of the processor."""
    known = dict(whole_numbers(RunConfig))
    assert len(known) > 20
    for name, field in known.items():
        assert any(getattr(bound, "le", 1 << 62) <= 1 << 40 for bound in field.metadata), name
