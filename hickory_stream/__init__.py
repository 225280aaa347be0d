"""hickory-stream: posed RGB-D frames in, a map of objects with four layers out."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hickory-stream")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"
