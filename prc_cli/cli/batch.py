"""``prc batch``: a tree of files, at night, by itself."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from prc_cli.cli.options import (
    Layers,
    Sectioned,
    add_options,
    layers_from,
    output_options,
    stream_options,
)
from prc_cli.cli.output import print_json
from prc_cli.cli.paths import READ, READ_TEXT, WRITTEN, WRITTEN_TEXT
from prc_cli.config import BatchParams, command_tables
from prc_cli.core.config import read_toml
from prc_cli.core.errors import ConfigError, ExitCode, PrcError
from prc_cli.core.interrupts import raise_or_wait
from prc_cli.core.near import nearest
from prc_cli.core.own_file import read_own, write_own
from prc_cli.core.paths import begin_command

if TYPE_CHECKING:
    from collections.abc import Iterable

    from prc_cli.jobs.batch.engine import Engine
    from prc_cli.jobs.batch.outputs import Verified
    from prc_cli.jobs.batch.report import BatchSummary
    from prc_cli.jobs.batch.run import RunEvent
    from prc_cli.jobs.batch.types import BatchSettings

_TYPED = "prc_cli.batch.typed"
_COMMAND_SCHEMA = 2
_RUN = "run"
"""Word before ARCHIVE that may be left out."""
_MAX_COMMAND = 1 << 20
"""Largest file that is read as the last command [bytes]."""


class BatchCommand(Sectioned, click.Group):
    """A command whose first word is a folder, or the name of one of its subcommands."""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        """Go on with a subcommand that the first word names; ``./status`` is a folder."""
        if args and args[0] == _RUN:
            name = f"{info_name} {_RUN}"
            return self._of_run(name, args[1:], parent, **extra)
        if args and args[0] in self.commands:
            subcommand = self.commands[args[0]]
            name = f"{info_name} {args[0]}"
            return subcommand.make_context(name, args[1:], parent=parent, **extra)
        first = args[0] if args else ""
        near = nearest(first, [_RUN, *self.commands], cutoff=0.75)
        is_folder = "/" in first or Path(first).exists()
        if near and not first.startswith("-") and not is_folder:
            message = f"there is no folder {first}; did you mean prc batch {near}?"
            raise click.UsageError(message, parent)
        return self._of_run(info_name, args, parent, **extra)

    def _of_run(
        self, name: str | None, args: list[str], parent: click.Context | None, **extra: Any
    ) -> click.Context:
        typed = list(args)  # reading them takes them away
        context = super().make_context(name, args, parent=parent, **extra)
        context.meta[_TYPED] = typed
        out = str(context.params.get("out"))
        if out in self.commands and out in typed and f"./{out}" not in typed:
            message = f"did you mean {context.command_path} {out} FOLDER? Type ./{out} for a folder"
            raise click.UsageError(message, context)
        return context

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, then the subcommands."""
        super().format_options(ctx, formatter)
        self.format_commands(ctx, formatter)

    # what a plain command does, not a group
    allow_extra_args = False
    allow_interspersed_args = True
    parse_args = click.Command.parse_args
    invoke = click.Command.invoke
    collect_usage_pieces = click.Command.collect_usage_pieces
    shell_complete = click.Command.shell_complete


