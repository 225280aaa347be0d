"""`tools/check --platforms`: whether the lock can be installed from wheels alone on the machines that a robot has."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

MACHINES = ("x86_64", "aarch64")
PYTHONS = ("3.11", "3.12", "3.13")
_LOCK = Path(__file__).resolve().parents[1] / "requirements.lock"


def obstacle(machine: str, python: str, lock: Path = _LOCK, *options: str) -> str:
    """Return uv's reason why the lock cannot be installed there, with the markers of that machine; empty if it can."""
    command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--only-binary", ":all:", "-o", os.devnull]
    # Without looking for a Python of that version, here and in the net.
    command += ["--python", sys.executable, "--no-python-downloads"]
    command += ["--python-version", python, "--python-platform", f"{machine}-manylinux_2_39", *options, str(lock)]
    asked = subprocess.run(command, capture_output=True, text=True, check=False)
    return " ".join(asked.stderr.split()) if asked.returncode else ""


def main() -> int:
    """Ask for every machine and Python; return 1 where something has no wheel."""
    parser = argparse.ArgumentParser(prog="tools/check --platforms")
    parser.add_argument("--machine", choices=MACHINES, action="append", help="only this one")
    parser.add_argument("--python", choices=PYTHONS, action="append", help="only this one")
    options = parser.parse_args()
    status = 0
    for machine in options.machine or MACHINES:
        for python in options.python or PYTHONS:
            found = obstacle(machine, python)
            print(f"Linux {machine}, Python {python}: {found or 'every package has a wheel'}", flush=True)
            status |= bool(found)
    return status


if __name__ == "__main__":
    sys.exit(main())
