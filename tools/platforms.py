"""`tools/check --platforms`: whether every runtime dependency has a wheel for the machines that a robot has."""
# The package index is asked through pip (a dry run that installs nothing) for Linux on x86_64 and aarch64, Python 3.11
# to 3.13. Markers are evaluated for the machine that is asked for, which pip itself does not do.

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

_PROJECT = "hickory-stream"
MACHINES = ("x86_64", "aarch64")
PYTHONS = ("3.11", "3.12", "3.13")
_TAGS = ("manylinux_2_39", "manylinux_2_35", "manylinux_2_34", "manylinux_2_31", "manylinux_2_28", "manylinux_2_27")
_OLD_TAGS = ("manylinux_2_24", "manylinux_2_17", "manylinux2014", "manylinux_2_12", "manylinux2010", "manylinux1")
_TIMEOUT_S = 600


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of machine with a Python."""

    machine: str
    python: str

    def environment(self, extra: str = "") -> dict[str, str]:
        return {
            **{name: str(value) for name, value in default_environment().items()}, "sys_platform": "linux",
            "platform_system": "Linux", "platform_machine": self.machine, "python_version": self.python,
            "python_full_version": f"{self.python}.0", "extra": extra,
        }  # fmt: skip

    @property
    def name(self) -> str:
        return f"Linux {self.machine}, Python {self.python}"


def dependencies(target: Target) -> list[str]:
    """Return what the project needs there to run, and what that needs, as requirements sorted by name."""
    # What is not installed here (a dependency of another machine alone) is taken without its own.
    found: dict[str, Requirement] = {}
    waiting = [(_PROJECT, "")]
    seen: set[tuple[str, str]] = set()
    while waiting:
        owner, extra = waiting.pop()
        if (owner, extra) in seen:
            continue
        seen.add((owner, extra))
        try:
            asked = requires(owner) or []
        except PackageNotFoundError:
            continue
        for text in asked:
            requirement = Requirement(text)
            if requirement.marker is not None and not requirement.marker.evaluate(target.environment(extra)):
                continue
            name = canonicalize_name(requirement.name)
            if owner == _PROJECT or name not in found:
                found[name] = requirement
            waiting += [(name, ""), *((name, wanted) for wanted in requirement.extras)]
    return [f"{name}{found[name].specifier}" for name in sorted(found)]


def without_wheel(requirements: list[str], target: Target) -> list[str]:
    """Return those for which the index has no wheel; halves what fails until it is known which ones do."""
    if _has_wheels(requirements, target):
        return []
    if len(requirements) == 1:
        return requirements
    middle = len(requirements) // 2
    return without_wheel(requirements[:middle], target) + without_wheel(requirements[middle:], target)


def _has_wheels(requirements: list[str], target: Target) -> bool:
    with tempfile.TemporaryDirectory(prefix="hickory-platforms-") as folder:
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--no-deps", "--ignore-installed"]
        command += ["--quiet", "--only-binary=:all:", "--target", folder, "--python-version", target.python]
        for tag in (*_TAGS, *_OLD_TAGS):
            command += ["--platform", f"{tag}_{target.machine}"]
        asked = subprocess.run([*command, *requirements], capture_output=True, text=True, timeout=_TIMEOUT_S)
    return asked.returncode == 0


def main() -> int:
    """Ask for every machine and Python; return 1 where something has no wheel."""
    parser = argparse.ArgumentParser(prog="tools/check --platforms")
    parser.add_argument("--machine", choices=MACHINES, action="append", help="only this one")
    parser.add_argument("--python", choices=PYTHONS, action="append", help="only this one")
    options = parser.parse_args()
    status = 0
    for machine in options.machine or MACHINES:
        for python in options.python or PYTHONS:
            target = Target(machine, python)
            needed = dependencies(target)
            lacking = without_wheel(needed, target)
            told = f"no wheel of {', '.join(lacking)}" if lacking else "every one has a wheel"
            print(f"{target.name}: {len(needed)} dependencies, {told}", flush=True)
            status |= bool(lacking)
    return status


if __name__ == "__main__":
    sys.exit(main())
