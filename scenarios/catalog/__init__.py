"""Scenarios as data, and the example of a model of one's own.

One TOML file a scenario, its name the file's. The key `kind` says who runs it: without one
`studies`, `trace` is run by `trials/planted_study`, `x29` by `x29`, `sweep` by `trials/sweeps`;
`jsbsim` is flown by `trials/jsbsim_flight`. `docs/scenarios.md` explains every key. Data only:
nothing is imported but `own_model.py`, the model of `own-model`, which is run as users' own files
are and which `flightid models --example` prints. To add one, write a file, run `flightid run NAME`,
add its line to the table of the built-in ones in `docs/scenarios.md`, and let the tests of the
catalogue run it.
"""
