"""`homeward live`: localise a robot while it drives, over JSON lines."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import (
    Authority,
    Changes,
    Mqtt,
    PasswordFile,
    key_values,
    no_answer,
    refuse,
    say,
)
from homeward.errors import InputError


def live(
    tcp: Annotated[
        str | None,
        typer.Option(metavar="[HOST:]PORT", help="TCP port for JSON lines; 0: any port."),
    ] = None,
    websocket: Annotated[
        str | None, typer.Option(metavar="[HOST:]PORT", help="WebSocket port (needs extra live).")
    ] = None,
    home: Annotated[Path | None, typer.Option(help="A home.csv with the home bearings.")] = None,
    robot_file: Annotated[
        Path | None,
        typer.Option(help="The robot.yaml of homeward tune, or a drive.yaml with a start prior."),
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|NAME",
            help="Saved map (place), which may be new with --update; with --mqtt, its name.",
        ),
    ] = None,
    mqtt: Mqtt = None,
    user: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Account at the broker, the name of the robot [$HOST]."),
    ] = None,
    password_file: PasswordFile = None,
    ca: Authority = None,
    update: Annotated[
        bool, typer.Option("--update", help="Merge the session into the place at its end.")
    ] = False,
    record: Annotated[
        Path | None, typer.Option(help="Record the session in this folder, as a drive folder.")
    ] = None,
    replay: Annotated[
        Path | None,
        typer.Option(help="Repeat the session.jsonl of a recording, and compare all answers."),
    ] = None,
    observe_token: Annotated[
        str | None,
        typer.Option(
            envvar="HOMEWARD_OBSERVE_TOKEN",
            show_envvar=False,
            help="Token of clients that may only read [an environment variable].",
        ),
    ] = None,
    release_stop: Annotated[
        bool,
        typer.Option("--release-stop", help="Release an emergency stop of an earlier session."),
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of all messages and exit.")
    ] = False,
    changes: Changes = None,
) -> None:
    """Localise a robot while it drives, and drive it home: JSON lines in, JSON lines out.

    Uses stdin and stdout, or the ports of --tcp and --websocket. Without HOST, only this machine
    can connect; with HOST, every client must send hello with the token of the environment variable
    HOMEWARD_TOKEN, or to read that of HOMEWARD_OBSERVE_TOKEN. The broker's password may be in
    HOMEWARD_MQTT_PASSWORD. Ends with stdin, Ctrl-C or SIGTERM. docs/do/live.md describes the
    messages.
    """
    from homeward.drives.folder import read_home
    from homeward.drives.settings import DriveSettings
    from homeward.io.settings import nested, read_settings, validated
    from homeward.live.fleet.connection import given_broker
    from homeward.live.fleet.robot import join_place
    from homeward.live.messages import schema as everything
    from homeward.live.recording import Recorder
    from homeward.live.recording import replay as repeat
    from homeward.live.server import Server, address, given_token, stop_file
    from homeward.live.session import Session
    from homeward.live.settings import LiveSettings

    if schema:
        typer.echo(json.dumps(everything(), indent=1))
        return
    given = key_values(changes or [])
    if replay is not None:
        same, other = repeat(replay, (str(given.get("estimator")),))
        if other is not None:
            refuse(f"answer {same + 1} differs from the recording: {other}")
            raise no_answer()
        say(f"{same:,} answers, all equal to the last bit")
        return
    settings = validated(LiveSettings, nested(given))
    known = DriveSettings() if robot_file is None else read_settings(robot_file, DriveSettings)
    homes = {} if home is None else {"home": read_home(home, {})}
    at_tcp, at_websocket = (None if text is None else address(text) for text in (tcp, websocket))
    if observe_token is not None and given_token() is None:
        raise InputError("--observe-token needs the token of the other clients in HOMEWARD_TOKEN")
    if update and place is None:
        raise InputError("--update needs --place")
    broker = given_broker(mqtt, user, password_file, ca)
    if broker is not None and place is None:
        raise InputError("--mqtt needs --place")
    visited = None if place is None else join_place(place, update, settings.estimator, broker)
    session = Session(settings, known, homes, visited)
    # After the session: a session that cannot begin must leave no folder.
    recorder = None if record is None else Recorder(record, settings, known, homes, visited)
    if recorder is not None:
        session.watch(recorder.keep)
    stop = stop_file(*filter(None, (at_tcp, at_websocket)))
    if release_stop and stop is not None:
        stop.unlink(missing_ok=True)
    server = Server(session, given_token(), observe_token, stop)

    def opened(ports: list[int]) -> None:
        typer.echo(f"listening on port {' and '.join(map(str, ports))}", err=True)

    stdio = at_tcp is None and at_websocket is None
    try:
        asyncio.run(server.serve(at_tcp, at_websocket, stdio, None if stdio else opened))
    finally:
        try:
            if recorder is not None and (words := recorder.close()) is not None:
                typer.echo(words, err=True)
        finally:  # a recording that cannot be ended must not cost the visit
            if (words := session.localisation.finalise()) is not None:
                typer.echo(words, err=True)
