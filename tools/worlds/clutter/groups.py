"""Arrangements on the floor: one function per recipe."""
# A group's frame has x away from the wall (its back is at x = 0) and y along it.

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.object_models import Model, Surface
from hickory_stream.worlds.scene import Placement, at_place, part_boxes, shared_volume_m3
from hickory_stream.worlds.support_placement import REST_M
from tools.worlds.clutter.contents import CONTENTS, Place
from tools.worlds.clutter.draws import about_y, chance, count, one_of, uniform
from tools.worlds.clutter.footprints import Taken, corners_of, do_overlap
from tools.worlds.clutter.heaps import heap
from tools.worlds.clutter.kit import SHAPES, Kit
from tools.worlds.clutter.objects.cloths import curtain, hung_cloth, rail, tablecloth
from tools.worlds.clutter.objects.materials import Skin
from tools.worlds.clutter.objects.solids import block, stretched

# A support with an open top is accessible from all sides, so that a cloth can hang down its sides.
_OPEN_M = 0.9


@dataclass(frozen=True, kw_only=True, slots=True)
class Group:
    """Placements in the group's frame, and whether it stands with its back to a wall."""

    placed: tuple[Placement, ...]
    is_at_wall: bool

    def corners(self) -> NDArray[np.float64]:
        """Return the (4, 2) corners of the rectangle that all of it takes."""
        points = np.concatenate(
            [
                part.vertices @ one.world_from_object[:2, :3].T + one.world_from_object[:2, 3]
                for one in self.placed
                for part in one.model.parts
            ]
        )
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return np.array([[x1, y1], [x0, y1], [x0, y0], [x1, y0]])


def _at(model: Model, x: float, y: float, yaw_rad: float = 0.0, z: float = REST_M) -> Placement:
    return Placement(model=model, world_from_object=at_place(x, y, z, yaw_rad))


def _backed(model: Model, y: float, away_m: float = 0.0) -> Placement:
    return _at(model, away_m - float(model.bounds_m()[0, 0]), y)


def filled(rng: np.random.Generator, kit: Kit, support: Placement, share: float = 0.8) -> list[Placement]:
    """Return the things on the surfaces of a support; about a `share` of the surfaces has some."""
    things = []
    for surface in support.model.surfaces:
        if chance(rng, share):
            things += _on_surface(rng, kit, support, surface)
    return things


def _on_surface(rng: np.random.Generator, kit: Kit, support: Placement, surface: Surface) -> list[Placement]:
    if min(surface.half_m) < 0.03 or surface.headroom_m < 0.05:
        return []
    place = Place(half_m=surface.half_m, headroom_m=surface.headroom_m)
    things = []
    parts = [place]
    offsets = [0.0]
    # A long board is divided into parts with different contents.
    if surface.half_m[1] > 0.5 and chance(rng, 0.7):
        half = surface.half_m[1] / 2
        parts, offsets = [replace(place, half_m=(surface.half_m[0], half - 0.01))] * 2, [-half, half]
    for part, y in zip(parts, offsets, strict=True):
        made = CONTENTS[one_of(rng, kit.recipes.contents)](rng, kit, part)
        x0, y0, z = surface.center_m
        world_from_place = support.world_from_object @ at_place(x0, y0 + y, z, 0.0)
        things += [Placement(model=model, world_from_object=world_from_place @ pose) for model, pose in made]
    return things


