"""The exception tree: everything that we raise on purpose.

    HickoryError                    exit status 1: our own failure
    |-- InputError                  exit status 2: something outside is not as it must be
    |   |-- ConfigError             a key, a value or a file of the configuration
    |   |   `-- RangeError          a number outside of its range
    |   |-- RecordingError          a log that cannot be read or lacks what mapping needs
    |   |   `-- NoPosesError        a log that has no poses at all: odometry can estimate them
    |   |-- CalibrationError        intrinsics or extrinsics that are missing or contradict the images
    |   |-- MapFolderError          a map folder that cannot be written, opened or overwritten
    |   |-- ModelError              a network that is missing, damaged, of another kind, or cannot run here
    |   |-- ViewerError             a viewer that was asked for and cannot be had
    |   `-- OutputError             a file that was asked for and could not be written to its end
    |-- GraphError                  a pose graph whose solution does not determine what is asked of it
    |-- WorkerError                 a shape worker that could not be started or broke its protocol
    `-- InvariantError              the map's state contradicts itself, as checks with --debug have found

A message names what was found, what was expected, and what to do.
"""

from __future__ import annotations


class HickoryError(Exception):
    """Base of every error raised on purpose; `exit_status` is what the command line returns for it."""

    exit_status = 1


class InputError(HickoryError):
    """Something that the caller gave us is not as it must be."""

    exit_status = 2


class ConfigError(InputError):
    """A configuration key, value or file that is refused."""


class RangeError(ConfigError, ValueError):
    """A number of a configuration that is outside of its range; a `ValueError`, as constructors raise it."""


class RecordingError(InputError):
    """A log that cannot be read, or that lacks what mapping needs."""


class NoPosesError(RecordingError):
    """A log that has no poses at all: odometry can estimate them."""


class CalibrationError(InputError):
    """Intrinsics or extrinsics that are missing or contradict the images."""


class MapFolderError(InputError):
    """A map folder that cannot be written, opened or overwritten."""


class ModelError(InputError):
    """A network that is missing, damaged, of another kind, or that cannot run here."""


class ViewerError(InputError):
    """A viewer that was asked for and cannot be had."""


class OutputError(InputError):
    """A file that was asked for, and that could not be written to its end."""


class WorkerError(HickoryError):
    """A shape worker that could not be started, or that broke its protocol."""


class GraphError(HickoryError):
    """A pose graph whose solution does not determine what is asked of it."""


class InvariantError(HickoryError):
    """The state of the map contradicts itself: a defect of the mapping, found by its checks."""
