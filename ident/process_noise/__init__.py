"""Maximum likelihood where random forces act on the states.

May import `ident.whole_record` and what that may import. No other estimator may import this
package.

To add a kind of process noise: declare it in `sim` as the density that `System.noise` returns;
nothing here changes. Oracles: `tests/unit/ident/process_noise`.
"""
