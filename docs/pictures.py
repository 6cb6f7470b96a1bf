"""Make the pictures of the manual, from the files of ``prc demo`` and a few commands of prc.

``python -m docs.pictures FOLDER`` runs the commands in FOLDER, opens the pages in chromium, and
writes ``docs/images``. ``python -m docs.pictures FOLDER NAME...`` makes only the named pictures.
It needs chromium with its driver. Files that are in FOLDER already are used again. Pages are drawn
twice, for light and for dark pages of the manual (``NAME_dark``).
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import laspy
import numpy as np
from PIL import Image

from prc_cli.core.classes import LABEL_COLOURS
from tests.browser import Browser, chromium

IMAGES = Path(__file__).resolve().parent / "images"
COLOURS = 96
"""Colours of a picture beside those of the classes."""
WIDEST = 1200
HELD_MS = 1600
"""How long the raw ranges and the classes are shown in the moving picture."""
TURNS = 10
"""Turns of the cloud by 5 degrees at its end."""
PICKED = (194, 0, 122)
"""Colour of the ring around a shot."""
Box = tuple[float, float, float, float]


def prc(words: str, output: str) -> Path:
    """Run a command, unless its output exists."""
    path = Path(output)
    if not path.exists():
        done = subprocess.run(["prc", *shlex.split(words)], check=False)
        if done.returncode not in (0, 4):
            raise SystemExit(f"prc {words}: exit code {done.returncode}")
    return path


def save(picture: Image.Image, name: str, widest: int = WIDEST) -> None:
    """Write a picture with a palette, no wider than a page."""
    picture = picture.convert("RGB")
    if picture.width > widest:
        size = (widest, round(picture.height * widest / picture.width))
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    own = picture.quantize(COLOURS, dither=Image.Dither.NONE).getpalette() or []
    palette = class_palette(own[: 3 * COLOURS])
    small = picture.quantize(palette=palette, dither=Image.Dither.NONE)
    small.save(IMAGES / f"{name}.png", optimize=True)


def opened(
    browser: Browser, page: Path, width: int = 1200, height: int = 760, *, dark: bool = False
) -> None:
    """Open a page of prc and wait until it is drawn."""
    browser.open(page, width=width, height=height, dark=dark)
    browser.wait("document.readyState === 'complete'")
    browser.wait("!document.getElementById('colours') || document.body.dataset.ready")
    for _ in range(3):
        browser.settle()


def seen(browser: Browser, box: Box | None = None) -> Image.Image:
    """Return what the window shows, or a part of it."""
    browser.picture(Path("seen.png"))
    with Image.open("seen.png") as picture:
        return picture.convert("RGB").crop(box) if box else picture.convert("RGB")


def save_seen(browser: Browser, name: str, box: Box | None = None) -> None:
    """Write what the window shows, or a part of it, in light and in dark colours."""
    for scheme, end in (("light", ""), ("dark", "_dark")):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        browser.devtools("Emulation.setEmulatedMedia", features=[feature])
        time.sleep(1)  # the page draws all points again
        browser.settle()
        save(seen(browser, box), f"{name}{end}")


def box_of(browser: Browser, selector: str) -> Box:
    """Return the place of an element in the window."""
    x, y, width, height = browser.run(
        f"const r = document.querySelector({selector!r}).getBoundingClientRect();"
        "return [r.x, r.y, r.width, r.height]"
    )
    return (x, y, x + width, y + height)


def coloured(browser: Browser, by: str) -> Image.Image:
    """Return both views of the page of prc render in colours of the class, the range, ..."""
    browser.run(
        f"const box = document.getElementById('colours'); box.value = {by!r};"
        "box.dispatchEvent(new Event('change'))"
    )
    browser.settle()
    return seen(browser, box_of(browser, ".views"))


def demo() -> Path:
    """Return the folder of the demo."""
    prc("demo", "prc-demo/street.html")
    return Path("prc-demo")


def class_palette(more: Sequence[int] = ()) -> Image.Image:
    """Return a palette of greys, of every class colour in light and shadow, and of more."""
    shades = [(grey, grey, grey) for grey in range(24, 256, 11)] + [(234, 238, 241), PICKED]
    for colour in LABEL_COLOURS.values():
        red, green, blue = colour
        shades += [
            (round(red * light), round(green * light), round(blue * light))
            for light in (1, 0.85, 0.7)
        ]
    palette = Image.new("P", (1, 1))
    palette.putpalette([*(part for shade in shades for part in shade), *more])
    return palette


def moving(browser: Browser) -> None:
    """Draw the ranges of the demo in grey, then the classes from left to right, and turn."""
    for name, dark in (("demo", False), ("demo_dark", True)):
        opened(browser, demo() / "street.html", 1200, 800, dark=dark)
        save_moving(browser, name)


def save_moving(browser: Browser, name: str) -> None:
    browser.run("for (const b of document.querySelectorAll('button[data-do]')) b.hidden = true")
    raw = coloured(browser, "range").convert("L").convert("RGB")
    views = [coloured(browser, "class")]
    for _ in range(TURNS):
        browser.run(
            "const cloud = document.getElementById('cloud');"
            "cloud.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}))"
        )
        time.sleep(1)  # the page draws all points when the turn is over
        views.append(seen(browser, box_of(browser, ".views")))
    size = (640, round(raw.height * 640 / raw.width))
    frames = [view.resize(size, Image.Resampling.LANCZOS) for view in (raw, *views)]
    palette = class_palette()
    before, *after = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    steps = [before]
    for edge in np.linspace(0, size[0], 25, dtype=int)[1:]:
        frame = before.copy()
        frame.paste(after[0].crop((0, 0, edge, size[1])), (0, 0))
        steps.append(frame)
    durations = [HELD_MS, *[90] * (len(steps) - 2), HELD_MS, *[200] * (TURNS - 1), 2 * HELD_MS]
    steps += after[1:]
    steps[0].save(
        IMAGES / f"{name}.gif",
        save_all=True,
        append_images=steps[1:],
        duration=durations,
        loop=0,
        optimize=True,
    )


def readme(browser: Browser) -> None:
    opened(browser, demo() / "street.html", 1200, 760)
    save_seen(browser, "readme")


def explain(browser: Browser) -> None:
    """Show a car of the demo, and the values of a clicked shot."""
    source = "prc-demo/street.npz"
    prc(f"classify {source} reasons.laz --reason --confidence", "reasons.laz")
    page = prc("render reasons.laz reasons.html", "reasons.html")
    cloud = laspy.read("reasons.laz")
    line, column = np.asarray(cloud.scan_line), np.asarray(cloud.column)
    car = np.flatnonzero(np.asarray(cloud.classification) == 65)
    place = car[len(car) // 2]
    opened(browser, page)
    browser.run(f"location.hash = '#{line[place]},{column[place]}'")
    browser.settle()
    browser.settle()
    save_seen(browser, "explain")


def check(browser: Browser) -> None:
    page = prc("check prc-demo/street.laz street_check.html --shots 100", "street_check.html")
    opened(browser, page, 1280, 760)
    save_seen(browser, "check_page")


def report(browser: Browser) -> None:
    opened(browser, demo() / "street_report.html", 1360, 1000)
    save_seen(browser, "report")


def car_cloud() -> Path:
    """Write the true classes of the demo as a cleaned cloud of other software, in a folder."""
    folder = Path("car")
    folder.mkdir(exist_ok=True)
    cloud = laspy.read(demo() / "street.laz")
    truth = np.load(demo() / "more" / "street_reference.npy")
    truth = truth[truth > 0] if np.count_nonzero(truth) == len(cloud.points) else None
    assert truth is not None, "a record per shot with a return"
    cloud.classification = truth
    cloud.points = cloud.points[(truth != 7) & (np.arange(len(truth)) % 3 > 0)]
    rng = np.random.default_rng(1)
    cloud.xyz = cloud.xyz + rng.normal(0, 0.01, (len(cloud.points), 3))
    cloud.write(folder / "street.laz")
    return folder


def differences(browser: Browser) -> None:
    prc("demo", "prc-demo/street.html")
    car_cloud()
    words = "evaluate prc-demo/street.laz car/ --match nearest --mapping street"
    page = prc(f"{words} --places places.geojson -o differences.html", "differences.html")
    opened(browser, page, 1200, 1000)
    browser.run(
        "const all = [...document.querySelectorAll('h2, h3')];"
        "const places = all.find((one) => /place/i.test(one.textContent));"
        "if (places) places.scrollIntoView()"
    )
    browser.settle()
    save_seen(browser, "differences")


def batch(browser: Browser) -> None:
    """Classify the archive of the page Archives, and show its report."""
    for name, seed in (("monday/drive_1", 1), ("monday/drive_2", 2), ("tuesday/drive_3", 3)):
        Path(f"archive/{name}").parent.mkdir(parents=True, exist_ok=True)
        prc(
            f"simulate street archive/{name}.laz --lines 300 --seed {seed} -q",
            f"archive/{name}.laz",
        )
    prc("batch archive classified --reference archive", "classified/report.html")
    opened(browser, Path("classified/report.html"), 1200, 900)
    save_seen(browser, "batch")


def top(_: Browser) -> None:
    """Draw registered points from above, classified from nothing but x, y, z and the times."""
    prc("simulate street registered.laz --length 120 --seed 5 -q", "registered.laz")
    cloud = laspy.read("registered.laz")
    cloud.remove_extra_dims([*cloud.point_format.extra_dimension_names])
    cloud.classification[:] = 0
    cloud.scan_angle[:] = 0
    cloud.write("tile.laz")
    prc("classify tile.laz tile_classified.laz --range points", "tile_classified.laz")
    picture = prc("render tile_classified.laz top.png --steps top", "top.png")
    with Image.open(picture) as image:
        save(image, "top")


def thin(browser: Browser) -> None:
    words = "thin prc-demo/street.laz thin.laz --keep-only ground,building,pole"
    prc(f"{words} --spacing ground=0.3", "thin.laz")
    page = prc("render thin.laz thin.html", "thin.html")
    opened(browser, page)
    save_seen(browser, "thin", box_of(browser, "#cloud"))


def spinning(browser: Browser) -> None:
    words = "simulate street spin.npz --scanner hdl-64e --duration 0.1 --seed 4"
    prc(f"{words} -q", "spin.npz")
    prc("classify spin.npz spin.laz --accept-doubt few-lines", "spin.laz")
    page = prc("render spin.laz spin.html", "spin.html")
    opened(browser, page)
    save_seen(browser, "spinning")


def wrong(_: Browser) -> None:
    """Draw the demo with the right and with a wrong number of shots per line."""
    with np.load(demo() / "street.npz") as scan:
        ranges = scan["range_m"].astype("<f4")
    m = ranges.shape[1]
    ranges.tofile("dump.bin")
    parts = []
    for name, n in (("right", m), ("wrong", m - 4)):
        words = f"render dump.bin {name}.png -M {n} --steps range --only 0:300"
        picture = prc(f"{words} --set input.partial_line=pad --trust-order", f"{name}.png")
        with Image.open(picture) as image:
            parts.append(image.convert("RGB"))
    both = Image.new("RGB", (max(p.width for p in parts), sum(p.height for p in parts)), "white")
    both.paste(parts[0], (0, 0))
    both.paste(parts[1], (0, parts[0].height))
    save(both, "wrong_lines")


FOREST = "--set sight_m=22 " + " ".join(
    f"--set scanner.{share}_share=0" for share in ("background", "sky", "bright_sky", "cluster")
)
"""A forest without the noise that would hide its stems."""


def forest(browser: Browser) -> None:
    prc(f"simulate forest wood.laz --length 20 --seed 1 {FOREST} -q", "wood.laz")
    prc("classify wood.laz stems.laz --preset fused-forest", "stems.laz")
    opened(browser, prc("render stems.laz stems.html", "stems.html"))
    save_seen(browser, "sim_forest_view")


def true_street(browser: Browser) -> None:
    words = "--scanner profiler-1mhz --length 70 --seed 7 --set sight_m=70"
    prc(f"simulate street cloud.laz {words} --set trajectory.stop_every_m=0 -q", "cloud.laz")
    opened(browser, prc("render cloud.laz cloud.html --labels cloud.laz", "cloud.html"))
    save_seen(browser, "sim_street_view")


def drawn(name: str, widest: int, source: str, words: str, _: Browser) -> None:
    """Draw a scan, which is simulated by a command or is a real one."""
    words = words.format(data=os.environ.get("PRC_DATA", ""))
    if source:
        prc(f"{source} -q", source.split()[2])
    with Image.open(prc(f"render {words} {name}.png", f"{name}.png")) as image:
        save(image, name, widest)


PICTURES: dict[str, Callable[[Browser], None]] = {
    "demo": moving,
    "readme": readme,
    "explain": explain,
    "check_page": check,
    "report": report,
    "differences": differences,
    "batch": batch,
    "top": top,
    "thin": thin,
    "spinning": spinning,
    "wrong_lines": wrong,
    "sim_forest_view": forest,
    "sim_street_view": true_street,
}
STATION = "simulate street-scan station.npz --seed 3 --set scanner.azimuth_step_deg=0.23"
PRC_DRIVE = "simulate street drive.npz --length 10 --seed 7"
DRAWN = {
    "sim_street_range": (
        1100,
        "simulate street sim.laz --length 60 --seed 7 --set trajectory.stop_every_m=0",
        "sim.laz --labels sim.laz --steps range,classes --only 0:300",
    ),
    "sim_static": (700, STATION, "station.npz --steps range,classes"),
    "static_scan": (
        700,
        "simulate street-scan scan.npz --seed 6",
        "scan.npz --preset street-scan --steps range,classes",
    ),
    "street": (
        WIDEST,
        PRC_DRIVE,
        "drive.npz --preset prc-2019-urban --only 0:99 --steps "
        "range,support,background,components,surfaces,classes",
    ),
    "fused_forest_park": (
        800,
        "",
        "{data}/forest/tls_park.npz --preset fused-forest --steps range,classes",
    ),
}
"""Name: width [pixels], the command that simulates the scan, the words that draw it."""
PICTURES |= {name: partial(drawn, name, *words) for name, words in DRAWN.items()}


def main() -> None:
    folder, *names = sys.argv[1:] or ["."]
    Path(folder).mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    with chromium() as browser:
        for name in names or PICTURES:
            PICTURES[name](browser)


if __name__ == "__main__":
    main()
