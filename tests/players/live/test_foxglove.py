import json
import socket
import threading
from contextlib import closing, contextmanager
import pytest
from hickory_stream.errors import RecordingError
from players.live import open_live
from players.live.foxglove_route import FoxgloveRoute
from players.live.inbox import Inbox
from tests.players.live.robot_fixtures import eventually, free_port


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


def test_odd_definitions_of_a_channel_do_no_harm():
    cdr = {"encoding": "cdr", "schema": "float64 x", "schemaName": "acme_msgs/msg/Thing"}
    channels = [
        {**cdr, "id": 1, "topic": "/thing"}, {**cdr, "id": 2, "topic": "/thing", "schemaName": "acme_msgs/msg/Other"},
        {
            "id": 3, "topic": "/image", "encoding": "protobuf", "schemaName": "foxglove.CompressedImage",
            "schema": "CgA=",
        },
    ]  # fmt: skip

    def serve(connection):
        for message in (
            "no JSON", ["no", "object"], {"op": "advertise", "channels": channels},
            {"op": "status", "level": 1, "message": "too slow"}, b"\x02" + bytes(8), b"\x01",
            b"\x01" + (1).to_bytes(4, "little") + bytes(8) + b"payload", {"op": "unadvertise", "channelIds": [3, 77]},
        ):  # fmt: skip
            connection.send(message if isinstance(message, str | bytes) else json.dumps(message))
        connection.recv()

    with serving(serve, subprotocols=["foxglove.sdk.v1"]) as address:
        route, inbox = FoxgloveRoute(f"foxglove://{address}"), Inbox()
        route.start(inbox)
        assert eventually(lambda: inbox.withdrawn() == {"/image"})
        topics = {topic.name: topic for topic in inbox.topics}
        assert topics["/thing"].definition == "float64 x"
        assert (topics["/image"].foreign_type, topics["/image"].definition) == ("foxglove.CompressedImage", "\n\0")
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
