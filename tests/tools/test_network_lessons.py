import dataclasses
import numpy as np
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.affinity.pixel_inputs import CHANNELS, NUM_INPUTS, ZERO
from tools.network_training.frames import HEIGHT_PX, WIDTH_PX, Scene, TrueFrame, frames_of_scene
from tools.network_training.lessons import UNKNOWN, lesson_of


def true_frame():
    """Return a wall at 2 m with a panel half a metre before it in the left half of the image."""
    depth = np.full((HEIGHT_PX, WIDTH_PX), 2.0, np.float32)
    instances = np.zeros(depth.shape, np.int32)
    depth[60:180, 30:130], instances[60:180, 30:130] = 1.5, 7
    depth[:10], instances[:10] = np.nan, -1
    camera = Camera(width=WIDTH_PX, height=HEIGHT_PX, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    rgb = np.full((HEIGHT_PX, WIDTH_PX, 3), 90, np.uint8)
    rgb[instances > 0] = (200, 60, 30)
    return TrueFrame(
        rgb=rgb, depth_m=depth, cosine=np.ones_like(depth), instances=instances, camera=camera, world_from_camera=pose
    )


def lessons(count=20):
    return [lesson_of(true_frame(), np.random.default_rng(seed)) for seed in range(count)]


def test_the_same_draw_gives_the_same_lesson():
    one, other = (lesson_of(true_frame(), np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.inputs, other.inputs)
    np.testing.assert_array_equal(one.labels, other.labels)


def test_labels_of_a_lesson_stay_on_the_image_when_mirrored():
    near = CHANNELS.index("valid")
    sides = set()
    for lesson in lessons():
        assert lesson.inputs.shape == (NUM_INPUTS, 256, 320)
        assert lesson.labels.shape == (128, 160)
        columns = np.flatnonzero((lesson.labels == 7).any(axis=0))
        sides.add(bool(columns.mean() > 80))
        # Whatever is to be told has a depth, at the pixel of the inputs that the output stands for.
        assert (lesson.inputs[near][::2, ::2][lesson.labels != UNKNOWN] != ZERO).all()
        assert (lesson.labels[120:] == UNKNOWN).all()
    assert sides == {False, True}


def test_some_lessons_lack_colour_and_some_height_and_scale():
    drawn = lessons()
    for name in ("light", "height", "scale"):
        absent = [bool((lesson.inputs[CHANNELS.index(name)] == ZERO).all()) for lesson in drawn]
        assert 0 < sum(absent) < len(absent)


def test_a_step_of_depth_is_told_where_labels_change():
    frame = dataclasses.replace(true_frame(), sensed_m=true_frame().depth_m)
    steps = []
    for seed in range(8):
        lesson = lesson_of(frame, np.random.default_rng(seed))
        bend = np.abs(lesson.inputs[CHANNELS.index("bend_x_4")].astype(int) - ZERO)[::2, ::2]
        seam = np.zeros(lesson.labels.shape, bool)
        seam[:, 1:] = (lesson.labels[:, 1:] == 7) != (lesson.labels[:, :-1] == 7)
        steps.append(bend[seam].mean() - bend[~seam].mean())
    assert min(steps) > 8


def test_frames_are_kept_as_they_were_rendered(tmp_path):
    scene = Scene(kind="clutter-training", seed=3, frames=2)
    made, kept = frames_of_scene(scene, tmp_path), frames_of_scene(scene, tmp_path)
    assert len(made) == 2
    for a, b in zip(made, kept, strict=True):
        np.testing.assert_array_equal(a.depth_m, b.depth_m)
        np.testing.assert_array_equal(a.instances, b.instances)
        assert np.nanmedian(np.abs(a.sensed_m - a.depth_m)) < 0.1
        assert a.instances.min() >= -1
    assert [path.name for path in tmp_path.iterdir()] == ["clutter-training-3-2.npy"]
