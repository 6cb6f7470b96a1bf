"""``prc simulate``: simulated scans, with the reference class of every shot."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import Word, add_options, output_options, table_from
from prc_cli.cli.output import console, print_json, print_line, print_text, results, table_of
from prc_cli.cli.paths import READ, READ_TEXT, WRITTEN
from prc_cli.cli.report import compiling_note, line_progress, lines_of_shots, print_notices
from prc_cli.config import params_to_toml
from prc_cli.core.classes import Label
from prc_cli.jobs.simulate import Beside, SimulationSummary, check_simulation
from prc_cli.jobs.simulate import simulate as simulate_file
from prc_cli.simulation.drive import load_simulator
from prc_cli.simulation.scanners import SCANNERS
from prc_cli.simulation.settings import KINDS, SCENES, Kind, load_settings, preset_notes

_option = click.option


_OUTPUT = [
    click.argument("output", type=WRITTEN, metavar="OUT"),
    _option(
        "--labels",
        type=WRITTEN,
        metavar="FILE.npy",
        help="Write the true class of every record. Default: if OUT cannot contain classes.",
    ),
]
_FOREST = [
    _option("--stems", type=WRITTEN, metavar="FILE.csv", help="Also write a list of the trees."),
    _option(
        "--reference",
        type=Word(["truth", "cylinders"]),
        default="truth",
        show_default=True,
        help="truth: the object that was hit. cylinders: stems by cylinders, ground by height, "
        "else noise.",
    ),
]
_PLACE = [
    _option(
        "--seed",
        type=click.IntRange(0, 2**63 - 1),
        help="Every seed gives another world.  [default: 1]",
    ),
    _option(
        "--lines", type=click.IntRange(min=1), help="Number of scan lines, instead of --length."
    ),
]
_LENGTH = [
    _option(
        "--length",
        type=click.FloatRange(min=0, min_open=True),
        metavar="METRES",
        help="Length of the path. Default: 300 in streets, 100 in forests.",
    ),
    _option(
        "--duration",
        type=click.FloatRange(min=0, min_open=True),
        metavar="SECONDS",
        help="Duration, instead of --length.",
    ),
    _option(
        "--trajectory",
        type=WRITTEN,
        metavar="FILE",
        help="Also write the path of the scanner: .csv or .sbet.",
    ),
    _option(
        "--frames",
        type=WRITTEN,
        metavar="FOLDER",
        help="For spinning scanners: also write each turn as a KITTI frame, with classes, "
        "poses and times.",
    ),
]
_PARAMETERS = [
    _option(
        "--config",
        "config_file",
        type=READ,
        metavar="FILE.toml",
        help="Parameters, in the tables [scene], [scanner] and [trajectory] or [station].",
    ),
    _option(
        "--set",
        "assignments",
        type=READ_TEXT,
        multiple=True,
        metavar="KEY=VALUE",
        help="Set a parameter, e.g. scene.trees=0.9, scanner.noise_m=0.01 or "
        "trajectory.speed_m_s=14. Can be repeated.",
    ),
    _option(
        "--threads",
        type=click.IntRange(min=1),
        help="Number of threads. The output does not depend on it.",
    ),
    _option("--overwrite", is_flag=True, help="Replace existing outputs."),
]


_SCENE_HELP: dict[Kind, str] = {
    "street": "Kind of street; mixed changes every 120 m.",
    "forest": "Kind of forest; mixed is a managed stand of pine, spruce and birch.",
    "street-scan": "Kind of street; mixed changes every 120 m.",
}


def _presets(kind: Kind) -> list[Any]:
    static = kind == "street-scan"
    scanners = [name for name, scanner in SCANNERS.items() if scanner.is_static == static]
    return [
        _option(
            "--scanner",
            type=Word(scanners),
            help="Model of the scanner: prc simulate scanners lists them.",
        ),
        _option("--scene", type=Word(list(SCENES[kind])), help=_SCENE_HELP[kind]),
    ]


@click.group()
def simulate() -> None:
    """Simulate a scan of a street or a forest, with the true class of every shot.

    OUT is any format that prc convert writes: .las, .laz, .csv (.csv.gz, .csv.zst), .parquet, .npz,
    .npy, .bin, or a bag (.bag, .mcap, .db3). The same parameters and the same seed give the
    same bytes. OUT.prc.json contains the parameters and the version.

    \b
    Examples:
      prc simulate street drive.laz --length 900 --seed 7
      prc simulate forest walk.npz --length 120 --stems stems.csv
      prc simulate street-scan station.npz
      prc simulate scanners
      prc simulate parameters forest
    """


@simulate.command()
@add_options(*_OUTPUT, *_LENGTH, *_PLACE, *_presets("street"), *_PARAMETERS)
@output_options
def street(**options: Any) -> None:
    """Simulate a drive along a street.

    Point clouds and tables contain ranges, and registered coordinates from the true path.

    \b
    Examples:
      prc simulate street drive.laz --length 900 --seed 7 --trajectory drive.csv
      prc simulate street drive.npz --scanner profiler-1mhz \\
        --set trajectory.speed_m_s=14 --set trajectory.stop_every_m=0
      prc simulate street drive.laz --config terraces.toml
      prc simulate street spin.npz --scanner vlp-16 --duration 5 --frames frames/
      prc simulate street spin.bag --scanner vlp-32c --duration 5 --set flake_m=150
    """
    _run("street", options)


@simulate.command()
@add_options(*_OUTPUT, *_FOREST, *_LENGTH, *_PLACE, *_presets("forest"), *_PARAMETERS)
@output_options
def forest(**options: Any) -> None:
    """Simulate a walk through a forest.

    --reference cylinders gives the classes by the rule of Lehtola et al. (2019, III).

    \b
    Examples:
      prc simulate forest walk.laz --length 120 --stems stems.csv
      prc simulate forest walk.npz --reference cylinders --scene dense-spruce
    """
    _run("forest", options)


@simulate.command("street-scan")
@add_options(*_OUTPUT, *_PLACE, *_presets("street-scan"), *_PARAMETERS)
@output_options
def street_scan(**options: Any) -> None:
    """Simulate a static scan of a street, from a tripod.

    \b
    Examples:
      prc simulate street-scan station.npz
      prc simulate street-scan station.npz --set station.turn_deg=90 --set station.along_m=200
    """
    _run("street-scan", options)


@simulate.command()
@click.option("--json", "as_json", is_flag=True, help="Print all parameters as JSON.")
def scanners(as_json: bool) -> None:
    """List the scanners that can be simulated.

    \b
    Example: prc simulate scanners --json
    """
    if as_json:
        print_json({name: scanner.model_dump() for name, scanner in SCANNERS.items()})
        return
    table = table_of(
        "scanners", "name", "lines/s", "shots a line", "field", "range", "noise", "returns"
    )
    table.columns[0].no_wrap = True  # the names are typed
    table.add_column("kind", overflow="fold")
    for name, scanner in SCANNERS.items():
        kind = "static" if scanner.is_static else f"profiler, slant {scanner.slant_deg:g}°"
        kind = "spinning" if scanner.spins else kind
        table.add_row(
            name,
            f"{scanner.line_hz:.4g}",
            f"{scanner.points_per_line:,}",
            f"{scanner.field_deg:g}°",
            f"{scanner.max_range_m:g} m",
            f"{1000 * scanner.noise_m:g} mm",
            str(scanner.max_returns),
            f"{kind}, {'phase' if scanner.principle == 'cw' else 'pulse'}",
        )
    results().print(table)


@simulate.command()
@click.argument("kind", type=Word(KINDS))
@click.option("--config", "config_file", type=READ, metavar="FILE.toml", help="Parameters.")
@click.option(
    "--set",
    "assignments",
    type=READ_TEXT,
    multiple=True,
    metavar="KEY=VALUE",
    help="Set a parameter, e.g. scanner.name=NAME. Can be repeated.",
)
def parameters(
    kind: Kind,
    config_file: Path | None,
    assignments: tuple[str, ...],
) -> None:
    """Print all parameters of a simulation as TOML, ready for --config.

    \b
    Example: prc simulate parameters street --set scanner.name=profiler-1mhz > fast.toml
    """
    options = table_from(assignments, {}, {})
    settings = load_settings(kind, config_file, options)
    notes = preset_notes(kind, settings, config_file, options)
    print_text(params_to_toml(settings, notes))


_KEYS = {
    "seed": "seed",
    "lines": "lines",
    "length": "length_m",
    "duration": "duration_s",
    "scanner": "scanner.name",
    "scene": "scene.name",
}
"""Keys of the options."""


def _run(kind: Kind, options: dict[str, Any]) -> None:
    extents = [name for name in ("length", "duration", "lines") if options.get(name) is not None]
    if len(extents) > 1:
        message = f"--{extents[0]} and --{extents[1]} contradict each other"
        raise click.UsageError(message)
    settings = load_settings(
        kind, options["config_file"], table_from(options["assignments"], options, _KEYS)
    )
    output = options["output"]
    quiet = options["quiet"]
    beside = Beside(
        options.get("trajectory"), options["labels"], options.get("stems"), options.get("frames")
    )
    check_simulation(kind, output, settings.scanner, beside, overwrite=options["overwrite"])
    with compiling_note(quiet=quiet, what="simulator"):
        load_simulator()
    start = time.perf_counter()
    with line_progress(output.name, quiet=quiet) as progress:
        summary = simulate_file(
            kind,
            output,
            settings,
            beside=beside,
            reference=options.get("reference", "truth"),
            threads=options["threads"],
            overwrite=options["overwrite"],
            progress=progress,
        )
    if options["as_json"]:
        print_json(summary.as_dict(), sort_keys=True)
    if not quiet:
        _print_summary(summary, time.perf_counter() - start, verbose=options["verbose"])


def _print_summary(summary: SimulationSummary, seconds: float, *, verbose: bool) -> None:
    counts = summary.counts
    record = summary.record
    total = int(counts.labels.sum())
    if verbose:
        label_counts = ((label.name.lower(), int(counts.labels[label])) for label in Label)
        rows = ((name, f"{n:,}", f"{n / total:.1%}") for name, n in label_counts if n)
        console().print(table_of("reference", "class", "shots", "share", rows=rows))
    print_notices(record.notices)
    for path in summary.files:
        print_line(f"{path} ({path.stat().st_size:,} bytes)")
    rate = counts.n_shots / seconds / 1e6 if seconds else 0.0
    what = lines_of_shots(counts.n_lines, record.points_per_line)
    print_line(f"{what} in {seconds:.1f} s ({rate:.2g} million a second)")
