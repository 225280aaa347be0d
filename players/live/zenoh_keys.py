"""ROS 2 topics in the keys and liveliness tokens of zenoh-bridge-ros2dds and rmw_zenoh.

The bridge: messages under NAMESPACE/TOPIC; tokens @/ZID/@ros2_lv/MP/KEY/TYPE/QOS, with § for slashes in KEY and
TYPE, before version 1.0 without the first two characters. rmw_zenoh: messages under DOMAIN/TOPIC/TYPE/HASH; tokens,
with % for slashes, @ros2_lv/DOMAIN/ZID/NODE/ENTITY/MP/ENCLAVE/NAMESPACE/NODE/TOPIC/TYPE/HASH/QOS.
"""

from dataclasses import dataclass
from typing import Literal

from players.live.dds_domain import dds_type
from players.logs.containers import normalized_type

Layout = Literal["bridge", "rmw"]

TOKENS = ("@/*/@ros2_lv/**", "@ros2_lv/**")
"""The tokens of both layouts, in any version."""

HASHED_KEYS = ("*/**/RIHS01_$*", "*/**/TypeHashNotSupported")
"""Keys of messages that say their type themselves: rmw_zenoh's."""

_TRANSIENT_LOCAL = "1"
_NO_HASH = "TypeHashNotSupported"


@dataclass(frozen=True, kw_only=True, slots=True)
class Publication:
    """A published ROS topic: its absolute name, its type as package/msg/Name."""

    name: str
    type_name: str
    layout: Layout
    #: The last messages are kept for late subscribers.
    is_latched: bool
    domain: str = "0"
    hash: str = _NO_HASH

    @property
    def key(self) -> str:
        """The key expression of its messages; rmw's of any domain and type, so that a wrong type is noticed."""
        return self.name.lstrip("/") if self.layout == "bridge" else f"*/{self.name.lstrip('/')}/*/*"


def publication_of_token(token: str) -> Publication | None:
    """Return the publication of a liveliness token; None for nodes, subscribers, services, and foreign tokens."""
    parts = token.split("/")
    if parts[0] == "@":
        parts = parts[2:]
        return _of_bridge(parts[2:]) if parts[:2] == ["@ros2_lv", "MP"] else None
    if parts[0] != "@ros2_lv":
        return None
    if len(parts) == 6 and parts[2] == "MP":
        return _of_bridge(parts[3:])
    if "MP" not in parts[3:6]:
        return None
    has_hash = _is_hash(parts[-2])
    name, type_name = parts[-4 if has_hash else -3], parts[-3 if has_hash else -2]
    return Publication(
        name=_absolute(name.replace("%", "/")),
        type_name=normalized_type(type_name),
        layout="rmw",
        is_latched=_field(parts[-1], 1) == _TRANSIENT_LOCAL,
        domain=parts[1],
        hash=parts[-2] if has_hash else _NO_HASH,
    )


def publication_of_key(key: str) -> Publication | None:
    """Return the publication of a key of rmw_zenoh; None for others, which lack the type."""
    parts = key.split("/")
    if len(parts) < 4 or not _is_hash(parts[-1]):
        return None
    name = _absolute("/".join(parts[1:-2]))
    return Publication(
        name=name,
        type_name=normalized_type(parts[-2]),
        layout="rmw",
        is_latched=name.endswith("tf_static"),
        domain=parts[0],
        hash=parts[-1],
    )


def own_token(publication: Publication, zid: str, entity: int, kind: Literal["MS", "MP"]) -> str | None:
    """Return the token of our subscription (MS) or publication (MP) for rmw_zenoh; a bridge needs none."""
    if publication.layout == "bridge":
        return None
    topic = publication.name.replace("/", "%")
    durability = _TRANSIENT_LOCAL if publication.is_latched else ""
    return (
        f"@ros2_lv/{publication.domain}/{zid}/0/{entity}/{kind}/%/%/hickory_stream/{topic}/"
        f"{dds_type(publication.type_name)}/{publication.hash}/:{durability}:,10:,:,:,,"
    )


def publication_like(
    other: Publication, name: str, type_name: str, *, namespace: str, type_hash: str, is_latched: bool
) -> Publication:
    """Return a topic of ours in the layout, domain and namespace of a robot that publishes `other`."""
    prefix = f"/{namespace.strip('/')}" if namespace else ""
    return Publication(
        name=prefix + _absolute(name),
        type_name=type_name,
        layout=other.layout,
        is_latched=is_latched,
        domain=other.domain,
        hash=_NO_HASH if other.hash == _NO_HASH else type_hash,
    )


def publishing_key(publication: Publication) -> str:
    """Return the key for publishing; rmw_zenoh's contains the type and its hash."""
    if publication.layout == "bridge":
        return publication.key
    name, type_name = publication.name.lstrip("/"), dds_type(publication.type_name)
    return f"{publication.domain}/{name}/{type_name}/{publication.hash}"


def within(publication: Publication, namespace: str) -> str | None:
    """Return a topic's name within a namespace; None for a topic of another robot."""
    if not namespace:
        return publication.name
    prefix = f"/{namespace.strip('/')}/"
    return f"/{publication.name.removeprefix(prefix)}" if publication.name.startswith(prefix) else None


def _of_bridge(parts: list[str]) -> Publication | None:
    if len(parts) != 3:
        return None
    key, type_name, qos = parts
    return Publication(
        name=_absolute(key.replace("§", "/")),
        type_name=type_name.replace("§", "/"),
        layout="bridge",
        is_latched=_field(qos, 2) == _TRANSIENT_LOCAL,
    )


def _is_hash(text: str) -> bool:
    return text.startswith("RIHS") or text == _NO_HASH


def _absolute(name: str) -> str:
    return "/" + name.strip("/")


def _field(qos: str, number: int) -> str:
    fields = qos.split(":")
    return fields[number] if number < len(fields) else ""
