"""Configuration keys of earlier versions: what took their place, so that a file that names one is refused with it.

A map records the configuration that it was made with: `with_current_names` reads one that an earlier version wrote.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

_SET = "set "
# Sections are nested less deeply than this; what a map records more deeply is no section.
_DEPTH = 8
_PRIOR = "the map's effect on a frame is perception.geometric.join.map_prior"
_LEARNED = "trees that were trained with the network's odds join fragments"
_GEOMETRY = "geometry decides what is structure"
_KINDS = "what is large, or a part of the room, is a fixture of the map"
_EXISTENCE = "new_view_gain same_view_gain min_gain fresh again least apart_rad apart_ratio full_sr".split()
_TIME = "time of observation counts now, by"
_SENSOR = "the range is that of the camera, sensor.max_m"
_NEAREST = "the least depth is that of the camera, sensor.min_m"
_MASKS = "masks are evidence for joining fragments, whose limits are in perception.geometric"
_SEEN = "what is filled follows from what was seen around it"

FORMER_KEYS = {
    "perception.observe.voxel_m": "set mapping.voxels.object_m",
    "mapping.track.voxel_m": "set mapping.voxels.object_m",
    "perception.space.voxel_m": "set mapping.voxels.space_m",
    "mapping.space_voxel_m": "set mapping.voxels.space_m",
    "mapping.lattice.points_m": "set mapping.voxels.object_m",
    "mapping.lattice.space_m": "set mapping.voxels.space_m",
    "mapping.associate.swollen": "set mapping.associate.oversize_ratio",
    # Of another unit: a recorded number is not taken over.
    **dict.fromkeys((f"mapping.existence.{name}" for name in _EXISTENCE), f"{_TIME} mapping.lifecycle.confirm_s"),
    "mapping.lifecycle.confirm_sightings": f"{_TIME} mapping.lifecycle.confirm_s",
    "mapping.lifecycle.phantom_frames": f"{_TIME} mapping.lifecycle.phantom_s",
    "mapping.merge.min_votes": f"{_TIME} mapping.merge.min_together_s",
    "mapping.merge.sure_votes": f"{_TIME} mapping.merge.min_together_s",
    "mapping.split.min_apart": f"{_TIME} mapping.split.min_apart_s",
    "perception.geometric.surface.max_depth_m": _SENSOR,
    "perception.observe.max_depth_m": _SENSOR,
    **dict.fromkeys(("perception.observe.min_depth_m", "perception.geometric.surface.min_depth_m"), _NEAREST),
    "perception.space.max_depth_m": "free space reaches as far as depth is sure to a voxel",
    "perception.observe.max_box_m": _KINDS,
    "perception.geometric.max_extent_m": _KINDS,
    "registration.way_share": "set registration.drift_share",
    "graph.way_noise": "set graph.path_noise",
    "shapes.judgement.most_less": "set shapes.judgement.max_less",
    "graph.way_share": "set graph.drift_share",
    "loops.most_candidates": "set loops.max_candidates",
    "loops.least_agreement": "set loops.min_agreement",
    "run.i_accept": "set run.accept_licence",
    "run.late_s": "set run.max_late_s",
    "perception.geometric.shades": "its numbers are fixed now",
    "perception.geometric.hidden_area_px": "its number is fixed now",
    "perception.geometric.hidden_share": "its number is fixed now",
    "perception.geometric.structure.relief": "its numbers are fixed now",
    "perception.geometric.join.hidden": "its numbers are fixed now",
    **dict.fromkeys((f"perception.masks.{name}" for name in ("hidden_share", "min_area_px", "max_extent_m")), _MASKS),
    "mapping.parts": "set mapping.split",
    "mapping.floating": "its numbers are fixed now",
    "mapping.lifecycle.structure_m": _KINDS,
    "mapping.lifecycle.revise_evidence": _KINDS,
    "mapping.lifecycle.finds_structure": _KINDS,
    "perception.map_guided_merge": _PRIOR,
    "perception.known": _PRIOR,
    **dict.fromkeys(
        (
            f"perception.affinities.{name}"
            for name in ("join", "least_odds", "far_weight", "trees_weight", "near_weight", "far_odds_weight")
        ),
        _LEARNED,
    ),
    "perception.affinities.learned_probability": "set perception.geometric.join.probability",
    "perception.geometric.join.forest": "one forest joins fragments, with the network's odds or without",
    "perception.affinities.odds_shift": _LEARNED,
    "perception.affinities.split.odds_shift": _LEARNED,
    "perception.affinities.structure_odds": _GEOMETRY,
    "perception.affinities.thing_odds": _GEOMETRY,
    **dict.fromkeys(
        (f"shapes.fused.completion.{name}" for name in ("full_share", "min_hidden_m", "max_hidden_m")), _SEEN
    ),
}
"""What took the place of a key, or of a section; "set " begins the name of another one."""

_FIXED = """\
registration step_m=0.001 turn_of_metre_deg=0.05 turn_deg=0.05 unseen_share=0.3 tilt_deg=0.5 jump_m=0.05 jump_deg=2
    contradiction_sigmas=2.5 contradictions=4 bound_sigmas=6 max_depth_sigma_m=0.1 surface_noise_m=0.005
    num_independent=200 first_scale_m=0.06 last_scale_m=0.015 num_iterations=6 least_cosine=0.85 num_patches=12
    num_recent=3 anchor_overlap=0.7 num_covering=3 least_points=300 least_fit=0.35 found_m=0.02 found_deg=1
    lost_keyframes=8
