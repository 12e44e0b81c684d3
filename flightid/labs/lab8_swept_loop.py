import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Lab 8: a sweep, its response, its margins")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.workings import swept_loop as lab
    from flightid.labs.workings.trying import close, command
    from scenarios.plots.flying_qualities import figure_margins, figure_response

    return close, command, figure_margins, figure_response, lab, mo, page


@app.cell
def _(page):
    page.heading(
        8,
        "A sweep, its response, its margins",
        """To sweep the roll loop of a small aircraft in flight, to read a model and the stability margins off its frequency responses,
        and to see how wrong they are when the excitation is not recorded.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    A law feeds the roll rate $p$ back to the command of the ailerons. A sweep $r$ is added at the sum:

    $$ e = r - f , \qquad p = P\,e , \qquad f = C\,p , \qquad L = C P . $$

    $P$ is the transfer function of the aircraft and $C$ that of the law, $e$ the command behind the sum and $f$ the signal that returns. The **broken-loop response** $L =
    f/e$ gives the margins, although the loop stays closed: where $|L| = 1$ the phase margin is the angle to $-180°$, where the angle is $-180°$ the gain margin is $-20 \log_{10} |L|$.

    *Noise goes round the loop.* Gyro noise and rough air enter $f$, and from there $e$. Let $S_{fe}$ be the cross spectrum of $f$ and $e$, and $S_{ee}$ the power spectrum of $e$. A **direct** estimate
    $\hat L = S_{fe}/S_{ee}$ then mixes two values,

    $$ L \ \text{(the sweep's share)} \quad\text{and}\quad -1 \ \text{(what noise alone would give: } e = -f\text{)} . $$

    The **joint** estimate relates both signals to the sweep, which no noise reaches: $\hat L = S_{fr}/S_{er}$.

    *Model.* The response $p/e$ in the usable band (coherence of 0.6 or more) is fitted by

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
                label="gain of the law, command per rad/s",
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
    _figure = page.plotted(
        figure_response(found.response),
        "magnitude, phase and coherence of the roll rate over the command, with the fitted model",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.beside(
                [
                    page.sliders(controls),
                    mo.md("Three flights of a minute are pooled; they take a second or two."),
                ],
                _figure,
            ),
        ]
    )
    return


@app.cell
def _(command, controls, lab, mo, page):
    asked = lab.changes(**controls.value)
    with page.computing():
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
            page.command_line(command("run", lab.SCENARIO, asked)),
        ]
    )
    return asked, found


@app.cell
def _(asked, figure_margins, found, lab, mo, page):
    _direct = lab.without_excitation(asked)
    mo.vstack(
        [
            mo.md("**The broken loop, by the joint estimate.**"),
            page.plotted(
                figure_margins(found.loop),
                "gain, phase and distance from -1 of the broken loop with its margins, joint "
                "estimate",
            ),
            mo.md("**The same flights if the sweep had not been recorded.** The direct estimate:"),
            page.plotted(
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
            "Everything as it was at first. How large is the phase margin?",
            page.number_field("deg"),
            lambda value: close(value, lab.numbers()["phase margin"], 0.03),
            "The table, or the bar in the second panel of the broken loop.",
            "Its interval holds the true value. The loop stayed closed, and no model was needed.",
        ),
        "delay": page.Question(
            f"What is the longest delay of the slider with a true phase margin of {lab.ENOUGH:g} "
            "deg or more?",
            page.number_field("ms"),
            lambda value: close(value, lab.longest_delay(), 0.01),
            "Move the delay and read the column `true`.",
            "Each millisecond costs the crossover frequency times 0.057 deg per rad/s. A delay "
            "margin says the same in one number.",
        ),
        "gain": page.Question(
            "Back to 32 ms. Double the gain of the law from 0.22 to 0.44. By how many dB does the "
            "gain margin fall?",
            page.number_field("dB"),
            lambda value: value is not None and abs(value - 6.0) <= 0.5,
            "Compare `gain increase` before and after.",
            "By 20 log 2 = 6 dB, less the effect of the integral: a gain margin is "
            "counted in the same unit.",
        ),
        "direct": page.Question(
            "Gain 0.22 again, gyro noise of 20 deg/s. Where does the direct estimate of the broken "
            "loop go?",
            page.choice(
                [
                    "towards 0",
                    "towards -1, as if the loop were at its border",
                    "nowhere: it only scatters more",
                ]
            ),
            lambda value: value is not None and value.startswith("towards -1"),
            "Look at the distance from -1 in the last figure, and at the theory: what is f/e when "
            "there is no sweep?",
            "Where noise is larger than the sweep, e = -f for any control law. The "
            "margins shown are those of the noise.",
        ),
        "amplitude": page.Question(
            "Gyro noise of 5 deg/s. Raise the amplitude of the sweep from 0.1 to 0.2. What does "
            "the sigma of the phase margin do?",
            page.choice(["it stays", "it halves about", "it doubles"]),
            lambda value: value == "it halves about",
            "Compare the sigmas of the phase margin in the table.",
            "The random error is proportional to noise over signal. Twice the "
            "amplitude has the same effect as four times the flight time.",
        ),
    }
    answers = page.fields(questions)
    return answers, questions


@app.cell
def _(answers, mo, page, questions):
    mo.vstack([mo.md("## Questions"), page.asked(questions, answers)])
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## To think about

    The sweep is the only signal that no noise reaches. Could the pilot's stick serve as one? When would it not?
    `flightid design --band LOW HIGH` says before the flight what coherence a sweep will give, and `flightid response ... --margins minus` reads
    the margins off a record of your own.
    """)
    return


if __name__ == "__main__":
    app.run()
