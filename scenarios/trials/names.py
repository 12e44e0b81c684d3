"""Names of the campaigns of the tracing loop itself, where the shell and the help find them at once."""

EVERY = "every-effect"
LOOP = ("false-alarms", "clean-models", "weak-effects", "random-papers", EVERY)
