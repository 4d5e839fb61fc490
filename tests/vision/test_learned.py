"""Models of the user's own in the place of SIFT, by small ONNX files written here by hand.

The features are a grid of 20 x 20 places, each described by 128 random masks of what is about it;
the matcher takes what is likest to each. No trained weights are needed for that, and none were
ever tried.
"""

import numpy as np
import pytest
import yaml
from cli.commands import call, done, refused

cv2 = pytest.importorskip("cv2", reason="pictures need the extra `vision`")

from homeward.angles import wrap  # noqa: E402
from homeward.errors import InputError  # noqa: E402
from homeward.vision import Equirectangular, FrontEnd, compare, look  # noqa: E402
from homeward.vision.features.learned import Learned  # noqa: E402
from homeward.vision.recorded.cache import cache_key  # noqa: E402
from homeward.vision.recorded.settings import ImageSettings, read_image_settings  # noqa: E402

GRID, SIDE = 20, 640
N = GRID**2
CAMERA = Equirectangular()
TURN = 272  # columns: five steps of the grid on 1,024 columns and the 64 beyond both edges


def varint(n):
    return bytes([n]) if n < 128 else bytes([n % 128 | 128]) + varint(n // 128)


def field(number, value):
    """Return one field of a protobuf message: a number, text, or another message."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    value = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(value)) + value


def fields(number, values):
    return b"".join(field(number, value) for value in values)


def tensor(name, a):
    kind = 1 if a.dtype == np.float32 else 7
    return fields(1, a.shape) + field(2, kind) + field(8, name) + field(9, a.tobytes())


def described(name, kind, *shape):
    dims = fields(1, (field(1, n) if isinstance(n, int) else field(2, n) for n in shape))
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, dims)))


def node(op, inputs, output, **attributes):
    told = fields(1, inputs.split()) + field(2, output) + field(3, output) + field(4, op)
    for name, value in attributes.items():
        one = isinstance(value, int)
        how = field(3, value) + field(20, 2) if one else fields(8, value) + field(20, 7)
        told += field(5, field(1, name) + how)
    return told


def onnx(path, nodes, constants, inputs, outputs):
    """Write a model of operator set 13."""
    graph = fields(1, nodes) + field(2, "g")
    graph += fields(5, (tensor(name, a) for name, a in constants.items()))
    graph += fields(11, inputs) + fields(12, outputs)
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13)))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path, rng = tmp_path_factory.mktemp("models"), np.random.default_rng(1)
    masks = rng.standard_normal((128, 3, 8, 8)).astype(np.float32)
    masks -= masks.mean(axis=(1, 2, 3), keepdims=True)
    middle = 2 * (np.arange(GRID) + 0.5) / GRID - 1
    places = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(N, 2).astype(np.float32)
    onnx(
        path / "features.onnx",
        [
            node("Conv", "image masks", "seen", strides=[32, 32], dilations=[4, 4]),
            node("Reshape", "seen flat", "rows"),
            node("Transpose", "rows", "descriptors", perm=[1, 0]),
            node("Identity", "places", "keypoints"),
            node("Identity", "ones", "scores"),
        ],
        {
            "masks": masks,
            "flat": np.array([128, N]),
            "places": places,
            "ones": np.ones((N, 1), np.float32),
        },
        [described("image", 1, 1, 3, SIDE, SIDE)],
        [
            described("keypoints", 1, N, 2),
            described("descriptors", 1, N, 128),
            described("scores", 1, N, 1),
        ],
    )
    onnx(
        path / "matcher.onnx",
        [
            node("Transpose", "desc1", "across", perm=[0, 2, 1]),
            node("MatMul", "desc0 across", "likeness"),
            node("ArgMax", "likeness", "likest", axis=2, keepdims=1),
            node("Reshape", "likest column", "second"),
            node("Shape", "desc0", "sizes"),
            node("Gather", "sizes one", "many"),
            node("Range", "none many one", "first"),
            node("Reshape", "first column", "counted"),
            node("Concat", "counted second", "matches0", axis=1),
            node("ReduceMax", "likeness", "best", axes=[2], keepdims=1),
            node("Reshape", "best row", "mscores0"),
            node("Add", "kpts0 kpts0", "unused0"),
            node("Add", "kpts1 kpts1", "unused1"),
        ],
        {
            "column": np.array([-1, 1]),
            "row": np.array([-1]),
            "none": np.array(0),
            "one": np.array(1),
        },
        [
            described(f"{k}{i}", 1, 1, "n", w)
            for i in (0, 1)
            for k, w in (("kpts", 2), ("desc", 128))
        ],
        [described("matches0", 7, "m", 2), described("mscores0", 1, "m")],
    )
    return path


@pytest.fixture(scope="module")
def pictures(folder):
    """Return a panorama, and what is seen of it by a camera that has turned on the spot."""
    rng = np.random.default_rng(3)
    grain = cv2.GaussianBlur(np.tile(rng.standard_normal((256, 1024)), 3), (0, 0), 3.0)[
        :, 1024:2048
    ]
    home = np.clip(128 + 60 * grain / grain.std(), 0, 255).astype(np.uint8)
    now = np.roll(home, TURN, axis=1)
    for name, picture in {"home": home, "now": now}.items():
        cv2.imwrite(str(folder / f"{name}.png"), picture)
    return home, now


@pytest.mark.parametrize("matcher", [None, "matcher.onnx"])
def test_a_turn_is_told_by_a_model_of_ones_own(folder, pictures, matcher):
    finder = Learned(folder / "features.onnx", matcher and folder / matcher)
    home, now = (look(picture, CAMERA, finder=finder) for picture in pictures)
    assert 300 < len(home) <= N  # those beyond the seam are left out
    seen = compare(home, now, CAMERA)
    assert seen.accepted, seen.acceptance.reason
    assert abs(wrap(seen.heading - 2 * np.pi * TURN / 1024)) < 1e-3
    assert not seen.shows_parallax


def test_frames_of_a_drive_are_looked_at_as_home_was(folder, pictures):
    home, now = pictures
    front_end = FrontEnd(look(home, CAMERA, finder=Learned(folder / "features.onnx")), CAMERA)
    assert front_end.see(now).home.accepted


def test_what_is_cached_hangs_on_the_models(folder, pictures):
    told(folder, model="features.onnx")
    own = read_image_settings(folder / "images.yaml")
    before = cache_key([folder / "home.png"], own)
    assert before != cache_key([folder / "home.png"], ImageSettings())
    (folder / "other.onnx").write_bytes((folder / "features.onnx").read_bytes() + b" ")
    told(folder, model="other.onnx")
    assert before != cache_key([folder / "home.png"], read_image_settings(folder / "images.yaml"))


def told(folder, **features):
    (folder / "images.yaml").write_text(yaml.safe_dump({"features": features}))
    return ["compare", folder / "home.png", folder / "now.png", "--camera", folder / "images.yaml"]


def test_compare_takes_models_from_images_yaml(folder, pictures, tmp_path):
    args = told(folder, model="features.onnx", matcher="matcher.onnx", size=[SIDE, SIDE])
    said = done(call(*args, "--force", "--out", tmp_path / "out")).stdout
    assert f"Heading change: {360 * TURN / 1024:.2f} deg" in said.replace("\n", " ")


@pytest.mark.parametrize(
    ("features", "words"),
    [
        ({"model": "none.onnx"}, "model 'none.onnx' is not there"),
        ({"model": "../out.onnx"}, "lies outside the folder"),
        ({"model": "home.png"}, "home.png: no ONNX model of features that OpenCV runs"),
        ({"model": "matcher.onnx"}, "matcher.onnx: no ONNX model of features that OpenCV runs"),
        ({"model": "features.onnx", "matcher": "features.onnx"}, "that OpenCV runs: input 'kpts0'"),
        ({"model": "features.onnx", "size": [320, 320]}, "that OpenCV runs"),
        ({"model": "features.onnx", "size": [0, 640]}, "features.size.0: must be at least 16"),
        ({"matcher": "matcher.onnx"}, "model"),
        ({"model": "features.onnx", "weights": 1}, "weights"),
    ],
)
def test_what_is_no_such_model_is_refused_in_one_line(
    folder, pictures, tmp_path, features, words, capfd
):
    assert words in refused(call(*told(folder, **features), "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    assert "WARN" not in capfd.readouterr().err


def test_tags_and_features_are_not_looked_for_together():
    with pytest.raises(ValueError, match="tags or features"):
        ImageSettings(tags="36h11", features={"model": "features.onnx"})


def test_a_file_that_is_not_there_is_named_from_python_too(tmp_path):
    with pytest.raises(InputError, match=r"none\.onnx: no such file"):
        Learned(tmp_path / "none.onnx")
