"""An input is resolved once: file, parts, format, layout, and why it cannot be read."""

import numpy as np
import pytest

from prc_cli.config import load_config, resolve
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig

LAYOUT = """
[input]
points_per_line = 4
lines = "fixed"

[fused]
environment = "forest"

[layout]
fields = [{ name = "range", type = "f4" }]
"""


def test_nothing_is_refused_before_the_check(tmp_path):
    scan = Input.of(tmp_path / "none.laz")
    assert scan.is_las
    for ask in (scan.check, scan.records, lambda: scan.images(InputConfig())):
        with pytest.raises(InputError, match="no such file"):
            ask()


def test_a_bag_of_several_files_is_its_metadata(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    names = ("bag_0.db3", "bag_1.db3")
    for name in names:
        (bag / name).write_bytes(b"x")
    (bag / "metadata.yaml").write_text("".join(f"- {name}\n" for name in names))
    scan = Input.of(bag)
    assert (scan.name, scan.suffix, scan.refusal) == ("metadata.yaml", ".db3", None)
    assert [part.name for part in scan.parts] == list(names)
    (bag / names[0]).write_bytes(b"")
    with pytest.raises(InputError, match=r"bag_0.db3: the file is empty"):
        Input.of(bag).check()


def test_the_layout_beside_a_dump_is_the_lowest_layer(tmp_path):
    dump = tmp_path / "a.bin"
    dump.write_bytes(bytes(64))
    beside = tmp_path / "a.bin.toml"
    beside.write_text(LAYOUT)
    option = load_config(options={"input": {"points_per_line": 8}})
    scan, loaded = resolve(dump, option)
    assert loaded.config.input.points_per_line == 8
    assert loaded.config.input.lines == "fixed"
    assert loaded.config.method == "auto"
    assert loaded.config.fused.environment == option.config.fused.environment
    assert scan.layout == loaded.config.layout
    assert loaded.sources["input.points_per_line"] == "option"
    assert loaded.sources["input.lines"] == str(beside)
    assert loaded.inputs(dump) == (dump, beside)
    # resolved again, nothing changes
    assert resolve(dump, loaded)[1] == loaded
    with pytest.raises(ConfigError, match=r"a\.bin\.toml.*not valid TOML"):
        beside.write_text("[layout")
        resolve(dump)


def test_a_copy_that_never_ended_is_refused(tmp_path):
    path = tmp_path / "a.npy"
    with path.open("wb") as handle:
        np.lib.format.write_array_header_1_0(
            handle, {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1024)}
        )
        handle.truncate(handle.tell() + (1 << 32))
    if getattr(path.stat(), "st_blocks", 1 << 40) * 512 > 1 << 20:
        pytest.skip("this file system has no holes")
    with pytest.raises(InputError, match="the disk stores almost none of its"):
        Input.of(path).check()
