"""Messages of an MCAP log, as Protobuf types that are made when they are needed.

Pictures are `foxglove.CompressedImage`. Foxglove has no schema of its own for a wrench, a
diagnosis or a single number. Wrenches and diagnoses have the fields of the ROS messages, under the
names by which Foxglove and Lichtblick know these in Protobuf: their panels of diagnostics accept
`ros.diagnostic_msgs.DiagnosticArray`. So one reader decodes the whole file, and what reads Protobuf
plots every number: Foxglove, Lichtblick, PlotJuggler, Rerun. The encoding of ROS 2 (CDR) would be
played by `ros2 bag` too, but has no readers in Python without one more package.
"""

from functools import cache
from typing import Any

from ...extras import need

_TIME = "google.protobuf.Timestamp"
#: Fields of each type; those of a type that it uses stand before it. A `*` means any number of it.
_TYPES = {
    "chromagrip.Value": {"timestamp": _TIME, "value": "double"},
    "chromagrip.Estimate": {
        "timestamp": _TIME,
        "value": "double",
        "low": "double",
        "high": "double",
    },
    "ros.std_msgs.Header": {"stamp": _TIME, "frame_id": "string"},
    "ros.geometry_msgs.Vector3": {"x": "double", "y": "double", "z": "double"},
    "ros.geometry_msgs.Wrench": {
        "force": "ros.geometry_msgs.Vector3",
        "torque": "ros.geometry_msgs.Vector3",
    },
    "ros.geometry_msgs.WrenchStamped": {
        "header": "ros.std_msgs.Header",
        "wrench": "ros.geometry_msgs.Wrench",
    },
    "ros.diagnostic_msgs.KeyValue": {"key": "string", "value": "string"},
    "ros.diagnostic_msgs.DiagnosticStatus": {
        "level": "int32",
        "name": "string",
        "message": "string",
        "hardware_id": "string",
        "values": "*ros.diagnostic_msgs.KeyValue",
    },
    "ros.diagnostic_msgs.DiagnosticArray": {
        "header": "ros.std_msgs.Header",
        "status": "*ros.diagnostic_msgs.DiagnosticStatus",
    },
}


@cache
def message(name: str) -> Any:
    """Class of the messages of a type above, or of one of Foxglove's own."""
    package, _, kind = name.rpartition(".")
    if package == "foxglove":
        return getattr(need(f"foxglove_schemas_protobuf.{kind}_pb2", "ros"), kind)
    factory = need("google.protobuf.message_factory", "ros")
    return factory.GetMessageClass(_pool().FindMessageTypeByName(name))


@cache
def _pool() -> Any:
    """Pool of our types, apart from those of other packages."""
    made = need("google.protobuf.descriptor_pool", "ros").DescriptorPool()
    time = need("google.protobuf.timestamp_pb2", "ros").DESCRIPTOR
    made.AddSerializedFile(time.serialized_pb)
    for name, fields in _TYPES.items():
        made.Add(_file(name, fields, time.name))
    return made


def _file(name: str, fields: dict[str, str], time: str) -> Any:
    """File of one type, which imports those of the types that it uses."""
    pb = need("google.protobuf.descriptor_pb2", "ros")
    package, _, kind = name.rpartition(".")
    file = pb.FileDescriptorProto(name=f"{name}.proto", package=package, syntax="proto3")
    made = file.message_type.add(name=kind)
    for number, (field, of) in enumerate(fields.items(), 1):
        one = made.field.add(name=field, number=number)
        one.label = one.LABEL_REPEATED if of[0] == "*" else one.LABEL_OPTIONAL
        of = of.removeprefix("*")
        if "." in of:
            one.type, one.type_name = one.TYPE_MESSAGE, f".{of}"
            used = time if of == _TIME else f"{of}.proto"
            if used not in file.dependency:
                file.dependency.append(used)
        else:
            one.type = getattr(one, f"TYPE_{of.upper()}")
    return file
