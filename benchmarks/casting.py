"""Rays per second of the simulator, compared with Embree on triangles of the same street.

    python -m pip install embreex          # anywhere; left out if missing
    python -m benchmarks.casting

Embree has only float32 triangles: cones become prisms of 8 sides, boxes 12 and ellipsoids 128
triangles, leaves closed hulls, and nothing moves. Both cast the same rays of the same 64 lines;
times are processor time of one thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from importlib import metadata

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.sensor import cast
from prc_cli.simulation.settings import load_settings, open_simulation
from prc_cli.simulation.trajectory import Shots, aim
from prc_cli.simulation.world import Bodies, Shape

LINES = 64
RUNS = 5
CONE_SIDES = 8


def fastest(job: Callable[[], object]) -> float:
    """Least processor time of several runs after a warm-up [s]."""
    job()
    seconds = []
    for _ in range(RUNS):
        start = time.process_time()
        job()
        seconds.append(time.process_time() - start)
    return min(seconds)


def unit_box() -> F64:
    """Triangles of a box of half edges 1, (12, 3, 3)."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    faces = []
    for axis in range(3):
        for side in (-1, 1):
            face = np.insert(square, axis, side, axis=1)
            faces += [face[[0, 1, 2]], face[[0, 2, 3]]]
    return np.array(faces, np.float64)


def unit_sphere() -> F64:
    """Triangles of a ball of radius 1, (128, 3, 3).

    The faces of an octahedron cut in four, twice.
    """
    corners = [
        np.array([[x, 0, 0], [0, y, 0], [0, 0, z]], np.float64)
        for x in (-1, 1)
        for y in (-1, 1)
        for z in (-1, 1)
    ]
    for _ in range(2):
        finer = []
        for a, b, c in corners:
            ab, bc, ca = ((p + q) / np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a)))
            finer += [
                np.array(face) for face in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
            ]
        corners = finer
    return np.array(corners)


def triangles_of(bodies: Bodies) -> F64:
    """The world at time 0 as triangles, (n, 3, 3) [m]."""
    return np.concatenate(list(_triangles(bodies)))


def _triangles(bodies: Bodies) -> Iterator[F64]:
    yield bodies.numbers[bodies.shape == Shape.TRIANGLE].reshape(-1, 3, 3)
    turn = 2 * np.pi * np.arange(CONE_SIDES) / CONE_SIDES
    for body in bodies.numbers[bodies.shape == Shape.CONE]:
        axis = body[3:6] - body[:3]
        across = np.cross(
            axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.7 * np.linalg.norm(axis) else [0.0, 1.0, 0.0]
        )
        across /= np.linalg.norm(across)
        along = np.cross(axis / np.linalg.norm(axis), across)
        ring = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * along
        low = body[:3] + body[6] * ring
        high = body[3:6] + body[7] * ring
        yield np.stack([low, np.roll(low, -1, 0), np.roll(high, -1, 0)], axis=1)
        yield np.stack([low, np.roll(high, -1, 0), high], axis=1)
    for shape, unit in ((Shape.BOX, unit_box()), (Shape.ELLIPSOID, unit_sphere())):
        for body in bodies.numbers[bodies.shape == shape]:
            x, y, z = np.moveaxis(unit * body[3:6], -1, 0)
            cos = np.cos(body[6])
            sin = np.sin(body[6])
            yield np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1) + body[:3]


def embree(triangles: F64, origin: F64, direction: F64) -> tuple[float, float] | None:
    """Least time to build and to cast [s]; None where embreex is not installed."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        return None
    start = time.process_time()
    scene = EmbreeScene()
    TriangleMesh(scene, triangles.astype(np.float32))
    rays = origin.reshape(-1, 3).astype(np.float32), direction.reshape(-1, 3).astype(np.float32)
    scene.run(rays[0][:10], rays[1][:10])
    built = time.process_time() - start
    # with distances, which the simulator needs
    return built, fastest(lambda: scene.run(*rays, output=True))


def main() -> None:
    """Print the table."""
    print(
        "| scanner, bodies in sight | caster | million rays a second of one core | built in [ms] |"
    )
    print("|---|---|---:|---:|")
    for name in ("photon-80", "profiler-1mhz"):
        settings = load_settings(
            "street", options={"lines": LINES, "seed": 7, "scanner": {"name": name}}
        )
        scan = open_simulation("street", settings).scan
        shots = aim(scan.platform, scan.scanner, 0, LINES)
        x, y, _ = shots.origin[LINES // 2, 0]
        bodies = scan.bodies_near(float(x), float(y), scan.sight_m, 0.0)
        n_rays = shots.origin[..., 0].size

        def ours(bodies: Bodies = bodies, shots: Shots = shots) -> object:
            return cast(bodies, shots.origin, shots.direction, shots.time_s)

        print(
            f"| {name}, {len(bodies):,} | this project | {n_rays / fastest(ours) / 1e6:.2f} | 0 |"
        )
        triangles = triangles_of(bodies)
        hits = embree(triangles, shots.origin, shots.direction)
        if hits is None:
            print(f"| {name} | embreex: not installed | | |")
            continue
        version = metadata.version("embreex")
        row = f"{name}, {len(triangles):,} triangles"
        print(f"| {row} | embreex {version} | {n_rays / hits[1] / 1e6:.2f} | {1e3 * hits[0]:.0f} |")


if __name__ == "__main__":
    main()
