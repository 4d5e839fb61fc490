"""The paper's second kind of measurement: bearings of features in panoramic images.

A small room is rendered with home in its middle. Features of the home image are the landmarks; in
cases with faults some of them are on boxes that were moved between the home image and the drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from homeward.drives.cameras.camera import unit_vectors
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, between, compose, from_polar
from homeward.lab.simulation.render.drive import Eye, panorama_of, things_seen
from homeward.lab.simulation.render.rays.raycast import points, trace
from homeward.lab.simulation.render.room.boxes import with_boxes
from homeward.lab.simulation.render.room.settings import (
    RenderScenario,
    RoomCamera,
    Walls,
)
from homeward.lab.simulation.scenario import Homing, RoomPose, StartPose
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, PaperWorld, draw_world, fault_count
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import Features, extract

SIDE = 3.8
"""Length of the room's walls [m]: landmarks are 1 to 2.5 m from home, as in the paper's layout."""
TRIES = 8
"""Maximum number of rooms drawn until one has enough landmarks, and moved ones."""


@dataclass
class Sight:
    """Camera in a rendered room, and the features of its home image that are landmarks."""

    eye: Eye
    camera: Panorama
    home_image: np.ndarray
    """(height, width), grey."""
    home: Features
    landmarks: np.ndarray
    """(q,), rows of the home features."""
    moved: np.ndarray
    """(q,) bool, which of them are on boxes that were moved since."""
    every: int
    """Number of samples between images."""
    _seen: dict[tuple[float, ...], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def measure(self, sample: int, pose: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Return bearings (q,) [rad] and which of them were seen (q,).

        `pose` (3,) is the true one in the home frame, `dt` the time between two samples [s].
        Between images there are no bearings.
        """
        key = (sample, *pose.tolist())
        if key not in self._seen:
            self._seen[key] = self._measure(sample, Pose(*pose.tolist()), dt)
        return self._seen[key]

    def _measure(self, sample: int, pose: Pose, dt: float) -> tuple[np.ndarray, np.ndarray]:
        bearings, seen = np.zeros(self.landmarks.size), np.zeros(self.landmarks.size)
        centre = compose(self.eye.scenario.home.pose, pose)
        # A filter that diverged can drive into objects, where no landmark is visible.
        if sample % self.every or self.eye.now.blocked(centre.x, centre.y):
            return bearings, seen
        now = extract(self.eye.look(sample * dt, pose, sample + 1), self.camera)
        compared = compare(self.home, now, self.camera)
        azimuth = dict(zip(*_matched(compared, now), strict=True))
        for i, row in enumerate(self.landmarks.tolist()):
            if row in azimuth:
                bearings[i], seen[i] = azimuth[row], 1.0
        return bearings, seen


def draw_image_world(case: CaseName, settings: PaperSettings, run: int) -> PaperWorld:
    """Draw run number `run` of a case with a rendered room; arguments as for `draw_world`.

    Raises `InputError` when no room has enough landmarks in view.
    """
    drawn = _draw_sight(case, settings, run)
    eye, home, rows, moved = drawn.eye, drawn.home, drawn.landmarks, drawn.moved
    places = _places(eye, home, rows)
    true = np.arctan2(places[:, 1], places[:, 0])
    world = draw_world(case, settings, run)
    return replace(
        world,
        landmarks=places,
        faults=np.asarray(wrap(home.azimuth[rows] - true)),
        moved=moved,
        visible=np.zeros_like(world.visible),
        noise=np.zeros_like(world.noise),
        sight=drawn,
    )