perception.geometric.surface normal_radius_px=3 min_depth_m=0.2
perception.geometric.structure floor_area_m2=0.25 wall_area_m2=0.45 behind_share=0.02 tolerance_m=0.025 storey_m=2.4
    wall_height_m=2.1 wall_foot_m=1.2 wall_cut_m=1.5 wall_width_m=0.9 furniture_depth_m=0.75 backing_m2=0.15
perception.geometric.structure.raised_patches window_px=5 least_m=0.009 sigmas=3 min_area_px=24 color_step=12
    reach_px=12 min_border_share=0.3 min_border_px=2
perception.geometric.structure.ground cell_m=0.2 level_m2=1.5 gap_m=1 off_plane_m=0.05 off_plane_m2=1
perception.geometric.fragments step_m=0.008 gap_share=0.025 crease_rad=0.45 crease_reach_px=2 min_pixels=12
perception.geometric.color_split window_px=5 lightness=0.5 min_step=12 min_separation=0.7 min_pixels=16 depth=2
perception.geometric.join rounds=12 reach_px=3 gap_m=0.2 forest=sizes
perception.geometric.join.bridging gap_m=0.5 tolerance_m=0.006 min_lines=4 min_share=0.12 other_lines=2
perception.geometric.join.map_prior min_sightings=4 min_share=0.5
perception.geometric min_side_sigmas=2.5 occluded_area_px=720 occluded_share=0.6 support_area_m2=0.03
    support_area_px=60
perception.semantic.panoptic mask_threshold=0.5 overlap=0.3
perception.masks max_share=0.6 structure_share=0.5 duplicate_iou=0.8 inside_share=0.85 stands_out_m=0.008
    flat_area_m2=0.008 visible_share=0.25 occluded_share=0.6 min_area_px=240 max_extent_m=4
perception.observe min_depth_m=0.2 agree_sigmas=3 min_neighbors=5 min_returns=24 min_points=12
mapping.track sketch_growth=0.3
mapping.associate settled_sightings=5 swollen_over=0.5 most_doubted=4 patience=3 patience_share=0.2 lies_in=0.2
mapping.existence new_view_gain=2 same_view_gain=0.7 min_gain=0.5 fresh=2 again=0.7 least=0.5 apart_rad=0.6
    apart_ratio=2 full_sr=0.004
mapping.lifecycle confirm_sightings=4 phantom_frames=4 revise_evidence=2 structure_m=2.6 finds_structure=1
    phantom_share=0.7 structure_m3=12 wall_foot_m=0.7 wall_top_m=1.25 wall_height_m=0.75 wall_thickness_m=0.22
    lintel_foot_m=1.4 lintel_top_m=2.1
    structure_share=0.5 wall_share=0.15 wall_hits=4 wall_against=2
mapping.merge min_votes=3 duplicate_share=0.5 sure_share=0.7 covers_share=0.3 sure_votes=6 sure_ratio=0.7
    neighbor_sightings=2 foreign_share=0.9
mapping.split min_apart=4 apart_ratio=2 same_share=0.45 covered_share=0.6 alone_share=0.8 min_voxels=40
    min_size_m=0.025 part_inside=0.55 part_volume=0.5
mapping.views cut_worth=0.7 better_by=1.4
mapping.requests refuted_share=0.1 replace_by=0.5
mapping.flush thickness_m=0.12 min_size_m=0.2 reach_m=0.2 border_share=0.25 max_offset=0.8 foot_m=0.1 edge_width_m=0.1
    edge_height_m=0.38 edge_reach_m=0.1 edge_share=0.8
mapping.support min_points=10 beside_m=0.04 leg_beside_m=0.08 corner_m=0.06 level_m=0.15 leg_slender=1.5
    leg_inside=0.5 leg_gap_m=0.3 leg_overlap_m=0.05 thin_leg=0.04 leg_covered=0.4 pot_inside=0.6 pot_slice=0.15
    pot_under=0.7 foot_step_m=0.2 foot_height_m=0.1 foot_slice_m=0.03 foot_slice=0.15 foot_under=0.7 foot_covered=0.8
    part_inside=0.8 part_volume=0.3 part_slack_m=0.02 touch_share=0.03 panel_m=0.1 panel_width_m=0.2
    panel_length_m=0.4 panel_gap_m=0.05 ring_m=0.04 ring_share=0.2 ring_below_m=0.04 ring_above_m=0.02 rise_m=0.025
    under_below_m=0.1 under_above_m=0.03 under_beside_m=0.03 under_sectors=4 under_quantile=0.8 lower_m=0.01
    floor_m=0.35
