"""House rules: who imports whom, who prints, what ``prc --help`` loads."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

import prc_cli
from prc_cli.cli import COMMANDS, cli
from prc_cli.config import load_config
from prc_cli.evaluation import mapping

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted((ROOT / "prc_cli").rglob("*.py"))


def test_compiled_loops_live_in_kernels_and_the_oracle_knows_none_of_them() -> None:
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if "kernels" not in path.parts:
            assert "import numba" not in text, path
            assert "from numba" not in text, path
    oracle = (ROOT / "prc_cli/reference/prc/stages.py").read_text(encoding="utf-8")
    imported = {
        (node.module or "") if isinstance(node, ast.ImportFrom) else name.name
        for node in ast.walk(ast.parse(oracle))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in node.names
    }
    assert not {name for name in imported if name.startswith("prc_cli") and name != "prc_cli.core.types"}


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from prc_cli.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'numba', 'laspy', 'scipy', 'skimage', 'pyarrow', 'pydantic', 'rich', 'tqdm', 'PIL'}\n"
        "sys.exit(', '.join(sorted(heavy & set(sys.modules))) or 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"loaded: {result.stderr}"
    assert "classify" in result.stdout


def test_public_functions_exist() -> None:
    for name in prc_cli.__all__:
        assert callable(getattr(prc_cli, name))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        prc_cli.nothing  # noqa: B018


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_help_with_an_example(name: str) -> None:
    result = CliRunner().invoke(cli, [name, "--help"])
    assert result.exit_code == 0
    assert "Example" in result.output, f"prc {name} --help shows no example"


def test_sample_layouts_and_mappings_are_valid() -> None:
    layouts = sorted((ROOT / "sample_configs" / "layouts").glob("*.toml"))
    assert layouts
    for path in layouts:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        load_config(options={"layout": table.get("layout", table)})
    mappings = sorted((ROOT / "sample_configs" / "classes").glob("*.toml"))
    assert mappings
    for path in mappings:
        mapping.load_mapping(path)


def test_the_citation_names_this_version_and_both_papers() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {prc_cli.__version__}\n" in citation
    assert "doi: 10.1109/TGRS.2019.2909351\n" in citation
    assert "title: Online algorithms for classification of urban objects in 3D point clouds\n" in citation
