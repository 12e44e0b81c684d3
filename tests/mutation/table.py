"""Mutants: changes of single lines, over all rooms, that tests have to notice.

Add one with `Mutant(file, old, new, tests)`; `old` is as little text as is unique in its file. Choose lines
that carry a meaning (formula, sign, unit, comparison, index, default) and changes that a slip could make.
"""

from __future__ import annotations

from tests.mutation.run import Mutant

FILTER_ERROR_START = ("tests/unit/ident/process_noise/test_filter_error_fit.py",)
REFITTING = ("tests/unit/ident/tracing/selection/test_ledger.py",)
FROM_FILES = ("tests/unit/scenarios/identification/test_from_files.py",)
FLYING = ("tests/unit/scenarios/studies/test_flying.py",)
DELAYS = ("tests/unit/ident/banks/test_delay_bank.py",)
FREQUENCY_FIT = ("tests/unit/ident/frequency_domain/test_fit.py",)
SETTING = ("tests/unit/scenarios/maneuver_design/test_setting.py",)
MACHINE = ("tests/unit/scenarios/trials/jsbsim/test_machine.py",)
TERMS = ("tests/unit/scenarios/trials/hidden/test_terms.py",)


def changes(file: str, tests: tuple[str, ...], *pairs: tuple[str, str]) -> tuple[Mutant, ...]:
    """Mutants of one file that the same tests notice, by old and new text."""
    return tuple(Mutant(file, old, new, tests) for old, new in pairs)


