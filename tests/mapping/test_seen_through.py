import numpy as np
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.steps.ageing import is_seen_through
from tests.mapping.mapping_fixtures import box_surface, track

CONFIG = MappingConfig()
SPACE_M = CONFIG.voxels.space_m
BOX = box_surface((0.0, 0.0, 0.5), (0.4, 0.4, 0.4))


def test_what_rays_passed_for_the_most_part_was_looked_through():
    keys = np.unique(keys_of_points(BOX, SPACE_M))
    assert is_seen_through(track(1, BOX), keys, CONFIG)
    assert not is_seen_through(track(1, BOX), keys[: len(keys) // 2], CONFIG)
