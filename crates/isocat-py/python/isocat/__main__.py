"""``python -m isocat``, and the command ``isocat`` of the wheel."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """Runs the command with the arguments of the process; gives its exit code."""
    from ._isocat import command

    # The command has its own ways with Ctrl-C, which Python's handler would swallow.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return command([sys.executable, "-m", "isocat"], sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
