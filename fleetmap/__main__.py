"""``python -m fleetmap`` is the command ``fleetmap``."""

from fleetmap.cli.main import main

if __name__ == "__main__":
    main()
