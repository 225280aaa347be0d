import dataclasses
import json
import math
import re
import tomllib
from typing import get_args, get_type_hints
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.base.config_text import from_dict, read_config, to_toml
from hickory_stream.base.former_keys import FORMER_KEYS, fixed_keys, with_current_names
from hickory_stream.base.ranges import Ranged, check_order, number, ranges_of
from hickory_stream.config import MapperConfig, RunConfig, as_far_as_known
from hickory_stream.errors import ConfigError, RangeError
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.merging.merge_maps import MergeMapsConfig
from hickory_stream.navigation.robot import Part, Posture, Robot
from hickory_stream.navigation.search import SearchConfig
from hickory_stream.settings import SET_OFTEN, Settings
from players.options import SourceOptions
from players.poses.tracks import JumpLimits
from players.profile import Intrinsics, Profile


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
        # Of an earlier version.
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
        # Misspelt.
        ("[mapper.keyframes]\nmin_intervall_s = 1.0", "did you mean mapper.keyframes.min_interval_s?"),
        ("[maper.run]\nworkers = 1", "unknown configuration key maper; did you mean mapper?"),
        ("[mapper.run]\nzebra = 1", "known keys: accept_licence, cluster, "),
        # Of the wrong type.
        ('[mapper.run]\nworkers = "two"', "mapper.run.workers is 'two'; expected int"),
        ("[mapper.run]\nworkers = 1.5", "mapper.run.workers is 1.5; expected int"),
        ("[mapper.run]\nworkers = true", "mapper.run.workers is True; expected int"),
        ("[mapper.run]\ngrace_s = false", "mapper.run.grace_s is False; expected float"),
        ("[mapper]\nrun = 3", "mapper.run is a section, found 3"),
        ("[rerun]\nbind = 1", "rerun.bind is 1; expected str"),
        ('[mapper.mapping.views]\nstrategy = "best"', "expected one of 's_score', 'initial', 'max_area'"),
        ('[mapper.shapes]\nreconstructor = "sam"', "expected one of 'fused', 'single_view'"),
        # Out of the range that its owner has.
        ("[disk]\nevery_keyframes = 0", "disk.every_keyframes is 0; expected 1 to "),
    ],
)
def test_what_is_no_key_or_value_is_refused_with_what_is_one(file, text, told):
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


@pytest.mark.parametrize("old", [
    {"mapping": {"track": {"voxel_m": 0.02}, "space_voxel_m": 0.1}},
    {"mapping": {"lattice": {"points_m": 0.02, "space_m": 0.1}}},
])  # fmt: skip
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


ROOTS = (Settings, AlignConfig, MergeMapsConfig, SearchConfig)
SUFFIXES = {"m": "m", "m2": "m2", "m3": "m3", "s": "s", "deg": "deg", "rad": "rad", "ns": "ns", "px": "px", "mb": "MB"}
SUFFIXES |= {"share": "share", "sightings": "sightings", "primitives": "primitives", "cells": "cells"}


def kinds_below(kind):
    hints = get_type_hints(kind).values()
    return {kind}.union(*(kinds_below(hint) for hint in hints if dataclasses.is_dataclass(hint)))


# What the files of robots and of profiles are read into.
FILES = (Part, Posture, Robot, Profile, DepthSensor, Intrinsics, JumpLimits, SourceOptions)
OTHERS = {Part: {"low_m": 0.0, "high_m": 1.0}, Intrinsics: {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0}}
OTHERS |= {Posture: {"name": "upright", "parts": ()}, Robot: {"name": "any", "postures": ()}}

KINDS = sorted(
    set().union(*(kinds_below(kind) for kind in ROOTS)), key=lambda kind: (kind.__module__, kind.__qualname__)
)
NUMBERS = [(kind, name, told) for kind in [*KINDS, *FILES] for name, told in ranges_of(kind).items()]
IDS = [f"{kind.__name__}.{name}" for kind, name, _ in NUMBERS]


@pytest.mark.parametrize("kind", [*KINDS, *FILES], ids=lambda kind: kind.__name__)
def test_every_number_of_the_configuration_has_range_and_unit(kind):
    numbers = {f.name for f in dataclasses.fields(kind) if re.search(r"\b(int|float)\b", str(f.type))}
    assert numbers == set(ranges_of(kind))


