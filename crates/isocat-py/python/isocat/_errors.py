"""Exceptions: each says where, what was found and what was expected."""

from __future__ import annotations

__all__ = [
    "Abort",
    "BusError",
    "Error",
    "InputError",
    "InternalError",
    "PlanError",
    "UnknownError",
]


class Error(Exception):
    """What isocat raises.

    Attributes
    ----------
    place : str or None
        A file with line and column, an argument, a key, a device.
    expected : str or None
        What would have been right, where that is known apart from the message.
    found : str or None
        What was there, likewise.
    hint : str or None
        What may have been meant.
    """

    place: str | None
    expected: str | None
    found: str | None
    hint: str | None

    def __init__(
        self,
        message: str = "",
        *,
        place: str | None = None,
        expected: str | None = None,
        found: str | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(f"{message}\n  {hint}" if hint else message)
        self._message = message
        self.place, self.expected, self.found, self.hint = place, expected, found, hint

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions cross processes, as those of workers do.
        return (
            _again,
            (type(self), self._message, self.place, self.expected, self.found, self.hint),
        )


def _again(
    kind: type[Error],
    message: str,
    place: str | None,
    expected: str | None,
    found: str | None,
    hint: str | None,
) -> Error:
    return kind(message, place=place, expected=expected, found=found, hint=hint)


class InputError(Error, ValueError):
    """A file, a text, a key or an argument can't be used."""


class PlanError(Error, ValueError):
    """A segment can't be planned at all; a plan that does not fit is no error."""


class BusError(Error, RuntimeError):
    """A bus refuses a call; nothing has happened then."""


class UnknownError(Error, LookupError):
    """Nothing is known of a code or a name."""


class InternalError(Error, RuntimeError):
    """A fault in isocat itself: please report it, with its seed and its version."""


class Abort(Exception):
    """Raised in ``read_object`` or ``write_object`` of a behaviour: the transfer is aborted.

    Parameters
    ----------
    code : int
        SDO abort code, such as ``0x06090030``.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code
