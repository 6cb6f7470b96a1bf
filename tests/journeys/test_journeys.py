"""The journeys: the way from one command to the next, as a user walks it, each with a figure that
must hold.

Read this first: it is what ``prc`` is for. Only drives that nothing was tuned to, only commands.
"""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

import prc_cli
from prc_cli.methods.reasons import rule_of
from tests.journeys.conftest import STREET, M
from tests.journeys.shell import CLASSES, COMMAND, Shell
from tests.patience import wait_until

pytestmark = pytest.mark.slow

ALIKE = 0.01
"""F1 that two ways to the same labels may lie apart."""


def test_1_an_unknown_laz_is_classified_by_what_info_says(prc):
    installed = Shell(prc.here, installed=True)
    prc(f"prc simulate street drive.laz -q {STREET}")
    said = installed(installed("prc info drive.laz").command("type"))
    installed(said.command("draw it"))
    assert (prc.here / "drive_classified.png").read_bytes()[:4] == b"\x89PNG"
    f1 = prc.f1("drive_classified.laz", "drive.laz")
    assert installed(said.command("compare it").replace("REFERENCE", "drive.laz")).out
    prc("prc classify drive.npz best.npy -q --preset fused")
    best = prc.f1("best.npy", "drive.npz")
    for name in CLASSES:
        assert f1[name] > best[name] - ALIKE
    assert min(f1[name] for name in CLASSES) > 0.85


