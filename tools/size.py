"""`tools/check --size`: how large the code base is, against the limits that it keeps to."""

import dataclasses
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hickory_stream.settings import Settings
from tools.readmes import READMES, RESULTS, ROOT

# Where tools/test notes the processor time of its last whole run.
TEST_TIMES = ROOT / ".venv" / "test-times"


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class Measure:
    """A figure of the code base; `value` is None where it was not measured."""

    name: str
    value: float | None
    limit: float

    @property
    def is_kept(self) -> bool:
        """Whether the figure is within its limit, or not known."""
        return self.value is None or self.value <= self.limit


def measures() -> Iterator[Measure]:
    product, players, tools, tests = (sources(name) for name in ("hickory_stream", "players", "tools", "tests"))
    yield Measure(name="files of hickory_stream", value=len(product), limit=520)
    yield Measure(name="lines of hickory_stream", value=lines(product), limit=78_000)
    yield Measure(
        name="lines of hickory_stream, players and tools", value=lines(product + players + tools), limit=110_000
    )
    folders = [file.parent for file in product + players + tools]
    yield Measure(name="most files flat in one folder", value=max(map(folders.count, set(folders))), limit=25)
    yield Measure(name="lines of tools/benchmarks", value=lines(sources("tools/benchmarks")), limit=9_500)
    yield Measure(name="configuration keys", value=len(list(keys(Settings()))), limit=160)
    yield Measure(
        name="words of READMEs",
        value=sum(len(file.read_text(encoding="utf-8").split()) for file in READMES if file not in RESULTS),
        limit=16_000,
    )
    yield Measure(name="lines of tests", value=lines(tests), limit=42_000)
    yield Measure(name="processor minutes of the last whole tools/test", value=test_minutes(), limit=14)


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def lines(files: Iterable[Path]) -> int:
    return sum(file.read_bytes().count(b"\n") for file in files)


def keys(config: Any, where: str = "") -> Iterator[str]:
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from keys(value, f"{where}{field.name}.")
        else:
            yield f"{where}{field.name}"


def test_minutes() -> float | None:
    """Return the processor time of the last whole run of the tests, as bash's `times` printed it."""
    if not TEST_TIMES.is_file():
        return None
    found = re.findall(r"(\d+)m([\d.]+)s", TEST_TIMES.read_text(encoding="utf-8").splitlines()[-1])
    return sum(int(minutes) + float(seconds) / 60 for minutes, seconds in found)


def main() -> int:
    """Print the figures; return 1 where one is over its limit."""
    found = list(measures())
    for measure in found:
        shown = "not measured" if measure.value is None else f"{measure.value:,.0f}"
        print(f"{measure.name:48} {shown:>12}  at most {measure.limit:,.0f}{'' if measure.is_kept else '  OVER'}")
    return 0 if all(measure.is_kept for measure in found) else 1


if __name__ == "__main__":
    sys.exit(main())