def flush_row(rng: np.random.Generator, kit: Kit) -> Group:
    """Return appliances, units and shelves side by side without a gap, of one depth and mostly of one height."""
    number, depth = count(rng, 2, 6), uniform(rng, 0.45, 0.7)
    heights = (uniform(rng, 0.8, 0.95), uniform(rng, 1.3, 2.1))
    gap = one_of(rng, (0.0008, 0.0008, 0.002, 0.006, 0.02))
    skin = kit.skin(rng)
    alike, twin = chance(rng, 0.35), chance(rng, 0.25)
    units: list[Placement] = []
    y = 0.0
    for i in range(number):
        if i and twin:
            model = units[-1].model
        else:
            name = one_of(rng, (*kit.recipes.units, *kit.recipes.units, *kit.recipes.supports))
            model = SHAPES[name](rng, (lambda own: skin) if alike else kit.skin)
            size = np.ptp(model.bounds_m(), axis=0)
            if max(size[1], size[0]) > 1.3:
                model = SHAPES[one_of(rng, kit.recipes.units)](rng, (lambda own: skin) if alike else kit.skin)
                size = np.ptp(model.bounds_m(), axis=0)
            high = heights[0] if chance(rng, 0.7) else heights[1]
            model = stretched(model, (depth / size[0], 1.0, high / size[2]))
        low, top = model.bounds_m()
        units.append(_backed(model, y - float(low[1]), uniform(rng, 0.0, 0.01)))
        y += float(top[1] - low[1]) + gap
    low_z = uniform(rng, 1.35, 1.6)
    if chance(rng, 0.5) and all(unit.model.bounds_m()[1, 2] < low_z for unit in units):
        units = [replace(unit, model=_under(unit.model, low_z)) for unit in units]
        units += _overhead(rng, kit, y, low_z, (lambda _: skin) if alike else kit.skin)
    return Group(placed=(*units, *(thing for unit in units for thing in filled(rng, kit, unit, 0.5))), is_at_wall=True)


def _under(model: Model, low_z: float) -> Model:
    surfaces = tuple(replace(s, headroom_m=min(s.headroom_m, low_z - s.center_m[2] - 0.02)) for s in model.surfaces)
    return replace(model, surfaces=surfaces)


def _overhead(rng: np.random.Generator, kit: Kit, length: float, low_z: float, skin: Skin) -> list[Placement]:
    depth, high = uniform(rng, 0.25, 0.42), uniform(rng, 0.3, 0.75)
    units, y = [], uniform(rng, 0.0, 0.5)
    while y < length - 0.3:
        model = SHAPES[one_of(rng, kit.recipes.units)](rng, skin)
        size = np.ptp(model.bounds_m(), axis=0)
        model = replace(stretched(model, (depth / size[0], 1.0, high / size[2])), surfaces=())
        low, top = model.bounds_m()
        units.append(_at(model, 0.001 - float(low[0]), y - float(low[1]), 0.0, low_z))
        y += float(top[1] - low[1]) + 0.001
    return units


def filled_support(rng: np.random.Generator, kit: Kit) -> Group:
    """Return one piece of furniture with what stands on and in it, at a wall mostly."""
    support = _backed(kit.make(rng, one_of(rng, kit.recipes.supports)), 0.0, one_of(rng, (0.001, 0.01, 0.05)))
    return Group(placed=(support, *filled(rng, kit, support, uniform(rng, 0.5, 1.0))), is_at_wall=chance(rng, 0.8))


def table_with_seats(rng: np.random.Generator, kit: Kit) -> Group:
    """Return a support with seats half under it, and things on it."""
    support = _at(kit.make(rng, one_of(rng, kit.recipes.supports)), 0.0, 0.0)
    name, chair_seed = one_of(rng, kit.recipes.seats), int(rng.integers(2**31))
    skin = kit.skin(rng)
    (x0, y0, _), (x1, y1, _) = support.model.bounds_m()
    seats: list[Placement] = []
    for _ in range(count(rng, 1, 6)):
        own = np.random.default_rng(chair_seed)
        chair = SHAPES[name](own, lambda _: skin) if chance(rng, 0.9) else kit.make(rng, name)
        side, yaw = int(rng.integers(4)), float(rng.normal(0, 0.15))
        reach = float(chair.bounds_m()[1, 0])
        for out in np.arange(uniform(rng, -0.9, 0.6) * reach, reach + 0.3, 0.08):
            along = uniform(rng, -0.7, 0.7)
            x, y, turn = (
                (x1 + out, along * y1, np.pi),
                (x0 - out, along * y1, 0.0),
                (along * x1, y1 + out, -np.pi / 2),
                (along * x1, y0 - out, np.pi / 2),
            )[side]
            one = _at(chair, float(x), float(y), turn + yaw)
            if _is_clear(one, [support, *seats]):
                seats.append(one)
                break
    things = filled(rng, kit, support)
    if len(support.model.surfaces) == 1 and support.model.surfaces[0].headroom_m >= _OPEN_M and chance(rng, 0.3):
        things = _on_cloth(rng, kit, support, things)
    return Group(placed=(support, *seats, *things), is_at_wall=False)


