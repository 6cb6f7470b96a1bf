"""Options that went with 2.0, and what to type instead."""

from __future__ import annotations

_SEARCH = "leave it out: the parameters follow from the measured scanner"
_PAGE = "prc render IN PAGE.html, which turns the points"

GONE = {
    "--adopt": "--overwrite, or another folder",
    "--bare": "leave it out: comments change nothing",
    "--draft": "prc info FILE, which prints the options to type",
    "--first": "--only LENGTH, e.g. --only 30s or --only 500lines",
    "--format": "--json, or -o FILE with the suffix .csv, .md or .html",
    "--ignore-return": "--match time+no-return",
    "--keep-version": "another OUT: in an old one, outputs of an older version are made again",
    "--labels-dimension": "--set render.dimension=NAME",
    "--line-hz": "--set layout.line_frequency=HZ",
    "--max-range": "--set input.max_range=METRES",
    "--metadata": "--set input.metadata=FILE.json",
    "--mount-heading": "--set scanner.heading_deg=DEGREES",
    "--mount-slant": "--set scanner.slant_deg=DEGREES",
    "--noise": "--set scanner.noise_m=METRES",
    "--only-lines": "--only A:B, e.g. --only 200:300",
    "--only-time": "--only A:B with units, e.g. --only +10s:+40s",
    "--predicted-dimension": "--dimension NAME",
    "--picture": "leave it out: the page has pictures, and prc render draws others",
    "--predicted-points": "--points PATH",
    "--return": "--set input.return=strongest, first or last",
    "--reference-points": "--points reference=PATH",
    "--segment-ids": "--set output.segment_ids=true",
    "--sight": "--set sight_m=METRES",
    "--speed": "--set trajectory.speed_m_s=SPEED",
    "--third-mapping": "--mapping third=NAME",
    "--topic": "--set input.topic=NAME",
}
"""What to type instead, or why to leave it out, by option."""

GONE_OF = {
    "prc batch --drift": "--set batch.drift=true",
    "prc batch --engine": "--scheduler ADDRESS",
    "prc batch --fail-fast": "--set batch.fail_fast=true",
    "prc batch --keep-going": "leave it out: prc goes on after a failure",
    "prc batch --mapping": "--set batch.mapping=NAME",
    "prc batch --match": "--set batch.match=HOW",
    "prc batch --memory-limit": "--set batch.memory_limit=MB",
    "prc batch --no-drift": "--set batch.drift=false",
    "prc batch --only-failed": "prc batch retry OUT",
    "prc batch --retry": "--set batch.retry=N",
    "prc batch --stall": "--set batch.stall=SECONDS",
    "prc batch --threads": "--set batch.threads=N",
    "prc batch --time-stamps": "--set batch.time_stamps=true",
    "prc batch clean --forget": "prc batch clean OUT ARCHIVE",
    "prc batch retry --retry": "prc batch ARCHIVE OUT --set batch.retry=N",
    "prc calibrate --budget": _SEARCH,
    "prc calibrate --format": "--json, or -o FILE.md",
    "prc calibrate --keep": _SEARCH,
    "prc calibrate --mapping": _SEARCH,
    "prc calibrate --max-shots": _SEARCH,
    "prc calibrate --objective": _SEARCH,
    "prc calibrate --plot": "-o FILE.svg",
    "prc calibrate --reference": _SEARCH,
    "prc calibrate --reference-dimension": _SEARCH,
    "prc calibrate --seed": _SEARCH,
    "prc calibrate --training-share": _SEARCH,
    "prc doctor --out": "prc doctor FOLDER",
    "prc evaluate --by-confidence": "--by confidence:50,80,90",
    "prc evaluate --by-lines": "--by lines:N",
    "prc evaluate --by-range": "--by range:5,10,20",
    "prc evaluate --by-scanner": "--by scanner",
    "prc evaluate --min-confidence": "--by confidence:PERCENT",
    "prc evaluate --pair": "prc evaluate PREDICTED/ REFERENCE/, two folders with the same names",
    "prc evaluate --reference-dimension": "--dimension reference=NAME",
    "prc render --line-spacing": "nothing: the distance of the lines is assumed",
    "prc render --shots": "--only A:B, which shows a part in full",
    "prc evaluate --interval-lines": "leave it out: a block has 99 lines",
    "prc render --block": "--only A:B, the lines to draw",
    "prc render --columns": "--set input.columns=HOW",
    "prc render --dimension": "--set render.dimension=NAME",
    "prc render --lines": "--set input.lines=HOW",
    "prc render --method": "--preset NAME, or --set method=NAME",
    "prc render --scanner": "--set input.scanner=HOW",
    "prc render --sort-by-time": "--set input.order=sort-time",
    "prc render --station": "--set render.station=N",
    "prc render --trust-order": "--set input.order=trust",
    "prc render --colour": "prc render IN PAGE.html, which has other colours",
    "prc render --figure1": "--steps figure1",
    "prc render --from": _PAGE,
    "prc render --height": _PAGE,
    "prc render --hide": "prc render IN PAGE.html, which hides classes",
    "prc render --html": "prc render IN PAGE.html",
    "prc render --pages": _PAGE,
    "prc render --reference-dimension": "prc evaluate -o PAGE.html, which draws differences",
    "prc render --view": "--steps top",
    "prc render --width": "leave it out: a picture has up to 2200 pixels in a line",
    "prc stream --report": "leave it out: prc reports every ten seconds",
    "prc thin --drop": "--keep CLASS=0",
    "prc transfer --same": "--match time+NAME",
}
"""The same for one command; wins over :data:`GONE`."""


def instead_of(command: str, option: str) -> str | None:
    """Return the hint for an option that a command no longer has, or None if it never was one.

    >>> instead_of("prc convert", "--return")
    'type --set input.return=strongest, first or last'
    """
    command = command.removesuffix(" run")
    text = GONE_OF.get(f"{command} {option}", GONE.get(option))
    return text if text is None or text.startswith("leave it out") else f"type {text}"
