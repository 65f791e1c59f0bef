"""``cosim`` and ``python -m cosim``: the command line."""

import signal
import sys


def main() -> int:
    """Run the command line. Returns the exit code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # Until the command takes care of signals, Ctrl-C ends the process at once. A KeyboardInterrupt would show the
        # traceback of an import.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .commands.cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