def _on_cloth(rng: np.random.Generator, kit: Kit, support: Placement, things: Sequence[Placement]) -> list[Placement]:
    surface = support.model.surfaces[0]
    half = np.asarray(surface.half_m) + 0.012
    fall = min(uniform(rng, 0.05, 0.35), 0.9 * surface.center_m[2])
    cloth = tablecloth(rng, (float(half[0]), float(half[1])), fall, kit.skin(rng))
    x, y, z = surface.center_m
    world_from_cloth = support.world_from_object @ at_place(x, y, z + REST_M, 0.0)
    lift = at_place(0.0, 0.0, float(cloth.bounds_m()[1, 2]) + REST_M, 0.0)
    lifted = [replace(one, world_from_object=lift @ one.world_from_object) for one in things]
    return [Placement(model=cloth, world_from_object=world_from_cloth), *lifted]


def clothes_rail(rng: np.random.Generator, kit: Kit) -> Group:
    """Return a rail with cloths that hang over it side by side, some touching."""
    length, height = uniform(rng, 0.6, 1.6), uniform(rng, 0.7, 1.6)
    frame = Model(kind="rail", parts=rail(rng, length, height, kit.skin(rng)))
    placed, y = [_at(frame, 0.0, 0.0)], -length / 2 + 0.03
    while y < length / 2 - 0.15:
        width = min(uniform(rng, 0.12, 0.6), length / 2 - 0.03 - y)
        falls = (uniform(rng, 0.15, 0.9) * (height - 0.1), uniform(rng, 0.1, 0.9) * (height - 0.1))
        cloth = hung_cloth(rng, width, falls, kit.skin(rng))
        placed.append(_at(cloth, 0.0, y + width / 2, 0.0, height + 0.01))
        y += width + uniform(rng, 0.0, 0.2)
    return _pulled(placed, is_at_wall=chance(rng, 0.6))


def wall_boards(rng: np.random.Generator, kit: Kit) -> Group:
    depth, length, thick = uniform(rng, 0.12, 0.35), uniform(rng, 0.4, 1.8), uniform(rng, 0.015, 0.05)
    skin, gap, placed = kit.skin(rng), uniform(rng, 0.25, 0.45), []
    for i in range(count(rng, 1, 3)):
        board = block((depth, length, thick), skin, at=(0, 0, thick / 2))
        top = Surface(
            center_m=(0.0, 0.0, thick), half_m=(depth / 2 - 0.005, length / 2 - 0.01), headroom_m=gap - thick - 0.01
        )
        one = _at(Model(kind="board", parts=(board,), surfaces=(top,)), depth / 2 + 0.001, 0.0, 0.0, 0.7 + i * gap)
        placed += [one, *filled(rng, kit, one)]
    return Group(placed=tuple(placed), is_at_wall=True)


def curtained(rng: np.random.Generator, kit: Kit) -> Group:
    """Return one or two curtains before a wall, a body between or beside them."""
    skin, placed, y = kit.skin(rng), [], 0.0
    for _ in range(count(rng, 1, 2)):
        width, height = uniform(rng, 0.3, 1.2), uniform(rng, 1.2, 2.1)
        placed.append(_at(curtain(rng, (width, height), skin), 0.09, y + width / 2, 0.0, uniform(rng, 0.005, 0.08)))
        y += width + uniform(rng, 0.02, 0.6)
    if chance(rng, 0.5):
        body = kit.make(rng, one_of(rng, kit.recipes.bodies))
        placed.append(_at(body, 0.18 - float(body.bounds_m()[0, 0]), y * uniform(rng, 0.2, 0.8)))
    return Group(placed=tuple(placed), is_at_wall=True)


def _is_clear(one: Placement, others: Sequence[Placement]) -> bool:
    mine, outline = part_boxes(one.model, one.world_from_object), corners_of(one.model, one.world_from_object)
    return not any(
        do_overlap(outline, corners_of(other.model, other.world_from_object))
        and shared_volume_m3(mine, part_boxes(other.model, other.world_from_object)) > 0.0
        for other in others
    )


