"""The runs of the gate, in processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed

from benchmarks.consistency.measures import Figures, figures
from benchmarks.consistency.sabotage import SABOTAGES
from benchmarks.consistency.scenarios import SCENARIOS
from homeward.localizer.localizer import Localizer
from homeward.track import run

AS_IT_IS = "as it is"
"""The estimator without sabotage."""
Results = dict[str, dict[str, list[Figures]]]
"""Figures by sabotage, scenario and seed."""


def one(scenario: str, seed: int, sabotages: Sequence[str] = ()) -> dict[str, Figures]:
    """Run the localiser on one drive of a scenario; return its figures, and those of sabotage."""
    named = SCENARIOS[scenario]
    trial = named.make(named.first + seed)
    track = run(trial.drive, Localizer(trial.drive.home, **trial.drive.settings.robot))
    spoilt = {name: SABOTAGES[name].of(track) for name in sabotages}
    return {name: figures(t, trial) for name, t in {AS_IT_IS: track, **spoilt}.items()}


def every(
    scenarios: Sequence[str],
    seeds: int,
    sabotages: Sequence[str] = (),
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Results:
    """Run each scenario so often.

    Parameters
    ----------
    scenarios : sequence of str
        Their names.
    seeds : int
        Drives of each.
    sabotages : sequence of str
        To be measured on the same drives.
    jobs : int
        Processes.
    progress : callable
        Told how many runs are done, and of how many.
    """
    work = [(scenario, seed) for seed in range(seeds) for scenario in scenarios]
    found: dict[tuple[str, int], dict[str, Figures]] = {}
    with ProcessPoolExecutor(jobs) as pool:
        running = {pool.submit(one, *job, sabotages): job for job in work}
        for future in as_completed(running):
            found[running[future]] = future.result()
            progress(len(found), len(work))
    return {
        sabotage: {s: [found[s, k][sabotage] for k in range(seeds)] for s in scenarios}
        for sabotage in (AS_IT_IS, *sabotages)
    }