def _draw_sight(case: CaseName, settings: PaperSettings, run: int) -> Sight:
    """Draw rooms until one has enough landmarks in view, including the case's moved ones.

    If no room has enough moved ones, the room with the most of them is used.
    """
    q, wanted = settings.printed.landmarks, fault_count(case, settings)
    every = max(1, round(1 / (settings.images.rate * settings.printed.sample_time)))
    start = from_polar(Polar(settings.printed.start_cm[0] / 100, *settings.printed.start_cm[1:]))
    best: Sight | None = None
    for attempt in range(TRIES):
        eye = Eye(_room(case, settings, (settings.seed * 1000 + run) * TRIES + attempt))
        camera, image = panorama_of(eye), as_grey(eye.home_picture())
        home, first = extract(image, camera), extract(eye.look(0.0, start, 1), camera)
        moved = _on_moved_boxes(eye, home)
        rows = _choose(compare(home, first, camera), home, moved, q, wanted)
        if rows.size == q and (best is None or moved[rows].sum() > best.moved.sum()):
            best = Sight(eye, camera, image, home, rows, moved[rows], every)
        if best is not None and best.moved.sum() == wanted:
            return best
    if best is None:
        raise InputError(
            f"none of {TRIES} rooms has {q} landmarks in view of home and start; use fewer"
        )
    return best


def _room(case: CaseName, settings: PaperSettings, seed: int) -> RenderScenario:
    """Return a square room with home in the middle, and the case's number of moved boxes."""
    R, theta, alpha = settings.printed.start_cm
    wanted, width = fault_count(case, settings), settings.images.width
    made = RenderScenario(
        name=f"case {case}",
        seed=seed,
        room=Walls(outline=((0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)), height=2.5),
        camera=RoomCamera(width=width, height=width // 4),
        home=RoomPose(x=SIDE / 2, y=SIDE / 2, heading=0.0),
        start=StartPose(R=R / 100, theta=theta, alpha=alpha, prior=False),
        trajectory=Homing(),
    )
    return with_boxes(made, max(6, wanted), pictures=6, moved=wanted, shift=(0.3, 0.9))


def _matched(compared: Comparison, now: Features) -> tuple[list[int], list[float]]:
    """Return the matched rows of the home features, and their azimuths now [rad]."""
    found = compared.agrees | compared.moved
    if not compared.accepted:
        found = np.zeros_like(found)
    return compared.home_row[found].tolist(), now.azimuth[compared.now_row[found]].tolist()


def _on_moved_boxes(eye: Eye, home: Features) -> np.ndarray:
    """Return which home features are on a box that has been moved since."""
    boxes = eye.scenario.boxes
    names = things_seen(eye, home)
    return np.array([n in boxes and boxes[n].stood is not None for n in names], bool)


def _choose(
    compared: Comparison, home: Features, moved: np.ndarray, q: int, wanted: int
) -> np.ndarray:
    """Choose q features matched from the start: some on moved boxes, the others spread out."""
    rows = np.unique(compared.home_row[compared.agrees | compared.moved])
    if not compared.accepted or rows.size < q:
        return rows[:0]
    chosen = rows[moved[rows]][:0]
    for pool, count in ((rows[moved[rows]], wanted), (rows[~moved[rows]], q)):
        for _ in range(count):
            left = np.setdiff1d(pool, chosen)
            if left.size and chosen.size < q:
                gaps = np.abs(wrap(home.azimuth[left][:, None] - home.azimuth[chosen]))
                # The next one is farthest from all chosen ones.
                nearest = gaps.min(axis=1) if chosen.size else -home.sigma[left]
                chosen = np.append(chosen, left[np.argmax(nearest)])
    return np.sort(chosen)


def _places(eye: Eye, home: Features, rows: np.ndarray) -> np.ndarray:
    """Return the landmark positions during the drive, (q, 2) in the home frame [m]."""
    view = eye.home_view
    surfaces = eye.then.surfaces
    rays = unit_vectors(home.azimuth[rows], home.elevation[rows])
    hits = trace(surfaces, view, rays)
    found = points(hits, view, rays)
    places = np.zeros((rows.size, 2))
    for i, (x, y, _) in enumerate(found.tolist()):
        place = Pose(x, y, 0.0)
        box = eye.scenario.boxes.get(eye.then.things[surfaces.thing[hits.surface[i]]])
        if box is not None and box.stood is not None:
            old, new = Pose(*box.stood.at, box.stood.yaw), Pose(*box.at, box.yaw)
            place = compose(new, between(old, place))
        local = between(eye.scenario.home.pose, place)
        places[i] = local.x, local.y
    return places
