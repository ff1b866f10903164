"""Makes recordings in the formats of other programs from one in the TUM layout.

    foreign_recordings.py TUM_DIR FORMAT OUT

The containers and messages are written by the libraries rosbags, mcap and mcap-ros2-support.
"""

import json
import shutil
import struct
import sys
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image as Picture

# Units in a metre of the depth that is written, unless a format has others.
MILLIMETRES = 1000.0


def frames(tum):
    """Time in nanoseconds, colour's file, depth's file."""
    rows = []
    for name in ("rgb.txt", "depth.txt"):
        lines = (tum / name).read_text().splitlines()
        rows.append([line.split() for line in lines if not line.startswith("#")])
    for (stamp, color), (_, depth) in zip(*rows):
        yield round(float(stamp) * 1e6) * 1000, tum / color, tum / depth


def camera(tum):
    return tomllib.loads((tum / "camera.toml").read_text())


def rgb(path):
    return np.asarray(Picture.open(path).convert("RGB"))


def depth_m(path, tum):
    return np.asarray(Picture.open(path)).astype(np.float64) / camera(tum)["depth_units_per_metre"]


def depth_mm(path, tum):
    return np.round(depth_m(path, tum) * MILLIMETRES).astype(np.uint16)


def png(depth):
    import io

    out = io.BytesIO()
    Picture.fromarray(depth).save(out, "png")
    return out.getvalue()


class Messages:
    """Messages of ROS 1 or ROS 2 by the library rosbags."""

    def __init__(self, tum, store, is_ros1=False):
        from rosbags.typesys import get_typestore

        self.store = get_typestore(store)
        self.is_ros1 = is_ros1
        self.camera = camera(tum)

    def type(self, name):
        return self.store.types[name]

    def bytes(self, message, name):
        if self.is_ros1:
            return bytes(self.store.serialize_ros1(message, name))
        return bytes(self.store.serialize_cdr(message, name))

    def header(self, time_ns, frame):
        stamp = self.type("builtin_interfaces/msg/Time")(time_ns // 10**9, time_ns % 10**9)
        extra = {"seq": 0} if self.is_ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame, **extra)

    def image(self, time_ns, frame, encoding, pixels):
        name = "sensor_msgs/msg/Image"
        data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
        height, width = pixels.shape[:2]
        message = self.type(name)(
            header=self.header(time_ns, frame),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=len(data) // height,
            data=data,
        )
        return self.bytes(message, name)

    def compressed(self, time_ns, frame, format, data):
        name = "sensor_msgs/msg/CompressedImage"
        header = self.header(time_ns, frame)
        data = np.frombuffer(data, np.uint8)
        return self.bytes(self.type(name)(header=header, format=format, data=data), name)

    def info(self, time_ns, frame):
        name = "sensor_msgs/msg/CameraInfo"
        c = self.camera
        roi = self.type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False)
        small = not self.is_ros1
        matrices = {
            "d": np.zeros(5),
            "k": np.array([c["fx"], 0, c["cx"], 0, c["fy"], c["cy"], 0, 0, 1.0]),
            "r": np.eye(3).reshape(-1),
            "p": np.array([c["fx"], 0, c["cx"], 0, 0, c["fy"], c["cy"], 0, 0, 0, 1.0, 0]),
        }
        message = self.type(name)(
            header=self.header(time_ns, frame),
            height=c["height"],
            width=c["width"],
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=roi,
            **{key if small else key.upper(): value for key, value in matrices.items()},
        )
        return self.bytes(message, name)


def ros2_store():
    from rosbags.typesys import Stores

    return Stores.ROS2_HUMBLE


COLOR, DEPTH = "/camera/color", "/camera/aligned_depth_to_color"
FRAME = "camera_color_optical_frame"


def rosbag2(tum, out, is_mcap, is_compressed):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if is_mcap else StoragePlugin.SQLITE3
    messages = Messages(tum, ros2_store())
    writer = Writer(out, version=9, storage_plugin=plugin)
    if is_compressed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        def topic(name, kind):
            return writer.add_connection(name, f"sensor_msgs/msg/{kind}", typestore=messages.store)

        color, depth = topic(f"{COLOR}/image_raw", "Image"), topic(f"{DEPTH}/image_raw", "Image")
        info = topic(f"{COLOR}/camera_info", "CameraInfo")
        for time, color_file, depth_file in frames(tum):
            bgr = rgb(color_file)[:, :, ::-1]
            metres = depth_m(depth_file, tum).astype(np.float32)
            writer.write(depth, time, messages.image(time, FRAME, "32FC1", metres))
            writer.write(color, time, messages.image(time, FRAME, "bgr8", bgr))
            writer.write(info, time, messages.info(time, FRAME))


