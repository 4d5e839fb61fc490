"""Lifecycle node: a live session on ROS 2 topics.

Callbacks queue samples and return at once; the estimator runs in its own thread, which publishes
the answers. Watchdogs and commands use the steady clock, stamps the ROS clock.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

from homeward.drives.folder import read_home
from homeward.drives.ros.measurements.extrinsics import TF_STATIC
from homeward.drives.ros.stamps import NANO
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError, InputError
from homeward.geometry.frames import Pose
from homeward.io.models import Strict
from homeward.io.settings import read_settings, validated
from homeward.live import messages as msg
from homeward.live.fleet.connection import given_broker
from homeward.live.fleet.robot import join_place
from homeward.live.recording import Recorder
from homeward.live.session import Session
from homeward.live.settings import LiveSettings, read_live_settings
from homeward.ros import conversions as convert
from homeward.ros.camera import FrameOrder, MessageCameras, Newest
from homeward.ros.conversions import JSON, TFS, Publishers

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service for messages that were published before the subscription."""
PARAMETERS: dict[str, Any] = {
    "odometry_topic": "odom",
    "topics": "",
    "bearings_topic": "bearings",
    "bearings_type": "geometry_msgs/msg/PoseArray",
    "bearings_frames": "",
    "bearings_axes": "",
    "bearing_sigma": 0.0,
    "tags": "36h11",
    "tag_size": 0.0,
    "camera": "",
    "camera_info_topic": "",
    "rectified": False,
    "camera_frame": "",
    "base_frame": "base_link",
    "imu_topic": "",
    "scan_topic": "",
    "scan_half_angle": 0.35,
    "cmd_vel_topic": "cmd_vel",
    "cmd_vel_stamped": False,
    "map_frame": "map",
    "odom_frame": "odom",
    "home_in_map": [0.0, 0.0, 0.0],
    "transform_tolerance": 0.1,
    "withhold_transform": False,
    "home": "",
    "place": "",
    "place_update": False,
    "mqtt": "",
    "mqtt_user": "",
    "mqtt_password_file": "",
    "mqtt_ca": "",
    "robot_file": "",
    "session": "",
    "smoothed_lag": 0.0,
    "dock": "",
    "record": "",
    "autostart": True,
}
"""Parameters and their defaults, described in ros/homeward_ros/config/homeward.yaml."""
MQTT = "", "_user", "_password_file", "_ca"
"""Ends of the names of the parameters of a broker."""
NAMED = msg.StoreHome, msg.TurnHome, msg.GoHome, msg.StoreRoute, msg.FollowRoute
"""Messages with a name: each is a topic, whose name is the type of the message."""
PLAIN = *NAMED[:3], msg.LookRound, msg.BeginRoute, msg.SavePlace, msg.Cancel, msg.Reset
"""Messages that are services without a request."""
DONE, FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


def _type_of(message: type[Strict]) -> str:
    """Return the type of a message, as in its JSON."""
    return str(message.model_fields["type"].default)


