"""Connected components and dilation, compared with other packages on the same binary images.

python -m benchmarks.peers

scikit-image and SciPy come with the development tools. OpenCV (``opencv-python-headless``) and cc3d
(``connected-components-3d``) are optional; missing packages are reported. One thread each.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.scaling import checkerboard, spiral
from benchmarks.stages import street
from prc_cli import kernels
from prc_cli.core.types import Mask
from prc_cli.reference.prc import stages as oracle

ROUNDS = 9
SHAPE = (99, 2154)
Job = Callable[[Mask], object]


def supported_street() -> Mask:
    """Supported shots of a block of a simulated street."""
    ranges = np.pad(street(SHAPE[0], SHAPE[1]).ravel(), SHAPE[1] + 1, constant_values=np.nan)
    mask = kernels.support_mask(ranges, *SHAPE, 1.0, 1.0, 3, 2)
    return mask & ~kernels.background_mask(ranges, mask, 0, 0.3, 0.05)


def optional(name: str) -> Any:
    """Return a package, None where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        print(f"{name} is not installed: left out", flush=True)
        return None


def labellers() -> dict[str, Job]:
    """Ways to number 4-connected components."""
    measure = import_module("skimage.measure")
    ndimage = import_module("scipy.ndimage")
    jobs: dict[str, Job] = {
        "prc (numba)": kernels.label_components,
        "scikit-image": lambda image: measure.label(image, connectivity=1),
        "SciPy": lambda image: ndimage.label(image),
    }
    if (cc3d := optional("cc3d")) is not None:
        jobs["cc3d"] = lambda image: cc3d.connected_components(image, connectivity=4)
    if (cv2 := optional("cv2")) is not None:
        cv2.setNumThreads(1)
        jobs["OpenCV"] = lambda image: cv2.connectedComponents(image.view(np.uint8), connectivity=4)
    return jobs


def dilations() -> dict[str, Job]:
    """Ways to dilate twice with the 4-neighbour cross."""
    ndimage = import_module("scipy.ndimage")
    jobs: dict[str, Job] = {
        "prc (numba)": lambda image: kernels.dilate(image, 2),
        "SciPy": lambda image: ndimage.binary_dilation(image, iterations=2),
        "scikit-image": lambda image: morphology(morphology(image)),
    }
    morphology = import_module("skimage.morphology").dilation
    if (cv2 := optional("cv2")) is not None:
        cross = oracle.CROSS.astype(np.uint8)
        jobs["OpenCV"] = lambda image: cv2.dilate(image.view(np.uint8), cross, iterations=2)
    return jobs


def main() -> None:
    """Print tables of labelling and dilation, core nanoseconds per pixel."""
    rng = np.random.default_rng(0)
    images = {
        "street": supported_street(),
        "noise, half": rng.random(SHAPE) < 0.5,
        "checkerboard": checkerboard(*SHAPE),
        "spiral": spiral(*SHAPE, width=1, gap=1),
    }
    for title, jobs in (
        ("4-connected components", labellers()),
        ("two dilations with the cross", dilations()),
    ):
        print(
            f"\n| {title} [ns a pixel] | "
            + " | ".join(images)
            + " |\n|---" * 1
            + "|---" * len(images)
            + "|"
        )
        for name, job in jobs.items():
            times = []
            for image in images.values():
                seconds = []
                for _ in range(ROUNDS):
                    start = time.process_time()
                    job(image)
                    seconds.append(time.process_time() - start)
                times.append(f"{min(seconds) / image.size * 1e9:.2f}")
            print(f"| {name} | " + " | ".join(times) + " |")


if __name__ == "__main__":
    main()
