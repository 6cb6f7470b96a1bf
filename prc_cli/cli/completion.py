"""``prc completion``: the script that makes a shell complete commands and options."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    \b
    Example: prc completion bash > ~/.local/share/bash-completion/completions/prc
    """
    from prc_cli.cli import cli

    script = get_completion_class(shell)
    assert script is not None  # the choice above lists what click ships
    click.echo(script(cli, {}, "prc", "_PRC_COMPLETE").source())
