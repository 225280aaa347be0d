"""The ablation of rules and the sensitivity of numbers: what is counted, what is changed, and that it is undone."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import pytest
from tools.benchmarks.perception.rule_logs import Counts, RuleLog
from tools.benchmarks.perception.rule_switches import RULES
from tools.benchmarks.perception.rules import ablation, sensitivity

from hickory_stream.config import MapperConfig
from hickory_stream.mapping import cloud, support_graph, track, track_merging, track_splitting
from hickory_stream.mapping.support_relations import is_leg
from tools.benchmarks.common.processes import ROOT
from tools.benchmarks.foreign.logs import WorldLog
from tools.benchmarks.perception.constants import (
    NOT_DECIDING,
    Constant,
    constants,
    inline_numbers,
    moved,
    patched,
    with_constant,
    with_number,
)

if TYPE_CHECKING:
    from tools.benchmarks.common.figures import Figure

CONFIG = MapperConfig()


@pytest.fixture(scope="module")
def room() -> RuleLog:
    logs = ROOT / "tests" / "golden" / "logs"
    return RuleLog(WorldLog(log=logs / "room.mcap", truth=logs / "room.truth", key=""), CONFIG, step=4)


def counts(found: int, objects: int) -> Counts:
    return Counts(truth=50, found_25=found, found_50=found, objects=objects, tracked=found, tracks=found)


def values(figures: list[Figure]) -> dict[str, float | str]:
    return {figure.name: figure.value for figure in figures}


def test_numbers_of_the_configuration_and_of_modules_are_found_each_alone() -> None:
    found = {constant.key: constant for constant in constants()}
    assert len(found) == len(constants())
    assert found["mapping.merge.min_votes"].value == CONFIG.mapping.merge.min_votes
    assert found["mapping/track_merging.py:_MEET_M"].value == track_merging._MEET_M
    assert not any(isinstance(constant.value, bool) for constant in found.values())
    assert {constant.package for constant in found.values()} == {"mapping", "perception"}


def test_every_reason_to_leave_a_number_out_is_that_of_some_number() -> None:
    names = [constant.name for constant in constants()] + [text.partition(":")[0] for text in inline_numbers()]
    names += [path.relative_to(ROOT / "hickory_stream").as_posix() for path in (ROOT / "hickory_stream").rglob("*.py")]
    assert [prefix for prefix in NOT_DECIDING if not any(name.startswith(prefix) for name in names)] == []


def test_a_number_is_changed_by_its_share_a_whole_one_by_one_at_least_and_stays_in_its_range() -> None:
    assert moved(Constant(name="mapping/cloud.py:X", value=0.5), -0.2) == pytest.approx(0.4)
    assert moved(Constant(name="mapping/cloud.py:X", value=2), 0.2) == 3
    assert moved(Constant(name="mapping/cloud.py:X", value=60), -0.2) == 48
    assert moved(Constant(name="mapping.lifecycle.wall_share", value=0.95), 0.2) == 1.0


def test_a_configured_number_is_changed_where_it_is_declared() -> None:
    changed = with_number(CONFIG, "perception.geometric.join.bridging.gap_m", 0.7)
    assert changed.perception.geometric.join.bridging.gap_m == 0.7
    assert CONFIG.perception.geometric.join.bridging.gap_m != 0.7


def test_a_number_of_a_module_is_changed_and_put_back() -> None:
    constant = next(c for c in constants() if c.name.startswith("mapping/") and c.index == 1)
    module = importlib.import_module(f"hickory_stream.{constant.name.partition('.')[0].replace('/', '.')}")
    name = constant.name.partition(":")[2]
    before = getattr(module, name)
    with with_constant(CONFIG, constant, 42):
        assert getattr(module, name) == (before[0], 42, *before[2:])
    assert getattr(module, name) == before


def test_a_function_is_another_one_for_whoever_imported_it_and_where_it_was_imported_alone() -> None:
    with patched("mapping.support_relations", "is_leg", None):
        assert support_graph.is_leg is None
    assert support_graph.is_leg is is_leg
    with patched("mapping.track_merging", "share_near", None):
        assert track_merging.share_near is None
        assert track_splitting.share_near is cloud.share_near is not None


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_every_rule_can_be_switched_and_switched_back(rule) -> None:  # type: ignore[no-untyped-def]
    def now() -> list[object]:
        found = []
        for module, attribute, _ in rule.patches:
            name, _, kind = module.partition(":")
            owner = importlib.import_module(f"hickory_stream.{name}")
            found.append(getattr(getattr(owner, kind) if kind else owner, attribute))
        return found

    before = now()
    with rule.switched(CONFIG) as switched:
        assert switched != CONFIG or all(a is not b for a, b in zip(before, now(), strict=True))
    assert all(a is b for a, b in zip(before, now(), strict=True))


def test_what_was_split_off_can_be_taken_for_any_other_track() -> None:
    rule = next(rule for rule in RULES if rule.patches and rule.patches[0][1] == "is_promoted")
    before = track.Track.is_promoted
    with rule.switched(CONFIG):
        assert track.Track.is_promoted is not before
    assert track.Track.is_promoted is before


def test_a_log_gives_the_same_counts_in_each_way_until_something_is_changed(room: RuleLog) -> None:
    assert room.baseline.found_25 > 0
    assert room.counts(CONFIG, "perceived") == room.counts(CONFIG, "prepared") == room.baseline
    nothing = with_number(CONFIG, "mapping.lifecycle.confirm_sightings", 1000)
    assert room.counts(nothing, "perceived").objects == 0
    blind = with_number(CONFIG, "perception.geometric.min_area_px", 1_000_000)
    assert room.counts(blind, "prepared").objects == 0
    assert room.counts(blind, "perceived") == room.baseline, "what was perceived before is not perceived anew"


def test_the_worth_of_a_rule_is_what_is_lost_without_it() -> None:
    measured = {"as it is": {"home": counts(40, 45)}, "two colours divide": {"home": counts(38, 46)}}
    measured["the network divides fragments"] = {"home": counts(41, 45)}
    found = values(ablation(measured))
    assert found == {"worth two colours divide": 2, "worth the network divides fragments": 1}


def test_a_knife_edge_is_a_number_that_moves_recall_by_more_than_two_hundredths() -> None:
    both = {"home": counts(40, 45), "bookstore": counts(20, 25)}
    measured = {
        "as it is": both,
        "a 1 -> 0.8": both | {"home": counts(38, 45)},
        "b 1 -> 0.8": both | {"home": counts(37, 45)},
        "b 1 -> 1.2": both | {"home": counts(44, 45)},
        "c 1 -> 1.2": {"home": counts(0, 0)},
    }
    (figure,) = sensitivity("mapping", measured, 6)
    assert (figure.value, figure.of) == (1, "3 of 6 changes by 20%, on home and bookstore")
