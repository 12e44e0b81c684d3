"""Which methods of which scenarios are measured, and with how many runs: a thousand where they are
cheap.
"""

from __future__ import annotations

SEED = 1
LOW, HIGH = 0.93, 0.97  # of the two-sigma coverage: where it should be
IDENTIFIABLE = 0.5  # share of a stated variance that the prior may give

# (scenario, method): runs. The first of a scenario is its main method.
RUNS: dict[tuple[str, str], int] = {
    ("rigid", "main"): 1000,
    ("rigid-euler", "main"): 1000,
    ("rigid-euler", "runge-kutta"): 1000,
    ("rigid-process-noise-a", "main"): 1000,
    ("rigid-process-noise-b", "main"): 1000,
    ("ballistic", "main"): 1000,
    ("ballistic", "one-pass"): 1000,
    ("ballistic", "paper-start-rk4"): 1000,
    ("ballistic", "paper-start-cured"): 1000,
    ("ballistic", "output-error"): 400,
    ("ballistic-process-noise", "main"): 1000,
    ("flexible-ac1-equivalent", "main"): 1000,
    ("flexible-ac1-equivalent", "no-process-noise"): 1000,
    ("flexible-ac1-equivalent", "output-error"): 200,
    ("flexible-ac2-equivalent", "main"): 1000,
    ("flexible-ac1-first-mode", "main"): 500,
    ("flexible-ac1-first-mode", "output-error"): 300,
    ("flexible-ac2-first-mode", "main"): 500,
    ("flexible-ac2-first-mode", "output-error"): 300,
    ("flexible-ac1-full-order", "main"): 150,
    ("flexibility-sweep", "main"): 500,
    ("lateral", "main"): 1000,
    ("longitudinal", "main"): 300,
    ("own-model", "main"): 1000,
    ("own-model", "filter"): 1000,
    ("aircraft-airliner", "main"): 200,
    ("aircraft-f16", "main"): 40,
    ("aircraft-uav", "main"): 200,
    ("unstable", "main"): 200,
    ("unstable", "filter"): 200,
    ("unstable", "regression"): 200,
}
