"""A small analytic street with known shapes, as a range image and as files of every readable
format."""

import gzip
from pathlib import Path

import numpy as np

from prc_cli.core.types import F32, F64

POINTS_PER_LINE = 180
N_LINES = 137
LINE_HZ = 48.0


def angles() -> F64:
    """Scan angle of every column [rad], from straight down, full circle."""
    return 2 * np.pi * np.arange(POINTS_PER_LINE) / POINTS_PER_LINE


def street(n_lines: int = N_LINES, seed: int = 1) -> F32:
    """Ground 2 m below, facades at 8 and 11 m, bushes, open sky, stray shots.

    (n_lines, M) float32 [m].
    """
    rng = np.random.default_rng(seed)
    angle = angles()
    with np.errstate(divide="ignore"):
        ground = np.where(np.cos(angle) > 0.05, 2.0 / np.cos(angle), np.inf)
        right = np.where(np.sin(angle) > 0.05, 8.0 / np.sin(angle), np.inf)
        left = np.where(np.sin(angle) < -0.05, -11.0 / np.sin(angle), np.inf)
    walls = np.minimum(right, left)
    walls = np.where(
        -walls * np.cos(angle) > 12.0, np.inf, walls
    )  # facades end 12 m above the scanner
    image = np.tile(np.minimum(ground, walls), (n_lines, 1))
    image += rng.normal(0.0, 0.003, image.shape)
    bush = (slice(20, 60), slice(24, 40))
    image[bush] = np.minimum(image[bush], rng.uniform(3.0, 6.0, image[bush].shape))
    image[~np.isfinite(image) | (image > 90.0)] = np.nan
    stray = rng.random(image.shape) < 0.02
    image[stray] = rng.uniform(0.5, 90.0, int(stray.sum()))
    image[rng.random(image.shape) < 0.03] = np.nan
    image[70] = np.nan  # a whole line without returns
    return image.astype(np.float32)


def write_raw(path: Path, image: F32) -> Path:
    """Write float32 ranges, missing = NaN."""
    image.astype("<f4").tofile(path)
    return path


def write_csv(path: Path, image: F32) -> Path:
    """Write one row a shot, gz if the name says so; missing = empty cell."""
    rows = ["scan_line,column,angle_deg,range"]
    degrees = np.rad2deg(angles())
    for line, ranges in enumerate(image):
        for column, value in enumerate(ranges):
            cell = "" if np.isnan(value) else repr(float(value))
            rows.append(f"{line},{column},{float(degrees[column])!r},{cell}")
    data = ("\n".join(rows) + "\n").encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
    return path


def write_npz(path: Path, image: F32) -> Path:
    """Write the range image with its angles."""
    np.savez_compressed(path, range_m=image, angle_deg=np.rad2deg(angles()))
    return path


def write_endless(path: Path) -> Path:
    """A raw file, or an array, of nothing but missing shots, a hole on the disk that takes minutes
    to classify.

    A larger hole is refused as a copy that never ended.
    """
    n_lines = 530_000
    n_shots = 800
    with path.open("wb") as handle:
        if path.suffix == ".npy":
            about = {"descr": "<f4", "fortran_order": False, "shape": (n_lines, n_shots)}
            np.lib.format.write_array_header_1_0(handle, about)
        handle.truncate(handle.tell() + 4 * n_lines * n_shots)
    return path
