"""The simulated robot with a forward camera of 70 degrees: pictures of tags, and CameraInfo.

`python picture_node.py image` or `compressed`; home is where it begins.
"""

import math
import sys

import cv2
import numpy as np
import rclpy
from robot_node import RobotNode
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from homeward.drives.cameras.camera import angles
from homeward.drives.cameras.lens import Lens

LENS = Lens(fx=457.0, fy=457.0, cx=319.5, cy=119.5, width=640, height=240)
TAGS, SIZE = 16, 0.2
FINE = 2
"""Parts of a pixel, either way."""
SHEET, BORDER = 40, 5
"""Width of a tag and of its white border [pixels of its sheet]. Finer sheets than pictures make
steps in edges: then bearings have errors of 7 sigma, and which tags agree is chance."""


class PictureNode(RobotNode):
    def __init__(self, packed):
        super().__init__(0, **{"trajectory.spin": 0.5, "rates.bearings": 12.5})
        self.packed = packed
        self.pictures = self.create_publisher(CompressedImage if packed else Image, "image", 5)
        self.info = self.create_publisher(CameraInfo, "camera_info", 5)
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        sheets = [cv2.aruco.generateImageMarker(family, k, SHEET) for k in range(TAGS)]
        self.sheets = [np.pad(sheet, BORDER, constant_values=255) for sheet in sheets]
        rng, way = np.random.default_rng(0), math.tau * np.arange(TAGS) / TAGS
        away = rng.uniform(1.6, 2.6, TAGS)
        self.places = np.array([self.robot.pose[:2]]) + np.stack(
            [away * np.cos(way), away * np.sin(way)], axis=1
        )
        self.facing = way

    def look(self, stamp, seen, pose):
        info = CameraInfo(width=640, height=240, distortion_model="plumb_bob", d=[0.0] * 5)
        info.k = [LENS.fx, 0.0, LENS.cx, 0.0, LENS.fy, LENS.cy, 0.0, 0.0, 1.0]
        info.header.stamp, info.header.frame_id = stamp, "camera_optical_frame"
        self.info.publish(info)
        grey = self.picture(pose)
        message = CompressedImage(format="png") if self.packed else Image()
        message.header = info.header
        if self.packed:
            message.data = cv2.imencode(".png", grey)[1].tobytes()
        else:
            message.height, message.width, message.step = 240, 640, 640
            message.encoding, message.data = "mono8", grey.tobytes()
        self.pictures.publish(message)

    def picture(self, pose):
        """What the camera sees from a pose: the tags, each face to where the robot began."""
        canvas = np.full((240 * FINE, 640 * FINE), 120, np.uint8)
        c, s = math.cos(pose.heading), math.sin(pose.heading)
        for sheet, place, facing in zip(self.sheets, self.places, self.facing, strict=True):
            half = SIZE * (0.5 + BORDER / SHEET)  # with its white border
            right = np.array([math.sin(facing), -math.cos(facing)]) * half
            corners = [
                (place + a * right, b * half) for a, b in ((-1, 1), (1, 1), (1, -1), (-1, -1))
            ]
            rays = np.array(
                [(*(np.array([[c, s], [-s, c]]) @ (spot - pose[:2])), z) for spot, z in corners]
            )
            if rays[:, 0].min() < 0.3:
                continue
            pixels = np.stack(LENS.pixels(*angles(rays)), axis=1)
            if pixels[:, 0].min() > 700 or pixels[:, 0].max() < -60:
                continue
            n = sheet.shape[0]
            square = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32) - 0.5
            there = ((pixels + 0.5) * FINE - 0.5).astype(np.float32)
            turn = cv2.getPerspectiveTransform(square, there)
            size = canvas.shape[::-1]
            drawn = cv2.warpPerspective(sheet, turn, size, flags=cv2.INTER_AREA)
            mask = cv2.warpPerspective(np.full_like(sheet, 255), turn, size)
            canvas = np.where(mask > 127, drawn, canvas)
        return cv2.resize(canvas, (640, 240), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(PictureNode(sys.argv[1] == "compressed"))