def floor_heap(rng: np.random.Generator, kit: Kit) -> Group:
    number, most = count(rng, 5, 16), uniform(rng, 0.15, 0.6)
    drawn = kit.alike(rng, number) if chance(rng, 0.3) else [kit.small(rng) for _ in range(number)]
    grown = [_grown(model, uniform(rng, 0.4, 1.0) * most) for model in drawn]
    half = max(uniform(rng, 0.2, 0.7), 0.8 * most)
    placed = [
        Placement(model=m, world_from_object=pose)
        for m, pose in heap(rng, grown, (half, half * uniform(rng, 0.5, 1.5)))
    ]
    return _pulled(placed, is_at_wall=chance(rng, 0.4))


def _pulled(placed: Sequence[Placement], *, is_at_wall: bool) -> Group:
    # Bounds of tilted things are those of their vertices.
    low = min(
        float((p.vertices @ one.world_from_object[0, :3]).min()) + one.world_from_object[0, 3]
        for one in placed
        for p in one.model.parts
    )
    moved = at_place(0.003 - low, 0.0, 0.0, 0.0)
    return Group(
        placed=tuple(replace(one, world_from_object=moved @ one.world_from_object) for one in placed),
        is_at_wall=is_at_wall,
    )


def _grown(model: Model, size_m: float) -> Model:
    factor = size_m / float(np.ptp(model.bounds_m(), axis=0).max())
    return stretched(model, (factor,) * 3)


def floor_stacks(rng: np.random.Generator, kit: Kit) -> Group:
    half = (uniform(rng, 0.25, 0.6), uniform(rng, 0.3, 0.8))
    made = CONTENTS[one_of(rng, ("stacks", "stacks", "same", "heap"))](rng, kit, Place(half_m=half, headroom_m=1.6))
    placed = [Placement(model=model, world_from_object=pose) for model, pose in made]
    if chance(rng, 0.3):
        pallet = _at(SHAPES["pallet"](rng, kit.skin), 0.0, 0.0)
        top = float(pallet.model.bounds_m()[1, 2])
        lifted = at_place(0.0, 0.0, top, 0.0)
        inside = pallet.model.surfaces[0].half_m
        placed = [replace(one, world_from_object=lifted @ one.world_from_object) for one in placed]
        placed = [one for one in placed if (np.abs(one.world_from_object[:2, 3]) < inside).all()]
        placed.insert(0, pallet)
    return _pulled(placed, is_at_wall=chance(rng, 0.5)) if placed else solitary(rng, kit)


def carton_wall(rng: np.random.Generator, kit: Kit) -> Group:
    """Return cartons of a few sizes piled flush against a wall, in columns."""
    name = "big_carton" if chance(rng, 0.6) else one_of(rng, kit.recipes.bodies)
    skin, placed, y = kit.skin(rng), [], 0.0
    alike = chance(rng, 0.5)
    makes: list[Model] = []
    for _ in range(count(rng, 2, 5)):
        z, width = REST_M, 0.0
        for _ in range(count(rng, 1, 4)):
            if not makes or chance(rng, 0.5):
                makes.append(SHAPES[name](rng, (lambda own: skin) if alike else kit.skin))
            model = one_of(rng, makes)
            low, high = model.bounds_m()
            if z + high[2] > 2.2:
                break
            placed.append(_at(model, uniform(rng, 0.001, 0.03) - float(low[0]), y - float(low[1]), 0.0, z))
            width, z = max(width, float(high[1] - low[1])), z + float(high[2]) + REST_M
            if not model.surfaces:
                break
        y += width + one_of(rng, (0.0008, 0.003, 0.03))
    return Group(placed=tuple(placed), is_at_wall=True)


def solitary(rng: np.random.Generator, kit: Kit) -> Group:
    """Return one body or seat, at a wall or free."""
    model = kit.make(rng, one_of(rng, (*kit.recipes.bodies, *kit.recipes.bodies, *kit.recipes.seats)))
    away, turn = one_of(rng, (0.001, 0.01, 0.1)), 0.0
    is_at_wall = chance(rng, 0.6)
    one = _backed(model, 0.0, away) if is_at_wall else _at(model, 0.0, 0.0, turn)
    return Group(placed=(one, *filled(rng, kit, one, 0.7)), is_at_wall=is_at_wall)


