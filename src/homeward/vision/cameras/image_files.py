"""Image files, read as 8-bit grey.

Pillow decodes them: it refuses truncated files, while OpenCV fills them with grey.
"""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from homeward.errors import InputError, naming_file
from homeward.io.reading import naming, opened
from homeward.vision.cameras.grey import MAX_PIXELS, Mask, as_grey, eight_bits, require_size
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.opencv import opencv

FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "PPM", "WEBP", "GIF")


def read_grey(path: Path) -> np.ndarray:
    """Read an image as grey, uint8 (height, width), rotated according to its Exif orientation.

    The file is a PNG, JPEG, BMP, TIFF, PPM, WebP or GIF; 16 bits are scaled as in `as_grey`. Raises
    `InputError` if it is no complete image of one frame, or its size is not that of a panorama.
    """
    with naming(path, "cannot be read"), opened(path) as stream:
        return decoded_grey(stream, path)


def decoded_grey(stream: IO[bytes], path: Path) -> np.ndarray:
    """Decode an open file, named `path` in errors; as `read_grey`."""
    if not stream.read(1):
        raise InputError("empty file", path)
    stream.seek(0)
    try:
        with warnings.catch_warnings():
            # Pillow warns about large images and odd tags; sizes are checked below.
            warnings.simplefilter("ignore")
            with Image.open(stream, formats=FORMATS) as image:
                _check(image)
                is_deep_colour = _is_deep_colour(image)
                upright = _upright(image)
                if is_deep_colour:  # Pillow drops the lower 8 bits: all of a dark image
                    upright = _upright(_deep_grey(stream, image))
                return _grey(upright)
    except InputError as error:
        error.at(path)
        raise
    except UnidentifiedImageError:
        raise InputError("not an image in a readable format", path) from None
    except Image.DecompressionBombError:
        raise InputError(f"more than {MAX_PIXELS // 10**6} million pixels", path) from None
    except Exception as error:  # decoders raise anything for bytes that are no picture
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"not a complete image: {reason}", path) from None


def read_mask(path: Path, camera: Panorama, shape: tuple[int, int]) -> Mask:
    """Read a mask from an image file, whose `shape` (height, width) [px] is that of the pictures.

    A ring is unwrapped. Raises `InputError` if it cannot be read, has another size, or leaves no
    pixels.
    """
    grey = read_grey(path)
    if grey.shape != shape:
        (height, width), (wanted_height, wanted_width) = grey.shape, shape
        raise InputError(
            f"{width}x{height} pixels: a mask must have the size of the pictures, "
            f"{wanted_width}x{wanted_height}",
            path,
        )
    with naming_file(path):
        return Mask.of(camera.panorama(grey))


def _check(image: Image.Image) -> None:
    """Refuse wrong sizes and several frames, before decoding."""
    require_size(*image.size)
    if (frames := getattr(image, "n_frames", 1)) > 1:
        raise InputError(f"contains {frames} frames; give one image per file")


def _is_deep_colour(image: Image.Image) -> bool:
    """Return whether an image that is not decoded yet is in colour with 16 bits a channel."""
    modes = [str(tile[3]) for tile in getattr(image, "tile", ())]
    return image.mode.startswith("RGB") and any(";16" in mode for mode in modes)


def _deep_grey(stream: IO[bytes], image: Image.Image) -> Image.Image:
    """Decode a complete image in colour with 16 bits to 8-bit grey, with its Exif orientation."""
    cv2 = opencv()
    stream.seek(0)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    grey = Image.fromarray(as_grey(cv2.imdecode(np.frombuffer(stream.read(), np.uint8), flags)))
    grey.getexif().update(image.getexif())
    return grey


def _upright(image: Image.Image) -> Image.Image:
    """Rotate or mirror an image according to its Exif orientation; a broken tag is ignored."""
    image.load()  # raises errors of the pixels
    try:
        return ImageOps.exif_transpose(image)
    except (OSError, SyntaxError, ValueError, TypeError, KeyError, struct.error):
        return image


def _grey(image: Image.Image) -> np.ndarray:
    """Decode to 8-bit grey."""
    if image.mode.startswith("I"):
        return eight_bits(np.asarray(image))
    if image.mode == "F":
        raise InputError("floating-point pixels; save the image with 8 or 16 bits")
    if image.mode in ("P", "PA"):
        image = image.convert("RGB")
    return np.asarray(image.convert("L"))