def _complete_archive(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = [name for name in (_RUN, *batch.commands) if name.startswith(incomplete)]
    return [*map(CompletionItem, names), CompletionItem(incomplete, type="dir")]


_option = click.option

_SELECTION = [
    _option(
        "--include",
        multiple=True,
        metavar="GLOB",
        help="Use only files whose names match, e.g. '2026/**/*.laz'.",
    ),
    _option(
        "--exclude",
        multiple=True,
        metavar="GLOB",
        help="Skip files and folders whose names match.",
    ),
    _option(
        "--drive",
        "drives",
        multiple=True,
        metavar="GLOB",
        help="Read files that differ only in the last wildcards, as '??' in 'drive_*_??.laz', "
        "as one "
        "drive, in the order of these numbers. Each file gets its own output.",
    ),
    _option(
        "--since",
        type=READ_TEXT,
        metavar="WHEN",
        help="Use only files changed since WHEN: 2026-01-31, 7d, 12h, or the time of a file.",
    ),
    _option(
        "--limit",
        type=click.IntRange(min=1),
        metavar="N",
        help="Classify at most N files in this run. A drive is not split.",
    ),
    _option(
        "--shard", metavar="I/N", help="Use only part I of N. Give every machine another part."
    ),
]
_WORK = [
    _option(
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Files at the same time. Default: one per core.",
    ),
    _option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use the Dask cluster at this address, e.g. tcp://10.0.0.1:8786.",
    ),
]
_OUTPUTS = [
    _option(
        "--to",
        default="same",
        show_default=True,
        metavar="FORMAT",
        help="laz, las, npy, csv or parquet. same: LAS for LAS, LAZ for LAZ, "
        "labels (.npy) for others.",
    ),
    _option("--overwrite", is_flag=True, help="Replace outputs that prc batch did not write."),
    _option(
        "--verify",
        is_flag=True,
        help="Compare the content of inputs and outputs, not only size and time. "
        "prc batch --verify OUT "
        "only checks the outputs.",
    ),
    _option(
        "--dry-run", is_flag=True, help="Only print the plan, with estimates of time and memory."
    ),
]
_CHECKS = [
    _option(
        "--reference",
        type=READ,
        metavar="TREE",
        help="Compare with the files of the same name in this folder, with any suffix.",
    ),
    _option(
        "--fail-under",
        "gates",
        multiple=True,
        metavar="SCORE.CLASS=VALUE",
        help="If a score of all files together is lower, exit with code 3, e.g. "
        "recall.ground=0.95.",
    ),
]
_REPORTING = [
    _option(
        "--log-json",
        type=WRITTEN_TEXT,
        metavar="FILE|-",
        help="Append every event to FILE as a line of JSON.",
    ),
]


@click.group(
    cls=BatchCommand,
    subcommand_metavar="",
    brief=(
        "--include",
        "--exclude",
        "--jobs",
        "--to",
        "--overwrite",
        "--dry-run",
        "--fail-under",
        "--preset",
        "--config",
        "--log-json",
        "--quiet",
    ),
)
@click.argument("archive", type=READ, shell_complete=_complete_archive)
@click.argument("out", type=WRITTEN, required=False)
@add_options(*_SELECTION, *_WORK, *_OUTPUTS, *_CHECKS, *_REPORTING)
@stream_options
@output_options
def batch(**options: Any) -> None:
    """Classify every file of ARCHIVE, and write it to the same place in OUT.

    prc skips finished files. If an input, the configuration or the version of prc has changed, prc
    classifies the file again. An interrupted run continues where it stopped. The journal is in
    OUT/.prc. The file of --config may contain [[override]] tables for some of the files, and a
    table [batch]: retry, stall, memory_limit, ... prc batch run ARCHIVE OUT does the same.

    Exit codes: 0 done. 1 a file failed. 2 wrong usage. 3 a score is below --fail-under. 4 a file
    has a warning or unusual classes. 5 another run works in OUT.

    \b
    Examples:
      prc batch /archive /classified
      prc batch /archive /classified --config archive.toml --jobs 4 --dry-run
      prc batch /archive /classified --drive 'drive_*_??.laz'
      prc batch /archive /classified --config archive.toml -q --log-json /var/log/prc.jsonl
      prc batch status /classified
      prc batch retry /classified
      prc batch --verify /classified
    """
    if options["out"] is not None:
        _run(options, click.get_current_context().meta[_TYPED])
    elif options["verify"]:
        _verify(options["archive"], as_json=options["as_json"], quiet=options["quiet"])
    else:
        raise click.MissingParameter(param_hint="'OUT'", param_type="argument")


