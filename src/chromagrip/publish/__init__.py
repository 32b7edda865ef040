"""Readings that leave while they are made, and their other end.

readings = Subscriber(process.stdout)  # of `chromagrip estimate … --publish jsonl:-`
while not readings.ended:
    if (message := readings.next(0.5)) is not None:
        command = controller.command(observation_of(message))
"""

from .message import SCHEMA, Message, message_of, observation_of
from .subscribe import Subscriber
from .targets import check_targets, publishing

__all__ = [
    "SCHEMA",
    "Message",
    "Subscriber",
    "check_targets",
    "message_of",
    "observation_of",
    "publishing",
]
