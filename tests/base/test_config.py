import dataclasses
import json
import tomllib
from typing import get_args, get_type_hints
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hickory_stream.base.config_text import from_dict, read_config, to_toml
from hickory_stream.base.former_keys import FORMER_KEYS, fixed_keys, with_current_names
from hickory_stream.base.ranges import ranges_of
from hickory_stream.config import MapperConfig, RunConfig, as_far_as_known
from hickory_stream.errors import ConfigError
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.settings import SET_OFTEN, Settings


def leaves(kind, where=""):
    """Return the path and the type of every value of a configuration."""
    found = []
    for name, hint in get_type_hints(kind).items():
        found += leaves(hint, f"{where}{name}.") if dataclasses.is_dataclass(hint) else [(where + name, hint)]
    return found


def value_at(config, path):
    for name in path.split("."):
        config = getattr(config, name)
    return config


LEAVES = leaves(Settings)


def values_of(path, hint):
    if hint is bool:
        return st.booleans()
    if hint in (int, float):
        section, _, key = path.rpartition(".")
        told = ranges_of(type(value_at(Settings(), section)))[key]
        return st.integers(told.low, told.high) if hint is int else st.floats(told.low, told.high)
    if get_args(hint):
        return st.sampled_from(get_args(hint))
    return st.text()


@st.composite
def settings(draw):
    """Draw settings that differ from the defaults in a few values; those that their owner refuses are left out."""
    data = {}
    for path, hint in draw(st.lists(st.sampled_from(LEAVES), max_size=8, unique_by=lambda leaf: leaf[0])):
        *sections, key = path.split(".")
        at = data
        for section in sections:
            at = at.setdefault(section, {})
        at[key] = draw(values_of(path, hint))
    try:
        return from_dict(Settings, data)
    except ConfigError:
        assume(False)
        raise


@pytest.fixture
def file(tmp_path):
    return tmp_path / "robot.toml"


def refusal(file, text, kind=Settings):
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_config(kind, file)
    return str(caught.value)


def test_no_file_and_the_defaults_written_out_give_the_defaults(file):
    assert read_config(Settings, None) == Settings()
    file.write_text(to_toml(Settings()))
    assert read_config(Settings, file) == Settings()


@given(written=settings())
@example(written=from_dict(Settings, {"mapper": {"run": {"worker_python": 'tab\t, quote", \x1f and \x7f'}}}))
def test_what_is_written_is_read_back(tmp_path_factory, written):
    file = tmp_path_factory.getbasetemp() / "written.toml"
    file.write_text(to_toml(written), encoding="utf-8")
    assert read_config(Settings, file) == written


def test_every_value_is_written_out():
    lines = to_toml(Settings()).splitlines()
    assert sum(" = " in line and not line.startswith("#") for line in lines) == sum(
        value_at(Settings(), path) is not None for path, _ in LEAVES
    )


def test_a_file_names_what_differs_and_an_override_wins(file):
    file.write_text("[mapper.keyframes]\nmin_interval_s = 1\n")
    read = read_config(Settings, file)
    assert read.mapper.keyframes.min_interval_s == 1.0
    assert isinstance(read.mapper.keyframes.min_interval_s, float)
    assert read.mapper.mapping == Settings().mapper.mapping
    file.write_text("[mapper.run]\nworkers = 3\ncrop_margin = 0.2\n")
    run = read_config(Settings, file, ("mapper.run.workers=5",)).mapper.run
    assert (run.workers, run.crop_margin) == (5, 0.2)


@pytest.mark.parametrize("text", ["max_area", '"max_area"', " 'max_area'"])
def test_a_word_may_be_given_bare_or_quoted(text):
    read = read_config(Settings, None, (f"mapper.mapping.views.strategy={text}",))
    assert read.mapper.mapping.views.strategy == "max_area"


@given(st.sampled_from([leaf for leaf in LEAVES if leaf[1] in (int, float)]))
def test_every_number_can_be_overridden_by_its_path(leaf):
    path, _ = leaf
    default = value_at(Settings(), path)
    assert value_at(read_config(Settings, None, (f"{path}={default!r}",)), path) == default


