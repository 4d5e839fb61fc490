"""Pixels and corners of tags in tables become bearings, with the camera's intrinsics."""

import math

import cv2
import numpy as np
import pytest
from cli.commands import call, refused

from homeward.drives.cameras.camera import tilt_matrix
from homeward.drives.cameras.lens import Lens
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.opening import sample_drive
from homeward.errors import InputError
from homeward.geometry.angles import wrap

SIZE = {"width": 1280, "height": 960}
NUMBERS = {"fx": 500.0, "fy": 505.0, "cx": 655.0, "cy": 470.0}
LENSES = {
    "pinhole": Lens(**NUMBERS, **SIZE),
    "plumb_bob": Lens(**NUMBERS, **SIZE, distortion=(-0.1, 0.01, 5e-4, -3e-4, 0)),
    "tilted": Lens(**NUMBERS, **SIZE, distortion=(-0.1, 0.01, 0, 0, 0), pitch=0.3, roll=-0.1),
    "fisheye": Lens(**NUMBERS, **SIZE, model="equidistant", distortion=(-0.02, 0.005, -0.001, 0)),
}
BEARING = np.linspace(-0.8, 0.8, 60)
T, ID = np.arange(60) / 4, 1 + np.arange(60) % 5
HALF_TAG = 0.08 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
"""Left and up of the corners of a tag, clockwise [m]."""


