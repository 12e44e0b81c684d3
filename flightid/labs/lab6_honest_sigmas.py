import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 6: honest sigmas")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_residual, figure_scatter
    from flightid.labs.workings import honest_sigmas as lab
    from flightid.labs.workings.trying import close, command, residuals

    return close, command, figure_residual, figure_scatter, lab, mo, page, residuals


@app.cell
def _(page):
    page.heading(
        6,
        "Honest sigmas",
        """To test the standard deviations of an estimator: fly the same flight many times, and
        compare the scatter of the estimates with the reported sigma. Then to make the sigmas
        wrong in three ways, and to correct them.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    An estimator returns $\hat\theta$ and a covariance $\hat P$. The sigma $\sqrt{\hat P_{ii}}$ is a *statement*: repeat the flight with other noise,
    and the estimates will scatter by so much about the truth. A
    **campaign** of $N$ runs tests it. With $e_i = \hat\theta_i - \theta$,

    $$ \text{bias} = \frac1N\sum e_i , \qquad \text{scatter} = \Big(\tfrac{1}{N-1}\sum (e_i - \bar e)^2\Big)^{1/2} , \qquad
       \text{coverage} = \frac1N\,\#\{\, |e_i| \le 2\hat\sigma_i \,\} . $$

    Honest sigmas have scatter / sigma = 1 and a coverage of 95 %. With $N$ runs the coverage of one parameter is itself known to $\sqrt{0.95 \cdot
    0.05/N}$ only: 3 % at 50 runs.

    *The least sigma there is.* The **Cramér-Rao bound** (lab 2) holds for every unbiased estimator whose model is right. Here it is computed from
    finite differences of simulated noise-free flights; no estimator is involved.

    *What an estimator assumes.* It weighs the data by two assumed covariances: $R$ of the sensor noise, and $Q$ of
    disturbances that act on the states, such as turbulence:

    $$ \dot x = f(x, u) + w , \quad \operatorname{E} w w^T = Q\,\delta(t - t') , \qquad z_k = h(x_k) + v_k , \quad \operatorname{E} v v^T = R . $$

    If $R$ is wrong by a factor, sigma is wrong by its root; the slider scales $\sqrt R$, so that sigma changes by the slider's factor. If forces act that the estimator does not assume, the residual becomes **coloured**: each
    sample resembles the one before, and $n$ samples are worth
    far fewer than $n$. An estimator that counts them as $n$ independent ones reports sigmas that are too small.

    *Two remedies.* Give the filter the right $Q$, and it weighs the data correctly: sigma *and* estimate improve. Or keep the estimator and correct its
    sigmas for the colour of the residual, as output error does here,
    with the autocorrelation $\mathcal{R}_{vv}$ of the residual in the middle and the sensitivities $S_i$ of the outputs:

    $$ \operatorname{cov}\hat\theta = M^{-1} \Big[ \sum_{i,j} S_i^T R^{-1}\,\mathcal{R}_{vv}(i-j)\,R^{-1} S_j \Big] M^{-1} ,
    \qquad M = \sum_i S_i^T R^{-1} S_i . $$
    """)
    return


@app.cell
def _(lab, mo, page):
    controls = mo.ui.dictionary(
        {
            "believed": page.slider(0.5, 2.0, 0.25, 1.0, "sensor noise assumed / true"),
            "acting": mo.ui.slider(
                steps=list(lab.DENSITIES),
                value=0.0,
                label="process noise that acts, (deg/s)²/s",
                show_value=True,
                debounce=True,
            ),
            "told": mo.ui.slider(
                steps=list(lab.DENSITIES),
                value=0.0,
                label="process noise that the filter assumes",
                show_value=True,
                debounce=True,
            ),
            "method": mo.ui.dropdown(
                list(lab.METHODS), value="extended Kalman filter", label="estimator"
            ),
        }
    )
    runs = page.slider(20, 200, 10, 50, "runs")
    return controls, runs


@app.cell
def _(controls, figure_scatter, lab, many, mo, page, runs):
    _figure = page.plotted(
        figure_scatter(lab.errors(many)),
        "histograms of the errors in reported sigmas beside the standard normal density",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.beside(
                [
                    page.sliders(controls),
                    runs,
                    mo.md(
                        "With process noise, every run is a flight of its own: fifty take a few "
                        "seconds. "
                        "(Output error assumes no process noise: the third slider has no effect on it.)"
                    ),
                ],
                _figure,
            ),
        ]
    )
    return


