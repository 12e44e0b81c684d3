"""``python -m flightid``: the command line."""

from scenarios.cli import main

if __name__ == "__main__":
    main()
