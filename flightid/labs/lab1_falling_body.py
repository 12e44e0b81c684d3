import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 1: a falling body")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.workings import close, command
    from flightid.labs.workings import falling_body as lab
    from scenarios.plots.signals import figure_ballistic_coefficient, figure_trajectory

    return close, command, figure_ballistic_coefficient, figure_trajectory, lab, mo, page


@app.cell
def _(page):
    page.heading(
        1,
        "A falling body",
        """To see how a Kalman filter estimates one parameter, at which altitudes the record
        contains information about it, and why after a poor start the error of the estimate is
        many times the standard deviation that the filter reports.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    A body falls straight down from 200 000 ft at 6000 ft/s. A radar measures its altitude $h$ ten times a second. Its drag depends on one number,
    the **ballistic coefficient** $\beta = m / (C_D A)$, mass over drag area. Its true value is 500 lb/ft² (pounds of mass per square foot), or 2441 kg/m²:

    $$ \ddot h = \frac{\rho(h)\,\dot h^2}{2\,\beta} - g , \qquad \rho(h) = \rho_0\, e^{-h/h_0} , $$

    with the air density $\rho$, which falls by the factor $e$ over $h_0$ = 22 000 ft, and the acceleration of gravity $g$.

    *A parameter as a state.* The extended Kalman filter (EKF) takes $x = (h, \dot h, \beta)$ with $\dot\beta = 0$. Between two samples, $\Delta t$ apart, it carries
    the mean $\hat x$ and the
    covariance $P$ along,

    $$ \dot{\hat x} = f(\hat x) , $$

    $$ P \leftarrow \Phi P \Phi^T , $$

    $$ \Phi \approx I + F\,\Delta t + \tfrac12 (F\,\Delta t)^2 , $$

    $$ F = \left.\frac{\partial f}{\partial x}\right|_{\hat x} , $$

    and at a sample $z$ with noise variance $R$ it weighs prediction against measurement. The matrix $H = (1, 0, 0)$ takes the measured altitude from the state; $K$ is the gain:

    $$ K = P H^T (H P H^T + R)^{-1} , $$

    $$ \hat x \leftarrow \hat x + K (z - H \hat x) , $$

    $$ P \leftarrow (I - K H) P . $$

    *Where the information is.* The altitude contains information about $\beta$ only through one entry of $F$,

    $$ \frac{\partial \ddot h}{\partial \beta} = - \frac{\rho\,\dot h^2}{2\,\beta^2} . $$

    At high altitude $\rho$ is nearly zero, and so is this entry: the record contains almost no
    information there. It is also proportional to $1/\beta^2$.

    *What the reported sigma leaves out.* The filter does not know the true $\beta$, so it evaluates $F$ at its own estimate $\hat\beta$.
    If $\hat\beta$ is wrong, so are the sensitivity and the gain $K$ that follows from it, and each measurement moves $\hat\beta$ by a wrong amount.
    $P$ contains the prior and the noise of the radar, but not this **error of linearisation**: it shrinks after each measurement as if $F$ were right.
    Later measurements then get too little weight to correct the early errors. At the end, sigma (the square root of the entry of $P$ that belongs to $\beta$)
    is nearly that of a filter with a good start, but the error of $\hat\beta$ is many times larger.

    A second *pass* avoids this: the filter runs through the record again and starts at the first estimate, with twenty times its sigma. If the second pass starts with the wide prior again, it does not help (`labs/falling-body.md`, part 4).

    *An honest sigma:* in 95 of 100 repetitions the interval of two standard deviations contains the true value. One run cannot show this; a **campaign** of many runs can.
    """)
    return


@app.cell
def _(mo, page):
    controls = mo.ui.dictionary(
        {
            "start": page.slider(300, 1200, 50, 800, "start of β, lb/ft²"),
            "spread": page.slider(10, 400, 10, 300, "its standard deviation, lb/ft²"),
            "passes": page.slider(1, 5, 1, 1, "passes"),
            "noise": page.slider(5, 200, 5, 25, "radar noise, ft"),
        }
    )
    seed = mo.ui.number(1, 999, step=1, value=1, label="seed of the noise")
    return controls, seed


@app.cell
def _(controls, figure_ballistic_coefficient, lab, mo, page, seed, study):
    _figure = page.interactive_figure(
        figure_ballistic_coefficient(
            {"Kalman filter, last pass": lab.history_of(study)},
            study.truth.parameters["beta"].value,
        ),
        "estimate of beta over time with its band of two standard deviations, and its error",
    )
    mo.vstack([mo.md("## Try it"), page.with_controls([page.sliders(controls), seed], _figure)])
    return


@app.cell
def _(command, controls, lab, mo, page, seed):
    asked = lab.changes(**controls.value)
    with page.progress_message():
        study = lab.study(asked, seed.value)
    _row = study.main.rows[0]
    _unit = lab.POUND_PER_SQUARE_FOOT
    _off = (_row.estimate - _row.true) / _row.std
    mo.vstack(
        [
            mo.md(
                f"**One fall:** β = {_row.estimate / _unit:.2f} ± {_row.std / _unit:.2f} lb/ft², "
                f"true value {_row.true / _unit:.0f}; error **{_off:+.1f} "
                "sigmas**. "
                f"The filter has halved its sigma at {lab.awakening(study)[0]:.1f} s, "
                f"{lab.awakening(study)[1] / 1000:.1f} km up."
            ),
            page.command_line(command("run", lab.SCENARIO, asked, "--seed", str(seed.value))),
        ]
    )
    return asked, study


