"""Classify and evaluate the real scans, and print the tables of docs/results.md.

    python benchmarks/real_scans.py             # reads ../shared/data or $PRC_DATA

Each table names the commands that give the same figures one by one.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes
from prc_cli.evaluation.reports import as_markdown
from prc_cli.pipeline import classify, evaluate

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("PRC_DATA", ROOT.parent / "shared" / "data"))
SICK = ROOT / "sample_configs" / "sick_push_broom.toml"


def oakland(folder: Path) -> None:
    """Three labelled strips with the published and the adapted parameters."""
    for title, config, option in (
        ("published urban parameters", load_config(preset="urban"), "--preset urban"),
        ("parameters for this sensor", load_config(SICK), "--config sample_configs/sick_push_broom.toml"),
    ):
        print(f"## Oakland, {title}\n")
        for strip in (1, 2, 3):
            name = f"oakland_{strip}"
            source = DATA / "oakland" / f"{name}.csv.gz"
            labels = folder / f"{name}.npy"
            classify(source, labels, config, overwrite=True)
            print(f"### Strip {strip}\n")
            print(f"```console\n$ prc classify {source.name} {name}.npy {option}")
            print(f"$ prc evaluate {name}.npy {source.name} --mapping oakland --format markdown\n```\n")
            print(as_markdown(evaluate(labels, source, "oakland")))


def forest(folder: Path) -> None:
    """The unlabelled park scan: class shares."""
    source = DATA / "forest" / "tls_park.npz"
    codes = ClassCodes().names()
    print("## Park, forest preset\n\n```console\n$ prc classify tls_park.npz tls_park.npy --preset forest\n```\n")
    print("| zeta_s, zeta_p | noise | ground | stem | vegetation |\n|---|---|---|---|---|")
    for zeta_s, zeta_p in ((0.01, 0.01), (1.0, 0.1)):
        options = {"prc": {"support": {"zeta_s": zeta_s, "zeta_p": zeta_p}}}
        classify(source, folder / "park.npy", load_config(preset="forest", options=options), overwrite=True)
        labels = np.load(folder / "park.npy")
        counts = np.bincount(labels[labels > 0], minlength=256)
        names = {name: counts[code] / counts.sum() for code, name in codes.items()}
        shares = " | ".join(f"{names[name]:.1%}" for name in ("noise", "ground", "stem", "vegetation"))
        print(f"| {zeta_s} m, {zeta_p} m | {shares} |")


def main() -> None:
    """Print all tables."""
    with tempfile.TemporaryDirectory() as name:
        oakland(Path(name))
        forest(Path(name))


if __name__ == "__main__":
    main()