@batch.command()
@click.argument("out", type=READ)
@_option("--json", "as_json", is_flag=True, help="Print all of it as JSON on stdout.")
@_option(
    "--verify",
    is_flag=True,
    help="Also compare the hash of every output. If one is damaged, exit with code 1.",
)
def status(out: Path, as_json: bool, verify: bool) -> None:
    """Print what is done in OUT, what failed and why, the warnings, and which runs are active.

    \b
    Examples:
      prc batch status /classified
      prc batch status /classified --verify
    """
    from prc_cli.cli.batch_report import print_status, print_verified, status_dict
    from prc_cli.jobs.batch.journal import read_entries, read_runs
    from prc_cli.jobs.batch.lock import holders
    from prc_cli.jobs.batch.outputs import own_folder, verify_outputs

    folder = own_folder(out)
    entries = read_entries(folder)
    runs = read_runs(folder)
    owners = holders(folder)
    verified = tuple(verify_outputs(out)) if verify else ()
    if as_json:
        more = {"verified": [asdict(item) for item in verified]} if verify else {}
        print_json(status_dict(entries, runs, owners) | more, indent=1)
    else:
        print_status(out, entries, runs, owners)
        if verify:
            print_verified(out, verified, quiet=False)
    click.get_current_context().exit(_verified_code(verified))


@batch.command()
@click.argument("out", type=READ)
@_option("--shard", metavar="I/N", help="Repeat the last run of this shard.")
@_option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Files at the same time.  [default: as in the last run]",
)
@_option("--dry-run", is_flag=True, help="Only print the plan.")
@output_options
def retry(out: Path, shard: str | None, **changes: Any) -> None:
    """Repeat the files of OUT that failed or were interrupted, with the options of the last run.

    \b
    Examples:
      prc batch retry /classified
      prc batch retry /classified --jobs 1
    """
    from prc_cli.jobs.batch.outputs import own_folder
    from prc_cli.jobs.batch.types import Shard, own_name

    last = own_name("command", None if shard is None else Shard.parse(shard), ".json")
    folder, typed, options = _read_command(own_folder(out) / last)
    options |= {key: value for key, value in changes.items() if value is not None}
    options |= {"only_failed": True, "limit": None, "since": None, "out": out.absolute()}
    # names that were given to the last run start at the folder that it was started in
    with contextlib.chdir(folder):
        _run(options, typed)


