import json
from dataclasses import asdict
import pytest
from hickory_stream.base.former_keys import FORMER_KEYS, fixed_keys
from hickory_stream.config import MapperConfig
from hickory_stream.errors import MapFolderError
from hickory_stream.map_folder.history.recorded_config import known_config, recorded_config
from hickory_stream.map_folder.writer import create_map_folder

RENAMED = (
    "mapping.lattice.points_m", "mapping.lattice.space_m", "registration.way_share", "run.late_s",
)  # fmt: skip


def section_of(data, path):
    *sections, name = path.split(".")
    for section in sections:
        data = data.setdefault(section, {})
    return data, name


@pytest.fixture
def earlier():
    """The default configuration with all keys that became constants, and some keys by their former names."""
    data = json.loads(json.dumps(asdict(MapperConfig())))
    for path, value in fixed_keys().items():
        section, name = section_of(data, path)
        section[name] = value
    for path in RENAMED:
        old, old_name = section_of(data, path)
        new, new_name = section_of(data, FORMER_KEYS[path].removeprefix("set "))
        old[old_name] = new.pop(new_name)
    return data


def recorded(path, config):
    create_map_folder(path, config=config, source={}).close()
    return path


def test_an_earlier_configuration_is_todays(tmp_path, earlier):
    path = recorded(tmp_path / "map", earlier)
    assert recorded_config(path) == known_config(path) == MapperConfig()


def test_another_number_than_the_fixed_one_is_refused(tmp_path, earlier):
    earlier["mapping"]["support"]["level_m"] = 0.2
    path = recorded(tmp_path / "map", earlier)
    with pytest.raises(MapFolderError, match=r"mapping\.support\.level_m .* fixed at 0\.15 now; play the log again$"):
        recorded_config(path)
    assert known_config(path) == MapperConfig()


DEEP = {}
for _ in range(300):
    DEEP = {"mapping": DEEP}
PARTS = {"mapping": {"parts": {"min_apart": 1}, "split": 5}}


@pytest.mark.parametrize(
    "config", [{"mapping": 3}, {"mapping": {"lattice": 3}}, PARTS, DEEP], ids=["number", "section", "parts", "deep"]
)
def test_a_damaged_configuration_is_refused(tmp_path, config):
    path = recorded(tmp_path / "map", config)
    assert config is DEEP or known_config(path).run == MapperConfig().run
    with pytest.raises(MapFolderError, match="play the log again"):
        recorded_config(path)