@pytest.mark.parametrize("override", ["mapper.run.workers", "=3", "", "  =1"])
def test_an_invalid_override_is_refused_with_an_example(override):
    with pytest.raises(ConfigError, match=r"found the override .*expected SECTION\.KEY=VALUE"):
        read_config(Settings, None, (override,))


def test_an_override_below_a_value_is_refused():
    with pytest.raises(ConfigError, match="workers is a value, not a section"):
        read_config(Settings, None, ("mapper.run.workers=2", "mapper.run.workers.count=3"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[mapper.keyframes]\nmin_intervall_s = 1.0", "did you mean mapper.keyframes.min_interval_s?"),
        ("[maper.run]\nworkers = 1", "unknown configuration key maper; did you mean mapper?"),
        ("[mapper.run]\nzebra = 1", "known keys: accept_licence, cluster, "),
    ],
)
def test_a_misspelt_key_is_refused_with_the_nearest_one(file, text, told):
    assert told in refusal(file, text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[mapper.perception.observe]\nvoxel_m = 0.02", "set mapper.mapping.voxels.object_m"),
        ("[mapper.mapping.track]\nvoxel_m = 0.02", "set mapper.mapping.voxels.object_m"),
        ("[mapper.perception.space]\nvoxel_m = 0.1", "set mapper.mapping.voxels.space_m"),
        ("[mapper.mapping]\nspace_voxel_m = 0.1", "set mapper.mapping.voxels.space_m"),
        ("[mapper.mapping.lattice]\npoints_m = 0.02", "set mapper.mapping.voxels.object_m"),
        ("[mapper.mapping.parts]\nmin_apart = 3", "set mapper.mapping.split"),
        ("[mapper.run]\nlate_s = 3", "mapper.run.late_s is no setting any more: set mapper.run.max_late_s"),
        ("[mapper.mapping.views]\nbetter_by = 2", "views.better_by is no setting any more: it is fixed at 1.4 now"),
        ("[mapper.mapping.merge]\nmin_votes = 4", "observation counts now, by mapping.merge.min_together_s"),
        ("[mapper.mapping.support]\nlevel_m = 0.2", "support.level_m is no setting any more: it is fixed at 0.15 now"),
    ],
)
def test_a_key_of_an_earlier_version_is_refused_with_the_new_one(file, text, told):
    assert told in refusal(file, text)


@pytest.mark.parametrize("old", [*FORMER_KEYS, *fixed_keys()])
def test_a_former_key_is_refused_and_is_none_today(file, old):
    section, _, key = f"mapper.{old}".rpartition(".")
    assert refusal(file, f"[{section}]\n{key} = 1").startswith(f"mapper.{old} is no setting any more: ")
    with pytest.raises(AttributeError):
        value_at(MapperConfig(), old)


@pytest.mark.parametrize("instead", [text for text in FORMER_KEYS.values() if text.startswith("set ")])
def test_what_to_set_instead_of_a_former_key_is_a_key(instead):
    assert value_at(MapperConfig(), instead.removeprefix("set ")) is not None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('[mapper.run]\nworkers = "two"', "mapper.run.workers is 'two'; expected int"),
        ("[mapper.run]\nworkers = 1.5", "mapper.run.workers is 1.5; expected int"),
        ("[mapper.run]\nworkers = true", "mapper.run.workers is True; expected int"),
        ("[mapper.run]\ngrace_s = false", "mapper.run.grace_s is False; expected float"),
        ("[mapper]\nrun = 3", "mapper.run is a section, found 3"),
        ("[rerun]\nbind = 1", "rerun.bind is 1; expected str"),
        ('[mapper.mapping.views]\nstrategy = "best"', "expected one of 's_score', 'initial', 'max_area'"),
        ('[mapper.shapes]\nreconstructor = "sam"', "expected one of 'fused', 'single_view'"),
    ],
)
def test_a_value_of_the_wrong_type_is_refused_with_the_right_one(file, text, told):
    assert told in refusal(file, text)


@pytest.mark.parametrize(
    "text",
    [
        "[mapper.run]\nworkers = 0",
        "[mapper.run]\nworkers = -1",
        "[mapper.run]\njob_timeout_s = 0.0",
        "[mapper.run]\njob_timeout_s = nan",
        "[mapper.run]\ncrop_margin = -0.1",
        "[mapper.run]\ntime_jump_s = 0.0",
        "[mapper.run]\ngrace_s = -1.0",
        "[disk]\nevery_keyframes = 0",
        "[rerun]\njpeg_quality = 101",
    ],
)
def test_a_value_that_its_owner_refuses_is_named(file, text):
    assert text.split("\n")[1].split(" ")[0] in refusal(file, text)