class HomewardNode(LifecycleNode):  # type: ignore[misc]
    """Lifecycle node of a live session."""

    def __init__(self, name: str = "homeward", **options: Any) -> None:
        super().__init__(name, **options)
        for parameter, default in PARAMETERS.items():
            self.declare_parameter(parameter, default)
        self._session: Session | None = None
        self._recorder: Recorder | None = None
        self._parts: list[tuple[Any, Any]] = []
        self._publish = Publishers(self)
        self._worker: threading.Thread | None = None
        self._cameras: MessageCameras | None = None
        self._frames = FrameOrder(1)
        self._pictures: Newest[msg.BearingsIn] | None = None
        self._stamps = convert.StampConverter()
        self._map_to_odom: Pose | None = None
        self._last_warning = ""

    def on_configure(self, state: Any) -> Any:
        """Read the files of the parameters, and create the session."""
        parameter = self._parameter
        try:
            settings, robot, homes = LiveSettings(), DriveSettings(), {}
            if parameter("session"):
                settings = read_live_settings(Path(parameter("session")))
            if parameter("smoothed_lag"):
                given = {"smoothed_lag": parameter("smoothed_lag")}
                settings = validated(LiveSettings, settings.model_dump() | given)
            if parameter("robot_file"):
                robot = read_settings(Path(parameter("robot_file")), DriveSettings)
            if parameter("home"):
                homes["home"] = read_home(Path(parameter("home")), {})
            given = {name: parameter(name) for name in PARAMETERS}
            self._cameras = MessageCameras(given, self._publish.tags)
            self._frames = FrameOrder(self._cameras.number)
            place = None
            if parameter("place_update") and not parameter("place"):
                raise InputError("place_update needs the parameter place")
            if parameter("place"):
                url, user, *paths = (parameter(f"mqtt{n}") or None for n in MQTT)
                broker = given_broker(url, user, *(path and Path(path) for path in paths))
                update = parameter("place_update")
                place = join_place(parameter("place"), update, settings.estimator, broker)
            self._session = Session(settings, robot, homes, place)
            self._session.watch(self._publish.keep)
            if parameter("record"):
                self._recorder = Recorder(Path(parameter("record")), settings, robot, homes, place)
                self._session.watch(self._recorder.keep)
            self._publish.make()
        except (HomewardError, ImportError) as error:
            missing = "; install its ROS package, or source the setup.bash of ROS"
            self.get_logger().error(f"{error}{missing if isinstance(error, ImportError) else ''}")
            self._clean()
            return FAILED
        return DONE

    @property
    def _live(self) -> Session:
        """The session, which exists from configuration to cleanup."""
        assert self._session is not None
        return self._session

    def on_activate(self, state: Any) -> Any:
        """Subscribe, and start the estimator's thread."""
        self._listen()
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        for period, act in ((1 / self._live.settings.rate, self._tick), (1.0, self._report)):
            timer = self.create_timer(period, act, clock=steady)
            self._parts.append((self.destroy_timer, timer))
        self._worker = threading.Thread(target=self._process, daemon=True)
        self._worker.start()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> Any:
        """Stop the robot if it is driven, and end subscriptions and services."""
        if self._live.driving:
            self._live.receive(msg.Cancel(), time.monotonic())
            self._tick()
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: Any) -> Any:
        """End the session."""
        self._clean()
        return DONE

    def on_shutdown(self, state: Any) -> Any:
        """Stop and end the session."""
        self._stop()
        self._clean()
        return DONE

    def _parameter(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _listen(self) -> None:
        """Create subscriptions and services."""
        parameter, cameras = self._parameter, self._cameras
        assert cameras is not None
        hear: Callable[[int, Any], None] = self._bearings
        if cameras.takes_pictures:
            seen = self.create_guard_condition(self._guarded(self._seen))
            self._parts.append((self.destroy_guard_condition, seen))
            self._pictures, hear = Newest(seen.trigger), self._picture
        topics: list[tuple[str, str, Callable[[Any], None]]] = [
            ("nav_msgs/msg/Odometry", parameter("odometry_topic"), self._odometry),
            ("geometry_msgs/msg/PoseWithCovarianceStamped", "initialpose", self._start),
            (JSON, "~/request", self._line),
        ]
        for number, given in enumerate(cameras.topics):
            take = self._line if cameras.kind == JSON else partial(hear, number)
            topics.append((cameras.kind, given.topic, take))
            if isinstance(given.camera, str):
                info = partial(cameras.info, number)
                topics.append(("sensor_msgs/msg/CameraInfo", given.camera, info))
        topics += [(JSON, f"~/{_type_of(kind)}", self._named(kind)) for kind in NAMED]
        topics.append((JSON, "~/dock", self._named(msg.GoHome, dock=True)))
        if parameter("imu_topic"):
            topics.append(("sensor_msgs/msg/Imu", parameter("imu_topic"), self._tilt))
        if parameter("scan_topic"):
            topics.append(("sensor_msgs/msg/LaserScan", parameter("scan_topic"), self._scan))
        if cameras.needs_transforms:
            topics.append((TFS, TF_STATIC, self._transforms))
        self._send_extrinsics()
        for kind, topic, callback in topics:
            guarded = self._guarded(callback)
            quality = LATCHED if topic == TF_STATIC else qos_profile_sensor_data
            made = self.create_subscription(convert.message_class(kind), topic, guarded, quality)
            self._parts.append((self.destroy_subscription, made))
        try:
            trigger = convert.message_class("std_srvs/srv/Trigger")
            switch = convert.message_class("std_srvs/srv/SetBool")
            empty = convert.message_class("std_srvs/srv/Empty")
        except ImportError:
            self.get_logger().warning("std_srvs is not installed: no services, use ~/request")
            return
        services = [(trigger, _type_of(m), self._service(lambda _, m=m: m())) for m in PLAIN]
        stop = self._service(lambda request: msg.EStop(engaged=request.data))
        for kind, name, serve in (*services, (switch, "estop", stop)):
            made = self.create_service(kind, f"~/{name}", serve)
            self._parts.append((self.destroy_service, made))
        made = self.create_service(empty, "reinitialize_global_localization", self._reinitialize)
        self._parts.append((self.destroy_service, made))

    def _guarded(self, callback: Any) -> Any:
        """Return a callback that logs each error once."""

        def safely(*message: Any) -> None:
            try:
                callback(*message)
            except HomewardError as error:
                words = str(error)
                if words != self._last_warning:
                    self.get_logger().warning(words)
                self._last_warning = words

        return safely

    def _service(self, make: Any) -> Any:
        def serve(request: Any, response: Any) -> Any:
            self._take(make(request))
            faults = [fault.reason for fault in self._live.faults(time.monotonic())]
            response.success = True
            response.message = "; ".join(["requested, see ~/said for the result", *faults])
            return response

        return serve

    def _reinitialize(self, request: Any, response: Any) -> Any:
        """Begin the map again, as AMCL's service of this name spreads its particles."""
        self._take(msg.Reset())
        return response

    def _named(self, kind: Any, **more: bool) -> Callable[[Any], None]:
        """Return a callback that sends a message of a kind, named by the data of a String."""
        return lambda message: self._take(validated(kind, {"name": message.data} | more))

    def _take(self, message: msg.Input) -> None:
        self._live.receive(message, time.monotonic())

    def _odometry(self, message: Any) -> None:
        self._take(convert.odometry_in(message, self._stamps.seconds(message.header.stamp)))

    def _transforms(self, message: Any) -> None:
        """Receive transforms, and with them the camera extrinsics."""
        assert self._cameras is not None
        self._cameras.add_transforms(message)
        self._send_extrinsics()

    def _send_extrinsics(self) -> None:
        assert self._cameras is not None
        while (extrinsics := self._cameras.extrinsics()) is not None:
            self._take(extrinsics)

    def _bearings(self, number: int, message: Any) -> None:
        for read in self._reads(number, message):
            for frame in self._frames.add(number, read()):
                self._take(frame)

    def _picture(self, number: int, message: Any) -> None:
        assert self._pictures is not None
        for read in self._reads(number, message):
            if self._pictures.give(read):
                self._live.counts["images dropped: newer ones came"] += 1

    def _seen(self) -> None:
        """Process the bearings from images."""
        while self._pictures is not None and (seen := self._pictures.take()) is not None:
            self._take(seen)

    def _reads(self, number: int, message: Any) -> list[Callable[[], msg.BearingsIn]]:
        """Return functions that read the bearings of a message of a camera, on any thread."""
        assert self._cameras is not None
        reads = self._cameras.readers(number, message, self._stamps.seconds)
        self._send_extrinsics()
        return reads

    def _line(self, message: Any) -> None:
        request = msg.parse(message.data)
        if isinstance(request, msg.BearingsIn) and self._cameras is not None:
            self._cameras.require_mount()
        if hasattr(request, "t"):  # ROS stamps; subtract the epoch
            request = request.model_copy(update={"t": self._stamps.of_unix(request.t)})
        self._take(request)

    def _start(self, message: Any) -> None:
        frame = self._parameter("map_frame")
        self._take(convert.start_in(message, frame, self._publish.home))

    def _tilt(self, message: Any) -> None:
        self._take(convert.tilt_in(message, self._stamps.seconds(message.header.stamp)))

    def _scan(self, message: Any) -> None:
        self._take(convert.obstacle_in(message, self._parameter("scan_half_angle")))

    def _process(self) -> None:
        """Run the estimator, in its own thread."""
        try:
            self._live.run(self._output)
        except Exception as error:
            if self.context.ok():  # after a shutdown there is no log
                self.get_logger().fatal(f"the estimator's thread ended: {error}")
                raise

    def _output(self, out: msg.Output) -> None:
        """Publish output of the session, or log the error."""
        try:
            live, epoch_ns = self._live.localisation, (self._stamps.epoch or 0) * NANO
            self._publish.output(out, epoch_ns, live.camera)
            if isinstance(out, msg.Answer) and (name := self._parameter("dock")):
                self._publish.dock(live.seen_from_robot(name), out.t, epoch_ns)
        except Exception as error:
            if not self.context.ok():
                raise
            self.get_logger().error(f"{out.type} cannot be published: {error}")

    def _tick(self) -> None:
        """Publish the command, and the transform of the odometry frame."""
        try:
            command = self._live.tick(time.monotonic())
        except HomewardError as error:
            command = None
            self.get_logger().error(str(error))
            self._output(msg.EventOut(type="error", text=str(error)))
        if command is not None:
            self._publish.command(command)
        # Without a pose, the last transform is the best estimate.
        self._map_to_odom = self._live.localisation.fix.odom or self._map_to_odom
        withheld = self._parameter("withhold_transform") and not self._live.is_sure(
            time.monotonic()
        )
        if self._map_to_odom is not None and not withheld:
            self._publish.transform(self._map_to_odom)

    def _report(self) -> None:
        """Publish diagnostics, and request the landmarks."""
        self._publish.diagnostics(self._live.diagnostics(time.monotonic()))
        self._live.request_landmarks()

    def _stop(self) -> None:
        if self._worker is not None:
            self._live.end()
            self._worker.join()
        self._worker = None
        if self._pictures is not None:
            self._pictures.close()
        self._pictures = None
        for destroy, part in self._parts:
            destroy(part)
        self._parts.clear()

    def _clean(self) -> None:
        self._publish.destroy()
        session, self._session, self._map_to_odom = self._session, None, None
        self._stamps, self._cameras = convert.StampConverter(), None
        recorder, self._recorder = self._recorder, None
        ends: list[Callable[[], str | None]] = []
        ends += [] if session is None else [session.localisation.finalise]
        ends += [] if recorder is None else [recorder.close]
        for end in ends:  # each must run even if the other fails
            try:
                words = end()
            except HomewardError as error:
                words = str(error)
            if words is not None:
                self.get_logger().info(words)
