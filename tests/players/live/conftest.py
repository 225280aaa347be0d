"""What waits for others to be done waits less here, where they are in the same process."""

import pytest


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch):
    monkeypatch.setattr("players.live.opening._QUIET_S", 0.15)
    monkeypatch.setattr("players.live.opening._BETWEEN_S", 0.05)
    monkeypatch.setattr("tools.robot.command._SETTLED_S", 0.15)
    monkeypatch.setattr("players.live.zenoh_route._AGAIN_S", 0.1)
    monkeypatch.setattr("players.live.foxglove_route._AGAIN_S", 0.1)
