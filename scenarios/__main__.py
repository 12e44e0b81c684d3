"""`python -m scenarios` is `flightid`."""

from scenarios.cli import main

main()
