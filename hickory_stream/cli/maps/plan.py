"""`hickory-stream plan`: a path through a map for a robot, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.commands import NO_PATH, Commands
from hickory_stream.cli.option_values import (
    add_allow_unverified,
    add_at,
    add_floor_argument,
    add_stationarity,
    floor_of_option,
    movable_objects,
    open_verified_map_at,
    parse_place,
    robot_of_option,
)
from hickory_stream.cli.output_files import add_output, check_ending, disk_refusals, write_picture
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.navigation.free_space import FreeSpace
    from hickory_stream.navigation.search import NoPath
    from hickory_stream.navigation.search import Path as Way
    from hickory_stream.navigation.stand_ins import SeenSurface
    from hickory_stream.records import MapSnapshot

MOST_BERTH_M = 5.0
PLANNERS = ("rrt", "rrt-connect", "rrt-star")


def add(commands: Commands) -> None:
    plan = commands.add("plan", run)
    plan.add_argument("map", type=Path, metavar="MAP")
    plan.add_argument("--start", required=True, metavar="X,Y", help="metres in the map, e.g. -1,0.5")
    plan.add_argument(
        "--goal",
        required=True,
        metavar="X,Y|object:ID",
        help="a position, or the nearest one beside an object of the map",
    )
    add_floor_argument(plan, "storey of a map with several")
    add_robot_arguments(plan)
    plan.add_argument("--planner", choices=PLANNERS, default="rrt-connect")
    plan.add_argument("--seed", type=int, default=0, help="the same seed gives the same path")
    add_stationarity(plan)
    plan.add_argument(
        "--berth",
        type=float,
        default=0.3,
        metavar="M",
        help="distance to objects that tend to move, if a path allows it (default 0.3 m)",
    )
    add_output(plan, "-o", "--out", type=Path, metavar="PNG|RRD", help="draw the grid, the objects and the path")
    add_at(plan)
    add_allow_unverified(plan)


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the robot and its grid."""
    parser.add_argument("--robot", metavar="NAME|FILE", help="robot: jackal, spot, turtlebot4, ..., or a TOML file")
    parser.add_argument("--cell", type=float, default=0.033, metavar="M", help="side of a cell, default 0.033 m")
    parser.add_argument(
        "--unknown", choices=("blocked", "free"), default="blocked", help="treatment of unobserved space (blocked)"
    )


def run(options: argparse.Namespace) -> int:
    import numpy as np

    from hickory_stream.navigation.berth import keep_off, passed_by
    from hickory_stream.navigation.free_space import free_space_of, uncertified, without_layer_four
    from hickory_stream.navigation.search import NoPath, SearchConfig, plan
    from hickory_stream.storeys import on_storey

    check_ending(options.out, ".png", ".rrd")
    start = np.array(parse_place(options.start, "--start"))
    wanted = _object_id(options.goal)
    place = None if wanted is not None else np.array(parse_place(options.goal, "--goal"))
    robot = robot_of_option(options.robot, "--robot")
    saved, doubt = open_verified_map_at(options)
    snapshot, seen = _as_driven(saved, options.at)
    floor_m = _floor_of(snapshot, options.floor, wanted)
    snapshot = on_storey(snapshot, floor_m)

    def free_space() -> FreeSpace:
        return free_space_of(snapshot, robot, cell_m=options.cell, unknown=options.unknown, seen=seen, floor_m=floor_m)

    space = free_space()
    if options.seed < 0:
        raise InputError(f"found --seed {options.seed}, expected 0 or more")
    if not 0 <= options.berth <= MOST_BERTH_M:
        raise InputError(f"found --berth {options.berth}, expected 0 to {MOST_BERTH_M:g} m")
    config = SearchConfig(planner=options.planner)
    goal = place if place is not None else _beside(space, snapshot, start, wanted)
    movable = movable_objects(options.stationarity, saved)

    def planned(space: FreeSpace) -> Way | NoPath:
        if isinstance(goal, NoPath):
            return goal
        return plan(space, start, goal, config, np.random.default_rng(options.seed))

    answer, keeps_off = planned(space), not movable
    if movable and not isinstance(answer, NoPath):
        wide = free_space()
        keep_off(wide, snapshot, movable, options.berth)
        found = planned(wide)
        if not isinstance(found, NoPath):
            answer, keeps_off = found, True
    if options.out is not None:
        _draw(options.out, snapshot, space, answer, start, start if isinstance(goal, NoPath) else goal)
    proof = Proof(
        boxes=without_layer_four(snapshot) if seen is None else [],
        observed_only=sorted(space.observed_only) if seen is not None else [],
        uncertified=uncertified(snapshot),
        doubt=doubt,
        movable=movable,
        fixed={tracked.id: tracked.fixture_probability for tracked in snapshot.objects},
        passed=[]
        if keeps_off or isinstance(answer, NoPath)
        else passed_by(answer.points, snapshot, movable, options.berth + robot.reach_m),
    )
    print(output("plan", _as_json(space, answer, proof), indent=1) if options.json else _as_text(space, answer, proof))
    return NO_PATH if isinstance(answer, NoPath) else 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Proof:
    """How far a plan rests on proven geometry."""

    #: objects avoided by their boxes
    boxes: list[int]
    #: objects of a live run that have no layer 4 yet
    observed_only: list[int]
    #: objects whose layer 4 is not certified
    uncertified: list[int]
    #: why nothing is proven, "" where the map is as it was saved
    doubt: str
    #: objects that tend to move
    movable: list[int]
    #: movable objects within reach of the path
    passed: list[int]
    #: probability of each object to be a fixture
    fixed: dict[int | None, float]


