"""A robot that serves a log (MCAP of ROS 2) through the Foxglove SDK's server, and prints the topics it is sent."""

import sys
import time
import foxglove
from foxglove import Channel, Schema
from foxglove.websocket import Capability, ServerListener
from mcap.reader import make_reader


class Listener(ServerListener):
    """Takes note of what clients publish."""

    def __init__(self):
        self.topics = {}
        self.heard = set()

    def on_client_advertise(self, client, channel):
        """A client will publish."""
        self.topics[channel.id] = channel.topic

    def on_message_data(self, client, client_channel_id, data):
        """A client has published."""
        if data:
            self.heard.add(self.topics[client_channel_id])


def main(path, port, seconds):
    """Play the log again and again; what is latched with every message of the first second."""
    listener = Listener()
    server = foxglove.start_server(
        host="127.0.0.1", port=port, capabilities=[Capability.ClientPublish], supported_encodings=["cdr"],
        server_listener=listener,
    )  # fmt: skip
    with open(path, "rb") as stream:  # noqa: PTH123 - nothing of this project, and as short as can be
        messages = [(schema, channel, message) for schema, channel, message in make_reader(stream).iter_messages()]
    channels = {}
    for schema, channel, _ in messages:
        if channel.topic not in channels:
            described = Schema(name=schema.name, encoding=schema.encoding, data=schema.data)
            channels[channel.topic] = Channel(channel.topic, message_encoding="cdr", schema=described)
    began_s = time.monotonic()
    while time.monotonic() - began_s < seconds:
        first_ns, started_s = messages[0][2].log_time, time.monotonic()
        for _, channel, message in messages:
            time.sleep(max(0.0, (message.log_time - first_ns) / 1e9 - (time.monotonic() - started_s)))
            channels[channel.topic].log(message.data)
    server.stop()
    print(" ".join(sorted(listener.heard)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
