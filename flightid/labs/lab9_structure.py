import marimo

__generated_with = "0.25.2"
app = marimo.App(width="medium", app_title="Lab 9: terms of a model, from data")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_structure
    from flightid.labs.workings import close
    from flightid.labs.workings import model_structure as lab

    return close, figure_structure, lab, mo, page


@app.cell
def _(page):
    page.heading(
        9,
        "Terms of a model, from data",
        """To find the terms of the aerodynamic coefficients of an aircraft from records, to see when a record cannot
        distinguish two terms, and why a model that fits well need not predict well.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    The measured accelerations and the derivatives of the measured rates give the **coefficients** of force and moment at each time. The coefficient of the pitching moment, for example, is

    $$ C_m = \frac{I_y \dot q + (I_x - I_z)\, p r + I_{xz}\,(p^2 - r^2) - T z_T}{\bar q S \bar c} , $$

    with the moments of inertia $I$, the thrust $T$ and its arm $z_T$, the dynamic pressure $\bar q$, the wing area $S$ and the mean chord $\bar c$.

    The model of a coefficient is a sum $z = \theta_0 + \sum_j \theta_j\, t_j$ of **terms** $t_j$: signals ($\alpha$, $\hat q = q \bar c / 2V$, $\delta_e$, ...) and
    their products. Which terms does it need? With eight signals there are 44 terms up to the second degree: 8 signals, 8 squares, 28 products.

    **Stepwise regression** adds terms one after the other. $F$ of a term is the sum of squares that it explains, divided by the variance of the residual. Linear terms enter first, whatever their $F$: two terms that mask each other both have a
    small $F$ alone. Those whose $F$ is below 20 then leave. From there on the term with the largest $F$ enters, if $F > 20$, and terms whose $F$ has fallen below 20 leave. At the end a linear term of small $F$ returns
    if the value of another term depends on it. The column `step` of the table says when a term entered; the steps that are missing there belong to terms that left again. Two further numbers show whether the last terms improve the model, with the samples $k = 1 \dots N$:

    $$ \text{PSE} = \frac{1}{N}\sum_k (z_k - \hat z_k)^2 + \sigma^2_{max}\,\frac{n}{N} , $$

    $$ R^2_{\text{left out}} = 1 - \frac{\sum_k (z_k - \hat z_k^{(-m)})^2}{\sum_k (z_k - \bar z)^2} . $$

    The **predicted squared error** (PSE) adds a penalty for each of the $n$ terms, with the variance $\sigma^2_{max}$ of $z$. The second number, **R² left out**, leaves out each
    maneuver $m$ in turn and predicts it by a model from the others, $\hat z^{(-m)}$.

    **Collinearity.** If two terms change together in a record, the record determines their joint effect, but not
    the effect of each. The *variance inflation factor* (VIF) of a term is the variance of its estimate, divided by the variance of an estimate of the same term without correlation with the others; values above 10 are critical. Two
    proportional terms do not show a large VIF, because only one of them enters.
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
                label="largest degree of a term",
                show_value=True,
                debounce=True,
            ),
        }
    )
    return (controls,)


@app.cell
def _(axis, controls, figure_structure, lab, mo, page, studied):
    _each = studied.found.selections[axis]
    _figure = page.interactive_figure(
        figure_structure(_each.steps, lab.variance(studied, axis), lab.shown(studied, axis), axis),
        "the residual after each step of the regression, and the coefficient measured and modelled",
    )
    mo.vstack([mo.md("## Try it"), page.with_controls([page.sliders(controls)], _figure)])
    return


@app.cell
def _(controls, lab, page):
    _values = dict(controls.value)
    axis = _values.pop("axis")
    with page.progress_message("Flying the maneuvers and choosing terms"):
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
                f"R² of the fitted maneuvers **{_each.r2:.4f}**; R² left out "
                f"**{lab.held_out(studied, axis)}**; R² of a maneuver that is never fitted, in "
                "which the rudder does not follow the aileron, "
                f"**{studied.predicted(axis):.4f}**; residual over noise **{_each.ratio:.2f}**; "
                "largest condition index (another measure of collinearity) "
                f"**{max(_together.indices):.0f}**."
            ),
            mo.callout(mo.md("<br>".join(page.escaped(line) for line in _said)), kind="warn")
            if _said
            else mo.callout(
                mo.md(
                    "No warning. This does not prove that every true term was found: compare with the column `true`."
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
                "The same on the command line, in the folder with the unpacked files",
            ),
        ]
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "product": page.Question(
            "Sliders as at first. Which term of the pitching moment does a linear model not contain?",
            page.multiple_choice(["alpha^2", "alpha*elevator", "alpha*q", "abs(elevator)"]),
            lambda value: value == "alpha*elevator",
            "Read the table.",
            "The elevator becomes less effective as the angle of attack grows: its effect is "
            "-1.3 + 5 alpha.",
        ),
        "lacking": page.Question(
            "Set the largest degree to 1. How many times the noise is the residual of Cm now?",
            page.number_field("times"),
            lambda value: close(value, lab.key_numbers(degree=1)["residual/noise"], 0.03),
            "The line below the table.",
            "R² is still 0.96: a high R² shows that the response was large, not that the model is "
            "right. Compare the residual with the noise instead. The warning names the missing term.",
        ),
        "inflation": page.Question(
            "Degree 2 again, coefficient Cl. The largest VIF is 8.4, that of beta. How large is the "
            "largest VIF if all surfaces move by multisines at once?",
            page.number_field("VIF"),
            lambda value: close(value, lab.key_numbers(axis="Cl", kind=lab.KINDS[1])["VIF"], 0.03),
            "Change how the surfaces move and read the last column.",
            "After a pulse the aircraft oscillates in its Dutch roll, in which p, r and beta keep their "
            "ratios. Surfaces that keep moving change these ratios.",
        ),
        "linked": page.Question(
            "Pulses one after the other, Cn. Let the rudder follow the aileron. How large is the "
            "largest VIF?",
            page.number_field("VIF"),
            lambda value: close(value, lab.key_numbers(axis="Cn", linked=True)["VIF"], 0.03),
            "The last column of the table.",
            "The rudder moves 0.6 times the aileron, and hardly by itself. The regression keeps both "
            "terms, and their large standard deviations show that the maneuvers hardly distinguish "
            "them. A model without the rudder gives its effect to the aileron: "
            "0.004 + 0.6 (-0.110) = -0.062. Its R² left out is still 0.98.",
        ),
        "noise": page.Question(
            "Rudder free, multisines at once, Cm, noise of 10. How many maneuvers does it take "
            "until `alpha*elevator` is found?",
            page.number_field("maneuvers"),
            lambda value: value == lab.maneuvers_needed("alpha*elevator", "Cm", 10.0),
            "Move the number of maneuvers up from one.",
            "F grows in proportion to the number of samples. A term that was not chosen need not be "
            "zero: the records may not determine it.",
        ),
        "degree": page.Question(
            "One maneuver of pulses, usual noise, Cl, degree 4: many more terms are offered. How many "
            "are chosen?",
            page.number_field("terms"),
            lambda value: value == lab.key_numbers(axis="Cl", maneuvers=1, degree=4)["terms"],
            "Count the rows of the table.",
            "The same six as at degree 2, all of them true. A term enters only if it lowers the "
            "residual by more than chance. With one maneuver no R² of "
            "maneuvers left out checks this; the maneuver that is never fitted does (R² 0.999).",
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

    Which maneuver would you fly to find $C_{m_{\alpha \delta_e}}$ in the shortest time? How does feedback change the collinearity, and
    which signal could be added to its commands? `flightid structure --out` writes the terms found into a vehicle file of model `aircraft`, and `flightid identify` refines their
    values by output error.
    """)
    return


if __name__ == "__main__":
    app.run()
