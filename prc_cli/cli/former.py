"""Names that options and outputs had, or have in other commands: they work and are not shown."""

from __future__ import annotations

from typing import Any

import click


class Renamed(click.Option):
    """An option with former names.

    Parameters
    ----------
    former : tuple of str
        Names that are taken, but not listed.
    """

    def __init__(self, *args: Any, former: tuple[str, ...] = (), **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.former = former

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Add all names to the parser."""
        shown = self.opts
        self.opts = [*shown, *self.former]
        try:
            super().add_to_parser(parser, ctx)
        finally:
            self.opts = shown


def output_last(command: click.Command, args: list[str]) -> list[str]:
    """Take ``-o OUT`` where the output is an argument: it is the last one.

    Parameters
    ----------
    command : click.Command
        Left as it is where it has an option ``-o``, or no argument ``output``.
    args : list of str
        Of the command line.

    Returns
    -------
    list of str
        The same, with OUT at the end.
    """
    has_own = any("-o" in parameter.opts for parameter in command.params if isinstance(parameter, click.Option))
    arguments = [parameter.name for parameter in command.params if isinstance(parameter, click.Argument)]
    if has_own or "output" not in arguments:
        return args
    for i, word in enumerate(args):
        if word == "--":
            break
        if word in ("-o", "--output") and i + 1 < len(args):
            return [*args[:i], *args[i + 2 :], args[i + 1]]
        if word.startswith("--output="):
            return [*args[:i], *args[i + 1 :], word.removeprefix("--output=")]
    return args
