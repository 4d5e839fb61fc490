"""`homeward place`: inspect or edit a saved map (place)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from homeward.cli.drives.add import add
from homeward.cli.options import AsJson, Authority, Mqtt, PasswordFile, say, show
from homeward.errors import InputError
from homeward.io.table import quoted

if TYPE_CHECKING:
    from homeward.places.place import Place

OTHER_NAMES = {
    other: command
    for command, others in {
        "info": "list ls print show",
        "add": "create new update visit",
        "forget": "delete remove rm",
        "view": "map page plot",
    }.items()
    for other in others.split()
}
"""Names that other programs have for commands of a place."""


class PlaceCommands(TyperGroup):
    """Commands of a place, each with its whole first paragraph in the help."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for a name of other programs, raise an error with the right one."""
        if name := OTHER_NAMES.get(cmd_name):
            raise InputError(
                f"homeward place {cmd_name} is not a command; use `homeward place {name}`"
            )
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with a sentence for each."""
        rows = [
            (name, " ".join((command.help or "").partition("\n\n")[0].split()))
            for name, command in self.commands.items()
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


place = typer.Typer(cls=PlaceCommands, no_args_is_help=True, rich_markup_mode=None)
Folder = Annotated[Path, typer.Argument(metavar="PLACE", help="The folder of the place.")]


@place.callback()
def about() -> None:
    """Inspect or edit a saved map (place)."""


place.command()(add)


@place.command()
def info(folder: Folder, json: AsJson = False) -> None:
    """Print the landmarks, homes, routes and visits of a place."""
    from homeward.live.fleet.merging import records, robot_lines
    from homeward.places.files import load_place
    from homeward.runs.report.place_words import info_lines

    found, robots = load_place(folder), records(folder)
    facts = _facts(found) | {"robots": {n: r.model_dump() for n, r in robots.items()}}
    show(json, facts, *info_lines(found), *robot_lines(robots))


def _facts(place: Place) -> dict[str, Any]:
    """Return a place at its last visit as plain values."""
    when = place.when
    stays, usual = place.stays(when), place.usual_rate
    return {
        "name": place.name,
        "when": when,
        "moves_per_day": usual,
        "landmarks": [
            {"landmark": n, "x": x, "y": y, "stays": stays[n], "moved": place.persistence[n].moved}
            for n, (x, y) in zip(place.map.names, place.map.positions.tolist(), strict=True)
        ],
        "homes": [
            {
                "home": home,
                **place.home_pose(home)._asdict(),
                "sigma_m": place.home_sigma(home, when),
                "stored": stored.stored,
            }
            for home, stored in place.homes.items()
        ],
        "routes": [
            {"route": name, "length_m": route.length, "waypoints": len(route.waypoints)}
            for name, route in place.routes.items()
        ],
        "visits": [asdict(visit) for visit in place.visits],
    }


@place.command()
def view(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="The page to write [out/NAME OF THE PLACE.html].")
    ] = None,
) -> None:
    """Write a page with the map of a place and its changes over the visits."""
    from homeward.places.files import load_place
    from homeward.runs.report.place_page import write_page

    file = out or Path("out") / f"{folder.resolve().name}.html"
    write_page(file, load_place(folder))
    say(f"Page: {file}")


@place.command()
def align(
    folder: Folder,
    survey: Annotated[
        Path, typer.Argument(help="landmarks.yaml with their positions in the other map.")
    ],
    json: AsJson = False,
) -> None:
    """Print the pose of a place's first home in another map, such as an occupancy map."""
    from homeward.drives.landmarks import KnownLandmarks
    from homeward.io.settings import read_settings
    from homeward.places.alignment import align_place
    from homeward.places.files import load_place
    from homeward.runs.report.place_words import alignment_lines

    found = align_place(load_place(folder), read_settings(survey, KnownLandmarks), survey)
    position, heading = found.sigmas
    facts = {
        "home_in_map": found.home,
        "sigma_m": position,
        "sigma_heading": heading,
        "residuals_m": found.residuals,
    }
    show(json, facts, *alignment_lines(found))


@place.command()
def merge(
    folder: Folder,
    other: Annotated[Path, typer.Argument(help="Another robot's place of the same room.")],
) -> None:
    """Merge another robot's place of the same room into a place."""
    from homeward.places.files import load_place, update_place
    from homeward.places.visiting import merged_places
    from homeward.runs.report.place_words import visit_words

    added = load_place(other)
    now, _ = update_place(folder, lambda known: merged_places(known, added))
    say(visit_words(now))


@place.command()
def forget(
    folder: Folder,
    landmarks: Annotated[list[str] | None, typer.Argument(help="Ids to remove.")] = None,
    home: Annotated[list[str] | None, typer.Option(help="A home to remove; repeatable.")] = None,
    route: Annotated[list[str] | None, typer.Option(help="A route to remove; repeatable.")] = None,
) -> None:
    """Remove landmarks, homes or routes from a place."""
    from homeward.places.files import update_place
    from homeward.runs.report.place_words import forget_words

    now, _ = update_place(folder, lambda p: p.without(landmarks or [], home or [], route or []))
    say(forget_words(now))


@place.command()
def undo(folder: Folder) -> None:
    """Undo the last change of a place."""
    from homeward.places.files import undo as go_back

    say(f"The place is version {go_back(folder)} again.")


@place.command()
def serve(
    folder: Folder,
    mqtt: Mqtt = None,
    user: Annotated[str, typer.Option(metavar="NAME", help="Account at the broker.")] = "merger",
    password_file: PasswordFile = None,
    ca: Authority = None,
    ignore: Annotated[
        list[str] | None, typer.Option(metavar="ROBOT", help="Ignore a robot; repeatable.")
    ] = None,
) -> None:
    """Share a place between live sessions, and merge their visits while they drive.

    They meet at an MQTT broker, whose configuration homeward place broker-config prints. Sessions
    join with homeward live --place NAME --mqtt URL. Ends with Ctrl-C or SIGTERM.
    """
    import signal
    import threading

    from homeward.live.fleet.connection import given_broker
    from homeward.live.fleet.merger import Merger
    from homeward.live.fleet.merging import SharedPlace

    broker = given_broker(mqtt, user, password_file, ca) if mqtt is not None else None
    if broker is None:
        raise InputError(
            "a place is shared by an MQTT broker: homeward place serve PLACE --mqtt mqtt://HOST;"
            " homeward place broker-config PLACE --robots A,B prints the broker's configuration"
        )
    ended = threading.Event()
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, lambda *_: ended.set())
    merger = Merger(SharedPlace(folder, tuple(ignore or ())), broker, say)
    merger.run(ended, lambda: say(f"the place {quoted(merger.name)} is at {broker.url}"))


@place.command()
def broker_config(
    name: Annotated[str, typer.Argument(metavar="PLACE", help="The name of the place.")],
    robots: Annotated[str, typer.Option(metavar="A,B,...", help="The names of the robots.")],
    merger: Annotated[str, typer.Option(metavar="NAME", help="Account of the merger.")] = "merger",
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write its files into this folder.")
    ] = None,
) -> None:
    """Print a configuration of the broker mosquitto for a fleet: TLS, accounts, access control."""
    from homeward.io.writing import write_whole
    from homeward.live.fleet.broker_config import broker_files, commands

    folder = Path("/etc/mosquitto/homeward") if out is None else out.absolute()
    accounts = robots.split(",")
    for file, text in broker_files(name, merger, accounts, folder).items():
        if out is None:
            typer.echo(f"# --- {folder / file}\n{text}")
        else:
            write_whole(out / file, text.encode())
    typer.echo(commands(name, merger, accounts, folder))