def floor_spread(rng: np.random.Generator, kit: Kit) -> Group:
    """Return small things scattered on the floor, apart or touching."""
    half = (uniform(rng, 0.2, 0.8), uniform(rng, 0.2, 0.8))
    made = CONTENTS[one_of(rng, kit.recipes.contents)](rng, kit, Place(half_m=half, headroom_m=1.0))
    if not made:
        return solitary(rng, kit)
    return Group(placed=tuple(Placement(model=m, world_from_object=pose) for m, pose in made), is_at_wall=False)


def leaning(rng: np.random.Generator, kit: Kit) -> Group:
    """Return boards, pictures or poles that lean against the wall."""
    placed, y = [], 0.0
    for _ in range(count(rng, 1, 4)):
        width, high, thick = uniform(rng, 0.05, 0.9), uniform(rng, 0.4, 1.8), uniform(rng, 0.01, 0.06)
        board = stretched(SHAPES["carton"](rng, kit.skin), (1.0, 1.0, 1.0))
        size = np.ptp(board.bounds_m(), axis=0)
        board = stretched(board, (thick / size[0], width / size[1], high / size[2]))
        angle = uniform(rng, 0.06, 0.3)
        low = board.bounds_m()[0]
        # Its upper back edge touches the wall, its lower front edge the floor.
        x = np.sin(angle) * high + thick / 2 * np.cos(angle) + 0.004
        rotation = about_y(-angle)
        lift = -float((np.concatenate([p.vertices for p in board.parts]) @ rotation[2]).min()) + REST_M
        placed.append(
            Placement(
                model=board, world_from_object=from_rotation_translation(rotation, np.array([x, y - low[1], lift]))
            )
        )
        y += width + uniform(rng, 0.002, 0.3)
    return _pulled(placed, is_at_wall=True)


def back_to_back(rng: np.random.Generator, kit: Kit) -> Group:
    """Return two rows of supports, back to back without a gap."""
    placed: list[Placement] = []
    for turn in (0.0, np.pi):
        y = 0.0
        for _ in range(count(rng, 1, 3)):
            model = kit.make(rng, one_of(rng, kit.recipes.supports))
            low, high = model.bounds_m()
            x = 0.0008 - float(low[0])
            at = y - float(low[1]) if turn == 0.0 else y + float(high[1])
            placed.append(_at(model, x if turn == 0.0 else -x, at, turn))
            y += float(high[1] - low[1]) + 0.001
    return Group(placed=(*placed, *(t for one in placed for t in filled(rng, kit, one, 0.7))), is_at_wall=False)


def corner_pile(rng: np.random.Generator, kit: Kit) -> Group:
    """Return bodies pushed together, each touching the next, with small things on and beside them."""
    taken, placed, y = Taken(), [], 0.0
    for _ in range(count(rng, 2, 4)):
        model = kit.make(rng, one_of(rng, (*kit.recipes.bodies, *kit.recipes.supports, *kit.recipes.units)))
        low, high = model.bounds_m()
        one = _at(model, uniform(rng, 0.001, 0.2) - float(low[0]), y - float(low[1]))
        y += float(high[1] - low[1]) + 0.0008
        taken.take(corners_of(model, one.world_from_object))
        placed += [one, *filled(rng, kit, one, 0.6)]
    front = max(float(corners[:, 0].max()) for corners in taken.corners)
    for _ in range(count(rng, 1, 5)):
        thing = kit.small(rng)
        pose = at_place(uniform(rng, 0.3 * front, front + 0.3), uniform(rng, 0.0, y), REST_M, uniform(rng, -3, 3))
        if taken.take(corners_of(thing, pose)):
            placed.append(Placement(model=thing, world_from_object=pose))
    return Group(placed=tuple(placed), is_at_wall=True)


GROUPS: dict[str, Callable[[np.random.Generator, Kit], Group]] = {
    f.__name__: f
    for f in (
        flush_row, filled_support, table_with_seats, floor_heap, floor_stacks, floor_spread, carton_wall, solitary,
        leaning, clothes_rail, wall_boards, curtained, back_to_back, corner_pile,
    )
}  # fmt: skip
"""The arrangements by name."""