@batch.command()
@click.argument("out", type=WRITTEN)
@click.argument("archive", metavar="[ARCHIVE]", type=READ, required=False)
@_option("--dry-run", is_flag=True, help="Only print what prc would remove.")
@_option("--json", "as_json", is_flag=True, help="Print it as JSON on stdout.")
def clean(
    out: Path,
    archive: Path | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Remove temporary files of interrupted runs from OUT. Outputs stay.

    If you name the ARCHIVE, prc also forgets the inputs that are no longer in it.

    \b
    Examples:
      prc batch clean /classified --dry-run
      prc batch clean /classified /archive
    """
    from prc_cli.cli.batch_report import print_cleaned
    from prc_cli.jobs.batch.outputs import clean as clean_folder

    cleaned = clean_folder(out, archive=archive, dry_run=dry_run)
    if as_json:
        table = {
            "removed": [str(path) for path in cleaned.files],
            "bytes": cleaned.n_bytes,
            "forgotten": list(cleaned.forgotten),
            "kept": [str(path) for path in cleaned.kept],
            "dry_run": dry_run,
        }
        print_json(table, indent=1)
    else:
        print_cleaned(cleaned, dry_run=dry_run)


def _run(options: dict[str, Any], typed: Sequence[str]) -> None:
    if options["as_json"] and options["log_json"] == "-":
        message = "--json and --log-json - both write to stdout; give --log-json a file"
        raise click.UsageError(message)
    layers = layers_from(options)
    params = _params(layers)
    settings = _settings(options, layers, params)
    if options["dry_run"]:
        _dry_run(settings, options)
        return
    summary = _run_and_print(settings, options, typed, has_stamps=params.time_stamps)
    if options["as_json"]:
        from prc_cli.jobs.batch.report import as_dict

        print_json(as_dict(summary), indent=1, allow_nan=False)
    click.get_current_context().exit(summary.exit_code)


def _verified_code(outputs: Iterable[Verified]) -> ExitCode:
    is_whole = all(output.state == "whole" for output in outputs)
    return ExitCode.DONE if is_whole else ExitCode.FAILED


def _verify(out: Path, *, as_json: bool, quiet: bool) -> None:
    """Print which outputs are whole; exit code 1 if one is not."""
    from prc_cli.cli.batch_report import print_verified
    from prc_cli.jobs.batch.outputs import verify_outputs

    outputs = tuple(verify_outputs(out))
    if as_json:
        print_json([asdict(output) for output in outputs], indent=1)
    else:
        print_verified(out, outputs, quiet=quiet)
    click.get_current_context().exit(_verified_code(outputs))


def _settings(options: dict[str, Any], layers: Layers, params: BatchParams) -> BatchSettings:
    from prc_cli.jobs.batch.references import check_reference
    from prc_cli.jobs.batch.types import BatchSettings, ConfigLayers, ReferenceSettings, Shard

    if options["gates"] and options["reference"] is None:
        message = "--fail-under needs --reference TREE"
        raise click.UsageError(message)
    reference = None
    if options["reference"] is not None:
        reference = ReferenceSettings(
            options["reference"], params.mapping, params.match, options["gates"]
        )
        check_reference(reference)
    same = (
        "archive",
        "out",
        "include",
        "exclude",
        "drives",
        "since",
        "limit",
        "jobs",
        "to",
        "overwrite",
        "verify",
    )
    return BatchSettings(
        config=ConfigLayers(layers.path, layers.preset, layers.table, layers.files),
        shard=None if options["shard"] is None else Shard.parse(options["shard"]),
        threads=params.threads,
        retry=params.retry,
        fail_fast=params.fail_fast,
        stall_s=params.stall,
        memory_limit_mib=params.memory_limit,
        drift=params.drift,
        reference=reference,
        # only prc batch retry sets it
        only_failed=options.get("only_failed", False),
        **{key: options[key] for key in same},
    )


def _params(layers: Layers) -> BatchParams:
    """Return the table ``[batch]``; a relative file in it starts at the folder of its file."""
    table = {} if layers.path is None else read_toml(layers.path)
    batch = table.get("batch")
    mapping = batch.get("mapping") if isinstance(batch, Mapping) else None
    if isinstance(batch, dict) and isinstance(mapping, str) and mapping.endswith(".toml"):
        batch["mapping"] = str(Path(layers.path or "").parent / mapping)
    commands, _, _ = command_tables(table, layers.table, str(layers.path))
    return commands.batch


def _engine(
    settings: BatchSettings, scheduler: str | None, notice: Callable[[str], None]
) -> Engine | None:
    """Return the engine; None = this machine."""
    if scheduler is None:
        return None
    from prc_cli.jobs.batch.dask_engine import DaskEngine

    threads = settings.threads or 1
    return DaskEngine(scheduler, notice=notice, jobs=settings.jobs, threads=threads)


def _dry_run(settings: BatchSettings, options: dict[str, Any]) -> None:
    from prc_cli.cli.batch_report import plan_dict, print_note, print_plan
    from prc_cli.jobs.batch.run import plan_batch

    _engine(settings, options["scheduler"], print_note)  # checks the options
    plan, estimate = plan_batch(settings)
    if options["as_json"]:
        print_json(plan_dict(plan, estimate), indent=1, allow_nan=False)
    else:
        print_plan(plan, estimate, verbose=options["verbose"])


def _run_and_print(
    settings: BatchSettings, options: dict[str, Any], typed: Sequence[str], *, has_stamps: bool
) -> BatchSummary:
    from prc_cli.cli.batch_report import Final, JsonLog, ProgressPrinter, print_end, print_note
    from prc_cli.jobs.batch.run import Noted, Ready, run_batch

    quiet = options["quiet"]
    on_terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    shows_bar = on_terminal and not quiet and not has_stamps
    log = None if options["log_json"] is None else JsonLog(options["log_json"])
    if log is not None:
        log.start(
            settings.archive, settings.out, None if settings.shard is None else str(settings.shard)
        )

    def keep_command(event: RunEvent) -> None:
        if isinstance(event, Ready):  # the lock is held
            _write_command(settings, typed)

    _end_with_terminal()
    summary: BatchSummary | None = None
    code = int(ExitCode.FAILED)
    problem = ""
    try:
        with contextlib.ExitStack() as stack:
            show = ProgressPrinter(
                quiet=quiet,
                verbose=options["verbose"],
                stamps=has_stamps,
                bar=shows_bar,
            )
            stack.callback(show.close)
            final = Final(keep_command, show, *([] if log is None else [log]))
            stack.callback(final.close)
            engine = _engine(settings, options["scheduler"], lambda text: final(Noted(text)))
            summary = run_batch(settings, engine, final)
        code = summary.exit_code
    except PrcError as error:
        code = error.exit_code
        problem = str(error)
        raise
    except (KeyboardInterrupt, SystemExit) as stop:
        code = int(stop.code or 0) if isinstance(stop, SystemExit) else ExitCode.INTERRUPTED
        problem = "interrupted"
        print_note("interrupted; finished files stay, and the next run continues")
        raise SystemExit(code) from None
    finally:
        if log is not None:
            log.end(code, summary, problem)
    print_end(
        summary,
        quiet=quiet,
        listed=not shows_bar,
        only_failed=settings.only_failed,
        trusting=not settings.verify,
    )
    return summary


def _end_with_terminal() -> None:
    """End a run when its terminal is closed, as SIGTERM does, but not under ``nohup``."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGHUP"):
        return
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(
            signal.SIGHUP, lambda number, frame: raise_or_wait(SystemExit(ExitCode.HANGUP))
        )


