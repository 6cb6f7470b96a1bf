"""The default: what a user gets who names no method, in every command, and that it is said."""

import json

import numpy as np
import pytest

import prc_cli
from prc_cli import classify_ranges, load_config
from prc_cli.config import RunConfig, from_layers, preset_table
from prc_cli.core.errors import ConfigError, InputError
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.streams.evidence.test_estimates import forest_lines


@pytest.fixture
def scans(tmp_path):
    """A folder with a street and a forest as dumps without angles, and as arrays with them."""
    for name, ranges in (("street", street_lines(140)[0]), ("forest", forest_lines(140))):
        ranges.tofile(tmp_path / f"{name}.bin")
        np.savez(tmp_path / f"{name}.npz", range_m=ranges, angle_deg=np.rad2deg(BEAM))
    return tmp_path


def test_tables_and_presets_decide():
    assert RunConfig().method == "auto"
    assert not RunConfig().is_decided
    assert RunConfig.model_validate({"sequential_angle": {}}).method == "sequential-angle"
    assert RunConfig.model_validate({"method": "auto", "prc": {}}).method == "auto"
    assert load_config(preset="prc-2019-forest").config.method == "prc"
    file = ("a.toml", {"method": "auto", "sequential_angle": {}})
    assert (
        from_layers([("preset prc-2019-urban", preset_table("urban")), file]).config.method == "prc"
    )
    assert from_layers([file]).config.method == "auto"
    assert from_layers([("a.toml", {"prc": {}})]).sources["method"] == "the table [prc]"
    with pytest.raises(ConfigError, match=r"the tables \[prc\] and \[fused\] and no method"):
        from_layers([("a.toml", {"prc": {}, "fused": {}})])


@pytest.mark.slow
def test_python_has_the_defaults_of_the_commands(prc, scans):
    """Angles as files have them, the class mapping of the run, the same JSON."""
    record = json.loads(prc(f"classify {scans}/street.npz {scans}/a.npy --json -q").out)
    run = prc_cli.classify(scans / "street.npz", scans / "b.npy")
    assert record == json.loads(json.dumps(run.as_dict()))
    assert record["doubts"] == []
    with np.load(scans / "street.npz") as arrays:
        image = arrays["range_m"]
        angle = arrays["angle_deg"]
    classified = classify_ranges(image, angle_deg=angle + 40)
    np.testing.assert_array_equal(classified.codes.ravel(), np.load(scans / "a.npy"))
    named = classify_ranges(
        image, load_config(preset="fused", options={"input": {"nadir": 0.0}}), angle_deg=angle
    )
    np.testing.assert_array_equal(named.labels, classify_ranges(image, beam_rad=BEAM).labels)
    with pytest.raises(InputError, match="expected finite angles of shape"):
        classify_ranges(image, angle_deg=angle[1:])
    matrix = prc_cli.evaluate(scans / "a.npy", scans / "b.npy")
    assert "car" in matrix.reference_names, "the mapping of fused"
    for config in (
        run,
        matrix,
        run.record,
        load_config(),
        load_config(preset="prc-2019-forest").config,
        classified,
    ):
        assert (repr(config).count("\n"), len(repr(config)) < 300) == (0, True)


@pytest.mark.slow
@pytest.mark.data
def test_real_scans_get_what_labels_them_best(prc, real_data):
    for name, preset in (("oakland/oakland_2.csv.gz", "fused"), ("forest/tls_park.npz", "fused")):
        report = prc.json(f"info {real_data}/{name}")
        assert report["choice"]["preset"] == preset
