"""The runs of the gate."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.consistency.measures import FIGURES, Figures, figures
from benchmarks.consistency.sabotage import SABOTAGES
from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.monte_carlo import Run, grid, run_all
from homeward.localizer.localizer import Localizer
from homeward.track import run

AS_IT_IS = "as it is"  # the estimator without sabotage
Results = dict[str, dict[str, list[Figures]]]  # figures by sabotage, scenario and seed


def one(scenario: str, seed: int, sabotages: Sequence[str] = ()) -> dict[str, Figures]:
    """Run the localiser on one drive of a scenario; return its figures, and those of sabotages."""
    trial = SCENARIOS[scenario].drive(seed)
    track = run(trial.drive, Localizer(trial.drive.home, **trial.drive.settings.robot))
    spoilt = {name: SABOTAGES[name].of(track) for name in sabotages}
    return {name: figures(t, trial) for name, t in {AS_IT_IS: track, **spoilt}.items()}


def _measured(sabotages: Sequence[str], run: Run) -> dict[str, float | None]:
    found = one(run.scenario, run.seed, sabotages)
    return {f"{which} {name}": v for which, all_ in found.items() for name, v in all_.items()}


def every(
    scenarios: Sequence[str],
    seeds: int,
    sabotages: Sequence[str] = (),
    jobs: int = 1,
    keep: Path | None = None,
) -> Results:
    """Run each scenario with `seeds` seeds; arguments as for `run_all`."""
    runs = grid(scenarios, ["robust"], range(seeds))
    found = run_all(partial(_measured, sabotages), runs, jobs, keep, sabotages=list(sabotages))
    return {
        which: {
            s: [
                {name: one[f"{which} {name}"] for name in FIGURES}
                for run, one in found.items()
                if run.scenario == s
            ]
            for s in scenarios
        }
        for which in (AS_IT_IS, *sabotages)
    }
