"""``prc calibrate`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from prc_cli.config import load_config
from tests.cli.test_commands import Prc, prc
from tests.street import street, write_npz

__all__ = ["prc"]


def test_parameters_of_a_doubted_stream_are_told(prc: Prc, tmp_path: Path) -> None:
    thin = np.full((137, 18_000), np.nan, np.float32)
    thin[:, :180] = street()
    np.save(tmp_path / "thin.npy", thin)
    result = prc("calibrate", tmp_path / "thin.npy", "-o", tmp_path / "thin.toml", "-q")
    assert (result.code, result.err.count("\n")) == (4, 1)
    assert result.err.startswith("warning: returns: ")
    text = (tmp_path / "thin.toml").read_text(encoding="utf-8")
    assert "\n# doubt: returns: " in text
    result = prc("calibrate", tmp_path / "thin.npy", "--json", "-q")
    assert [doubt["check"] for doubt in json.loads(result.out)["doubts"]] == ["returns"]
    assert prc("calibrate", tmp_path / "thin.npy", "-q", "--accept-doubt", "returns").code == 0
    np.save(tmp_path / "shuffled.npy", np.random.default_rng(3).permuted(street(), axis=1))
    result = prc("calibrate", tmp_path / "shuffled.npy", "-o", tmp_path / "shuffled.toml")
    assert (result.code, "insist with --accept-doubt" in result.err) == (1, True)
    assert not (tmp_path / "shuffled.toml").exists()


def test_outputs_are_whole_or_not_there(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "street.npz", street())
    (tmp_path / "old.toml").write_text("", encoding="utf-8")
    result = prc("calibrate", source, "-o", tmp_path / "old.toml")
    assert result.code == 2
    assert "exists already" in result.err
    assert prc("calibrate", source, "-o", tmp_path / "old.toml", "--overwrite", "-q").code == 0
    assert load_config(tmp_path / "old.toml").sources
    np.save(tmp_path / "short.npy", np.ones(7, np.uint8))
    files = sorted(tmp_path.iterdir())
    result = prc(
        "calibrate", source, "--method", "prc", "--reference", tmp_path / "short.npy", "-o", tmp_path / "new.toml"
    )
    assert (result.code, result.out) == (1, "")
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == files
    result = prc("calibrate", source, "-o", source, "--overwrite")
    assert result.code == 2
    assert "inputs are never modified" in result.err


def test_wrong_options(prc: Prc, tmp_path: Path) -> None:
    source = write_npz(tmp_path / "street.npz", street())
    for options, message in (
        (["--plot", tmp_path / "curves.png"], "ends in .svg"),
        (["--json", "--format", "markdown"], "contradict"),
        (["--reference", source, "--objective", "beauty"], "found score 'beauty'"),
        (["--reference", source, "--objective", "f1.houses"], "'f1.houses', expected one of: f1.noise, f1.ground, f1."),
        (["--objective", "beauty"], "--objective needs --reference"),
        (["--objective", "mean_f1"], "--objective needs --reference"),
        (["--budget", 9], "--budget needs --reference"),
        (["--mapping", "prc"], "--mapping needs --reference"),
        (["--keep", "prc.support.zeta_p"], "--keep needs --reference"),
        (["--training-share", 0.5], "--training-share needs --reference"),
        (["--seed", 1], "--seed needs --reference"),
        (["--max-shots", 5000], "--max-shots needs --reference"),
        (["--reference-dimension", "class"], "--reference-dimension needs --reference"),
        (["--reference", source, "--keep", "prc.zeta"], "--keep: found 'prc.zeta'"),
        (["--reference", tmp_path / "none.npy"], "no such file"),
    ):
        result = prc("calibrate", source, *options)
        assert result.code in (1, 2), message
        assert message in result.err
        assert result.code == 2 or "needs" not in message
        assert "mean_f1, ground" not in result.err
