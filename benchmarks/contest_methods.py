"""Methods of the contest on the stream.

Presets of this program, and the fused method without single steps.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import contest_files
from benchmarks.contest_data import Scan
from benchmarks.pages import ROOT
from benchmarks.user import classify
from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.classes import ClassCodes
from prc_cli.core.config import flatten, merge
from prc_cli.core.threads import default_threads
from prc_cli.core.types import U8
from prc_cli.jobs.classify import label_blocks, load_classifier

SICK = ROOT / "sample_configs" / "sick_push_broom.toml"
STREETS = frozenset({"street", "oakland", "kitti", "views_kitti", "views_nuscenes"})
FORESTS = frozenset({"forest", "cylinders"})
FUSED = "fused"


@dataclass(frozen=True, slots=True)
class Method:
    """A configuration, and the scans that it is for."""

    name: str
    preset: str | None = None
    options: dict[str, Any] = field(default_factory=dict)
    path: Path | None = None
    mappings: frozenset[str] = STREETS
    suits: Callable[[Scan], bool] = lambda _: True

    def config(self, scan: Scan) -> LoadedConfig:
        """Return the configuration for a scan; only the ranging noise of the scanner may differ."""
        options = self._options(scan)
        if self.path is not None:
            return load_config(self.path, options=options)
        return load_config(preset=self.preset, options=options)

    def _options(self, scan: Scan) -> dict[str, Any]:
        if self.preset != "street-scan":
            return self.options
        return merge(
            self.options, {"sequential_angle": {"angles": {"range_noise_m": scan.range_noise_m}}}
        )

    def takes(self, scan: Scan) -> bool:
        """Whether the method is for such a scan."""
        return scan.mapping in self.mappings and self.suits(scan)

    def arguments(self, scan: Scan) -> list[str]:
        """Return the options of ``prc classify`` for a scan."""
        chosen = [] if self.preset is None else ["--preset", self.preset]
        if self.path is not None:
            chosen = ["--config", str(self.path)]
        options = self._options(scan)
        return chosen + [
            part for key, value in flatten(options) for part in ("--set", f"{key}={value}")
        ]

    def command(self) -> str:
        """Return the same as a text, without what differs between scans."""
        chosen = [] if self.preset is None else ["--preset", self.preset]
        if self.path is not None:
            chosen = ["--config", str(self.path.relative_to(ROOT))]
        return " ".join(
            [*chosen, *(f"--set {key}={value}" for key, value in flatten(self.options))]
        )


def _zeta(zeta_s: float, zeta_p: float) -> dict[str, Any]:
    return {"prc": {"support": {"zeta_s": zeta_s, "zeta_p": zeta_p}}}


def _is_push_broom(scan: Scan) -> bool:
    return scan.range_m.shape[1] < 400 and not scan.is_upright


PAPERS = (
    Method("PRC, published", "prc-2019-urban"),
    Method("PRC, published, ζ_p 0.1 m", "prc-2019-urban", {"prc": {"support": {"zeta_p": 0.1}}}),
    Method("PRC, for push-brooms", path=SICK, suits=_is_push_broom),
    Method("sequential-angle", "street-scan"),
    Method("PRC forest, ζ 0.01 m, 0.01 m", "prc-2019-forest", _zeta(0.01, 0.01), mappings=FORESTS),
    Method("PRC forest, ζ 1 m, 0.1 m", "prc-2019-forest", _zeta(1.0, 0.1), mappings=FORESTS),
)
"""The methods of both papers, with published parameters except for the two push-broom presets."""

TO_THE_TOP = (
    Method(
        "fused-forest, stems up to 4.6 m",
        "fused-forest",
        {"fused": {"forest": {"stem_top_m": 4.6}}},
        mappings=frozenset({"cylinders"}),
    ),
)
"""The same with the height of stems.

The cylinders of the reference end 4.3 m above the ground, which is 4.6 m in a
plane tilted by 20°. Higher parts of a stem are noise in that reference by definition."""


METHODS = (
    *PAPERS,
    Method(FUSED, FUSED),
    Method(f"{FUSED}-forest", f"{FUSED}-forest", mappings=FORESTS),
    *TO_THE_TOP,
)


@dataclass(frozen=True, slots=True)
class Labelled:
    """Labels of a method of the stream."""

    codes: U8
    """(lines, M) uint8, default class codes."""
    extra_codes: U8
    """(e,) uint8, of the further returns."""
    cpu_s: float
    """Seconds of all cores together."""
    wall_s: float
    said: tuple[str, ...] = ()
    """What was said of the file: doubts and refusals, one line each."""


def label(scan: Scan, config: LoadedConfig, threads: int | None = None) -> Labelled:
    """Run a classifier over a whole scan that is in memory, with beam directions."""
    load_classifier(config)
    lookup = ClassCodes().lookup()
    threads = default_threads() if threads is None else threads
    start = time.perf_counter()
    busy = time.process_time()
    items = list(label_blocks(scan.blocks(), config.config.classifier, threads=threads))
    wall_s = time.perf_counter() - start
    cpu_s = time.process_time() - busy
    labels: NDArray[np.uint8] = np.concatenate([item.labels for item in items])
    extra = np.concatenate([item.extra_labels for item in items])
    assert labels.shape == scan.range_m.shape
    assert len(extra) == len(scan.extra)
    return Labelled(lookup[labels], lookup[extra], cpu_s, wall_s)


def label_scan(scan: Scan, method: Method) -> Labelled:
    """Run a method over a scan as a user does.

    The scan as a file, straight down not told, ``prc classify -q``.

    Where that is refused, straight down is told, as the refusal says. What is refused still has no
    labels."""
    config = method.config(scan)
    if config.config.is_decided:
        load_classifier(config)
    with tempfile.TemporaryDirectory() as name:
        file = contest_files.write(scan, Path(name))
        said: list[str] = []
        for nadir in ((), file.nadir) if file.nadir else ((),):
            start = time.perf_counter()
            busy = time.process_time()
            options = (*file.options, *method.arguments(scan), *nadir)
            done = classify(file.path, Path(name) / "labels.npy", options)
            wall_s = time.perf_counter() - start
            cpu_s = time.process_time() - busy
            said += [
                f"{done.exit_code}: {line.replace(f'{name}/', '')}"
                for line in done.stderr.splitlines()
                if line.strip()
            ]
            codes = done.labels
            if codes is not None:
                break
        else:
            if file.record is None:
                last = scan.n_shots - 1
            else:
                last = int(max(file.record.max(), file.extra_record.max(initial=-1)))
            codes = np.zeros(last + 1, np.uint8)
        image, extra = file.image(scan, codes)
    return Labelled(image, extra, cpu_s, wall_s, tuple(said))
