"""The command line: parses options, calls one job, prints the result. The only code that prints."""

from __future__ import annotations

import contextlib
import errno
import gc
import importlib
import io
import os
import signal
import sys
import threading
import traceback
import warnings
from typing import Any

import click

from prc_cli.cli.watching import go_on_in_child
from prc_cli.core.errors import AFTER_SIGNAL, ExitCode, PrcError, message, printable_lines
from prc_cli.core.files import (
    drop_proofs,
    forget_placed,
    keep_proofs,
    left_words,
    remove_own,
    take_back,
)
from prc_cli.core.interrupts import Interrupts
from prc_cli.core.near import did_you_mean, nearest
from prc_cli.core.paths import begin_command
from prc_cli.core.process import no_collecting, share_arena
from prc_cli.core.version import __version__

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": (
        "prc_cli.cli.demo:demo",
        "Simulate a street, classify it and draw it. Needs no data.",
    ),
    "info": (
        "prc_cli.cli.info:info",
        "Check whether a file can be classified, and print the command to type.",
    ),
    "classify": ("prc_cli.cli.classify:classify", "Give every shot of a file its class."),
    "render": (
        "prc_cli.cli.render:render",
        "Draw a scan, its classes, the differences of two labellings, or the cloud.",
    ),
    "explain": ("prc_cli.cli.explain:explain", "Explain why a shot has its class."),
    "evaluate": ("prc_cli.cli.evaluate:evaluate", "Compare predicted with reference classes."),
    "check": (
        "prc_cli.cli.check:check",
        "Write a page to check a random sample of the classes by hand.",
    ),
    "batch": (
        "prc_cli.cli.batch:batch",
        "Classify all files of an archive. An interrupted run can be resumed.",
    ),
    "stream": (
        "prc_cli.cli.stream:stream",
        "Classify a live stream: ranges on stdin, one class code per shot on stdout.",
    ),
    "calibrate": (
        "prc_cli.cli.calibrate:calibrate",
        "Measure the scanner and choose the parameters.",
    ),
    "objects": ("prc_cli.cli.objects:objects", "List stems, poles, cars and curbs."),
    "convert": (
        "prc_cli.cli.convert:convert",
        "Convert a file to another format, and report what is lost.",
    ),
    "transfer": (
        "prc_cli.cli.transfer:transfer",
        "Copy the classes to the registered points of the same drive.",
    ),
    "thin": ("prc_cli.cli.thin:thin", "Remove noise and thin out the classes that you name."),
    "simulate": (
        "prc_cli.cli.simulate:simulate",
        "Simulate a scan of a street or a forest with known classes.",
    ),
    "config": ("prc_cli.cli.config:config", "Show, check or describe the configuration."),
    "doctor": ("prc_cli.cli.doctor:doctor", "Check the installation, and a folder for outputs."),
    "completion": ("prc_cli.cli.completion:completion", "Print the shell completion script."),
}
"""Commands by name: their module (loaded when called) and the line in ``prc --help``."""


