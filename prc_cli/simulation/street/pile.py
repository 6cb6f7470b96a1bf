"""Places with their own axes, and a pile to which bodies are added."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.world import Bodies, Material, Shape

Point = tuple[float, float, float]
Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Frame:
    """A place with axes u (forward), v (left, or mirrored), w (up); slopes only lift points."""

    x: float
    y: float
    z: float
    yaw: float
    """Direction of u, counter-clockwise from +x [rad]."""
    slope: float = 0.0
    """Rise along u [m/m]."""
    roll: float = 0.0
    """Rise along v [m/m]."""
    mirror: int = 1
    """-1 = v points to the right."""

    def point(self, u: float, v: float, w: float) -> Point:
        """World coordinates of a point [m]."""
        c = math.cos(self.yaw)
        s = math.sin(self.yaw)
        side = self.mirror * v
        return (
            self.x + c * u - s * side,
            self.y + s * u + c * side,
            self.z + w + self.slope * u + self.roll * v,
        )


@dataclass(slots=True)
class Pile:
    """Bodies that are being put together."""

    first_number: float
    """Identity of the first body; the others follow."""
    velocity: Span = (0.0, 0.0)
    """Of the bodies that are added from now on [m/s]."""
    _shape: list[int] = field(default_factory=list)
    _numbers: list[tuple[float, ...]] = field(default_factory=list)
    _material: list[int] = field(default_factory=list)
    _density: list[float] = field(default_factory=list)
    _velocity: list[Span] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._shape)

    def _add(
        self,
        shape: Shape,
        numbers: tuple[float, ...],
        material: Material,
        density: float,
    ) -> None:
        self._shape.append(int(shape))
        self._numbers.append(numbers)
        self._material.append(int(material))
        self._density.append(density)
        self._velocity.append(self.velocity)

    def triangle(
        self,
        a: Point,
        b: Point,
        c: Point,
        material: Material,
    ) -> None:
        """Add a triangle."""
        self._add(Shape.TRIANGLE, (*a, *b, *c), material, 0.0)

    def quad(self, a: Point, b: Point, c: Point, d: Point, material: Material) -> None:
        """Add a surface between four corners, given in their order around it, as two triangles."""
        self.triangle(a, b, c, material)
        self.triangle(a, c, d, material)

    def face(self, frame: Frame, corners: Sequence[Point], material: Material) -> None:
        """Add a surface between four corners that are given along the axes of a frame."""
        a, b, c, d = (frame.point(*corner) for corner in corners)
        self.quad(a, b, c, d, material)

    def cone(self, start: Point, end: Point, radii: Span, material: Material) -> None:
        """Add a pole, trunk or branch with the radii of its two ends."""
        self._add(Shape.CONE, (*start, *end, *radii, 0.0), material, 0.0)

    def ellipsoid(
        self,
        centre: Point,
        half: Point,
        yaw: float,
        material: Material,
        density: float = 0.0,
    ) -> None:
        """Add a rounded body."""
        self._add(Shape.ELLIPSOID, (*centre, *half, yaw, 0.0, 0.0), material, density)

    def box(
        self,
        frame: Frame,
        u: Span,
        v: Span,
        w: Span,
        material: Material,
        density: float = 0.0,
    ) -> None:
        """Add a level box by its spans (from, to) along the axes; slopes lift it as one."""
        centre = frame.point((u[0] + u[1]) / 2, (v[0] + v[1]) / 2, (w[0] + w[1]) / 2)
        half = ((u[1] - u[0]) / 2, (v[1] - v[0]) / 2, (w[1] - w[0]) / 2)
        self._add(Shape.BOX, (*centre, *half, frame.yaw, 0.0, 0.0), material, density)

    def bodies(self) -> Bodies:
        """Return the bodies of the pile."""
        n = len(self._shape)
        return Bodies(
            shape=np.array(self._shape, dtype=np.uint8),
            numbers=np.array(self._numbers, dtype=np.float64).reshape(n, 9),
            material=np.array(self._material, dtype=np.uint8),
            density=np.array(self._density, dtype=np.float64),
            velocity=np.array(self._velocity, dtype=np.float64).reshape(n, 2),
            number=self.first_number + np.arange(n, dtype=np.float64),
        )


def outlines(bodies: Bodies) -> F64:
    """Return the bounds of bodies in plan, (n, 4) float64: least x, y, greatest x, y [m]."""
    is_triangle = bodies.shape == Shape.TRIANGLE
    is_cone = bodies.shape == Shape.CONE
    is_round = ~is_triangle & ~is_cone
    triangles = bodies.numbers[is_triangle]
    cones = bodies.numbers[is_cone]
    rounds = bodies.numbers[is_round]
    cone_reach = cones[:, 6:8].max(axis=1)
    round_reach = np.hypot(rounds[:, 3], rounds[:, 4])
    bounds = np.empty((len(bodies), 4))
    for axis in (0, 1):
        corners = triangles[:, [axis, axis + 3, axis + 6]]
        bounds[is_triangle, axis] = corners.min(axis=1)
        bounds[is_triangle, axis + 2] = corners.max(axis=1)
        ends = cones[:, [axis, axis + 3]]
        bounds[is_cone, axis] = ends.min(axis=1) - cone_reach
        bounds[is_cone, axis + 2] = ends.max(axis=1) + cone_reach
        bounds[is_round, axis] = rounds[:, axis] - round_reach
        bounds[is_round, axis + 2] = rounds[:, axis] + round_reach
    return bounds
