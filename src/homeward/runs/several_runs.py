"""Several estimators over one drive: one that fails ends nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from homeward.drives.drive import Drive
from homeward.errors import HomewardError, InputError
from homeward.runs.scoring import Metrics, score
from homeward.runs.single_run import RunSettings, finish, opened, ready
from homeward.track import Track


@dataclass(frozen=True)
class Outcome:
    """What came of one estimator."""

    run: RunSettings
    """With every setting spelt out."""
    drive: Drive
    """With the start prior that this estimator had."""
    track: Track | None
    """None where it failed."""
    failure: str = ""
    """Why."""

    @property
    def metrics(self) -> Metrics | None:
        """Of the track."""
        return None if self.track is None else score(self.track, self.drive.truth)


def run_several(
    runs: Sequence[RunSettings], progress: Callable[[float], None] | None = None
) -> list[Outcome]:
    """Run several estimators over one drive, which is opened once.

    Parameters
    ----------
    runs : sequence of RunSettings
        Alike but for their estimators, at least one.
    progress : callable, optional
        Told the fraction done, in [0, 1].

    Raises
    ------
    InputError
        When the drive cannot be used, two estimators are the same, or one cannot be made.
    """
    words = [run.estimator for run in runs]
    if twice := next((word for word in words if words.count(word) > 1), None):
        raise InputError(f"{twice}: named twice")
    drive = opened(runs[0])
    prepared = [ready(run, drive) for run in runs]
    outcomes = []
    for done, (told, estimator, complete) in enumerate(prepared):

        def tell(fraction: float, done: int = done) -> None:
            if progress is not None:
                progress((done + fraction) / len(runs))

        try:
            track = finish(told, estimator, complete, tell)
            outcomes.append(Outcome(complete, told, track))
        except HomewardError as error:
            outcomes.append(Outcome(complete, told, None, str(error)))
    return outcomes
