import platform
from dataclasses import replace
import pytest
from hickory_stream.config import MapperConfig
from hickory_stream.engine.shape_jobs.processor import processor_kind, processor_of_run, processor_of_shapes
from hickory_stream.map_folder.manifest import read_manifest
from hickory_stream.map_folder.writer import create_map_folder

PERCEPTION = MapperConfig().perception


@pytest.mark.skipif(platform.machine() != "x86_64", reason="shown for x86-64 alone")
def test_the_default_map_is_the_same_on_every_processor():
    assert processor_of_run(PERCEPTION, is_own=False) != ""
    assert processor_of_run(PERCEPTION, is_own=True) == ""
    assert processor_of_shapes() == ""


def test_networks_run_as_the_processor_has_them():
    for other in (
        replace(PERCEPTION, segmenter="fastsam"),
        replace(PERCEPTION, extractor="dinov2"),
        replace(PERCEPTION, semantics="graph"),
    ):
        assert processor_of_run(other, is_own=True) == processor_kind()
    assert processor_kind().startswith(platform.machine().lower())


def test_on_another_architecture_every_map_depends_on_it(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    processor_kind.cache_clear()
    try:
        assert processor_of_run(PERCEPTION, is_own=True).startswith("aarch64 ")
        assert processor_of_shapes().startswith("aarch64 ")
    finally:
        processor_kind.cache_clear()


def test_the_manifest_keeps_the_kind_of_processor(tmp_path):
    create_map_folder(tmp_path / "map", config={}, source={}, processor="riscv64 some").close()
    assert read_manifest(tmp_path / "map").processor == "riscv64 some"
