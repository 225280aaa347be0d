import base64
import json
import socket
import threading
from contextlib import closing, contextmanager
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from players.live import open_live
from players.live.foxglove_route import FoxgloveRoute
from players.live.inbox import Inbox
from players.opening import open_source
from tests.players.live.robot_fixtures import eventually, free_port, mapped, scene_log
from tools.robot.foxglove_publisher import FoxglovePublisher
from tools.robot.link import Faults


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return scene_log(tmp_path_factory.mktemp("foxglove") / "scene.mcap", num_frames=8)


@pytest.fixture
def address():
    return f"127.0.0.1:{free_port()}"


@contextmanager
def serving(handler, **options):
    """Serve WebSockets with a handler; yield the address."""
    from websockets.sync.server import serve

    server = serve(handler, "127.0.0.1", 0, compression=None, **options)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{server.socket.getsockname()[1]}"
    finally:
        server.shutdown()
        thread.join(5.0)


@pytest.mark.parametrize("protocols", [("foxglove.sdk.v1", "foxglove.websocket.v1"), ("foxglove.websocket.v1",)])
def test_a_robot_is_mapped_and_nothing_is_unaccounted(log, address, protocols):
    found = mapped(log, FoxglovePublisher(address, protocols=protocols), f"foxglove://{address}", rate=2.0)
    expected = list(open_source(log).frames())
    assert [frame.stamp_ns for frame in found.frames] == [frame.stamp_ns for frame in expected]
    assert np.allclose(found.frames[-1].world_from_camera, expected[-1].world_from_camera)
    assert found.unaccounted() == {}
    assert sum(found.report.sent.values()) == sum(topic.num_messages or 0 for topic in open_source(log)._log.topics)


def test_a_robot_that_was_away_is_mapped_on(tmp_path, address):
    log = scene_log(tmp_path / "scene.mcap", num_frames=30)
    found = mapped(log, FoxglovePublisher(address), f"foxglove://{address}", Faults(disconnects=((0.8, 0.4),)))
    gaps_ns = np.diff([frame.stamp_ns for frame in found.frames])
    assert gaps_ns.max() >= 400_000_000
    assert len(found.frames) - 1 - int(gaps_ns.argmax()) > 3
    assert found.source.account().as_dict()["difference"] == 0


def test_odd_definitions_of_a_channel_do_no_harm():
    cdr = {"encoding": "cdr", "schema": "float64 x", "schemaName": "acme_msgs/msg/Thing"}
    channels = [
        {**cdr, "id": 1, "topic": "/thing"},
        {**cdr, "id": 2, "topic": "/thing", "schemaName": "acme_msgs/msg/Other"},
        {
            "id": 3,
            "topic": "/image",
            "encoding": "protobuf",
            "schemaName": "foxglove.CompressedImage",
            "schema": base64.b64encode(b"\x0a\x00").decode(),
        },
    ]

    def serve(connection):
        connection.send("no JSON")
        connection.send(json.dumps(["no", "object"]))
        connection.send(json.dumps({"op": "advertise", "channels": channels}))
        connection.send(json.dumps({"op": "status", "level": 1, "message": "too slow"}))
        connection.send(b"\x02" + bytes(8))
        connection.send(b"\x01")
        connection.send(b"\x01" + (1).to_bytes(4, "little") + bytes(8) + b"payload")
        connection.send(json.dumps({"op": "unadvertise", "channelIds": [3, 77]}))
        connection.recv()

    with serving(serve, subprotocols=["foxglove.sdk.v1"]) as address:
        route, inbox = FoxgloveRoute(f"foxglove://{address}"), Inbox()
        route.start(inbox)
        assert eventually(lambda: inbox.withdrawn() == {"/image"})
        topics = {topic.name: topic for topic in inbox.topics}
        assert topics["/thing"].definition == "float64 x"
        assert topics["/image"].foreign_type == "foxglove.CompressedImage"
        assert topics["/image"].definition == "\n\0"
        assert route.health().problem == "/thing is published as acme_msgs/msg/Other, too; the server says: too slow"
        assert bytes(inbox.take(2.0).data) == b"payload"
        route.stop()


def test_who_does_not_answer_or_speaks_something_else_is_said(address):
    with pytest.raises(RecordingError, match=f"{address} does not answer .*waited 0.3 s"):
        open_live(f"foxglove://{address}", patience_s=0.3)
    with (
        serving(lambda connection: None) as other,
        pytest.raises(RecordingError, match=f"{other} does not speak Foxglove's"),
    ):
        open_live(f"foxglove://{other}", patience_s=0.5)
    with closing(socket.create_server(("127.0.0.1", 0))) as server:

        def answer():
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                with client:
                    client.recv(100)
                    client.sendall(b"SSH-2.0-OpenSSH_9.2\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        port = server.getsockname()[1]
        with pytest.raises(RecordingError, match=f"127.0.0.1:{port} does not speak Foxglove's"):
            open_live(f"foxglove://127.0.0.1:{port}", patience_s=0.5)
        server.shutdown(socket.SHUT_RDWR)


@pytest.mark.parametrize("uri", ["foxglove://robot:0", "foxglove://robot:port", "foxglove://robot/x"])
def test_an_address_that_is_none_is_refused(uri):
    with pytest.raises(RecordingError, match="expected foxglove://HOST"):
        open_live(uri, patience_s=0.1)
