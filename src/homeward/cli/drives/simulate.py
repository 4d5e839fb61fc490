"""`homeward simulate`: make a drive folder."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from homeward.cli.options import AsJson, Changes, key_values, progress
from homeward.cli.terminal import answer, no_answer, say, warn
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.simulation.scenario import Scenario
    from homeward.simulation.simulate import Simulation


def simulate(
    scenario: Annotated[
        str, typer.Argument(help="A preset (warehouse, paper-homing, circle) or a YAML file.")
    ],
    out: Annotated[Path | None, typer.Option(help="The drive folder to write.")] = None,
    seed: Annotated[int | None, typer.Option(help="Another seed than the scenario's.")] = None,
    trajectory: Annotated[
        Literal["homing", "circle", "waypoints", "teach", "repeat"] | None,
        typer.Option(
            metavar="KIND",
            help="Another trajectory than the scenario's: homing, circle, waypoints, teach or "
            "repeat.",
        ),
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
    place: Annotated[
        str | None, typer.Option(help="To repeat: the place whose route it drives along.")
    ] = None,
    route: Annotated[str | None, typer.Option(help="To repeat: the name of the route.")] = None,
    live: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Write nothing, but be the robot of the homeward live that listens there.",
        ),
    ] = None,
    pace: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="With --live: so many times real time.")
    ] = 1.0,
    changes: Changes = None,
    json: AsJson = False,
) -> None:
    """Simulate a drive and write it as a drive folder.

    Beside the drive it writes scenario.yaml, which repeats the drive to the last bit, and
    world.csv, the truth about the landmarks.
    """
    from homeward.registry import make_estimator
    from homeward.report.output import check_output, whole_folder
    from homeward.simulation.files import SCENARIO, load_scenario, write_simulation
    from homeward.simulation.repeating import settled
    from homeward.simulation.simulate import prepare
    from homeward.simulation.simulate import simulate as run_simulation

    options = {
        "seed": seed,
        "trajectory.kind": trajectory,
        "estimator": estimator,
        "trajectory.law": law,
        "trajectory.place": place,
        "trajectory.route": route,
    }
    given = {key: value for key, value in options.items() if value is not None}
    chosen = settled(load_scenario(scenario, given | key_values(changes or [])))
    if (out is None) == (live is None):
        raise InputError("give one of --out and --live")
    if out is None and chosen.trajectory.kind == "repeat":
        raise InputError("--live repeats no route: what drives the robot is homeward live")
    if out is None:
        _play(chosen, live or "", pace, json)
        return
    prepared = prepare(chosen)
    steering = None if chosen.estimator == "truth" else make_estimator(chosen.estimator, prepared)
    check_output(out, SCENARIO)
    with progress(f"simulating {chosen.name}") as tell:
        simulation = run_simulation(chosen, steering, tell)
    with whole_folder(out, SCENARIO) as scratch:
        write_simulation(simulation, scratch)
    if json:
        answer(_facts(simulation, out))
    else:
        say(_summary(simulation, out))


def _play(scenario: Scenario, where: str, pace: float, json: bool) -> None:
    """Be a robot until it is home, or has given up."""
    from homeward.live.player import Player, play
    from homeward.live.server import address
    from homeward.simulation.live_robot import LiveRobot

    player = Player(LiveRobot(scenario), scenario.trajectory.duration)
    token = os.environ.get("HOMEWARD_TOKEN") or None
    asyncio.run(play(player, address(where), pace, token, lambda text: warn(text)))
    ending, robot = player.ending, player.robot
    state = "time up" if ending is None else f"{ending.state}: {ending.reason}"
    if json:
        told = {"scenario": scenario.name, "ending": state}
        answer({**told, "duration_s": robot.t, "from_home_m": robot.distance})
    else:
        end = f"{state}; truly {robot.distance:.3f} m from home after {robot.t:.1f} s"
        say(f"{scenario.name}: {end}")
    if ending is None or ending.state != "arrived":
        raise no_answer()


def _facts(simulation: Simulation, out: Path) -> dict[str, Any]:
    """Return for programs what was made, and how it ended."""
    drive, world = simulation.drive, simulation.world
    return {
        "summary": _summary(simulation, out),
        "scenario": simulation.scenario.name,
        "ending": simulation.ending.value,
        "reason": simulation.reason,
        "duration_s": drive.span[1],
        "from_home_m": simulation.final_distance,
        "twists": drive.odometry.t.size,
        "sightings": drive.sightings.t.size,
        "landmarks": world.ids,
        "moved": world.moved,
        "folder": out,
    }


def _summary(simulation: Simulation, out: Path) -> str:
    """Say in one line what was made."""
    drive, world = simulation.drive, simulation.world
    sightings, stamps = drive.sightings.t.size, len(set(drive.sightings.t.tolist()))
    ending = simulation.ending.value + (f": {simulation.reason}" if simulation.reason else "")
    return (
        f"{simulation.scenario.name}: {drive.span[1]:.1f} s, {drive.odometry.t.size} twists,"
        f" {sightings} sightings of {len(world.ids)} landmarks at {stamps} stamps,"
        f" {len(world.moved)} moved; ended ({ending})"
        f" {simulation.final_distance:.3f} m from home; written to {out}"
    )
