"""Published weights of the paper's networks: address, size, sha256 and licence of each file, and how they are fetched.

A file is accepted by its hash only, whether it comes from its publisher, a mirror or a folder.
"""

import http.client
import shutil
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hickory_stream.errors import ModelError
from hickory_stream.perception.models.library import Kind, sha256_of

_TIMEOUT_S = 60
_BLOCK = 1 << 20


@dataclass(frozen=True, kw_only=True, slots=True)
class PublishedFile:
    """One file of published weights."""

    name: str
    num_bytes: int
    sha256: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Published:
    """The published weights of a network; its files lie at `address`/name. `name` is the network's in the library."""

    name: str
    kind: Kind
    licence: str
    address: str
    files: tuple[PublishedFile, ...]
    #: What the licence asks for, if it asks for much.
    licence_note: str = ""

    @property
    def num_bytes(self) -> int:
        """Size of all files."""
        return sum(file.num_bytes for file in self.files)

    @property
    def source(self) -> str:
        """Origin for the manifest: the largest file with its hash."""
        main = max(self.files, key=lambda file: file.num_bytes)
        return f"{self.address}/{main.name} (sha256 {main.sha256})"


def _file(name: str, num_bytes: int, sha256: str) -> PublishedFile:
    return PublishedFile(name=name, num_bytes=num_bytes, sha256=sha256)


def _fastsam(name: str, file: PublishedFile) -> Published:
    return Published(
        name=name,
        kind="fastsam",
        licence="AGPL-3.0 (ultralytics)",
        licence_note="AGPL: a product or network service with it must offer its whole source to its users; ultralytics "
        "sells other licences",
        address="https://github.com/ultralytics/assets/releases/download/v8.4.0",
        files=(file,),
    )


PUBLISHED: dict[str, Published] = {
    "fastsam-s": _fastsam(
        "fastsam-s",
        _file("FastSAM-s.pt", 23_851_578, "c9f78716a81c7aff0d608ccc73e1b82ab3aaad86005049f6a92106a0be6d0844"),
    ),
    "fastsam-x": _fastsam(
        "fastsam-x",
        _file("FastSAM-x.pt", 144_972_346, "752cadc2828edb1cd4bc4f9eb587100631af06ea2108f4c9ed56df4755701e76"),
    ),
    "dinov2-small": Published(
        name="dinov2-small",
        kind="dinov2",
        licence="Apache-2.0 (Meta)",
        address="https://huggingface.co/facebook/dinov2-small/resolve/ed25f3a31f01632728cabb09d1542f84ab7b0056",
        files=(
            _file("config.json", 547, "1809f83e3bdb1609a501a610ad4a742f4fd8ae44d72ca4aa0df52d1f2ac8628d"),
            _file("model.safetensors", 88_249_960, "ae1e99fcefd534ed978cdeb8326f08030c96e28b7a81ffcbc98a857c84d14be1"),
        ),
    ),
    "oneformer-ade20k": Published(
        name="oneformer-ade20k-swin-tiny",
        kind="oneformer",
        licence="MIT (SHI Labs)",
        address="https://huggingface.co/shi-labs/oneformer_ade20k_swin_tiny/resolve/"
        "05f2812b1eccf9909b3897777450f8d68148cafc",
        files=(
            _file("config.json", 84_284, "091cbc7c980128ae63b2a15d882923f326f85926ef163adad00c24bd90228896"),
            _file("merges.txt", 524_619, "9fd691f7c8039210e0fced15865466c65820d09b63988b0174bfe25de299051a"),
            _file("pytorch_model.bin", 203_389_501, "909b07dbf4129c2bbb8df4498e35dcd46f305e3ec45329d3ff6d4f0360de27f3"),
            _file("vocab.json", 1_059_962, "e089ad92ba36837a0d31433e555c8f45fe601ab5c221d4f607ded32d9f7a4349"),
        ),
    ),
}
"""By the name of `models get`. Hashes agree between several public records of these files, each made by its users."""


def collect(
    model: Published, folder: Path, origin: str | None = None, progress: Callable[[int], None] = lambda _: None
) -> None:
    """Bring the files of a network into a folder, from its publisher, or an `origin`: a folder, or another address.

    A broken download continues where it ended. `progress` gets the number of bytes so far.

    Raises:
        ModelError: a file is missing, breaks off, or has another hash; it is then removed from `folder`.
    """
    address = model.address if origin is None else origin.rstrip("/")
    done = 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in model.files:
            target = folder / file.name

            def report(have: int, before: int = done) -> None:
                progress(before + have)

            if not (target.is_file() and sha256_of(target) == file.sha256):
                if "://" in address:
                    _fetch(f"{address}/{file.name}", target, file, report)
                else:
                    _copy(Path(address) / file.name, target, file)
            done += file.num_bytes
            progress(done)
    except OSError as error:
        raise ModelError(f"cannot keep the weights of {model.name} in {folder}: {error.strerror or error}") from error


def _copy(source: Path, target: Path, file: PublishedFile) -> None:
    if not source.is_file():
        raise ModelError(f"{source} is missing; --from needs a folder with the published file {file.name}")
    part = target.with_name(f"{file.name}.part")
    shutil.copyfile(source, part)
    _accept(part, target, file, str(source))


def _fetch(url: str, target: Path, file: PublishedFile, progress: Callable[[int], None]) -> None:
    part = target.with_name(f"{file.name}.part")
    is_whole, have, before, cause = False, _size(part), -1, ""
    # A connection that breaks is opened again while each one brings something.
    while not is_whole and before < have < file.num_bytes:
        before, cause = have, "the connection ended"
        try:
            is_whole = _append(url, part, have, file.num_bytes, progress)
        except urllib.error.HTTPError as error:
            if error.code == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
                break  # the server's file is shorter: its hash is refused
            text = f"{url} answers {error.code} {error.reason}; get {file.name} by hand, and use --from FOLDER"
            raise ModelError(text) from error
        except (OSError, http.client.HTTPException) as error:
            cause = str(getattr(error, "reason", error))
        have = _size(part)
    else:
        if not is_whole and have < file.num_bytes:
            what = f"broke off at {have} of {file.num_bytes} bytes" if have else "cannot be reached"
            then = "the same command continues there" if have else "without internet, use --from FOLDER"
            raise ModelError(f"{url} {what} ({cause}); {then}")
    _accept(part, target, file, url)


def _append(url: str, part: Path, have: int, most: int, progress: Callable[[int], None]) -> bool:
    # Returns whether the server sent all that it announced.
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})
    with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as response:
        continues = response.status == http.HTTPStatus.PARTIAL_CONTENT
        with part.open("ab" if continues else "wb") as stream:
            announced = stream.tell() + (response.length or most)
            while stream.tell() <= most and (block := response.read(_BLOCK)):
                stream.write(block)
                progress(min(stream.tell(), most))
            return stream.tell() >= min(announced, most)


def _accept(part: Path, target: Path, file: PublishedFile, origin: str) -> None:
    found = sha256_of(part)
    if found != file.sha256:
        part.unlink()
        raise ModelError(
            f"{origin} has sha256 {found}, expected {file.sha256}: it is damaged or another file; nothing was added"
        )
    part.replace(target)


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0
