import dataclasses
import math
import re
from typing import get_type_hints
import pytest
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.base.config_text import from_dict, read_config, to_toml
from hickory_stream.base.ranges import Ranged, check_order, number, ranges_of
from hickory_stream.errors import ConfigError, RangeError
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.merging.merge_maps import MergeMapsConfig
from hickory_stream.navigation.robot import Part, Posture, Robot
from hickory_stream.navigation.search import SearchConfig
from hickory_stream.settings import Settings
from players.options import SourceOptions
from players.poses.tracks import JumpLimits
from players.profile import Intrinsics, Profile

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


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [("mapper.shapes.fused.volume.max_voxel_m", "0.001", "expected at most max_voxel_m, 0.001")],
)
def test_the_lower_end_of_a_pair_does_not_exceed_the_upper_one(key, value, told):
    with pytest.raises(ConfigError, match=told):
        read_config(Settings, None, (f"{key}={value}",))


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
