import numpy as np
import pytest
from hypothesis import given, settings
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import centroid_world
from tests.strategies import seeds
from tools.evaluation.simulated_maps.simulate import SimulationConfig, real_fits, simulate_pair, simulate_unrelated
from tools.evaluation.simulated_maps.trial import noise_floor, run_trial


@settings(max_examples=10)
@given(seed=seeds)
def test_common_objects_are_where_the_truth_says_up_to_the_noise(seed):
    pair = simulate_pair(SimulationConfig(num_objects=40, outliers=0.75), seed)
    assert len(pair.map_a) == len(pair.map_b) == 40
    assert len(pair.common) == 10
    places_a = pair.map_a.centroids[pair.common[:, 0]]
    places_b = apply(pair.a_from_b, pair.map_b.centroids[pair.common[:, 1]])
    assert np.abs(places_a - pair.common_centroids_a).max() < 0.3
    assert np.abs(places_b - pair.common_centroids_a).max() < 0.3
    for place, shape in zip(pair.map_a.centroids, pair.map_a.shapes, strict=True):
        assert np.allclose(place, centroid_world(shape))


@pytest.mark.parametrize(
    ("difficulty", "same", "alike"), [("easy", (0.94, 0.05), (0.75, 0.08)), ("hard", (0.93, 0.03), (0.92, 0.03))]
)
def test_cosines_have_the_wanted_means_and_spreads(difficulty, same, alike):
    pairs = [
        simulate_pair(SimulationConfig(num_objects=60, outliers=0.0, difficulty=difficulty), seed) for seed in range(4)
    ]
    own, others = [], []
    for pair in pairs:
        assert pair.map_a.features is not None
        cosines = pair.map_a.features @ pair.map_b.features.T
        i, j = pair.common.T
        own.append(cosines[i, j])
        cosines[i, j] = np.nan
        others.append(cosines[np.isfinite(cosines)])
    found, rest = np.concatenate(own), np.concatenate(others)
    assert abs(found.mean() - same[0]) < 0.015
    assert abs(found.std() - same[1]) < 0.015
    # The gap between the classes: what is above it is of one class.
    classmates = rest[rest > 0.56]
    assert abs(np.median(classmates) - alike[0]) < 0.03
    assert abs(classmates.std() - alike[1]) < 0.02
    assert abs(rest[rest < 0.56].mean() - 0.25) < 0.06


def test_equal_seeds_give_equal_maps_and_others_differ():
    one, two, three = (simulate_pair(SimulationConfig(num_objects=8), seed) for seed in (1, 1, 2))
    assert one.map_b.centroids.tobytes() == two.map_b.centroids.tobytes()
    assert one.map_a.features.tobytes() == two.map_a.features.tobytes()
    assert not np.allclose(one.map_b.centroids, three.map_b.centroids)


def test_simulated_maps_have_the_tilt_asked_for_or_are_unrelated():
    pair = simulate_pair(SimulationConfig(tilt_deg=15.0), 0)
    assert np.isclose(np.degrees(np.arccos(pair.a_from_b[2, 2])), 15.0)
    assert np.isclose(simulate_pair(SimulationConfig(), 0).a_from_b[2, 2], 1.0)
    assert len(simulate_unrelated(SimulationConfig(), 0).common) == 0


def test_shapes_are_real_ones_about_their_centroids():
    assert len(real_fits()) > 60
    assert all(np.abs(centroid_world(shape)).max() < 1e-3 for shape in real_fits())


def test_a_trial_near_the_floor_is_a_success():
    config = SimulationConfig(outliers=0.5)
    floor_m, floor_deg = noise_floor(config, 0)
    assert 0.01 < floor_m < 0.05
    assert 0.05 < floor_deg < 0.5
    trial = run_trial(config, 0)
    assert trial.is_success
    assert not trial.is_wrong
    assert trial.error.translation_m < 6 * floor_m


@pytest.mark.parametrize("bad", [{"num_objects": -1}, {"outliers": 1.5}])
def test_a_simulation_of_nothing_sensible_is_refused(bad):
    with pytest.raises(ValueError, match="expected"):
        SimulationConfig(**bad)  # type: ignore[arg-type]
