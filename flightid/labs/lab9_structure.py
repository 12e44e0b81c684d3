import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Lab 9: terms of a model, from data")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_structure
    from flightid.labs.workings import model_structure as lab
    from flightid.labs.workings.trying import close

    return close, figure_structure, lab, mo, page


@app.cell
def _(page):
    page.heading(
        9,
        "Terms of a model, from data",
        """To find which terms the aerodynamic coefficients of an aircraft consist of, to see when a record cannot
        distinguish two terms, and why a model that fits need not predict.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    Accelerometers and the slopes of measured rates give the **coefficients** of force and moment over time; of the pitching moment, for example,

    $$ C_m = \frac{I_y \dot q + (I_x - I_z)\, p r + I_{xz}\,(p^2 - r^2) - T z_T}{\bar q S \bar c} , $$

    with the moments of inertia $I$, the thrust $T$ and its arm $z_T$, the dynamic pressure $\bar q$, the wing area $S$ and the mean chord $\bar c$.

    Each is modelled as a sum $z = \theta_0 + \sum_j \theta_j\, t_j$ of **terms** $t_j$: signals ($\alpha$, $\hat q = q \bar c / 2V$, $\delta_e$) and
    their products. Which of them? With eight signals there are 44 terms up to the second degree: 8 signals, 8 squares, 28 products.

    **Stepwise regression**: at each step the term with the largest partial $F$ enters, if $F > 20$; terms whose $F$ has fallen below 20 leave. A weaker linear term stays where the value of another depends on it.
    $F$ is the sum of squares that a term explains, divided by the variance of the residual. Two further numbers show whether the last terms were worth it:

    $$ \text{PSE} = \frac{1}{N}\sum_k (z_k - \hat z_k)^2 + \sigma^2_{max}\,\frac{n}{N} , \qquad R^2_{\text{left out}} = 1 - \frac{\sum_k (z_k - \hat z_k^{(-m)})^2}{\sum_k (z_k - \bar z)^2} . $$

    The **predicted squared error** adds a penalty for each of the $n$ terms, $\sigma^2_{max}$ being the variance of $z$. The second number leaves out each
    maneuver $m$ in turn and predicts it from the others.

    **Collinearity.** If two columns are correlated, the sum of their effects is known, but not
    each of them. The *variance inflation factor* of a term (VIF) says how
    many times larger its variance is than it would be if its column were orthogonal to the others; values above 10 are critical. Two
    proportional columns do not show a large VIF, because only one of them enters.
    """)
    return


@app.cell
def _(lab, mo):
    controls = mo.ui.dictionary(
        {
            "axis": mo.ui.dropdown(list(lab.AXES), value="Cm", label="coefficient"),
            "maneuvers": mo.ui.slider(
                1, lab.MOST, step=1, value=3, label="maneuvers", show_value=True, debounce=True
            ),
            "kind": mo.ui.dropdown(list(lab.KINDS), value=lab.KINDS[0], label="surfaces move as"),
            "linked": mo.ui.checkbox(value=False, label="the rudder follows the aileron"),
            "noise": mo.ui.slider(
                steps=[0.3, 1.0, 3.0, 10.0],
                value=1.0,
                label="sensor noise, times the usual",
                show_value=True,
                debounce=True,
            ),
            "degree": mo.ui.slider(
                1,
                4,
                step=1,
                value=2,
                label="degree of terms offered",
                show_value=True,
                debounce=True,
            ),
        }
    )
    return (controls,)


@app.cell
def _(axis, controls, figure_structure, lab, mo, page, studied):
    _each = studied.found.selections[axis]
    _figure = page.plotted(
        figure_structure(_each.steps, lab.variance(studied, axis), lab.shown(studied, axis), axis),
        "what each step of the regression leaves, and the coefficient measured and modelled",
    )
    mo.vstack([mo.md("## Try it"), page.beside([page.sliders(controls)], _figure)])
    return


@app.cell
def _(controls, lab, page):
    _values = dict(controls.value)
    axis = _values.pop("axis")
    with page.computing("Flying the maneuvers and choosing terms"):
        studied = lab.study(**_values)
    return axis, studied


