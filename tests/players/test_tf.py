import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import from_rotation_translation, invert, yaw_rotation
from players.poses.interpolation import track_of
from players.poses.tf import Edge, FrameTree

angles = st.floats(-3, 3)
offsets = st.tuples(*[st.floats(-2, 2)] * 3)
transforms = st.builds(lambda a, t: from_rotation_translation(yaw_rotation(a), np.array(t)), angles, offsets)


def _static(parent, child, parent_from_child):
    return Edge(parent=parent, child=child, parent_from_child=parent_from_child)


def _at(tree, target, source, stamp_ns=0):
    return tree.chain(target, source).at(stamp_ns)


@given(transforms, transforms, transforms)
def test_a_chain_composes_links_and_its_inverse_leads_back(a, b, c):
    tree = FrameTree([_static("base", "mast", a), _static("mast", "camera", b), _static("base", "lidar", c)])
    np.testing.assert_allclose(_at(tree, "lidar", "camera"), invert(c) @ a @ b, atol=1e-9)
    np.testing.assert_allclose(_at(tree, "camera", "lidar"), invert(a @ b) @ c, atol=1e-9)


def test_a_frame_is_its_own_trees_are_apart_and_a_loop_ends():
    np.testing.assert_array_equal(_at(FrameTree([]), "camera", "camera"), np.eye(4))
    tree = FrameTree([_static("base", "camera", np.eye(4)), _static("world", "robot", np.eye(4))])
    assert tree.chain("world", "camera") is None
    tree = FrameTree([_static("a", "b", np.eye(4)), _static("b", "a", np.eye(4))])
    assert tree.ancestors("a") == ["a", "b"]


def test_a_moving_link_is_interpolated_and_ends_with_its_track():
    track = track_of([0, 100_000_000], [[0, 0, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 0, 1]], 500_000_000)
    tree = FrameTree([Edge(parent="odom", child="base", parent_from_child=track), _static("base", "camera", np.eye(4))])
    chain = tree.chain("odom", "camera")
    assert not chain.is_static
    assert chain.at(50_000_000)[0, 3] == 1.0
    assert chain.at(200_000_000) is None


def test_of_two_parents_the_static_one_is_kept():
    track = track_of([0, 1], [[0, 0, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 0, 1]], 1)
    moving = Edge(parent="odom", child="camera", parent_from_child=track)
    for edges in ([moving, _static("mast", "camera", np.eye(4))], [_static("mast", "camera", np.eye(4)), moving]):
        assert FrameTree(edges).ancestors("camera") == ["camera", "mast"]
