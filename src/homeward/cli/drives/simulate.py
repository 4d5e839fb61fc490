"""`homeward simulate`: simulate a drive, or render the images of a drive through a room."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from homeward.cli.options import AsJson, Changes, key_values, no_answer, progress, say, show, warn
from homeward.errors import InputError
from homeward.io.naming import command

if TYPE_CHECKING:
    from homeward.drives.drive import Drive
    from homeward.estimator import Estimator
    from homeward.lab.simulation.render.room.settings import RenderScenario
    from homeward.lab.simulation.scenario import Scenario
    from homeward.lab.simulation.simulate import Simulation


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            help="A preset (warehouse, paper-homing, circle; with --images: living-room), or a "
            "YAML file."
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="The drive folder to write.")] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed [the scenario's].")] = None,
    trajectory: Annotated[
        Literal["homing", "circle", "waypoints", "teach", "repeat"] | None,
        typer.Option(
            metavar="KIND",
            help="Trajectory [the scenario's]: homing, circle, waypoints, teach or repeat.",
        ),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(help="Estimator whose pose steers the robot, or truth (ground truth)."),
    ] = None,
    law: Annotated[
        str | None,
        typer.Option(
            help="Control law of homing trajectories: paper, lyapunov, alv, tron, or "
            "package.module:function."
        ),
    ] = None,
    place: Annotated[
        str | None, typer.Option(help="For repeat: the place with the route to follow.")
    ] = None,
    route: Annotated[
        str | None, typer.Option(help="For repeat, and for teach with --live: name of the route.")
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Write nothing; connect as a simulated robot to homeward live at this port.",
        ),
    ] = None,
    pace: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="With --live: speed relative to real time.")
    ] = 1.0,
    images: Annotated[
        bool, typer.Option("--images", help="Render the camera images of a drive through a room.")
    ] = False,
    changes: Changes = None,
    json: AsJson = False,
) -> None:
    """Simulate a drive and write it as a drive folder.

    It also writes scenario.yaml, which repeats the drive to the last bit, and world.csv, the ground
    truth of the landmarks. With --images it writes home.png, images.csv and the images,
    images.yaml, things.csv with the objects moved since the home image, and scenario.yaml; if also
    --estimator robust, the images steer the robot home, and drive/ contains the sightings.
    """
    from homeward.io.writing import check_output, whole_folder
    from homeward.lab.simulation.simulate import SCENARIO, load_scenario, prepare, write_simulation
    from homeward.lab.simulation.simulate import simulate as run_simulation
    from homeward.lab.simulation.trajectories import settled
    from homeward.registry import make_estimator

    if (out is None) == (live is None):
        raise InputError("give either --out FOLDER or --live [HOST:]PORT")
    drive = {"trajectory": trajectory, "law": law, "place": place, "route": route}
    if images:
        if wrong := [name for name, value in ({"live": live} | drive).items() if value is not None]:
            raise InputError(
                f"--{wrong[0]} does not work with --images; set the trajectory with --set"
            )
        estimators = {"estimator": estimator} if estimator else {}
        render(scenario, cast(Path, out), seed, key_values(changes or []) | estimators)
        return
    if live is not None:  # the server has the place and its routes
        if place is not None:
            raise InputError("--live takes no --place; give it to homeward live")
        if (route is not None) != (trajectory in ("teach", "repeat")):
            raise InputError("--live needs --route NAME with --trajectory teach or repeat only")
        del drive["route"]
        if trajectory == "repeat":
            del drive["trajectory"]
    options: dict[str, Any] = {"seed": seed, "estimator": estimator}
    options |= {f"trajectory.{'kind' if k == 'trajectory' else k}": v for k, v in drive.items()}
    given = {key: value for key, value in options.items() if value is not None}
    chosen = settled(load_scenario(scenario, given | key_values(changes or [])))
    if live is not None:
        if chosen.trajectory.kind == "repeat":
            raise InputError(
                "--live cannot repeat the scenario's own place; give --trajectory repeat --route"
                " NAME"
            )
        _play(chosen, live, pace, json, route, teach=trajectory == "teach")
        return
    assert out is not None
    prepared = prepare(chosen)
    steering = None if chosen.estimator == "truth" else make_estimator(chosen.estimator, prepared)
    check_output(out, SCENARIO)
    with progress(f"simulating {chosen.name}") as on_progress:
        simulation = run_simulation(chosen, steering, on_progress)
    with whole_folder(out, SCENARIO) as scratch:
        write_simulation(simulation, scratch)
    show(json, _facts(simulation, out), _summary(simulation, out), f"Next: {command('run', out)}")


def _play(
    scenario: Scenario, where: str, pace: float, json: bool, route: str | None, teach: bool
) -> None:
    """Simulate a robot for `homeward live` until its task has succeeded or failed."""
    from homeward.lab.simulation.live_robot import LiveRobot, SimulatedRobotClient, Task, play
    from homeward.lab.simulation.trajectories import make_control
    from homeward.live.messages import FollowRoute, StoreRoute
    from homeward.live.server import address

    task: Task | None = None
    if route is not None:
        task = StoreRoute(name=route) if teach else FollowRoute(name=route)
    hand = partial(make_control, scenario) if teach else None
    player = SimulatedRobotClient(LiveRobot(scenario), scenario.trajectory.duration, task, hand)
    token = os.environ.get("HOMEWARD_TOKEN") or None
    asyncio.run(play(player, address(where), pace, token, warn))
    state, robot = player.summary or "time up", player.robot
    end = f"{state}; true distance from home {robot.distance:.3f} m after {robot.t:.1f} s"
    facts = {"scenario": scenario.name, "ending": state, "duration_s": robot.t}
    show(json, facts | {"from_home_m": robot.distance}, f"{scenario.name}: {end}")
    if not player.succeeded:
        raise no_answer()


def _facts(simulation: Simulation, out: Path) -> dict[str, Any]:
    """Return the facts of a simulation as plain values."""
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
    """Return the summary of a simulation in one line."""
    drive, world = simulation.drive, simulation.world
    sightings, stamps = drive.sightings.t.size, len(set(drive.sightings.t.tolist()))
    ending = simulation.ending.value + (f": {simulation.reason}" if simulation.reason else "")
    return (
        f"{simulation.scenario.name}: {drive.span[1]:.1f} s, {drive.odometry.t.size} twists,"
        f" {sightings} sightings of {len(world.ids)} landmarks at {stamps} stamps,"
        f" {len(world.moved)} moved; ended ({ending})"
        f" {simulation.final_distance:.3f} m from home; written to {out}"
    )


def render(room: str, out: Path, seed: int | None, given: dict[str, Any]) -> None:
    """Render the camera images of a drive through a room, and write an image data set."""
    from homeward.io.writing import check_output, whole_folder
    from homeward.lab.simulation.render.drive import Eye, moved_boxes, write_rendered
    from homeward.lab.simulation.render.room.settings import load_room
    from homeward.lab.simulation.simulate import SCENARIO
    from homeward.runs.report.words import describe_moved

    scenario = load_room(room, seed, given)
    eye = Eye(scenario)
    check_output(out, SCENARIO)
    title = f"rendering {scenario.name}"
    with progress(title) as on_progress, whole_folder(out, SCENARIO) as scratch:
        made = write_rendered(eye, scratch, _maker(scenario), on_progress)
    camera = made.eye.scenario.camera
    moved = moved_boxes(made.eye)
    say(
        f"{scenario.name}: {made.drive.span[1]:.1f} s, {made.images} images of "
        f"{camera.width}x{camera.height}, {len(moved)} boxes moved since home; ended "
        f"({made.ending.value}) {made.final_distance:.3f} m from home; written to {out}"
    )
    say(describe_moved(moved))
    say(f"Next: {command('run', out)}")


def _maker(scenario: RenderScenario) -> Callable[[Drive], Estimator] | None:
    """Return the factory of the steering estimator, or None if ground truth steers."""
    if scenario.estimator == "truth":
        return None
    from homeward.registry import make_estimator

    return partial(make_estimator, scenario.estimator)