def drawn(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of centres (n, 2) and corners (n, 4, 2) of tags at `BEARING`, from OpenCV."""
    facing = np.stack([-np.sin(BEARING), np.cos(BEARING), 0 * BEARING], axis=-1)
    ahead = np.stack([np.cos(BEARING), np.sin(BEARING), 0.05 * ID - 0.1], axis=-1) * 2.0
    left, up = HALF_TAG.T[..., None, None]
    tags = ahead + left * facing + up * np.array([0.0, 0.0, 1.0])
    level = np.concatenate([ahead[None], tags]) @ tilt_matrix(lens.roll, lens.pitch)
    x, y, z = np.moveaxis(level, -1, 0)
    points, still = np.stack([-y, -z, x], axis=-1).reshape(-1, 1, 3), np.zeros(3)
    k = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if lens.model == "equidistant" else cv2.projectPoints
    uv = project(points, still, still, k, np.array(lens.distortion))[0].reshape(5, -1, 2)
    return uv[0], np.moveaxis(uv[1:], 0, 1)


def write(folder, columns, name="tags.csv"):
    rows = zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    (folder / name).write_text("\n".join(lines) + "\n")
    return [sample_drive() / "odometry.csv", folder / name, sample_drive() / "home.csv"]


def bearings(paths, *columns, **cameras):
    found = understand(paths, columns, **cameras)
    how = found["bearings"].columns["bearing"]
    return drive_of(found, "tags").sightings, f"{how.name}; {how.source}"


def points(u, v):
    return {
        "t": T,
        "id": ID,
        u: drawn(LENSES["pinhole"])[0][:, 0],
        v: drawn(LENSES["pinhole"])[0][:, 1],
    }


def corners(lens, names, order=(0, 1, 2, 3)):
    columns = drawn(lens)[1][:, order].reshape(-1, 8).T
    return {"t": T, "tag_id": ID, **dict(zip(names.split(), columns, strict=True))}


@pytest.mark.parametrize("name", LENSES)
def test_a_pixel_has_the_bearing_of_its_ray(tmp_path, name):
    uv = drawn(LENSES[name])[0]
    paths = write(tmp_path, {"t": T, "id": ID, "u": uv[:, 0], "v": uv[:, 1]})
    sightings, how = bearings(paths, cameras={"": LENSES[name]})
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)
    assert how == f"ray (u, v); {LENSES[name].model}"
    assert np.isnan(sightings.sigma).all()


NAMES = [
    "x0 y0 x1 y1 x2 y2 x3 y3",
    "u1 v1 u2 v2 u3 v3 u4 v4",
    "corner0_x corner0_y corner1_x corner1_y corner2_x corner2_y corner3_x corner3_y",
    "corners[0].x corners[0].y corners[1].x corners[1].y corners[2].x corners[2].y corners[3].x "
    "corners[3].y",
    "tl_x tl_y tr_x tr_y br_x br_y bl_x bl_y",
    "topLeftX topLeftY topRightX topRightY bottomRightX bottomRightY bottomLeftX bottomLeftY",
]


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("names", NAMES)
def test_corners_have_the_bearing_of_the_centre_of_the_tag(tmp_path, name, names):
    paths = write(tmp_path, corners(LENSES[name], names))
    sightings, _ = bearings(paths, cameras={"": LENSES[name]})
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)
    assert ((sightings.sigma > 2e-4) & (sightings.sigma < 0.03)).all()


@pytest.mark.parametrize("form", ["{}", "[{}]"])
def test_corners_and_centre_as_arrays_in_cells(tmp_path, form):
    uv, tags = drawn(LENSES["fisheye"])
    cells = {"center": uv[:, None], "corners": tags}
    table = {name: [form.format(v.tolist()) for v in values] for name, values in cells.items()}
    rows = zip(T.tolist(), ID.tolist(), *table.values(), strict=True)
    lines = [f"{t};{tag};{middle};{four}" for t, tag, middle, four in rows]
    paths = write(tmp_path, {"t": T})
    paths[1].write_text("\n".join([";".join(["t", "tag_id", *table]), *lines]))
    sightings, _ = bearings(paths, cameras={"": LENSES["fisheye"]})
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)
    assert sightings.sigma.max() < 0.03
    with pytest.raises(
        InputError, match=r"'corners_x0', 'corners_y0', \.\.\. are pixels, which need"
    ):
        understand(paths)


@pytest.mark.parametrize("order", [(0, 1, 3, 2), (0, 2, 1, 3), (3, 2, 1, 0)])
def test_corners_in_any_order(tmp_path, order):
    paths = write(tmp_path, corners(LENSES["fisheye"], NAMES[0], order))
    sightings, how = bearings(paths, cameras={"": LENSES["fisheye"]})
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)
    assert ("order 0 " in how) == (order != (3, 2, 1, 0))


@pytest.mark.parametrize(
    ("u", "v"),
    [
        *(("u", "v"), ("x", "y"), ("px", "py"), ("cx", "cy"), ("x_px", "y_px")),
        *(("x [px]", "y [px]"), ("center.x", "center.y"), ("col", "row"), ("pixel_x", "pixel_y")),
    ],
)
def test_names_of_pixel_columns(tmp_path, u, v):
    sightings, _ = bearings(write(tmp_path, points(u, v)), cameras={"": LENSES["pinhole"]})
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("given", [("fx", "fy", "cx", "cy"), ("fx", "cx", "cy"), ("fx", "cx")])
def test_intrinsics_in_columns(tmp_path, given):
    constant = {name: [NUMBERS[name]] * len(T) for name in given}
    rows = {"t": T, "id": ID, "u": drawn(LENSES["pinhole"])[0][:, 0]}
    for table in (points("x", "y"), points("u", "v"), rows):
        sightings, how = bearings(write(tmp_path, table | constant))
        assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)
        assert how.endswith("plumb_bob")


def test_home_in_pixels(tmp_path):
    paths = write(tmp_path, points("u", "v"))
    uv = drawn(LENSES["pinhole"])[0][:5]
    at_home = {"id": ID[:5], "u": uv[:, 0], "v": uv[:, 1]}
    paths[2] = write(tmp_path, at_home, "home.csv")[1]
    home = drive_of(understand(paths, cameras={"": LENSES["pinhole"]}), "home").home
    assert {n: h.bearing for n, h in home.items()} == pytest.approx(
        dict(zip("12345", BEARING[:5], strict=True)), abs=1e-6
    )


def test_home_bearings_in_degrees_along_with_pixels(tmp_path):
    paths = write(tmp_path, points("u", "v"))
    paths[2] = write(tmp_path, {"id": ID[:2], "bearing": [10.0, -120.0]}, "home.csv")[1]
    home = drive_of(understand(paths, cameras={"": LENSES["pinhole"]}), "home").home
    assert home["2"].bearing == pytest.approx(math.radians(-120.0))


def test_landmarks_out_of_view_are_left_out(tmp_path):
    table = points("u", "v")
    for column in ("u", "v"):
        table[column] = np.where(np.arange(60) < 2, -1.0, table[column])
        table[column][5] = 0.0
    drive = drive_of(understand(write(tmp_path, table), cameras={"": LENSES["pinhole"]}), "zeros")
    assert drive.sightings.t.size == 57
    assert any(line.startswith("3 landmarks out of view") for line in drive.remark_lines)


def test_positions_along_with_corners_need_no_camera(tmp_path):
    where = {"x": -np.sin(BEARING), "y": 0.01 * ID, "z": np.cos(BEARING)}
    paths = write(tmp_path, corners(LENSES["pinhole"], NAMES[0]) | where)
    sightings, how = bearings(paths)
    assert how.startswith("atan2(-x, z)")
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-9)
    assert bearings(paths, cameras={"": LENSES["pinhole"]})[1].startswith("tag x0 ... y3")


def test_specified_columns(tmp_path):
    table = points("a", "b") | {"bearing": 0 * T}
    sightings, _ = bearings(
        write(tmp_path, table), "column=a, row=b", cameras={"": LENSES["pinhole"]}
    )
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)


PIN = points("u", "v")


@pytest.mark.parametrize(
    ("table", "camera", "complaint"),
    [
        (PIN, None, r"'u', 'v' are pixels, which need the camera's intrinsics; add --camera FILE"),
        (corners(LENSES["pinhole"], NAMES[0]), None, "'x0', 'y0', ... are pixels, which need"),
        (points("x", "y"), None, "positions in unknown axes .*if they are pixels.*--camera FILE"),
        (PIN | {"u": PIN["u"] * 2}, "pinhole", r"row \d+: the pixel .* is outside the calibrated"),
        ({**PIN, "u": PIN["u"] / 3, "v": PIN["v"] / 3}, "pinhole", "all pixels are in the first q"),
        (
            {**PIN, "u": PIN["u"] / 1280, "v": PIN["v"] / 960},
            "pinhole",
            "up to 0.9.* are no pixels",
        ),
        ({**PIN, "u": 0 * T, "v": 0 * T}, "pinhole", "all rows are of landmarks out of view"),
        ({**PIN, "u": T * math.nan}, "pinhole", "no row has values for all of t, landmark, column"),
        ({**PIN, "u": ["a"] * 60}, "pinhole", "row 2: u: must be a finite number, not 'a'"),
        ({**PIN, "theta": T}, "pinhole", "'theta' may be the bearing or the heading"),
        ({"t": T, "id": ID, "bearing": BEARING}, "pinhole", "--camera: not used: no table has"),
        ({"t": T, "id": ID, "u": PIN["u"]}, "plumb_bob", "only columns of pixels, but the camera"),
        (points("x", "y") | {"w": T + 9}, "pinhole", "may be the centre or a corner of a box"),
        (
            PIN | {"fx": T, "cx": T},
            None,
            "row 3: fx: must be the same in all rows of a camera, not '0.25'",
        ),
        (PIN | {"fx": 0 * T, "cx": 0 * T}, None, "fx: must be greater than 0"),
        (PIN | {"fx": T * math.nan, "cx": 0 * T}, None, "fx: must be greater than 0"),
    ],
)
def test_refusals(tmp_path, table, camera, complaint):
    with pytest.raises(InputError, match=complaint):
        understand(write(tmp_path, table), cameras={"": LENSES[camera]} if camera else {})


def test_corners_that_are_no_quadrilateral(tmp_path):
    table = corners(LENSES["pinhole"], NAMES[0])
    table["x2"] = np.random.default_rng(1).permutation(table["x2"])
    with pytest.raises(InputError, match="corners are in no order round the tags"):
        understand(write(tmp_path, table), cameras={"": LENSES["pinhole"]})


def test_camera_option(tmp_path):
    paths = write(tmp_path, PIN)
    (tmp_path / "ost.yaml").write_text("fx: 500\nfy: 505\ncx: 655\ncy: 470\n")
    picture = ["--picture", tmp_path / "import.png"]
    answer = call("import", *paths, *picture, "--camera", tmp_path / "ost.yaml")
    assert "pixels, --camera" in answer.stdout
    words = refused(call("import", *paths, *picture, "--camera", tmp_path / "nothing.yaml"))
    assert "nothing.yaml: cannot be read" in words


FRONT = np.arange(60) % 3 == 0
"""Rows of a front camera; the others are of a rear one."""


def seen_by_two(u="u", v="v"):
    """Pixels in a tilted front camera and a rear fisheye, at the same bearings."""
    front, rear = drawn(LENSES["tilted"])[0], drawn(LENSES["fisheye"])[0]
    uv = np.where(FRONT[:, None], front, rear)
    names = np.where(FRONT, "front", "rear")
    return {"t": T, "id": ID, "camera": names, u: uv[:, 0], v: uv[:, 1]}


@pytest.mark.parametrize("first", ["front", ""])
@pytest.mark.parametrize("u", ["u", "x"])
def test_each_of_several_cameras_has_its_calibration(tmp_path, first, u):
    paths = write(tmp_path, seen_by_two(u, {"u": "v", "x": "y"}[u]))
    cameras = {first: LENSES["tilted"], "rear": LENSES["fisheye"]}
    sightings, how = bearings(paths, cameras=cameras)
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)
    assert sightings.camera.tolist() == np.where(FRONT, "front", "rear").tolist()
    assert how.endswith("; plumb_bob/equidistant")


def test_corners_in_several_cameras(tmp_path):
    front, rear = corners(LENSES["tilted"], NAMES[0]), corners(LENSES["fisheye"], NAMES[0])
    table = {name: np.where(FRONT, front[name], rear[name]) for name in front}
    paths = write(tmp_path, table | {"camera": np.where(FRONT, "front", "rear")})
    cameras = {"front": LENSES["tilted"], "rear": LENSES["fisheye"]}
    found = understand(paths, cameras=cameras, tag_size=0.16)
    seen = drive_of(found, "tags").sightings
    assert wrap(seen.bearing - BEARING) == pytest.approx(0, abs=1e-6)
    assert seen.range == pytest.approx(2.0, abs=0.005)


def test_intrinsics_of_several_cameras_in_columns(tmp_path):
    wide = Lens(**NUMBERS | {"fx": 400.0, "cx": 600.0}, **SIZE)
    u = np.where(FRONT, drawn(LENSES["pinhole"])[0][:, 0], drawn(wide)[0][:, 0])
    intrinsics = {"fx": np.where(FRONT, 500.0, 400.0), "cx": np.where(FRONT, 655.0, 600.0)}
    table = {"t": T, "id": ID, "camera": np.where(FRONT, "front", "rear"), "u": u, **intrinsics}
    sightings, _ = bearings(write(tmp_path, table))
    assert wrap(sightings.bearing - BEARING) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("given", "missing"),
    [([""], "'front' and 'rear'"), (["front"], "'rear'"), (["left"], "'front'")],
)
def test_a_camera_without_its_calibration_is_refused(tmp_path, given, missing):
    cameras = dict.fromkeys(given, LENSES["tilted"])
    with pytest.raises(InputError, match=f"cameras without a calibration: {missing}.*NAME=FILE"):
        understand(write(tmp_path, seen_by_two()), cameras=cameras)


def test_a_pixel_outside_the_image_of_its_camera_is_refused(tmp_path):
    small = Lens(**NUMBERS | {"cx": 160.0, "cy": 120.0}, width=320, height=240)
    cameras = {"front": LENSES["tilted"], "rear": small}
    with pytest.raises(InputError, match="is outside the calibrated image, 320x240"):
        understand(write(tmp_path, seen_by_two()), cameras=cameras)


def test_camera_option_of_several_cameras(tmp_path):
    paths = write(tmp_path, seen_by_two())
    for name in ("tilted", "fisheye"):
        (tmp_path / f"{name}.yaml").write_text(LENSES[name].model_dump_json())
    rear = f"rear={tmp_path / 'fisheye.yaml'}"
    options = ["--picture", tmp_path / "import.png", "--camera", rear]
    front = ["--camera", f"front={tmp_path / 'tilted.yaml'}"]
    assert f"--camera {rear} --camera front=" in call("import", *paths, *options, *front).stdout
    words = refused(call("import", *paths, *options, "--camera", rear))
    assert "--camera is given twice for one camera" in words


@pytest.mark.parametrize("name", LENSES)
def test_the_size_of_tags_gives_ranges(tmp_path, name):
    paths = write(tmp_path, corners(LENSES[name], NAMES[0]))
    found = understand(paths, cameras={"": LENSES[name]}, tag_size=0.16)
    assert drive_of(found, "tags").sightings.range == pytest.approx(2.0, abs=0.005)
    assert np.isnan(
        drive_of(understand(paths, cameras={"": LENSES[name]}), "tags").sightings.range
    ).all()


def test_the_size_of_tags_without_corners_is_refused(tmp_path):
    paths = write(tmp_path, points("u", "v"))
    with pytest.raises(InputError, match="--tag-size: not used: no table has the corners"):
        understand(paths, cameras={"": LENSES["pinhole"]}, tag_size=0.16)
