from dataclasses import replace
from threading import Thread
from players.live.inbox import MAX_TOPICS, Inbox
from players.live.live_log import LiveLog
from players.live.status import status_of, status_table
from players.live.transport import Health
from tests.players.live.live_fixtures import ScriptedRoute, scene_packets

TOPICS = {packet.topic.name: packet.topic for packet in scene_packets()}
IMAGE_TOPIC, POSE_TOPIC = TOPICS["/cam/color/image_rect/compressed"], TOPICS["/odom"]


class Clock:
    now_ns = 1_000_000_000_000

    def __call__(self):
        return self.now_ns


def test_a_flood_of_images_drops_the_oldest_images_and_no_pose():
    inbox = Inbox(large_bytes=1000)
    inbox.announce(IMAGE_TOPIC)
    inbox.announce(POSE_TOPIC)
    for i in range(50):
        inbox.put(IMAGE_TOPIC.name, bytes([i]) * 100)
        inbox.put(POSE_TOPIC.name, bytes([i]) * 100)
    taken = [message for _ in range(60) if (message := inbox.take(0)) is not None]
    assert [message.data[0] for message in taken if message.topic == IMAGE_TOPIC.name] == list(range(40, 50))
    assert [message.data[0] for message in taken if message.topic == POSE_TOPIC.name] == list(range(50))
    assert inbox.arrivals[IMAGE_TOPIC.name].fates["queue_full"] == 40
    assert inbox.arrivals[IMAGE_TOPIC.name].num_received == 50


def test_a_route_that_can_wait_loses_nothing():
    inbox = Inbox(large_bytes=300)
    inbox.announce(IMAGE_TOPIC)

    def send():
        for i in range(20):
            inbox.put(IMAGE_TOPIC.name, bytes([i]) * 100, waits=True)
        inbox.close()

    Thread(target=send, daemon=True).start()
    taken = []
    while not inbox.is_over:
        message = inbox.take(5.0)
        taken += [message.data[0]] if message is not None else []
    assert taken == list(range(20))
    assert not inbox.arrivals[IMAGE_TOPIC.name].fates


def test_a_hostile_publisher_is_held_within_limits():
    inbox = Inbox(max_message_bytes=1000)
    for i in range(MAX_TOPICS + 7):
        inbox.announce(replace(IMAGE_TOPIC, name=f"/topic{i}"))
    assert len(inbox.topics) == MAX_TOPICS
    assert inbox.num_unlisted == 7
    inbox.put("/topic0", bytes(1001))
    inbox.put("/nobody/announced/this", bytes(10))
    assert inbox.arrivals["/topic0"].fates == {"too_large": 1}
    assert inbox.take(0) is None


def test_the_status_says_rates_ages_and_what_is_wrong():
    clock = Clock()
    inbox = Inbox(clock)
    route = ScriptedRoute()
    route.start(inbox)
    for topic in (IMAGE_TOPIC, TOPICS["/tf_static"]):
        inbox.announce(topic)
    for _ in range(60):
        inbox.put(IMAGE_TOPIC.name, bytes(1000))
        clock.now_ns += 100_000_000
    inbox.lost(IMAGE_TOPIC.name, 3)
    clock.now_ns += 500_000_000
    log = LiveLog(route, inbox)
    log.roles = {IMAGE_TOPIC.name: "color"}
    color = next(entry for entry in status_of(route, log).topics if entry.role == "color")
    assert (color.rate_hz, color.bytes_per_s, color.received, color.lost) == (10.0, 10_000, 60, 3)
    assert color.age_s == 0.6
    assert color.problem == "3 lost on the way"
    clock.now_ns += 10_000_000_000
    told = {entry.role: entry.problem for entry in status_of(route, log).topics}
    assert told == {"color": "silent for 11 s", "tf": told["tf"]}
    assert "sent once" in told["tf"]
    inbox.withdraw(IMAGE_TOPIC.name)
    table = status_table(status_of(route, log))
    assert "nobody publishes it any more" in table
    assert "never" in table
    # Of a run that has ended nothing is tried again, and nothing is missing.
    route.state = Health(is_connected=False, problem="the connection is lost; it is tried again")
    assert "not connected: the connection is lost; it is tried again\n" in status_table(status_of(route, log))
    log.end()
    ended = status_table(status_of(route, log))
    assert ended.startswith(f"{route.uri} ({route.kind}): ended\n")
    assert "tried again" not in ended and "<-" not in ended