@app.cell
def _(command, controls, lab, mo, page, runs):
    asked = lab.changes(**controls.value)
    with page.computing():
        many = lab.campaign(asked, runs.value)
    _bound = lab.bound()
    _rows = [
        [
            s.name,
            f"{s.bias / s.scatter * len(many.seeds) ** 0.5:+.1f}",
            f"{s.scatter:.3g}",
            f"{s.reported:.3g}",
            f"**{s.scatter / s.reported:.2f}**",
            f"{_bound[s.name]:.3g}",
            f"{100 * s.within_two:.0f} %",
        ]
        for s in many.spreads
    ]
    _low, _high = many.pooled.interval
    mo.vstack(
        [
            page.table(
                [
                    "derivative, 1/rad",
                    "bias, in its standard errors",
                    "scatter",
                    "reported sigma",
                    "scatter / reported",
                    "Cramér-Rao, sensors alone",
                    "within 2 sigma",
                ],
                _rows,
            ),
            mo.md(
                f"All six together: **{100 * many.pooled.within_two:.0f} %** of the 2-sigma "
                "intervals hold the truth (95 % interval "
                f"{100 * _low:.0f} to {100 * _high:.0f} %; honest: 95 %); "
                f"scatter over sigma **{many.pooled.scatter:.2f}**."
            ),
            page.command_line(
                command("campaign", lab.SCENARIO, asked, "--runs", str(runs.value), "--seed", "1")
            ),
        ]
    )
    return asked, many


@app.cell
def _(asked, figure_residual, lab, mo, page, residuals):
    _study = lab.study(asked)
    mo.vstack(
        [
            mo.md("**The residual of the first run.** Is it white?"),
            page.plotted(
                figure_residual(
                    _study.record.time,
                    residuals(_study),
                    {channel.name: channel.unit for channel in _study.record.outputs},
                    _study.truth.noise_std,
                ),
                "residual of angle of attack and pitch rate of one run, power spectra, "
                "autocorrelation",
            ),
        ]
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "honest": page.Question(
            "Everything as it was at first (50 runs). By how much does the reported sigma of C_mα "
            "differ from the Cramér-Rao bound, in per cent?",
            page.number_field("%"),
            lambda value: (
                abs(abs(value) - abs(100 * (lab.numbers()["sigma over bound of Cm_alpha"] - 1)))
                <= 1.5
            ),
            "Divide the fourth column by the sixth.",
            "By almost nothing: this estimator is efficient, and its sigmas are "
            "correct. (It is slightly below the bound because it also has a prior, "
            "which the bound does not contain.)",
        ),
        "sensors": page.Question(
            "Let the filter assume half the true sensor noise (0.5). What happens?",
            page.choice(
                [
                    "sigma and scatter both halve",
                    "sigma halves, the scatter stays",
                    "sigma stays, the scatter doubles",
                ]
            ),
            lambda value: value == "sigma halves, the scatter stays",
            "Compare the columns `scatter` and `reported sigma` before and after.",
            "A factor that is common to the weights of all sensors does not change "
            "the estimate. Only the reported sigma is wrong.",
        ),
        "unmodelled": page.Question(
            "Back to 1. Let process noise of 0.1 act that the filter does not assume. By what factor "
            "does C_mδe scatter more than its sigma says?",
            page.number_field("times"),
            lambda value: close(value, lab.numbers(acting=0.1)["scatter over sigma of Cm_de"], 0.1),
            "The column `scatter / reported`.",
            "The residual's autocorrelation shows why: it is coloured. So are residuals of real records in calm air, since every model is "
            "incomplete.",
        ),
        "corrected": page.Question(
            "The same flight by output error, whose sigmas are corrected for the colour. How many "
            "per cent of the 2-sigma intervals hold the "
            "truth now?",
            page.number_field("%"),
            lambda value: (
                abs(value - lab.numbers(acting=0.1, method="output error")["within 2 sigma"]) <= 3
            ),
            "The line under the table.",
            "From 41 to 90: far better, but not yet 95. The correction estimates the "
            "colour from the residual of one maneuver, which determines it poorly.",
        ),
        "right": page.Question(
            "Kalman filter again: 0.1 acts, and it assumes 0.1. Now the sigmas are honest. By what "
            "factor is the *scatter* of C_Lq smaller than when it assumes 0?",
            page.number_field("times"),
            lambda value: close(
                value,
                lab.numbers(acting=0.1)["scatter of CL_q"]
                / lab.numbers(acting=0.1, told=0.1)["scatter of CL_q"],
                0.1,
            ),
            "Divide the scatter at 0 assumed by the one at 0.1 assumed.",
            "The right weights not only give correct sigmas, they also improve the estimate.",
        ),
        "modest": page.Question(
            "Now no process noise acts, but the filter assumes 0.1. Is that safe?",
            page.choice(
                [
                    "yes, and it costs nothing",
                    "it is safe but wasteful: sigmas are several times too large, and the "
                    "intervals say little",
                    "no, the estimates are biased",
                ]
            ),
            lambda value: value is not None and value.startswith("it is safe"),
            "Compare reported sigma and bound for C_mα.",
            "The sigma of C_mα is 4.5 times the bound. A sigma that is too large is wrong as well.",
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

    On measured data there is no truth and no campaign. What else shows whether your sigmas are honest? (Whiteness of the residual. Scatter
    from record to record. The prediction of a record that was not fitted.)
    `flightid identify --method filter-error` finds the size of $Q$ from the record itself.
    """)
    return


if __name__ == "__main__":
    app.run()
