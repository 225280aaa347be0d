"""Names are the field's: none of the private vocabulary that modules and identifiers once had is left."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tools.readmes import READMES

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parent.parent
OURS = ("hickory_stream", "players", "tools", "tests")
FILES = sorted(file for package in OURS for file in (ROOT / package).rglob("*.py"))

OLD_MODULES = {
    "relief": "raised_patches",
    "shades": "color_split",
    "hidden": "occlusion_bridging",
    "seams": "contacts",
    "standing": "support_contacts",
    "scenery": "room_structure",
    "part_sums": "region_sums",
    "sizes": "absolute_features",
    "strays": "residual_boxes",
    "pieces": "label_boxes, surface_partition",
    "parts": "region_graph, split_candidates, object_models",
    "merge": "track_merging, merge_maps",
    "carried": "support_relations",
    "floating": "unsupported",
    "against_structure": "structure_checks",
    "placing": "report_poses, support_placement",
    "going_back": "rewind",
    "continued": "resume_point",
    "fates": "track_histories",
    "pump": "pacing",
    "known": "map_prior",
}
# Of these names two or three modules had one each, for different things.
AMBIGUOUS = ("parts", "merge", "surface", "pieces")
# Words and phrases that had to be read twice.
OLD_PHRASES = (
    "by how much less easily",
    "every so manieth",
    "going back",
    "legs that no mask ever had",
    "no drop",
    "strays",
    "to and fro",
    "what a pillar divides",
)
OLD_NAMES = {
    "ReliefConfig": "RaisedPatchConfig",
    "relief": "raised_patches",
    "ShadeConfig": "ColorSplitConfig",
    "divided_by_color": "split_by_color",
    "HiddenConfig": "BridgingConfig",
    "are_one_behind": "is_bridged",
    "hidden_share": "occluded_share",
    "hidden_shares": "occluded_shares",
    "Standing": "SupportContacts",
    "standing_of": "support_contacts_of",
    "Scenery": "RoomStructure",
    "scenery": "room",
    "scenery_of": "room_structure_of",
    "PartSums": "RegionSums",
    "part_sums": "region_sums",
    "grouped_parts": "merged_regions",
    "grouped_pairs": "merged_pairs",
    "Parts": "Regions, SplitCandidates",
    "Measures": "RegionGraph",
    "size_features": "absolute_features",
    "PartConfig": "TrackSplitConfig",
    "moved_to": "reassigned",
    "FloatConfig": "UnsupportedConfig",
    "stem_of": "attachment_of",
    "with_strays_boxed": "with_residuals_boxed",
    "WentBack": "Rewound",
    "known_before": "rewound_to",
    "where_it_lies": "in_map_frame",
    "Continued": "ResumePoint",
    "continued_from": "resume_point_of",
    "TrackFate": "TrackHistory",
    "FateBook": "TrackHistories",
    "Pump": "Pacer",
}
# The command line names its modules by its commands.
COMMANDS = ROOT / "hickory_stream" / "cli"


def names_in(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name
            case ast.keyword(arg=str(name)) | ast.alias(name=name):
                yield name
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name


def test_no_module_has_an_old_name() -> None:
    found = {str(file.relative_to(ROOT)): file.stem.removeprefix("test_") for file in FILES if file.parent != COMMANDS}
    assert {path: OLD_MODULES[stem] for path, stem in found.items() if stem in OLD_MODULES} == {}


def test_no_identifier_has_an_old_name() -> None:
    found = {str(file.relative_to(ROOT)): set(names_in(ast.parse(file.read_text(encoding="utf-8")))) for file in FILES}
    left = {path: {name: OLD_NAMES[name] for name in names & OLD_NAMES.keys()} for path, names in found.items()}
    assert {path: names for path, names in left.items() if names} == {}


@pytest.mark.parametrize("stem", AMBIGUOUS)
def test_one_module_at_most_has_a_name_that_fits_many(stem: str) -> None:
    assert len([file for file in FILES if file.stem == stem and file.parent != COMMANDS]) <= 1


def test_no_docstring_or_message_has_an_old_phrase() -> None:
    """Nor have the READMEs."""
    texts = {readme: [readme.read_text(encoding="utf-8")] for readme in READMES}
    for file in FILES:
        if "tests" not in file.parts:
            nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
            texts[file] = [n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    found = [
        (str(file.relative_to(ROOT)), phrase)
        for file, parts in texts.items()
        for phrase in OLD_PHRASES
        if any(phrase in " ".join(text.lower().split()) for text in parts)
    ]
    assert found == []
