"""Images within one file: spans of it, or members of a ZIP archive. Every size is checked before it is read."""

import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hickory_stream.errors import RecordingError

MAX_BYTES = 1 << 28
_LOCAL_HEAD = 30


@dataclass(frozen=True, kw_only=True, slots=True)
class FilePart:
    """An image within a file. `read` raises `RecordingError`."""

    file: Path
    name: str
    read: Callable[[], bytes]

    def __str__(self) -> str:
        return f"{self.file}: {self.name}"


ImageFile = Path | FilePart


def read_image_file(image: ImageFile) -> bytes:
    """Return the bytes of an image. Raises `RecordingError`: they cannot be read."""
    try:
        return image.read() if isinstance(image, FilePart) else image.read_bytes()
    except OSError as error:
        raise RecordingError(f"{image} cannot be read: {error.strerror}") from error


def span_of(file: Path, name: str, offset: int, size: int) -> FilePart:
    """Return a span of a file."""
    return FilePart(file=file, name=name, read=partial(_read_span, file, name, offset, size))


def members_of(file: Path) -> dict[str, FilePart]:
    """Return the members of a ZIP archive by name. Raises `RecordingError`: its directory cannot be read."""
    try:
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, struct.error) as error:
        raise RecordingError(
            f"{file} is a ZIP archive without its directory, which is at the end ({error}): it was cut off or damaged; "
            "copy it again"
        ) from error
    return {
        info.filename: FilePart(file=file, name=info.filename, read=partial(_read_member, file, info))
        for info in infos
        if not info.is_dir()
    }


def _read_span(file: Path, name: str, offset: int, size: int) -> bytes:
    if 0 <= size <= MAX_BYTES:
        with file.open("rb") as stream:
            stream.seek(offset)
            data = stream.read(size)
        if len(data) == size:
            return data
    raise RecordingError(f"{file}: {name} of {size} bytes is cut off or damaged")


def _read_member(file: Path, info: zipfile.ZipInfo) -> bytes:
    # Read by place, since `zipfile` would read the whole directory again for every image.
    what = f"{file}: {info.filename}"
    head = _read_span(file, info.filename, info.header_offset, _LOCAL_HEAD)
    start = info.header_offset + _LOCAL_HEAD + sum(struct.unpack_from("<HH", head, 26))
    data = _read_span(file, info.filename, start, info.compress_size)
    if info.compress_type == zipfile.ZIP_DEFLATED and info.file_size <= MAX_BYTES:
        try:
            data = zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, info.file_size + 1)
        except zlib.error as error:
            raise RecordingError(f"{what} is damaged: {error}") from error
    if len(data) != info.file_size or zlib.crc32(data) != info.CRC:
        raise RecordingError(f"{what} is damaged: its size or checksum is not the one in the archive's directory")
    return data
