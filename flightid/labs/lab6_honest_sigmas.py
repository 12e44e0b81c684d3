import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 6: honest sigmas")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_residual, figure_scatter
    from flightid.labs.workings import close, command, residuals
    from flightid.labs.workings import honest_sigmas as lab

    return close, command, figure_residual, figure_scatter, lab, mo, page, residuals


@app.cell
def _(page):
    page.heading(
        6,
        "Honest sigmas",
        """To test the standard deviations that an estimator reports: fly the same flight many
        times, and compare the scatter of the estimates with the reported sigma. Then to make the
        sigmas wrong in three ways, and to correct them.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    An estimator returns an estimate $\hat\theta$ and its covariance $\hat P$. The reported standard deviation $\hat\sigma$ of a parameter is the root of its entry on the diagonal of $\hat P$. It is a *prediction*:
    if the flight is repeated with other noise, the estimates will scatter by $\hat\sigma$ about the true value $\theta$. A
    **campaign** of $N$ runs tests this prediction. With the error $e_i = \hat\theta_i - \theta$ of run $i$,

    $$ \text{bias} = \frac1N\sum e_i , $$

    $$ \text{scatter} = \Big(\tfrac{1}{N-1}\sum (e_i - \bar e)^2\Big)^{1/2} , $$

    $$ \text{coverage} = \frac1N\,\#\{\, |e_i| \le 2\hat\sigma_i \,\} . $$

    For honest sigmas, scatter / sigma is 1 and the coverage is 95 %. $N$ runs determine the coverage of one parameter only with a standard deviation of $\sqrt{0.95 \cdot
    0.05/N}$: 3 % at 50 runs.

    *The smallest possible sigma* is the **Cramér-Rao bound** (lab 2). It holds for every unbiased estimator whose model is right. Here it is computed from
    finite differences of simulated noise-free flights; no estimator is involved.

    *What an estimator assumes.* A Kalman filter weighs the data by two assumed covariances: $R$ of the sensor noise $v$, and $Q$ of the **process noise** $w$, which stands for
    disturbances that act on the states, such as turbulence:

    $$ \dot x = f(x, u) + w , \quad \operatorname{E} w w^T = Q\,\delta(t - t') , $$

    $$ z_k = h(x_k) + v_k , \quad \operatorname{E} v v^T = R . $$

    If $R$ is wrong by a factor, sigma is wrong by the square root of this factor. The slider scales $\sqrt R$, so sigma changes by the slider's factor. If forces act that the estimator does not assume, the residual becomes **coloured**: each
    sample resembles the one before, and $n$ samples contain
    less information than $n$ independent ones. An estimator that counts them as independent reports sigmas that are too small.

    *Two remedies.* With the right $Q$ the filter weighs the data correctly: sigma *and* estimate improve. The other remedy keeps the estimate and corrects its
    sigma for the colour of the residual, as output error does here. The correction contains the autocorrelation $\mathcal{R}_{vv}(i-j)$ of the residual between samples $i$ and $j$, and the sensitivities $S_i$ of the outputs:

    $$ \operatorname{cov}\hat\theta = M^{-1} \Big[ \sum_{i,j} S_i^T R^{-1}\,\mathcal{R}_{vv}(i-j)\,R^{-1} S_j \Big] M^{-1} , $$

    $$ M = \sum_i S_i^T R^{-1} S_i . $$
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
    _figure = page.interactive_figure(
        figure_scatter(lab.errors(many)),
        "histograms of the errors in reported sigmas beside the standard normal density",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.with_controls(
                [
                    page.sliders(controls),
                    runs,
                    mo.md(
                        "With process noise, every run is a flight of its own: fifty take a few "
                        "seconds. "
                        "The estimator `output error` has no process noise, so the third slider "
                        "does not change its result."
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
    with page.progress_message():
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
                    "bias / its standard error",
                    "scatter",
                    "reported sigma",
                    "scatter / reported",
                    "Cramér-Rao, sensors alone",
                    "within 2 sigma",
                ],
                _rows,
            ),
            mo.md(
                f"All six derivatives together: **{100 * many.pooled.within_two:.0f} %** of the "
                "2-sigma intervals contain the true value (95 % interval "
                f"{100 * _low:.0f} to {100 * _high:.0f} %; honest sigmas: 95 %); "
                f"standard deviation of all errors, each divided by the sigma of its run: "
                f"**{many.pooled.scatter:.2f}** (honest sigmas: 1)."
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
            page.interactive_figure(
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
    _numbers = lab.key_numbers
    questions = {
        "honest": page.Question(
            "Sliders as at first (50 runs). By how many per cent does the reported sigma of C_mα "
            "differ from the Cramér-Rao bound?",
            page.number_field("%"),
            lambda value: (
                abs(abs(value) - abs(100 * (_numbers()["sigma over bound of Cm_alpha"] - 1))) <= 1.5
            ),
            "Divide `reported sigma` by `Cramér-Rao, sensors alone`.",
            "By less than 2 %: this estimator is efficient, and its sigmas are honest. (The sigma "
            "is slightly below the bound because the filter also has a prior, which the bound does "
            "not contain. The bias of C_mδe, 0.6 of its sigma, is the error of linearisation after "
            "a poor start, as in lab 1; output error does not have it.)",
        ),
        "sensors": page.Question(
            "Let the filter assume half the true sensor noise (0.5). What happens?",
            page.multiple_choice(
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
            "Back to 1. Let process noise of 0.1 act that the filter does not assume. How many times "
            "its reported sigma is the scatter of C_mδe?",
            page.number_field("times"),
            lambda value: close(value, _numbers(acting=0.1)["scatter over sigma of Cm_de"], 0.1),
            "The column `scatter / reported`.",
            "The autocorrelation of the residual shows why: the residual is coloured. The same holds for "
            "measured records even in calm air, since every model is incomplete.",
        ),
        "corrected": page.Question(
            "Now the same flights by output error, which corrects its sigmas for the colour. How many "
            "per cent of the 2-sigma intervals of all six derivatives contain the true value?",
            page.number_field("%"),
            lambda value: (
                abs(value - _numbers(acting=0.1, method="output error")["within 2 sigma"]) <= 3
            ),
            "The line under the table.",
            "With the Kalman filter it was 41 %; 90 % is far better, but not yet 95 %. The "
            "correction estimates the colour from the residual of one maneuver, which determines "
            "it poorly.",
        ),
        "right": page.Question(
            "Kalman filter again: process noise of 0.1 acts, and the filter assumes 0.1. Now the sigmas are "
            "honest. By what factor is the *scatter* of C_Lq smaller than when the filter assumes 0?",
            page.number_field("times"),
            lambda value: close(
                value,
                _numbers(acting=0.1)["scatter of CL_q"]
                / _numbers(acting=0.1, told=0.1)["scatter of CL_q"],
                0.1,
            ),
            "Divide the scatter of CL_q at 0 assumed by the one at 0.1 assumed.",
            "The right weights give honest sigmas, and they also improve the estimate.",
        ),
        "modest": page.Question(
            "Now no process noise acts, but the filter assumes 0.1. Is that safe?",
            page.multiple_choice(
                [
                    "yes, and it costs nothing",
                    "it is safe but wasteful: the sigmas are several times too large",
                    "no, the estimates are biased",
                ]
            ),
            lambda value: value is not None and value.startswith("it is safe"),
            "Compare reported sigma and bound for C_mα.",
            "The sigma of C_mα is 4.5 times the bound. A sigma that is too large is wrong as well.",
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

    For a measured record the true values are unknown, and you cannot repeat it 50 times. What else shows whether your sigmas are honest? (Whiteness of the residual. Scatter of the estimates
    from record to record. Prediction of a record that was not fitted.)
    `flightid identify --method filter-error` estimates $Q$ from the record itself.
    """)
    return


if __name__ == "__main__":
    app.run()
