"""Help in sections: method, input, output, run."""

from __future__ import annotations

import click

SECTIONS: dict[str, frozenset[str]] = {
    "Method": frozenset({"method", "preset", "config_file", "assignments", "engine"}),
    "Input": frozenset(
        {
            "layout_file", "lines", "columns", "range_", "scanner", "topic", "metadata", "return_", "points_per_line",
            "max_range", "accept_doubts", "trust_order", "sort_by_time", "deep", "window_lines", "window_time",
            "window_first",
        }
    ),
    "Output": frozenset({"output", "outputs", "overwrite", "segment_ids", "labels", "draft"}),
    "Run": frozenset({"threads", "profile", "as_json", "quiet", "verbose"}),
}  # fmt: skip
"""Parameters by section; others stand under "Options", before all sections."""


class Sectioned(click.Command):
    """A command whose options are listed by what they are for."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, section by section; a command that classifies nothing keeps one list."""
        rows: dict[str, list[tuple[str, str]]] = {"Options": [], **{name: [] for name in SECTIONS}}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                is_help = "--help" in parameter.opts
                section = next((name for name, has in SECTIONS.items() if parameter.name in has), "Options")
                rows["Run" if is_help else section].append(record)
        if not rows["Method"]:
            super().format_options(ctx, formatter)
            return
        for name, records in rows.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)
