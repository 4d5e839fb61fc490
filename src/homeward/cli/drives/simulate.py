"""`homeward simulate`: make a drive folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from homeward.cli.options import Changes, key_values, progress
from homeward.cli.terminal import say

if TYPE_CHECKING:
    from homeward.simulation.simulate import Simulation


def simulate(
    scenario: Annotated[
        str, typer.Argument(help="A preset (warehouse, paper-homing, circle) or a YAML file.")
    ],
    out: Annotated[Path, typer.Option(help="The drive folder to write.")],
    seed: Annotated[int | None, typer.Option(help="Another seed than the scenario's.")] = None,
    trajectory: Annotated[
        Literal["homing", "circle", "waypoints"] | None,
        typer.Option(help="Another trajectory than the scenario's."),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(help="Whose pose steers: truth, or as homeward run --estimator takes it."),
    ] = None,
    law: Annotated[
        str | None,
        typer.Option(
            help="By which law it drives home (homing trajectories alone): paper, lyapunov, alv, "
            "tron, or package.module:function."
        ),
    ] = None,
    changes: Changes = None,
) -> None:
    """Simulate a drive and write it as a drive folder.

    Beside the drive it writes scenario.yaml, which repeats the drive to the last bit, and
    world.csv, the truth about the landmarks.
    """
    from homeward.registry import make_estimator
    from homeward.report.output import check_output, whole_folder
    from homeward.simulation.files import SCENARIO, load_scenario, write_simulation
    from homeward.simulation.simulate import prepare
    from homeward.simulation.simulate import simulate as run_simulation

    options = {
        "seed": seed,
        "trajectory.kind": trajectory,
        "estimator": estimator,
        "trajectory.law": law,
    }
    given = {key: value for key, value in options.items() if value is not None}
    chosen = load_scenario(scenario, given | key_values(changes or []))
    prepared = prepare(chosen)
    steering = None if chosen.estimator == "truth" else make_estimator(chosen.estimator, prepared)
    check_output(out, SCENARIO)
    with progress(f"simulating {chosen.name}") as tell:
        simulation = run_simulation(chosen, steering, tell)
    with whole_folder(out, SCENARIO) as scratch:
        write_simulation(simulation, scratch)
    say(_summary(simulation, out))


def _summary(simulation: Simulation, out: Path) -> str:
    """Say in one line what was made."""
    drive, world = simulation.drive, simulation.world
    sightings, stamps = drive.sightings.t.size, len(set(drive.sightings.t.tolist()))
    return (
        f"{simulation.scenario.name}: {drive.span[1]:.1f} s, {drive.odometry.t.size} twists,"
        f" {sightings} sightings of {len(world.ids)} landmarks at {stamps} stamps,"
        f" {len(world.moved)} moved; ended ({simulation.ending.value})"
        f" {simulation.final_distance:.3f} m from home; written to {out}"
    )