# -- the last run, for retry -----------------------------------------------------------------


def _write_command(settings: BatchSettings, typed: Sequence[str]) -> None:
    """Keep the arguments beside the journal; if that fails, the run continues."""
    from prc_cli.jobs.batch.types import OWN_FOLDER, own_name

    table = {"schema": _COMMAND_SCHEMA, "folder": str(Path.cwd()), "arguments": typed}
    path = settings.out / OWN_FOLDER / own_name("command", settings.shard, ".json")
    # prc batch retry obeys nobody else
    with contextlib.suppress(PrcError):
        write_own(path, json.dumps(table, indent=1) + "\n", private=True)


def _read_command(path: Path) -> tuple[Path, list[str], dict[str, Any]]:
    """Read the last run: its working folder, its arguments, and its options."""
    hint = "type the whole command again; finished files are skipped"
    try:
        table = json.loads(read_own(path, _MAX_COMMAND))
        folder = Path(table["folder"])
        typed = [str(word) for word in table["arguments"]]
        begin_command("batch")  # its options are those of the last run
        context = batch.make_context("prc batch", list(typed))
        if (
            table["schema"] != _COMMAND_SCHEMA
            or not folder.is_dir()
            or context.command is not batch
        ):
            raise ValueError
    except FileNotFoundError:
        raise ConfigError(
            str(path), "is missing: it contains the options of the last run", hint
        ) from None
    except PermissionError as error:
        problem = f"other users can change this file ({error.strerror})"
        raise ConfigError(str(path), problem, hint) from None
    except (
        click.ClickException,
        click.exceptions.Exit,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        RecursionError,
    ):
        raise ConfigError(
            str(path), "cannot be read: it contains the options of the last run", hint
        ) from None
    return folder, typed, context.params
