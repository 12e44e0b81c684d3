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
        """To analyse a record of your own from the file to the report: name its columns, check the sensors before any model is fitted, identify the
        derivatives, and find out what the model lacks.""",
    )
    return


@app.cell
def _(mo):
    mo.md(r"""
    ## Theory

    **Check the sensors first.** The fit of a model mixes errors of the model with errors of the sensors. A check by kinematics needs no aerodynamic model, and so it finds an error of a sensor by itself.

    *1. Check of the sensors by kinematics.* Angle of attack $\alpha$, pitch rate $q$ and load factor $n_z$ depend on each other, whatever the aerodynamics are. For small deviations from trim,

    $$ \dot\alpha = q - \frac{g_0}{V}\,(n_z - n_{z0}) , $$

    $$ \alpha_m = (1 + k_\alpha)\,\alpha - \frac{d}{V}\, q + b_\alpha , $$

    with the true airspeed $V$, the standard gravity $g_0$ (9.81 m/s²), and the load factor $n_{z0}$ in trim: 1, or 0 if the sensor records changes from trim. $\alpha_m$ is what the vane
    measures: it has a scale error $k_\alpha$ and a bias $b_\alpha$, and it sits the arm $d$ ahead of the centre of gravity. The check
    integrates the measured $q$ and $n_z$ and compares the result with $\alpha_m$. A difference shows a bias, a scale error, a delay or an arm. The check adds each possible fault to these equations; it reports the fault that raises the log likelihood of the record most, if the rise is larger than chance explains. Such a comparison is called **data compatibility check**.

    *2. Identification* estimates the derivatives by output error, with a bias for each output: it minimises the squared difference between measured and simulated outputs, weighted by the sensor noise. Its sigmas are honest only if its residual is white
    (lab 6).

    *3. Diagnosis* (lab 5) searches for an effect that the model lacks. It tests each on a record, or on a part of one, that was not fitted.

    **What you need.** A record is a table (CSV, Excel, MATLAB, HDF5, ...) or the log of a flight computer (ArduPilot, PX4). It has the time, an input
    that moves (`elevator`; `stick`; `aileron` and `rudder`), and at least one output (`alpha`, `q`, `nz`). The units stand in the header (`alpha [deg]`), in
    the log itself, or in a channel map. The **channel map** names the column of each channel. It also converts, for example, the servo pulses of a log to the
    elevator angle. The **vehicle file** has mass, geometry, flight condition and starting values of the derivatives, which may be 30 % wrong. Signs: $\alpha$, $q$ and $n_z$ are positive nose up; the
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
        label="Records, one file for each maneuver: drop them here",
    )
    model = mo.ui.dropdown(list(lab.VEHICLES), value="rigid", label="model")
    return model, source, uploads


@app.cell
def _(lab, mo, model, source):
    vehicle = mo.ui.text_area(
        value=lab.vehicle_text(model.value, source.value),
        rows=16,
        full_width=True,
        label="vehicle.toml, the vehicle file: put in your numbers",
    )
    channels = mo.ui.text_area(
        value=lab.map_of(source.value),
        rows=6,
        full_width=True,
        label="map.toml, the channel map: empty if your columns have the names of the channels",
    )
    return channels, vehicle


@app.cell
def _(channels, lab, mo, model, source, uploads, vehicle):
    _told = {
        lab.TABLE: "Two records as a flight-test system may export them:",
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
def _(channels, mo, vehicle):
    mo.hstack(
        [
            mo.md("For the commands below, save the two texts beside your records:"),
            mo.download(vehicle.value.encode(), filename="vehicle.toml", label="vehicle.toml"),
            *(
                [mo.download(channels.value.encode(), filename="map.toml", label="map.toml")]
                if channels.value.strip()
                else []
            ),
        ],
        justify="start",
        wrap=True,
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
    mo.stop(bool(_error), mo.callout(mo.md(f"**Refused.** {page.escaped(_error)}"), kind="danger"))
    mo.vstack(
        [
            mo.md("## 2. What was read"),
            page.table(
                ["record", "channel", "unit", "samples", "smallest", "largest"],
                lab.channel_rows(_records),
            ),
            mo.md(
                "If a channel is missing here, its column has another name: put that name into the "
                "channel map. Columns that belong to no channel are not read."
            ),
        ]
    )
    return (given,)


@app.cell
def _(given, lab, mo, page):
    _check, _error = lab.tried(lambda: lab.checked(given))
    mo.vstack(
        [
            mo.md("## 3. Check of the sensors"),
            mo.callout(mo.md(f"**Refused.** {page.escaped(_error)}"), kind="danger")
            if _check is None
            else mo.md(
                "\n".join(f"- {page.escaped(line)}" for line in lab.check_remarks(_check))
                or "The check by kinematics has no result for these channels."
            ),
            page.interactive_figure(
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
        _shown = [mo.callout(mo.md(f"**Refused.** {page.escaped(_error)}"), kind="danger")]
    else:
        _shown = [
            page.table(
                ["parameter", "unit", "estimate", "sigma", "starting value"],
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
                + "".join(f"\n- {page.escaped(line)}" for line in lab.fit_remarks(_found))
            ),
            page.interactive_figure(
                _found.plot.fit(), "measured and fitted outputs with the residual"
            ),
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
                "The tracing loop tries every effect of its library (lab 5). A short record takes some "
                "seconds, several long ones take minutes."
            ),
            ask,
        ]
    )
    return (ask,)


@app.cell
def _(ask, given, lab, mo, model, page, partial):
    mo.stop(not ask.value)
    with mo.status.spinner(title="Searching for the cause of the residual"):
        _found, _error = lab.tried(lambda: lab.diagnosed(given, model.value))
    mo.stop(
        _found is None, mo.callout(mo.md(f"**Refused.** {page.escaped(_error)}"), kind="danger")
    )
    _effects = [
        f"- **{page.escaped(effect.name)}**: {page.escaped(effect.sentence)}"
        for effect in _found.effects
    ]
    mo.vstack(
        [
            mo.callout(
                mo.md(
                    f"**{_found.verdict.upper()}.** {page.escaped(_found.headline)}\n\n"
                    + "\n".join(_effects)
                ),
                kind="info",
            ),
            page.interactive_figure(
                _found.plot.prediction(),
                "record that was not fitted: measured and predicted, before and after",
            ),
            page.interactive_figure(_found.plot.derivatives(), "parameters before and after"),
            mo.md("\n".join(f"- {page.escaped(line)}" for line in lab.diagnosis_remarks(_found))),
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

    1. The table: does the check of the sensors alone find the fault? In which sentence? Another fault fits the data equally well: why is it improbable?
    2. The table: run the diagnosis. By how many of the sigmas before does each derivative change when the fault is part of the model (the numbers beside the last figure of section 5)? Which sigmas become smaller, and why?
    3. The table: set the unit of `alpha` in the channel map to `rad`. Which step refuses the record, and with which reason? Without that check, which derivatives does the fit find?
    4. The log of ArduPilot: the check of the sensors finds no fault, but the identification warns. Which derivatives differ in sign from their starting values? What does the
       diagnosis find? Why can the check of the sensors not find it?
    5. Your own record: is the residual white? If not, which of labs 3 to 6 shows a similar residual?
    6. Which maneuver would you fly next, and which sensor would you add, to decide what your record leaves open?
    """)
    return


if __name__ == "__main__":
    app.run()
