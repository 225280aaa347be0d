"""Shared settings: hypothesis without deadlines (the first call of a numba kernel compiles it), places of real data."""

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("default", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("default")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def demo_log() -> Path:
    return ROOT / "recordings" / "demo.mcap"


@pytest.fixture(scope="session")
def demo_truth() -> Path:
    return ROOT / "recordings" / "demo.truth"


@pytest.fixture(scope="session")
def redkitchen() -> Path:
    folder = ROOT.parent / "shared" / "data" / "redkitchen"
    if not folder.is_dir():
        pytest.skip(f"needs the 7-Scenes frames in {folder.name} beside the checkout")
    return folder
