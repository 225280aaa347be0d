import json
import re
import shutil
from contextlib import closing
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.cli import main
from hickory_stream.graph.trajectories import ways_of
from hickory_stream.inspection.graph_summary import summary_of, summary_text
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder, reopen_map_folder
from hickory_stream.pictures.drawing import Drawing, Ellipse, Line, Text
from hickory_stream.pictures.render_graph import AFTER, BEFORE, LOOP, REFUSED, recorded_ways, render_graph
from hickory_stream.records import MapSnapshot, PoseGraphRecord
from tests.graph.graph_fixtures import solved_graph, walk

GRAPH = solved_graph()
WAYS = ways_of(GRAPH, [n.stamp_ns for n in GRAPH.nodes], np.array([n.uncorrected[:3, 3] for n in GRAPH.nodes]))


def lines_of(drawing, color):
    # The legend's lines have two ends.
    return [p for p in drawing.parts if isinstance(p, Line) and p.color == color and len(p.places_px) > 2]


def test_the_corrected_way_is_that_of_the_solution():
    assert np.allclose(WAYS.after, [node.place[:3, 3] for node in GRAPH.nodes], atol=1e-9)
    error_m = np.linalg.norm(WAYS.after - walk().true[:, :3, 3], axis=1).max()
    assert error_m < np.linalg.norm(WAYS.before - walk().true[:, :3, 3], axis=1).max()


def test_a_place_moves_with_the_submap_open_at_that_time():
    node = GRAPH.nodes[7]
    ways = ways_of(GRAPH, [node.stamp_ns + 1], node.uncorrected[None, :3, 3] + (0.5, 0, 0))
    move = node.place @ np.linalg.inv(node.uncorrected)
    assert np.allclose(ways.after[0], move[:3, :3] @ ways.before[0] + move[:3, 3])


def test_believed_loops_are_solid_with_scores_and_others_dashed():
    drawing = render_graph(GRAPH, WAYS, (1200, 900))
    believed = [loop for loop in GRAPH.loops if loop.status == "accepted"]
    through, dashed = lines_of(drawing, LOOP), lines_of(drawing, REFUSED)
    assert (len(through), len(dashed)) == (len(believed), len(GRAPH.loops) - len(believed))
    assert all(line.dash_px == 0 for line in through)
    assert all(line.dash_px > 0 for line in dashed)
    assert len(lines_of(drawing, BEFORE)) == len(lines_of(drawing, AFTER)) == 1
    texts = {part.text for part in drawing.parts if isinstance(part, Text)}
    assert {f"{loop.score:.3g}" for loop in believed} <= texts


def test_uncertain_places_have_ellipses_and_residuals_a_plot():
    drawing = render_graph(GRAPH, WAYS, (1200, 900))
    outlines = [part for part in drawing.parts if isinstance(part, Ellipse) and not part.is_filled]
    assert len(outlines) == len(GRAPH.nodes)
    assert outlines[0].half_axes_px[0] < 0.1 < outlines[5].half_axes_px[1] < outlines[5].half_axes_px[0]
    dots = [part for part in drawing.parts if isinstance(part, Ellipse) and part.half_axes_px == (4.0, 4.0)]
    assert len(dots) == len(GRAPH.loops)
    heights = {True: [], False: []}
    for dot, loop in zip(dots, GRAPH.loops, strict=True):
        heights[loop.status == "accepted"].append(dot.center_px[1])
    assert max(heights[False]) < min(heights[True])


def test_both_forms_of_a_drawing_show_the_same():
    drawing = render_graph(GRAPH, WAYS, (640, 480))
    svg = drawing.svg()
    assert svg.count("<polyline") == sum(isinstance(part, Line) for part in drawing.parts)
    assert svg.count("<ellipse") == sum(isinstance(part, Ellipse) for part in drawing.parts)
    image = drawing.image()
    assert image.shape == (480, 640, 3)
    for color in (BEFORE, AFTER, LOOP, REFUSED):
        assert (image == color).all(axis=2).sum() > 20


