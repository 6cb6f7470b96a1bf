"""Time and memory of reading bags and captures, beside the decoders that others use.

    python -m benchmarks.bags            # 20 s of a VLP-16 and of a laser scanner of 541 beams
    python -m benchmarks.bags --large    # and ten times as long, for the memory

Times are the least of three runs in this process; memory is the most that a process of its own
takes. Files are in the system's cache. prc reads every file twice: once for what is in it, once for
the shots."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import velodyne_decoder
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from prc_cli.formats import open_images
from prc_cli.formats.options import InputConfig
from tests.formats.bags import recordings
from tests.formats.packets import captures

BEAMS = 541
PACKETS_HZ = 754
SCANS_HZ = 50


def write_inputs(folder: Path, seconds: int) -> list[Path]:
    """Write a capture of a VLP-16 and the laser scans of a drive in three containers."""
    packets = captures.vlp16(PACKETS_HZ)
    step_us = round(PACKETS_HZ * 24 * 55.296)
    capture = folder / f"vlp16_{seconds}.pcap"
    parts = []
    for second in range(seconds):
        stamped = [
            packet[:1200]
            + (5_000_000 + second * step_us + round(i * 24 * 55.296)).to_bytes(4, "little")
            + packet[1204:]
            for i, packet in enumerate(packets)
        ]
        frames = [(start_ns + second, frame) for start_ns, frame in captures.framed(stamped)]
        data = captures.write_pcap(capture, frames).read_bytes()
        parts.append(data if not second else data[24:])
    capture.write_bytes(b"".join(parts))
    rng = np.random.default_rng(1)
    rows = (4 + np.sin(np.linspace(0, 3, BEAMS)) + rng.normal(0, 0.01, (SCANS_HZ, BEAMS))).astype(
        np.float32
    )
    sent: dict[int, list[recordings.Sent]] = {1: [], 2: []}
    for version, every in sent.items():
        for i in range(seconds * SCANS_HZ):
            start_ns = recordings.START_NS + i * recordings.PERIOD_NS
            message = recordings.laser(recordings.STORES[version], start_ns, rows[i % SCANS_HZ])
            every.append(recordings.Sent("/scan", "sensor_msgs/msg/LaserScan", start_ns, message))
    return [
        capture,
        recordings.write_bag(folder / f"scan_{seconds}.bag", sent[1]),
        recordings.write_bag(folder / f"scan_lz4_{seconds}.bag", sent[1], "lz4"),
        recordings.write_db3(folder / f"scan_{seconds}.db3", sent[2]),
        recordings.write_mcap(folder / f"scan_zstd_{seconds}.mcap", sent[2], "zstd", 1 << 20),
    ]


def read(path: Path) -> int:
    """Read with prc; return the shots."""
    return sum(block.range_m.size for block in open_images(path, InputConfig()).blocks())


def read_elsewhere(path: Path) -> int:
    """Read with the usual decoder of the format; return the shots or points."""
    if path.suffix == ".pcap":
        return sum(len(points) for _, points in velodyne_decoder.read_pcap(str(path)))
    if path.suffix == ".mcap":
        with path.open("rb") as handle:
            return sum(
                _ranges(2, message.data) for _, _, message in make_reader(handle).iter_messages()
            )
    if path.suffix == ".db3":
        return 0
    with AnyReader([path]) as reader:
        return sum(
            len(reader.deserialize(raw, connection.msgtype).ranges)
            for connection, _, raw in reader.messages()
        )


def _ranges(version: int, data: bytes) -> int:
    return len(recordings.STORES[version].deserialize_cdr(data, "sensor_msgs/msg/LaserScan").ranges)


def least_s(job: Callable[[], object]) -> float:
    """Return the least time of three runs [s]."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return min(times)


def peak_mib(path: Path) -> float:
    """Return the most memory of a process that reads a file [MiB]."""
    code = (
        f"import benchmarks.bags as b; from pathlib import Path; b.read(Path({str(path)!r})); "
        "print(b.own_mib())"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return float(process.stdout)


def own_mib() -> float:
    """Return the most memory of this process so far [MiB]."""
    # getrusage would count the process that started this one
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return (
        next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
        / 1024
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--large", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(
            "| file | MB | million shots a second, prc | the usual decoder | peak memory | "
            "ten times as long |"
        )
        print("|---|---|---|---|---|---|")
        small = write_inputs(Path(folder), arguments.seconds)
        large = write_inputs(Path(folder), 10 * arguments.seconds) if arguments.large else small
        for path, ten in zip(small, large, strict=True):
            shots = read(path)
            own_s = least_s(lambda path=path: read(path))
            n_ranges = read_elsewhere(path)
            other_s = least_s(lambda path=path: read_elsewhere(path)) if n_ranges else float("nan")
            beside = f"{n_ranges / other_s / 1e6:.2f}" if n_ranges else "-"
            more = f"{peak_mib(ten):.0f} MiB" if arguments.large else "-"
            size = path.stat().st_size / 1e6
            rate = shots / own_s / 1e6
            print(
                f"| {path.name} | {size:.1f} | {rate:.2f} | {beside} | "
                f"{peak_mib(path):.0f} MiB | {more} |"
            )


if __name__ == "__main__":
    main()
