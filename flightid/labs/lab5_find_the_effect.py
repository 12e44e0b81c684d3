import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 5: find the effect")


@app.cell
def _():
    import marimo as mo
    import numpy as np

    from flightid.labs import page
    from flightid.labs.figures import figure_residual
    from flightid.labs.workings import hidden_effect as lab
    from scenarios.plots.signals import figure_record

    return figure_record, figure_residual, lab, mo, np, page


@app.cell
def _(page):
    page.heading(
        5,
        "Find the effect",
        """To read a residual. An effect that the rigid model does not contain acts on this
        flight, or none does. First you guess which it is, then the program shows its
        evidence, and last you see the truth.""",
    )
    return


@app.cell
def _(page):
    page.aircraft_sketch()
    return


@app.cell
def _(lab, mo, page):
    _rows = [[words, suspect.shows] for words, suspect in lab.SUSPECTS.items()]
    mo.vstack(
        [
            mo.md(r"""
    ## Theory

    If a model that lacks an effect is fitted by output error, its residual $v = z - \hat y$ is the noise plus the part of the missing response that the parameters cannot
    imitate:

    $$ v \;\approx\; e + \big(I - S (S^T R^{-1} S)^{-1} S^T R^{-1}\big)\, d , $$

    where $d$ is the response of the outputs to the missing effect, $S$ the sensitivities of the outputs to the fitted parameters, $R$ the covariance of the sensor noise and $e$ the noise. Part of $d$
    is absorbed by the derivatives, which are now **biased**;
    the rest remains in the residual and has a *signature*: in which channel, when, at which frequency, with which maneuver.

    **How to read it.** In which channels is it larger than the noise? Does it follow a step of the elevator? Does it return, decay or grow? Does it have a single frequency?

    **What the tracing loop does.** This is the search behind `flightid diagnose`. For each effect of its library it computes how much of the residual the signature would explain (a *score*, one linear step). It then fits
    all parameters of the best effects together with the derivatives, and predicts a **second record that was not fitted**.
    It names an effect if noise alone rarely gives such a gain in likelihood, and if the
    prediction improves. If two effects explain the data equally well, it says so.
    """),
            mo.accordion(
                {
                    "Signatures: how each suspect shows": page.table(
                        ["suspect", "its signature"], _rows
                    )
                }
            ),
        ]
    )
    return


@app.cell
def _(lab, mo):
    seed = mo.ui.number(
        1, 9999, step=1, value=lab.FIRST_SEED, label="seed: each hides another effect"
    )
    get_locked, set_locked = mo.state(None)
    get_rounds, set_rounds = mo.state(())
    return get_locked, get_rounds, seed, set_locked, set_rounds


@app.cell
def _(figure_record, lab, mo, page, seed):
    flown = lab.flown(seed.value)
    mo.vstack(
        [
            mo.md("## 1. The record"),
            seed,
            page.interactive_figure(
                figure_record(flown.train),
                "elevator, angle of attack, pitch rate and load factor over time",
            ),
        ]
    )
    return (flown,)


@app.cell
def _(figure_residual, flown, lab, mo, np, page, seed):
    with page.progress_message():
        _found = lab.fitted(seed.value)
    _residuals = lab.residuals(seed.value)
    _rows = [
        [
            name,
            f"{np.sqrt(np.mean(values**2)) / flown.noise[name]:.2f}",
            f"{np.corrcoef(values[1:], values[:-1])[0, 1]:+.2f}",
        ]
        for name, values in _residuals.items()
    ]
    mo.vstack(
        [
            mo.md("## 2. The residual of the rigid model"),
            page.interactive_figure(
                figure_residual(
                    flown.train.time,
                    _residuals,
                    {channel.name: channel.unit for channel in flown.train.outputs},
                    flown.noise,
                ),
                "residuals of angle of attack, pitch rate and load factor over time, their power "
                "spectra and autocorrelations",
            ),
            page.table(
                ["channel", "rms residual / noise", "correlation with the sample before"], _rows
            ),
            mo.accordion(
                {
                    "The fit itself": page.interactive_figure(
                        _found.plot.fit(), "measured and fitted outputs"
                    ),
                    "Another record, predicted": page.interactive_figure(
                        _found.plot.held_out(),
                        "a record that was not fitted, measured and predicted",
                    ),
                }
            ),
        ]
    )
    return


@app.cell
def _(lab, mo, seed):
    # A new seed is a new case: the guess is empty again.
    _ = seed.value
    guess = mo.ui.radio(list(lab.SUSPECTS), value=None, label="What acts here?")
    sure = mo.ui.slider(
        0, 100, step=10, value=50, label="probability that your guess is right, %", show_value=True
    )
    return guess, sure


@app.cell
def _(guess, mo, seed, set_locked, sure):
    show = mo.ui.button(
        label="This is my guess. Show what the loop finds",
        kind="success",
        disabled=guess.value is None,
        on_click=lambda _: set_locked((seed.value, guess.value, sure.value)),
    )
    mo.vstack(
        [
            mo.md("## 3. Your guess"),
            guess,
            sure,
            show,
            mo.md(
                "*Choose an effect first; then the button works.*" if guess.value is None else ""
            ),
        ]
    )
    return


