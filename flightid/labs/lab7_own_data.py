import marimo

__generated_with = "0.20.0"
app = marimo.App(width="medium", app_title="Lab 7: bring your own data")


@app.cell
def _():
    from functools import partial

    import marimo as mo

    from flightid.labs import page
    from flightid.labs.workings import own_data as lab

    return lab, mo, page, partial


@app.cell
def _(page):
    page.heading(
        7,
        "Bring your own data",
        """To go the whole way with a record of your own: say what its columns are, look at the sensors before any model, identify, ask what the model
        lacks, and take a report home.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    **Order matters.** A model can be blamed for a sensor's fault, never the other way round if the sensors are looked at first.

    *1. Kinematics before aerodynamics.* Angle of attack, pitch rate and load factor are tied to each other whatever the aerodynamics are; about trim,

    $$ \dot\alpha = q - \frac{g_0}{V}\,(n_z - n_{z0}) , \qquad \alpha_{\text{vane}} = \lambda\,\alpha - \frac{x_v}{V}\, q + b_\alpha . $$

    Integrate the measured rates and load factor and compare the result with the measured angle: a difference shows a bias, a scale error, a delay or a vane away from the centre of
    gravity. This is the **data compatibility check**.

    *2. Identification* fits the derivatives by output error (lab 2), with a bias for each output. Its sigmas are honest only if its residual is white
    (lab 6).

    *3. Diagnosis* (lab 5) tries what the model may lack and judges by a record, or a part of one, that was not fitted.

    **What you need.** A record: a table (CSV, Excel, MATLAB, HDF5, ...) or the log of a flight computer (ArduPilot, PX4). It has the time, an input
    that moves (`elevator`; `stick`; `aileron` and `rudder`), and at least one output (`alpha`, `q`, `nz`). Units are given in the header, `alpha [deg]`, in
    the log itself, or in a channel map. The map also says which column is which channel, and converts, for example, the servo pulses of a log to the
    elevator angle. A vehicle file has mass, geometry, flight condition and starting values that may be 30 % wrong. Signs: nose up is positive; the
    elevator is positive trailing edge down.
    """)
    return


@app.cell
def _(lab, mo):
    source = mo.ui.radio(list(lab.SOURCES), value=lab.TABLE, label="Which records?", inline=True)
    uploads = mo.ui.file(
        filetypes=lab.SUFFIXES,
        multiple=True,
        kind="area",
        label="Records, one file a maneuver; drop them here",
    )
    model = mo.ui.dropdown(list(lab.VEHICLES), value="rigid", label="model")
    return model, source, uploads


@app.cell
def _(lab, mo, model, source):
    vehicle = mo.ui.text_area(
        value=lab.vehicle_text(model.value, source.value),
        rows=16,
        full_width=True,
        label="vehicle file (TOML): put your numbers in",
    )
    channels = mo.ui.text_area(
        value=lab.map_of(source.value),
        rows=6,
        full_width=True,
        label="channel map (TOML), where your headers are not ours; may be empty",
    )
    return channels, vehicle


@app.cell
def _(channels, lab, mo, model, source, uploads, vehicle):
    _told = {
        lab.TABLE: "Two records, exported as flight-test systems do:",
        lab.LOG: "Two flights of a small flying wing with a vane, as ArduPilot logs them (DataFlash):",
    }
    mo.vstack(
        [
            mo.md("## 1. Your files"),
            source,
            uploads
            if source.value == lab.OWN
            else mo.hstack(
                [
                    mo.md(_told[source.value]),
                    *(
                        mo.download(content, filename=name, label=name)
                        for name, content in lab.files_of(source.value)
                    ),
                ],
                justify="start",
                wrap=True,
            ),
            model,
            vehicle,
            channels,
        ]
    )
    return


@app.cell
def _(channels, lab, mo, page, source, uploads, vehicle):
    _files = (
        tuple((each.name, each.contents) for each in uploads.value)
        if source.value == lab.OWN
        else lab.files_of(source.value)
    )
    mo.stop(not _files, mo.callout(mo.md("No file yet."), kind="neutral"))
    given, _refused = lab.tried(lambda: lab.kept(_files, vehicle.value, channels.value))
    _records, _error = lab.tried(lambda: lab.read(given)) if given else (None, _refused)
    mo.stop(bool(_error), mo.callout(mo.md(f"**Refused.** {page.plain(_error)}"), kind="danger"))
    mo.vstack(
        [
            mo.md("## 2. What was read"),
            page.table(
                ["record", "channel", "unit", "samples", "least", "greatest"],
                lab.channel_rows(_records),
            ),
            mo.md(
                "Columns that no channel needs are not read. If a channel is missing here, its column has "
                "another name: put that into the map."
            ),
        ]
    )
    return (given,)


