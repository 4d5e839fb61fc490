"""What a study keeps of each run: names, units, and what they mean."""

from __future__ import annotations

from typing import NamedTuple


class Quantity(NamedTuple):
    """One number of a run, or one number of a run at each time."""

    unit: str
    """As netCDF conventions write it; 1 for a number without one."""
    meaning: str


RUN: dict[str, Quantity] = {
    "position_rmse": Quantity("m", "RMSE of the position over the run, weighted by time"),
    "R_rmse": Quantity("m", "RMSE of the distance from home"),
    "theta_rmse": Quantity("rad", "RMSE of the direction seen from home"),
    "heading_rmse": Quantity("rad", "RMSE of the heading"),
    "position_max": Quantity("m", "largest error of the position"),
    "position_bias": Quantity("m", "size of the mean position error, second half of the run"),
    "position_oscillation": Quantity("m", "RMS of what is left of it, second half of the run"),
    "position_bound": Quantity("m", "Cramer-Rao bound on position_rmse, at the true path"),
    "heading_bound": Quantity("rad", "Cramer-Rao bound on heading_rmse, at the true path"),
    "nees": Quantity("1", "mean NEES of (x, y, heading): 3 when consistent"),
    "nees_inside_95": Quantity("1", "share of the run inside the 95 % region: 0.95"),
    "nis": Quantity("1", "mean NIS of accepted sightings: 1 when consistent"),
    "pose_share": Quantity("1", "share of the run with a pose"),
    "first_pose": Quantity("s", "time of the first pose"),
    "duration": Quantity("s", "length of the drive"),
    "final_distance": Quantity("m", "true distance from home at the end"),
    "reached_home": Quantity("1", "1 where the run truly ended at home, else 0"),
    "moved_right": Quantity("1", "1 where exactly the moved landmarks were named, else 0"),
    "moved_bearing_error": Quantity("rad", "RMS of the moved landmarks' estimated home bearings"),
    "moved_bearing_stored": Quantity("rad", "the same of what home stored"),
    "seconds": Quantity("s", "processor time; the one number that does not repeat"),
}
"""Each has a value for every scenario, estimator and run; NaN where it cannot be told."""

SERIES: dict[str, Quantity] = {
    "position_error": Quantity("m", "error of the position"),
    "heading_error": Quantity("rad", "error of the heading"),
    "nees_over_time": Quantity("1", "NEES of (x, y, heading)"),
    "position_bound_over_time": Quantity("m", "Cramer-Rao bound on the position's error"),
    "heading_bound_over_time": Quantity("rad", "Cramer-Rao bound on the heading's error"),
}
"""The same at each time."""

FAILURE = "failure"
"""Why a run failed, in words; empty where it did not."""
