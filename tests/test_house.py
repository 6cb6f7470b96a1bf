"""The rules of the house."""

import ast
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

import prc_cli
from prc_cli.cli import COMMANDS, cli
from prc_cli.config import load_config
from prc_cli.evaluation import mapping
from prc_cli.formats.registry import formats
from tests import patience
from tests.measure import together, weigh

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted((ROOT / "prc_cli").rglob("*.py"))


def test_loops_know_the_compiler_by_core_alone():
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if path.parts[-2:] not in (("core", "loops.py"), ("core", "loop_cache.py")):
            assert "import numba" not in text, path
            assert "from numba" not in text, path


@pytest.mark.slow
def test_no_function_is_too_deep():
    """At most 5 compound statements in each other."""
    functions = [
        (f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node)
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    assert len(functions) > 1000
    assert [place for place, node in functions if nesting(node) > 5] == []


COMPOUND = (
    ast.For,
    ast.AsyncFor,
    ast.While,
    ast.If,
    ast.With,
    ast.AsyncWith,
    ast.Try,
    ast.TryStar,
    ast.Match,
    ast.ClassDef,
    ast.FunctionDef,
    ast.AsyncFunctionDef,
)


def nesting(node: ast.AST) -> int:
    """How many compound statements lie in each other within a node.

    An ``elif`` is as deep as its ``if``.
    """
    last = node.orelse if isinstance(node, ast.If) else []
    elifs = [child for child in last if isinstance(child, ast.If) and len(last) == 1]
    blocks = (ast.stmt, ast.excepthandler, ast.match_case)
    inner = (child for child in ast.iter_child_nodes(node) if isinstance(child, blocks))
    return max(
        (nesting(child) + (isinstance(child, COMPOUND) and child not in elifs) for child in inner),
        default=0,
    )


def test_help_loads_nothing_heavy():
    code = (
        "import sys\n"
        "from prc_cli.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'numba', 'laspy', 'scipy', 'skimage', 'pyarrow', 'pydantic', "
        "'rich', 'tqdm', 'PIL'}\n"
        "sys.exit(', '.join(sorted(heavy & set(sys.modules))) or 0)"
    )
    result = patience.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, f"loaded: {result.stderr}"
    assert "classify" in result.stdout


def test_public_functions_exist():
    for name in prc_cli.__all__:
        assert callable(getattr(prc_cli, name))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        prc_cli.nothing  # noqa: B018


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_help_with_an_example(name):
    result = CliRunner().invoke(cli, [name, "--help"])
    assert result.exit_code == 0
    assert "Example" in result.output, f"prc {name} --help shows no example"


def test_sample_layouts_and_mappings_are_valid():
    layouts = sorted((ROOT / "sample_configs" / "layouts").glob("*.toml"))
    assert layouts
    for path in layouts:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        load_config(options={"layout": table.get("layout", table)})
    mappings = sorted((ROOT / "sample_configs" / "classes").glob("*.toml"))
    assert mappings
    for path in mappings:
        mapping.load_mapping(path)


def test_the_citation_names_this_version_and_both_papers():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {prc_cli.__version__}\n" in citation
    assert "doi: 10.1109/TGRS.2019.2909351\n" in citation
    assert (
        "title: Online algorithms for classification of urban objects in 3D point clouds\n"
        in citation
    )


REPORTS = {"cli/evaluate.py", "cli/evaluate_answers.py", "jobs/objects/__init__.py"}
"""Modules that name suffixes of reports and lists, which are no scans."""


def test_suffixes_of_formats_stay_in_their_room():
    """Tables of suffixes derive from the records of formats.

    Names that are put together may end in one.
    """
    known = {
        suffix
        for record in formats()
        for suffix in (*record.scans, *record.streams, *record.labels, *record.codes)
    }
    root = Path(prc_cli.__file__).parent
    named: list[str] = []
    for path in sorted(root.rglob("*.py")):
        where = path.relative_to(root).as_posix()
        if where.startswith("formats/") or where in REPORTS:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        parts = {
            id(part)
            for node in ast.walk(tree)
            if isinstance(node, ast.JoinedStr)
            for part in node.values
        }
        named += [
            f"{where}:{node.lineno}: {node.value}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and node.value in known and id(node) not in parts
        ]
    assert named == []


HEAVIEST = {
    "prc_cli": {
        "tokens": 670_000,
        "tokens_per_line": 9.0,
        "long_lines": 20,
        "packed_share": 0.015,
        "named_once": 1235,
        "tuples": 21,
        "format_skips": 10,
        "riddles": 42,
    },
    "tests": {
        "tokens": 260_000,
        "tokens_per_line": 10.5,
        "long_lines": 20,
        "packed_share": 0.015,
        "tuples": 12,
        "format_skips": 10,
        "riddles": 55,
    },
    "benchmarks": {
        "tokens": 50_000,
        # the tables of scans, which had few tokens in a line, are benchmarks/scans.toml
        "tokens_per_line": 9.8,
        "long_lines": 5,
        "packed_share": 0.015,
        "tuples": 3,
        "format_skips": 10,
        "riddles": 5,
    },
}
"""What a reader had to read at the last release, with 5 % air."""


@pytest.mark.slow
@pytest.mark.parametrize("folder", HEAVIEST)
def test_the_house_is_no_heavier_to_read(folder):
    weight = together(weigh(ROOT / folder))
    heavier = {
        name: getattr(weight, name)
        for name, most in HEAVIEST[folder].items()
        if getattr(weight, name) > most
    }
    assert heavier == {}, "python -m tests.measure shows the rooms"