def _as_driven(saved: SavedMap, at: str | None) -> tuple[MapSnapshot, SeenSurface | None]:
    from hickory_stream.map_folder.history.live_map import is_live, live_map

    if not is_live(saved):
        return saved.snapshot, None
    found = live_map(saved.folder, saved.snapshot.stamp_ns if at is not None else None)
    return found if found is not None else (saved.snapshot, None)


def _listed(ids: list[int]) -> str:
    return ", ".join(map(str, ids[:10])) + (", ..." if len(ids) > 10 else "")


def _object_id(goal: str) -> int | None:
    kind, colon, number = goal.partition(":")
    if not colon:
        return None
    if kind != "object" or not number.isdecimal():
        raise InputError(f"found --goal {goal}, expected X,Y in metres, or object:ID, e.g. --goal object:12")
    return int(number)


def _floor_of(snapshot: MapSnapshot, floor_m: float | None, object_id: int | None) -> float:
    from hickory_stream.storeys import floor_beneath, floors_of

    floors_m = floors_of(snapshot)
    goal = next((tracked for tracked in snapshot.objects if tracked.id == object_id), None)
    if goal is None or len(floors_m) < 2:
        return floor_of_option(snapshot, floor_m)
    beneath_m = floor_beneath(floors_m, float(goal.box.corners_world()[:, 2].min()))
    if floor_m is not None and floor_of_option(snapshot, floor_m) != beneath_m:
        raise InputError(
            f"found --floor {floor_m:g}, but object {object_id} is on the floor at z = {beneath_m:.2f} m; "
            "choose that floor, or leave out --floor"
        )
    return beneath_m


def _beside(
    space: FreeSpace, snapshot: MapSnapshot, start: NDArray[np.float64], object_id: int | None
) -> NDArray[np.float64] | NoPath:
    from hickory_stream.navigation.free_space import place_beside
    from hickory_stream.navigation.search import NoPath, NoPathReason, refused_start

    box = next((item.box for item in snapshot.objects if item.id == object_id), None)
    if box is None:
        raise InputError(f"the map has no object {object_id}; `hickory-stream inspect` lists its objects")
    refused = refused_start(space, start)
    if refused is not None:
        return refused
    place = place_beside(space, start, box)
    if place is not None:
        return place
    text = f"no place beside object {object_id} can be reached from the start by this robot"
    return NoPath(reason=NoPathReason.UNREACHABLE, text=text)


