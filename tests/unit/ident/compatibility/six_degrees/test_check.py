"""What a check in six degrees of freedom says of sound and of faulty sensors, of the whole set of
channels and of parts of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.compatibility.check import compatibility
from ident.compatibility.fitting import reduced_whitener
from ident.compatibility.kinematics import ARM, BOOM, PACKAGE, SCALE, SensorFault
from ident.compatibility.trials import Compatibility, CompatibilitySettings
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.compatibility_report import odds
from scenarios.diagnosis.kinematics import AGREES, Kinematics, agreements
from sim.errors import RecordError
from sim.record import Channel, Record
from tests.oracles.six_degrees import FINE, LATERAL, SPEED, WHOLE, Faults, fly, shown
from tests.unit.ident.compatibility.flights import THREE, record

SETTINGS = CompatibilitySettings(SPEED)


def leaders(found: Compatibility) -> dict[str, tuple[str, ...]]:
    """The best of each group that stands, with its group."""
    out: dict[str, tuple[str, ...]] = {}
    said: set[str] = set()
    for finding in found.findings:
        if finding.supported and finding.name not in said:
            out[finding.name] = finding.group
            said |= {finding.name, *finding.group}
    return out


def value(found: Compatibility, name: str) -> tuple[float, float]:
    item = next(item for item in (*found.joint.estimates, *found.joint.biases) if item.name == name)
    assert item.determined and item.agrees
    return item.smoother.value, item.smoother.std


@pytest.mark.long
def test_sound_sensors_raise_nothing_and_the_noise_is_found() -> None:
    found = compatibility([shown(fly(), WHOLE, Faults(), 3)], SETTINGS)
    assert leaders(found) == {} and found.notes == ()
    assert all(item.agrees for item in (*found.joint.estimates, *found.joint.biases))
    for name, sigma in (
        ("beta", 0.00262),
        ("phi", 0.00349),
        ("theta", 0.00349),
        ("airspeed", 0.3),
        ("height", 1.0),
    ):
        assert found.joint.noise_std[name] == pytest.approx(sigma, rel=0.15)
    assert any("steady wind" in line for line in found.unobservable)
    assert any(
        "bias:airspeed, bias:ax and sensor-drift:airspeed" in line for line in found.unobservable
    )


@pytest.mark.long
def test_three_faults_of_different_axes_are_named_and_sized_together() -> None:
    wrong = Faults(bias={"q": 0.01}, delay={"beta": 0.06}, scale={"r": 1.08})
    found = compatibility([shown(fly(), WHOLE, wrong, 1)], SETTINGS)
    assert set(leaders(found)) == {"bias:q", "sensor-delay:beta", "sensor-scale:r"}
    for name, true in (("bias:q", 0.01), ("sensor-delay:beta", 0.06), ("sensor-scale:r", 1.08)):
        size, std = value(found, name)
        assert abs(size - true) < 3.0 * std and std < 0.1 * true
    assert any(
        note.startswith("delays are relative to") and "beta" not in note.split(", which")[0]
        for note in found.notes
    )


@pytest.mark.slow
def test_accelerometers_on_one_base_are_one_fault() -> None:
    wrong = Faults(accelerometers=dict.fromkeys(("ax", "ay", "az"), (3.0, 0.0, 0.0)))
    found = compatibility([shown(fly(), WHOLE, wrong, 2)], SETTINGS)
    assert set(leaders(found)) == {"accelerometer-offset"}
    size, std = value(found, "accelerometer-offset")
    assert abs(size - 3.0) < 3.0 * std


@pytest.mark.long
def test_both_vanes_on_a_boom_are_told_before_accelerometers_behind() -> None:
    """Both leave the same trace. A boom of 9 m is common, accelerometers 9 m behind the centre of
    gravity are not.
    """
    wrong = Faults(vanes=dict.fromkeys(("alpha", "beta"), (9.0, 0.0, 0.0)))
    found = compatibility([shown(fly(), WHOLE, wrong, 2)], SETTINGS)
    (best,) = leaders(found)
    size, std = value(found, best)
    assert best == "vane-offset:boom" and abs(size - 9.0) < 3.0 * std
    told = next(finding for finding in found.findings if finding.name == best)
    assert (
        sum(told.probabilities.values()) == pytest.approx(1.0) and told.probabilities[best] > 0.99
    )


@pytest.mark.long
def test_a_vane_of_sideslip_ahead_is_told_before_its_accelerometer_behind_and_both_are_printed() -> (  # noqa: E501
    None
):
    """Lateral channels alone: vane and accelerometer are twins of opposite sign; their priors alone
    part them.
    """
    found = compatibility(
        [shown(fly(), LATERAL, Faults(vanes={"beta": (12.0, 0.0, 0.0)}), 1)], SETTINGS
    )
    ((best, group),) = leaders(found).items()
    assert best == "vane-offset:beta" and any(
        name.startswith("accelerometer-offset") for name in group
    )
    told = next(finding for finding in found.findings if finding.name == best)
    twin = next(name for name in group if name.startswith("accelerometer-offset"))
    assert told.probabilities[twin] < 1e-3 < told.probabilities[best]
    said = odds(told, found.findings)
    assert (
        "that the vane of beta is" in said
        and "< 0.1 % that the accelerometer of" in said
        and "behind the centre of gravity" in said
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("channels", "load", "rate"),
    [(LATERAL, "ny", "r"), (("alpha", "q", "nz", "airspeed"), "nz", "q")],
)
def test_an_accelerometer_ahead_is_printed_beside_the_lag_of_its_rate_however_unusual_its_place(
    channels: tuple[str, ...], load: str, rate: str
) -> None:
    """An accelerometer x ahead feels x times the change of the rate: a rate that is late by
    x / V. At one airspeed 4 m and 31 ms are one motion, and the prior of a place 4 m away is small.
    """
    wrong = Faults(accelerometers={load: (4.0, 0.0, 0.0)})
    records = [shown(fly(), channels, wrong, 2), shown(fly(seed=2), channels, wrong, 12)]
    found = compatibility(records, SETTINGS, each=False, six=True)
    both = {finding.name: finding for finding in found.findings if finding.supported}
    arm, lag = both[f"accelerometer-offset:{load}"], both[f"sensor-lag:{rate}"]
    assert abs(arm.value - 4.0) < 3.0 * arm.std
    assert lag.value == pytest.approx(arm.value / SPEED, rel=0.1)
    assert lag.instead_of == "" and arm.instead_of == lag.name
    chances = lag.probabilities
    assert set(chances) == set(both) and sum(chances.values()) == pytest.approx(1.0)
    assert 0.0 < chances[arm.name] < chances[lag.name]
    (said,) = agreements(
        Kinematics(("flight",), found), [Claim(arm.name, {"arm": Quantity(4.0, 0.05, "m")})]
    )
    assert said.says == AGREES and f"% {lag.name}" in said.sentence
    lines = " ".join(found.unobservable)
    assert arm.name not in lines and lag.name not in lines


def test_where_sensors_usually_are() -> None:
    """A boom of metres or of chords; an accelerometer within a metre or half a chord."""
    spreads = [
        SensorFault(channel, ARM, chord).spread
        for channel in ("alpha", BOOM, PACKAGE, "ay")
        for chord in (0.0, 8.0)
    ]
    assert spreads == [5.0, 24.0, 5.0, 24.0, 1.0, 2.0, 1.0, 2.0]
    assert SensorFault("q", SCALE).prior_loss(0.3, 0.01) == 0.0
    assert SensorFault("ay", ARM).prior_loss(-14.0, 0.5) == pytest.approx(0.5 * 14.0**2 / 1.5)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        (Faults(), ""),
        (Faults(lag={"p": 0.08}), "sensor-lag:p"),
        (Faults(bias={"p": 0.01}), "bias:p"),
        (Faults(vanes={"beta": (0.0, 0.0, -3.0)}), "vane-offset-below:beta"),
    ],
)
def test_lateral_channels_alone_at_a_given_airspeed(wrong: Faults, name: str) -> None:
    found = compatibility([shown(fly(), LATERAL, wrong, 1)], SETTINGS)
    stand = leaders(found)
    assert set(found.relations) == {"beta", "phi"} and len(stand) == bool(name)
    assert all(name in (best, *group) for best, group in stand.items())
    assert any("ny" in line and "phi" in line for line in found.unobservable)


def test_which_of_two_is_late_takes_a_third() -> None:
    """Of p and phi a scale is the other's inverse; with the side load and sideslip phi stands for
    itself.
    """
    two = compatibility([shown(fly(), ("p", "phi"), Faults(scale={"phi": 1.1}), 1)], SETTINGS)
    assert {name for best, group in leaders(two).items() for name in (best, *group)} == {
        "sensor-scale:p",
        "sensor-scale:phi",
    }
    assert "a scale common to p and phi is not observable, only ratios are" in two.unobservable
    five = compatibility([shown(fly(), LATERAL, Faults(scale={"phi": 1.1}), 1)], SETTINGS)
    assert leaders(five) == {"sensor-scale:phi": ()}


def test_biases_that_make_up_for_each_other_are_not_seen_and_said_to_be() -> None:
    """g sin(theta) against ax along the path, g sin(phi) against ny across it."""
    channels = ("alpha", "theta", "airspeed", "ax", "az", "p", "phi")
    tilted = Faults(bias={"theta": 0.02, "ax": 0.02 * 9.80665})
    found = compatibility([shown(fly(), channels, tilted, 1)], SETTINGS)
    assert set(found.relations) == {"airspeed", "phi"} and leaders(found) == {}
    assert any(
        "bias:ax" in line and "bias:theta" in line and "only combinations" in line
        for line in found.unobservable
    )
    leaning = compatibility(
        [shown(fly(), LATERAL, Faults(bias={"phi": 0.03, "ny": -0.03}), 1)], SETTINGS
    )
    assert (
        leaders(leaning) == {}
        and "bias:ny and bias:phi: only combinations are observable" in leaning.unobservable
    )


def test_a_delay_of_all_channels_alike_is_invisible_and_said_to_be() -> None:
    found = compatibility(
        [shown(fly(), LATERAL, Faults(delay=dict.fromkeys(LATERAL, 0.08)), 1)], SETTINGS
    )
    assert leaders(found) == {}
    assert (
        "a delay common to beta, p, r, ny and phi is not observable, only relative delays are"
        in found.unobservable
    )


def test_without_an_airspeed_flow_angles_are_left_out_and_said_to_be() -> None:
    found = compatibility([shown(fly(), LATERAL, Faults(), 1)], CompatibilitySettings())
    assert set(found.relations) == {"phi"} and any("airspeed" in note for note in found.notes)
    assert any(line.startswith("beta: cannot be checked") for line in found.unobservable)


@pytest.mark.long
def test_several_records_share_a_fault_and_keep_their_own_biases_and_drifts() -> None:
    wrong = Faults(delay={"r": 0.06}, bias={"p": 0.008})
    records = [
        shown(fly(), LATERAL, wrong, 1),
        shown(fly(), LATERAL, replace(wrong, bias={}, drift={"p": 0.002}), 2),
    ]
    found = compatibility(records, SETTINGS)
    assert [best for best in leaders(found) if "r" in best] == ["sensor-delay:r"] and len(
        leaders(found)
    ) == 1
    one, two = found.single
    assert [f.name for f in one.findings if f.supported] == ["bias:p"]
    assert "sensor-drift:p" in [
        name for f in two.findings if f.kind == "drift" for name in (f.name, *f.group)
    ]


@pytest.mark.slow
def test_a_fault_of_one_record_of_three_does_not_replicate() -> None:
    records = [
        shown(fly(), LATERAL, Faults(delay={"beta": 0.06}) if i == 0 else Faults(), i)
        for i in range(3)
    ]
    found = compatibility(records, SETTINGS, each=False)
    assert (
        found.single == ()
        and not leaders(found)
        and any(not finding.replicates for finding in found.findings)
    )


@pytest.mark.long
def test_recorded_controls_are_instruments_and_a_fault_is_found_in_gusts() -> None:
    flown = fly(gusts=0.3, seed=2)
    gusty = shown(flown, LATERAL, Faults(delay={"p": 0.06}), 2)
    moved = tuple(
        Channel.of(
            name, "rad", np.interp(gusty.time, np.arange(len(flown[name])) * FINE, flown[name])
        )
        for name in ("aileron", "rudder")
    )
    found = compatibility([replace(gusty, inputs=moved)], SETTINGS)
    assert set(leaders(found)) == {"sensor-delay:p"}
    size, std = value(found, "sensor-delay:p")
    assert abs(size - 0.06) < 3.0 * std


def test_gaps_and_spikes_do_no_harm() -> None:
    whole = shown(fly(), LATERAL, Faults(delay={"p": 0.06}), 4)
    rng, outputs = np.random.default_rng(4), []
    for channel in whole.outputs:
        values = np.where(rng.random(len(whole)) < 0.05, np.nan, channel.values)
        values[200] += 1.0
        outputs.append(Channel.of(channel.name, channel.unit, values))
    found = compatibility([replace(whole, outputs=tuple(outputs))], SETTINGS)
    assert (
        "sensor-delay:p" in leaders(found)
        and sum("isolated wrong sample" in note for note in found.notes) >= 3
    )


def with_more(plain: Record, *channels: Channel) -> Record:
    return replace(plain, outputs=(*plain.outputs, *channels))


def test_channels_that_close_nothing_leave_a_longitudinal_check_as_it_is() -> None:
    plain = record(THREE, seed=3)
    rng = np.random.default_rng(0)
    more = with_more(
        plain,
        *(Channel.of(name, "rad", rng.standard_normal(len(plain))) for name in ("beta", "psi")),
    )
    # the wings stay level
    more = with_more(more, Channel.of("r", "rad/s", 1e-4 * rng.standard_normal(len(plain))))
    more = replace(more, inputs=(*more.inputs, Channel.of("aileron", "rad", np.sin(plain.time))))
    one, two = compatibility([plain], SETTINGS), compatibility([more], SETTINGS)
    assert one.joint.estimates == two.joint.estimates and one.unobservable == two.unobservable


def test_an_attitude_near_the_vertical_is_refused_and_a_short_record_ends_well() -> None:
    whole = shown(fly(), WHOLE, Faults(), 1)
    with pytest.raises(RecordError, match="near the vertical"):
        compatibility([shown(fly(), (*LATERAL, "theta"), Faults(bias={"theta": 1.4}), 1)], SETTINGS)
    short = compatibility([whole.window(0.0, 0.8)], SETTINGS)
    assert leaders(short) == {} and all(
        np.isfinite([item.smoother.value, item.smoother.std, item.gain]).all()
        for item in short.joint.estimates
    )
    assert reduced_whitener.cache_info().currsize == 0, (
        "what was made for this check is not kept after it"
    )


def test_exact_and_constant_data_end_well() -> None:
    for noise in (0.0, 1.0):
        plain = shown(fly(), LATERAL, Faults(), 1, noise=noise)
        still = (
            replace(
                plain,
                outputs=tuple(
                    Channel.of(c.name, c.unit, np.zeros(len(plain))) for c in plain.outputs
                ),
            )
            if noise
            else plain
        )
        found = compatibility([still], SETTINGS)
        assert all(
            np.isfinite(
                [item.smoother.value, item.smoother.std, item.gain, item.output_error.std]
            ).all()
            for item in found.joint.estimates
        )
        assert not noise or leaders(found) == {}
