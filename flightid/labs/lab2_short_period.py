import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 2: the short period and the 3-2-1-1")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_input_spectrum
    from flightid.labs.workings import close, command, sigmas_off
    from flightid.labs.workings import short_period as lab
    from scenarios.plots.signals import figure_record

    return close, command, figure_input_spectrum, figure_record, lab, mo, page, sigmas_off


@app.cell
def _(page):
    page.heading(
        2,
        "The short period and the 3-2-1-1",
        """To see what a maneuver must excite so that a record determines the derivatives of an
        aircraft, what the standard deviations depend on, and how an estimate can be far off although its
        standard deviation is small.""",
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

    After a short deflection of the elevator $\delta_e$ an aircraft oscillates in angle of attack $\alpha$ and pitch rate $q$ before its speed has time to change. This
    oscillation is the **short period**. For small deviations from trim, with $q$ made non-dimensional by $\bar c / 2V$,

    $$ \dot\alpha = q - \frac{\rho V S}{2m}\Big(C_{L_\alpha}\alpha + C_{L_q}\tfrac{\bar c}{2V} q + C_{L_{\delta_e}}\delta_e\Big) , $$

    $$ \dot q = \frac{\rho V^2 S \bar c}{2 I_y}\Big(C_{m_\alpha}\alpha + C_{m_q}\tfrac{\bar c}{2V} q + C_{m_{\delta_e}}\delta_e\Big) . $$

    Here $V$ is the airspeed, $\rho$ the air density, $S$ the wing area, $\bar c$ the mean chord, $m$ the mass and $I_y$ the moment of inertia in pitch.

    In short, $\dot\alpha = L_\alpha \alpha + L_q q + L_\delta \delta_e$ and $\dot q = M_\alpha \alpha + M_q
    q + M_\delta \delta_e$. The coefficients $L$ collect the terms of the lift and $M$ those of the moment; $L_\alpha < 0$ and
    $L_q \approx 1$. The oscillation has the natural frequency $\omega$ and the damping ratio $\zeta$:

    $$ \omega^2 = L_\alpha M_q - L_q M_\alpha , \qquad 2 \zeta \omega = -(L_\alpha + M_q) . $$

    A record of the free oscillation alone shows $\omega$ and $\zeta$: **two** numbers. Six derivatives need more: two outputs, and an input that moves at
    several frequencies.

    *The 3-2-1-1* holds the elevator trailing edge down for three units of time, up for two, down for one, up for one. Pulses of three lengths spread its power
    over a band; a
    *doublet* (one unit down, one up) has a narrow band.

    *How well a maneuver determines the parameters $\theta$* can be computed before the flight. Let $y_k$ be the outputs at sample $k$, $\partial y_k / \partial \theta$
    their sensitivities and $R$ the covariance of the sensor noise. No unbiased estimate has a smaller covariance than the **Cramér-Rao bound**:

    $$ \operatorname{cov} \hat\theta \;\ge\; \Big[ \sum_k \Big(\frac{\partial y_k}{\partial\theta}\Big)^{\!T} R^{-1}
    \frac{\partial y_k}{\partial\theta} \Big]^{-1} . $$

    In a linear model the sensitivities are proportional to the amplitude $A$ of the input, and the sum to the number of samples $n$: every sigma is proportional to
    $\sigma_{\text{noise}} / (A \sqrt n)$. The rest depends on the *shape* of the maneuver. The bound assumes that the model is right, and that the
    recorded input is the one that acted.
    """)
    return


@app.cell
def _(lab, mo, page):
    controls = mo.ui.dictionary(
        {
            "kind": mo.ui.dropdown(["3-2-1-1", "doublet"], value="3-2-1-1", label="maneuver"),
            "amplitude": page.slider(1, 8, 0.5, 6, "amplitude, deg"),
            "unit": page.slider(0.1, 1.2, 0.1, 0.5, "unit, s"),
            "rate": mo.ui.dropdown(
                {"100": 100, "50": 50, "25": 25, "20": 20}, value="100", label="samples a second"
            ),
            "outputs": mo.ui.dropdown(list(lab.OUTPUTS), value="alpha and q", label="outputs used"),
        }
    )
    seed = mo.ui.number(1, 999, step=1, value=1, label="seed of the noise")
    return controls, seed


@app.cell
def _(controls, figure_input_spectrum, mo, page, seed, study):
    _figure = page.interactive_figure(
        figure_input_spectrum(
            study.record.time,
            study.record["elevator"].values,
            study.main.derived["natural_frequency"][0],
            "short period",
        ),
        "the elevator over time, and its spectrum with the frequency of the short period marked",
    )
    mo.vstack([mo.md("## Try it"), page.with_controls([page.sliders(controls), seed], _figure)])
    return


@app.cell
def _(command, controls, lab, mo, page, seed, sigmas_off):
    asked = lab.changes(**controls.value)
    with page.progress_message():
        study = lab.study(asked, seed.value)
    _derived = study.main.derived
    _rows = [
        [
            row.name,
            f"{row.true:.4g}",
            f"{row.estimate:.4g}",
            f"{row.std:.2g}",
            f"{100 * row.std / abs(row.true):.2f} %",
            f"{sigmas_off(row):+.1f}",
        ]
        for row in study.main.rows
    ]
    _failed = [
        f"{test.channel or 'all'}: {test.sentence}" for test in study.main.tests if not test.passed
    ]
    mo.vstack(
        [
            page.table(
                [
                    "derivative, 1/rad",
                    "true",
                    "estimate",
                    "sigma",
                    "sigma, % of true",
                    "error, sigmas",
                ],
                _rows,
            ),
            mo.md(
                f"Natural frequency **{_derived['natural_frequency'][0]:.4f} ± "
                f"{_derived['natural_frequency'][1]:.4f} rad/s**, damping ratio "
                f"**{_derived['damping_ratio'][0]:.4f} ± {_derived['damping_ratio'][1]:.4f}**; "
                "largest angle of attack "
                f"{lab.largest_alpha(study):.1f} deg from trim."
            ),
            mo.callout(
                mo.md("The residual is more than sensor noise. " + "; ".join(_failed)),
                kind="danger",
            )
            if _failed
            else mo.callout(mo.md("The residual is consistent with sensor noise."), kind="neutral"),
            page.command_line(command("run", lab.SCENARIO, asked, "--seed", str(seed.value))),
        ]
    )
    return (study,)


@app.cell
def _(figure_record, mo, page, study):
    mo.accordion(
        {
            "The record": page.interactive_figure(
                figure_record(study.record), "elevator, angle of attack and pitch rate over time"
            )
        }
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "amplitude": page.Question(
            "Halve the amplitude (3 deg in place of 6). How many such flights together would give "
            "the sigmas of the one at 6 deg?",
            page.number_field("flights"),
            lambda value: (
                value == round(lab.sigma_ratio(lab.changes(), lab.changes(amplitude=3.0)) ** 2)
            ),
            "Every sigma doubles. With n equal flights it falls by the square root of n.",
            "Sigma is proportional to noise over amplitude, and to one over the square root of the number of "
            "samples.",
        ),
        "doublet": page.Question(
            """The spectrum of a doublet of unit T peaks where ωT = 2.33. Which T puts the peak at this aircraft's short period, in s? (Then set the slider
            to the nearest value
            and compare the sigmas with those of a doublet of 0.5 s.)""",
            page.number_field("s"),
            lambda value: close(value, lab.tuned_doublet(lab.key_numbers()["frequency"]), 0.03),
            "Read the natural frequency below the table, in rad/s.",
            "Input power near the frequency of the short period gives the most information.",
        ),
        "limit": page.Question(
            "A 3-2-1-1 of 6 deg, but the flight-test card allows at most 10 deg of angle of attack "
            "from trim. What is the longest unit on "
            "the slider that keeps this limit?",
            page.number_field("s"),
            lambda value: close(value, lab.longest_unit(10.0), 1e-6),
            "Read the largest angle of attack below the table.",
            "Longer units give smaller sigmas, but larger angles of attack, where the"
            " linear model no longer holds.",
        ),
        "alone": page.Question(
            "Use α alone (3-2-1-1, 6 deg, 0.5 s, 100 samples a second). Which numbers are still "
            "known to better than 0.2 %?",
            page.multiple_choice(
                ["C_Lα and C_mq", "natural frequency and damping ratio", "C_Lq alone", "none"]
            ),
            lambda value: value == "natural frequency and damping ratio",
            "Look at the sigmas in per cent, and at the line below the table.",
            "α alone determines frequency and damping. The damping is a weighted sum of C_Lα and "
            "C_mq: the record determines the sum, but neither of the two, so that both have large sigmas.",
        ),
        "rate": page.Question(
            "Use both outputs again, at 25 samples a second: the error of C_mα is 18 sigmas. At 20 "
            "samples a second it is less than one. What is wrong at 25?",
            page.multiple_choice(
                [
                    "25 Hz is too slow for a short period of 2 rad/s",
                    "switches of the elevator at odd multiples of 0.5 s fall between two samples, so "
                    "that the recorded input is late there",
                    "fewer samples make larger sigmas",
                ]
            ),
            lambda value: value is not None and value.startswith("switches of the elevator"),
            "The elevator switches at multiples of 0.5 s. Which of these are multiples of 0.04 s, "
            "and which of 0.05 s?",
            "The recorded input is 0.02 s late there. The sigma does not show it, the test of the "
            "residual does. Do you know by "
            "how much your own sensors are late?",
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

    Under which conditions would you rather fly a frequency sweep? What does a test pilot fly by hand when you ask for a 3-2-1-1? Does the difference matter
    if the deflection of the elevator is recorded?
    """)
    return


if __name__ == "__main__":
    app.run()
