"""How rmw_zenoh names things and what it sends beside a message: keys, type hashes, liveliness tokens, attachments.

Of Jazzy (rmw_zenoh_cpp 0.2.4), Kilted, Lyrical and Rolling, which share one format.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

ADMIN_SPACE: Final = "@ros2_lv"
# RIHS01 hashes of the messages' definitions (REP-2011), the same in all of these distributions.
TYPE_HASHES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "std_msgs/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        "sensor_msgs/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
        "geometry_msgs/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
        "geometry_msgs/WrenchStamped": "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
        "tf2_msgs/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
        "diagnostic_msgs/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
        "rosgraph_msgs/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
        "rcl_interfaces/Log": "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    }
)
_NONE: Final = "%"  # an empty enclave or namespace
_ATTACHMENT: Final = struct.Struct("<qqB16s")  # sequence, source time, length of the id, id
_GID_BYTES: Final = 16


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic and how its messages are kept."""

    name: str  # with the leading slash
    ros_name: str  # package/Name
    latched: bool = False  # transient_local: kept for whoever comes late
    depth: int = 10

    @property
    def dds_type(self) -> str:
        """Name of the type as DDS has it."""
        package, name = self.ros_name.split("/")
        return f"{package}::msg::dds_::{name}_"

    @property
    def type_hash(self) -> str:
        """Hash of the type's definition.  Raises KeyError for a type that is not in the table."""
        return f"RIHS01_{TYPE_HASHES[self.ros_name]}"

    @property
    def qos(self) -> str:
        """Reliable, keep last, the depth; numbers in full, because defaults differ between versions."""
        return f"1:{1 if self.latched else 2}:1,{self.depth}:,:,:,,"

    def key(self, domain: int) -> str:
        """Where its messages go."""
        return f"{domain}/{self.name.removeprefix('/')}/{self.dds_type}/{self.type_hash}"


@dataclass(frozen=True, slots=True)
class Node:
    """One node of the ROS graph, on one session; its number in the session is 0, its publishers count from 1."""

    domain: int
    session: str  # Zenoh's id, hexadecimal
    name: str

    @property
    def token(self) -> str:
        """Liveliness token that makes it a node of the graph."""
        return f"{ADMIN_SPACE}/{self.domain}/{self.session}/0/0/NN/{_NONE}/{_NONE}/{self.name}"

    def publisher_token(self, entity: int, topic: Topic) -> str:
        """Liveliness token of its publisher with that number."""
        mangled = topic.name.replace("/", "%")
        return (
            f"{ADMIN_SPACE}/{self.domain}/{self.session}/0/{entity}/MP/{_NONE}/{_NONE}/{self.name}"
            f"/{mangled}/{topic.dds_type}/{topic.type_hash}/{topic.qos}"
        )


def gid_of(token: str) -> bytes:
    """Id of a publisher: 16 bytes, its own and the same for its life (receivers do not compute it)."""
    return hashlib.blake2b(token.encode(), digest_size=_GID_BYTES).digest()


def attachment(sequence: int, source_ns: int, gid: bytes) -> bytes:
    """What goes with every message: without it rmw_zenoh drops the message; sequence counts from 1 without a gap."""
    return _ATTACHMENT.pack(sequence, source_ns, _GID_BYTES, gid)
