"""One device's conversation with the host that has its port open."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from biosensor_gateway.devices.shimmer.simulator.interpreter import Interpreter
from biosensor_gateway.devices.shimmer.simulator.wire import (
    NACK,
    Command,
    CommandReader,
    Firmware,
    Opcode,
    sealed,
)


class Conversation:
    """Commands in, answers out, in order and, as a fault, late or refused.

    Parameters
    ----------
    firmware, interpreter
    write
        Sends bytes; tells whether the link took them.
    obeyed
        Called after each command that was carried out, when its answer is on the link,
        with whether the link took it.

    Attributes
    ----------
    refusing
        Carry out no command.
    answer_delay_s
        Carry out each command so much later.
    """

    def __init__(
        self,
        firmware: Firmware,
        interpreter: Interpreter,
        write: Callable[[bytes], bool],
        obeyed: Callable[[Opcode, bool], None],
    ) -> None:
        self._firmware = firmware
        self._interpreter = interpreter
        self._write = write
        self._obeyed = obeyed
        self.refusing = False
        self.answer_delay_s = 0.0
        self._reader = CommandReader(firmware)
        self._spoken_to = False
        self._delayed: list[asyncio.TimerHandle] = []

    @property
    def spoken_to(self) -> bool:
        """Whether the host has said anything; before, the device says nothing."""
        return self._spoken_to

    def hear(self, data: bytes) -> None:
        """Take the host's bytes."""
        self._spoken_to = True
        for command in self._reader.feed(data):
            if self.answer_delay_s:
                loop = asyncio.get_running_loop()
                self._delayed.append(loop.call_later(self.answer_delay_s, self._carry_out, command))
            else:
                self._carry_out(command)

    def say(self, message: bytes) -> bool:
        """Send a message with its check; tell whether the link took it."""
        return self._write(sealed(message, self._interpreter.crc_bytes))

    def dock(self, *, docked: bool) -> None:
        """Be put into the dock or taken out, and say so unasked."""
        self._interpreter.docked = docked
        if self._spoken_to:
            self.say(self._interpreter.pushed_status())

    def link_lost(self) -> None:
        """Forget the host, what it set for the link, and what it is owed."""
        for handle in self._delayed:
            handle.cancel()
        self._delayed.clear()
        self._spoken_to = False
        self._reader = CommandReader(self._firmware)
        self._interpreter.link_lost()

    def _carry_out(self, command: Command) -> None:
        if not self.refusing:
            taken = self.say(self._interpreter.execute(command))
            self._obeyed(command.opcode, taken)
        elif self._firmware.has_nack:  # older firmware knows no refusal but silence
            self.say(NACK)
