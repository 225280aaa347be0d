"""The configuration of the Rerun sink."""

from __future__ import annotations

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class RerunConfig(Ranged):
    """What is shown, and how much of it.

    Attributes:
        rrd_cap_mb: the size at which the file gets no more images, clouds and meshes.
        max_points_per_object: a larger cloud is thinned evenly.
        cloud_period_s: a growing cloud is logged at most this often.
        color_every: every n-th colour frame between keyframes is logged; keyframes always are.
        jpeg_quality: for logs without compressed colour, and for thumbnails.
        structure_every: floor and walls are logged every n-th keyframe.
        live_queue_length: entries that wait for the viewer; one is a heavy item, or all light ones of a frame.
        texture_px: the side of the textures that layer 2 gets when the run ends, 0 for none; about 0.3 s of processor
            time and 35 KB an object at 512.
        server_memory_limit: what a viewer or server that we start may keep for those who connect late.
        bind: where a viewer or server that we start listens.
    """

    rrd_cap_mb: float = number(1000.0, 0.001, 1e7, "MB")
    max_points_per_object: int = number(3000, 1, 100_000_000, "points")
    cloud_period_s: float = number(1.0, 0, 86400, "s")
    color_every: int = number(1, 1, 1_000_000, "frames")
    jpeg_quality: int = number(80, 1, 100, "percent")
    structure_every: int = number(20, 1, 1_000_000, "keyframes")
    live_queue_length: int = number(256, 1, 1_000_000, "entries")
    texture_px: int = number(0, 0, 8192, "px")
    server_memory_limit: str = "512MiB"
    bind: str = "127.0.0.1"
