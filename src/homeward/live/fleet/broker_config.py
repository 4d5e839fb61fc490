"""Configuration of the broker mosquitto for a fleet: TLS, accounts, and access control by topic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from homeward.errors import InputError
from homeward.live.fleet.parcels import (
    ACK,
    CHANGE,
    MANIFEST,
    MAP,
    ROOT,
    STATE,
    VISIT,
    require_topic_name,
)

CONF, ACL, PASSWORDS = "mosquitto.conf", "acl", "passwords"
_CONF = """\
# mosquitto -c {folder}/mosquitto.conf
listener 8883
cafile {folder}/ca.crt
certfile {folder}/server.crt
keyfile {folder}/server.key
allow_anonymous false
password_file {folder}/passwords
acl_file {folder}/acl
max_connections {connections}
# A part of a visit or map, with its topic.
message_size_limit 262144
max_queued_messages 2000
# Retained messages survive a restart; robots and merger send again what the broker lost.
persistence true
persistence_location {folder}/
autosave_interval 30
"""
_COMMANDS = """\
# Once, in {folder}: an authority and a certificate for the broker's host name, and the passwords.
openssl req -x509 -newkey rsa:3072 -nodes -days 3650 -subj /CN=homeward-fleet \\
  -keyout ca.key -out ca.crt
openssl req -newkey rsa:3072 -nodes -subj /CN=BROKER -keyout server.key -out server.csr
printf 'subjectAltName=DNS:BROKER' > names
openssl x509 -req -days 3650 -in server.csr -CA ca.crt -CAkey ca.key -CAcreateserial \\
  -extfile names -out server.crt
touch passwords
{passwords}
# Then, with HOMEWARD_MQTT_PASSWORD or --password-file on each machine, and ca.crt:
homeward place serve {place} --mqtt mqtts://BROKER --user {merger} --ca ca.crt
homeward live --tcp 7707 --place {place} --update --mqtt mqtts://BROKER --user {robot} --ca ca.crt
"""


def broker_files(place: str, merger: str, robots: Sequence[str], folder: Path) -> dict[str, str]:
    """Return the files of a configuration by name, for a folder; `InputError` for wrong names."""
    require_topic_name("place", place)
    for name in (merger, *robots):
        require_topic_name("robot", name)
    if len({merger, *robots}) <= len(robots):
        raise InputError("the names of the merger and of the robots must be different")
    base = f"{ROOT}/{place}"
    rules = [
        f"user {merger}",
        f"topic readwrite {base}/{MANIFEST}",
        *(f"topic readwrite {base}/{topic}/#" for topic in (MAP, CHANGE, ACK, STATE)),
        f"topic read {base}/{VISIT}/#",
    ]
    for robot in robots:
        rules += [
            "",
            f"user {robot}",
            f"topic read {base}/{MANIFEST}",
            *(f"topic read {base}/{topic}/#" for topic in (MAP, CHANGE)),
            f"topic read {base}/{ACK}/{robot}",
            f"topic write {base}/{VISIT}/{robot}/#",
            f"topic write {base}/{STATE}/{robot}",
        ]
    connections = 2 * (len(robots) + 1)
    return {
        CONF: _CONF.format(folder=folder, connections=connections),
        ACL: "\n".join(rules) + "\n",
    }


def commands(place: str, merger: str, robots: Sequence[str], folder: Path) -> str:
    """Return the commands that complete a configuration."""
    passwords = "\n".join(f"mosquitto_passwd passwords '{name}'" for name in (merger, *robots))
    return _COMMANDS.format(
        folder=folder, passwords=passwords, place=place, merger=merger, robot=robots[0]
    )
