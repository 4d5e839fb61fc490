"""Connection to an MQTT broker (version 3.1.1)."""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from homeward.errors import InputError
from homeward.io.reading import read_small
from homeward.live.fleet.parcels import ROOT, STATE, digest, require_topic_name, split

PASSWORD = "HOMEWARD_MQTT_PASSWORD"
"""Environment variable with the password."""
PORTS = {"mqtt": 1883, "mqtts": 8883}
TIMEOUT_S = 20.0
"""Timeout for the broker's first answer [s]."""
KEEPALIVE_S = 10
"""A connection without an answer for 1.5 times this time is lost [s]."""
MIN_BACKOFF_S, MAX_BACKOFF_S = 1, 4
"""Time between attempts to connect [s]."""


@dataclass(frozen=True)
class Broker:
    """Address of a broker, and the account of a client."""

    url: str
    user: str
    """Also the name of the robot."""
    password: str | None = field(default=None, repr=False)
    authority: Path | None = None
    """File with the certificate of the authority that signed the broker's; None: the system's."""

    @property
    def where(self) -> tuple[str, int]:
        """Host and port; `InputError` where the address is not valid."""
        with contextlib.suppress(ValueError):
            parts = urlsplit(self.url)
            is_plain = not (parts.path or parts.query or parts.fragment or "@" in parts.netloc)
            if parts.scheme in PORTS and parts.hostname and is_plain:
                return parts.hostname, parts.port or PORTS[parts.scheme]
        raise InputError(f"{self.url}: must be mqtt://HOST:PORT, or mqtts://HOST:PORT with TLS")

    @property
    def is_encrypted(self) -> bool:
        """Whether the connection uses TLS."""
        return self.url.startswith("mqtts:")


def given_broker(
    url: str | None,
    user: str | None,
    password_file: Path | None = None,
    authority: Path | None = None,
) -> Broker | None:
    """Return a broker, if there is a `url`; the user is by default the name of this machine.

    The password is in a file, or in the environment variable `PASSWORD`.
    """
    if url is None:
        if user or password_file or authority:
            raise InputError("the user, password and certificate of a broker need --mqtt")
        return None
    password = os.environ.get(PASSWORD) or None
    if password_file is not None:
        password = read_small(password_file, 4096, "a password").decode(errors="replace").strip()
    name = require_topic_name("robot", user or socket.gethostname())
    broker = Broker(url, name, password, authority)
    _ = broker.where  # an invalid address gives an error at once
    return broker


class Connection:
    """Connection of a client to the topics of a place, in a thread of its own, until `close`.

    `on_message` receives the parts of a topic below that of the place, and the payload;
    `on_connected` is called whenever the connection is made, and `on_lost` with a reason when it is
    lost, all on that thread.
    """

    def __init__(
        self,
        broker: Broker,
        place: str,
        topics: Sequence[str],
        on_message: Callable[[list[str], bytes], None],
        on_connected: Callable[[], None] = lambda: None,
        on_lost: Callable[[str], None] = lambda _: None,
    ) -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self._base = f"{ROOT}/{require_topic_name('place', place)}"
        self._state = f"{self._base}/{STATE}/{broker.user}"
        self._topics, self._on_message = [f"{self._base}/{topic}" for topic in topics], on_message
        self._on_connected, self._on_lost = on_connected, on_lost
        self._answered, self._refused = threading.Event(), ""
        name = f"homeward {place} {broker.user}"
        self._client = client = Client(CallbackAPIVersion.VERSION2, name, clean_session=True)
        client.on_connect, client.on_disconnect = self._connected, self._disconnected
        client.on_message = self._receive
        client.reconnect_delay_set(MIN_BACKOFF_S, MAX_BACKOFF_S)
        client.will_set(self._state, b"offline", 1, True)
        if broker.password is not None or broker.is_encrypted:
            client.username_pw_set(broker.user, broker.password)
        where = broker.where
        try:
            if broker.is_encrypted:
                client.tls_set_context(ssl.create_default_context(cafile=broker.authority))
            client.connect(*where, keepalive=KEEPALIVE_S)
        except OSError as error:
            self.close()
            raise InputError(f"no MQTT broker at {broker.url}: {error}") from error
        client.loop_start()
        if not self._answered.wait(TIMEOUT_S) or self._refused:
            self.close()
            why = self._refused or "it does not answer"
            raise InputError(f"the MQTT broker at {broker.url} refuses {broker.user}: {why}")

    def publish(self, topic: str, payload: bytes) -> None:
        """Publish a retained message; an empty one deletes it."""
        self._client.publish(f"{self._base}/{topic}", payload, 1, True)

    def send(self, topic: str, content: bytes, before: int = 0) -> tuple[str, ...]:
        """Publish the parts of content, and delete those of earlier content with more parts.

        Return their digests; `before` is the number of parts before.
        """
        parts = split(content)
        for number, part in enumerate(parts):
            self.publish(f"{topic}/{number}", part)
        for number in range(len(parts), before):
            self.publish(f"{topic}/{number}", b"")
        return tuple(map(digest, parts))

    def close(self) -> None:
        """End the connection, after all published messages are sent."""
        if self._client.is_connected():
            last = self._client.publish(self._state, b"offline", 1, True)
            with contextlib.suppress(RuntimeError, ValueError):  # disconnected meanwhile
                last.wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()
        self._client._reset_sockets()  # otherwise only when the garbage collector finds it

    def _connected(self, client: Any, _: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._refused = str(reason)
            if not self._answered.is_set():
                self._answered.set()
            else:
                self._on_lost(self._refused)
            return
        client.publish(self._state, b"online", 1, True)
        self._on_connected()
        client.subscribe([(topic, 1) for topic in self._topics])
        self._answered.set()

    def _disconnected(self, client: Any, _: Any, flags: Any, reason: Any, properties: Any) -> None:
        if self._answered.is_set() and reason.is_failure:
            self._on_lost(str(reason))

    def _receive(self, client: Any, _: Any, message: Any) -> None:
        self._on_message(message.topic[len(self._base) + 1 :].split("/"), message.payload)