@app.cell
def _(given, lab, mo, page):
    _check, _error = lab.tried(lambda: lab.checked(given))
    mo.vstack(
        [
            mo.md("## 3. The sensors, before any model"),
            mo.callout(mo.md(f"**Refused.** {page.plain(_error)}"), kind="danger")
            if _check is None
            else mo.md(
                "\n".join(f"- {page.plain(line)}" for line in (*_check.sentences, *_check.warnings))
                or "The kinematics find nothing to say."
            ),
            page.plotted(
                _check.plot.reconstruction(),
                "measured channels against those that the kinematics reconstruct",
            )
            if _check is not None and _check.details.result.reconstructions
            else mo.md(""),
            page.command_line(
                "flightid check "
                + " ".join(path.name for path in given.records)
                + " --vehicle vehicle.toml"
                + (" --channels map.toml" if given.channels else "")
            ),
        ]
    )
    return


@app.cell
def _(given, lab, mo, model, page):
    _found, _error = lab.tried(lambda: lab.identified(given, model.value))
    if _found is None:
        _shown = [mo.callout(mo.md(f"**Refused.** {page.plain(_error)}"), kind="danger")]
    else:
        _shown = [
            page.table(
                ["parameter", "unit", "estimate", "sigma", "started at"],
                [
                    [
                        p.name,
                        p.unit,
                        f"{p.value:.4g}",
                        f"{p.sigma:.2g}",
                        "" if p.start is None else f"{p.start:.4g}",
                    ]
                    for p in _found.parameters.values()
                ],
            ),
            mo.md(
                f"Outcome: {_found.outcome}."
                + "".join(f"\n- {page.plain(line)}" for line in (*_found.warnings, *_found.notes))
            ),
            page.plotted(_found.plot.fit(), "measured and fitted outputs with what is left"),
        ]
    mo.vstack(
        [
            mo.md("## 4. Identification"),
            *_shown,
            page.command_line(
                "flightid identify "
                + " ".join(path.name for path in given.records)
                + f" --model {model.value} --vehicle vehicle.toml"
                + (" --channels map.toml" if given.channels else "")
            ),
        ]
    )
    return


@app.cell
def _(given, mo):
    # Other files are another question: it is asked again.
    _ = given
    ask = mo.ui.run_button(label="What does the model lack?", kind="success")
    mo.vstack(
        [
            mo.md("## 5. Diagnosis"),
            mo.md(
                "The loop tries every effect that it knows. A short record takes some seconds, "
                "several long ones take minutes."
            ),
            ask,
        ]
    )
    return (ask,)


@app.cell
def _(ask, given, lab, mo, model, page, partial):
    mo.stop(not ask.value)
    with mo.status.spinner(title="Tracing what the residual comes from"):
        _found, _error = lab.tried(lambda: lab.diagnosed(given, model.value))
    mo.stop(_found is None, mo.callout(mo.md(f"**Refused.** {page.plain(_error)}"), kind="danger"))
    _effects = [
        f"- **{page.plain(effect.name)}**: {page.plain(effect.sentence)}"
        for effect in _found.effects
    ]
    mo.vstack(
        [
            mo.callout(
                mo.md(
                    f"**{_found.verdict.upper()}.** {page.plain(_found.headline)}\n\n"
                    + "\n".join(_effects)
                ),
                kind="info",
            ),
            page.plotted(
                _found.plot.prediction(),
                "what was held out: measured and predicted, before and after",
            ),
            page.plotted(_found.plot.derivatives(), "parameters before and after"),
            mo.md("\n".join(f"- {page.plain(line)}" for line in (*_found.warnings, *_found.notes))),
            mo.download(
                partial(lab.report, _found),
                filename="report.html",
                mimetype="text/html",
                label="Download the report",
            ),
            page.command_line(
                "flightid diagnose "
                + " ".join(path.name for path in given.records)
                + f" --model {model.value} --vehicle vehicle.toml"
                + (" --channels map.toml" if given.channels else "")
                + " --out study"
            ),
        ]
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Questions

    1. The table: does the kinematic check alone already name the fault? In which sentence?
    2. The table: by how many of its sigmas does each derivative move when the fault is taken into account (the last figure)? Which sigma was honest
       before?
    3. The table: set the unit of `alpha` in the map to `rad`. Which step notices, and in which words? What would have happened without that check?
    4. The log of ArduPilot: the kinematic check finds nothing, and yet the identification warns. Which derivatives have the wrong sign, and what does the
       diagnosis find? Why can the kinematics not see it?
    5. Your own record: is the residual white? If not, which of labs 3 to 6 does it remind you of?
    6. Which maneuver would you fly next, and which sensor would you add, to decide what your record left open?
    """)
    return


if __name__ == "__main__":
    app.run()
