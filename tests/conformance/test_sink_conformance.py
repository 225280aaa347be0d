import itertools
import shutil
from dataclasses import replace
import pytest
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.navigation.robot import load_robot
from hickory_stream.sinks.costmap_sink import CostmapSink
from hickory_stream.sinks.disk_sink import DiskSink, DiskSinkConfig
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.sink import RerunSink
from hickory_stream.sinks.rerun.viewer import ViewerChoice, ViewerKind
from hickory_stream.testing import RememberingSink, SlowSink
from tests.engine.run_fixtures import NO_SHAPES, map_scene
from tests.examples.csv_sink import COLUMNS, CsvSink

pytestmark = pytest.mark.timeout(60)


def _disk(folder):
    return DiskSink(folder, DiskSinkConfig(every_keyframes=2))


def _rerun(folder, rrd=None):
    return RerunSink(RerunConfig(), folder.path, rrd, ViewerChoice(kind=ViewerKind.NONE))


def _example(folder):
    return CsvSink(folder.path.parent / "objects.csv")


# A sink of one's own adds its line here.
SINKS = {
    "costmap": lambda folder: CostmapSink(load_robot("point"), path=folder.path.parent / "costmap.mcap"),
    "rerun_file": lambda folder: _rerun(folder, folder.path.parent / "run.rrd"), "rerun_of_nothing": _rerun,
    "disk": _disk, "example": _example, "remembering": lambda _: RememberingSink(),
    "slow": lambda _: SlowSink(RememberingSink(), 0.001),
}  # fmt: skip


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    sink = RememberingSink()
    run = map_scene(
        tmp_path_factory.mktemp("played"), loops=2, sinks=lambda folder: [(sink, True), (_disk(folder), True)]
    )
    return run.folder, sink.reports


@pytest.fixture(scope="module")
def undisturbed_digest(tmp_path_factory):
    return map_scene(tmp_path_factory.mktemp("undisturbed"), *NO_SHAPES).digest


@pytest.fixture(params=sorted(SINKS))
def make_sink(request):
    return SINKS[request.param]


@pytest.fixture
def folder(played, tmp_path):
    """A copy of the folder that the reports refer to."""
    shutil.copytree(played[0].path, tmp_path / "map")
    return MapFolder(tmp_path / "map", played[0].manifest)


def test_the_reports_are_of_every_kind(played):
    _, reports = played
    assert any(report.snapshot and any(tracked.shape for tracked in report.snapshot.objects) for report in reports)
    assert any(b.stamp_ns < a.stamp_ns for a, b in itertools.pairwise(reports))
    assert reports[-1].frame is None
    assert reports[-1].snapshot is not None


def shown(sink, reports):
    for report in reports:
        sink.show(report)
    sink.close()


def test_a_sink_takes_every_report_of_a_run(make_sink, folder, played):
    shown(make_sink(folder), played[1])


def test_a_sink_can_be_closed_before_it_was_shown_anything(make_sink, folder):
    make_sink(folder).close()


def test_a_sink_takes_an_empty_map_and_an_empty_frame(make_sink, folder, played):
    first = played[1][0]
    assert first.snapshot is not None
    empty = replace(first, snapshot=replace(first.snapshot, objects=()), observations=(), object_ids=(), decisions=())
    bare = replace(
        first, index=1, keyframe_index=None, frame=None, segmentation=None, snapshot=None, observations=(),
        object_ids=(),
    )  # fmt: skip
    shown(make_sink(folder), (empty, bare))


def test_a_sink_on_a_thread_of_its_own_does_not_change_the_map(make_sink, tmp_path, undisturbed_digest):
    run = map_scene(tmp_path, *NO_SHAPES, sinks=lambda folder: [(_disk(folder), True), (make_sink(folder), True)])
    assert run.digest == undisturbed_digest


def test_the_example_writes_a_line_per_object_and_keyframe(folder, played):
    shown(_example(folder), played[1])
    lines = (folder.path.parent / "objects.csv").read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert len(lines) - 1 == sum(len(report.snapshot.objects) for report in played[1] if report.snapshot)
    assert {line.rsplit(",", 1)[1] for line in lines[1:]} == {"0", "1"}
