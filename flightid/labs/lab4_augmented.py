import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 4: an augmented aircraft and its equivalent system")


@app.cell
def _():
    import marimo as mo
    import numpy as np

    from flightid.labs import page
    from flightid.labs.figures import figure_bode
    from flightid.labs.workings import augmented as lab
    from flightid.labs.workings import close, command
    from scenarios.plots.signals import figure_fit, response_of

    return close, command, figure_bode, figure_fit, lab, mo, np, page, response_of


@app.cell
def _(page):
    page.heading(
        4,
        "An augmented aircraft and its equivalent system",
        """To see that a record of a controlled aircraft shows the aircraft *with* its control law, to describe both together by a low-order equivalent system,
        and to predict from it the level of flying qualities.""",
    )
    return


@app.cell
def _(page):
    page.aircraft_sketch()
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    A forward-swept fighter like the X-29 is unstable by design: its airframe has $M_\alpha > 0$ and one eigenvalue $\lambda > 0$,
    so that a disturbance doubles in the time $t_2 = \ln 2 / \lambda$. A digital
    control law moves three surfaces forty times a second and makes the aircraft stable. With its sensors, filters, actuators and delays of one or more computer cycles, the closed
    loop has some thirty states.

    The pilot notices none of these states: the **stick** $\delta_p$ moves, and the aircraft answers with a short period, slightly late. The **low-order equivalent system** (LOES)
    has a short period and a delay, and nothing else. Its input $\delta$ is the stick behind a first-order lag:

    $$ \dot\delta = \tfrac1\tau\big(\delta_p(t - t_d) - \delta\big) + \delta_0 , $$

    $$ \dot\alpha = L_\alpha\alpha + L_q q + L_\delta\delta + L_0 , $$

    $$ \dot q = M_\alpha\alpha + M_q q + M_\delta\delta + M_0 , $$

    with the time constant $\tau$ of the lag and a pure delay $t_d$. These are eight parameters, and three constants for biases ($L_0$, $M_0$, $\delta_0$), in place of thirty states. The transfer function from stick to
    pitch rate is

    $$ \frac{q}{\delta_p}(s) = \frac{M_\delta (s - L_\alpha) + M_\alpha L_\delta}{s^2 - (L_\alpha + M_q)s + L_\alpha M_q - L_q M_\alpha}\;
    \frac{e^{-s t_d}}{\tau s + 1} . $$

    Its $M_\alpha$ is *not* the airframe's: the control law gives it its sign and its size. Requirements on flying qualities apply to the equivalent system.

    *Where the delay comes from.* Each filter and actuator of the loop adds phase lag. Over the pilot's band, below some 10 rad/s, phase that falls in
    proportion to frequency $\omega$ is a delay:
    $\varphi = -\omega t_d$. A longer lag with a shorter delay fits almost as well: to first order a record determines only their sum $t_d + \tau$. The specification limits $t_d$ alone, so the level depends on how the fit divides the sum. MIL-F-8785C allows an
    equivalent delay of 0.10 s for Level 1 (satisfactory), 0.20 s for Level 2 (acceptable with more work for the pilot)
    and 0.25 s for Level 3 (controllable), for aircraft of all classes. The damping ratio, the natural frequency and the control anticipation parameter (CAP) have levels of their own.

    *What a linear equivalent cannot describe.* A stick may have a dead band (small movements have no effect) or a curved gain, and an actuator a rate limit. The equivalent system then changes with the size of the
    input.
    """)
    return


@app.cell
def _(lab, mo, page):
    controls = mo.ui.dictionary(
        {
            "airframe": mo.ui.dropdown(
                list(lab.AIRFRAMES), value="F, flight-like", label="airframe"
            ),
            "amplitude": page.slider(0.25, 2, 0.25, 1, "stick amplitude, in"),
            "unit": page.slider(0.2, 1.0, 0.1, 0.5, "unit of the 3-2-1-1, s"),
            "dead_band": page.slider(0, 0.4, 0.05, 0.05, "dead band of the stick, in"),
            "noise": mo.ui.checkbox(value=True, label="sensors are noisy"),
        }
    )
    seed = mo.ui.number(1, 999, step=1, value=1, label="seed of the noise")
    return controls, seed


@app.cell
def _(controls, figure_fit, mo, page, response_of, seed, study):
    _figure = page.interactive_figure(
        figure_fit(
            study.found.record,
            [response_of(study.found.estimate, "equivalent system")],
            None,
            "",
            dict(
                zip(study.found.estimate.output_names, study.found.estimate.noise_std, strict=True)
            ),
        ),
        "measured angle of attack, pitch rate and load factor, those of the equivalent system, and "
        "the residual",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.with_controls(
                [
                    page.sliders(controls),
                    seed,
                    mo.md(
                        "Airframe S resembles the X-29 as simulated, airframe F the X-29 as flown "
                        "(NASA TM-101722). The last column of the table is an equivalent system that was "
                        "fitted, without noise, to the frequency response of the whole loop below."
                    ),
                ],
                _figure,
            ),
        ]
    )
    return


@app.cell
def _(command, controls, lab, mo, page, seed):
    asked = lab.changes(**controls.value)
    with page.progress_message():
        study = lab.study(asked, seed.value)
    _loop = study.of_loop
    _rows = [
        [
            row.name,
            row.unit,
            f"{row.estimate:.4g}",
            f"{row.std:.2g}",
            f"{getattr(_loop, row.name):.4g}" if hasattr(_loop, row.name) else "",
        ]
        for row in study.found.rows
        if not row.name.endswith("_0")
    ]
    _flight = study.flown.x29.airframe
    _judged = "; ".join(
        f"{level.criterion.quantity.replace('_', ' ')} {level.quality.value:.3g}: Level "
        f"{level.level}"
        for level in study.levels
    )
    _tests = page.residual_tests(study.found.tests)
    mo.vstack(
        [
            mo.md(
                f"**Airframe without its control law:** M_α = {_flight.M_alpha:+.1f} 1/s², "
                "eigenvalues "
                f"{', '.join(f'{v:+.2f}' for v in lab.bare_airframe(study.flown))} 1/s: "
                f"a disturbance doubles in **{lab.doubling_time(study.flown):.2f} s**."
            ),
            page.table(
                [
                    "equivalent system",
                    "unit",
                    "from the record",
                    "sigma",
                    "from the frequency response",
                ],
                _rows,
            ),
            mo.md(
                f"Natural frequency **{lab.quality(study, 'natural_frequency'):.2f} rad/s**, "
                "damping ratio "
                f"**{lab.quality(study, 'damping_ratio'):.3f}**, delay and lag together "
                f"**{1000 * lab.quality(study, 'total_delay'):.0f} ms**. Flying qualities by "
                f"MIL-F-8785C, class IV (fighters), category {lab.CATEGORY} (rapid maneuvers): "
                f"{_judged}. Tests of the "
                f"residual (Ljung-Box tests whiteness, as in lab 3): {_tests}."
            ),
            page.command_line(
                command(
                    "simulate",
                    lab.SCENARIO,
                    asked,
                    "--seed",
                    str(seed.value),
                    "--out",
                    "flight.csv",
                )
                + "\nflightid identify flight.csv --model loes --vehicle augmented.toml"
            ),
            mo.download(
                lab.vehicle_text(study.flown).encode(),
                filename="augmented.toml",
                label="augmented.toml",
            ),
            mo.accordion(
                {
                    "The text of augmented.toml": mo.md(
                        f"```toml\n{lab.vehicle_text(study.flown)}```"
                    )
                }
            ),
        ]
    )
    return (study,)


@app.cell
def _(figure_bode, lab, np, page, study):
    page.interactive_figure(
        figure_bode(
            np.geomspace(0.3, 30.0, 200),
            lab.responses(study, np.geomspace(0.3, 30.0, 200)),
            "rad/s per inch",
        ),
        "frequency response of pitch rate to the stick: the whole loop and the equivalent system",
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "doubles": page.Question(
            "Airframe F without its control law (the computer has stopped): in what time does a disturbance double, in ms?",
            page.number_field("ms"),
            lambda value: close(value, 1000 * lab.key_numbers()["doubles in"], 0.03),
            "Read the line above the table; it is in seconds.",
            "Less than a third of a second is too fast for a pilot. Nevertheless the record shows "
            "a stable aircraft.",
        ),
        "sign": page.Question(
            "M_α of the airframe is positive. How large is M_α of the equivalent system, in 1/s²?",
            page.number_field("1/s²"),
            lambda value: close(value, lab.key_numbers()["M_alpha"], 0.05),
            "The first column of numbers, with its sign.",
            "The control law provides the static stability. A record of stick and "
            "response alone does not determine the airframe: for that the deflections of the "
            "surfaces must be recorded too.",
        ),
        "level": page.Question(
            "Which Level does the equivalent *delay* of airframe F have in MIL-F-8785C? Take the delay "
            "alone, without the lag.",
            page.multiple_choice(["Level 1", "Level 2", "Level 3"]),
            lambda value: value == lab.level_of_delay(),
            "Read the delay in the table; its bounds are in the theory.",
            "Damping ratio, natural frequency and CAP are all of Level 1. The pilot will complain about the delay.",
        ),
        "trade": page.Question(
            "Set the unit of the 3-2-1-1 to 0.2, 0.5 and 1.0 s. Which of these changes least, in per "
            "cent of its value?",
            page.multiple_choice(["inv_tau", "M_q", "delay and lag together", "M_alpha"]),
            lambda value: value == lab.most_constant(),
            "Write the four numbers down at each of the three units.",
            "The record determines the sum well and its parts poorly. The same holds "
            "for M_α, M_q and the lag: use equivalent parameters together, never one "
            "alone.",
        ),
        "band": page.Question(
            "Unit 0.5 s, stick amplitude 1 in. Change the dead band from 0 to 0.4 in. By how many per "
            "cent does M_δ fall?",
            page.number_field("%"),
            lambda value: close(
                value,
                100
                * (
                    1
                    - lab.key_numbers(dead_band=0.4)["M_delta"]
                    / lab.key_numbers(dead_band=0.0)["M_delta"]
                ),
                0.05,
            ),
            "Compute 100 (1 - M_δ(0.4 in) / M_δ(0)).",
            "That is nearly the share of the stick amplitude that the dead band takes, 0.4 of 1 in. "
            "If the stick moves in steps, a dead band acts like a smaller gain, and no test detects "
            "it. A smooth movement of the stick would show it.",
        ),
        "order": page.Question(
            "Dead band 0.05 in again. Take the sensor noise away. How many tests of the residual fail now?",
            page.number_field("tests"),
            lambda value: value == lab.key_numbers(noise=False)["tests failed"],
            "Clear the box `sensors are noisy` and count in the line below the table.",
            "Eight parameters do not describe thirty states; the sensor noise concealed the "
            "difference. A model is good enough for a purpose and for a level of noise.",
        ),
    }
    answers = page.answer_fields(questions)
    return answers, questions


@app.cell
def _(answers, mo, page, questions):
    mo.vstack([mo.md("## Questions"), page.question_list(questions, answers)])
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## To think about

    `flightid run x29-flight` fits the same record with nine Kalman filters side by side, each with another delay, as NASA TM-101722 did in 1989. `flightid run trace-breakout` shows
    how a large dead band of the stick is found from two records. What would you need to see such estimates while the aircraft flies? (`flightid watch` identifies while the data arrive.)
    """)
    return


if __name__ == "__main__":
    app.run()
