from collections import Counter
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from hickory_stream.journal.format import JOURNAL, MAGIC
from hickory_stream.journal.mcap_file import index_of
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import StepKind
from hickory_stream.journal.writer import JournalWriter
from tests.journal.test_journal import NUM_STEPS, checkpoint, entry, read_numbers, write


def go_on(folder, *, steps=1):
    """Continue the journal of a folder with more steps, and close it."""
    with Journal(folder) as journal:
        journal.cut_to_resumable()
        count = len(journal)
        writer = JournalWriter(folder, flush_s=100.0, continued=journal)
    for i in range(count, count + steps):
        writer.append(entry(i), color=b"jpeg")
    writer.checkpoint(checkpoint(count), 1000 + count)
    writer.close()


def topics_of(folder):
    """Return the topic of each message as the MCAP library reads them, by the index and by the chunks alike."""
    with (folder / JOURNAL).open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        by_index = [channel.topic for _, channel, _ in reader.iter_messages(log_time_order=False)]
    counts = summary.statistics.channel_message_counts
    assert {summary.channels[i].topic: n for i, n in counts.items()} == Counter(by_index)
    assert summary.statistics.message_count == len(by_index)
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count
    return by_index


def is_whole(folder, num_steps):
    """Hold a journal of so many steps, as we read it, against what the MCAP library reads."""
    assert read_numbers(folder) == list(range(1, num_steps + 1))
    topics = topics_of(folder)
    assert topics.count("step") == num_steps
    return topics


@pytest.mark.parametrize("closes", [True, False])
def test_a_journal_is_gone_on_with_in_its_file_and_is_whole_mcap(tmp_path, closes):
    begun = write(tmp_path, closes=closes)
    with Journal(tmp_path) as journal:
        kept = begun[: journal.num_bytes]
    before = (tmp_path / JOURNAL).stat().st_ino
    go_on(tmp_path, steps=2)
    assert (tmp_path / JOURNAL).stat().st_ino == before
    assert (tmp_path / JOURNAL).read_bytes()[: len(kept)] == kept
    topics = is_whole(tmp_path, NUM_STEPS + 2)
    assert topics.count("color") == 1 + 2
    assert topics.count("checkpoint/2") == NUM_STEPS // 2 + 1


def test_a_run_killed_while_writing_the_index_loses_nothing(tmp_path):
    whole = write(tmp_path, last=StepKind.KEYFRAME, closes=False)
    with Journal(tmp_path) as journal:
        end = journal.num_bytes
        index = index_of(journal.last_records())
    assert whole[end:] == index
    # From behind the first record of the index on.
    for cut in range(end + 9 + int.from_bytes(index[1:9], "little"), len(whole) + 1):
        (tmp_path / JOURNAL).write_bytes(whole[:cut])
        go_on(tmp_path)
        is_whole(tmp_path, NUM_STEPS + 1)


def test_left_out_content_stays_readable_in_the_old_file(tmp_path):
    begun = write(tmp_path, last=StepKind.CLOSING)
    with (tmp_path / JOURNAL).open("rb") as old:
        go_on(tmp_path)
        assert old.read() == begun
    is_whole(tmp_path, NUM_STEPS)


def test_a_file_with_a_second_index_is_rewritten(tmp_path):
    whole = bytearray(write(tmp_path, closes=False))
    with Journal(tmp_path) as journal:
        end = journal.num_bytes
    whole[end + 20] ^= 1  # the stamp of a message
    (tmp_path / JOURNAL).write_bytes(whole)
    before = (tmp_path / JOURNAL).stat().st_ino
    go_on(tmp_path)
    assert (tmp_path / JOURNAL).stat().st_ino != before
    is_whole(tmp_path, NUM_STEPS + 1)


@pytest.mark.parametrize("content", [b"", bytes(5), bytes(28) + b"\xff" * 40])
def test_a_damaged_early_chunk_is_left_out_of_the_summary(tmp_path, content):
    whole = write(tmp_path, closes=False)
    first = first_chunk(whole)
    damaged = bytes([Opcode.CHUNK]) + len(content).to_bytes(8, "little") + content
    (tmp_path / JOURNAL).write_bytes(whole[:first] + damaged + whole[first:])
    go_on(tmp_path)
    assert read_numbers(tmp_path) == list(range(1, NUM_STEPS + 2))
    with (tmp_path / JOURNAL).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert first not in [index.chunk_start_offset for index in summary.chunk_indexes]


def first_chunk(whole):
    """Return where the first chunk of a journal begins."""
    at = len(MAGIC)
    while whole[at] != Opcode.CHUNK:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    return at


def test_an_empty_journal_is_whole_mcap_too(tmp_path):
    JournalWriter(tmp_path, flush_s=100.0).close()
    assert topics_of(tmp_path) == []
    go_on(tmp_path)
    is_whole(tmp_path, 1)


@pytest.mark.parametrize("records", [b"\x05", b"\x05" + bytes(8), b"\x05" + bytes([40, *[0] * 7]) + bytes(10)])
def test_there_is_no_index_of_what_is_no_records(records):
    with pytest.raises(ValueError, match="begins at byte 0"):
        index_of(records)