def mcap(tum, out):
    """Compressed pictures, written by mcap-ros2-support from the messages' definitions."""
    from mcap_ros2.writer import Writer
    from rosbags.typesys import get_typestore

    store = get_typestore(ros2_store())
    c = camera(tum)
    with open(out, "wb") as file:
        writer = Writer(file)
        schemas = {
            kind: writer.register_msgdef(
                f"sensor_msgs/msg/{kind}",
                store.generate_msgdef(f"sensor_msgs/msg/{kind}", ros_version=2)[0],
            )
            for kind in ("CompressedImage", "CameraInfo")
        }
        for time, color_file, depth_file in frames(tum):
            stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
            header = {"stamp": stamp, "frame_id": FRAME}
            # What compressed_depth_image_transport writes before the PNG.
            depth = struct.pack("<iff", 0, 0.0, 0.0) + png(depth_mm(depth_file, tum))
            info = {
                "header": header,
                "height": c["height"],
                "width": c["width"],
                "distortion_model": "plumb_bob",
                "d": [0.0] * 5,
                "k": [c["fx"], 0.0, c["cx"], 0.0, c["fy"], c["cy"], 0.0, 0.0, 1.0],
            }
            for topic, kind, message in (
                (f"{COLOR}/image_raw/compressed", "CompressedImage",
                 {"header": header, "format": "rgb8; png compressed bgr8",
                  "data": color_file.read_bytes()}),
                (f"{DEPTH}/image_raw/compressedDepth", "CompressedImage",
                 {"header": header, "format": "16UC1; compressedDepth", "data": depth}),
                (f"{COLOR}/camera_info", "CameraInfo", info),
            ):
                writer.write_message(topic, schemas[kind], message, log_time=time)
        writer.finish()


def realsense(tum, out):
    """As RealSense's viewer records: depth of another camera, its unit, and how they stand."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores

    messages = Messages(tum, Stores.ROS1_NOETIC, is_ros1=True)
    writer = Writer(out)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    depth_stream, color_stream = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"
    with writer:
        def topic(name, kind):
            return writer.add_connection(name, kind, typestore=messages.store)

        transform = "geometry_msgs/msg/Transform"
        vector, quaternion = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"
        here = messages.type(transform)(
            translation=messages.type(vector)(0.1, 0.0, 0.0),
            rotation=messages.type(quaternion)(0.0, 0.0, 0.0, 1.0),
        )
        units = camera(tum)["depth_units_per_metre"]
        unit = messages.type("std_msgs/msg/Float32")(1.0 / units)
        option = topic("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32")
        writer.write(option, 1, messages.bytes(unit, "std_msgs/msg/Float32"))
        pictures = {}
        for stream in (depth_stream, color_stream):
            info = topic(f"{stream}/info/camera_info", "sensor_msgs/msg/CameraInfo")
            writer.write(info, 1, messages.info(0, stream))
            tf = topic(f"{stream}/tf/0", transform)
            writer.write(tf, 1, messages.bytes(here, transform))
            pictures[stream] = topic(f"{stream}/image/data", "sensor_msgs/msg/Image")
        for time, color_file, depth_file in frames(tum):
            raw = np.asarray(Picture.open(depth_file)).astype(np.uint16)
            depth = messages.image(time, depth_stream, "mono16", raw)
            writer.write(pictures[depth_stream], time, depth)
            color = messages.image(time, color_stream, "rgb8", rgb(color_file))
            writer.write(pictures[color_stream], time, color)


def rosbag1(tum, out):
    """As a Kinect's driver for ROS 1 publishes, in chunks of bz2."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores

    messages = Messages(tum, Stores.ROS1_NOETIC, is_ros1=True)
    writer = Writer(out)
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer:
        def topic(name, kind):
            return writer.add_connection(name, f"sensor_msgs/msg/{kind}", typestore=messages.store)

        color = topic("/camera/rgb/image_rect_color/compressed", "CompressedImage")
        depth = topic("/camera/depth_registered/image_raw/compressedDepth", "CompressedImage")
        info = topic("/camera/rgb/camera_info", "CameraInfo")
        frame = "camera_rgb_optical_frame"
        for time, color_file, depth_file in frames(tum):
            data = struct.pack("<iff", 0, 0.0, 0.0) + png(depth_mm(depth_file, tum))
            format = "16UC1; compressedDepth"
            writer.write(depth, time, messages.compressed(time, frame, format, data))
            data = color_file.read_bytes()
            writer.write(color, time, messages.compressed(time, frame, "png", data))
            writer.write(info, time, messages.info(time, frame))


