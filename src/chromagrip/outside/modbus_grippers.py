"""Grippers that are driven over Modbus: Robotiq's and OnRobot's.

They were tried against fake devices that answer as the manuals say, not on hardware.
"""

import logging
import math
import weakref
from collections.abc import Callable
from functools import partial
from socket import create_connection
from time import monotonic, sleep
from typing import Any, Literal

from ..errors import UserError
from ..extras import need
from .gripper import force_within

#: Time in which a device must answer a request, and once more after its repetition [s].
ANSWER_S = 0.5
#: Time in which an activation or a motion must end [s].
MOTION_S = 10.0
#: Least and greatest force of each model [N], by the makers' data sheets.
ROBOTIQ_N = {"2f-85": (20.0, 235.0), "2f-140": (10.0, 125.0), "hand-e": (20.0, 185.0)}
ONROBOT_N = {"rg2": (3.0, 40.0), "rg6": (25.0, 120.0)}
#: Fault codes gFLT of Robotiq. Code 9, no request for a second, ends with the next request.
ROBOTIQ_FAULTS = {
    5: "an activation has not ended",
    7: "it is not activated",
    8: "it is too hot",
    10: "its supply voltage is too low",
    11: "it is releasing its grip",
    12: "an internal fault",
    13: "its activation failed",
    14: "its current is too high",
    15: "it has released its grip",
}

# Our errors tell what pymodbus logs; without a handler Python would print that, too.
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())


class Line:
    """A Modbus device; a request that fails closes the connection, and the next one opens it.

    Parameters
    ----------
    who: device and address in messages
    client: client of pymodbus
    connect: opens what the client speaks through
    unit: number of the device
    """

    def __init__(self, who: str, client: Any, connect: Callable[[], Any], unit: int) -> None:
        self.who = who
        self._client, self._connect, self._unit = client, connect, unit
        self._errors = need("pymodbus.exceptions", "modbus")
        weakref.finalize(self, client.close)

    def ask(self, call: str, first: int, **request: Any) -> list[int]:
        """Registers that answer a request.

        Parameters
        ----------
        call: method of the client, such as `write_registers`
        first: number of the first register
        request: `count` of registers to read, or `values` to write

        Raises
        ------
        UserError
            When the device cannot be reached, does not answer, or refuses the request.
        """
        try:
            if self._client.socket is None:
                self._client.socket = self._connect()
            answer = getattr(self._client, call)(first, device_id=self._unit, **request)
        except (OSError, self._errors.ModbusException) as error:
            self._client.close()
            raise UserError(f"{self.who} {self._problem(error)}") from error
        if answer.isError():
            code = answer.exception_code
            raise UserError(f"{self.who} answered register {first} with Modbus exception {code}")
        registers: list[int] = answer.registers
        if len(registers) != request.get("count", 0):
            raise UserError(f"{self.who} answered register {first} with {len(registers)} registers")
        return registers

    def _problem(self, error: Exception) -> str:
        """Words for an error of the connection."""
        if isinstance(error, OSError):
            return f"cannot be reached: {error.strerror or error}"
        if isinstance(error, self._errors.ConnectionException):
            return "lost the connection"
        return f"gave no valid answer within {2.0 * ANSWER_S:g} s"


def _tcp(name: str, host: str, unit: int) -> Line:
    """Device at an address HOST or HOST:PORT."""
    where, _, port = str(host).partition(":")
    if not where or not (port or "502").isdecimal():
        raise UserError(f"host {host!r}: expected HOST or HOST:PORT")
    clients = need("pymodbus.client", "modbus")
    client = clients.ModbusTcpClient(where, timeout=ANSWER_S, retries=1)
    connect = partial(create_connection, (where, int(port or 502)), ANSWER_S)
    return Line(f"{name} at {host}", client, connect, unit)


def _serial(name: str, port: str, unit: int) -> Line:
    """Device at a serial port, with 115200 baud, 8 data bits, no parity and 1 stop bit."""
    settings = {"baudrate": 115200, "timeout": ANSWER_S}
    open_port = need("serial", "modbus").serial_for_url
    clients = need("pymodbus.client", "modbus")
    client = clients.ModbusSerialClient(str(port), retries=1, **settings)
    connect = partial(open_port, str(port), write_timeout=ANSWER_S, exclusive=True, **settings)
    return Line(f"{name} at {port}", client, connect, unit)


def _limits(model: str, models: dict[str, tuple[float, float]]) -> tuple[float, float]:
    """Least and greatest force of a model [N]."""
    if model not in models:
        raise UserError(f"model {model!r}: expected {', '.join(models)}")
    return models[model]