def test_there_are_as_many_numbers_as_the_dump_shows_with_ranges():
    lines = [line for line in to_toml(Settings()).splitlines() if " = " in line and not line.startswith("#")]
    shown = [line for line in lines if line.partition(" = ")[2][0] in "-0123456789"]
    assert len(shown) > 100
    assert [line for line in shown if "  # " not in line or " to " not in line] == []
    assert "r_safe_m = 0.02  # 0 to 2 m" in lines


@pytest.mark.parametrize(("kind", "name", "told"), NUMBERS, ids=IDS)
def test_the_unit_is_the_one_that_the_name_says(kind, name, told):
    assert told.unit
    first, _, suffix = name.rpartition("_")
    expected = "1/m" if name.endswith("_per_m") else SUFFIXES.get(suffix, told.unit)
    assert told.unit == expected or not first


@pytest.mark.parametrize(("kind", "name", "told"), NUMBERS, ids=IDS)
def test_each_end_of_a_range_is_allowed_and_beyond_is_not(kind, name, told):
    assert math.isfinite(told.low) and math.isfinite(told.high) and told.low < told.high
    for end in (told.low, told.high):
        try:
            kind(**OTHERS.get(kind, {}) | {name: end})
        except RangeError as error:
            assert "expected at most" in str(error)  # the other end of a pair does not move with it
    step = max(abs(told.high), abs(told.low), 1)
    whole = (told.low - 1, told.high + 1, -(2**70), 2**70)
    for wrong in (*whole, told.low - step, told.high + step, math.nan, math.inf, -math.inf, True, "1"):
        with pytest.raises(RangeError) as caught:
            kind(**OTHERS.get(kind, {}) | {name: wrong})
        assert str(caught.value) == f"{name} is {wrong!r}; expected {told}"


def test_a_number_that_must_be_whole_is():
    from hickory_stream.config import RunConfig

    with pytest.raises(RangeError, match=r"workers is 2\.5; expected a whole number, 1 to 1024 processes"):
        RunConfig(workers=2.5)


@pytest.mark.parametrize("value", ["-1", "nan", "inf", "-inf", "1e9"])
def test_no_way_leads_around_the_range_of_the_safety_margin(value, tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text(f"[mapper.shapes.inflate]\nr_safe_m = {value}\n")
    told = rf"^mapper\.shapes\.inflate\.r_safe_m is {float(value)!r}; expected 0 to 2 m$".replace("+", r"\+")
    with pytest.raises(ConfigError, match=told):
        read_config(Settings, file)
    with pytest.raises(ConfigError, match=told):
        read_config(Settings, None, (f"mapper.shapes.inflate.r_safe_m={value}",))
    with pytest.raises(ConfigError, match=told):
        from_dict(Settings, {"mapper": {"shapes": {"inflate": {"r_safe_m": float(value)}}}})


def test_the_lower_end_of_a_pair_does_not_exceed_the_upper_one():
    with pytest.raises(ConfigError, match=r"expected at most max_voxel_m, 0\.001"):
        read_config(Settings, None, ("mapper.shapes.fused.volume.max_voxel_m=0.001",))


def test_numbers_are_checked_one_by_one_and_zero_numbers_pass():
    @dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
    class Several(Ranged):
        place_m: tuple[float, float] = number((0.0, 0.0), -1, 1, "m")
        limit_m: float | None = number(None, 0, 1, "m")

    assert Several(place_m=(1.0, -1.0)).limit_m is None
    with pytest.raises(RangeError, match=r"place_m is \(0.0, nan\); expected -1 to 1 m"):
        Several(place_m=(0.0, math.nan))
    with pytest.raises(ValueError, match=r"limit_m is 2; expected 0 to 1 m"):
        Several(limit_m=2)
    with pytest.raises(RangeError, match="limit_m is 1; expected at most place_m, 0"):
        check_order(dataclasses.make_dataclass("Pair", ["limit_m", "place_m"])(1, 0), "limit_m", "place_m")
