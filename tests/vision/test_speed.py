"""What keeps the front-end quick."""

import platform

import numpy as np
import pytest

pytest.importorskip("cv2")

from homeward.vision import Equirectangular, extract


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library's memory")
def test_memory_is_not_requested_again_for_every_image():
    from resource import RUSAGE_SELF, getrusage

    image = np.random.default_rng(0).integers(0, 256, (384, 1536), dtype=np.uint8)
    pages = []
    for _ in range(4):
        before = getrusage(RUSAGE_SELF).ru_minflt
        extract(image, Equirectangular())
        pages.append(getrusage(RUSAGE_SELF).ru_minflt - before)
    # Pyramids are some 180 MB.
    assert min(pages) < 1000, pages
