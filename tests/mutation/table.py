"""Mutants: changes of single lines, over all rooms, that tests have to notice.

Add one to `changes` of its file, or a new file: tests, then pairs of old and new text. The old text
is as little as is unique in its file. Choose lines that carry a meaning (formula, sign, unit,
comparison, index, default) and changes that a slip could make.
"""

from __future__ import annotations

from tests.mutation.run import Mutant

FILTER_ERROR_START = ("tests/unit/ident/process_noise/test_filter_error_fit.py",)
FROM_FILES = ("tests/unit/scenarios/identification/test_from_files.py",)
FLYING = ("tests/unit/scenarios/studies/test_flying.py",)
DELAYS = ("tests/unit/ident/banks/test_delay_bank.py",)
FREQUENCY_FIT = ("tests/unit/ident/frequency_domain/test_fit.py",)
SETTING = ("tests/unit/scenarios/maneuver_design/test_setting.py",)
MACHINE = ("tests/unit/scenarios/trials/test_jsbsim_machine.py",)
TERMS = ("tests/unit/exam/test_hidden_terms.py",)


def changes(file: str, tests: tuple[str, ...], *pairs: tuple[str, str]) -> tuple[Mutant, ...]:
    """Mutants of one file that the same tests notice, by old and new text."""
    return tuple(Mutant(file, old, new, tests) for old, new in pairs)


