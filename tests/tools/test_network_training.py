"""The training of the segmenter's network, on a few lessons.

Needs the extra `train` (torch); skipped without. Run: pytest -m reference tests/tools/test_network_training.py
"""

import dataclasses
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`: pip install -e '.[train]'")

from test_network_lessons import true_frame  # noqa: E402 -- after what is skipped without torch
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, OFFSETS, THING, PixelNetwork  # noqa: E402
from hickory_stream.perception.models.network import Network, NetworkConfig  # noqa: E402
from tests.perception.affinity.test_pixel_inputs import run_in_integers  # noqa: E402
from tools.network_training.export import export  # noqa: E402
from tools.network_training.lessons import UNKNOWN, lesson_of  # noqa: E402
from tools.network_training.model import inputs_of  # noqa: E402
from tools.network_training.scenes import Schedule, Stage  # noqa: E402
from tools.network_training.train import accuracies, batches, read_checkpoint, train, truth_of  # noqa: E402

pytestmark = [pytest.mark.reference, pytest.mark.timeout(600)]
FIRST, SECOND = Stage(steps=4, batch=1, rooms=(0, 1), rising=2), Stage(steps=2, batch=2, rooms=(1, 4), rising=2)
SHORT = Schedule(stages=(FIRST, SECOND), told_every=100, kept_every=3, precision="float32")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    checkpoint = tmp_path_factory.mktemp("network") / "net.pt"
    return train(lambda rng, stage: true_frame(), SHORT, checkpoint), checkpoint


def test_a_run_that_was_broken_off_ends_as_one_that_was_not(trained, tmp_path):
    whole, _ = trained
    broken_off = tmp_path / "net.pt"
    frame = true_frame()

    until_step_4 = [frame] * 4
    with pytest.raises(IndexError):
        train(lambda rng, stage: until_step_4.pop(), SHORT, broken_off)
    assert torch.load(broken_off, weights_only=True)["step"] == 3
    again = train(lambda rng, stage: frame, SHORT, broken_off)
    for a, b in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_a_checkpoint_of_an_earlier_version_is_refused(trained, tmp_path):
    kept = read_checkpoint(trained[1])
    del kept["elapsed_s"]
    torch.save(kept, tmp_path / "old.pt")
    with pytest.raises(RuntimeError, match="earlier version"):
        train(lambda rng, stage: true_frame(), SHORT, tmp_path / "old.pt")


def test_other_processes_make_the_same_lessons():
    frame = true_frame()
    alone, helped = (list(batches(lambda rng, stage: frame, SHORT, 2, processes)) for processes in (0, 2))
    assert [len(batch.labels) for batch in alone] == [1, 1, 2, 2]
    for one, other in zip(alone, helped, strict=True):
        for name in ("inputs", "labels", "weights"):
            torch.testing.assert_close(getattr(one, name), getattr(other, name), rtol=0, atol=0)


def test_the_exported_network_is_close_to_the_trained_one(trained, tmp_path):
    net, _ = trained
    inputs = [lesson_of(true_frame(), np.random.default_rng(seed)).inputs for seed in range(4)]
    path = tmp_path / "net.onnx"
    export(net, inputs, path)
    part = inputs[0][None, :, :64, :96]
    exported = Network(path, NetworkConfig(provider="cpu", threads=1)).run(part)[0]
    np.testing.assert_array_equal(exported, run_in_integers(path, part))
    with torch.no_grad():
        said = net(inputs_of(torch.from_numpy(part)))[0].numpy()
    assert np.abs((exported[0].astype(float) - 128) / 16 - said).mean() < 0.1
    PixelNetwork(path)


def test_what_is_to_be_said_of_pairs_follows_from_their_labels():
    labels = torch.full((1, 40, 60), 0, dtype=torch.int32)
    labels[0, 10:30, 10:30] = 3
    labels[0, 10:30, 30:50] = 4
    labels[0, :, 55:] = UNKNOWN
    true, known = (v[0].numpy() for v in truth_of(labels))
    assert true.shape == known.shape == (NUM_OUTPUTS, 40, 60)
    right = OFFSETS.index((0, 1))
    assert known[right, 15, 15]
    assert true[right, 15, 15]
    assert known[right, 15, 29]
    assert not true[right, 15, 29]
    # Of two pixels of structure, and of what is not known, nothing is said.
    assert not known[right, 2, 2]
    assert not known[right, 2, 54]
    assert true[THING, 15, 15]
    assert not true[THING, 2, 2]
    left_below = OFFSETS.index((9, -9))
    assert true[left_below, 12, 25]
    assert known[left_below, 12, 12]
    assert not true[left_below, 12, 12]


def test_it_learns_what_it_is_shown(tmp_path):
    schedule = dataclasses.replace(SHORT, stages=(Stage(steps=40, batch=1, rooms=(0, 1), rising=5, rate=4e-3),))
    frame = true_frame()
    net = train(lambda rng, stage: frame, schedule, tmp_path / "net.pt")
    found = accuracies(net, [lesson_of(frame, np.random.default_rng(seed)) for seed in range(100, 104)])
    assert found["thing"] > 0.9


def test_each_step_is_of_its_stage_and_its_rate_rises_and_falls():
    assert SHORT.steps == 6
    assert [SHORT.at(step) for step in (0, 3, 4, 5)] == [(FIRST, 0), (FIRST, 3), (SECOND, 0), (SECOND, 1)]
    with pytest.raises(IndexError):
        SHORT.at(6)
    stage = Stage(steps=100, batch=1, rooms=(0, 1), rate=1.0, rising=10, falling_share=0.2)
    assert [stage.rate_at(step) for step in (0, 4, 50, 90, 99)] == pytest.approx([0.1, 0.5, 1.0, 0.5, 0.05])
