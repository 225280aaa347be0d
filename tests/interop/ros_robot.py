"""A robot of real ROS 2 nodes (rclpy, Fast DDS): publishes the scene of an .npz again and again. Run by the tests.

Its interpreter needs `ros-rclpy[fastrtps]`, `ros-sensor-msgs` and `ros-nav-msgs`, and nothing of this project.
"""

import sys
import time
import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image


def main(path, seconds):
    """Publish colour and depth best effort, as drivers do, and the rest reliably."""
    scene = np.load(path)
    rclpy.init()
    node = rclpy.create_node("robot")
    color = node.create_publisher(Image, "/cam/color/image_raw", qos_profile_sensor_data)
    depth = node.create_publisher(Image, "/cam/depth/image_raw", qos_profile_sensor_data)
    infos = [node.create_publisher(CameraInfo, f"/cam/{kind}/camera_info", 10) for kind in ("color", "depth")]
    odom = node.create_publisher(Odometry, "/odom", 10)
    print("ready", flush=True)
    fx, fy, cx, cy = scene["pinhole"].tolist()
    began_s, i = time.monotonic(), 0
    while time.monotonic() - began_s < seconds:
        at = i % len(scene["rgb"])
        stamp_ns = int(scene["start_ns"]) + 100_000_000 * i
        header = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
        pose = Odometry(child_frame_id="cam_optical")
        pose.header.frame_id = "odom"
        position, orientation = pose.pose.pose.position, pose.pose.pose.orientation
        position.x, position.y, position.z = scene["positions"][at].tolist()
        orientation.x, orientation.y, orientation.z, orientation.w = scene["quaternions"][at].tolist()
        messages = [(odom, pose)]
        for publisher in infos:
            info = CameraInfo(width=scene["rgb"].shape[2], height=scene["rgb"].shape[1], distortion_model="plumb_bob")
            info.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
            info.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
            info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
            info.d = [0.0] * 5
            messages.append((publisher, info))
        for publisher, pixels, encoding in ((color, scene["rgb"][at], "rgb8"), (depth, scene["depth_mm"][at], "16UC1")):
            image = Image(height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, step=pixels.strides[0])
            image.data = pixels.tobytes()
            messages.append((publisher, image))
        for publisher, message in messages:
            message.header.stamp.sec, message.header.stamp.nanosec = header["sec"], header["nanosec"]
            message.header.frame_id = message.header.frame_id or "cam_optical"
            publisher.publish(message)
        i += 1
        time.sleep(max(0.0, began_s + 0.1 * i - time.monotonic()))
    print(i, flush=True)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