# Lines whose changes no test had noticed in version 0.2.0.
ONCE_UNNOTICED = (
    *changes(
        "ident/process_noise/best_start.py",
        FILTER_ERROR_START,
        ("fit.variance - noise**2", "fit.variance - noise"),
        ("fit.variance - noise**2", "fit.variance + noise**2"),
        ("fit.variance - noise**2", "fit.variance"),
        ("1e-4 * noise**2", "1e-4 * noise"),
        ("1e-4 * noise**2", "1e-2 * noise**2"),
        ("np.sqrt(np.median(excess[at]", "(np.median(excess[at]"),
        ("np.clip(ratio, 0.01, 100.0)", "np.clip(ratio, 0.01, 1000.0)"),
        ("np.clip(ratio, 0.01, 100.0)", "np.clip(ratio, 0.001, 100.0)"),
    ),
    *changes(
        "scenarios/identification/identify.py",
        FROM_FILES,
        ("method not in FILTERS\n        and found", "found"),
        ("method not in FILTERS\n", "method in FILTERS\n"),
        ("and found.record.inputs\n", ""),
        ("and request.plan.hold is None", ""),
        ("request.plan.hold is None", "request.plan.hold is not None"),
        (" and not any(file.sidecar.states_hold for file in files)", ""),
        ("not any(file.sidecar", "not all(file.sidecar"),
        ("not any(file.sidecar", "any(file.sidecar"),
        ("replace(options, profile=None)", "options"),
        ("replace(request.plan, hold=hold)", "request.plan"),
    ),
    *changes(
        "scenarios/studies/declaration.py",
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
        ("used = total > 0", "used = total >= 0"),
        ("used = total > 0", "used = total > 1e9"),
        ("used = total > 0", "used = total == 0"),
        (
            "np.sum(fit.levels * fit.counts, axis=1) / np.maximum(total, 1.0)",
            "np.sum(fit.levels * fit.counts, axis=1)",
        ),
    ),
    *changes(
        "scenarios/trials/sweeps.py",
        ("tests/unit/scenarios/trials/test_sweeps.py",),
        (
            "decay * p + now * delayed[n + 1] + before * delayed[n]",
            "decay * p + now * delayed[n] + before * delayed[n + 1]",
        ),
        ("later ** (whole + 1) * (now", "later ** whole * (now"),
        ("loop.integral / loop.rate / (1.0 - later)", "loop.integral * loop.rate / (1.0 - later)"),
    ),
    *changes(
        "scenarios/maneuver_design/setting.py",
        ("tests/unit/scenarios/maneuver_design/test_coherence.py",),
        ("limits.corner(i) / (low * (high / low) ** at)", "limits.corner(i) / low"),
        (
            "limits.corner(i) * period / (2.0 * math.pi * harmonic)",
            "limits.corner(i) * period / harmonic",
        ),
    ),
    *changes(
        "scenarios/maneuver_design/design.py",
        ("tests/unit/scenarios/maneuver_design/test_coherence.py",),
        ("clean + noise * rng", "clean + 0.2 * noise * rng"),
        (
            "np.minimum(self.random_error, USELESS_RANDOM_ERROR)",
            "np.maximum(self.random_error, USELESS_RANDOM_ERROR)",
        ),
    ),
    *changes(
        "scenarios/maneuver_design/setting.py",
        SETTING,
        ("np.exp(np.mean(np.log(quick)))", "np.mean(quick)"),
        ("np.exp(np.mean(np.log(quick)))", "np.exp(np.median(np.log(quick)))"),
        ("np.exp(np.mean(np.log(quick)))", "np.exp(np.sum(np.log(quick)))"),
        ("if len(quick) else 1.0", "if len(quick) else 0.1"),
        ("if len(quick) else 1.0", "if not len(quick) else 1.0"),
        ("sizes[sizes > SLOW_ROOT_SHARE * np.max(sizes, initial=0.0)]", "sizes"),
        ("SLOW_ROOT_SHARE = 0.1", "SLOW_ROOT_SHARE = 0.05"),
        ("SLOW_ROOT_SHARE = 0.1", "SLOW_ROOT_SHARE = 0.2"),
        ("decade * digit >= value * (1.0 - 1e-9)", "decade * digit > value"),
        ("np.arange(count + 1) / rate", "np.arange(count) / rate"),
        ("if count > MOST_SAMPLES", "if count >= MOST_SAMPLES"),
    ),
    *changes(
        "scenarios/maneuver_design/report.py",
        SETTING,
        ('maneuver.flight.bound_by or "amplitude"', 'maneuver.flight.bound_by and "amplitude"'),
        ('maneuver.flight.bound_by or "amplitude"', "maneuver.flight.bound_by"),
        ('maneuver.flight.bound_by or "amplitude"', '"amplitude"'),
        ("maneuver.sigmas.items() if math.isfinite(std)", "maneuver.sigmas.items()"),
    ),
    *changes(
        "scenarios/trials/jsbsim_machine.py",
        MACHINE,
        ("math.radians(75.0)", "math.radians(60.0)"),
        ("math.radians(75.0)", "75.0"),
        ("math.radians(75.0)", "math.radians(80.0)"),
        ("math.radians(60.0)", "math.radians(65.0)"),
        ("math.radians(75.0)", "math.radians(70.0)"),
        ("math.radians(60.0)", "60.0"),
        ('np.max(np.abs(signals["phi"]))', 'np.max(signals["phi"])'),
        ('np.max(np.abs(signals["theta"]))', 'np.max(signals["theta"])'),
        ("not finite\n        or np.max", "np.max"),
        ("POUND = SLUG * FOOT", "POUND = SLUG / FOOT"),
    ),
    *changes(
        "exam/hidden_terms/density_layer.py",
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

# Equations, effects, truth, loops and maneuvers.
SIM = (
    *changes(
        "sim/vehicles/uncoupled.py",
        ("tests/unit/sim/vehicles/test_textbook_modes.py",),
        ("s.p * sin(p.trim_alpha) - s.r", "s.p * sin(p.trim_alpha) + s.r"),
    ),
    *changes(
        "sim/vehicles/other_vehicles.py",
        ("tests/unit/sim/vehicles/test_multirotor.py",),
        ("p.M_pr * s.p * s.r", "p.M_pr * s.p * s.q"),
        ("p.Z_0 + p.Z_col * s.thrust_command", "p.Z_0 - p.Z_col * s.thrust_command"),
        (
            'ActuatorLag(name, "1", name, LAG) for name in COMMANDS)',
            'ActuatorLag(name, "1", name, LAG) for name in COMMANDS[:3])',
        ),
    ),
    *changes(
        "sim/declaration/model.py",
        ("tests/unit/sim/vehicles/test_multirotor.py",),
        ("for item in removed[0].parameters} - shared", "for item in removed[0].parameters}"),
    ),
    *changes(
        "scenarios/preparation/reading.py",
        ("tests/integration/commands/test_quadrotor_logs.py",),
        ("in record.input_names and not np.any(", "in record.input_names and np.any("),
    ),
    *changes(
        "sim/vehicles/uncoupled.py",
        ("tests/unit/sim/vehicles/test_second_writings.py",),
        ("lift * cosine + drag * sine", "lift * cosine - drag * sine"),
        ("_lift(s, p) + s.thrust * sin(s.alpha)", "_lift(s, p) - s.thrust * sin(s.alpha)"),
        ("/ (p.mass * s.airspeed)", "/ (p.mass * s.V)"),
    ),
    *changes(
        "sim/vehicles/uncoupled.py",
        ("tests/unit/sim/vehicles/test_second_writings.py",),
        ("p.vane_arm / s.V * s.q", "p.vane_arm / p.airspeed * s.q"),
    ),
    *changes(
        "sim/vehicles/uncoupled.py",
        ("tests/unit/sim/vehicles/test_second_writings.py",),
        ("s.q * p.chord / (2.0 * V)", "s.q * p.chord / (2.0 * p.airspeed)"),
    ),
    *changes(
        "sim/vehicles/other_vehicles.py",
        ("tests/unit/sim/vehicles/test_second_writings.py",),
        ("s.velocity * absolute(s.velocity)", "-s.velocity * s.velocity"),
    ),
    *changes(
        "sim/vehicles/flexibility.py",
        ("tests/unit/sim/vehicles/test_second_writings.py",),
        ("value=factor * number.value", "value=factor**2 * number.value"),
    ),
    *changes(
        "sim/effects/loads.py",
        ("tests/unit/sim/effects/dynamics_and_disturbance/test_whole_axes.py",),
        ("0.5 * (low + high) if self.total", "0.5 * (high - low) if self.total"),
    ),
    *changes(
        "sim/effects/loads.py",
        ("tests/unit/sim/effects/sensor_path/test_instrument_faults.py",),
        ('s.V if hasattr(s, "V") else getattr(vehicle, speed)', "getattr(vehicle, speed)"),
    ),
    *changes(
        "sim/effects/loads.py",
        ("tests/unit/sim/effects/test_events.py",),
        ("(time - at) / width + 0.5", "(time - at) / width"),
    ),
    *changes(
        "sim/effects/input_path/actuator.py",
        (
            "tests/unit/sim/effects/input_path/test_actuator_rate_limit.py",
            "tests/unit/sim/effects/input_path/test_memoryless_inputs.py",
        ),
        ("left - 0.5 * travel, left", "left - travel, left"),
        (
            "typical_share_of_peak: ClassVar[float] = 3.0",
            "typical_share_of_peak: ClassVar[float] = 1.0",
        ),
    ),
    *changes(
        "sim/truth/measurement.py",
        ("tests/unit/sim/truth/test_noise.py",),
        ("-np.expm1(-2.0 * gaps)", "-np.expm1(-gaps)"),
    ),
    *changes(
        "sim/truth/measurement.py",
        ("tests/unit/sim/truth/test_second_writings.py",),
        ("rng.random(len(values)) < measurement", "rng.random(len(values)) > measurement"),
    ),
    *changes(
        "sim/truth/flight.py",
        ("tests/unit/sim/truth/test_second_writings.py",),
        ("= walk[1:]", "= walk[:-1]"),
    ),
    *changes(
        "sim/closed_loop/equations.py",
        ("tests/unit/sim/closed_loop/test_limits.py",),
        ("(upper[i] + lower[i]) / 2.0", "(upper[i] - lower[i]) / 4.0"),
    ),
    *changes(
        "sim/closed_loop/equations.py",
        ("tests/unit/sim/closed_loop/test_late_command.py",),
        ("control.sample_system(continuous, T - rest,", "control.sample_system(continuous, T,"),
    ),
    *changes(
        "sim/closed_loop/nonlinear.py",
        ("tests/unit/sim/closed_loop/test_second_writings.py",),
        ("0.3 + 0.7 * size", "0.3 + size"),
    ),
    *changes(
        "sim/maneuvers.py",
        ("tests/unit/sim/test_maneuvers.py",),
        (
            "self.part.before(np.asarray(t) - self.delay)",
            "self.part.before(np.asarray(t) + self.delay)",
        ),
    ),
    *changes(
        "sim/maneuvers.py",
        ("tests/unit/sim/test_maneuvers.py",),
        ("panel = 0.5 / max(self.low, self.high)", "panel = 50.0 / max(self.low, self.high)"),
    ),
    *changes(
        "sim/propagation.py",
        (
            "tests/unit/sim/test_ends_of_steps.py",
            "tests/unit/sim/test_grid.py",
        ),
        ("gaps / (1.5 * usual)", "gaps / (2.5 * usual)"),
        ("row[-1] + (row[-1] - row[-2])", "row[-1] - (row[-1] - row[-2])"),
    ),
    *changes(
        "sim/truth/motion.py",
        ("tests/unit/sim/truth/test_motion.py",),
        ("_AFFINE_TOLERANCE = 1e-11", "_AFFINE_TOLERANCE = 1e-4"),
    ),
)

# Estimators, statistics and tracing.
IDENT = (
    *changes(
        "ident/compatibility/kinematics.py",
        ("tests/unit/ident/compatibility/six_degrees/test_check.py",),
        ("- h**2 / 12.0", "+ h**2 / 12.0"),
    ),
    *changes(
        "ident/compatibility/signals.py",
        ("tests/unit/ident/compatibility/test_noise.py",),
        ("middle**2 / 20.0", "middle**2 / 6.0"),
    ),
    *changes(
        "ident/compatibility/kinematics.py",
        ("tests/unit/ident/compatibility/six_degrees/test_check.py",),
        ("return 0.1 * self.plausible", "return self.plausible"),
    ),
    *changes(
        "ident/recording/inspection.py",
        ("tests/unit/ident/recording/test_levels.py",),
        (
            "gain = (2.0 * math.sin(math.pi * line_frequency * step)) ** 2",
            "gain = 2.0 * math.sin(math.pi * line_frequency * step)",
        ),
    ),
    *changes(
        "ident/recording/series.py",
        ("tests/unit/ident/recording/test_levels.py",),
        ("loud[2 : len(local) + 2]", "loud[: len(local)]"),
    ),
    *changes(
        "ident/recording/distorted_channels.py",
        ("tests/unit/ident/recording/test_levels.py",),
        ("np.arange(length) + 0.5", "np.arange(length) + 1.0"),
    ),
    *changes(
        "ident/recording/missing_samples.py",
        ("tests/unit/ident/recording/test_samples.py",),
        ("before * after > 0.0", "before * after < 0.0"),
    ),
    *changes(
        "ident/recording/kinematic_relations.py",
        ("tests/unit/ident/recording/test_readings.py",),
        (
            "float(residual @ residual) / len(residual) * lag",
            "float(residual @ residual) / len(residual)",
        ),
    ),
    *changes(
        "ident/recording/misread_columns.py",
        ("tests/unit/ident/recording/test_readings.py",),
        ("abs(math.log2(best)) < GROSS_CLOCK_ERROR", "math.log2(best) < GROSS_CLOCK_ERROR"),
    ),
    *changes(
        "ident/flying_qualities/modes.py",
        ("tests/unit/ident/flying_qualities/test_mode_levels.py",),
        ("float(-(one + other).real)", "float((one + other).real)"),
        ("/ gravity * q / alpha", "/ G0 * q / alpha"),
    ),
    *changes(
        "ident/frequency_response/segments.py",
        ("tests/unit/ident/frequency_response/test_estimate.py",),
        ("0.5 * middle - 0.25 * (below + above)", "0.5 * middle + 0.25 * (below + above)"),
        ("(math.pi / length) ** 2 * (below + above)", "(math.pi / length) ** 2 * (below - above)"),
    ),
    *changes(
        "ident/frequency_response/segments.py",
        ("tests/unit/ident/frequency_response/test_estimate.py",),
        ("lowered = 2.0 * crossed -", "lowered = crossed -"),
        ("0.5 * spectrum[:, None, None]", "spectrum[:, None, None]"),
        ("1.0 - 1.0 / np.maximum(last, 1.0)", "1.0 / np.maximum(last, 1.0)"),
    ),
    *changes(
        "ident/frequency_response/transfer_function.py",
        ("tests/unit/ident/frequency_response/test_transfer_function.py",),
        ("(1.58 * (1.0 - np.exp(-coherence))) ** 2", "1.58 * (1.0 - np.exp(-coherence))"),
        ("(transform / 0.375) ** 2", "transform / 0.375"),
    ),
    *changes(
        "ident/flying_qualities/attitude_criteria.py",
        ("tests/unit/ident/flying_qualities/test_bandwidth.py",),
        ("NEUTRAL_PHASE + BANDWIDTH_PHASE_MARGIN", "NEUTRAL_PHASE + 2.0 * BANDWIDTH_PHASE_MARGIN"),
        ("half = 0.5 * math.pi / 180.0", "half = math.pi / 180.0"),
        ("- p[DELAY]", "+ p[DELAY]"),
    ),
    *changes(
        "ident/flying_qualities/fitted_forms.py",
        ("tests/unit/ident/flying_qualities/test_fitted_forms.py",),
        (
            "** 2 * inverse_time / p",
            "** 2 * inverse_time * p",
        ),
        ('p["inv_T_theta2"] / inverse_time', 'p["inv_T_theta2"] * inverse_time'),
    ),
    *changes(
        "ident/flying_qualities/attitude_criteria.py",
        ("tests/unit/ident/flying_qualities/test_fitted_forms.py",),
        ("row @ function.covariance @ row", "row @ row"),
    ),
    *changes(
        "ident/flying_qualities/stability_margins.py",
        ("tests/unit/ident/flying_qualities/test_stability_margins.py",),
        ("np.angle(-target.response)", "np.angle(target.response)"),
        ("away = np.abs(1.0 + target.response)", "away = np.abs(1.0 - target.response)"),
        ("return _CrossingMargin(-gain.value,", "return _CrossingMargin(gain.value,"),
        (
            "spare = limit - near.sigmas_from_crossing**2",
            "spare = limit - 2.0 * near.sigmas_from_crossing**2",
        ),
        ("return _CrossingMargin(angle / at,", "return _CrossingMargin(angle * at,"),
        ("0.5 * (1.0 - CONFIDENCE) / len(known)", "0.5 * (1.0 - CONFIDENCE)"),
    ),
    *changes(
        "ident/frequency_response/model_fit.py",
        ("tests/unit/ident/frequency_response/test_multitaper.py",),
        ("np.abs(zero_order_hold) ** 2", "np.abs(zero_order_hold)"),
    ),
    *changes(
        "ident/flying_qualities/modes.py",
        ("tests/unit/ident/flying_qualities/test_mode_levels.py",),
        ("/ (2.0 * step)", "/ step"),
    ),
    *changes(
        "ident/frequency_domain/online.py",
        ("tests/unit/ident/frequency_domain/test_online.py",),
        ("step * (rate_at_begin - rate_at_end)", "step * (rate_at_end - rate_at_begin)"),
        ("_THIRD_DIFFERENCE_VARIANCE = 20.0", "_THIRD_DIFFERENCE_VARIANCE = 2.0"),
    ),
    *changes(
        "ident/frequency_domain/online_regression.py",
        ("tests/unit/ident/frequency_domain/test_online.py",),
        ("= scaled - noise_share / np.outer(scale, scale)", "= scaled"),
        (
            "level = known[k] + shapes @ solution",
            "level = 0.1 * (known[k] + shapes @ solution)",
        ),
        ("total += 0.5 * correlation[k, m]", "total += 0.1 * correlation[k, m]"),
        (
            "np.where(lag >= 0, differences, differences.conj())",
            "np.where(lag == 0, differences, 0.0)",
        ),
    ),
    *changes(
        "ident/frequency_domain/online_regression.py",
        ("tests/unit/ident/frequency_domain/test_online.py",),
        ("second_decay * (1.0 - first_decay)", "(1.0 - first_decay)"),
        ("integral = area - delta / lag", "integral = area + delta / lag"),
        ("(ends[0] - ends[1]) / (2.0 * reach)", "(ends[0] - ends[1]) / reach"),
    ),
    *changes(
        "ident/frequency_domain/transform.py",
        ("tests/unit/ident/frequency_domain/test_response.py",),
        ("(count + 1) // 2", "count // 2 + 1"),
    ),
    *changes(
        "ident/frequency_domain/transform.py",
        ("tests/unit/ident/frequency_domain/test_response.py",),
        ("before if share > 0.0 else now", "now"),
    ),
    *changes(
        "ident/frequency_domain/transform.py",
        ("tests/unit/ident/frequency_domain/test_fit.py",),
        ("ratio = 2.0 * np.sum", "ratio = np.sum"),
    ),
    *changes(
        "ident/maneuver_design.py",
        ("tests/unit/ident/test_rivalry.py",),
        ("2.0 * squares * share", "4.0 * squares * share"),
        ("8.0 * gain + 2.0 * count", "4.0 * gain + 2.0 * count"),
    ),
    *changes(
        "ident/pooling.py",
        ("tests/unit/ident/test_pooling.py",),
        ("remaining = covariance - gain @", "remaining = covariance - 0.5 * gain @"),
    ),
    *changes(
        "ident/pooling.py",
        ("tests/unit/ident/test_pooling.py",),
        ("np.minimum.accumulate(raised[::-1])[::-1]", "np.minimum.accumulate(raised)"),
    ),
    *changes(
        "ident/pooling.py",
        ("tests/unit/ident/test_pooling.py",),
        ("factor = max(1.0, float(", "factor = max(0.0, float("),
    ),
    *changes(
        "ident/pooling.py",
        ("tests/unit/ident/test_pooling.py",),
        ("0.5 * squared + 0.5 * shrunk", "0.5 * squared + shrunk"),
    ),
    *changes(
        "ident/pooling.py",
        ("tests/unit/ident/test_pooling.py",),
        ("spread**2 - float(np.median(sigmas)) ** 2", "spread**2"),
    ),
    *changes(
        "ident/pooling.py",
        ("tests/unit/ident/test_pooling.py",),
        ("float(weight @ residual**2) / (n - 2)", "float(weight @ residual**2) / n"),
    ),
    *changes(
        "ident/statistics/intervals.py",
        ("tests/unit/ident/statistics/test_shares.py",),
        ("betaincinv(count, trials - count + 1, tail)", "betaincinv(count, trials - count, tail)"),
    ),
    *changes(
        "ident/statistics/noise_levels.py",
        ("tests/unit/ident/statistics/test_local_level.py",),
        ("4: 70.0", "4: 20.0"),
    ),
    *changes(
        "ident/statistics/intervals.py",
        ("tests/unit/ident/statistics/test_chi_square.py",),
        ("degrees, tail = count - 1", "degrees, tail = count"),
    ),
    *changes(
        "ident/statistics/residuals.py",
        ("tests/unit/ident/statistics/test_local_level.py",),
        ("n * (n + 2) * np.sum", "n * n * np.sum"),
    ),
    *changes(
        "ident/statistics/residuals.py",
        ("tests/unit/ident/statistics/test_compare.py",),
        ("z, abs(z) > limit", "z, z > limit"),
    ),
    *changes(
        "ident/statistics/residuals.py",
        ("tests/unit/ident/statistics/test_error_figures.py",),
        ("1.0 - (error / spread) ** 2", "1.0 - error / spread"),
    ),
    *changes(
        "ident/banks/online.py",
        ("tests/unit/ident/banks/test_online_bank.py",),
        ("LONGEST_STEP = 1.5 ", "LONGEST_STEP = 3.5 "),
        ("outside[k] & (streak < LONGEST_SPIKE)", "outside[k] & (streak <= LONGEST_SPIKE)"),
    ),
    *changes(
        "ident/filters/smoother.py",
        ("tests/unit/ident/filters/test_smoother_limits.py",),
        ("np.minimum(variance, largest)", "np.maximum(variance, largest)"),
    ),
    *changes(
        "ident/filters/one_record.py",
        ("tests/unit/ident/filters/test_transition.py",),
        ("dt ** (i + j + 1) / (i + j + 1)", "dt ** (i + j + 1)"),
    ),
    *changes(
        "ident/regression/state_histories.py",
        ("tests/unit/ident/regression/test_local_polynomial.py",),
        ("1.0 - own_weight, 1e-6", "1.0, 1e-6"),
        ("_LONGEST_WINDOW * (width - 1)", "10.0 * _LONGEST_WINDOW * (width - 1)"),
    ),
    *changes(
        "ident/whole_record/layout.py",
        ("tests/unit/ident/whole_record/test_layout.py",),
        ("shared + r * local + np.arange(local)", "shared + (r - 1) * local + np.arange(local)"),
    ),
    *changes(
        "ident/whole_record/unstable_motion.py",
        ("tests/unit/ident/whole_record/test_unstable_motion.py",),
        (
            "prior.mean[of_record] - fit.theta[prior.positions[of_record]]",
            "fit.theta[prior.positions[of_record]] - prior.mean[of_record]",
        ),
    ),
    *changes(
        "ident/banks/bank.py",
        ("tests/unit/ident/banks/test_bank.py",),
        ("active[next_pass.sound & (change >= SETTLED_SIGMAS)]", "active[next_pass.sound]"),
    ),
)

# Files, studies, and what they show.
SCENARIOS = (
    *changes(
        "scenarios/files/units.py",
        ("tests/unit/scenarios/files/test_units.py",),
        ("_DEGREE ** (source.deg - wanted.deg)", "_DEGREE ** (wanted.deg - source.deg)"),
    ),
    *changes(
        "scenarios/preparation/measured_inputs.py",
        ("tests/unit/scenarios/preparation/test_airspeed.py",),
        ("(1.0 / level - 1.0 / pressure)", "(1.0 / pressure - 1.0 / level)"),
        ('-p["gravity"].value / flow.speed', 'p["gravity"].value / flow.speed'),
    ),
    *changes(
        "scenarios/preparation/filtering.py",
        ("tests/unit/scenarios/preparation/test_filtering.py",),
        ("0.5 * CORNER_SHARE * plan.rate", "CORNER_SHARE * plan.rate"),
    ),
    *changes(
        "scenarios/preparation/measured_inputs.py",
        ("tests/unit/scenarios/preparation/test_trim.py",),
        ("until = max(2, until - 1)", "until = max(2, until)"),
    ),
    *changes(
        "scenarios/preparation/measured_inputs.py",
        ("tests/unit/scenarios/preparation/test_reading.py",),
        ("level < -1.0 / LARGEST_REST_LOAD", "level < -LARGEST_REST_LOAD"),
    ),
    *changes(
        "scenarios/preparation/measured_inputs.py",
        ("tests/unit/scenarios/preparation/test_attitude.py",),
        ("LEAST_SAMPLE_SHARE = 0.5", "LEAST_SAMPLE_SHARE = 0.05"),
    ),
    *changes(
        "ident/statistics/residuals.py",
        ("tests/unit/scenarios/test_predict.py",),
        ("(1.0 - self.nrmse[channel])", "(1.0 - self.nrmse[channel] ** 2)"),
    ),
    *changes(
        "scenarios/identification/assessment.py",
        ("tests/unit/scenarios/identification/test_from_files.py",),
        ("MOVED_SIGMAS = 1.0", "MOVED_SIGMAS = 2.0"),
    ),
    *changes(
        "scenarios/identification/assessment.py",
        ("tests/unit/scenarios/identification/test_assessment.py",),
        ('0 if side == "lower" else 1', '1 if side == "lower" else 0'),
    ),
    *changes(
        "scenarios/watching/study.py",
        ("tests/unit/scenarios/watching/test_history.py",),
        ("ndtr((between - value) /", "ndtr((value - between) /"),
    ),
    *changes(
        "scenarios/watching/study.py",
        ("tests/unit/scenarios/watching/test_history.py",),
        ("np.sqrt(np.maximum(variance, 0.0))", "np.maximum(variance, 0.0)"),
    ),
    *changes(
        "scenarios/survey/growing.py",
        ("tests/unit/scenarios/survey/test_pooled_fits.py",),
        ("        )\n        / share,", "        )\n        * share,"),
    ),
    *changes(
        "scenarios/survey/survey.py",
        ("tests/unit/scenarios/survey/test_derivatives.py",),
        (" / effect.recurrence.probability[number]", ""),
    ),
    *changes(
        "scenarios/plots/display.py",
        ("tests/unit/scenarios/test_side_by_side.py",),
        (
            "(self.estimate - self.reference) / abs(self.reference)",
            "(self.estimate - self.reference) / self.reference",
        ),
        ("self.true if self.condensed is None else self.condensed", "self.true"),
    ),
    *changes(
        "scenarios/x29/estimating.py",
        ("tests/unit/scenarios/x29/test_linear_check.py",),
        ("len(power) // 5", "len(power) // 2"),
        (
            "(abs(self.peak_simulated) / abs(self.peak_measured) - 1.0)",
            "(abs(self.peak_measured) / abs(self.peak_simulated) - 1.0)",
        ),
    ),
    *changes(
        "scenarios/report/quantities.py",
        ("tests/unit/scenarios/report/test_display_units.py",),
        ("value / (2.0 * math.pi)", "value * (2.0 * math.pi)"),
    ),
    *changes(
        "scenarios/report/document.py",
        ("tests/unit/scenarios/report/test_document.py",),
        ("self.signed and self.value >= 0", "self.signed and self.value > 0"),
    ),
    *changes(
        "scenarios/diagnosis/diagnose.py",
        ("tests/unit/scenarios/diagnosis/test_diagnosing.py",),
        ("record[name].values - record[name].values[0]", "record[name].values"),
    ),
    *changes(
        "scenarios/maneuver_design/limits.py",
        ("tests/unit/scenarios/maneuver_design/test_setting.py",),
        ("else -abs(high)", "else -np.inf"),
    ),
    *changes(
        "scenarios/maneuver_design/design.py",
        ("tests/unit/scenarios/maneuver_design/test_setting.py",),
        ("(high - at) / (most - at)", "(high - at) / most"),
    ),
    *changes(
        "scenarios/studies/campaign_statistics.py",
        ("tests/unit/scenarios/studies/test_bound.py",),
        ("pass_prior = np.minimum(prior, spread * stated)", "pass_prior = spread * stated"),
        ("1.0 - (self.scatter / self.stated) ** 2", "1.0 - self.scatter / self.stated"),
    ),
    *changes(
        "exam/recorder_faults.py",
        ("tests/unit/exam/test_recorder_faults.py",),
        (
            'record.time < values["begin"] + values["length"]',
            'record.time <= values["begin"] + values["length"]',
        ),
    ),
    *changes(
        "exam/recorder_faults.py",
        ("tests/unit/exam/test_recorder_faults.py",),
        ("np.clip(column, low + edge, high - edge)", "np.clip(column, low, high - edge)"),
    ),
    *changes(
        "exam/coverage/every_scenario.py",
        ("tests/unit/exam/test_coverage_page.py",),
        ("if factor > 1.0\n", "if factor < 1.0\n"),
    ),
    *changes(
        "scenarios/compatibility.py",
        ("tests/unit/scenarios/test_compatibility.py",),
        ("2.0 * np.maximum(np.where(pressure", "np.maximum(np.where(pressure"),
    ),
    *changes(
        "scenarios/plots/signals.py",
        ("tests/unit/scenarios/plots/test_contents.py",),
        ("band = 2.0 * unit.factor", "band = unit.factor"),
    ),
    *changes(
        "scenarios/api/shown.py",
        ("tests/unit/scenarios/api/test_results.py",),
        ("self.value - 2.0 * self.sigma", "self.value - self.sigma"),
    ),
)

# Records from the files of recorders.
RECORDS = (
    *changes(
        "scenarios/preparation/filtering.py",
        ("tests/unit/scenarios/preparation/test_gaps.py",),
        ('side="right") - 1, 0, None)', 'side="left") - 1, 0, None)'),
        (
            "np.where(valid, joined[:, before], mean)",
            "np.where(~valid, joined[:, before], mean)",
        ),
        ("np.concatenate(values)[before], np.nan)", "np.concatenate(values)[before], 0.0)"),
    ),
    *changes(
        "scenarios/files/formats/autopilots.py",
        ("tests/unit/scenarios/files/test_forms.py",),
        ('float(f"{float(cells[2]):.7g}")', "1.0"),
        (
            'if len(cells := rest.split(",")) == len(layout.columns)',
            'if len(cells := rest.split(",")) >= 0',
        ),
    ),
    *changes(
        "scenarios/watching/rows.py",
        ("tests/integration/commands/test_reading_options.py",),
        ("- header.first) / header.rate", "- header.first) * header.rate"),
        ("if choice.delay:", "if choice.hold:"),
    ),
    *changes(
        "scenarios/identification/cautions.py",
        ("tests/unit/scenarios/identification/test_sigma_cautions.py",),
        ("return tuple(dict.fromkeys(failed))", "return tuple(failed)"),
    ),
    *changes(
        "scenarios/files/formats/text.py",
        ("tests/integration/commands/test_recorders.py",),
        ('text.endswith(("\\n", "\\r"))\n        or last < 1', "last < 1"),
    ),
)

# The labs.
FLIGHTID = (
    *changes(
        "flightid/labs/workings/__init__.py",
        ("tests/unit/flightid/labs/test_workings.py",),
        ("return row.sigmas", "return -row.sigmas"),
        ("z - estimate.fitted[0]", "estimate.fitted[0] - z"),
    ),
    *changes(
        "flightid/labs/workings/short_period.py",
        ("tests/unit/flightid/labs/test_workings.py",),
        ("PEAK_OF_DOUBLET = 2.3311", "PEAK_OF_DOUBLET = 1.16556"),
    ),
    *changes(
        "flightid/labs/workings/augmented.py",
        ("tests/unit/flightid/labs/test_workings.py",),
        (
            "math.log(2.0) / float(bare_airframe(flown)[-1])",
            "math.log(2.0) / float(bare_airframe(flown)[0])",
        ),
    ),
)

MUTANTS = (*ONCE_UNNOTICED, *SIM, *IDENT, *SCENARIOS, *RECORDS, *FLIGHTID)