@app.cell
def _(axis, controls, lab, mo, page, studied):
    _each, _together = studied.found.selections[axis], studied.found.collinearity[axis]
    _said = lab.told(studied, axis)
    mo.vstack(
        [
            page.table(
                ["term", "true", "estimate ± σ", "step", "F", "R² left out", "PSE", "VIF"],
                lab.term_rows(studied, axis),
            ),
            mo.md(
                f"R² of the maneuvers fitted **{_each.r2:.4f}**, left out in turn "
                f"**{lab.held_out(studied, axis)}**, of one that is never fitted, rudder free, "
                f"**{studied.predicted(axis):.4f}**; residual over noise **{_each.ratio:.2f}**; "
                f"largest condition index **{max(_together.indices):.0f}**."
            ),
            mo.callout(
                mo.md("<br>".join(page.plain(line) for line in _said)),
                kind="warn",
            )
            if _said
            else mo.callout(
                mo.md(
                    "No warning. This does not prove that every true term was found: compare with the column of true values."
                ),
                kind="neutral",
            ),
            mo.download(
                data=lambda: lab.archive(studied),
                filename="maneuvers.zip",
                label="The records and a vehicle file without terms",
            ),
            page.command_line(
                lab.command(controls.value["maneuvers"], controls.value["degree"]),
                "The same on the command line, beside the unpacked files",
            ),
        ]
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "product": page.Question(
            "Everything as it was at first. Which term of the pitching moment is no derivative of "
            "a linear model?",
            page.choice(["alpha^2", "alpha*elevator", "alpha*q", "abs(elevator)"]),
            lambda value: value == "alpha*elevator",
            "Read the table.",
            "The elevator loses power as the angle of attack grows, as in downwash or stall.",
        ),
        "lacking": page.Question(
            "Offer terms of degree 1 only. How many times the noise is the residual of Cm now?",
            page.number_field("times"),
            lambda value: close(value, lab.numbers(degree=1)["residual/noise"], 0.03),
            "The line below the table.",
            "And R² is still 0.96. A high R² says that the maneuver was large, not that the model "
            "is right; noise is the measure. The report names the term that was not offered.",
        ),
        "inflation": page.Question(
            "Degree 2 again, coefficient Cl. The largest VIF is 8.4, of beta. How large is the "
            "largest one with multisines on all surfaces at once?",
            page.number_field("VIF"),
            lambda value: close(value, lab.numbers(axis="Cl", kind=lab.KINDS[1])["VIF"], 0.03),
            "Change how the surfaces move and read the last column.",
            "After a pulse an aircraft swings in its Dutch roll, where p, r and beta keep their "
            "ratios. Surfaces that keep moving change these ratios.",
        ),
        "linked": page.Question(
            "Pulses one after the other, Cn. Let the rudder follow the aileron. How large is the "
            "largest VIF?",
            page.number_field("VIF"),
            lambda value: close(value, lab.numbers(axis="Cn", linked=True)["VIF"], 0.03),
            "The last column of the table.",
            "The rudder moves 0.6 times the aileron. Without it the aileron would take its effect "
            "in, 0.004 + 0.6 (-0.110) = -0.062, with R² of 0.98. Both are kept: their standard "
            "deviations say how little the maneuvers tell them apart.",
        ),
        "noise": page.Question(
            "Rudder free, multisines at once, Cm, noise of 10. How many maneuvers does it take "
            "until `alpha*elevator` is found?",
            page.number_field("maneuvers"),
            lambda value: value == lab.maneuvers_needed("alpha*elevator", "Cm", 10.0),
            "Move the number of maneuvers up from one.",
            "F grows in proportion to the number of samples. A term that is not chosen need not be zero: the record does not "
            "determine it.",
        ),
        "degree": page.Question(
            "One maneuver of pulses, usual noise, Cl, degree 4. What shows that the terms cannot be "
            "trusted?",
            page.choice(["R²", "residual over noise", "VIF"]),
            lambda value: value == "VIF",
            "Compare all three with those at degree 2.",
            "`alpha^2*r` has a VIF of 29: where alpha hardly moves, it and `alpha*p` together "
            "imitate p and beta. R² of the maneuver that is not fitted is 0.998 all the same.",
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

    Which maneuver would you fly to find $C_{m_{\alpha \delta_e}}$ with as little time as possible? What does a feedback law do to collinearity, and
    what can be added to its commands? The file that `flightid structure --out` writes is one of model `aircraft`: `flightid identify` refines its
    values by output error.
    """)
    return


if __name__ == "__main__":
    app.run()
