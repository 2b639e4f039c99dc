"""Definitions of the standard ROS 2 messages in the log, each with the definitions of what it contains."""

from __future__ import annotations

from typing import Final

_PARTS: Final[dict[str, str]] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/String": "string data\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    ),
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock\n",
    "diagnostic_msgs/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
    ),
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    "rcl_interfaces/Log": (
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
        "uint32 line\n"
    ),
}
_SEPARATOR: Final = "=" * 80


def schema_name(ros_name: str) -> str:
    """`package/Name` as MCAP's `ros2msg` schemas are called: `package/msg/Name`."""
    package, name = ros_name.split("/")
    return f"{package}/msg/{name}"


def definition(ros_name: str) -> str:
    """The .msg text of a standard message, followed by every message it contains, each once."""
    order: list[str] = []
    _collect(ros_name, order)
    first, *rest = order
    return _PARTS[first] + "".join(f"{_SEPARATOR}\nMSG: {name}\n{_PARTS[name]}" for name in rest)


def _collect(ros_name: str, order: list[str]) -> None:
    if ros_name in order:
        return
    order.append(ros_name)
    for line in _PARTS[ros_name].splitlines():
        contained = line.split()[0].removesuffix("[]")
        if "/" in contained:
            _collect(contained, order)
