import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Lab 8: a sweep, its response, its margins")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.workings import close, command
    from flightid.labs.workings import swept_loop as lab
    from scenarios.plots.flying_qualities import figure_margins, figure_response

    return close, command, figure_margins, figure_response, lab, mo, page


@app.cell
def _(page):
    page.heading(
        8,
        "A sweep, its response, its margins",
        """To excite the roll loop of a small aircraft in flight by a frequency sweep, to find a model and the stability margins from its frequency responses,
        and to see how wrong the margins are if the excitation is not recorded.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    A control law feeds the roll rate $p$ back to the command of the ailerons. The pilot or a computer adds a **sweep** $r$, a sine whose frequency rises slowly:

    $$ e = r - f , \qquad p = P\,e , \qquad f = C\,p , \qquad L = C P . $$

    $P$ is the transfer function of the aircraft and $C$ that of the control law, $e$ the command to the ailerons and $f$ the signal that is fed back. The **broken-loop response** $L =
    f/e$ gives the margins, although the loop stays closed in flight. At the frequency where $|L| = 1$, the phase margin is the distance of the phase from $-180°$. Where the phase is $-180°$, the gain margin is $-20 \log_{10} |L|$.
    A third measure of stability is the smallest distance of $L$ from $-1$.

    *Noise runs round the loop.* Gyro noise and turbulence enter $f$, and from there $e$. Let $S_{fe}$ be the cross spectrum of $f$ and $e$, and $S_{ee}$ the power spectrum of $e$. The **direct** estimate
    $\hat L = S_{fe}/S_{ee}$ then mixes two values:

    - $L$, which it gives where the sweep is much larger than the noise,
    - $-1$, which it gives where the noise is much larger than the sweep (with $r = 0$, $e = -f$).

    The **joint** estimate relates both signals to the sweep, which contains no noise: $\hat L = S_{fr}/S_{er}$.

    *Model.* In the band of frequencies where the coherence is 0.6 or more, the response $p/e$ is fitted by the roll mode with a delay $\tau$:

    $$ \frac{p}{e}(s) = \frac{K}{s + 1/T_{roll}}\, e^{-\tau s} . $$
    """)
    return


@app.cell
def _(lab, mo, page):
    controls = mo.ui.dictionary(
        {
            "gain": mo.ui.slider(
                steps=list(lab.GAINS),
                value=0.22,
                label="gain of the control law, command per rad/s",
                show_value=True,
                debounce=True,
            ),
            "delay": mo.ui.slider(
                steps=list(lab.DELAYS),
                value=32.0,
                label="delay, ms",
                show_value=True,
                debounce=True,
            ),
            "amplitude": page.slider(0.1, 0.3, 0.05, 0.15, "amplitude of the sweep"),
            "gyro": mo.ui.slider(
                steps=[0.5, 1.0, 5.0, 20.0],
                value=1.0,
                label="gyro noise, deg/s",
                show_value=True,
                debounce=True,
            ),
        }
    )
    return (controls,)


@app.cell
def _(controls, figure_response, found, mo, page):
    _figure = page.interactive_figure(
        figure_response(found.response),
        "magnitude, phase and coherence of the roll rate over the command, with the fitted model",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.with_controls(
                [
                    page.sliders(controls),
                    mo.md(
                        "The estimates use three flights of a minute each; they take a second or two."
                    ),
                ],
                _figure,
            ),
        ]
    )
    return


@app.cell
def _(command, controls, lab, mo, page):
    asked = lab.changes(**controls.value)
    with page.progress_message():
        found = lab.study(asked)
    _rows = [
        [
            row.name.replace("_", " "),
            row.unit,
            "" if row.true is None else f"{row.true:.4g}",
            f"{row.estimate:.4g} ± {row.std:.2g}",
            "" if row.sigmas is None else f"{row.sigmas:+.1f}",
        ]
        for row in found.rows
    ]
    mo.vstack(
        [
            page.table(["quantity", "unit", "true", "estimate ± σ", "error, σ"], _rows),
            mo.md(
                "`inv T roll` is 1/T of the roll mode. `gain increase` is the gain margin; `delay "
                "margin` is the further delay at which the loop becomes unstable. `distance` is "
                "the smallest distance from -1; the figure below shows it in dB."
            ),
            page.command_line(command("run", lab.SCENARIO, asked)),
        ]
    )
    return asked, found