class LazyGroup(click.Group):
    """Loads a command only when it is called, so that ``prc --help`` loads only click."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the commands in the order in which a new user needs them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load one command."""
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        with no_collecting():
            command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without loading them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, Any, list[str]]:
        """Name the nearest command when one is unknown."""
        name = args[0] if args else ""
        if name and name not in COMMANDS and not name.startswith("-"):
            hint = did_you_mean(name, COMMANDS)
            ctx.fail(f"there is no command {name!r}" + (f"; {hint}" if hint else ""))
        return super().resolve_command(ctx, args)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Example: prc classify drive.laz drive_classified.laz",
)
@click.version_option(__version__, prog_name="prc")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Classify raw mobile laser scanning streams before registration, shot by shot.

    Start with prc demo, or with prc info and your own file.

    Exit codes: 0 done. 1 a file failed. 2 wrong usage or configuration. 3 a score is below the
    limit of --fail-under. 4 done with a warning. 5 another prc batch works in the same folder.
    """
    context = click.get_current_context()
    begin_command(context.invoked_subcommand or "")
    context.call_on_close(lambda: begin_command(""))
    forget_placed()


def main(args: list[str] | None = None) -> None:
    """Run the command line; errors of the package become a message and an exit code."""
    arguments = sys.argv[1:] if args is None else args
    if args is None:
        is_guarded = go_on_in_child(arguments, COMMANDS)
        share_arena()
        # pydantic then does not look through all installed packages for plugins
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
        keep_proofs()
    # the parent process may have closed stdout and stderr, as some daemons do
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115
    _leave_on_signals()
    if args is None and "--debug" not in arguments and not sys.warnoptions:
        warnings.simplefilter(
            "ignore"
        )  # of NumPy and Python, for programmers; tests run with them as errors
    # escape names that the terminal cannot show instead of stopping
    if args is None and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        code = _run(arguments, debug="--debug" in arguments)
    except SystemExit as stop:
        if isinstance(stop.code, int) and stop.code > AFTER_SIGNAL:
            take_back()
        raise
    finally:
        if args is None:
            remove_own()
            if not is_guarded:
                drop_proofs()
    if args is None:
        # skips Python's last garbage collection, a fifth of the time of a short command
        gc.freeze()
    sys.exit(code)


def _run(arguments: list[str], *, debug: bool) -> int:
    """Run one command and return its exit code."""
    failure: BaseException
    code: int
    try:
        # without standalone mode click returns the exit code of ``ctx.exit`` and raises the rest
        returned = cli.main(args=arguments, prog_name="prc", standalone_mode=False)
        sys.stdout.flush()
    except PrcError as error:
        failure = error
        text = error.message()
        code = error.exit_code
    except click.ClickException as error:
        # click 8.2 and newer: the message is the whole help
        if type(error).__name__ == "NoArgsIsHelpError":
            error.show()
            return error.exit_code
        failure = error
        text = _usage_message(error)
        code = error.exit_code
    except MemoryError as error:
        failure = error
        problem = "not enough memory for this input and these parameters"
        text = message("error", f"{problem}; {left_words()}")
        code = ExitCode.FAILED
    except ImportError as error:
        failure = error
        hint = "prc doctor checks the installation"
        text = message("error", f"a package cannot be loaded ({error})", hint)
        code = ExitCode.FAILED
    except (click.Abort, KeyboardInterrupt) as error:
        failure = error
        take_back()
        text = message("error", f"interrupted; {left_words()}")
        code = ExitCode.INTERRUPTED
    except OSError as error:
        failure = error
        text = _system_message(error)
        code = ExitCode.FAILED
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 - else Python complains at exit
    else:
        return returned if isinstance(returned, int) else ExitCode.DONE
    if debug:
        with contextlib.suppress(OSError):
            click.echo(printable_lines("".join(traceback.format_exception(failure))), err=True)
    with contextlib.suppress(OSError):
        click.echo(text, err=True)
    return code


def _usage_message(error: click.ClickException) -> str:
    context: click.Context | None = getattr(error, "ctx", None)
    text = " ".join(error.format_message().split()).removesuffix(".")
    if context is None:
        return message("error", text)
    if isinstance(error, click.MissingParameter) and error.param is not None:
        needed = error.param.opts[0]
        if isinstance(error.param, click.Argument):
            needed = " ".join(context.command.collect_usage_pieces(context)[1:])
        text = f"{context.command_path} needs {needed}"
    if isinstance(error, click.NoSuchOption):
        from prc_cli.cli.gone import instead_of

        option = error.option_name
        text = f"there is no option {option}"
        instead = instead_of(context.command_path, option)
        if instead is not None:
            return message("error", f"{text} any more", instead)
        near = nearest(option, error.possibilities or (), cutoff=0.75)
        text += f"; did you mean {near}?" if near else ""
    problem, _, advice = text.partition("; ")
    manual = f"see {context.command_path} --help"
    if advice:
        manual = f"{advice}{'' if advice.endswith('?') else ';'} {manual}"
    return message("error", problem, manual)


_LIMITS = {
    errno.EMFILE: "raise the limit of this shell: ulimit -n 4096",
    errno.ENFILE: "close other programs, or raise the limit of the system: fs.file-max",
    errno.EFBIG: "raise the limit of this shell: ulimit -f unlimited",
}
"""Hints for limits of the system."""


def _system_message(error: OSError) -> str:
    """Return the message of a system error; without a file name it is the terminal or a pipe."""
    why = error.strerror or str(error)
    if error.errno in _LIMITS:
        return message("error", f"{why}; {left_words()}", _LIMITS[error.errno])
    if error.filename is not None:
        where = os.fsdecode(error.filename)
        return message(f"error: {where}", why, "check the file and its permissions")
    return message("error", f"the result cannot be printed ({why})")


def _leave_on_signals() -> None:
    """Make SIGTERM (``kill``, ``timeout``) end a run like Ctrl-C: temporary files are removed."""
    if threading.current_thread() is not threading.main_thread():
        return
    interrupts = Interrupts()
    interrupts.on(signal.SIGTERM, lambda: SystemExit(ExitCode.TERMINATED))
    # the parent process may have set Ctrl-C to be ignored, as nohup does
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        interrupts.on(signal.SIGINT, KeyboardInterrupt)