def matrix(tum, side):
    c = camera(tum)
    m = np.eye(side)
    m[0, 0], m[1, 1], m[0, 2], m[1, 2] = c["fx"], c["fy"], c["cx"], c["cy"]
    return m


def folder(tum, out, color_name, depth_name):
    """Pictures with their numbers in their names, depth in millimetres."""
    for number, (_, color_file, depth_file) in enumerate(frames(tum)):
        for name in (color_name, depth_name):
            (out / name.format(number)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(color_file, out / color_name.format(number))
        (out / depth_name.format(number)).write_bytes(png(depth_mm(depth_file, tum)))


def open3d(tum, out):
    folder(tum, out, "color/{:06}.png", "depth/{:06}.png")
    c = camera(tum)
    text = {
        "width": c["width"],
        "height": c["height"],
        "intrinsic_matrix": matrix(tum, 3).T.reshape(-1).tolist(),
    }
    (out / "camera_intrinsic.json").write_text(json.dumps(text))


def scannet(tum, out):
    folder(tum, out, "color/{}.png", "depth/{}.png")
    (out / "intrinsic").mkdir()
    for name in ("color", "depth"):
        np.savetxt(out / "intrinsic" / f"intrinsic_{name}.txt", matrix(tum, 4))


def bundlefusion(tum, out):
    folder(tum, out, "frame-{:06}.color.png", "frame-{:06}.depth.png")
    c = camera(tum)
    numbers = " ".join(str(x) for x in matrix(tum, 4).reshape(-1))
    (out / "info.txt").write_text(
        f"m_versionNumber = 4\nm_colorWidth = {c['width']}\nm_colorHeight = {c['height']}\n"
        f"m_depthShift = 1000\nm_calibrationColorIntrinsic = {numbers}\n"
    )


def stray_scanner(tum, out):
    folder(tum, out, "rgb/{:06}.png", "depth/{:06}.png")
    np.savetxt(out / "camera_matrix.csv", matrix(tum, 3), delimiter=",")


def record3d(tum, out):
    """A .r3d file; its colour is JPEG, and its depth is packed by Apple's own LZFSE."""
    import io
    import zipfile

    import lzfse

    shown, times = camera(tum), [time / 1e9 for time, _, _ in frames(tum)]
    size = {"w": shown["width"], "h": shown["height"], "dw": shown["width"], "dh": shown["height"]}
    metadata = size | {
        "K": matrix(tum, 3).T.flatten().tolist(),
        "fps": 30,
        "frameTimestamps": [time - times[0] for time in times],
        "poses": [[0, 0, 0, 1, 0, 0, 0] for _ in times],
    }
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("metadata", json.dumps(metadata))
        for i, (_, color_file, depth_file) in enumerate(frames(tum)):
            jpeg = io.BytesIO()
            Picture.fromarray(rgb(color_file)).save(jpeg, "jpeg", quality=95)
            archive.writestr(f"rgbd/{i}.jpg", jpeg.getvalue())
            metres = depth_m(depth_file, tum).astype(np.float32)
            metres[metres == 0] = np.nan
            archive.writestr(f"rgbd/{i}.depth", lzfse.compress(metres.tobytes()))
            sure = np.full(metres.shape, 2, np.uint8)
            archive.writestr(f"rgbd/{i}.conf", lzfse.compress(sure.tobytes()))


def associations(tum, out):
    out.mkdir()
    lines = []
    for time, color_file, depth_file in frames(tum):
        stamp = f"{time / 1e9:.6f}"
        lines.append(f"{stamp} {color_file.resolve()} {stamp} {depth_file.resolve()}\n")
    (out / "associations.txt").write_text("".join(lines))
    shutil.copy(tum / "camera.toml", out / "camera.toml")


FORMATS = {
    "mcap": mcap,
    "rosbag2-sqlite": lambda tum, out: rosbag2(tum, out, is_mcap=False, is_compressed=False),
    "rosbag2-zstd": lambda tum, out: rosbag2(tum, out, is_mcap=False, is_compressed=True),
    "rosbag2-mcap": lambda tum, out: rosbag2(tum, out, is_mcap=True, is_compressed=False),
    "rosbag1": rosbag1,
    "realsense": realsense,
    "open3d": open3d,
    "scannet": scannet,
    "bundlefusion": bundlefusion,
    "stray-scanner": stray_scanner,
    "associations": associations,
    "record3d": record3d,
}

if __name__ == "__main__":
    FORMATS[sys.argv[2]](Path(sys.argv[1]), Path(sys.argv[3]))
