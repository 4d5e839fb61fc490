"""The lifecycle node: a live session on the topics of ROS 2.

Callbacks take samples in and return at once; the estimator works in a thread of its own, and
answers are published from there. Watchdogs and commands go by the steady clock, stamps by ROS's.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

from homeward.drives.folder import read_home
from homeward.drives.ros.measurements.extrinsics import TF_STATIC
from homeward.drives.ros.messages.stamps import NANO
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError, InputError
from homeward.geometry.frames import Pose
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.settings import read_settings, validated
from homeward.live import messages as msg
from homeward.live.recording import Recorder
from homeward.live.session import Session
from homeward.live.settings import LiveSettings
from homeward.live.visiting import open_place
from homeward.ros import conversions as convert
from homeward.ros.camera import MessageCamera, Newest
from homeward.ros.conversions import JSON, TFS, Publishers

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of what was said once, before anybody listened."""
PARAMETERS: dict[str, Any] = {
    "odometry_topic": "odom",
    "bearings_topic": "bearings",
    "bearings_type": "geometry_msgs/msg/PoseArray",
    "bearings_axes": "",
    "bearing_sigma": 0.0,
    "tags": "36h11",
    "camera": "",
    "camera_info_topic": "",
    "rectified": False,
    "camera_frame": "",
    "base_frame": "base_link",
    "scan_topic": "",
    "scan_half_angle": 0.35,
    "cmd_vel_topic": "cmd_vel",
    "cmd_vel_stamped": False,
    "map_frame": "map",
    "odom_frame": "odom",
    "home": "",
    "place": "",
    "place_update": False,
    "robot": "",
    "session": "",
    "record": "",
    "autostart": True,
}
"""With their defaults; docs/do/live.md says what they are."""
NAMED: dict[str, Any] = {
    "store_home": msg.StoreHome,
    "turn_home": msg.TurnHome,
    "go_home": msg.GoHome,
    "store_route": msg.StoreRoute,
    "follow_route": msg.FollowRoute,
}
"""What is asked for with a name, by topic."""
DONE, FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class HomewardNode(LifecycleNode):  # type: ignore[misc]
    """homeward on a robot."""

    def __init__(self, name: str = "homeward", **options: Any) -> None:
        super().__init__(name, **options)
        for parameter, default in PARAMETERS.items():
            self.declare_parameter(parameter, default)
        self._session: Session | None = None
        self._recorder: Recorder | None = None
        self._parts: list[tuple[Any, Any]] = []
        self._say = Publishers(self)
        self._worker: threading.Thread | None = None
        self._work, self._running = threading.Event(), False
        self._camera: MessageCamera | None = None
        self._pictures: Newest[msg.BearingsIn] | None = None
        self._stamps = convert.StampConverter()
        self._map_to_odom: Pose | None = None
        self._complained = ""

    def on_configure(self, state: Any) -> Any:
        """Read what the parameters name, and make the session."""
        told = self._told
        try:
            settings, robot, homes = LiveSettings(), DriveSettings(), {}
            if told("session"):
                settings = read_settings(Path(told("session")), LiveSettings)
            if told("robot"):
                robot = read_settings(Path(told("robot")), DriveSettings)
            if told("home"):
                homes["home"] = read_home(Path(told("home")), {})
            self._camera = MessageCamera({name: told(name) for name in PARAMETERS})
            place = None
            if told("place_update") and not told("place"):
                raise InputError("place_update needs a place")
            if told("place"):
                place = open_place(Path(told("place")), told("place_update"), settings.estimator)
            self._session = Session(settings, robot, homes, place)
            if told("record"):
                self._recorder = Recorder(Path(told("record")), settings, robot, homes, place)
                self._session.watch(self._recorder.keep)
            self._say.make()
        except (HomewardError, ImportError) as error:
            missing = "; its ROS package is not installed, or ROS's setup.bash was not sourced"
            self.get_logger().error(f"{error}{missing if isinstance(error, ImportError) else ''}")
            self._clean()
            return FAILED
        return DONE

    @property
    def _live(self) -> Session:
        """The session, which is there from configuring to cleaning up."""
        assert self._session is not None
        return self._session

    def on_activate(self, state: Any) -> Any:
        """Listen, and let the estimator work."""
        self._listen()
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        for period, act in ((1 / self._live.settings.rate, self._tick), (1.0, self._tell)):
            timer = self.create_timer(period, act, clock=steady)
            self._parts.append((self.destroy_timer, timer))
        self._running = True
        self._worker = threading.Thread(target=self._process, daemon=True)
        self._worker.start()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> Any:
        """Command the robot to stand, if it was driving home, and listen no more."""
        if self._live.driving:
            self._live.receive(msg.Cancel(), time.monotonic())
            self._tick()
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: Any) -> Any:
        """Forget the session."""
        self._clean()
        return DONE

    def on_shutdown(self, state: Any) -> Any:
        """Stop whatever runs."""
        self._stop()
        self._clean()
        return DONE

    def _told(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _listen(self) -> None:
        """Subscribe, and offer services."""
        told, camera = self._told, self._camera
        assert camera is not None
        hear = self._line if camera.kind == JSON else self._bearings
        if camera.takes_pictures:
            seen = self.create_guard_condition(self._guarded(self._seen))
            self._parts.append((self.destroy_guard_condition, seen))
            self._pictures, hear = Newest(seen.trigger), self._picture
        topics: list[tuple[str, str, Callable[[Any], None]]] = [
            ("nav_msgs/msg/Odometry", told("odometry_topic"), self._odometry),
            (camera.kind, told("bearings_topic"), hear),
            ("geometry_msgs/msg/PoseWithCovarianceStamped", "/initialpose", self._start),
            (JSON, "~/request", self._line),
        ]
        topics += [(JSON, f"~/{topic}", self._named(asked)) for topic, asked in NAMED.items()]
        if told("camera_info_topic"):
            topics.append(("sensor_msgs/msg/CameraInfo", told("camera_info_topic"), camera.info))
        if told("scan_topic"):
            topics.append(("sensor_msgs/msg/LaserScan", told("scan_topic"), self._scan))
        if camera.awaits_mount:
            topics.append((TFS, TF_STATIC, self._mount))
        for kind, topic, callback in topics:
            guarded = self._guarded(callback)
            quality = LATCHED if topic == TF_STATIC else qos_profile_sensor_data
            made = self.create_subscription(convert.message_class(kind), topic, guarded, quality)
            self._parts.append((self.destroy_subscription, made))
        try:
            trigger = convert.message_class("std_srvs/srv/Trigger")
            switch = convert.message_class("std_srvs/srv/SetBool")
        except ImportError:
            self.get_logger().warning("no std_srvs here: ask on ~/request")
            return
        asked = {
            "store_home": msg.StoreHome,
            "look_round": msg.LookRound,
            "turn_home": msg.TurnHome,
        }
        asked |= {"go_home": msg.GoHome, "begin_route": msg.BeginRoute, "save_place": msg.SavePlace}
        asked |= {"cancel": msg.Cancel, "reset": msg.Reset}
        services = [(trigger, name, self._service(lambda _, m=m: m())) for name, m in asked.items()]
        stop = self._service(lambda request: msg.EStop(engaged=request.data))
        for kind, name, serve in (*services, (switch, "estop", stop)):
            made = self.create_service(kind, f"~/{name}", serve)
            self._parts.append((self.destroy_service, made))

    def _guarded(self, callback: Any) -> Any:
        """Return a callback of which an error is told once in the log, and no more."""

        def safely(*message: Any) -> None:
            try:
                callback(*message)
            except HomewardError as error:
                words = str(error)
                if words != self._complained:
                    self.get_logger().warning(words)
                self._complained = words

        return safely

    def _service(self, make: Any) -> Any:
        def serve(request: Any, response: Any) -> Any:
            self._take(make(request))
            faults = [fault.reason for fault in self._live.faults(time.monotonic())]
            response.success = True
            response.message = "; ".join(["asked, ~/said tells what comes of it", *faults])
            return response

        return serve

    def _named(self, kind: Any) -> Callable[[Any], None]:
        """Return a callback that asks for something with the name that a message says."""
        return lambda message: self._take(validated(kind, {"name": message.data}))

    def _take(self, message: msg.Input) -> None:
        self._live.receive(message, time.monotonic())
        self._work.set()

    def _odometry(self, message: Any) -> None:
        self._take(convert.odometry_in(message, self._stamps.seconds(message.header.stamp)))

    def _mount(self, message: Any) -> None:
        """Hear where the camera sits."""
        assert self._camera is not None
        sits = self._camera.mount(message)
        if sits is not None:
            self._take(sits)

    def _bearings(self, message: Any) -> None:
        self._take(self._read(message)())

    def _picture(self, message: Any) -> None:
        assert self._pictures is not None
        if self._pictures.give(self._read(message)):
            self._live.counts["pictures left out, as newer ones came"] += 1

    def _seen(self) -> None:
        """Take what was seen in pictures."""
        while self._pictures is not None and (seen := self._pictures.take()) is not None:
            self._take(seen)

    def _read(self, message: Any) -> Callable[[], msg.BearingsIn]:
        """Return what reads the bearings in a message, on whatever thread."""
        assert self._camera is not None
        return self._camera.reader(message, self._stamps.seconds(message.header.stamp))

    def _line(self, message: Any) -> None:
        said = msg.parse(message.data)
        if isinstance(said, msg.BearingsIn) and self._camera is not None:
            self._camera.require_mount()
        if hasattr(said, "t"):  # stamps of ROS, whose epoch is taken out
            said = said.model_copy(update={"t": self._stamps.of_unix(said.t)})
        self._take(said)

    def _start(self, message: Any) -> None:
        self._take(convert.start_in(message))

    def _scan(self, message: Any) -> None:
        self._take(convert.obstacle_in(message, self._told("scan_half_angle")))

    def _process(self) -> None:
        """Let the estimator work, in a thread of its own."""
        try:
            with single_threaded_blas():
                while self._running:
                    self._work.wait(0.1)
                    self._work.clear()
                    for said in self._live.process():
                        self._output(said)
        except Exception as error:
            if self.context.ok():  # else it was shut down, and nobody hears
                self.get_logger().fatal(f"the estimator's thread ended: {error}")
                raise

    def _output(self, said: msg.Output) -> None:
        """Publish what the session says; what cannot be published is named in the log."""
        try:
            self._say.output(said, (self._stamps.epoch or 0) * NANO)
        except Exception as error:
            if not self.context.ok():
                raise
            self.get_logger().error(f"{said.type} cannot be published: {error}")

    def _tick(self) -> None:
        """Say the command, and where the odometry frame lies."""
        try:
            command = self._live.tick(time.monotonic())
        except HomewardError as error:
            command = None
            self.get_logger().error(str(error))
            self._output(msg.EventOut(type="error", text=str(error)))
        if command is not None:
            self._say.command(command)
        # Where there is no pose any more, the last transform is the best there is.
        self._map_to_odom = self._live.localisation.fix.odom or self._map_to_odom
        if self._map_to_odom is not None:
            self._say.transform(self._map_to_odom)

    def _tell(self) -> None:
        """Say how everything is, and ask where the landmarks are."""
        self._say.diagnostics(self._live.diagnostics(time.monotonic()))
        self._live.ask_landmarks()
        self._work.set()

    def _stop(self) -> None:
        self._running = False
        self._work.set()
        if self._worker is not None:
            self._worker.join()
        self._worker = None
        if self._pictures is not None:
            self._pictures.close()
        self._pictures = None
        for destroy, part in self._parts:
            destroy(part)
        self._parts.clear()

    def _clean(self) -> None:
        self._say.destroy()
        session, self._session, self._map_to_odom = self._session, None, None
        self._stamps, self._camera = convert.StampConverter(), None
        recorder, self._recorder = self._recorder, None
        ends: list[Callable[[], str | None]] = []
        ends += [] if session is None else [session.localisation.conclude]
        ends += [] if recorder is None else [recorder.close]
        for end in ends:  # none of them may cost the other
            try:
                words = end()
            except HomewardError as error:
                words = str(error)
            if words is not None:
                self.get_logger().info(words)
