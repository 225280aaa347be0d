from dataclasses import replace
import numpy as np
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.query.grammar import question_of
from tools.benchmarks.maps.true_questions import TrueThing, relations, true_questions


def test_questions_are_understood_and_a_tenth_has_no_answer(demo_truth):
    truth = load_truth(demo_truth)
    questions, again = (true_questions(truth, 40, np.random.default_rng(3)) for _ in range(2))
    assert questions == again
    assert len(questions) == len({one.text for one in questions}) == 40
    assert sum(not one.answers for one in questions) == 4
    for one in questions:
        assert question_of(one.text).thing.conditions
    kinds = {item.id: item.kind for item in truth.objects}
    seats = [one for one in questions if "to sit on" in one.text]
    assert seats
    assert {kinds[i] for one in seats for i in one.answers} <= {"chair", "sofa"}


def test_a_map_that_lacks_what_an_answer_holds_by_cannot_answer(demo_truth):
    questions = true_questions(load_truth(demo_truth), 200, np.random.default_rng(3))
    plain = {f"thing carrying something {name}" for name in ("red", "green", "blue", "yellow", "purple")}
    carrying = next(one for one in questions if one.text in plain and len(one.answers) == 1)
    (answer,) = carrying.answers
    (carried,) = carrying.witnesses[answer]
    assert carried
    assert answer not in carried
    assert carrying.is_held({answer, *carried})
    assert not carrying.is_held({answer})
    assert not carrying.is_held(carried)
    assert next(one for one in questions if not one.answers).is_held(())


def test_a_carrier_of_unclear_colour_is_not_asked_about():
    things = [thing("table", 0.0, (0.5, 0.5, 0.5)), thing("box", 0.5, (0.8, 0.1, 0.1))]
    maroon = replace(things[1], color=np.array([0.35, 0.25, 0.25]))
    assert [carries_red(things)(one) for one in things] == [True, False]
    assert carries_red([things[0], maroon])(things[0]) is None


def thing(kind, bottom_m, color):
    bounds = np.array([[0.0, 0.0, bottom_m], [1.0, 1.0, bottom_m + 0.5]])
    return TrueThing(id=len(kind), kind=kind, color=np.array(color), bounds=bounds)


def carries_red(things):
    return next(one.test for one in relations(things) if one.text == "carrying something red")
