"""Surveyed landmarks and measured distances: landmarks.yaml."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np

from homeward.io.checks import Field
from homeward.io.models import Strict, model_validator

Surveyed = Annotated[float, Field(ge=-1e7, le=1e7)]
Sigma = Annotated[float, Field(ge=1e-4, le=1e3)]


class SurveyedLandmark(Strict):
    """Surveyed position of a landmark."""

    x: Surveyed
    """[m]"""
    y: Surveyed
    """[m]"""
    sigma: Sigma | None = None
    """Standard deviation of each coordinate [m]; None: `KnownLandmarks.sigma`."""
    stays: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Probability that it is still in place; None: as the estimator's settings specify."""


class KnownDistance(Strict):
    """Measured distance of two landmarks."""

    between: Annotated[tuple[str, ...], Field(min_length=2, max_length=2)]
    """Their ids."""
    distance: Annotated[float, Field(gt=0, le=1e7)]
    """[m]"""
    sigma: Sigma | None = None
    """Its standard deviation [m]; None: `KnownLandmarks.sigma`."""


class KnownLandmarks(Strict):
    """The keys of landmarks.yaml: surveyed landmarks, and distances of pairs.

    `tags` and `field` of a WPILib field layout (AprilTagFieldLayout) may replace `landmarks`.
    """

    frame: Literal["own", "home"] = "own"
    """Frame of the survey: the home frame, or its own, whose pose in the map is estimated."""
    sigma: Sigma = 0.02
    """Standard deviation of coordinates and distances without their own [m]."""
    landmarks: dict[str, SurveyedLandmark] = {}
    """Surveyed landmarks by id."""
    distances: tuple[KnownDistance, ...] = ()
    """Distances of pairs."""

    @classmethod
    def remembered(
        cls, landmarks: dict[str, SurveyedLandmark], covariance: np.ndarray
    ) -> KnownLandmarks:
        """Return landmarks in the home frame, with the covariance of x, y, x, y, ... [m^2]."""
        known = cls(frame="home", landmarks=landmarks)
        vars(known)["_joint"] = covariance  # no key of the file
        return known

    @property
    def names(self) -> set[str]:
        """Ids of all landmarks with a position or distance."""
        return {*self.landmarks, *(name for d in self.distances for name in d.between)}

    @property
    def joint_covariance(self) -> np.ndarray:
        """(2 k, 2 k): covariance of the coordinates of the landmarks, in order [m^2]."""
        if self.is_place:
            joint: np.ndarray = vars(self)["_joint"]
            return joint
        sigmas = [s.sigma or self.sigma for s in self.landmarks.values()]
        return np.diag(np.repeat(np.square(sigmas), 2))

    @model_validator(mode="before")
    @classmethod
    def _from_field_layout(cls, values: Any) -> Any:
        if not isinstance(values, dict) or "tags" not in values:
            return values
        if "landmarks" in values:
            raise ValueError("give either landmarks or the tags of a field layout")
        rest = {key: value for key, value in values.items() if key not in ("tags", "field")}
        landmarks: dict[str, dict[str, float]] = {}
        for k, tag in enumerate(values["tags"] if isinstance(values["tags"], list) else [None]):
            try:
                name, place = str(tag["ID"]), tag["pose"]["translation"]
                x, y = float(place["x"]), float(place["y"])
                if not math.hypot(x, y) < math.inf or name in landmarks:
                    raise ValueError
            except (TypeError, KeyError, ValueError):
                raise ValueError(
                    f"tags.{k} is no tag {{ID, pose: {{translation: {{x, y}}}}}} with finite "
                    "numbers and an ID of its own, as in a field layout of WPILib"
                ) from None
            landmarks[name] = {"x": x, "y": y}
        return rest | {"landmarks": landmarks}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if any(a == b for a, b in (d.between for d in self.distances)):
            raise ValueError("a distance needs two different landmarks")
        if len(self.landmarks) == 1 and self.frame == "own":
            raise ValueError(
                "one surveyed landmark in its own frame gives no information: survey at least two"
            )
        return self

    @property
    def surveyed_from_home(self) -> bool:
        """Whether landmarks were surveyed in the home frame."""
        return self.frame == "home" and bool(self.landmarks)

    @property
    def is_place(self) -> bool:
        """Whether they are of a place, and not of a file."""
        return "_joint" in vars(self)

    @property
    def is_given(self) -> bool:
        """Whether any landmark or distance is known."""
        return bool(self.landmarks or self.distances)
