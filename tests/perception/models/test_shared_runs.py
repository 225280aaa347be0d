import threading
import time
from concurrent.futures import ThreadPoolExecutor
import numpy as np
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.models.semantic_graph import GraphSemantics, PanopticConfig
from hickory_stream.perception.models.shared_runs import IMAGES_A_RUN, SharedRuns
from tests.perception import small_graphs

BROKEN = 7.0
IMAGES = [np.full((1, 3, 2, 2), i, np.float32) for i in range(9)]


class Device:
    """A network that fails on one image; its first run goes on when all other calls wait."""

    def __init__(self, compute=lambda images: images.mean(axis=(2, 3))):
        self.sizes, self.is_busy, self.all_wait, self._compute = [], threading.Event(), threading.Event(), compute

    def run(self, images):
        self.is_busy.set()
        assert self.all_wait.wait(timeout=20)
        self.sizes.append(len(images))
        if (images == BROKEN).any():
            raise ModelError("no sevens")
        return [self._compute(images)]


def outputs_of(device, images=IMAGES):
    shared = SharedRuns(device.run)

    def found(image):
        try:
            return shared.run(image)[0]
        except ModelError as error:
            return str(error)

    with ThreadPoolExecutor(len(images)) as threads:
        calls = [threads.submit(found, images[0])]
        assert device.is_busy.wait(timeout=20)
        calls += [threads.submit(found, image) for image in images[1:]]
        while len(shared._waiting) < len(images) - 1:
            time.sleep(0.001)
        device.all_wait.set()
        return [call.result() for call in calls]


def test_images_that_wait_share_runs_of_one_size():
    device = Device()
    found = outputs_of(device, IMAGES[:7] + IMAGES[:2])
    np.testing.assert_array_equal(np.concatenate(found)[:, 0], [0, 1, 2, 3, 4, 5, 6, 0, 1])
    # Two to check, one of the first alone, two of the eight that waited.
    assert device.sizes == [IMAGES_A_RUN] * 5


def test_a_failure_costs_its_image_and_not_those_beside_it():
    found = outputs_of(Device())
    assert [one if isinstance(one, str) else one[0, 0] for one in found] == [0, 1, 2, 3, 4, 5, 6, "no sevens", 8]


def by_place(images):
    return images.mean(axis=(2, 3)) + 1e-7 * np.arange(len(images))[:, None]


def by_neighbours(images):
    return images.mean(axis=(2, 3)) + np.float32(1e-3) * images.max()


def one_row(images):
    return images.mean(axis=(2, 3))[:1]


@pytest.mark.parametrize("compute", [by_place, by_neighbours, one_row])
def test_images_run_alone_where_company_shows_in_results(compute):
    device = Device(compute)
    found = outputs_of(device, IMAGES[1:6])
    np.testing.assert_array_equal(np.concatenate(found), np.concatenate([compute(image) for image in IMAGES[1:6]]))
    assert device.sizes[2:] == [1] * 5


@pytest.mark.parametrize(
    ("images", "provider", "shared"),
    [(None, "cuda", IMAGES_A_RUN), (1, "cuda", 1), (None, "cpu", 1)],
    ids=["open", "fixed to one image", "no accelerator"],
)
def test_graphs_with_open_batches_share_runs_on_accelerators(tmp_path, images, provider, shared):
    network = Network(small_graphs.scores_by_color(tmp_path / "a.onnx", (images, 3, None, None)), NetworkConfig())
    model = GraphSemantics(network, ("r", "g", "b"), short_px=32, panoptic=PanopticConfig(), warm_up=False)
    pictures = np.random.default_rng(3).integers(0, 255, (6, 32, 64, 3), np.uint8)
    alone = [model.classify(picture).classes for picture in pictures]
    network.provider = provider
    assert model.share_runs() == shared

    def num_runs():
        before = network.num_runs
        with ThreadPoolExecutor(len(pictures)) as threads:
            together = [*threads.map(lambda picture: model.classify(picture).classes, pictures)]
        np.testing.assert_array_equal(together, alone)
        return network.num_runs - before

    # On a busy machine threads may come one after the other.
    assert any(num_runs() < len(pictures) for _ in range(20)) == (shared > 1)
