"""Real scans of the contest without a reference.

What ``prc classify IN OUT`` says of them, and pictures.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.contest_data import DATA, ROOT
from benchmarks.pages import say
from benchmarks.user import in_process
from prc_cli.core.classes import ClassCodes

IMAGES = ROOT / "docs" / "images"


@dataclass(frozen=True, slots=True)
class Drive:
    """A real file that is typed as it is."""

    name: str
    path: str
    """Below the folder of real scans."""


DRIVES = (
    Drive("RIEGL profiler on a car in Paris, 66 lines", "riegl/sample_riegl_18_01.ply"),
    Drive("the same kind of car, standing, every pulse", "echopulse/pulse-uint8-n_echo.bin"),
    Drive("Ouster OS1-64, off-road", "ouster/rellis_frame000104.ply"),
    Drive("Ouster OS-1-128, packets", "pcap/OS-1-128_v2.3.0_1024x10_lb_n3.pcap"),
    Drive("Velodyne HDL-32, packets", "pcap/velodyne_hdl32.pcap"),
    Drive("Hesai XT16, ROS 2 bag", "ros/nebula_xt16/1732848127890747768_0.db3"),
    Drive("park from a tripod", "forest/tls_park.npz"),
)


def print_drives() -> None:
    """Print a row for every file that is there, and draw it."""
    print("## Real scans without a reference\n")
    say("""<code>prc classify IN labels.npy</code>, nothing told. Records without a range and
    returns that are listed twice stay unclassified and are left out of the shares. The pictures are
    of <code>prc render IN OUT.png --labels labels.npy</code>.""")
    names = ClassCodes().names()
    rows = []
    pictures = []
    for number, drive in enumerate(drive for drive in DRIVES if (DATA / drive.path).exists()):
        path = DATA / drive.path
        picture = IMAGES / f"drive_{number + 1:02}.png"
        with tempfile.TemporaryDirectory() as name:
            output = Path(name) / "labels.npy"
            code, said = in_process(["classify", str(path), str(output), "-q"])
            doubts = [line for line in said.splitlines() if line.strip()]
            if not output.exists():
                rows.append(f"| {drive.name} | `{drive.path}` | {code} | | {'; '.join(doubts)} |")
                continue
            record = json.loads(output.with_name("labels.npy.prc.json").read_text(encoding="utf-8"))
            in_process(
                [
                    "render",
                    str(path),
                    str(picture),
                    "--labels",
                    str(output),
                    "--steps",
                    "range,classes",
                    "--width",
                    "1100",
                    "--overwrite",
                    "-q",
                ]
            )
        chosen = next(said["value"] for said in record["assumptions"] if said["key"] == "method")
        counts = {entry["code"]: entry["count"] for entry in record["classes"] if entry["code"] > 1}
        total = sum(counts.values())
        shares = ", ".join(
            f"{names.get(key, key)} {n / total:.1%}"
            for key, n in counts.items()
            if n >= total / 1000
        )
        rows.append(f"| {drive.name} | `{drive.path}` | {code} | {chosen} | {shares} |")
        pictures += [
            f"![{drive.name}](../images/{picture.name})\n",
            f"{drive.name}. {' '.join(doubts)}\n",
        ]
    print("| | file | exit code | method | |\n|---|---|---:|---|---|")
    print("\n".join(rows), end="\n\n")
    print("\n".join(pictures))
