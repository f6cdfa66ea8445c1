"""``python -m isocat``, and the command ``isocat`` of the wheel."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """Runs the command with the arguments of the process; returns its exit code."""
    from ._isocat import command

    # The command handles Ctrl-C itself; Python's handler would swallow the signal.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return command([sys.executable, "-m", "isocat"], sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
