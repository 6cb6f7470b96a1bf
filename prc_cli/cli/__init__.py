"""The command line: parses options, calls one job, prints the result. The only code that prints."""

from __future__ import annotations

import contextlib
import errno
import gc
import importlib
import io
import math
import os
import signal
import sys
import threading
import time
import traceback
import warnings
from typing import Any

import click

from prc_cli.cli.guard import REPEATED_S, begin
from prc_cli.core.errors import AFTER_SIGNAL, ExitCode, PrcError, printable, printable_lines
from prc_cli.core.files import (
    drop_proofs,
    forget_placed,
    keep_proofs,
    left_words,
    remove_own,
    take_back,
)
from prc_cli.core.paths import begin_command
from prc_cli.core.process import claim_process, no_collecting, raise_or_hold
from prc_cli.core.version import __version__

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": (
        "prc_cli.cli.demo:demo",
        "Simulate scans, classify them, evaluate them, draw them: no data needed.",
    ),
    "info": (
        "prc_cli.cli.info:info",
        "Say what a file holds, whether it can be classified, and how.",
    ),
    "classify": ("prc_cli.cli.classify:classify", "Give every shot of a file its class."),
    "render": (
        "prc_cli.cli.render:render",
        "Draw a scan, its steps, its classes, differences, or the cloud.",
    ),
    "explain": ("prc_cli.cli.explain:explain", "Say why a shot has its class, stage by stage."),
    "evaluate": ("prc_cli.cli.evaluate:evaluate", "Compare predicted with reference classes."),
    "batch": (
        "prc_cli.cli.batch:batch",
        "Classify an archive of files; resumes, journals, many at a time.",
    ),
    "stream": (
        "prc_cli.cli.stream:stream",
        "Label a live stream: ranges on stdin, one class code a shot on stdout.",
    ),
    "calibrate": (
        "prc_cli.cli.calibrate:calibrate",
        "Measure the sensor and derive the parameters.",
    ),
    "objects": ("prc_cli.cli.objects:objects", "List stems, poles, cars and curbs as they pass."),
    "convert": (
        "prc_cli.cli.convert:convert",
        "Write a file in another format, and say what it cannot hold.",
    ),
    "transfer": (
        "prc_cli.cli.transfer:transfer",
        "Carry classes onto the registered points of the same drive.",
    ),
    "thin": ("prc_cli.cli.thin:thin", "Drop noise and thin out chosen classes of a stream."),
    "simulate": (
        "prc_cli.cli.simulate:simulate",
        "Make a scan of a street or a forest whose classes are known.",
    ),
    "config": ("prc_cli.cli.config:config", "Show, check or describe the configuration."),
    "doctor": ("prc_cli.cli.doctor:doctor", "Check the installation and a folder for outputs."),
    "completion": ("prc_cli.cli.completion:completion", "Print the shell completion script."),
}
"""Commands by name: their module (loaded when called) and the line in ``prc --help``."""


