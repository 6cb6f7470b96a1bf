"""``prc config``: the effective configuration, with the source of every value."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import config_from, stream_options
from prc_cli.cli.output import print_json, print_result, print_text
from prc_cli.cli.paths import READ
from prc_cli.config import (
    json_schema,
    load_config,
    params_to_toml,
    preset_summaries,
    sample_summaries,
    to_toml,
)
from prc_cli.core.config import read_toml
from prc_cli.core.errors import message


@click.group()
def config() -> None:
    """Show, check or describe the configuration.

    \b
    Example: prc config show --preset fused-forest > forest.toml
    """


@config.command()
@stream_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON, with the source of every value.")
def show(as_json: bool, **options: Any) -> None:
    """Print the effective configuration as TOML, ready to use as a configuration file.

    \b
    Example: prc config show --set fused.lines_per_block=50
    """
    loaded = config_from(options)
    if as_json:
        commands = loaded.commands.model_dump(mode="json", exclude_none=True)
        print_json({"config": loaded.config.to_table() | commands, "sources": loaded.sources})
    else:
        print_text(f"{to_toml(loaded)}\n{params_to_toml(loaded.commands, loaded.sources)}")


@config.command()
@click.argument("file", type=READ)
def check(file: Path) -> None:
    """Check a configuration file. If a key is wrong, print it and exit with code 2.

    The file may contain the [[override]] tables of prc batch.

    \b
    Example: prc config check night_run.toml
    """
    from prc_cli.methods.prc.support import unusual

    overrides = read_toml(file).get("override")
    if overrides is None:
        loaded = load_config(file)
        more = ""
    else:
        from prc_cli.jobs.batch.configs import BatchConfig
        from prc_cli.jobs.batch.types import ConfigLayers

        loaded = BatchConfig(ConfigLayers(file)).base
        more = f" and {len(overrides)} override{'s' * (len(overrides) != 1)}"
    print_result(f"{file}: valid, {len(loaded.sources)} keys set{more}")
    if (
        loaded.config.method == "prc"
        and (warning := unusual(loaded.config.prc.support)) is not None
    ):
        click.echo(message("warning", warning, "set zeta_s >= zeta_p"), err=True)


@config.command()
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print JSON, with all values and the file of each preset.",
)
def presets(as_json: bool) -> None:
    """List the presets and the sample configurations, with their purpose.

    "changed" is the number of values that differ from the defaults.

    \b
    Example: prc config presets
    """
    summaries = preset_summaries()
    if as_json:
        rows = [
            {
                "name": preset.name,
                "purpose": preset.purpose,
                "method": preset.method,
                "changed": preset.n_changed,
                "values": preset.values,
                "file": str(preset.file),
            }
            for preset in summaries
        ]
        print_json({"presets": rows})
        return
    width = max(len(preset.name) for preset in summaries)
    print_result(f"{'preset':{width}}  changed  what for")
    for preset in summaries:
        print_result(f"{preset.name:{width}}  {preset.n_changed:7}  {preset.purpose}")
    print_result("")
    print_result("sample configurations, for --config:")
    for file, purpose in sample_summaries():
        print_result(f"{file.name:{width}}  {purpose}")
    print_result("")
    print_result(
        "If you name no preset, prc chooses the method from the input: prc info FILE prints it."
    )


@config.command()
def schema() -> None:
    """Print the JSON schema of the configuration file (for editors).

    \b
    Example: prc config schema > prc.schema.json
    """
    print_json(json_schema())