@app.cell
def _(figure_trajectory, lab, mo, page, study):
    mo.accordion(
        {
            "The fall itself: altitude and velocity": page.interactive_figure(
                figure_trajectory(
                    study.record, {"Kalman filter": lab.history_of(study)}, study.truth
                ),
                "altitude and velocity over time with the errors of the filter",
            )
        }
    )
    return


@app.cell
def _(page):
    runs = page.slider(50, 400, 50, 200, "falls")
    return (runs,)


@app.cell
def _(asked, command, lab, mo, page, runs):
    many = lab.campaign(asked, runs.value)
    _all = many.pooled
    mo.vstack(
        [
            mo.md("## Not one fall but many"),
            runs,
            page.table(
                [
                    "errors in units of the sigma that each fall reports",
                    "found",
                    "with an honest sigma",
                ],
                [
                    ["mean over the falls", f"{_all.bias:+.1f}", "0"],
                    ["scatter: standard deviation over the falls", f"{_all.scatter:.1f}", "1"],
                    [
                        "share within 2: the interval of two sigmas contains the true value",
                        f"{100 * _all.within_two:.0f} %",
                        "95 %",
                    ],
                    ["falls on which the filter broke down", f"{many.broken}", "0"],
                ],
            ),
            page.command_line(
                command("campaign", lab.SCENARIO, asked, "--runs", str(runs.value), "--seed", "1")
            ),
        ]
    )
    return


@app.cell
def _(close, lab, page):
    _at = lab.key_numbers()
    questions = {
        "altitude": page.Question(
            "With the sliders as they were (start 800 ± 300, one pass, 25 ft): how high is the "
            "body when the filter has halved its sigma of "
            "β, in km?",
            page.number_field("km"),
            lambda value: close(value, _at["altitude then"], 0.05),
            "Read the line that begins with `One fall`; the band in the figure shows it too.",
            "Above this altitude the air is so thin that the radar noise of 25 ft hides the drag. "
            "In this first third of the record sigma falls only to a half; at the end "
            "it is a thousandth of its start.",
        ),
        "honest": page.Question(
            "Same sliders, 200 falls: how many of 100 intervals of two sigmas contain the true value?",
            page.number_field("of 100"),
            lambda value: abs(value - _at["within 2 sigma"]) <= 3,
            "Read the table of the campaign.",
            "With honest sigmas it is 95. A single fall shows nothing unusual; only repeated "
            "falls show that the errors are many times the reported sigma.",
        ),
        "noise": page.Question(
            "Make the radar four times worse (100 ft). By what factor does the *reported* sigma of "
            "β grow?",
            page.number_field("times"),
            lambda value: close(value, lab.key_numbers(noise=100.0)["sigma"] / _at["sigma"], 0.06),
            "Divide the sigma at 100 ft by the one at 25 ft.",
            "Nearly in proportion to the noise: the reported sigma is noise over sensitivity. It "
            "does not contain the error of linearisation.",
        ),
        "cure": page.Question(
            "Start 550 ± 110 instead. How many passes does the filter need until at least 90 of "
            "100 intervals contain the true value?",
            page.number_field("passes"),
            lambda value: value == lab.passes_needed(550.0, 110.0),
            "Set the start first, then raise the passes one by one and watch the table of many falls.",
            "The second pass starts near the true value, so its sensitivities are right from the "
            "first sample on, and the errors fit the reported sigma. It starts at the result of "
            "the first pass with twenty times its sigma: the record counts 1 + 1/400 times, so "
            "that using it twice hardly matters.",
        ),
        "worse": page.Question(
            "Start 800 again, one pass. Which prior gives the larger bias in sigmas?",
            page.multiple_choice(["a wide one: 800 ± 300", "a narrow one: 800 ± 30"]),
            lambda value: value == lab.worse_prior(),
            "Try both, and read the mean error in the table of many falls.",
            "By a prior of 800 ± 30 the true value of 500 is ten standard deviations away. The "
            "reported sigma at the end is nearly the same for both priors, so it gives no warning.",
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

    *Output error* fits the whole record at once by least squares. It does not work through the samples one after the other, so it has no early gains that can be wrong.
    This command repeats it on the same 200 falls, in some seconds:

    ```sh
    flightid campaign ballistic --runs 200 --set estimate.method=output-error --set "estimate.label=output error"
    ```

    Output error needs a start of β only for its first step: from 550 lb/ft², as in this command, and from 800 lb/ft² it ends at the same estimate. It reports a sigma of
    1.5 kg/m² (0.30 lb/ft²), nearly as the filter does (1.4 kg/m², 0.28 lb/ft²). But the mean error of output error is less than its standard error, and 96 % of its 2-sigma intervals contain the true value.
    When would you still want the filter?
    """)
    return


if __name__ == "__main__":
    app.run()
