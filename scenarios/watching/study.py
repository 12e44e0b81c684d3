"""Results of a watch: estimates, history, comparison, page, and the values shown on line."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from scipy.special import ndtr

from ident.banks.delays import likelihood_weights
from ident.banks.online import (
    MEDIAN_SQUARE,
    BankState,
    OnlineBank,
    changed_starts,
    spread_covariance,
)
from ident.banks.relinearised import joint_estimate
from ident.estimate import Estimate, Outcome
from scenarios.files.sources import InputFile, resolved, versions
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.identification.assessment import IdentificationResult
from scenarios.identification.low_order import derived_of, mean_delay
from scenarios.report.document import (
    Block,
    Page,
    Section,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.folder import CONTENT, write_page
from scenarios.report.summary import PAGE
from scenarios.report.terminal import derived_table, estimates_table, fixed_table
from scenarios.studies.comparison import DERIVED_UNITS, SCHEMA, estimate_content
from scenarios.studies.declaration import Row, rows_of
from scenarios.watching.reference import (
    CrossValidation,
    Reference,
    against,
    delay_tables,
    differences_table,
    reference_content,
    rows_and_vehicle,
    usual_command,
)
from scenarios.watching.rows import OUTPUTS
from scenarios.watching.session import STARTED, Session, WatchStep, history_section
from scenarios.watching.spectral import METHOD, history_csv, last_estimate, spectral_content
from sim.errors import DeclarationError, FlightidError
from sim.record import Record

# ---- Results of a stream so far


@dataclass(frozen=True, eq=False)
class SoFar:
    """Estimate of a stream so far.

    Attributes
    ----------
    estimate : estimate of the parameters.
    derived : value and standard deviation of derived quantities.
    weights : weight of each delay of the bank, shape ``(B,)``. For a refined estimate it is the
        probability that this delay is the nearest one, else the likelihood of its filter.
    refined : whether the estimate is that of the relinearised bank, whose delay may be between
        those of the bank; else it is that of the most likely filter.
    hanging : quantities that depend on the start: filters with other starts end as far apart as
        they began. Empty for a refined estimate.
    """

    estimate: Estimate
    derived: Mapping[str, tuple[float, float]]
    weights: np.ndarray
    refined: bool
    hanging: frozenset[str] = frozenset()


def so_far(session: Session, step: WatchStep | None = None) -> SoFar:
    """Return the estimate after a step; None: the last step. A refined estimate has precedence."""
    step = session.last if step is None else step
    assert session.bank is not None and step is not None
    if step.refined is None:
        return first_pass_so_far(session, step)
    estimate = joint_estimate(step.refined)
    weights = nearest(session.bank.delays, estimate.value("delay"), estimate.sigma("delay"))
    return SoFar(estimate, derived_of(estimate, session.vehicle, (0.0, 0.0)), weights, True)


def nearest(delays: np.ndarray, value: float, std: float) -> np.ndarray:
    """Return the probability that each of the increasing ``delays`` is the nearest to the true one.

    The true delay is normal about ``value`` with ``std``, s. Delays and result have shape ``(B,)``.
    """
    between = 0.5 * (delays[1:] + delays[:-1])
    below = ndtr((between - value) / max(std, 1e-9))
    return np.diff(np.concatenate([[0.0], below, [1.0]]))


def first_pass_so_far(session: Session, step: WatchStep | None = None) -> SoFar:
    """Return the estimate of the most likely filter after a step; None: the last step.

    Its sigmas include the differences between filters with other starts.
    """
    bank, step = session.bank, session.last if step is None else step
    assert bank is not None and step is not None
    estimate, weights, (delay, std) = likely_estimate(bank, step.state)
    n_x = len(bank.system.states)
    spread, differences = step.spread[n_x:], step.differences[:, n_x:]
    derived = derived_of(estimate, session.vehicle, (delay, std))
    end_spread = _derived_spread(session, estimate, derived, differences)
    declared = replace(estimate, values=bank.start[n_x:])
    of_declared = derived_of(declared, session.vehicle, (0.0, 0.0))
    moved = (changed_starts(bank, STARTED) - bank.start[:, None]).T[:, n_x:]
    start_spread = _derived_spread(session, declared, of_declared, moved)
    prior = np.sqrt(np.diagonal(bank.covariance))[n_x:]
    wide = (spread >= prior).tolist()
    start_dependent = {name for name, is_wide in zip(estimate.names, wide, strict=True) if is_wide}
    start_dependent |= {
        name for name, size in end_spread.items() if size >= start_spread.get(name, np.inf)
    }
    # The standard deviation of a uniform distribution over the grid: the delay is undetermined.
    if step.delay_spread >= float(np.ptp(bank.delays)) / 12.0**0.5:
        start_dependent.add("delay")
    added = {**end_spread, "delay": step.delay_spread}
    with_spread = {
        name: (value, float(np.hypot(sigma, added.get(name, 0.0))))
        for name, (value, sigma) in derived.items()
    }
    finite_spread = np.where(np.isfinite(spread), spread, prior)
    covariance = estimate.covariance + spread_covariance(finite_spread, differences)
    return SoFar(
        replace(estimate, covariance=covariance),
        with_spread,
        weights,
        False,
        frozenset(start_dependent),
    )


def likely_estimate(
    bank: OnlineBank, state: BankState
) -> tuple[Estimate, np.ndarray, tuple[float, float]]:
    """Return results of a bank of filters.

    Returns
    -------
    Parameters of the most likely filter with its own covariance; likelihood weights of the delays,
    shape ``(B,)``; mean delay by these weights, and its standard deviation, s.
    """
    best, n_x = state.best, len(bank.system.states)
    names = bank.names[n_x:]
    P = state.covariance[best, n_x:, n_x:]
    weights = likelihood_weights(np.where(state.sound, state.log_likelihood, -np.inf))
    estimate = Estimate(
        "online",
        names,
        bank.units,
        state.mean[n_x:, best].copy(),
        0.5 * (P + P.T),
        Outcome.CONVERGED if state.sound[best] else Outcome.DIVERGED,
        float(state.log_likelihood[best]),
        bank.system.output_names,
        np.sqrt(np.diag(bank.R)),
        (),
    )
    return estimate, weights, mean_delay(bank.delays, weights)


def _derived_spread(
    session: Session,
    about: Estimate,
    derived: Mapping[str, tuple[float, float]],
    differences: np.ndarray,
) -> dict[str, float]:
    """Return the spread of natural frequency and damping between filters with other starts.

    A spread is infinite if half of the filters have no such quantity.

    Parameters
    ----------
    about : the estimate.
    derived : its derived quantities.
    differences : differences of the other filters' parameters from it, shape ``(K, n)``.
    """
    others = [
        derived_of(replace(about, values=about.values + difference), session.vehicle, (0.0, 0.0))
        for difference in differences
    ]
    spread = {}
    for name, (value, _) in derived.items():
        if name != "delay":
            changes = [other[name][0] - value if name in other else np.inf for other in others]
            spread[name] = float(np.sqrt(np.median(np.square(changes)) / MEDIAN_SQUARE))
    return spread


# ---- The history of a watch: one line per row, written while the stream continues

NAME = "history.csv"
PART = "history.csv.part"


class History:
    """A growing file ``history.csv.part`` in the folder of the study; ``finish`` returns its text.

    Columns, with an empty cell where there is no number:

    - ``time``, s.
    - ``most_likely_delay`` and ``weighted_delay``, s.
    - ``log_likelihood`` of the most likely filter; empty once all filters have diverged.
    - ``weight_25ms`` and so on: likelihood of each delay.
    - States and parameters of the most likely filter: ``NAME``; ``NAME_std`` of that filter;
      ``NAME_spread``, which other starts and the grid of delays add.
    - If the bank is relinearised: ``refined_NAME`` and ``refined_NAME_std`` of the parameters and
      the delay; empty before the first relinearisation.
    - ``innovation_CHANNEL``, in standard deviations.
    - ``spikes``: number of samples of the row that were left out.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._creates_folder = folder, not folder.exists()
        self.path = folder / PART
        self._file: IO[str] | None = None
        self._bank: OnlineBank | None = None

    def __enter__(self) -> History:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Remove an incomplete file."""
        if self._file is not None:
            self._file.close()
            self.path.unlink(missing_ok=True)
        if (
            kind is not None
            and self._creates_folder
            and self._folder.is_dir()
            and not any(self._folder.iterdir())
        ):
            self._folder.rmdir()

    def write(self, bank: OnlineBank, steps: Sequence[WatchStep], refine: bool = False) -> None:
        """Append a line for each step; all lines are on disk when this returns.

        ``refine``: whether the bank is relinearised during the watch.

        Raises
        ------
        FlightidError : the folder cannot be written.
        """
        if not steps:
            return
        try:
            if self._file is None:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._file = self.path.open("w", encoding="ascii", newline="")
                self._file.write(",".join(columns(bank, refine)) + "\n")
            self._file.write(lines(bank, steps, refine))
            self._file.flush()
        except OSError as error:
            raise FlightidError(
                f"cannot be written ({error.strerror})",
                where=str(self._folder),
                remedy="name a folder that you may write in",
            ) from None

    def finish(self) -> str:
        """Close the file and return its text."""
        if self._file is None:
            return ""
        self._file.close()
        self._file = None
        text = self.path.read_text(encoding="ascii")
        self.path.unlink()
        return text


def columns(bank: OnlineBank, refine: bool = False) -> list[str]:
    """Return the names of the columns of a history."""
    weights = [f"weight_{1000.0 * delay:g}ms" for delay in bank.delays]
    values = [column for name in bank.names for column in (name, f"{name}_std", f"{name}_spread")]
    if refine:
        values += [
            column
            for name in (*bank.names[len(bank.system.states) :], "delay")
            for column in (f"refined_{name}", f"refined_{name}_std")
        ]
    head = ["time", "most_likely_delay", "weighted_delay", "log_likelihood"]
    return [*head, *weights, *values, *(f"innovation_{name}" for name in OUTPUTS), "spikes"]


def lines(bank: OnlineBank, steps: Sequence[WatchStep], refine: bool = False) -> str:
    """Return the lines of a history, one for each step, in the order of ``columns``.

    Numbers have ten digits, innovations four.
    """
    B, n, count = len(bank.delays), len(bank.names), len(steps)
    states = [step.state for step in steps]
    log_likelihood = np.array(
        [np.where(state.sound, state.log_likelihood, -np.inf) for state in states]
    )
    best = log_likelihood.argmax(axis=1)
    weights = likelihood_weights(log_likelihood)
    at_best = [*zip(states, best.tolist(), strict=True)]
    variance = np.array([np.diagonal(state.covariance[run]) for state, run in at_best])
    n_x = len(bank.system.states)
    values_at, refined_at = 4 + B, 4 + B + 3 * n  # first columns of values and refined values
    table = np.full((count, refined_at + (2 * (n - n_x + 1) if refine else 0)), np.nan)
    table[:, 0], table[:, 1] = [step.row[0] for step in steps], bank.delays[best]
    table[:, 2], table[:, 3] = weights @ bank.delays, log_likelihood[np.arange(count), best]
    table[:, 4:values_at] = weights
    table[:, values_at:refined_at:3] = [state.mean[:, run] for state, run in at_best]
    table[:, values_at + 1 : refined_at : 3] = np.sqrt(np.maximum(variance, 0.0))
    spread = np.array([step.spread for step in steps])
    table[:, values_at + 2 : refined_at : 3] = np.where(np.isfinite(spread), spread, np.nan)
    for row, step in enumerate(steps):
        if refine and step.refined is not None:
            estimate = joint_estimate(step.refined)
            table[row, refined_at::2] = estimate.values
            table[row, refined_at + 1 :: 2] = estimate.std
    innovations = np.array([state.innovation for state in states])
    spikes = [int(np.count_nonzero(state.skipped)) for state in states]
    form = ",".join(["%.10g"] * table.shape[1] + ["%.4g"] * innovations.shape[1]) + ",%d\n"
    text = "".join(
        form % (*numbers, *sizes, skipped)
        for numbers, sizes, skipped in zip(
            table.tolist(), innovations.tolist(), spikes, strict=True
        )
    )
    # Twice: of two neighbouring cells the first match takes the comma of the second.
    return text.replace(",-inf,", ",,").replace(",nan,", ",,").replace(",nan,", ",,")


# ---- The page of a watch that has ended


def watch_page(
    content: Mapping[str, Any],
    name: str,
    digest: str,
    first: tuple[Section, ...] = (),
    vehicle: InputFile | None = None,
) -> Page:
    """Return the page of a watch.

    Parameters
    ----------
    content : content of ``comparison.json``.
    name : name of the watched file.
    digest : SHA-256 of the record.
    first : sections above all others.
    vehicle : the vehicle file, or None.
    """
    stream, reference = content["stream"], content.get("reference")
    methods = content.get("methods", {})
    outside = list(reference["outside"]) if reference else []
    counts = (
        f"{stream['rows']} rows of {name}, {stream['left_out']} left out, {stream['mended']} "
        f"filled in, {stream['spikes']} spikes"
    )
    agreement = (
        against(
            outside,
            len(reference["differences"]),
            reference["study"],
            content.get("start_dependent", ()),
        )
        if reference
        else ""
    )
    refined = {"online": "as the stream left it", "online-refined": "refined on line"}.get(
        content["method"], "refined over all rows"
    )
    return Page(
        title=f"{capital(content['vehicle'])}: identified from a stream",
        kind=f"Watch of {name}, low-order equivalent system, {refined}",
        verdict="outside the reference"
        if outside
        else content["outcome_sentence"].partition(":")[0].partition(",")[0],
        tone="fair" if outside else "good" if content["outcome"] == "converged" else "open",
        sentence=as_sentence(agreement or counts),
        summary=(as_sentence(counts),) if reference else (),
        warnings=tuple(content.get("warnings", ())),
        sections=(
            *first,
            *section("Estimates", *estimate_tables(content)),
            *section("As the stream left it", *estimate_tables(methods.get("online"))),
            *section("In the frequency domain", *estimate_tables(methods.get(METHOD))),
            *section("Against the reference", differences_table(content)),
            *section("Delay", *delay_tables(content)),
            *section(
                "How it was made",
                fixed_table(
                    "Constants",
                    {
                        name: (entry["value"], entry["unit"])
                        for name, entry in content["fixed"].items()
                    },
                ),
            ),
        ),
        reproduction=reproduction(
            usual_command(name, "loes", vehicle),
            as_sentence(f"the watch ended: {stream['ended']}"),
            rows_and_vehicle(name, digest, vehicle),
        ),
        created=now(),
    )


def estimate_tables(content: Mapping[str, Any] | None) -> list[Block]:
    """Return the tables of parameters and derived quantities of ``comparison.json``.

    Return none without content or parameters.
    """
    if content is None or not content["parameters"]:
        return []
    rows = [
        Row(name, entry["unit"], entry["estimate"], entry["std"])
        for name, entry in content["parameters"].items()
    ]
    derived = {
        name: (entry["estimate"], entry["std"])
        for name, entry in content.get("derived", {}).items()
    }
    return [
        estimates_table("Parameters", rows),
        *([derived_table("Derived quantities", derived)] if derived else []),
    ]


# ---- Files of a watch that has ended

FREQUENCY = "frequency.csv"  # history of the estimates in the frequency domain
FILES = ("comparison.json", NAME, FREQUENCY, "record.csv", "record.json", CONTENT, PAGE)


@dataclass(frozen=True, eq=False)
class WatchOutcome:
    """Final results of a watch.

    Attributes
    ----------
    record : record of all rows.
    refinement : identification from the whole record, or None.
    online : the last on-line estimate.
    delays : delays of the bank, shape ``(B,)``, s.
    standings : main results, each beside its reference.
    left_out : number of rows that were left out.
    mended : number of rows that were filled in.
    spikes : number of samples that were left out as spikes.
    reason : why the watch ended.
    """

    record: Record
    refinement: IdentificationResult | None
    online: SoFar
    delays: np.ndarray
    standings: tuple[CrossValidation, ...]
    left_out: int
    mended: int
    spikes: int
    reason: str

    @property
    def weights(self) -> np.ndarray:
        """Weights of the declared delays by the final estimate, as in ``SoFar``."""
        if self.refinement is None or "delay" not in self.refinement.estimate.names:
            return self.online.weights
        return nearest(
            self.delays,
            self.refinement.estimate.value("delay"),
            self.refinement.estimate.sigma("delay"),
        )

    @property
    def refined(self) -> bool:
        """Whether the final estimate is relinearised."""
        return self.refinement is not None or self.online.refined


def refuse_overwriting(stream: Path, out: Path) -> None:
    """Raise DeclarationError if the output would overwrite the watched file."""
    if resolved(stream).parent == resolved(out) and stream.name in FILES:
        what = "the study's files would take the place of what is watched"
        raise DeclarationError(what, where=str(stream), remedy="name another folder with --out")


def write_watch(
    out: Path,
    session: Session,
    reference: Reference | None,
    end: WatchOutcome,
    history: History,
    name: str,
    figures: Formats = USUAL,
) -> None:
    """Write the files of a watch; the growing history becomes one of them."""
    with study_folder(out, "comparison.json") as scratch:
        record_file, _ = write_record(scratch, end.record)
        write_text(scratch / NAME, history_text := history.finish())
        if session.spectral is not None and session.spectral.points:
            write_text(scratch / FREQUENCY, history_csv(session.spectral))
        digest = hashlib.sha256(record_file.read_bytes()).hexdigest()
        content = watch_content(session, reference, end)
        title = f"{content['vehicle']}: {name}"
        first = history_section(scratch, history_text, content, title, figures)
        write_page(scratch, watch_page(content, name, digest, first, session.vehicle.identity))
        write_json(
            scratch / "comparison.json",
            {**content, "inputs": {"records": [name], "sha256": [digest]}},
        )


def watch_content(
    session: Session, reference: Reference | None, end: WatchOutcome
) -> dict[str, Any]:
    """Return the content of ``comparison.json``.

    The main estimate is the refined one, if there is one. The estimate of the bank is then under
    ``methods``.
    """
    bank, state = session.bank, session.state
    assert bank is not None and state is not None
    first_pass = first_pass_so_far(session)
    plain: dict[str, Any] = {**_content(session, first_pass), "method": "online"}
    if end.refinement is not None:
        result = end.refinement
        main: dict[str, Any] = {
            **estimate_content(
                result.estimate, result.rows, result.derived, result.fixed, result.tests
            ),
            "method": "ekf",
        }
    else:
        main = (
            {**_content(session, end.online), "method": "online-refined"} if end.refined else plain
        )
    methods: dict[str, Any] = {"online": plain} if end.refined else {}
    if session.spectral is not None and last_estimate(session.spectral) is not None:
        methods[METHOD] = spectral_content(session.spectral)
    return {
        "schema": SCHEMA,
        "scenario": "watch",
        "model": "loes",
        "vehicle": session.vehicle.name,
        **main,
        **({"methods": methods} if methods else {}),
        "bank": {
            "delays": bank.delays,
            "weights": first_pass.weights,
            **({"refined": end.weights} if end.refined else {}),
            "most_likely": float(bank.delays[state.best]),
        },
        **({} if reference is None else {"reference": reference_content(reference, end.standings)}),
        "stream": {
            "rows": len(end.record),
            "left_out": end.left_out,
            "mended": end.mended,
            "spikes": end.spikes,
            "trim": dict(session.offsets),
            "ended": end.reason,
        },
        "versions": versions(),
    }


def _content(session: Session, online: SoFar) -> dict[str, Any]:
    """Return the content of an on-line estimate; quantities that depend on the start get a warning
    and no number.
    """
    assert session.bank is not None and session.state is not None and session.system is not None
    estimate = online.estimate
    hanging = online.hanging
    rows = tuple(row for row in rows_of(estimate) if row.std > 0 and row.name not in hanging)
    fixed = {
        item.name: (item.value, item.unit)
        for item in session.system.parameters
        if not item.free and item.name not in estimate.names
    }
    if "delay" not in estimate.names:
        fixed["delay"] = (float(session.bank.delays[session.state.best]), DERIVED_UNITS["delay"])
    derived = {name: pair for name, pair in online.derived.items() if name not in hanging}
    content = estimate_content(estimate, rows, derived, fixed, ())
    if not hanging:
        return content
    names = sorted(hanging)
    warning = (
        f"with another start within its prior the result would differ: {', '.join(names)} depend "
        "on the start, and no number is shown"
    )
    return {**content, "start_dependent": names, "warnings": [warning]}
