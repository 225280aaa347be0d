"""Cyclone DDS without typed Python: a domain with named peers only, and topics whose samples are bytes.

Settings were tried against Fast DDS 2 and 3. Type information of Fast DDS 3 is ignored, or its writers never match.
The receive buffer is raised, or raw images do not fit. There is no multicast.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from importlib import import_module
from typing import Any
from xml.sax.saxutils import quoteattr

from hickory_stream.errors import RecordingError

_DEPTH = 50
_BLOCKING_MS = 200


def check_installed() -> None:
    """Raise `RecordingError` if Cyclone DDS is not installed."""
    try:
        import_module("cyclonedds.core")
    except ImportError as error:
        raise RecordingError("dds:// needs Cyclone DDS: pip install 'hickory-stream[dds]'") from error


def settings(interface: str, peers: Sequence[str]) -> str:
    """Return Cyclone's settings for one interface (a name or an address) and these peers only."""
    kind = "address" if interface.replace(".", "").isdigit() or ":" in interface else "name"
    named = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers)
    return (
        '<CycloneDDS><Domain Id="any"><General><Interfaces>'
        f'<NetworkInterface {kind}={quoteattr(interface)} multicast="false"/></Interfaces>'
        "<AllowMulticast>false</AllowMulticast></General>"
        "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>"
        f"<Peers>{named}</Peers></Discovery>"
        '<Internal><SocketReceiveBufferSize max="10MB"/></Internal>'
        "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility></Domain></CycloneDDS>"
    )


def participant(domain: int, config: str) -> tuple[Any, Any]:
    """Return the domain and a participant in it; a domain that this process already has keeps its settings.

    Raises `cyclonedds.core.DDSException`: the settings do not fit this machine, e.g. there is no such interface.
    """
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain, DomainParticipant

    try:
        made = Domain(domain, config)
    except DDSException as error:
        if error.code != DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:
            raise
        made = None
    return made, DomainParticipant(domain)


@cache
def _type_of(type_name: str) -> Any:
    # A type by name alone: its fields are never read.
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl.types import uint8

    dotted = dds_type(type_name).replace("::", ".")
    return make_idl_struct(dotted.rpartition(".")[2], dotted, {"bytes": uint8})


def dds_type(type_name: str) -> str:
    """Return the name on the wire of package/msg/Name."""
    package, _, name = type_name.partition("/msg/")
    return f"{package}::msg::dds_::{name}_"


def ros_type(name: str) -> str | None:
    """Return package/msg/Name for a name on the wire; None for a name that is no message of ROS 2."""
    parts = name.split("::")
    if len(parts) != 4 or parts[1:3] != ["msg", "dds_"] or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/msg/{parts[3][:-1]}"


def qos(*, is_reliable: bool, is_latched: bool, depth: int = _DEPTH) -> Any:
    """Return the QoS of ROS 2's profiles: XCDR1, the last messages, and latched ones for late subscribers."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.util import duration

    reliable = Policy.Reliability.Reliable(duration(milliseconds=_BLOCKING_MS))
    return Qos(
        reliable if is_reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if is_latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        # Who publishes and listens to one topic does not hear itself.
        Policy.IgnoreLocal.Participant,
    )


def topic_of(member: Any, name: str, type_name: str) -> Any:
    """Return the DDS topic of a ROS 2 topic."""
    from cyclonedds.topic import Topic

    return Topic(member, f"rt{name}", _type_of(type_name))


def taken(reader: Any) -> Iterator[bytes]:
    """Yield the samples that a reader has received, with their four bytes of encapsulation."""
    from cyclonedds.core import InstanceState, SampleState, ViewState

    ddspy_take = import_module("cyclonedds._clayer").ddspy_take
    mask = SampleState.Any | ViewState.Any | InstanceState.Any
    while isinstance(found := ddspy_take(reader._ref, mask, _DEPTH), list) and found:
        for data, info in found:
            if info.valid_data:
                yield data


def write(writer: Any, data: bytes) -> bool:
    """Write serialised bytes; return whether DDS accepted them."""
    padded = data.ljust(-(-len(data) // 4) * 4, b"\0")
    return bool(import_module("cyclonedds._clayer").ddspy_write(writer._ref, padded) >= 0)