@app.cell
def _(flown, get_locked, lab, mo, page, seed):
    _locked = get_locked()
    mo.stop(_locked is None or _locked[0] != seed.value)
    with mo.status.spinner(
        title="The loop tries every effect of its library: some seconds, for some seeds half a minute"
    ):
        found = lab.diagnosed(seed.value)
    guessed, sureness = _locked[1:]
    _errors = [
        [
            name,
            f"{found.error_before[name] / found.noise_floor[name]:.2f}",
            f"{found.error_after[name] / found.noise_floor[name]:.2f}",
        ]
        for name in found.error_before
    ]
    _effects = [
        f"- **{page.escaped(effect.name)}**: {page.escaped(effect.sentence)}"
        + (
            f" ({page.escaped(' or '.join(effect.alternatives))} fits these data equally well)"
            if effect.alternatives
            else ""
        )
        for effect in found.effects
    ]
    mo.vstack(
        [
            mo.md(
                f"## 4. What the loop says\n\nYour guess: **{guessed}**, right with a probability "
                f"of {sureness} %."
            ),
            mo.callout(
                mo.md(
                    f"**{found.verdict.upper()}.** {page.escaped(found.headline)}\n\n"
                    + "\n".join(_effects)
                ),
                kind="info",
            ),
            mo.md(
                "The figure shows the odds of each candidate against the model of the round. They "
                "contain the gain in likelihood and the prior: what is known before the flight, "
                "such as where sensors usually sit and which derivatives the vehicle file has. So "
                "an effect that fits equally well can have much smaller odds."
            ),
            page.interactive_figure(
                found.plot.evidence(), "posterior odds of the candidates of each round"
            ),
            page.interactive_figure(found.plot.residuals(), "residuals before and after"),
            mo.md(
                "Prediction error on the second record, which was **not** fitted, in units of the "
                "sensor noise:"
            ),
            page.table(["channel", "rigid model", "with the effects found"], _errors),
            page.command_line(
                "flightid diagnose train.csv --model rigid --vehicle vehicle.toml --validate "
                "validate.csv --out study"
            ),
            mo.hstack(
                [
                    mo.download(flown.path(name).read_bytes(), filename=name, label=name)
                    for name in ("train.csv", "validate.csv", "vehicle.toml")
                ],
                justify="start",
                wrap=True,
            ),
        ]
    )
    return found, guessed, sureness


@app.cell
def _(found, mo):
    _ = found
    envelope = mo.ui.button(
        value=0, on_click=lambda presses: presses + 1, label="Show the truth", kind="warn"
    )
    mo.vstack([mo.md("## 5. The truth"), envelope])
    return (envelope,)


@app.cell
def _(envelope, found, guessed, lab, mo, page, seed, set_rounds, sureness):
    mo.stop(not envelope.value)
    _words, _values = lab.drawn(seed.value)
    # One round a seed: who opens it again has seen it.
    _round = (seed.value, guessed, sureness, guessed == _words, lab.found_by_loop(seed.value))
    set_rounds(
        lambda rounds, new=_round: (
            rounds if any(each[0] == new[0] for each in rounds) else (*rounds, new)
        )
    )
    _claimed = {effect.name: effect for effect in found.effects}.get(lab.SUSPECTS[_words].name)
    _rows = [
        [
            name,
            f"{value:.4g}",
            f"{_claimed[name].value:.4g} ± {_claimed[name].sigma:.2g}"
            if _claimed is not None and name in _claimed.parameters
            else "–",
        ]
        for name, value in _values.items()
    ]
    mo.vstack(
        [
            mo.callout(
                mo.md(
                    f"The hidden effect: **{_words}**. Your guess was "
                    f"**{'right' if guessed == _words else 'wrong'}**, "
                    "that of the loop was "
                    f"{'right' if lab.found_by_loop(seed.value) else 'wrong'}."
                ),
                kind="success" if guessed == _words else "danger",
            ),
            page.table(["value, SI", "true", "found by the loop"], _rows) if _rows else mo.md(""),
            mo.md(
                f"Its signature: {lab.SUSPECTS[_words].shows}. Do you see it in the figure of part 2?"
            ),
        ]
    )
    return


@app.cell
def _(get_rounds, mo, page):
    _rounds = get_rounds()
    mo.stop(not _rounds)
    _rows = [
        [
            str(each[0]),
            each[1],
            f"{each[2]} %",
            "yes" if each[3] else "no",
            "yes" if each[4] else "no",
        ]
        for each in _rounds
    ]
    _brier = sum((each[2] / 100 - each[3]) ** 2 for each in _rounds) / len(_rounds)
    mo.vstack(
        [
            mo.md("### Your rounds"),
            page.table(
                ["seed", "your guess", "your probability", "you were right", "the loop was right"],
                _rows,
            ),
            mo.md(
                f"Brier score of your guesses: **{_brier:.2f}**. It is the mean over your rounds of "
                "(probability − outcome)², where the outcome is 1 if your guess was right and 0 if "
                "it was wrong. The best score is 0: always 100 %, always right. The worst is 1: "
                "always 100 %, always wrong. A player who always says 50 % gets 0.25."
            ),
        ]
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Questions

    1. Seed 1: which channel has the largest residual in units of its noise, and which *measured* signal does it resemble? What position of a sensor has this effect?
    2. Seed 1: the loop names another effect that fits the data equally well. Why can these data not distinguish the two? By which prior knowledge does the loop prefer
    one of them, and which further channel or maneuver could decide?
    3. Why does the error on the *second* record show more than the error on the first?
    4. Which of the suspects biases the derivatives most and leaves the smallest residual?
    5. Play five seeds. Is your Brier score below 0.25? Compare the mean of your probabilities with the share of your guesses that were right: were you too sure? What
    will you look at first in the next round?
    """)
    return


if __name__ == "__main__":
    app.run()