def _as_json(space: FreeSpace, answer: Way | NoPath, proof: Proof) -> dict[str, Any]:
    from hickory_stream.navigation.search import NoPath
    from hickory_stream.records import ObjectKind

    report: dict[str, Any] = {
        "robot": space.robot.name,
        "objects_by_box": proof.boxes,
        "objects_observed_only": proof.observed_only,
        "objects_uncertified": proof.uncertified,
        "unproven": proof.doubt or None,
        "objects_movable": proof.movable,
        "cell_m": space.frame.cell_m,
        "floor_m": space.floor_z_m,
    }
    if isinstance(answer, NoPath):
        blockers = [
            {
                "object": b.object_id,
                "kind": ObjectKind.of(proof.fixed[b.object_id]) if b.object_id in proof.fixed else None,
                "fixture_probability": proof.fixed.get(b.object_id),
                "distance_m": round(b.distance_m, 4),
            }
            for b in answer.blockers
        ]
        return report | {"found": False, "reason": answer.reason.value, "text": answer.text, "blockers": blockers}
    return report | {
        "found": True,
        "length_m": answer.length_m,
        "passes_movable": proof.passed,
        "points": answer.points.tolist(),
        "postures": [space.robot.postures[int(p)].name for p in answer.postures],
        "headings_rad": answer.headings_rad.tolist(),
        "iterations": answer.num_iterations,
    }


def _as_text(space: FreeSpace, answer: Way | NoPath, proof: Proof) -> str:
    from hickory_stream.navigation.search import NoPath

    notes = []
    if proof.boxes:
        text = f"{len(proof.boxes)} objects have no layer 4, their boxes are avoided"
        notes.append(f"note: {text}: {_listed(proof.boxes)}")
    if proof.observed_only:
        text = f"{len(proof.observed_only)} objects have no layer 4 yet, their seen points are avoided"
        notes.append(f"note: {text}: {_listed(proof.observed_only)}")
    if proof.uncertified:
        count = len(proof.uncertified)
        notes.append(f"note: {count} objects have a layer 4 that is not certified: {_listed(proof.uncertified)}")
    if proof.passed:
        notes.append(f"note: the path passes near objects that tend to move: {_listed(proof.passed)}")
    if isinstance(answer, NoPath):
        stirring = [b.object_id for b in answer.blockers if b.object_id in proof.movable]
        if stirring:
            notes.append(f"note: these blocking objects tend to move, look again: {_listed(stirring)}")
        fixed = [b.object_id for b in answer.blockers if proof.fixed.get(b.object_id, 0.0) > 0.5]
        if fixed:
            notes.append(f"note: these blocking objects are fixtures, which stay: {', '.join(map(str, fixed))}")
    if proof.doubt:
        notes.append(f"note: layer 4 is not proven: {proof.doubt}")
    if isinstance(answer, NoPath):
        return "\n".join([f"no path ({answer.reason.value}): {answer.text}", *notes])
    legs = f"{answer.length_m:.2f} m in {len(answer.points) - 1} legs"
    how = "verified along the whole length" if not proof.doubt else "free of obstacles, which are NOT proven"
    lines = [f"{legs}, {how} for {space.robot.name}"]
    for i, (x, y) in enumerate(answer.points):
        posture = space.robot.postures[int(answer.postures[min(i, len(answer.postures) - 1)])].name
        leg = f"  on, {posture}" if i < len(answer.points) - 1 else "  there"
        lines.append(f"  ({x:7.3f}, {y:7.3f}){leg}")
    return "\n".join([*lines, *notes])


def _draw(path: Path, snapshot: Any, space: FreeSpace, answer: Way | NoPath, start: Any, goal: Any) -> None:
    from hickory_stream.pictures.render_navigation import render_plan
    from hickory_stream.sinks.rerun.path import write_plan

    if path.suffix == ".rrd":
        with disk_refusals(path, "picture"):
            write_plan(path, snapshot, space, answer, start=start, goal=goal)
    else:
        write_picture(path, render_plan(snapshot, space, answer, start, goal))