mapping.unsupported min_height_m=0.25 free_share=0.9 support_m=0.06 support_share=0.1 wall_m=0.1 attach_m=0.15
mapping.submaps drift_share=0.01 drift_per_rad_m=0.005 surface_m=0.08 surface_range_m=5
loops least_apart=2 least_overlap=0.15 most_sigma_m=0.7 least_points=150 rival_share=0.85 correct_m=0.02
    correct_deg=0.3
graph floor_m=0.01 floor_rad=0.002 turn_noise=0.0045 turn_share=0.005 registered_times=4
    degenerate_share=0.3 jump_m=30 jump_rad=3 gate_chi2=22.46 inlier_chi2=16.81
shapes.fused.volume max_faces=20000 spread=1.6 smoothing=15 seen_voxels=1.5
shapes.fused.completion min_hit_share=0.08 max_free_ratio=0.9 max_support_gap_m=0.08 min_feet_area_m2=0.25
    min_edge=0.33 max_clear=0.35 edge_ratio=1.5 min_piece_share=0.02
shapes.fused.revolution num_bins=13 max_misfit=0.11 max_ratio=0.7 max_contradiction=0.3
shapes.fused turned_trust=0.2
shapes.single_view.volume max_faces=20000 spread=1.6 smoothing=15 seen_voxels=1.5
shapes.single_view.completion min_hit_share=0.08 max_free_ratio=0.9 max_support_gap_m=0.08 min_feet_area_m2=0.25
    min_edge=0.33 max_clear=0.35 edge_ratio=1.5 min_piece_share=0.02
shapes.single_view.symmetry max_contradiction=0.1 growth_penalty=0.6 min_second_score=0.25 contradiction_penalty=4
    max_points=800
shapes.single_view mirror_trust=0.2
shapes.placement coarse_share=0.06 fine_share=0.02 free_weight=1 support_weight=0.1 stretch_gain=0.1 cells=40
    surface_points=400 mesh_points=400
shapes.judgement tolerance_share=0.03 min_explained=0.67 max_violated=0.3 min_silhouette=0.6 min_other_silhouette=0.5
    max_support_gap=0.1 most_less_foretold=0.1
shapes.blend reach_voxels=10 seam_voxels=1 min_part=0.02
shapes.fit band_cells=3 min_thickness_cells=3.5 min_gain=0.015 waste_weight=1.5 merge_loss=0.02 num_rounds=1
    joint_sweeps=15 simple_samples=40000 simple_samples_each=600 simple_sweeps=5 simple_tolerance=0.03
    min_explained=0.5 min_overlap=0.7 max_protruding=4 protruding_cells=3
shapes.inflate tolerance=0.01
journal jpeg_quality=80
rerun cloud_period_s=1 structure_every=20
"""
"""Keys whose number became a constant beside its rule: each section, then its keys with their numbers."""


def refusal(key: str, value: Any) -> str | None:
    """Return why a key or a section of a file is refused, and what took its place; None if it was never one."""
    if isinstance(value, dict):
        inner = (refusal(f"{key}.{name}", item) for name, item in value.items())
        if (found := next((one for one in inner if one is not None), None)) is not None:
            return found
    root = "mapper." if key.startswith("mapper.") else ""
    path = key.removeprefix(root)
    if path in FORMER_KEYS:
        instead = FORMER_KEYS[path]
        instead = f"{_SET}{root}{instead.removeprefix(_SET)}" if instead.startswith(_SET) else instead
    elif path in fixed_keys():
        instead = f"it is fixed at {fixed_keys()[path]:g} now"
    else:
        return None
    return f"{key} is no setting any more: {instead}"


@cache
def fixed_keys() -> Mapping[str, float | str]:
    """Return the numbers, and names, of the keys that became constants."""
    found, section = dict[str, float | str](), ""
    for word in _FIXED.split():
        name, is_key, text = word.partition("=")
        if is_key:
            found[f"{section}.{name}"] = text if text.isalpha() else float(text)
        else:
            section = name
    return found


def with_current_names(data: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Return a recorded configuration with today's names, without keys that are fixed now at the recorded number.

    `data` is the section `where` ("shapes.") of the mapper's configuration, by default all of it.
    """
    found: dict[str, Any] = {}
    for old, value in _leaves(data, where):
        path = _current_name(old)
        if path in fixed_keys() and value == fixed_keys()[path]:
            continue
        at: Any = found
        *sections, name = path.removeprefix(where).split(".")
        for section in sections:
            at = at.setdefault(section, {}) if isinstance(at, dict) else None
        if isinstance(at, dict):
            at[name] = value
    return found


def _leaves(data: Mapping[str, Any], where: str) -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, dict) and where.count(".") < _DEPTH:
            yield from _leaves(value, f"{where}{name}.")
        else:
            yield f"{where}{name}", value


def _current_name(path: str) -> str:
    for old, instead in FORMER_KEYS.items():
        if instead.startswith(_SET) and (path == old or path.startswith(f"{old}.")):
            return instead.removeprefix(_SET) + path.removeprefix(old)
    return path
