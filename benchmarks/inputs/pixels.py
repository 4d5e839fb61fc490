"""Tables of pixels and corners of tags, and calibrations as other tools write them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.inputs.kinds import Files, Sample, Seen, kind, table
from homeward.drives.cameras.camera import angles
from homeward.drives.cameras.lens import Lens
from homeward.drives.opening import sample_drive
from homeward.geometry.angles import wrap

TAGS = "import odometry.csv tags.csv home.csv"
SIZE = {"width": 1280, "height": 960}
PINHOLE = Lens(fx=170, fy=171, cx=655, cy=470, **SIZE)
PLUMB_BOB = Lens(fx=170, fy=171, cx=655, cy=470, distortion=(-0.005, 1e-4, 5e-5, -3e-5, 0), **SIZE)
TILTED = PLUMB_BOB.model_copy(update={"pitch": -0.3})
FISHEYE = Lens(
    **{"fx": 330, "fy": 331, "cx": 655, "cy": 470, "model": "equidistant", **SIZE},
    distortion=(-0.02, 0.005, -0.001, 2e-4),
)
TAG = 0.16
"""Width of the tags [m]."""
PIXEL_SIGMA = 0.3
"""Noise of each coordinate [px]."""


def corners(seen: Seen, lens: Lens) -> np.ndarray:
    """Return the corners of upright tags that face the camera, clockwise, (n, 4, 2) [px]."""
    height = (0.1 + 0.02 * seen.id)[:, None]
    centre = np.stack([seen.forward, seen.left, height[:, 0]], axis=-1)[:, None]
    aside = np.stack([-np.sin(seen.bearing), np.cos(seen.bearing), 0 * seen.bearing], axis=-1)
    left, up = np.array([1, -1, -1, 1])[:, None], np.array([1, 1, -1, -1])[:, None]
    points = centre + 0.5 * TAG * (left * aside[:, None] + up * np.array([0.0, 0.0, 1.0]))
    azimuth, elevation = angles(points)
    uv = np.stack(lens.pixels(azimuth.ravel(), elevation.ravel(), (0, 0)), axis=-1)
    uv += np.random.default_rng(1).normal(0.0, PIXEL_SIGMA, uv.shape)
    return uv.reshape(-1, 4, 2)


def centres(seen: Seen, lens: Lens) -> np.ndarray:
    """Return the centres of tags, (n, 2) [px]."""
    azimuth, elevation = angles(np.stack([seen.forward, seen.left, 0.1 + 0.02 * seen.id], axis=-1))
    uv = np.stack(lens.pixels(azimuth, elevation, (0, 0)), axis=-1)
    return uv + np.random.default_rng(2).normal(0.0, PIXEL_SIGMA, uv.shape)


def exact(s: Sample, seen: Seen) -> Seen:
    """Return landmarks with bearings without noise: pixels are better than those of the sample."""
    rows = [row.split(",") for row in (sample_drive() / "world.csv").read_text().split()[1:]]
    world = {int(r[0][1:]): complex(float(r[1]), float(r[2])) for r in rows}
    x, y, heading = s.truth.at(seen.t) if seen is s.seen else (0.0, 0.0, 0.0)
    camera = x + 1j * y + s.camera * np.exp(1j * np.asarray(heading))
    bearing = np.angle(np.array([world[i] for i in seen.id]) - camera) - heading
    if seen is s.home:  # those that moved since then
        bearing += np.array([{int(r[0][1:]): float(r[4]) for r in rows}[i] for i in seen.id])
    return replace(seen, bearing=wrap(bearing))


def in_view(seen: Seen, lens: Lens) -> Seen:
    """Return the landmarks of which the whole tag is in the image."""
    with np.errstate(invalid="ignore"):
        inside = (corners(seen, lens) > 0) & (corners(seen, lens) < np.array([1280, 960]))
    return seen[inside.all(axis=(1, 2))]


def seen_by(
    s: Sample,
    lens: Lens,
    names: str = "timestamp id u v",
    uv: Callable[[Seen, Lens], np.ndarray] = centres,
    home: bool = False,
) -> Files:
    """Return a table of the pixels of tags, and of those at home; `names` are the columns'."""
    stamp, *others = names.split()

    def one(seen: Seen) -> dict[str, np.ndarray]:
        coordinates = uv(seen, lens).reshape(seen.id.size, -1)
        return dict(zip(others, (seen.id, *coordinates.T), strict=True))

    a, h = in_view(exact(s, s.seen), lens), exact(s, s.home)
    turned = {"landmark": h.id, "bearing": h.bearing}  # of a camera that turned there
    at_home = one(in_view(h, lens)) if home else turned
    return {"tags.csv": table({stamp: a.t, **one(a)}), "home.csv": table(at_home)}