# Lines whose changes no test had noticed in version 0.2.0.
ONCE_UNNOTICED = (
    *changes(
        "ident/process_noise/filter_error_fit.py",
        FILTER_ERROR_START,
        ("fit.variance - noise**2", "fit.variance - noise"),
        ("fit.variance - noise**2", "fit.variance + noise**2"),
        ("fit.variance - noise**2", "fit.variance"),
        ("1e-4 * noise**2", "1e-4 * noise"),
        ("1e-4 * noise**2", "1e-2 * noise**2"),
        ("np.sqrt(np.median(beyond[at]", "(np.median(beyond[at]"),
        ("np.clip(ratio, 0.01, 100.0)", "np.clip(ratio, 0.01, 1000.0)"),
        ("np.clip(ratio, 0.01, 100.0)", "np.clip(ratio, 0.001, 100.0)"),
    ),
    *changes(
        "ident/tracing/selection/refitting.py",
        REFITTING,
        ("if other < key and len", "if len"),
        ("if other < key and len", "if not other < key and len"),
        ("len(other) == len(key) - 1", "len(other) == len(key) - 2"),
        ("len(other) == len(key) - 1", "len(other) <= len(key) - 1"),
        ("len(other) == len(key) - 1", "len(other) == len(key) + 1"),
        ("list(ledger.models.values())[:1]", "list(ledger.models.values())[-1:]"),
        ("list(ledger.models.values())[:1]", "list(ledger.models.values())"),
        (" or list(ledger.models.values())[:1]", ""),
        ("parent = min(parents", "parent = max(parents"),
        ("max(2.0 * gained, 0.0)", "max(gained, 0.0)"),
        ("base.fit.cost - fitted.fit.cost", "fitted.fit.cost - base.fit.cost"),
    ),
    *changes(
        "scenarios/identification/from_files.py",
        FROM_FILES,
        ("if method not in FILTERS and found", "if found"),
        ("if method not in FILTERS and", "if method in FILTERS and"),
        ("and found.record.inputs and", "and"),
        ("and request.plan.hold is None", ""),
        ("request.plan.hold is None", "request.plan.hold is not None"),
        (" and not any(file.sidecar.says_hold for file in files)", ""),
        ("not any(file.sidecar", "not all(file.sidecar"),
        ("not any(file.sidecar", "any(file.sidecar"),
        ("replace(options, profile=None)", "options"),
        ("replace(request.plan, hold=hold)", "request.plan"),
    ),
    *changes(
        "scenarios/studies/flying.py",
        FLYING,
        ("if all(plan.kind in SMOOTH", "if any(plan.kind in SMOOTH"),
        ("if all(plan.kind in SMOOTH", "if not all(plan.kind in SMOOTH"),
        ("if all(plan.kind in SMOOTH", "if all(plan.kind not in SMOOTH"),
        ("for plan in plans if plan.kind in SMOOTH}", "for plan in plans}"),
        ("time[1:].tolist()", "time[:-1].tolist()"),
    ),
    *changes(
        "ident/banks/delays.py",
        DELAYS,
        ("return float(x[1]), 0.0", "return float(x[0]), 0.0"),
        ("return float(x[1]), 0.0", "return float(x[2]), 0.0"),
        ("return float(x[1]), 0.0", "return float(x[1]), 1.0"),
        ("if not curvature > 0:", "if curvature > 0:"),
        ("if not curvature > 0:", "if curvature < 0:"),
        ("curvature = -2.0 *", "curvature = 2.0 *"),
        ("float(0.5 * (x[0] + x[1]) +", "float(0.5 * (x[0] + x[1]) -"),
    ),
    *changes(
        "ident/frequency_domain/output_error.py",
        FREQUENCY_FIT,
        ("used = fit.counts.sum(axis=1) > 0", "used = fit.counts.sum(axis=1) >= 0"),
        ("used = fit.counts.sum(axis=1) > 0", "used = fit.counts.sum(axis=1) > 1e9"),
        ("used = fit.counts.sum(axis=1) > 0", "used = fit.counts.sum(axis=1) == 0"),
        ("fit.levels * fit.counts, axis=1) / np.maximum(total, 1.0), 1.0", "fit.levels * fit.counts, axis=1), 1.0"),
    ),
    *changes(
        "scenarios/maneuver_design/setting.py",
        SETTING,
        ("np.exp(np.mean(np.log(quick)))", "np.mean(quick)"),
        ("np.exp(np.mean(np.log(quick)))", "np.exp(np.median(np.log(quick)))"),
        ("np.exp(np.mean(np.log(quick)))", "np.exp(np.sum(np.log(quick)))"),
        ("if len(quick) else 1.0", "if len(quick) else 0.1"),
        ("if len(quick) else 1.0", "if not len(quick) else 1.0"),
        ("sizes[sizes > SLOW * np.max(sizes, initial=0.0)]", "sizes"),
        ("SLOW = 0.1", "SLOW = 0.05"),
        ("SLOW = 0.1", "SLOW = 0.2"),
        ("decade * digit >= value * (1.0 - 1e-9)", "decade * digit > value"),
        ("np.arange(count + 1) / rate", "np.arange(count) / rate"),
        ("if count > MOST_SAMPLES", "if count >= MOST_SAMPLES"),
    ),
    *changes(
        "scenarios/maneuver_design/content.py",
        SETTING,
        ('maneuver.flight.bound_by or "amplitude"', 'maneuver.flight.bound_by and "amplitude"'),
        ('maneuver.flight.bound_by or "amplitude"', "maneuver.flight.bound_by"),
        ('maneuver.flight.bound_by or "amplitude"', '"amplitude"'),
        ("maneuver.sigmas.items() if math.isfinite(std)", "maneuver.sigmas.items()"),
    ),
    *changes(
        "scenarios/trials/jsbsim/machine.py",
        MACHINE,
        ("math.radians(75.0), math.radians(60.0)", "math.radians(60.0), math.radians(75.0)"),
        ("math.radians(75.0), math.radians(60.0)", "75.0, 60.0"),
        ("math.radians(75.0), math.radians(60.0)", "math.radians(80.0), math.radians(60.0)"),
        ("math.radians(75.0), math.radians(60.0)", "math.radians(75.0), math.radians(65.0)"),
        ("math.radians(75.0), math.radians(60.0)", "math.radians(70.0), math.radians(60.0)"),
        ('np.max(np.abs(signals["phi"]))', 'np.max(signals["phi"])'),
        ('np.max(np.abs(signals["theta"]))', 'np.max(signals["theta"])'),
        ("if not finite or np.max", "if np.max"),
        ("POUND, INERTIA = SLUG * FOOT,", "POUND, INERTIA = SLUG / FOOT,"),
    ),
    *changes(
        "scenarios/trials/hidden/foreign/density_layer.py",
        TERMS,
        ("p.size * exp(-off * off)", "p.size * exp(-off)"),
        ("p.size * exp(-off * off)", "p.size * exp(off * off)"),
        ("p.size * exp(-off * off)", "p.size * exp(-0.5 * off * off)"),
        ("p.size * exp(-off * off)", "exp(-off * off)"),
        ("p.size * exp(-off * off)", "-p.size * exp(-off * off)"),
        ("(s.altitude - p.middle) / p.depth", "(s.altitude + p.middle) / p.depth"),
        ("(s.altitude - p.middle) / p.depth", "(s.altitude - p.middle) * p.depth"),
    ),
)

MUTANTS = (*ONCE_UNNOTICED,)
