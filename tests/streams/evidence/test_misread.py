"""Tests of dumps that are read wrongly: which bytes make ranges of a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import main
from prc_cli.core.types import F32
from prc_cli.streams.evidence.lines import Reading, other_reading

M, LINES = 1000, 200


def run(arguments: list[str]) -> object:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    return stop.value.code


def street() -> F32:
    """A road and two walls around a scanner 2 m above it, a tenth of the shots missing, 5 mm of noise."""
    angle = np.linspace(-np.pi, np.pi, M, endpoint=False)
    noise = np.random.default_rng(3).normal(0, 0.005, (LINES, M))
    with np.errstate(divide="ignore"):
        wall = np.where(np.arange(LINES)[:, None] // 40 % 2, 6.0, 9.0) / np.abs(np.sin(angle))
        road = np.where(np.cos(angle) > 0, 2.0 / np.cos(angle), np.inf)
    range_m = np.minimum(np.minimum(road, wall), 60.0) + noise
    range_m[:, : M // 20] = range_m[:, -M // 20 :] = 0
    return range_m.astype(np.float32)


@pytest.mark.parametrize(
    ("stored", "scale", "header", "options"),
    [
        ("<f4", 1, 0, ""),
        (">f4", 1, 0, "--set layout.endian=big"),
        ("<f4", 1, 2, "--set layout.header_bytes=2"),
        ("<f4", 1, 128, "--set layout.header_bytes=128"),
        ("<f8", 1, 0, """--set 'layout.fields=[{name="range",type="f8",missing=0}]'"""),
        ("<u2", 1000, 0, """--set 'layout.fields=[{name="range",type="u2",scale=0.001,missing=0}]'"""),
        ("<u2", 100, 0, """--set 'layout.fields=[{name="range",type="u2",scale=0.01,missing=0}]'"""),
        (
            ">u4", 1000, 3,
            """--set 'layout.fields=[{name="range",type="u4",scale=0.001,missing=0}]' --set layout.endian=big """
            "--set layout.header_bytes=3",
        ),
        ("<f4", 1000, 0, """--set 'layout.fields=[{name="range",type="f4",scale=0.001,missing=0}]'"""),
    ],
)  # fmt: skip
def test_the_right_reading_is_found(tmp_path: Path, stored: str, scale: float, header: int, options: str) -> None:
    """Whatever type, byte order, unit and header."""
    dump = tmp_path / "scan.bin"
    dump.write_bytes(bytes(range(header)) + (street() * scale).astype(stored).tobytes())
    found = other_reading(dump, M)
    assert found is not None
    assert found.options() == options


def test_what_is_no_scan_has_no_reading(tmp_path: Path) -> None:
    dump = tmp_path / "scan.bin"
    for content in (
        np.random.default_rng(1).bytes(1 << 18),
        bytes(1 << 18),
        np.full(1 << 16, 8, "<f4").tobytes(),
        np.random.default_rng(1).permutation(street().ravel()).tobytes(),
        street().tobytes()[:4000],
    ):
        dump.write_bytes(content)
        assert other_reading(dump) is None


def test_a_header_is_whole_numbers_of_another_kind(tmp_path: Path) -> None:
    """Bytes that are too many are a header only if few, and if they end where the numbers begin."""
    dump, bytes_ = tmp_path / "scan.bin", street().tobytes()
    dump.write_bytes(b"h" + bytes_ + bytes(6))
    assert other_reading(dump, M) == Reading("f4", "little", 1, 1.0, has_zeros=True)
    dump.write_bytes(b"h" + bytes_)
    assert other_reading(dump) == Reading("f4", "little", 1, 1.0, has_zeros=True)


def test_the_refusal_names_the_options_that_mend_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is named can be typed, and labels the scan."""
    dump, labels = tmp_path / "scan.bin", tmp_path / "labels.npy"
    street().astype(">f4").tofile(dump)
    command = ["classify", str(dump), str(labels), "--preset", "urban", "-M", str(M)]
    assert run(command) == 1
    assert "; its bytes are ranges of a scan with --set layout.endian=big, or insist" in capsys.readouterr().err
    assert run(["info", str(dump), "-M", str(M)]) == 0
    assert f"-M {M} --set layout.endian=big\n" in capsys.readouterr().out
    assert run([*command, "--set", "layout.endian=big"]) == 0
