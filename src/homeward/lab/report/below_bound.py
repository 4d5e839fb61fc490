"""What a page says where an estimator lies below its bound."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from homeward.runs.report.words import listing

MARK = "†"
"""Of such an estimator in a figure."""
MOST = 6
"""Of them are named."""
CHANCE, FEWEST = 3.0, 10
"""Standard errors that chance explains 999 times in 1000, and runs that it takes to know them."""


def below_bound(errors: np.ndarray, bounds: np.ndarray) -> str:
    """Say how far an RMSE lies below its bound, and whether by chance; nothing where it does not.

    Parameters
    ----------
    errors, bounds : ndarray, shape (runs,)
        RMSE of each run, and the bound on it; NaN where not known.
    """
    known = np.isfinite(errors) & np.isfinite(bounds)
    excess = (errors**2 - bounds**2)[known]
    if not excess.size or excess.mean() >= 0.0:
        return ""
    share = np.sqrt(np.mean(errors[known] ** 2) / np.mean(bounds[known] ** 2))
    error = excess.std() / np.sqrt(excess.size)
    told = excess.size >= FEWEST and -excess.mean() > CHANCE * error
    return f"{100 * share:.1f} % of it, {'which is not chance' if told else 'perhaps by chance'}"


def note_below(found: Mapping[str, str]) -> str:
    """Return the note of a page on those that `below_bound` found, by name; empty without any."""
    told = [f"{name} ({words})" for name, words in found.items() if words]
    if not told:
        return ""
    return (
        f"{MARK} RMSE below its bound: {listing(told, MOST)}. The bound is of the mean over all"
        " drives, for estimators without a bias: over few runs chance gets below it, and so does an"
        " estimator whose errors are drawn towards what it expects."
    )