def test_a_dashed_line_has_gaps():
    ends = np.array([[10.0, 10.0], [90.0, 10.0]])
    inked = {}
    for dash_px in (0.0, 5.0):
        drawing = Drawing(width=100, height=20)
        drawing.add(Line(places_px=ends, color=(0, 0, 0), dash_px=dash_px))
        inked[dash_px] = int((drawing.image()[10, :, 0] < 128).sum())
    assert 0.4 * inked[0.0] < inked[5.0] < 0.9 * inked[0.0]


@pytest.fixture(scope="module")
def graph_map(tmp_path_factory):
    path = tmp_path_factory.mktemp("graph") / "graph.map"
    snapshot = MapSnapshot(revision=3, stamp_ns=GRAPH.nodes[-1].stamp_ns, submaps=(), objects=(), graph=GRAPH)
    with closing(create_map_folder(path, config={}, source={"uri": "walk"})) as folder:
        folder.save(snapshot)
    return path


def test_render_draws_the_graph_as_png_and_svg(graph_map, tmp_path, capsys):
    for name in ("graph.png", "graph.svg"):
        command = ["render", str(graph_map), "--graph", "-o", str(tmp_path / name), "--size", "800x600"]
        assert main(command) == 0, capsys.readouterr().err
    assert cv2.imread(str(tmp_path / "graph.png")).shape == (600, 800, 3)
    assert (tmp_path / "graph.svg").read_text().startswith("<svg ")


@pytest.fixture
def mapped(short_map, tmp_path):
    """A map of a log, without a graph, with its journal."""
    copy = tmp_path / "log.map"
    shutil.copytree(short_map, copy)
    with closing(reopen_map_folder(copy)) as folder:
        folder.save(replace(open_map(copy).snapshot, graph=None))
    return copy


def test_a_map_without_a_graph_says_so(mapped, tmp_path, capsys):
    assert recorded_ways(open_map(mapped, warns=False)) is None
    assert main(["render", str(mapped), "--graph", "-o", str(tmp_path / "g.png")]) == 2
    assert "has no pose graph" in capsys.readouterr().err


def test_the_way_is_that_of_every_frame_up_to_the_last_keyframe(mapped):
    with Journal(mapped) as journal:
        frames = [frame for i in range(len(journal)) for frame in journal.step(i).frames]
    frames = [frame for frame in frames if frame.stamp_ns <= open_map(mapped).snapshot.stamp_ns]
    middle = len(frames) // 2
    nodes = (
        replace(GRAPH.nodes[0], stamp_ns=frames[0].stamp_ns),
        replace(GRAPH.nodes[1], stamp_ns=frames[middle].stamp_ns, place=np.eye(4), uncorrected=np.eye(4)),
    )
    shift = np.eye(4)
    shift[0, 3] = 1.0
    graph = PoseGraphRecord(nodes=(nodes[0], replace(nodes[1], place=shift)), edges=())
    with closing(reopen_map_folder(mapped)) as folder:
        folder.save(replace(open_map(mapped, warns=False).snapshot, graph=graph))
    ways = recorded_ways(open_map(mapped, warns=False))
    assert len(ways.before) == len(frames)
    assert np.array_equal(ways.before, [frame.world_from_camera[:3, 3] for frame in frames])
    expected = np.zeros_like(ways.before)
    expected[middle:, 0] = 1.0
    assert np.allclose(ways.after - ways.before, expected, atol=1e-12)


def test_inspect_has_a_line_on_the_graph_and_its_loops_as_json(graph_map, capsys):
    assert main(["inspect", str(graph_map)]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("pose graph: "))
    assert re.match(r"pose graph: 60 submaps, 9 loops \(6 accepted, 2 rejected, 1 withdrawn\); submaps moved", line)
    assert line == summary_text(summary_of(GRAPH))
    assert main(["inspect", str(graph_map), "--json"]) == 0
    graph = json.loads(capsys.readouterr().out)["graph"]
    assert (graph["num_submaps"], graph["num_withdrawn"]) == (60, 1)
    assert [loop["status"] for loop in graph["loops"]] == [loop.status for loop in GRAPH.loops]
