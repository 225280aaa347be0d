"""The parts of the gate, each one measurement."""
# A part is named by its world, walk, camera and rung (`home:A:hand:ours`), or by its subject (`kitchen`).

from collections.abc import Sequence
from dataclasses import dataclass

from hickory_stream.errors import InputError
from tools.evaluation.oracle_ablation import RUNGS, Rung

TUNED_WORLDS, REPORTED_WORLDS = ("home", "bookstore"), ("office", "warehouse")
WORLDS = (*TUNED_WORLDS, *REPORTED_WORLDS)
OWN = ("own1", "own2", "own3")
OUTDOORS = ("outdoor1", "outdoor2")
# Outdoors, by a camera that reaches 10 m; the first walk is the headline. A Jackal's log has walk A of the robot.
CAMPUS, JACKAL = "campus", "jackal"
CAMPUS_WALKS = (("A", "robot"), ("A", "hand"), ("B", "robot"), ("A", JACKAL))
WALKS, CAMERAS = ("A", "B"), ("hand", "robot")
TUNED, REPORTED = "tuned on", "reported"
ROLES = {
    **dict.fromkeys(TUNED_WORLDS, TUNED), **dict.fromkeys(REPORTED_WORLDS, REPORTED),
    **dict.fromkeys((*OWN, *OUTDOORS), "reported, fresh seeds of a generator that is tuned on"), "kitchen": REPORTED,
    "clouds_tuned": TUNED, "clouds_report": REPORTED, CAMPUS: TUNED,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """One measurement; `walk`, `camera` and `rung` are empty where they do not apply."""

    world: str
    walk: str = ""
    camera: str = ""
    rung: Rung = "ours"

    @property
    def name(self) -> str:
        return ":".join((self.world, self.walk, self.camera, self.rung)) if self.walk else self.world

    @property
    def is_map(self) -> bool:
        return self.world in (*WORLDS, CAMPUS, *OWN, *OUTDOORS)

    def is_named(self, name: str) -> bool:
        world, *rest = name.split(":")
        kind = self.world if self.walk else self.world.split("_")[0].rstrip("123")
        return world in (self.world, kind) and set(rest) <= {self.walk, self.camera, self.rung}


def all_parts() -> list[Part]:
    """Return the parts in the order in which they are measured, the most important ones first."""
    parts = [Part(world=world, walk="A", camera="hand") for world in WORLDS]
    parts += [Part(world=CAMPUS, walk=walk, camera=camera) for walk, camera in CAMPUS_WALKS]
    parts += [Part(world=name) for name in ("clouds_tuned", "clouds_report", "kitchen", "speed", *OWN, *OUTDOORS)]
    parts += [Part(world=world, walk="A", camera="hand", rung=rung) for world in WORLDS for rung in RUNGS[1:]]
    others = [(walk, camera) for walk in WALKS for camera in CAMERAS if (walk, camera) != ("A", "hand")]
    return parts + [Part(world=world, walk=walk, camera=camera) for walk, camera in others for world in WORLDS]


def chosen_parts(only: Sequence[str]) -> list[Part]:
    """Return the parts that `only` names, all where it is empty: `home`, `office:A`, `home:masks`, `own`, `clouds`."""
    # Raises InputError: a name means no part.
    names, parts = [name for text in only for name in text.split(",") if name], all_parts()
    for name in names:
        if not any(part.is_named(name) for part in parts):
            raise InputError(
                f"--only {name}: no such part; expected WORLD[:WALK][:CAMERA][:RUNG] of worlds {', '.join(WORLDS)}, "
                f"{CAMPUS}, walks A and B, cameras hand and robot ({CAMPUS}: and {JACKAL}), rungs {', '.join(RUNGS)}, "
                "or kitchen, clouds, own, outdoor, speed"
            )
    return [part for part in parts if not names or any(map(part.is_named, names))]
