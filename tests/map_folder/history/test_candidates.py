from dataclasses import replace
import pytest
from hickory_stream.journal.step import Told
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.history.candidates import Candidates, candidates_of
from tests.journal.test_journal import entry
from tests.map_folder.history.test_track_histories import told

STEPS = (
    [told("create", i, "mask: new", observation_index=i) for i in range(1, 8)],
    [told("merge", 2, "#3 is the same: seen as one", other_id=3), told("drop", 4, cause="never confirmed")],
    [told("drop", 5, cause="looked through"), told("drop", 6, cause="never confirmed"), told("room", 7)],
)


def journal(folder, steps, **last):
    writer = JournalWriter(folder, flush_s=0.0)
    for i, decisions in enumerate(steps):
        made = entry(i)
        step = replace(made.step, **last) if i == len(steps) - 1 else made.step
        known = None if decisions is None else Told(decisions=tuple(decisions), submap_id=0)
        writer.append(replace(made, step=step, told=known))
    writer.close()
    return folder


def test_the_numbers_of_candidates_add_up_with_their_causes(tmp_path):
    found = candidates_of(journal(tmp_path, STEPS), {1, 2})
    causes = {"never confirmed": 2, "looked through": 1, "structure": 1}
    assert found == Candidates(made=7, kept=2, merged=1, dropped=4, causes=causes)
    assert next(iter(found.causes)) == "never confirmed"
    assert "7 candidates became 2 objects: 1 merged as parts of others, 4 dropped (2 seen too briefly" in found.text()


def test_candidates_that_a_seek_took_back_do_not_count(tmp_path):
    again = [told("create", 8, "mask: new", observation_index=0)]
    found = candidates_of(journal(tmp_path, [*STEPS, again], goes_back_to=1), {1, 2, 3, 4, 5, 6, 7, 8})
    assert (found.made, found.kept) == (8, 8)


@pytest.mark.parametrize("steps", [None, [STEPS[0], None]])
def test_without_decisions_nothing_is_said_of_candidates(tmp_path, steps):
    assert candidates_of(tmp_path if steps is None else journal(tmp_path, steps), {1}) is None
