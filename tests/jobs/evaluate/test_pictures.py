from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from prc_cli.evaluation.html import class_colour
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.jobs.evaluate.counts import _worst
from prc_cli.jobs.evaluate.pictures import class_pictures

MAPPING = ClassMapping(ignore=(0,), predicted={"ground": (2,), "noise": (7,)}, reference={"car": (65,), "ground": (2,)})
GREY, WHITE = (222, 222, 222), (255, 255, 255)


def colour(name: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(class_colour(name)[1:]))


def draw(tmp_path: Path, predicted: object, reference: object, m: int) -> list[tuple[str, np.ndarray]]:
    paths = tmp_path / "predicted.npy", tmp_path / "reference.npy"
    for path, codes in zip(paths, (predicted, reference), strict=True):
        np.save(path, np.asarray(codes, np.uint8))
    found = class_pictures(*paths, MAPPING, m)
    return [(title, np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))) for title, content in found]


def test_cells_have_the_colours_of_their_classes(tmp_path: Path) -> None:
    # three lines of two shots; records of an unfinished line are left out
    (one, first), (_, second), (_, differ) = draw(tmp_path, [2, 7, 2, 2, 0, 2, 2], [2, 2, 65, 0, 2, 2, 2], 2)
    assert one == "Predicted, lines 0-2 of predicted.npy"
    assert first.shape == second.shape == differ.shape
    rows, columns = (np.array([0, -1]), np.array([0, first.shape[1] // 2, -1]))
    cells = [[[tuple(image[r, c].tolist()) for c in columns] for r in rows] for image in (first, second, differ)]
    ground, noise, car = colour("ground"), colour("noise"), colour("car")
    assert cells[0] == [[ground, ground, WHITE], [noise, ground, ground]]
    assert cells[1] == [[ground, car, ground], [ground, WHITE, ground]]
    assert cells[2] == [[GREY, ground, WHITE], [noise, WHITE, GREY]]
    assert _worst(np.array([[0, 0, 0], [3, 2, 1], [1, 0, 2]])).tolist() == [0, 1, 3]


@pytest.mark.parametrize("rising", [True, False])
@pytest.mark.parametrize("folder", [True, False])
def test_the_sky_is_at_the_top_whichever_way_the_columns_run(tmp_path: Path, *, rising: bool, folder: bool) -> None:
    m, n = 60, 40
    beam = np.deg2rad(np.linspace(20, 120, m))
    beam = beam if rising else beam[::-1]
    # a scanner 2 m over the ground, and a wall 15 m away
    range_m = np.minimum(np.where(np.cos(beam) > 0.01, 2.0 / np.maximum(np.cos(beam), 0.01), 99.0), 15.0 / np.sin(beam))
    x, z = range_m * np.sin(beam), -range_m * np.cos(beam)
    rows = [
        f"{range_m[k]:.4f},{x[k]:.4f},{0.01 * line:.4f},{z[k]:.4f},{line},{k}" for line in range(n) for k in range(m)
    ]
    points = tmp_path / "points"
    points.mkdir()
    (points / "labels.csv").write_text("\n".join(["range,x,y,z,scan_line,column", *rows]) + "\n")
    codes = np.tile(np.where(z < -1.99, 2, 7), n).astype(np.uint8)
    np.save(tmp_path / "labels.npy", codes)
    pair = tmp_path / "labels.npy", tmp_path / "labels.npy"
    mapping = ClassMapping(predicted={"ground": (2,), "noise": (7,)}, reference={"ground": (2,), "noise": (7,)})
    where = points if folder else points / "labels.csv"
    found = class_pictures(*pair, mapping, m, points=(where, None))
    image = np.asarray(Image.open(io.BytesIO(found[0][1])).convert("RGB"))
    assert tuple(image[0, 0].tolist()) == colour("noise")
    assert tuple(image[-1, 0].tolist()) == colour("ground")


@pytest.mark.data
def test_a_street_stands_as_in_its_rendering(real_data: Path) -> None:
    street = real_data / "oakland" / "oakland_1.csv.gz"
    found = class_pictures(
        street,
        street,
        ClassMapping(unlisted="other", predicted={"ground": ("1200-1206",)}, reference={"ground": ("1200-1206",)}),
        229,
    )
    image = np.asarray(Image.open(io.BytesIO(found[0][1])).convert("RGB"))
    ground = (image == np.array(colour("ground"))).all(axis=2).sum(axis=1)
    tenth = len(ground) // 10
    assert ground[-tenth:].max() > 1000
    assert ground[:tenth].max() < 50
