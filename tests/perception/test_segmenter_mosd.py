from tools.evaluation.masks.labelled_clouds import clouds_in, load_cloud, score_cloud
from tools.evaluation.masks.scores import total


def test_things_on_a_real_table_are_masks_of_their_own(mosd):
    score = total(score_cloud(load_cloud(path)) for path in clouds_in(mosd))
    assert score.f1 >= 0.8
    assert score.best_iou >= 0.75
