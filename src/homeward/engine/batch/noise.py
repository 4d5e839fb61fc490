"""The noise of a batch: the generator of `native/noise.h`, number for number, in NumPy.

Philox4x32-10 with the seed as its key; its counter is the pair of numbers drawn, the stream, the
step and the run, so that no draw depends on another.

References
----------
Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from __future__ import annotations

import numpy as np

_LOW = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)


def philox(counter: np.ndarray, seed: int) -> np.ndarray:
    """Return 4 words of 32 random bits for each counter, shape (4, ...), of such words.

    Returns
    -------
    ndarray of uint64, shape (4, ...)
    """
    a, b, c, d = counter
    key = np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint64)
    for _ in range(10):
        left, right = a * np.uint64(0xD2511F53), c * np.uint64(0xCD9E8D57)
        a, b = (right >> _32) ^ b ^ key[0], right & _LOW
        c, d = (left >> _32) ^ d ^ key[1], left & _LOW
        key = (key + np.array([0x9E3779B9, 0xBB67AE85], np.uint64)) & _LOW
    return np.stack([a, b, c, d])


def uniforms(seed: int, run: int, step: int, stream: int, size: int) -> np.ndarray:
    """Return numbers in [0, 1), shape (size,), of one stream at one step of one run."""
    pairs = np.arange((size + 1) // 2, dtype=np.uint64)
    counter = np.zeros((4, pairs.size), np.uint64)
    counter[0] = np.uint64(stream << 16) + pairs
    counter[1], counter[2], counter[3] = step, run & 0xFFFFFFFF, run >> 32
    words = philox(counter, seed)
    bits = (words[0::2] << _32 | words[1::2]) >> np.uint64(12) | np.uint64(0x3FF0000000000000)
    numbers: np.ndarray = bits.T.copy().view(np.float64).reshape(-1)[:size] - 1.0
    return numbers


def normals(seed: int, run: int, step: int, stream: int, size: int) -> np.ndarray:
    """Return standard normal numbers, shape (size,), of one stream at one step of one run."""
    u = uniforms(seed, run, step, stream, size + size % 2).reshape(-1, 2)
    radius = np.sqrt(-2.0 * np.log(1.0 - u[:, 0]))
    angle = 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).reshape(-1)[:size]