def test_no_toml_and_a_missing_file_are_refused(file, tmp_path):
    assert "is not TOML" in refusal(file, "[mapper\n")
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="is not TOML"):
        read_config(Settings, file)
    with pytest.raises(ConfigError, match=r"cannot read the configuration .*none\.toml: No such file"):
        read_config(Settings, tmp_path / "none.toml")


def test_the_mappers_section_is_read_alone_and_from_a_manifest(file):
    file.write_text("[run]\nworkers = 2\n")
    assert read_config(MapperConfig, file) == MapperConfig(run=RunConfig(workers=2))
    config = MapperConfig()
    assert from_dict(MapperConfig, json.loads(json.dumps(dataclasses.asdict(config)))) == config


def test_a_file_of_another_version_is_read_as_far_as_known():
    data = json.loads(json.dumps(dataclasses.asdict(MapperConfig())))
    data["mapping"]["lifecycle"]["confirm_s"] = 7.0
    data["mapping"]["lifecycle"]["colour_of_the_moon"] = 3
    data["mapping"]["voxels"]["space_m"] = "coarse"
    data["run"]["workers"] = -5
    del data["perception"]
    found = as_far_as_known(data)
    assert found.mapping.lifecycle.confirm_s == 7.0
    assert found.mapping.voxels == MapperConfig().mapping.voxels
    assert (found.run, found.perception) == (RunConfig(), MapperConfig().perception)


@pytest.mark.parametrize(
    "old",
    [
        {"mapping": {"track": {"voxel_m": 0.02}, "space_voxel_m": 0.1}},
        {"mapping": {"lattice": {"points_m": 0.02, "space_m": 0.1}}},
    ],
)
def test_the_voxels_of_an_older_map_keep_their_sizes(old):
    assert as_far_as_known(old).mapping.voxels == Lattice(object_m=0.02, space_m=0.1)
    assert from_dict(MapperConfig, with_current_names(old)).mapping.voxels == Lattice(object_m=0.02, space_m=0.1)


def test_an_older_configuration_loses_what_is_constant_now():
    old = {"split": {"min_apart_s": 3.0, "apart_ratio": 2}, "support": {"level_m": 0.15}}
    assert from_dict(MapperConfig, with_current_names({"mapping": old})).mapping.split.min_apart_s == 3.0
    old["support"]["level_m"] = 0.2
    with pytest.raises(ConfigError, match=r"mapping.support.level_m .* it is fixed at 0.15 now"):
        from_dict(MapperConfig, with_current_names({"mapping": old}))


@pytest.mark.parametrize(
    ("section", "key", "usual"),
    [("lifecycle", "confirm_sightings", 4), ("existence", "new_view_gain", 2.0), ("merge", "min_votes", 3)],
)
def test_counts_of_an_older_configuration_do_not_become_seconds(section, key, usual):
    assert from_dict(MapperConfig, with_current_names({"mapping": {section: {key: usual}}})) == MapperConfig()
    assert as_far_as_known({"mapping": {section: {key: 9}}}) == MapperConfig()
    with pytest.raises(ConfigError, match=f"{key} is no setting any more: time of observation counts now"):
        from_dict(MapperConfig, with_current_names({"mapping": {section: {key: 9}}}))


def test_the_shapes_of_an_older_configuration_are_read_alone():
    old = {"judgement": {"min_explained": 0.67}, "fit": {"cells": 16, "num_rounds": 1}}
    assert with_current_names(old, "shapes.") == {"fit": {"cells": 16}}


def test_there_are_no_more_keys_than_can_be_read_in_five_minutes():
    assert len(LEAVES) <= 160


def test_the_sections_that_users_set_stand_first():
    text = to_toml(Settings(), SET_OFTEN)
    headings = [line.strip("[]") for line in text.splitlines() if line.startswith("[")]
    assert tuple(headings[: len(SET_OFTEN)]) == SET_OFTEN
    assert from_dict(Settings, tomllib.loads(text)) == Settings()
