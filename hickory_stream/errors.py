"""The exception tree: every error raised on purpose.

    HickoryError                    exit status 1: a failure of our own
    |-- InputError                  exit status 2: an invalid input
    |   |-- ConfigError             a key, a value or a file of the configuration
    |   |   `-- RangeError          a number outside of its range
    |   |-- RecordingError          a log that cannot be read or mapped
    |   |   |-- NoPosesError        a log without poses, for odometry
    |   |   |-- EmptyMapError       a log of which nothing could be mapped; exit status 3
    |   |   `-- UnknownLogError     a path that is no log of a known kind
    |   |-- CalibrationError        missing intrinsics or extrinsics, or a contradiction to the images
    |   |-- MapFolderError          a map folder that cannot be written, opened or overwritten
    |   |-- ModelError              a network that is missing, damaged, of another kind, or cannot run here
    |   |-- ViewerError             a requested viewer that is missing
    |   `-- OutputError             a requested file that could not be completed
    |-- WorkerError                 a shape worker that did not start or broke its protocol
    `-- InvariantError              a contradiction in the map's state, found with --debug

A message names what was found, what was expected, and what to do.
"""

from collections.abc import Mapping
from typing import Any


class HickoryError(Exception):
    """Base of every error raised on purpose; `exit_status` is what the command line returns for it."""

    exit_status = 1


class InputError(HickoryError):
    """An invalid input of the caller."""

    exit_status = 2


class ConfigError(InputError):
    """A refused key, value or file of the configuration."""


class RangeError(ConfigError, ValueError):
    """A number of a configuration that is outside of its range; a `ValueError`, as constructors raise it."""


class RecordingError(InputError):
    """A log that cannot be read or mapped; `fixes` are lines of a profile that would mend it."""

    fixes: Mapping[str, Any] = {}


class NoPosesError(RecordingError):
    """A log without poses; odometry can estimate them."""


class EmptyMapError(RecordingError):
    """A log that was read to its end, and of which nothing could be mapped."""

    exit_status = 3


class UnknownLogError(RecordingError):
    """A path that is no log of a known kind; `nearest` says, a line each, what similar layouts lack."""

    def __init__(self, found: str, nearest: tuple[str, ...] = ()) -> None:
        super().__init__("; ".join((found, *nearest)))
        self.found, self.nearest = found, nearest


class CalibrationError(InputError):
    """Missing intrinsics or extrinsics, or a contradiction to the images."""


class MapFolderError(InputError):
    """A map folder that cannot be written, opened or overwritten."""


class ModelError(InputError):
    """A network that is missing, damaged, of another kind, or cannot run here."""


class ViewerError(InputError):
    """A requested viewer that is missing."""


class OutputError(InputError):
    """A requested file that could not be completed."""


class WorkerError(HickoryError):
    """A shape worker that did not start, or broke its protocol."""


class InvariantError(HickoryError):
    """A contradiction in the map's state: a defect of the mapping."""
