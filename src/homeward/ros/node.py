"""The lifecycle node: a live session on the topics of ROS 2.

Callbacks take samples in and return at once; the estimator works in a thread of its own, and
answers are published from there. Watchdogs and commands go by the steady clock, stamps by ROS's.
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

from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import DriveSettings
from homeward.drives.folder import read_home
from homeward.drives.ros.measurements.bearings import IN_IMAGE, READERS, Eye
from homeward.drives.ros.measurements.camera import from_camera_info
from homeward.drives.ros.measurements.mount import TF_STATIC, Transforms, mount, not_tied
from homeward.drives.ros.messages.names import PICTURES
from homeward.drives.ros.messages.stamps import NANO
from homeward.drives.ros.settings import BearingsTopic, MountFrames
from homeward.drives.text.settings import read_settings, validated
from homeward.errors import HomewardError, InputError
from homeward.frames import Pose
from homeward.live.messages import (
    Answer,
    BearingsIn,
    BeginRoute,
    Cancel,
    Command,
    EStop,
    FollowRoute,
    GoHome,
    Input,
    Landmarks,
    LookRound,
    MountIs,
    Output,
    Reset,
    SavePlace,
    StoreHome,
    StoreRoute,
    TurnHome,
    line_of,
    parse,
)
from homeward.live.recording import Recorder
from homeward.live.session import Session
from homeward.live.settings import LiveSettings
from homeward.live.visiting import visiting
from homeward.one_thread import one_thread
from homeward.ros import conversions as convert
from homeward.ros.newest import Newest

JSON = "std_msgs/msg/String"
"""The type of bearings as JSON."""
TFS = "tf2_msgs/msg/TFMessage"
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
        self._out: dict[str, Any] = {}
        self._worker: threading.Thread | None = None
        self._work, self._running = threading.Event(), False
        self._camera: Lens | None = None
        self._eye: Eye | None = None
        """Of pictures."""
        self._pictures: Newest[BearingsIn] | None = None
        self._transforms = Transforms()
        self._awaited: MountFrames | None = None
        """Whose transform is not there yet; until then bearings are left out."""
        self._stamps = convert.Clock()
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
            kinds = (JSON, *READERS, *PICTURES)
            if told("bearings_type") not in kinds:
                raise InputError(f"bearings_type: one of {', '.join(kinds)}")
            convert.message_class(told("bearings_type"))  # not all are there on each robot
            self._camera = None
            if told("camera"):
                file = Path(told("camera"))
                self._camera = read_calibration(file.parent, file.name)
            self._eye = None
            if told("bearings_type") in PICTURES:
                from homeward.vision.tags.messages import tag_eye  # the extra vision

                self._eye = tag_eye(told("tags"))
            axes, sigma = told("bearings_axes") or None, told("bearing_sigma") or None
            self._topic = validated(
                BearingsTopic,
                {
                    "topic": told("bearings_topic"),
                    "axes": axes,
                    "sigma": sigma,
                    "rectified": told("rectified"),
                },
            )
            place = None
            if told("place_update") and not told("place"):
                raise InputError("place_update needs a place")
            if told("place"):
                place = visiting(Path(told("place")), told("place_update"), settings.estimator)
            if told("camera_frame"):
                frames = {"camera": told("camera_frame"), "base": told("base_frame")}
                self._awaited = validated(MountFrames, frames)
                convert.message_class(TFS)
            if told("record"):
                self._recorder = Recorder(Path(told("record")), settings, robot, homes, place)
            keep = self._recorder.keep if self._recorder else None
            self._session = Session(settings, robot, homes, keep, place)
            self._publish()
        except (HomewardError, ImportError) as error:
            missing = "; its ROS package is not installed, or ROS's setup.bash was not sourced"
            self.get_logger().error(f"{error}{missing if isinstance(error, ImportError) else ''}")
            self._clean()
            return FAILED
        return DONE

    def on_activate(self, state: Any) -> Any:
        """Listen, and let the estimator work."""
        assert self._session is not None
        self._listen()
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        for period, act in ((1 / self._session.settings.rate, self._tick), (1.0, self._tell)):
            timer = self.create_timer(period, act, clock=steady)
            self._parts.append((self.destroy_timer, timer))
        self._running = True
        self._worker = threading.Thread(target=self._process, daemon=True)
        self._worker.start()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> Any:
        """Tell the robot to stand, if it was driving home, and listen no more."""
        assert self._session is not None
        if self._session.driving:
            self._session.receive(Cancel(), time.monotonic())
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

    def _publish(self) -> None:
        make = self.create_lifecycle_publisher
        stamped = "Stamped" if self._told("cmd_vel_stamped") else ""
        topics = {
            "said": (JSON, "~/said"),
            "pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", "~/pose"),
            "diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "/diagnostics"),
            "landmarks": ("visualization_msgs/msg/MarkerArray", "~/landmarks"),
            "cmd_vel": (f"geometry_msgs/msg/Twist{stamped}", self._told("cmd_vel_topic")),
            "transform": ("geometry_msgs/msg/TransformStamped", "~/map_to_odom"),
        }
        self._out = {
            key: make(convert.message_class(kind), topic, 10)
            for key, (kind, topic) in topics.items()
        }
        try:
            self._out["tf"] = make(convert.message_class(TFS), "/tf", 10)
        except ImportError:
            self.get_logger().warning("no tf2_msgs here: map to odom is on ~/map_to_odom alone")

    def _listen(self) -> None:
        """Subscribe, and offer services."""
        told = self._told
        kind = told("bearings_type")
        hear = self._line if kind == JSON else self._bearings
        if self._eye is not None:
            seen = self.create_guard_condition(self._guarded(self._seen))
            self._parts.append((self.destroy_guard_condition, seen))
            self._pictures, hear = Newest(seen.trigger), self._picture
        topics = [
            ("nav_msgs/msg/Odometry", told("odometry_topic"), self._odometry),
            (kind, told("bearings_topic"), hear),
            ("geometry_msgs/msg/PoseWithCovarianceStamped", "/initialpose", self._start),
            (JSON, "~/request", self._line),
            (JSON, "~/store_home", lambda m: self._take(validated(StoreHome, {"name": m.data}))),
            (JSON, "~/turn_home", lambda m: self._take(validated(TurnHome, {"name": m.data}))),
            (JSON, "~/go_home", lambda m: self._take(validated(GoHome, {"name": m.data}))),
            (JSON, "~/store_route", lambda m: self._take(validated(StoreRoute, {"name": m.data}))),
            (
                JSON,
                "~/follow_route",
                lambda m: self._take(validated(FollowRoute, {"name": m.data})),
            ),
        ]
        if told("camera_info_topic"):
            topics.append(("sensor_msgs/msg/CameraInfo", told("camera_info_topic"), self._info))
        if told("scan_topic"):
            topics.append(("sensor_msgs/msg/LaserScan", told("scan_topic"), self._scan))
        if self._awaited is not None:
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
        asked = {"store_home": StoreHome, "look_round": LookRound, "turn_home": TurnHome}
        asked |= {"go_home": GoHome, "begin_route": BeginRoute, "save_place": SavePlace}
        asked |= {"cancel": Cancel, "reset": Reset}
        services = [(trigger, name, self._service(lambda _, m=m: m())) for name, m in asked.items()]
        stop = self._service(lambda request: EStop(engaged=request.data))
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
            assert self._session is not None
            self._take(make(request))
            faults = self._session.faults(time.monotonic())
            response.success = True
            response.message = "; ".join(["asked, ~/said tells what comes of it", *faults])
            return response

        return serve

    def _take(self, message: Input) -> None:
        assert self._session is not None
        self._session.receive(message, time.monotonic())
        self._work.set()

    def _odometry(self, message: Any) -> None:
        self._take(convert.odometry_in(message, self._stamps.seconds(message.header.stamp)))

    def _mount(self, message: Any) -> None:
        """Hear where the camera sits."""
        self._transforms.add(0.0, message)
        if self._awaited is not None:
            kind = self._told("bearings_type")
            found = mount(self._transforms, self._awaited, kind, self._topic)
            if found is not None:
                sits, self._topic = found
                self._take(MountIs(**dict(sits)))
                self._awaited = None

    def _bearings(self, message: Any) -> None:
        self._take(self._read(message)())

    def _picture(self, message: Any) -> None:
        assert self._session is not None
        assert self._pictures is not None
        if self._pictures.give(self._read(message)):
            self._session.counts["pictures left out, as newer ones came"] += 1

    def _seen(self) -> None:
        """Take what was seen in pictures."""
        while self._pictures is not None and (seen := self._pictures.take()) is not None:
            self._take(seen)

    def _read(self, message: Any) -> Callable[[], BearingsIn]:
        """Return what reads the bearings in a message, on whatever thread."""
        self._require_mount()
        t, kind = self._stamps.seconds(message.header.stamp), self._told("bearings_type")
        if kind in IN_IMAGE and self._camera is None:
            raise InputError("bearings are left out: nothing on camera_info_topic, and no camera")
        return partial(convert.bearings_in, message, t, kind, self._topic, self._camera, self._eye)

    def _require_mount(self) -> None:
        if self._awaited is not None:
            mount(self._transforms, self._awaited, self._told("bearings_type"), self._topic)
            raise InputError(f"bearings are left out: {not_tied(self._awaited)} yet")

    def _line(self, message: Any) -> None:
        said = parse(message.data)
        if isinstance(said, BearingsIn):
            self._require_mount()
        if hasattr(said, "t"):  # stamps of ROS, whose epoch is taken out
            said = said.model_copy(update={"t": self._stamps.of_unix(said.t)})
        self._take(said)

    def _start(self, message: Any) -> None:
        self._take(convert.start_in(message))

    def _info(self, message: Any) -> None:
        if self._camera is None:
            self._camera = from_camera_info(message, self._topic.rectified)

    def _scan(self, message: Any) -> None:
        self._take(convert.obstacle_in(message, self._told("scan_half_angle")))

    def _process(self) -> None:
        """Let the estimator work, in a thread of its own."""
        assert self._session is not None
        try:
            with one_thread():
                while self._running:
                    self._work.wait(0.1)
                    self._work.clear()
                    for said in self._session.process():
                        self._say(said)
                        if isinstance(said, Answer) and said.pose is not None:
                            self._answer(said)
                        if isinstance(said, Landmarks):
                            self._mark(said)
        except Exception as error:
            if self.context.ok():  # else it was shut down, and nobody hears
                self.get_logger().fatal(f"the estimator's thread ended: {error}")
                raise

    def _say(self, said: Output) -> None:
        self._out["said"].publish(convert.message_class(JSON)(data=line_of(said).rstrip()))

    def _answer(self, said: Answer) -> None:
        message = convert.message_class("geometry_msgs/msg/PoseWithCovarianceStamped")()
        message.header.frame_id = self._told("map_frame")
        stamp = round(said.t * NANO) + (self._stamps.epoch or 0) * NANO
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANO)
        convert.fill_pose(message.pose.pose, Pose(*said.pose or (0.0, 0.0, 0.0)))
        convert.fill_covariance(message.pose, said)
        self._out["pose"].publish(message)

    def _mark(self, said: Landmarks) -> None:
        stamp = self.get_clock().now().to_msg()
        markers = convert.markers_out(said, stamp, self._told("map_frame"))
        self._out["landmarks"].publish(markers)

    def _tick(self) -> None:
        """Say the command, and where the odometry frame lies."""
        assert self._session is not None
        command = self._session.tick(time.monotonic())
        if command is not None:
            self._drive(command)
        # Where there is no pose any more, the last transform is the best there is.
        self._map_to_odom = self._session.localisation.fix.odom or self._map_to_odom
        if self._map_to_odom is not None:
            stamp = self.get_clock().now().to_msg()
            frames = self._told("map_frame"), self._told("odom_frame")
            message = convert.transform(stamp, *frames, self._map_to_odom)
            self._out["transform"].publish(message)
            if "tf" in self._out:
                tf = convert.message_class(TFS)
                self._out["tf"].publish(tf(transforms=[message]))

    def _drive(self, command: Command) -> None:
        stamped = self._told("cmd_vel_stamped")
        message = convert.message_class(f"geometry_msgs/msg/Twist{'Stamped' * stamped}")()
        if stamped:
            message.header.stamp = self.get_clock().now().to_msg()
        twist = message.twist if stamped else message
        twist.linear.x, twist.angular.z = float(command.v), float(command.omega)
        self._out["cmd_vel"].publish(message)
        self._say(command)

    def _tell(self) -> None:
        assert self._session is not None
        stamp = self.get_clock().now().to_msg()
        said = self._session.diagnostics(time.monotonic())
        self._out["diagnostics"].publish(convert.diagnostics_out(said, stamp))
        self._say(said)
        self._session.ask_landmarks()
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
        for publisher in self._out.values():
            self.destroy_publisher(publisher)
        self._out = {}
        session, self._session, self._map_to_odom = self._session, None, None
        self._stamps, self._transforms = convert.Clock(), Transforms()
        self._awaited = None
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
