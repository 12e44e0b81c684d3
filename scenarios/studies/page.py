"""The page of a study, repeated flights included, and of a campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.estimate import Outcome
from scenarios.report.document import (
    BY_ROW,
    SIGMAS,
    Block,
    Bullets,
    Column,
    Fold,
    Page,
    Prose,
    Section,
    Table,
    as_sentence,
    capital,
    estimate,
    formatted,
    known,
    now,
    reproduction,
    section,
    summary_sentences,
    table,
)
from scenarios.report.figure_formats import Drawn
from scenarios.report.folder import first_figure
from scenarios.report.quantities import shown_in, test_line
from scenarios.report.summary import levels_line
from scenarios.report.terminal import (
    derived_table,
    estimates_table,
    fixed_table,
    levels_of_noise,
    tests_table,
)
from scenarios.studies.comparison import (
    choice_lines,
    distance_text,
    engine_line,
    other_flight_line,
    reference_lines,
    vehicle_line,
)
from scenarios.studies.declaration import Row
from scenarios.studies.study import (
    MethodResult,
    StudyResult,
    distinct_labels,
    flexibility_sentences,
)
from scenarios.studies.sweep import sweep_blocks
from scenarios.studies.text import (
    determination_blocks,
    repeated_blocks,
    study_summary,
    with_display,
)
from sim.truth.flight import EXACT, INTEGRATION_TOLERANCE, Truth

# ---- The page of a study

SETTLED = (Outcome.CONVERGED, Outcome.AT_BOUND)


def study_page(study: StudyResult, drawn: Sequence[Drawn] = ()) -> Page:
    """Return the page of a study with the figures ``drawn``."""
    scenario, main = study.scenario, study.main
    outcome = main.result.estimate.outcome
    white = all(test.passed for test in main.tests)
    tone = "open" if outcome not in SETTLED else "good" if white else "fair"
    files = [("model", file.name, file.sha256) for file in scenario.files]
    first, others = first_figure(drawn)
    return Page(
        title=capital(scenario.title),
        kind=f"Study {scenario.name}, {main.estimation.label}",
        verdict=outcome.value.partition(":")[0].partition(",")[0],
        tone=tone,
        sentence=capital(within_line(main.rows, "condensed" if scenario.condensed else "true")),
        summary=summary_sentences(study_summary(study)),
        warnings=tuple(as_sentence(line) for line in (main.result.estimate.message,) if line),
        sections=(
            *section("Recorded and estimated", *first),
            *section("Estimates", *_estimates(study, main)),
            *_other_methods(study),
            *section(
                "Repeated flights", *(repeated_blocks(study.repeated) if study.repeated else ())
            ),
            *section(
                "What the record determines",
                *(determination_blocks(study.determinations) if study.determinations else ()),
            ),
            *section(
                "Structures from stiff to soft",
                *(sweep_blocks(study.sweep) if study.sweep is not None else ()),
            ),
            *section("Further figures", *others),
            *section("Residuals and noise", *_residual_blocks(study)),
            *section("How it was made", *_provenance(study)),
        ),
        reproduction=reproduction(
            ("flightid", "run", scenario.name, "--seed", str(study.seed)),
            f"Seed {study.seed}.",
            files,
        ),
        created=now(),
    )


def within_line(rows: Sequence[Row], reference: str) -> str:
    """Return how many estimates are within two sigmas of the reference; empty without one."""
    errors = [abs(row.sigmas) for row in rows if row.sigmas is not None and row.std > 0.0]
    if not errors:
        return ""
    if len(errors) == 1:
        return f"the estimate lies {errors[0]:.1f} of its sigmas from the {reference} value"
    inside = sum(error <= 2.0 for error in errors)
    return (
        f"{inside} of {len(errors)} estimates lie within two of their sigmas of the {reference} "
        f"value; the largest error is {max(errors):.1f} sigmas"
    )


def _estimates(study: StudyResult, method: MethodResult, told: Sequence[str] = ()) -> list[Block]:
    """Return tables and sentences of a method, without sentences that are ``told`` already."""
    label, outcome = method.estimation.label, method.result.estimate.outcome
    blocks: list[Block] = [
        estimates_table(
            f"{capital(label)}: {outcome.value}",
            with_display(study, method.rows),
        )
    ]
    blocks += [derived_table("Derived quantities", method.derived)] if method.derived else []
    sentences = [line for line in _sentences(study, method) if line not in told]
    return [*blocks, *(Prose(as_sentence(line)) for line in sentences)]


def _sentences(study: StudyResult, method: MethodResult) -> list[str]:
    """Return the sentences on the estimates of a method."""
    scenario, estimation = study.scenario, method.estimation
    flown = scenario.flown
    lines = (
        other_flight_line(scenario, estimation),
        levels_line(method.levels, flown, method.tests) if flown is not None else "",
        estimation.explanation,
        *reference_lines(method.rows, estimation),
    )
    return [line for line in lines if line]


def _method(study: StudyResult, method: MethodResult) -> Section:
    told = reference_lines(study.methods[0].rows, study.methods[0].estimation)
    choices = Bullets(tuple(choice_lines(method.estimation.choices)))
    tests = Prose(as_sentence(test_line(method.tests))) if method.tests else None
    blocks = _estimates(study, method, told)
    return section(capital(method.estimation.label), *blocks, tests, choices)[0]


def _other_methods(study: StudyResult) -> tuple[Section, ...]:
    """Return the section of all methods after the main one.

    Methods with the parameters and true values of the main one are side by side in one table, and
    what is to be said of each is folded. Each of the others has a part of its own.
    """
    main = _known_values(study.main)
    alike = [method for method in study.methods if _known_values(method) == main]
    others = [method for method in study.methods[1:] if _known_values(method) != main]
    blocks: list[Block] = []
    if len(alike) > 1:
        blocks += side_by_side(study, alike)
        blocks += [_folded(study, method) for method in alike[1:]]
    parts = tuple(_method(study, method) for method in others)
    return section("Other methods", *blocks, parts=parts)


def _known_values(method: MethodResult) -> list[tuple[str, float | None]]:
    """Return names and true values of the parameters."""
    return [(row.name, row.true) for row in method.rows]


def side_by_side(study: StudyResult, methods: Sequence[MethodResult]) -> list[Block]:
    """Return the estimates of methods with the same parameters: a column for each method, or a row
    where there is a single parameter.
    """
    by_method = {
        capital(label): with_display(study, method.rows)
        for label, method in zip(
            distinct_labels([method.estimation for method in methods]), methods, strict=True
        )
    }
    if len(methods[0].rows) == 1:
        rows = [replace(shown[0], name=label) for label, shown in by_method.items()]
        single = estimates_table(f"{methods[0].rows[0].name} by all methods", rows)
        return [replace(single, columns=(Column("method"), *single.columns[1:]))]
    first = next(iter(by_method.values()))
    units = [shown_in(row.unit, row.name) for row in first]
    names = Column("parameter"), [row.name for row in first]
    true = [
        known(None if row.true is None else unit.factor * row.true)
        for row, unit in zip(first, units, strict=True)
    ]
    has_true = any(row.true is not None for row in first)
    blocks: list[Block] = [
        table(
            "Estimates of all methods",
            names,
            (Column("true", BY_ROW), true) if has_true else None,
            *(
                (
                    Column(label, BY_ROW),
                    [
                        estimate(unit.factor * row.estimate, unit.factor * row.std)
                        for row, unit in zip(rows, units, strict=True)
                    ],
                )
                for label, rows in by_method.items()
            ),
            *(
                (
                    Column(f"published for {label}", BY_ROW),
                    [
                        estimate(unit.factor * row.published.value, unit.factor * row.published.std)
                        if row.published
                        else ""
                        for row, unit in zip(rows, units, strict=True)
                    ],
                )
                for label, rows in by_method.items()
                if [row.published for row in rows] != [row.published for row in first]
                and any(row.published for row in rows)
            ),
            units=[unit.unit for unit in units],
        )
    ]
    if has_true:
        blocks.append(
            table(
                "Errors of all methods, in sigmas of each",
                names,
                *(
                    (
                        Column(label, SIGMAS),
                        [formatted(row.sigmas if row.std > 0 else None, "+.2f") for row in rows],
                    )
                    for label, rows in by_method.items()
                ),
            )
        )
    return [*blocks, *_derived_side_by_side(methods, list(by_method))]


def _derived_side_by_side(methods: Sequence[MethodResult], labels: Sequence[str]) -> list[Block]:
    """Return the table of derived quantities with a column for each method; none where the methods
    have different ones.
    """
    derived = [
        derived_table("Derived quantities of all methods", method.derived) for method in methods
    ]
    names = [[row[0] for row in each.rows] for each in derived]
    if not names[0] or any(each != names[0] for each in names):
        return []
    columns = (derived[0].columns[0], *(Column(label, BY_ROW) for label in labels))
    rows = tuple(
        (of_all[0][0], *(row[1] for row in of_all))
        for of_all in zip(*(each.rows for each in derived), strict=True)
    )
    return [Table(derived[0].caption, columns, rows, derived[0].units)]


def _folded(study: StudyResult, method: MethodResult) -> Fold:
    """Return the sentences of a method, folded below its name."""
    told = reference_lines(study.methods[0].rows, study.methods[0].estimation)
    sentences = [
        method.result.estimate.outcome.value,
        *(line for line in _sentences(study, method) if line not in told),
        test_line(method.tests) if method.tests else "",
        *choice_lines(method.estimation.choices),
    ]
    items = tuple(as_sentence(capital(line)) for line in sentences if line)
    return Fold(capital(method.estimation.label), items)


def _residual_blocks(study: StudyResult) -> list[Block]:
    """Return tables of residual tests and noise levels, of all methods together."""
    if len(study.methods) > 1:
        return _residuals_of_all(study)
    blocks: list[Block] = []
    for method in study.methods:
        estimate, record = method.result.estimate, method.result.record
        units = {channel.name: channel.unit for channel in record.outputs}
        noise = {
            name: (float(std), units.get(name, "1"))
            for name, std in zip(estimate.output_names, estimate.noise_std, strict=True)
        }
        blocks += [tests_table("Residual tests", method.tests)] if method.tests else []
        blocks += [levels_of_noise("Sensor noise", noise)]
    return blocks


def _residuals_of_all(study: StudyResult) -> list[Block]:
    """Return one table of the residual tests and one of the noise levels of several methods."""
    tests, noise = list[Table](), list[Table]()
    for method in study.methods:
        result = method.result
        units = {channel.name: channel.unit for channel in result.record.outputs}
        levels = {
            name: (float(std), units.get(name, "1"))
            for name, std in zip(
                result.estimate.output_names, result.estimate.noise_std, strict=True
            )
        }
        tests.append(tests_table("Residual tests", method.tests))
        noise.append(levels_of_noise("Sensor noise", levels))
    blocks = [_with_methods(study, tests)]
    equal = all(each == noise[0] for each in noise)
    blocks.append(noise[0] if equal else _with_methods(study, noise))
    return [block for block in blocks if block.rows]


def _with_methods(study: StudyResult, tables: Sequence[Table]) -> Table:
    """Return the tables of all methods as one, with a column of the method: the first, or the last
    where a unit follows the first.
    """
    labels = [
        capital(label) for label in distinct_labels([method.estimation for method in study.methods])
    ]
    units = tuple(unit for each in tables for unit in each.units)
    labelled = [
        (label, row) for label, each in zip(labels, tables, strict=True) for row in each.rows
    ]
    columns, method = tables[0].columns, Column("method")
    if units:
        rows = tuple((*row, label) for label, row in labelled)
        return Table(tables[0].caption, (*columns, method), rows, units)
    rows = tuple((label, *row) for label, row in labelled)
    return Table(tables[0].caption, (method, *columns), rows)


def _integration_sentence(truth: Truth) -> str:
    if truth.step is not None:
        return f"The motion is integrated in steps of {truth.step:g} s."
    if truth.method == EXACT:
        return "The motion is the exact solution of the linear equations of the aircraft."
    error = f"a relative error of {INTEGRATION_TOLERANCE:g}"
    return f"The motion is integrated by {truth.method} to {error}."


def _provenance(study: StudyResult) -> list[Block]:
    """Return sentences on flight, model, engine, choices and vehicle, and a table of constants."""
    scenario, record = study.scenario, study.record
    vehicle = vehicle_line(scenario.flight)
    blocks: list[Block] = [Prose(as_sentence(scenario.about))] if scenario.about else []
    flight = (
        f"Flight and model: {distance_text(scenario.distance)}. {len(record)} samples in "
        f"{record.time[-1]:g} s."
    )
    blocks += [Prose(f"{flight} {_integration_sentence(study.truth)}")]
    if line := engine_line([method.estimation for method in study.methods]):
        blocks += [Prose(as_sentence(line))]
    if study.flexibility is not None:
        blocks += [
            Prose(as_sentence(line))
            for line in flexibility_sentences(study.flexibility, scenario.flight.noise_std)
        ]
    blocks += [Prose(as_sentence(note)) for note in study.notes]
    if scenario.choices:
        blocks += [
            Prose("Chosen for this study, not published or published otherwise:"),
            Bullets(tuple(choice_lines(scenario.choices))),
        ]
    blocks += [Prose(as_sentence(vehicle))] if vehicle else []
    blocks += [fixed_table("Constants", study.main.fixed)] if study.main.fixed else []
    return blocks
