import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 3: flexibility and what a rigid model absorbs")


@app.cell
def _():
    import marimo as mo

    from flightid.labs import page
    from flightid.labs.figures import figure_residual
    from flightid.labs.workings import flexibility as lab
    from flightid.labs.workings.trying import close, command, residuals, sigmas_off
    from scenarios.plots.residuals import EquivalentRow, figure_equivalents

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
    page.sketch()
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    The structure of a large aircraft bends under its loads. In modal coordinates $\eta_i$ with in-vacuo frequencies $\omega_i$, dampings $\zeta_i$
    and generalised masses $M_i$, each mode is
    an oscillator that the air drives,

    $$ \ddot\eta_i + 2\zeta_i\omega_i\dot\eta_i + \omega_i^2\eta_i =
    \frac{\rho V^2 S \bar c}{2 M_i} \Big( C^{\eta_i}_\alpha \alpha + C^{\eta_i}_q \tfrac{\bar c}{2V} q +
    C^{\eta_i}_{\delta}\delta_e + \sum_j \big(C^{\eta_i}_{\eta_j}\eta_j + \dots\big) \Big) , $$

    and each drives the aircraft in turn: $C_L = \dots + C_{L_{\eta_i}}\eta_i + C_{L_{\dot\eta_i}}\dot\eta_i$, and $C_m$ likewise.

    *A stiff structure follows its loads at once.* With $\dot\eta = \ddot\eta = 0$ the modes become algebraic,
    $\eta = -A^{-1}(b_\alpha\alpha + b_q q +
    b_\delta\delta_e)$, and become part of the six
    derivatives, which are then called **condensed** (or quasi-static, or elastic equivalents):

    $$ C_{m_\alpha}^{\text{cond}} = C_{m_\alpha} - C_{m_\eta} A^{-1} b_\alpha , \quad \text{and so for the others.} $$

    This is what a rigid model can absorb. It does not find the derivatives of the rigid
    aircraft, but those of the aircraft with its wing bent.

    *What it cannot absorb* is the lag of the structure: it needs time to bend, and it oscillates. The six derivatives take biased values that imitate the lag;
    the rest of it appears in the residual, near the frequencies of the modes. The *innovations* of a Kalman filter with a correct model are
    white: uncorrelated, with the variance
    that the filter computes. The test of Ljung and Box checks the first property, the normalised innovations squared (NIS) the second.

    *Process noise* of density $Q$ on $\dot q$ tells the filter that its model is incomplete.
    Its sigmas grow. It is no model of a mode, though: the
    missing force follows the elevator and is not white.
    """)
    return


@app.cell
def _(lab, mo, page):
    controls = mo.ui.dictionary(
        {
            "factor": page.slider(0.5, 4, 0.1, 1, "stiffness: factor of all modal frequencies"),
            "density": mo.ui.slider(
                steps=list(lab.DENSITIES),
                value=0.0,
                label="process noise on pitch rate, (deg/s)²/s",
                show_value=True,
                debounce=True,
            ),
            "unit": page.slider(0.2, 1.0, 0.1, 0.5, "unit of the 3-2-1-1, s"),
        }
    )
    return (controls,)


@app.cell
def _(controls, figure_residual, lab, mo, page, residuals, study):
    _figure = page.plotted(
        figure_residual(
            study.record.time,
            residuals(study),
            {channel.name: channel.unit for channel in study.record.outputs},
            study.truth.noise_std,
            lab.marks(controls.value["factor"]),
        ),
        "innovations of angle of attack and pitch rate over time, their power spectra with the "
        "elastic modes marked, and their autocorrelation",
    )
    mo.vstack(
        [
            mo.md("## Try it"),
            page.beside(
                [
                    page.sliders(controls),
                    mo.md(
                        "Factor 1 is the moderately flexible bomber AC1 of the paper, 0.5 its soft sister "
                        "AC2."
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
    with page.computing():
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
    _tests = "; ".join(
        f"{test.channel or 'all'} ({test.name}): {'passed' if test.passed else '**failed**'}"
        for test in study.main.tests
    )
    mo.vstack(
        [
            page.table(
                [
                    "derivative, 1/rad",
                    "rigid",
                    "condensed",
                    "estimate",
                    "sigma",
                    "estimate against rigid",
                    "against condensed, sigmas",
                ],
                _rows,
            ),
            mo.md(
                f"Short period {study.main.derived['natural_frequency'][0]:.3f} rad/s, elastic "
                "modes from "
                f"{lab.marks(controls.value['factor'])[0]:.2f} rad/s. "
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
            "Rigid, condensed, estimated: the picture": page.plotted(
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
            page.choice(["rigid", "condensed"]),
            lambda value: value == lab.nearer(),
            "Compare the third column of numbers with the first two.",
            "A rigid model absorbs whatever follows the loads at once. The rigid "
            "value cannot be measured on this aircraft.",
        ),
        "lost": page.Question(
            "By how many per cent is the estimated static stability (C_mα) smaller "
            "than that of the rigid aircraft?",
            page.number_field("%"),
            lambda value: close(value, lab.numbers()["Cm_alpha lost, %"], 0.05),
            "The column `estimate against rigid`, without its sign.",
            "And the aircraft at half these frequencies has lost most of it: try 0.5.",
        ),
        "worst": page.Question(
            "Which derivative lies the most of its sigmas away from its condensed value?",
            page.choice(["CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"]),
            lambda value: value == lab.worst(),
            "The last column.",
            "The lag of the structure acts like negative damping. The error is 6 % of"
            " the value, but 23 sigmas, since the sigmas do not contain it.",
        ),
        "seen": page.Question(
            "Go from stiff to soft: 4, 3, 2, 1.5, 1. At which of these does a test of the "
            "innovations fail for the first time?",
            page.number_field("factor"),
            lambda value: value == lab.first_seen(),
            "The tests stand under the table.",
            "At 2 the estimates have begun to drift while every test passes: a bias within a few "
            "sigmas hides in the noise.",
        ),
        "noise": page.Question(
            "Back to factor 1. What is the least process noise on the slider with which all tests "
            "pass?",
            page.number_field("(deg/s)²/s"),
            lambda value: value == lab.enough_noise(),
            "Move the second slider step by step.",
            "All tests pass, and C_mq is still three sigmas off: the missing force follows the "
            "elevator. Too much noise fails the tests "
            "again, on the other side.",
        ),
        "mends": page.Question(
            "What has the process noise mended?",
            page.choice(
                [
                    "the model",
                    "the estimates, which are now the rigid aircraft's",
                    "mostly the sigmas, which now admit what the model lacks",
                ]
            ),
            lambda value: value is not None and value.startswith("mostly the sigmas"),
            "Compare the sigma of C_mq without noise and with 0.3, and how far its estimate moved.",
            "To correct the model, add the mode: `flightid run flexible-ac1-first-mode`.",
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

    Move the unit of the 3-2-1-1 so that its spectrum has a gap at the first mode (lab 2 shows spectra), or a peak. What does that do to the bias?
    `flightid run flexibility-sweep` goes
    through fourteen structures at once; `flightid run trace-elastic` lets the tracing loop find the mode.
    """)
    return


if __name__ == "__main__":
    app.run()