@app.cell
def _(asked, figure_margins, found, lab, mo, page):
    _direct = lab.without_excitation(asked)
    mo.vstack(
        [
            mo.md("**The broken-loop response by the joint estimate:**"),
            page.interactive_figure(
                figure_margins(found.loop),
                "gain, phase and distance from -1 of the broken loop with its margins, joint "
                "estimate",
            ),
            mo.md("**The same flights if the sweep were not recorded, by the direct estimate:**"),
            page.interactive_figure(
                figure_margins(_direct),
                "gain, phase and distance from -1 of the broken loop by the direct estimate",
            ),
        ]
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "phase": page.Question(
            "Sliders as at first. How large is the estimated phase margin?",
            page.number_field("deg"),
            lambda value: close(value, lab.key_numbers()["phase margin"], 0.03),
            "Read the table, or the bar in the phase of the broken-loop response.",
            "Its 2-sigma interval contains the true value. The loop stayed closed in flight, and no model was needed.",
        ),
        "delay": page.Question(
            "What is the longest delay on the slider at which the true phase margin is still at "
            "least 45 deg, as MIL-F-9490D asks?",
            page.number_field("ms"),
            lambda value: close(value, lab.longest_delay(), 0.01),
            "Move the delay and read the column `true`.",
            "A delay lowers the phase margin by the crossover frequency (where |L| = 1) times the "
            "delay: by 0.057 deg per millisecond for each rad/s. The delay margin is the delay that takes all of it.",
        ),
        "gain": page.Question(
            "Delay 32 ms again. Double the gain of the control law from 0.22 to 0.44. By how many dB does "
            "the gain margin fall?",
            page.number_field("dB"),
            lambda value: value is not None and abs(value - 6.0) <= 0.5,
            "The gain margin is `gain increase` in the table: compare it before and after.",
            "Twice the gain is 20 log 2 = 6 dB more, and the gain margin falls by nearly as much. (A "
            "small part of the feedback, the integral of the roll rate, keeps its gain.)",
        ),
        "direct": page.Question(
            "Gain 0.22 again, gyro noise of 20 deg/s. What happens to the direct estimate of the "
            "broken-loop response?",
            page.multiple_choice(
                [
                    "it moves towards 0",
                    "it moves towards -1, as if the loop were at its stability limit",
                    "it only scatters more",
                ]
            ),
            lambda value: value is not None and value.startswith("it moves towards -1"),
            "Look at the distance from -1 in the last figure, and at the theory: what is f/e when "
            "there is no sweep?",
            "At frequencies where the noise is larger than the sweep, e is nearly -f for any control "
            "law. The margins of the direct estimate then show the noise, not the loop.",
        ),
        "amplitude": page.Question(
            "Gyro noise of 5 deg/s. Raise the amplitude of the sweep from 0.1 to 0.2. How does the "
            "sigma of the phase margin change?",
            page.multiple_choice(["it stays", "it falls to about a half", "it doubles"]),
            lambda value: value == "it falls to about a half",
            "Compare the sigmas of the phase margin in the table.",
            "The random error is proportional to noise over signal. Twice the "
            "amplitude has the same effect as four times the flight time.",
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

    The sweep is the only signal that no noise enters. Could the movement of the pilot's stick take its place? When could it not?
    `flightid design --band LOW HIGH` predicts before the flight which coherence a sweep will give, and `flightid response ... --margins minus` estimates
    the margins from a record of your own.
    """)
    return


if __name__ == "__main__":
    app.run()
