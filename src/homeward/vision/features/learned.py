"""Features of a user's own ONNX models, as OpenCV 5 runs them: ALIKED, and LightGlue to match them.

Zhao et al., "ALIKED: a lighter keypoint and descriptor extraction network", 2023; Lindenberger et
al., "LightGlue: local feature matching at light speed", ICCV 2023. No weights come with homeward.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from homeward.drives.text.files import is_there
from homeward.errors import InputError
from homeward.vision.features.detection import Sift, View
from homeward.vision.opencv import opencv

TRIED = 64
"""Models are tried on noise of so many columns and rows, before long work begins."""


class Learned(Sift):
    """Finds features by models; not for several threads at once.

    Parameters
    ----------
    model : Path
        From `image`, (1, 3, height, width) in [0, 1], to `keypoints`, (n, 2) in [-1, 1], their
        `descriptors`, (n, k), and `scores`, (n, 1).
    matcher : Path, optional
        From `kpts0`, `desc0`, `kpts1` and `desc1`, (1, n, 2 or k), to `matches0`, (m, 2), and
        `mscores0`, (m,); None: as those of SIFT are matched.
    size : tuple of int
        Width and height of `image`; pictures are scaled to them.

    Raises
    ------
    InputError
        When a file is not there, or is no such model.
    """

    tells_size = False

    def __init__(
        self, model: Path, matcher: Path | None = None, size: tuple[int, int] = (640, 640)
    ) -> None:
        cv2, self.files = opencv(), (model, matcher)
        told = cv2.ALIKED_Params()
        told.inputSize = size
        with _running(model):
            self._model = cv2.ALIKED_create(str(model), told)
        rows, descriptor = self.find(np.random.default_rng(0).integers(0, 256, 2 * [TRIED], "u1"))
        if matcher is not None:
            with _running(matcher):
                self._matcher = cv2.LightGlueMatcher_create(str(matcher))
            self._matched(*2 * [(rows[:, :2], descriptor, (TRIED, TRIED))])

    def find(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Sift`."""
        cv2 = opencv()
        with _running(self.files[0]):
            colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
            points, found = self._model.detectAndCompute(colour, None)
        return np.array([(*p.pt, p.size, 0.0) for p in points]).reshape(-1, 4), found

    def match(
        self, home: View, now: View, ratio: float, possible: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Sift`."""
        if self.files[1] is None or not len(home) or not len(now):
            return super().match(home, now, ratio, possible)
        rows, quality = self._matched(
            *(
                (np.column_stack([v.column, v.row]), v.descriptor, v.shape[::-1])
                for v in (home, now)
            )
        )
        kept = np.ones(len(rows), bool) if possible is None else possible[tuple(rows.T)]
        return rows[kept], quality[kept]

    def _matched(
        self, *views: tuple[np.ndarray, np.ndarray, tuple[int, ...]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return rows, (m, 2), that LightGlue matches, and one less their scores, (m,)."""
        places, descriptors, sizes = zip(*views, strict=True)
        with _running(self.files[1]):
            self._matcher.setPairInfo(*(p.astype(np.float32) for p in places), *sizes)
            found = self._matcher.match(*descriptors)
        rows = np.array([(m.queryIdx, m.trainIdx) for m in found], int).reshape(-1, 2)
        return rows, np.array([m.distance for m in found])


@contextmanager
def _running(file: Path | None) -> Iterator[None]:
    """Say in one line what is wrong with a model, where OpenCV would say it in five."""
    if file is None or not is_there(file):
        raise InputError("no such file", file)
    cv2 = opencv()
    level = cv2.utils.logging.setLogLevel(0)
    try:
        yield
    except cv2.error as error:
        words = "no ONNX model of features that OpenCV runs"
        raise InputError(f"{words}: {error.err.splitlines()[0]}", file) from None
    finally:
        cv2.utils.logging.setLogLevel(level)
