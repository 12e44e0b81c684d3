import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 3: flexibility and what a rigid model absorbs")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_residual
    from flightid.labs.workings import close, command, residuals, sigmas_off
    from flightid.labs.workings import flexibility as lab
    from scenarios.plots.comparisons import EquivalentRow, figure_equivalents

    return (
        EquivalentRow,
        close,
        command,
        figure_equivalents,
        figure_residual,
        lab,
        mo,
        page,
        residuals,
        sigmas_off,
    )


@app.cell
def _(page):
    page.heading(
        3,
        "Flexibility and what a rigid model absorbs",
        """To see which derivatives a rigid model finds on the record of a flexible aircraft, why they are not those of the rigid
        aircraft, how the residual shows the missing modes, and what process noise can and
        cannot correct.""",
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

    The structure of a large aircraft bends under its loads. The bending is a sum of mode shapes $i$, each with a coordinate $\eta_i$ (without dimension), a frequency $\omega_i$
    and a damping ratio $\zeta_i$ in vacuo, and a generalised mass $M_i$. Each mode is an oscillator that the air drives (the other symbols are those of lab 2):

    $$ \ddot\eta_i + 2\zeta_i\omega_i\dot\eta_i + \omega_i^2\eta_i =
    \frac{\rho V^2 S \bar c}{2 M_i} \Big( C^{\eta_i}_\alpha \alpha + C^{\eta_i}_q \tfrac{\bar c}{2V} q +
    C^{\eta_i}_{\delta}\delta_e + \sum_j \big(C^{\eta_i}_{\eta_j}\eta_j + \dots\big) \Big) . $$

    The dots stand for similar terms with $\dot\eta_j$. In turn each mode changes the lift and the moment:

    $$ C_L = C_{L_\alpha}\alpha + C_{L_q}\tfrac{\bar c}{2V} q + C_{L_\delta}\delta_e + \sum_i \big( C_{L_{\eta_i}}\eta_i + C_{L_{\dot\eta_i}}\tfrac{\bar c}{2V}\dot\eta_i \big) , $$

    and the moment $C_m$ likewise.

    *A stiff structure follows its loads at once.* With $\dot\eta = \ddot\eta = 0$ the equations of the modes become a linear system,

    $$ A\,\eta = b_\alpha\,\alpha + b_q \tfrac{\bar c}{2V} q + b_\delta\,\delta_e , $$

    $$ A_{ij} = \omega_i^2\,[i = j] - k_i\, C^{\eta_i}_{\eta_j} , $$

    $$ b_{\alpha,i} = k_i\, C^{\eta_i}_\alpha , $$

    $$ k_i = \frac{\rho V^2 S \bar c}{2 M_i} , $$

    where $[i = j]$ is 1 on the diagonal of $A$ and 0 elsewhere; $b_q$ and $b_\delta$ are formed like $b_\alpha$. So $\eta$ is proportional to $\alpha$, $q$ and $\delta_e$, and lift and moment depend on these three
    alone, as on a rigid aircraft, but with other derivatives. These are called **condensed** (also quasi-static, or elastic equivalents):

    $$ C_{m_\alpha}^{\text{cond}} = C_{m_\alpha} + C_{m_\eta} A^{-1} b_\alpha , \quad \text{and so for the other five.} $$

    A rigid model that is fitted to a flexible aircraft can absorb this part of the bending. It then finds the condensed derivatives, not those of the rigid aircraft.

    *What it cannot absorb* is the lag of the structure, which needs time to bend, and its oscillation. The six derivatives take biased values that imitate the lag;
    the rest of it appears in the residual, below and near the frequencies of the modes, where the input has power. The residual of a Kalman filter is called its *innovations*: measured minus predicted output. If the model is correct, the innovations are
    white (uncorrelated), and they have the variance that the filter computes. The test of Ljung and Box checks the first property; the test of the normalised innovations squared (NIS) checks the second.

    *Process noise* is white noise of density $Q$ that the filter adds to $\dot q$: it tells the filter that its model is incomplete, and the reported sigmas grow. It is no model of a mode, though: the
    missing force follows the elevator and is not white.
    """)
    return


@app.cell
def _(lab, mo, page):
    controls = mo.ui.dictionary(
        {
            "factor": page.slider(0.5, 4, 0.1, 1, "factor of all modal frequencies"),
            "density": mo.ui.slider(
                steps=list(lab.DENSITIES),
                value=0.0,
                label="process noise, (deg/s)²/s",
                show_value=True,
                debounce=True,
            ),
            "unit": page.slider(0.2, 1.0, 0.1, 0.5, "unit of the 3-2-1-1, s"),
        }
    )
    return (controls,)


@app.cell
def _(controls, figure_residual, lab, mo, page, residuals, study):
    _figure = page.interactive_figure(
        figure_residual(
            study.record.time,
            residuals(study),
            {channel.name: channel.unit for channel in study.record.outputs},
            study.truth.noise_std,
            lab.mode_frequencies(controls.value["factor"]),
        ),
        "innovations of angle of attack and pitch rate over time, their power spectra with the "
        "elastic modes marked, and their autocorrelation",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.with_controls(
                [
                    page.sliders(controls),
                    mo.md(
                        "Factor 1 is a large swept-wing bomber with four elastic modes (Waszak and "
                        "Schmidt, J. Aircraft 25(6), 1988; `flightid vehicles bomber_ac1` lists its "
                        "numbers and their origins). At 0.5 all its modes are half as fast, and "
                        "the structure is a quarter as stiff.\n\nThe process noise acts on pitch "
                        f"rate. With any value above 0, the filter also adds {lab.ALPHA_PROCESS_NOISE.replace('^2', '²')} "
                        "to angle of attack."
                    ),
                ],
                _figure,
            ),
        ]
    )
    return


@app.cell
def _(command, controls, lab, mo, page, sigmas_off):
    asked = lab.changes(**controls.value)
    with page.progress_message():
        study = lab.study(asked)
    _rows = [
        [
            row.name,
            f"{row.true:.4g}",
            f"{row.condensed:.4g}",
            f"{row.estimate:.4g}",
            f"{row.std:.2g}",
            f"{100 * (row.estimate / row.true - 1):+.0f} %",
            f"{sigmas_off(row):+.1f}",
        ]
        for row in study.main.rows
    ]
    _tests = page.residual_tests(study.main.tests)
    mo.vstack(
        [
            page.table(
                [
                    "derivative, 1/rad",
                    "rigid",
                    "condensed",
                    "estimate",
                    "sigma",
                    "estimate minus rigid",
                    "minus condensed, sigmas",
                ],
                _rows,
            ),
            mo.md(
                f"Natural frequency of the short period {study.main.derived['natural_frequency'][0]:.3f} "
                "rad/s; lowest elastic mode in vacuo "
                f"{lab.mode_frequencies(controls.value['factor'])[0]:.2f} rad/s. "
                f"Tests of the innovations: {_tests}."
            ),
            page.command_line(command("run", lab.SCENARIO, asked)),
        ]
    )
    return (study,)


@app.cell
def _(EquivalentRow, figure_equivalents, mo, page, study):
    _rows = [
        EquivalentRow(
            "this structure", row.name, row.unit, row.true, row.condensed, row.estimate, row.std
        )
        for row in study.main.rows
    ]
    mo.accordion(
        {
            "Rigid, condensed and estimated derivatives as a figure": page.interactive_figure(
                figure_equivalents(_rows), "rigid, condensed and estimated derivatives"
            )
        }
    )
    return


@app.cell
def _(close, lab, page):
    questions = {
        "nearer": page.Question(
            "Factor 1, no process noise. Is the estimate of C_mα nearer to the rigid aircraft's "
            "value or to the condensed one?",
            page.multiple_choice(["rigid", "condensed"]),
            lambda value: value == lab.nearer_reference(),
            "Compare the third column of numbers with the first two.",
            "A rigid model absorbs the bending that follows the loads at once. The record of this "
            "aircraft does not show the value of the rigid aircraft.",
        ),
        "lost": page.Question(
            "By how many per cent is the estimated static stability (C_mα) smaller "
            "than that of the rigid aircraft?",
            page.number_field("%"),
            lambda value: close(value, lab.key_numbers()["Cm_alpha lost, %"], 0.05),
            "The column `estimate minus rigid`, without its sign.",
            "Bending takes away part of the static stability. With the factor at 0.5 it takes away 71 %.",
        ),
        "worst": page.Question(
            "Which derivative has the largest error in sigmas (estimate minus condensed value)?",
            page.multiple_choice(["CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"]),
            lambda value: value == lab.worst_derivative(),
            "The last column.",
            "The lag of the structure acts like negative damping: C_mq is -31.2 instead of -33.1. "
            "The error is only 6 % of the value, but 23 sigmas: the sigmas contain the sensor "
            "noise, not the lag.",
        ),
        "seen": page.Question(
            "Lower the factor of the modal frequencies: 4, 3, 2, 1.5, 1. At which of these does a "
            "test of the innovations fail for the first time?",
            page.number_field("factor"),
            lambda value: value == lab.first_rejected_factor(),
            "The line under the table has the tests.",
            "At 2 every test passes, although the error of C_mq is already 3.4 sigmas: the tests "
            "do not see a bias of this size.",
        ),
        "noise": page.Question(
            "Factor 1 again. What is the least process noise on the slider with which all tests "
            "pass?",
            page.number_field("(deg/s)²/s"),
            lambda value: value == lab.least_sufficient_density(),
            "Move the second slider step by step.",
            "All tests pass, and the error of C_mq is still three sigmas, since the missing force "
            "follows the elevator. From 0.6 on the test of q fails again: the filter now follows "
            "the sensor noise, and successive innovations tend to have opposite signs.",
        ),
        "mends": page.Question(
            "What has the process noise corrected?",
            page.multiple_choice(
                [
                    "the model",
                    "the estimates, which are now the rigid aircraft's",
                    "mostly the sigmas, which now allow for what the model lacks",
                ]
            ),
            lambda value: value is not None and value.startswith("mostly the sigmas"),
            "Compare the sigma of C_mq at process noise 0 and 0.3, and how far its estimate moved.",
            "The sigma of C_mq becomes fourteen times larger. Its estimate even moves away from the "
            "condensed value (from -31.2 to -30.7; condensed -33.1), that of C_Lq towards it (from "
            "-22.0 to -17.5; condensed -16.2). To correct the model, add the mode: "
            "`flightid run flexible-ac1-first-mode`.",
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

    At a unit of 0.5 s the spectrum of the 3-2-1-1 has a gap at $2\pi / 0.5\,\text{s} = 12.57$ rad/s, the frequency of the first mode (lab 2 shows spectra). Shorter units excite
    the mode. Which of the biases grow with that, and does another test fail?

    `flightid run flexibility-sweep` estimates the derivatives of fourteen such structures; `flightid run trace-elastic` adds the missing mode to the rigid model of another flight, with alpha, q and nz (lab 5 shows how). The derivatives are then
    hardly determined, because the mode and the derivatives explain the same motion.
    """)
    return


if __name__ == "__main__":
    app.run()
