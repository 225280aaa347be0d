"""Foxglove's own messages, as protobuf or JSON, converted to objects with the fields of ROS messages."""

import base64
import json
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from players.messages.records import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, POSE, TF

ROS_TYPES = {
    "foxglove.CompressedImage": COMPRESSED_IMAGE,
    "foxglove.CompressedVideo": COMPRESSED_IMAGE,
    "foxglove.RawImage": IMAGE,
    "foxglove.CameraCalibration": CAMERA_INFO,
    "foxglove.PoseInFrame": POSE,
    "foxglove.FrameTransform": TF[0],
    "foxglove.FrameTransforms": TF[0],
}
"""The equivalent ROS message of each Foxglove message."""


def decode_foxglove(name: str, wire: str, definition: str, data: Any) -> Any:
    """Return a message as its equivalent ROS message.

    Raises `ValueError`: the bytes do not fit the type; `KeyError`: a field is missing.
    """
    fields = json.loads(bytes(data)) if wire == "json" else _protobuf(name, definition, bytes(data))
    if not isinstance(fields, dict):
        raise ValueError("no object")
    return _as_ros(name, fields)


def _protobuf(name: str, definition: str, data: bytes) -> Any:
    from google.protobuf.json_format import MessageToDict
    from google.protobuf.message import DecodeError

    message = _message_class(name, definition)()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise ValueError(str(error)) from error
    # Bytes are copied directly: the conversion to a dictionary would encode them as base64.
    content = getattr(message, "data", None)
    if isinstance(content, bytes):
        message.ClearField("data")
    fields = MessageToDict(message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
    if message.DESCRIPTOR.fields_by_name.get("timestamp"):
        fields["timestamp"] = {"sec": message.timestamp.seconds, "nsec": message.timestamp.nanos}
    if name == "foxglove.FrameTransforms":
        for entry, transform in zip(fields.get("transforms", []), message.transforms, strict=True):
            entry["timestamp"] = {"sec": transform.timestamp.seconds, "nsec": transform.timestamp.nanos}
    if isinstance(content, bytes):
        fields["data"] = content
    return fields


@lru_cache(maxsize=64)
def _message_class(name: str, definition: str) -> Any:
    from google.protobuf import descriptor_pool, message_factory
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.message import DecodeError

    try:
        files = FileDescriptorSet.FromString(definition.encode("latin-1"))
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    except (DecodeError, TypeError, KeyError) as error:
        raise ValueError(f"descriptors of {name}: {error}") from error


def _as_ros(name: str, fields: Any) -> Any:
    match name:
        case "foxglove.CompressedImage" | "foxglove.CompressedVideo":
            return SimpleNamespace(header=_header(fields), format=fields["format"], data=_bytes(fields["data"]))
        case "foxglove.RawImage":
            return SimpleNamespace(
                header=_header(fields),
                width=int(fields["width"]),
                height=int(fields["height"]),
                encoding=fields["encoding"],
                step=int(fields["step"]),
                is_bigendian=0,
                data=_bytes(fields["data"]),
            )
        case "foxglove.CameraCalibration":
            return SimpleNamespace(
                header=_header(fields),
                width=int(fields["width"]),
                height=int(fields["height"]),
                distortion_model=fields.get("distortion_model", ""),
                d=fields.get("D", []),
                k=fields["K"],
                p=fields.get("P") or [0.0] * 12,
            )
        case "foxglove.PoseInFrame":
            place, rotation = _numbers(fields["pose"]["position"]), _numbers(fields["pose"]["orientation"], w=1.0)
            return SimpleNamespace(header=_header(fields), pose=SimpleNamespace(position=place, orientation=rotation))
        case "foxglove.FrameTransform":
            return SimpleNamespace(transforms=[_transform(fields)])
        case "foxglove.FrameTransforms":
            return SimpleNamespace(transforms=[_transform(entry) for entry in fields["transforms"]])
    raise ValueError(f"{name} stands for no message of ROS")


def _header(fields: Any, frame: str = "frame_id") -> Any:
    stamp = SimpleNamespace(sec=int(fields["timestamp"]["sec"]), nanosec=int(fields["timestamp"]["nsec"]))
    return SimpleNamespace(stamp=stamp, frame_id=fields.get(frame, ""))


def _transform(fields: Any) -> Any:
    translation, rotation = _numbers(fields["translation"]), _numbers(fields["rotation"], w=1.0)
    return SimpleNamespace(
        header=_header(fields, "parent_frame_id"),
        child_frame_id=fields.get("child_frame_id", ""),
        transform=SimpleNamespace(translation=translation, rotation=rotation),
    )


def _numbers(fields: Any, **defaults: float) -> Any:
    return SimpleNamespace(**{"x": 0.0, "y": 0.0, "z": 0.0, **defaults, **{k: float(v) for k, v in fields.items()}})


def _bytes(data: Any) -> Any:
    return np.frombuffer(base64.b64decode(data, validate=True) if isinstance(data, str) else data, dtype=np.uint8)
