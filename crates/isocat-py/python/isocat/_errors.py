"""Exceptions: each names the place, what was found and what was expected."""

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
    """The base class of all exceptions of isocat.

    Attributes
    ----------
    place : str or None
        A file with line and column, an argument, a key, a device.
    expected : str or None
        The expected value, if it is known apart from the message.
    found : str or None
        The value that was found, likewise.
    hint : str or None
        What the user may have meant.
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
        # Exceptions must be picklable: those of workers go to another process.
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
    """A file, a text, a key or an argument is invalid."""


class PlanError(Error, ValueError):
    """A segment can't be planned at all; a plan that does not fit is no error."""


class BusError(Error, RuntimeError):
    """A bus refuses a call, and does nothing."""


class UnknownError(Error, LookupError):
    """A code or a name is not known."""


class InternalError(Error, RuntimeError):
    """A bug in isocat itself: please report it, with its seed and its version."""


class Abort(Exception):
    """Raised by ``read_object`` or ``write_object`` of a behaviour to abort the transfer.

    Parameters
    ----------
    code : int
        SDO abort code, for example ``0x06090030``.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code