class Robotiq:
    """Robotiq's 2F-85, 2F-140 or Hand-E. It was tried against a fake device, not on hardware.

    The registers are those of Robotiq's instruction manuals: chapter 4 of those of 2F-85 & 2F-140
    and of Hand-E for a serial line (Modbus RTU), section 4.10 of that of the 2-Finger 200 for a
    controller with Modbus TCP. The force register has 256 steps from the least to the greatest
    force. Between them the force is taken as linear. The manuals promise neither that, nor that a
    lower force loosens a grip.

    A gripper that is not activated is activated first: its fingers move through their whole travel,
    so keep them free. 0 N stops them where they are; they are not opened.

    A command is one or two requests. A USB converter of FTDI delays each answer by up to 16 ms,
    unless its latency timer is set to 1 ms.

    Parameters
    ----------
    model: `2f-85`, `2f-140` or `hand-e`
    port: serial port, such as `/dev/ttyUSB0`
    host: address HOST or HOST:PORT of a controller, in place of a port
    unit: number of the device (default: 9 on a serial line, 2 at a controller)
    speed: speed of closing from 0, the slowest (default), to 1
    floor: close with the least force where less is commanded, but more than 0 N; by default such a
        force is refused
    """

    def __init__(
        self,
        model: Literal["2f-85", "2f-140", "hand-e"],
        port: str = "",
        host: str = "",
        unit: int | None = None,
        speed: float = 0.0,
        floor: bool = False,
    ) -> None:
        self._limits, self._floor = _limits(model, ROBOTIQ_N), floor
        if not 0.0 <= speed <= 1.0:
            raise UserError(f"speed {speed:g}: expected 0 to 1")
        if bool(port) == bool(host):
            raise UserError("expected either a port, such as /dev/ttyUSB0, or a host")
        if port:
            self._line = _serial(model, port, 9 if unit is None else unit)
        else:
            self._line = _tcp(model, host, 2 if unit is None else unit)
        self._output, self._input = (1000, 2000) if port else (0, 0)
        self._speed = round(255 * speed)
        self._sent: list[int] | None = None
        self._activate()

    def command(self, force: float) -> None:
        """Close with a force from now on [N]; one in the same step of the register is not sent.

        Raises
        ------
        UserError
            For a force that it cannot hold, a fault, and when it does not answer.
        """
        least, most = self._limits
        force = force_within(self._limits, force, self._floor, self._line.who)
        step = round(255 * (force - least) / (most - least))
        # Bytes: rACT and rGTO, reserved, reserved, position rPR, speed rSP, force rFR.
        wanted = [0x0900, 0x00FF, self._speed << 8 | step] if force else [0x0100, 0, 0]
        before, self._sent = self._sent, None  # after a failure all is sent again
        # Writing to a gripper that is not activated would activate it.
        if self._activation() != 3:
            raise UserError(f"{self._line.who} is not activated any more")
        if wanted != before:
            self._write(wanted)
        self._sent = wanted

    def _activate(self) -> None:
        """Activate the gripper, unless it is."""
        if self._activation(5, 7) == 3:
            return
        self._write([0, 0, 0])
        self._write([0x0100, 0, 0])
        end = monotonic() + MOTION_S
        while self._activation(5) != 3:
            if monotonic() > end:
                raise UserError(f"{self._line.who} was not activated within {MOTION_S:g} s")
            sleep(0.05)

    def _activation(self, *allowed: int) -> int:
        """State gSTA, 3 after the activation; a fault that is not allowed is refused."""
        status, fault, _ = self._line.ask("read_input_registers", self._input, count=3)
        code = fault >> 8 & 0xF
        if code not in (0, 9, *allowed):
            words = ROBOTIQ_FAULTS.get(code, "see its manual")
            raise UserError(f"{self._line.who} reports fault {code}: {words}")
        return status >> 12 & 3

    def _write(self, values: list[int]) -> None:
        self._line.ask("write_registers", self._output, values=values)


class OnRobot:
    """OnRobot's RG2 or RG6 at a Compute Box. It was tried against a fake device, not on hardware.

    The registers are those of the published driver `onrobot-rg` of T. Kiyokawa, which quotes
    OnRobot's description: target force in 0.1 N, target width and control; the status has a busy
    flag and the safety switches.

    The gripper takes no force while its fingers move. Such a force is not sent; the first command
    after the motion is. 0 N stops the fingers where they are; they are not opened.

    Parameters
    ----------
    model: `rg2` or `rg6`
    host: address HOST or HOST:PORT of the Compute Box
    unit: number of the device (default 65)
    floor: see `Robotiq`
    """

    def __init__(
        self, model: Literal["rg2", "rg6"], host: str, unit: int = 65, floor: bool = False
    ) -> None:
        self._limits, self._floor = _limits(model, ONROBOT_N), floor
        self._line = _tcp(model, host, unit)
        self._sent: list[int] | None = None
        self._busy_since = math.inf
        self._busy()

    def command(self, force: float) -> None:
        """Close with a force from now on [N]; one that rounds to the same 0.1 N is not sent.

        Raises
        ------
        UserError
            For a force that it cannot hold, a pushed safety switch, a motion that does not end, and
            when it does not answer.
        """
        stop, grip = 8, 16  # of the register control; grip counts the width from the fingertips
        force = force_within(self._limits, force, self._floor, self._line.who)
        wanted = [round(10.0 * force), 0, grip] if force else [0, 0, stop]
        before, self._sent = self._sent, None  # after a failure all is sent again
        busy = self._busy()
        if wanted != before and (not busy or not force):
            self._line.ask("write_registers", 0, values=wanted)
            before = wanted
        self._sent = before

    def _busy(self) -> bool:
        """Whether the fingers move; a safety switch that is or was pushed is refused."""
        (status,) = self._line.ask("read_holding_registers", 268, count=1)
        if status & 0b1111100:
            raise UserError(
                f"{self._line.who} reports a safety switch (status {status}): free its fingers, "
                "and switch it off and on"
            )
        busy = bool(status & 1)
        self._busy_since = min(self._busy_since, monotonic()) if busy else math.inf
        if monotonic() - self._busy_since > MOTION_S:
            raise UserError(f"{self._line.who} has been moving for {MOTION_S:g} s")
        return busy