def ros(lens: Lens) -> str:
    """Return camera_info YAML, as cameracalibrator writes it."""
    k = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
    d = list(lens.distortion)
    return f"""image_width: {lens.width}
image_height: {lens.height}
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: {k}
distortion_model: {lens.model}
distortion_coefficients:
  rows: 1
  cols: {len(d)}
  data: {d}
"""


def opencv(lens: Lens) -> str:
    """Return the YAML of cv2.FileStorage."""
    text = ros(lens).replace("camera_matrix:", "camera_matrix: !!opencv-matrix")
    text = text.replace("coefficients:", "coefficients: !!opencv-matrix")
    lines = [
        line for line in text.splitlines() if not line.startswith(("camera_n", "distortion_m"))
    ]
    return "\n".join(["%YAML:1.0", "---", *lines, ""])


def colmap(lens: Lens) -> str:
    """Return a cameras.txt."""
    numbers = [lens.fx, lens.fy, lens.cx + 0.5, lens.cy + 0.5, *lens.distortion]
    row = f"1 OPENCV_FISHEYE {lens.width} {lens.height} {' '.join(map(str, numbers))}"
    return f"# Camera list with one line of data per camera:\n{row}\n"


@kind("pixels u, v; intrinsics in columns", TAGS)
def _(s: Sample) -> Files:
    files = seen_by(s, PINHOLE)
    head, *rows = str(files["tags.csv"]).splitlines()
    lines = [f"{head},fx,fy,cx,cy", *(f"{row},170,171,655,470" for row in rows)]
    return {"tags.csv": "\n".join(lines) + "\n"}


@kind("pixels x, y; camera_info of ROS", f"{TAGS} --camera ost.yaml")
def _(s: Sample) -> Files:
    return seen_by(s, PLUMB_BOB, "timestamp id x y") | {"ost.yaml": ros(PLUMB_BOB)}


@kind("pixels, fisheye, also at home; COLMAP", f"{TAGS} --camera cameras.txt")
def _(s: Sample) -> Files:
    tags = seen_by(s, FISHEYE, "timestamp id center_x center_y", home=True)
    return tags | {"cameras.txt": colmap(FISHEYE)}


@kind("corners x0 ... y3; OpenCV's YAML", f"{TAGS} --camera calib.yml")
def _(s: Sample) -> Files:
    tags = seen_by(s, PLUMB_BOB, "stamp tag_id x0 y0 x1 y1 x2 y2 x3 y3", corners)
    return tags | {"calib.yml": opencv(PLUMB_BOB)}


@kind("corners of a tilted camera", f"{TAGS} --camera ost.yaml")
def _(s: Sample) -> Files:
    names = " ".join(f"corner{k}_x corner{k}_y" for k in (1, 2, 3, 4))
    return seen_by(s, TILTED, f"stamp tag_id {names}", corners) | {
        "ost.yaml": ros(TILTED) + "pitch: -0.3\n"
    }


@kind("corners row by row, also at home; fisheye", f"{TAGS} --camera ost.yaml")
def _(s: Sample) -> Files:
    def by_rows(seen: Seen, lens: Lens) -> np.ndarray:
        return corners(seen, lens)[:, (0, 1, 3, 2)]

    names = "stamp tag_id c0.u c0.v c1.u c1.v c2.u c2.v c3.u c3.v"
    return seen_by(s, FISHEYE, names, by_rows, home=True) | {"ost.yaml": ros(FISHEYE)}


@kind("pixels without a camera", TAGS, refused="need the camera's intrinsics; add --camera FILE")
def _(s: Sample) -> Files:
    return seen_by(s, PINHOLE)


@kind(
    "pixels of another size",
    f"{TAGS} --camera ost.yaml",
    refused="outside the calibrated image, 640x480",
)
def _(s: Sample) -> Files:
    small = {"fx": 85.0, "fy": 85.5, "cx": 327.0, "cy": 235.0, "width": 640, "height": 480}
    return seen_by(s, PINHOLE) | {"ost.yaml": ros(Lens(**small))}


@kind("camera never calibrated", f"{TAGS} --camera ost.yaml", refused="matrix is zero")
def _(s: Sample) -> Files:
    text = ros(PINHOLE)
    for number in ("170.0", "171.0", "655.0", "470.0", "1.0"):
        text = text.replace(number, "0.0")
    return seen_by(s, PINHOLE) | {"ost.yaml": text}
