"""``fleetmap`` and ``python -m fleetmap``: the command line from its first moment, in which Ctrl-C may come as well."""

import signal
import sys

from fleetmap.model.interrupts import interrupts_later


def end(*_: object) -> None:
    """End as on Ctrl-C, also where a shell has its background jobs ignore that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def main() -> None:
    """Run the command line and exit with its code."""
    # What service managers, containers and `timeout` send: end as cleanly as on Ctrl-C.
    signal.signal(signal.SIGTERM, end)
    try:
        with interrupts_later():
            from fleetmap.cli.main import run
    except KeyboardInterrupt:
        sys.exit(130)
    code = run(sys.argv[1:])
    # It is over: what comes now would only spoil the exit code.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


if __name__ == "__main__":
    main()
