from hickory_stream.config import MapperConfig
from hickory_stream.mapping.rules import merging
from tests.conftest import ROOT
from tools.benchmarks.perception.constants import NOT_DECIDING, Constant, constants, inline_numbers

PRODUCT = ROOT / "hickory_stream"


def test_numbers_are_found_once_and_networks_do_not_decide():
    found = {constant.name: constant.value for constant in constants()}
    assert len(found) == len(constants())
    assert found["mapping.merge.min_together_s"] == MapperConfig().mapping.merge.min_together_s
    assert found["mapping/merging.py:_COVERS_SHARE"] == merging._COVERS_SHARE
    assert not any(isinstance(value, bool) for value in found.values())
    assert Constant(name="perception.geometric.min_iou", value=0.5).decides
    assert not Constant(name="perception.fastsam.min_iou", value=0.5).decides
    assert any(text.startswith("perception/surface.py:") for text in inline_numbers())
    assert not any("models" in constant.name for constant in constants())


def test_every_reason_to_leave_a_number_out_applies():
    names = [constant.name for constant in constants()]
    names += [
        f"{package}/{path.name}" for package in ("mapping", "perception") for path in (PRODUCT / package).rglob("*.py")
    ]
    assert [prefix for prefix in NOT_DECIDING if not any(name.startswith(prefix) for name in names)] == []
