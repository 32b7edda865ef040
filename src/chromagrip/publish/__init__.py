"""Readings that leave while they are made, and their other end.

with Subscriber("udp:5005") as readings:
    while (message := readings.next(0.5)) is not None:
        command = controller.command(observation_of(message))
"""

from .message import SCHEMA, Message, message_of, observation_of
from .subscribe import Subscriber
from .targets import Publisher, Publishers, check_targets

__all__ = [
    "SCHEMA",
    "Message",
    "Publisher",
    "Publishers",
    "Subscriber",
    "check_targets",
    "message_of",
    "observation_of",
]
