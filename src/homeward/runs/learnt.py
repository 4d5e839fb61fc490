"""Estimates of a run as lines for drive.yaml."""

from __future__ import annotations

from homeward.drives.settings import DriveSettings, Sensor
from homeward.io.settings import settings_yaml
from homeward.localizer.localizer import Learnt


def learnt_yaml(learnt: Learnt, drive: str) -> str:
    """Return lines for drive.yaml; empty if a run learnt nothing that matters.

    The extrinsics are tested by the localiser and are keys. The noise and the lag are comments: the
    noise is an estimate without a test on other data, and either clock may be late.
    """
    sensor = {"sensor": Sensor(**learnt.extrinsics)} if learnt.extrinsics else {}
    lines = settings_yaml(DriveSettings(**sensor)).splitlines()
    if learnt.bearing_sigma is not None:
        sigma = f"{learnt.bearing_sigma:.2g}"
        lines.append(f"# sensor: {{bearing_sigma: {sigma}}}  # rad; homeward tune tests it")
    if learnt.lag:
        lines.append(f"# bearings_late: {learnt.lag:.2f}  # s; if the bearings are stamped late")
    head = f"# Estimated by homeward run from {drive}; for drive.yaml.\n"
    return head + "\n".join(lines) + "\n" if lines else ""
