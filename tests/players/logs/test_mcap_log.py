import tracemalloc
import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from players.logs.mcap_log import McapLog
from tests import player_scenes as scenes

M = scenes.Messages(ros=2)


def _large(path, **settings):
    """Write 8 MB of noise in 40 images."""
    noise = np.random.default_rng(0).integers(0, 255, 200_000, dtype=np.uint8).tobytes()
    image = M.compressed(0, "camera", "jpeg", noise)
    images = [scenes.Message(topic="/image", stamp_ns=i, message=image) for i in range(40)]
    return McapLog(scenes.write_mcap(path / "log.mcap", M, images, chunk_size=300_000, **settings))


@pytest.mark.parametrize(
    "settings", [{}, {"compression": CompressionType.NONE}, {"index_types": IndexType.NONE}, {"use_chunking": False}]
)
def test_a_log_is_read_without_holding_it_in_memory(tmp_path, settings):
    log = _large(tmp_path, **settings)
    assert sum(1 for _ in log.messages({"/image"})) == 40  # imports what reading needs
    tracemalloc.start()
    count = sum(1 for _ in log.messages({"/image"}))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 40
    assert peak < 3_000_000


def test_several_channels_of_one_topic_are_one_topic(tmp_path):
    path = tmp_path / "log.mcap"
    with scenes.mcap_writer(path) as writer:
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        for node in ("a", "b"):
            writer.add_message(writer.register_channel("/chat", "cdr", schema, {"node": node}), 1, b"", 1)
    log = McapLog(path)
    assert [(topic.name, topic.num_messages) for topic in log.topics] == [("/chat", 2)]
    assert len(list(log.messages({"/chat"}))) == 2
