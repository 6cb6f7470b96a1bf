from __future__ import annotations

import pytest
from pydantic import ValidationError

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import ConfigError
from prc_cli.formats.writing.columns import OutputConfig, check_codes, class_names


def test_below_32_names_the_first_key_that_is_too_high() -> None:
    codes = ClassCodes(stem=19, car=20)
    with pytest.raises(
        ConfigError, match=r"classes\.curb: found code 66, expected a code below 32 .*set curb"
    ) as caught:
        check_codes(codes, OutputConfig(codes="below-32"))
    assert caught.value.exit_code == 2
    check_codes(codes, OutputConfig())


def test_below_32_accepts_low_codes() -> None:
    check_codes(
        ClassCodes(stem=19, car=20, curb=21, vertical=22, horizontal=31, pole=25), OutputConfig(codes="below-32")
    )


def test_high_noise_has_a_name_only_where_it_is_asked_for() -> None:
    assert 18 not in class_names(ClassCodes(), OutputConfig())
    assert class_names(ClassCodes(car=18), OutputConfig(high_noise_beyond=1))[18] == "car/high_noise"


@pytest.mark.parametrize("values", [{"high_noise_beyond": 0}, {"codes": "drop"}, {"segments": True}])
def test_wrong_values_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        OutputConfig(**values)