AGAIN_S = 0.05
"""Delay after which a dropped signal is raised again [s]."""


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
            import difflib

            near = difflib.get_close_matches(name, COMMANDS, n=1)
            hint = (
                f"did you mean {near[0]!r}?" if near else f"known commands: {', '.join(COMMANDS)}"
            )
            ctx.fail(f"no such command {name!r}; {hint}")
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

    Exit codes: 0 done, 1 a file failed, 2 wrong usage or configuration, 3 an evaluation gate
    failed, 4 done, but look at it: a doubt, or in an archive unusual classes; of prc batch also 5
    another run is at work.
    """
    context = click.get_current_context()
    begin_command(context.invoked_subcommand or "")
    context.call_on_close(lambda: begin_command(""))
    forget_placed()


def main(args: list[str] | None = None) -> None:
    """Run the command line; errors of the package become one line and an exit code."""
    arguments = sys.argv[1:] if args is None else args
    if args is None:
        is_guarded = begin(arguments, frozenset(COMMANDS))
        claim_process()
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
        message = printable(str(error))
        code = error.exit_code
    except click.ClickException as error:
        if (
            type(error).__name__ == "NoArgsIsHelpError"
        ):  # click 8.2 and newer: its message is the whole help
            error.show()
            return error.exit_code
        failure = error
        context = getattr(error, "ctx", None)
        said = _without_line_ends(error)
        if context is not None:
            # click ends its sentences with a full stop, some after a colon of their own
            said = (
                said.removesuffix(".")
                + (" " if said.endswith("?") else "; ")
                + f"see {context.command_path} --help"
            )
            if isinstance(error, click.MissingParameter) and isinstance(
                error.param, click.Argument
            ):
                said += f", expected {' '.join(context.command.collect_usage_pieces(context)[1:])}"
        message = printable(said)
        code = error.exit_code
    except MemoryError as error:
        failure = error
        message = f"not enough memory for this input and these parameters; {left_words()}"
        code = ExitCode.FAILED
    except ImportError as error:
        failure = error
        message = printable(
            f"a package cannot be loaded ({error}); prc doctor checks the installation"
        )
        code = ExitCode.FAILED
    except (click.Abort, KeyboardInterrupt) as error:
        failure = error
        take_back()
        message = printable(f"interrupted; {left_words()}")
        code = ExitCode.INTERRUPTED
    except OSError as error:
        failure = error
        message = printable(_system_problem(error))
        code = ExitCode.FAILED
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 - else Python complains at exit
    else:
        return returned if isinstance(returned, int) else ExitCode.DONE
    if debug:
        with contextlib.suppress(OSError):
            click.echo(printable_lines("".join(traceback.format_exception(failure))), err=True)
    with contextlib.suppress(OSError):
        click.echo(f"error: {message}", err=True)
    return code


def _without_line_ends(error: click.ClickException) -> str:
    """Return what click says; it lists the choices of a missing argument a line each."""
    said = error.format_message()
    return " ".join(said.split()) if isinstance(error, click.MissingParameter) else said


_LIMITS = {
    errno.EMFILE: "raise the limit of this shell: ulimit -n 4096",
    errno.ENFILE: "end other programs, or raise the limit of the system: fs.file-max",
    errno.EFBIG: "raise the limit of this shell: ulimit -f unlimited",
}
"""What helps when a limit of the system is reached."""


def _system_problem(error: OSError) -> str:
    """Say what the system refused.

    Errors of files are handled where they occur: the rest is the terminal or a pipe.
    """
    why = error.strerror or str(error)
    if error.errno in _LIMITS:
        return f"{why}; {left_words()}; {_LIMITS[error.errno]}"
    if error.filename is not None:
        return f"{os.fsdecode(error.filename)}: {why}; check the file and its permissions"
    return f"the result cannot be printed ({why})"


def _leave_on_signals() -> None:
    """Make SIGTERM (``kill``, ``timeout``) end a run like Ctrl-C, so that temporary files are removed."""
    if threading.current_thread() is not threading.main_thread():
        return
    signal.signal(
        signal.SIGTERM, lambda number, frame: _hear(number, SystemExit(AFTER_SIGNAL + number))
    )
    # the parent process may have set Ctrl-C to be ignored, as nohup does
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda number, frame: _hear(number, KeyboardInterrupt()))
    sys.unraisablehook = _deliver_again


_heard: dict[int, float] = {}


def _hear(number: int, error: BaseException) -> None:
    """Raise for a signal, once for two of a kind at a time.

    Systemd sends one, and the guard passes its own on.
    """
    now = time.monotonic()
    before = _heard.get(number, -math.inf)
    if now - before > REPEATED_S:
        _heard[number] = now
        raise_or_hold(error)


def _deliver_again(dropped: sys.UnraisableHookArgs) -> None:
    """Raise a signal again if Python dropped its exception because it arrived while an object was deleted."""
    if not isinstance(dropped.exc_value, (KeyboardInterrupt, SystemExit)):
        sys.__unraisablehook__(dropped)
        return
    number = signal.SIGINT if isinstance(dropped.exc_value, KeyboardInterrupt) else signal.SIGTERM
    _heard.pop(number, None)
    main = threading.main_thread().ident
    # by a timer: an exception raised in this hook would be dropped as well
    if main is not None and hasattr(signal, "pthread_kill"):
        timer = threading.Timer(AGAIN_S, signal.pthread_kill, (main, number))
    else:
        timer = threading.Timer(AGAIN_S, signal.raise_signal, (number,))
    timer.daemon = True
    timer.start()
