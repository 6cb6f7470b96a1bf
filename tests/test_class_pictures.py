from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from prc_cli.class_pictures import MAX_LINES, class_pictures
from prc_cli.core.errors import InputError
from prc_cli.evaluation.charts import class_colour
from prc_cli.evaluation.mapping import ClassMapping

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


def test_long_lines_and_long_drives_are_cut(tmp_path: Path) -> None:
    codes = np.full(700 * 1000, 2)
    pictures = draw(tmp_path, codes, codes, 1000)
    assert pictures[0][0].startswith(f"Predicted, lines 0-{MAX_LINES - 1} of")
    assert all(max(picture.shape) <= 1200 for _, picture in pictures)


@pytest.mark.parametrize("m", [8, 10**9])
def test_without_a_whole_line_there_is_no_picture(tmp_path: Path, m: int) -> None:
    assert draw(tmp_path, [2] * 7, [2] * 7, m) == []


def test_unknown_codes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="codes that the class mapping does not list: 9"):
        draw(tmp_path, [2, 9], [2, 2], 2)


def test_lines_that_a_file_numbers_need_no_m(tmp_path: Path) -> None:
    def write(lengths: tuple[int, ...]) -> Path:
        rows = [f"{line + 5},2" for line, n in enumerate(lengths) for _ in range(n)]
        (tmp_path / "lines.csv").write_text("\n".join(["scan_line,class", *rows]) + "\n")
        np.save(tmp_path / "labels.npy", np.full(sum(lengths), 2, np.uint8))
        return tmp_path / "lines.csv"

    found = class_pictures(tmp_path / "labels.npy", write((4, 4, 4)), MAPPING)
    assert found[0][0] == "Predicted, lines 0-2 of labels.npy"
    for lengths in ((4, 3, 4), (8,)):
        assert class_pictures(tmp_path / "labels.npy", write(lengths), MAPPING) == ()
    assert class_pictures(tmp_path / "labels.npy", tmp_path / "labels.npy", MAPPING) == ()