@pytest.mark.parametrize("wrong", [3 * M, 100 * M, M // 2, M // 3, M + 1])
def test_2_a_wrong_number_is_refused_and_the_hint_gives_the_labels(prc, wrong):
    said = prc(f"prc classify drive.bin labels.npy -M {wrong}", code=1)
    assert not (prc.here / "labels.npy").exists()
    hint = re.search(r"give (-M \d+)", said.err)
    assert hint, said.err
    prc(f"prc classify drive.bin labels.npy -q {hint[1]}")
    f1 = prc.f1("labels.npy", "drive.npz")
    assert min(f1[name] for name in CLASSES) > 0.85


def test_2_a_wrong_unit_too(prc):
    with np.load(prc.here / "drive.npz") as drive:
        np.savez(prc.here / "mm.npz", range_m=1000 * drive["range_m"], angle_deg=drive["angle_deg"])
        np.savez(
            prc.here / "radians.npz",
            range_m=drive["range_m"],
            angle_deg=np.deg2rad(drive["angle_deg"]),
        )
    said = prc("prc classify mm.npz labels.npy", code=1)
    assert "--set input.range_scale=0.001" in said.err
    prc("prc classify mm.npz labels.npy -q --set input.range_scale=0.001")
    f1 = prc.f1("labels.npy", "drive.npz")
    assert min(f1[name] for name in CLASSES) > 0.85
    assert "radians" in prc("prc classify radians.npz more.npy", code=1).err


def test_3_calibrate_never_makes_the_labels_worse(prc):
    prc("prc calibrate drive.npz -o calibrated.toml -q")
    prc("prc classify drive.npz plain.npy -q")
    prc("prc classify drive.npz calibrated.npy -q --config calibrated.toml")
    plain, calibrated = (prc.f1(f"{stem}.npy", "drive.npz") for stem in ("plain", "calibrated"))
    for name in CLASSES:
        assert calibrated[name] >= plain[name]


@pytest.mark.parametrize("suffix", ["laz", "ply", "pcd"])
def test_4_another_program_finds_a_cloud_with_class_names(prc, suffix):
    prc(f"prc classify drive.npz cloud.{suffix} -q")
    xyz, codes = points_of(prc.here / f"cloud.{suffix}")
    ranges = np.fromfile(prc.here / "drive.bin", "<f4")
    assert len(xyz) == np.count_nonzero(~np.isnan(ranges))
    assert not np.isnan(xyz).any()
    assert min(np.ptp(xyz, axis=0)) > 5
    assert {2, 5, 6, 7, 65, 66, 69} <= set(codes.tolist())
    if suffix == "laz":
        (names,) = [
            vlr.lookups for vlr in laspy.read(prc.here / "cloud.laz").vlrs if vlr.record_id == 0
        ]
        assert {65: "car", 66: "curb", 69: "pole"}.items() <= names.items()


@pytest.mark.parametrize("suffix", ["laz", "ply"])
def test_4_registered_coordinates_are_kept(prc, suffix):
    prc(f"prc classify registered.laz cloud.{suffix} -q --range trajectory:path.csv")
    xyz, _ = points_of(prc.here / f"cloud.{suffix}")
    assert np.allclose(xyz, points_of(prc.here / "registered.laz")[0], rtol=0, atol=0.0006)


def test_5_a_night_ends_with_the_state_of_the_archive(prc):
    (prc.here / "archive").mkdir()
    for name in "abcd":
        shutil.copy(prc.here / "drive.npz", prc.here / "archive" / f"{name}.npz")
    night = [str(COMMAND), "batch", "archive", "out", "-q", "--jobs", "1"]
    killed = subprocess.Popen(
        night, cwd=prc.here, start_new_session=True, stderr=subprocess.DEVNULL
    )
    wait_until((prc.here / "out/a.npz.labels.npy").exists)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    whole = (prc.here / "archive/a.npz").read_bytes()
    (prc.here / "archive/cut.npz").write_bytes(whole[: len(whole) // 2])
    prc("prc thin drive.npz archive/thinned.npz --keep noise=0 -q --keep-empty")
    said = prc("prc batch archive out", code=1)
    assert "thinned" in said.out + said.err
    assert "cut.npz" in said.out + said.err
    prc("prc batch archive out", code=1)
    (prc.here / "archive/cut.npz").unlink()
    prc("prc batch archive out", code=4)
    before = {path.name: path.stat().st_mtime_ns for path in (prc.here / "out").glob("*.npy")}
    prc("prc batch archive out --accept-doubt thinned")
    after = {path.name: path.stat().st_mtime_ns for path in (prc.here / "out").glob("*.npy")}
    assert [name for name in after if after[name] != before[name]] == ["thinned.npz.labels.npy"]
    prc("prc batch archive out --accept-doubt thinned")
    prc("prc batch --verify out")
    prc("prc classify drive.npz alone.npy -q")
    assert all(
        np.array_equal(prc.labels(f"out/{name}.npz.labels.npy"), prc.labels("alone.npy"))
        for name in "abcd"
    )


def test_6_the_tables_of_the_paper_against_car(prc):
    car = laspy.read(prc.here / "registered.laz")
    car.points = car.points[np.argsort(car.x)]
    car.write(prc.here / "car.laz")
    prc("prc classify drive.npz raw.laz -q --preset prc-2019-urban")
    prc("prc transfer raw.laz car.laz labelled.laz -q")
    said = prc("prc evaluate labelled.laz car.laz --mapping lehtola_urban --json -q")
    table = json.loads(said.out)
    assert table["n_scored"] == np.count_nonzero(
        ~np.isnan(np.fromfile(prc.here / "drive.bin", "<f4"))
    )
    assert table["classes"]["ground"]["recall"] > 0.5


@pytest.mark.data
def test_7_a_bag_of_two_scanners_to_frames_of_points(prc, real_data):
    shutil.copy(real_data / "cartographer/b0_short.bag", prc.here)
    prc(
        "prc thin b0_short.bag frames.ply -q --set input.topic=vertical_laser_2d "
        "--preset prc-2019-urban --keep noise=0"
    )
    xyz, _ = points_of(prc.here / "frames.ply")
    assert len(xyz) > 100_000
    assert not np.isnan(xyz).any()


@pytest.mark.parametrize("preset", ["", "--preset prc-2019-urban", "--preset prc-2019-forest"])
def test_8_a_live_stream_has_the_labels_of_the_file(prc, preset):
    prc(f"prc classify drive.bin labels.npy -q -M {M} {preset}")
    with (prc.here / "drive.bin").open("rb") as drive, (prc.here / "live.bin").open("wb") as live:
        words = [str(COMMAND), *shlex.split(f"stream -q -M {M} {preset}")]
        subprocess.run(words, stdin=drive, stdout=live, check=True, timeout=120)
    live_labels = np.fromfile(prc.here / "live.bin", np.uint8)
    assert np.mean(live_labels == prc.labels("labels.npy")) > 0.999


@pytest.mark.parametrize(
    "preset, drive, lines",
    [
        ("prc-2019-urban", "drive", 40),
        ("prc-2019-forest", "forest", 40),
        ("street-scan", "scan", 6),
    ],
)
def test_9_the_papers_in_plain_numpy_have_the_same_labels(
    prc,
    preset,
    drive,
    lines,
):
    with np.load(prc.here / f"{drive}.npz") as whole:
        kept = {
            name: array[:lines] if array.ndim > 1 or name == "time_s" else array
            for name, array in whole.items()
        }
    np.savez(prc.here / "short.npz", **kept)
    accepted = "--accept-doubt ground-below --accept-doubt few-lines"
    for engine in ("reference", "compiled"):
        prc(
            f"prc classify short.npz {engine}.npy -q --preset {preset} --engine {engine} {accepted}"
        )
    assert np.array_equal(prc.labels("reference.npy"), prc.labels("compiled.npy"))


def test_10_what_explain_says_is_what_the_loop_did(prc):
    prc("prc classify drive.npz labels.parquet -q --set output.reason=true")
    table = pq.read_table(prc.here / "labels.parquet")
    labels = table["class"].to_numpy()
    reasons = table["reason"].to_numpy()
    rng = np.random.default_rng(8803)
    for code in (2, 5, 6, 7, 65):
        shot = int(rng.choice(np.flatnonzero(labels == code)))
        explanation = json.loads(
            prc(f"prc explain drive.npz --at {shot // M},{shot % M} --json").out
        )
        assert (explanation["code"], explanation["reason"]) == (code, reasons[shot])
        assert explanation["sentence"] == rule_of(int(reasons[shot]))[1].sentence


@pytest.mark.parametrize(
    "drive, preset, name, least",
    [
        ("drive", "prc-2019-urban", "ground", 0.6),
        ("drive", "fused", "ground", 0.98),
        ("scan", "street-scan", "horizontal", 0.95),
        ("scan", "street-scan-published", "horizontal", 0.6),
        ("forest", "prc-2019-forest", "ground", 0.6),
        ("forest", "fused-forest", "ground", 0.9),
    ],
)
def test_11_every_preset_labels_what_it_is_for(
    prc,
    drive,
    preset,
    name,
    least,
):
    # as published little of the road is ground on this scan: the check ground-below says so
    prc(
        f"prc classify {drive}.npz labels.npy -q --preset {preset}",
        code=4 if "published" in preset else 0,
    )
    assert prc.f1("labels.npy", f"{drive}.npz")[name] > least


def test_12_python_and_the_command_line_are_one(prc):
    prc("prc classify drive.npz typed.npy -q")
    prc_cli.classify(prc.here / "drive.npz", prc.here / "called.npy")
    assert (prc.here / "typed.npy").read_bytes() == (prc.here / "called.npy").read_bytes()
    typed = json.loads(prc("prc evaluate typed.npy drive.npz --json -q").out)
    called = prc_cli.evaluate(prc.here / "called.npy", prc.here / "drive.npz")
    assert typed["overall"]["accuracy"] == called.n_right / called.n_scored


def test_13_a_registered_tile_is_the_stream_that_it_was(prc):
    """Tiles of times and coordinates alone, sorted in space.

    Each by what info says, and all of them as one drive.
    """
    prc(f"prc simulate street drive.laz -q {STREET} --lines 300")
    truth = laspy.read(prc.here / "drive.laz")
    (prc.here / "tiles").mkdir()
    rows = tiles_of(truth, prc.here / "tiles")
    prc("prc classify drive.laz raw.laz -q")
    command = prc("prc info tiles/t_0.laz").command("type")
    assert command == "prc classify tiles/t_0.laz tiles/t_0_classified.laz --range points"
    prc(command)
    raw, reference = (
        np.asarray(laspy.read(prc.here / name).classification) for name in ("raw.laz", "drive.laz")
    )
    tile = np.asarray(laspy.read(prc.here / "tiles/t_0_classified.laz").classification)
    assert f1_of(tile, reference[rows[0]]) > f1_of(raw[rows[0]], reference[rows[0]]) - 0.05
    (prc.here / "tiles/t_0_classified.laz").unlink()
    prc("prc batch tiles out --drive 't_*.laz' --range points -q")
    whole = np.zeros(len(raw), np.uint8)
    for number, tile_rows in enumerate(rows):
        whole[tile_rows] = laspy.read(prc.here / f"out/t_{number}.laz").classification
    assert f1_of(whole, reference) > f1_of(raw, reference) - ALIKE
    assert np.mean(whole == raw) > 0.98


def test_14_how_good_it_is_by_hand_by_reference_and_beside_a_car(prc):
    """The commands of docs/how_good.md, on a drive with known classes."""
    page = (Path(__file__).parents[2] / "docs" / "how_good.md").read_text(encoding="utf-8")
    checked, answered, scored, classified, compared, differing = re.findall(
        r"^\$ (prc .*)$", page, re.MULTILINE
    )
    more = prc.here / "prc-demo" / "more"
    more.mkdir(parents=True)
    shutil.copy(prc.here / "drive.npz", prc.here / "prc-demo" / "street.npz")
    with np.load(prc.here / "drive.npz") as drive:
        np.save(more / "street_reference.npy", drive["class"].ravel())
    prc("prc classify prc-demo/street.npz prc-demo/more/street_labels.npy -q")
    prc(f"prc simulate street drive.laz -q {STREET}")
    prc("prc classify drive.laz prc-demo/street.laz -q")

    prc(checked)
    about = re.search(
        r'id="about">(.*?)</script>', (prc.here / "check.html").read_text("utf-8"), re.DOTALL
    )
    assert about
    answers = json.loads(about[1])["answers"]
    truth = np.asarray(laspy.read(prc.here / "drive.laz").classification)
    names = {7: "noise", 2: "ground", 6: "building", 5: "vegetation", 65: "car", 66: "curb"}
    names[69] = "pole"
    for place in answers["places"]:
        place["answer"] = names.get(int(truth[place["record"]]), "other")
    (prc.here / "street_answers.json").write_text(json.dumps(answers))
    by_hand = json.loads(prc(f"{answered} --json").out)["scores"]["accuracy"]
    whole = json.loads(prc(f"{scored} --json").out)["overall"]["accuracy"]
    assert by_hand["low"] < whole < by_hand["high"]

    prc(classified)
    assert "methods against the reference" in prc(compared).out

    (prc.here / "car").mkdir()
    car = laspy.read(prc.here / "drive.laz")
    # a facade that the office called vegetation
    wrong = (car.classification == 6) & (car.x < np.quantile(car.x, 0.5))
    car.classification[wrong] = 5
    car[np.random.default_rng(14).permutation(len(car.points))].write(prc.here / "car/a.laz")
    prc(differing)
    first = json.loads((prc.here / "places.geojson").read_text())["features"][0]
    assert first["properties"]["reference"] == "vegetation"
    assert first["properties"]["predicted"] == "building"
    assert car.header.x_min <= first["geometry"]["coordinates"][0] <= car.header.x_max
    assert prc(first["properties"]["explain"]).out


def tiles_of(drive: laspy.LasData, folder: Path) -> list[NDArray[Any]]:
    """Write the drive in two tiles with coordinates and times alone, sorted in space.

    Return the records of each.
    """
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = [0.001] * 3
    header.offsets = drive.header.offsets
    middle = float(np.median(drive.x))
    rows = []
    for number, inside in enumerate((np.asarray(drive.x) < middle, np.asarray(drive.x) >= middle)):
        inside_rows = np.flatnonzero(inside)
        inside_rows = inside_rows[
            np.lexsort((np.floor(drive.y[inside_rows]), np.floor(drive.x[inside_rows])))
        ]
        tile = laspy.LasData(header)
        tile.x, tile.y, tile.z, tile.gps_time = (
            np.asarray(drive[name])[inside_rows] for name in ("x", "y", "z", "gps_time")
        )
        tile.write(folder / f"t_{number}.laz")
        rows.append(inside_rows)
    return rows


def f1_of(codes: NDArray[Any], truth: NDArray[Any]) -> float:
    """Return the mean F1 of ground, building, vegetation and noise."""
    scores = []
    for code in (2, 6, 5, 7):
        both = np.count_nonzero((codes == code) & (truth == code))
        scores.append(
            2 * both / max(np.count_nonzero(codes == code) + np.count_nonzero(truth == code), 1)
        )
    return float(np.mean(scores))


def points_of(path: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    """Read a cloud as other programs do: laspy, or the header of PLY and PCD and NumPy."""
    if path.suffix == ".laz":
        cloud = laspy.read(path)
        return np.asarray(cloud.xyz), np.asarray(cloud.classification)
    data = path.read_bytes()
    if path.suffix == ".ply":
        head, body = data.split(b"end_header\n", 1)
        kinds = {"float": "<f4", "double": "<f8", "uint": "<u4", "uchar": "u1"}
        fields = [
            (name, kinds[kind]) for kind, name in re.findall(r"property (\w+) (\w+)", head.decode())
        ]
    else:
        head, body = data.split(b"DATA binary\n", 1)
        names, sizes, kinds_ = (
            re.search(rf"^{key} (.*)$", head.decode(), re.MULTILINE)[1].split()
            for key in ("FIELDS", "SIZE", "TYPE")
        )
        fields = [
            (name, f"<{kind.lower()}{size}")
            for name, size, kind in zip(names, sizes, kinds_, strict=True)
        ]
    records = np.frombuffer(body, fields)
    return np.stack([records[axis] for axis in "xyz"], axis=-1), records["class"]
