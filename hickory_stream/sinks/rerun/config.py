"""The configuration of the Rerun sink."""

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class RerunConfig(Ranged):
    """What is shown, and how much of it."""

    #: Size at which the file gets no more images, clouds and meshes; half of it ends colour between keyframes.
    rrd_cap_mb: float = number(1000.0, 0.001, 1e7, "MB")
    #: A larger cloud is thinned evenly.
    max_points_per_object: int = number(3000, 1, 100_000_000, "points")
    #: Every n-th colour frame between keyframes is logged; keyframes always are.
    color_every: int = number(1, 1, 1_000_000, "frames")
    #: Quality of thumbnails, and of colour for logs without compressed colour.
    jpeg_quality: int = number(80, 1, 100, "percent")
    #: Entries that wait for the viewer; one is a heavy item, or all light ones of a frame.
    live_queue_length: int = number(256, 1, 1_000_000, "entries")
    #: Side of the textures that layer 2 gets when the run ends, 0: none; 512 takes about 0.3 s and 35 KB an object.
    texture_px: int = number(0, 0, 8192, "px")
    #: What a viewer or server that is started here may keep for those who connect late.
    server_memory_limit: str = "512MiB"
    #: Where a viewer or server that is started here listens.
    bind: str = "127.0.0.1"
