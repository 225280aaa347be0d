"""What the tests of the engine share: one undisturbed run of the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.engine.run_fixtures import map_scene

if TYPE_CHECKING:
    from tests.engine.run_fixtures import SceneRun


@pytest.fixture(scope="session")
def undisturbed_run(tmp_path_factory: pytest.TempPathFactory) -> SceneRun:
    """The run of the scene by one worker, which nobody disturbs; its folder is not to be changed."""
    return map_scene(tmp_path_factory.mktemp("undisturbed"), child_workers=True)
