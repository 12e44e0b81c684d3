"""Results of a watch: estimates, history, comparison, page, and the values shown on line."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from scipy.special import ndtr

from ident.banks.delays import likelihood_weights
from ident.banks.online import MEDIAN_SQUARE, BankState, OnlineBank, moved_starts, spread_covariance
from ident.banks.relinearised import joint_estimate
from ident.estimate import Estimate, Outcome
from scenarios.files.sources import InputFile, resolved, versions
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.identification.assessment import IdentificationResult
from scenarios.identification.low_order import derived_of, mean_delay
from scenarios.report.document import (
    BY_ROW,
    PURE,
    Block,
    Cell,
    Column,
    Number,
    Page,
    Section,
    Table,
    as_sentence,
    capital,
    estimate,
    now,
    reproduction,
    section,
)
from scenarios.report.folder import CONTENT, write_page
from scenarios.report.summary import PAGE
from scenarios.report.terminal import derived_table, estimates_table, fixed_table
from scenarios.studies.comparison import DERIVED_UNITS, SCHEMA, estimate_content
from scenarios.studies.published import Row
from scenarios.watching.reference import (
    WORDS,
    CrossValidation,
    Reference,
    against,
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
    """``estimate`` of the parameters, ``derived`` quantities with deviations, ``weights (B,)`` of
    the declared delays: likelihoods of the plain filters, or where it is refined the probability
    that the delay is nearest to each.

    ``refined``: linearised anew on its way, with the delay between the grid points. Else the most
    likely filter's, and ``hanging`` are the quantities that depend on the start: other starts end
    as far apart as they began.
    """

    estimate: Estimate
    derived: Mapping[str, tuple[float, float]]
    weights: np.ndarray
    refined: bool
    hanging: frozenset[str] = frozenset()


def so_far(session: Session, step: WatchStep | None = None) -> SoFar:
    """Return the estimate after a step, the last when None: the one that was linearised anew if
    there is one.
    """
    step = session.last if step is None else step
    assert session.bank is not None and step is not None
    if step.refined is None:
        return first_pass_so_far(session, step)
    estimate = joint_estimate(step.refined)
    weights = nearest(session.bank.delays, estimate.value("delay"), estimate.sigma("delay"))
    return SoFar(estimate, derived_of(estimate, session.vehicle, (0.0, 0.0)), weights, True)


def nearest(delays: np.ndarray, value: float, std: float) -> np.ndarray:
    """Return the probability ``(B,)`` of a normal delay (s) to be nearer to each of the increasing
    ``delays`` than to any other.
    """
    between = 0.5 * (delays[1:] + delays[:-1])
    below = ndtr((between - value) / max(std, 1e-9))
    return np.diff(np.concatenate([[0.0], below, [1.0]]))


def first_pass_so_far(session: Session, step: WatchStep | None = None) -> SoFar:
    """Estimate of the most likely filter; its deviations include the differences between starts."""
    bank, step = session.bank, session.last if step is None else step
    assert bank is not None and step is not None
    estimate, weights, (delay, std) = likely_estimate(bank, step.state)
    n_x = len(bank.system.states)
    spread, differences = step.spread[n_x:], step.differences[:, n_x:]
    derived = derived_of(estimate, session.vehicle, (delay, std))
    ended = _derived_spread(session, estimate, derived, differences)
    began = _derived_spread(session, *_at_start(session, estimate))
    prior = np.sqrt(np.diagonal(bank.covariance))[n_x:]
    hanging = {
        name
        for name, far, wide in zip(estimate.names, spread.tolist(), prior.tolist(), strict=True)
        if far >= wide
    }
    hanging |= {name for name, far in ended.items() if far >= began.get(name, np.inf)}
    spans = {**ended, "delay": step.delay_spread}
    # A spread as wide as a uniform distribution over the grid: the delay is undetermined.
    hanging |= {"delay"} if step.delay_spread >= float(np.ptp(bank.delays)) / 12.0**0.5 else set()
    wide = {
        name: (value, float(np.hypot(sigma, spans.get(name, 0.0))))
        for name, (value, sigma) in derived.items()
    }
    finite = np.isfinite(spread)
    covariance = estimate.covariance + spread_covariance(
        np.where(finite, spread, prior), differences
    )
    return SoFar(replace(estimate, covariance=covariance), wide, weights, False, frozenset(hanging))


def likely_estimate(
    bank: OnlineBank, state: BankState
) -> tuple[Estimate, np.ndarray, tuple[float, float]]:
    """Return the most likely filter's parameters with its own covariance, the likelihood weights
    ``(B,)``, and the weighted delay with its deviation (s).
    """
    best, n_x = state.best, len(bank.system.states)
    names = bank.names[n_x:]
    P = state.covariance[best, n_x:, n_x:]
    outcome = Outcome.CONVERGED if state.sound[best] else Outcome.DIVERGED
    log_likelihood = np.where(state.sound, state.log_likelihood, -np.inf)
    weights = likelihood_weights(log_likelihood)
    std = np.sqrt(np.diag(bank.R))
    likely = float(state.log_likelihood[best])
    estimate = Estimate(
        "online",
        names,
        bank.units,
        state.mean[n_x:, best].copy(),
        0.5 * (P + P.T),
        outcome,
        likely,
        bank.system.output_names,
        std,
        (),
    )
    return estimate, weights, mean_delay(bank.delays, weights)


def _at_start(
    session: Session, estimate: Estimate
) -> tuple[Estimate, Mapping[str, tuple[float, float]], np.ndarray]:
    """Return the declared start as an estimate, derived quantities, and the differences of the
    other starts ``(K, n)``.
    """
    bank = session.bank
    assert bank is not None
    n_x = len(bank.system.states)
    start_estimate = replace(estimate, values=bank.start[n_x:])
    moved = (moved_starts(bank, STARTED) - bank.start[:, None]).T[:, n_x:]
    return start_estimate, derived_of(start_estimate, session.vehicle, (0.0, 0.0)), moved


def _derived_spread(
    session: Session,
    about: Estimate,
    derived: Mapping[str, tuple[float, float]],
    differences: np.ndarray,
) -> dict[str, float]:
    """Typical differences of natural frequency and damping between estimates that differ by ``apart
    (K, n)``; infinite if half have none.
    """
    each = [
        derived_of(replace(about, values=about.values + away), session.vehicle, (0.0, 0.0))
        for away in differences
    ]
    out = {}
    for name, (value, _) in derived.items():
        if name != "delay":
            far = [result[name][0] - value if name in result else np.inf for result in each]
            out[name] = float(np.sqrt(np.median(np.square(far)) / MEDIAN_SQUARE))
    return out


# ---- The history of a watch: one line per row, written while the stream continues

NAME = "history.csv"
PART = "history.csv.part"


class History:
    """A file ``history.csv.part`` in the study's folder that grows; ``finish`` hands it over as a
    whole.

    Columns: ``time``; ``most_likely_delay``, ``weighted_delay`` (s); ``log_likelihood`` of the most
    likely filter, empty once all filters have broken down; ``weight_25ms`` and so on; states and
    parameters of the most likely filter, each ``NAME``, ``NAME_std`` as that filter has it, and
    ``NAME_spread``, the deviation that other starts and the grid of delays add; where the bank is
    linearised anew ``refined_NAME`` and ``refined_NAME_std`` of the parameters and the delay, empty
    until it first is; ``innovation_CHANNEL`` in standard deviations, an empty cell where nothing
    was measured; ``spikes``, how many samples of the row were left out.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._made = folder, not folder.exists()
        self.path = folder / PART
        self._file: IO[str] | None = None
        self._bank: OnlineBank | None = None

    def __enter__(self) -> History:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove an incomplete file."""
        if self._file is not None:
            self._file.close()
            self.path.unlink(missing_ok=True)
        if (
            kind is not None
            and self._made
            and self._folder.is_dir()
            and not any(self._folder.iterdir())
        ):
            self._folder.rmdir()

    def write(self, bank: OnlineBank, steps: Sequence[WatchStep], refine: bool = False) -> None:
        """Append a line for each step, all of them on disk when this returns; ``refine``: the bank
        is linearised anew on its way.

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
            what = f"cannot be written ({error.strerror})"
            raise FlightidError(
                what, where=str(self._folder), remedy="name a folder that you may write in"
            ) from None

    def finish(self) -> str:
        """Close the file and return its text."""
        if self._file is not None:
            self._file.close()
            self._file = None
            text = self.path.read_text(encoding="ascii")
            self.path.unlink()
            return text
        return ""


def columns(bank: OnlineBank, refine: bool = False) -> list[str]:
    """Return the names of the columns."""
    weights = [f"weight_{1000.0 * delay:g}ms" for delay in bank.delays]
    values = [name for each in bank.names for name in (each, f"{each}_std", f"{each}_spread")]
    if refine:
        values += [
            name
            for each in (*bank.names[len(bank.system.states) :], "delay")
            for name in (f"refined_{each}", f"refined_{each}_std")
        ]
    head = ["time", "most_likely_delay", "weighted_delay", "log_likelihood"]
    return [*head, *weights, *values, *(f"innovation_{name}" for name in OUTPUTS), "spikes"]


def lines(bank: OnlineBank, steps: Sequence[WatchStep], refine: bool = False) -> str:
    """Return a line a step, ten digits a number."""
    B, n, count = len(bank.delays), len(bank.names), len(steps)
    states = [step.state for step in steps]
    each = np.arange(count)
    log_likelihood = np.array(
        [np.where(state.sound, state.log_likelihood, -np.inf) for state in states]
    )
    best = log_likelihood.argmax(axis=1)
    weights = likelihood_weights(log_likelihood)
    variance = np.array(
        [
            state.covariance[run].reshape(-1)[:: n + 1]
            for state, run in zip(states, best.tolist(), strict=True)
        ]
    )
    n_x = len(bank.system.states)
    table = np.full((count, 4 + B + 3 * n + (2 * (n - n_x + 1) if refine else 0)), np.nan)
    table[:, 0], table[:, 1] = [step.row[0] for step in steps], bank.delays[best]
    table[:, 2], table[:, 3] = weights @ bank.delays, log_likelihood[each, best]
    table[:, 4 : 4 + B] = weights
    last = 4 + B + 3 * n
    table[:, 4 + B : last : 3] = [
        state.mean[:, run] for state, run in zip(states, best.tolist(), strict=True)
    ]
    table[:, 5 + B : last : 3] = np.sqrt(np.maximum(variance, 0.0))
    spread = np.array([step.spread for step in steps])
    table[:, 6 + B : last : 3] = np.where(np.isfinite(spread), spread, np.nan)
    for row, step in enumerate(steps):
        if refine and step.refined is not None:
            result = joint_estimate(step.refined)
            table[row, last::2], table[row, last + 1 :: 2] = result.values, result.std
    innovations = np.array([state.innovation for state in states])
    spikes = [int(np.count_nonzero(state.skipped)) for state in states]
    form = ",".join(["%.10g"] * table.shape[1] + ["%.4g"] * innovations.shape[1]) + ",%d\n"
    text = "".join(
        form % (*numbers, *sizes, more)
        for numbers, sizes, more in zip(table.tolist(), innovations.tolist(), spikes, strict=True)
    )
    # a match takes the comma of the next
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

    ``content``: of ``comparison.json``. ``digest``: hash of the rows. ``first``: first sections.
    ``vehicle``: the vehicle file.
    """
    stream, reference = content["stream"], content.get("reference")
    methods = content.get("methods", {})
    outside = list(reference["outside"]) if reference else []
    counts = (
        f"{stream['rows']} rows of {name}, {stream['left_out']} left out, {stream['mended']} "
        f"filled in, {stream['spikes']} spikes"
    )
    words = (
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
        sentence=as_sentence(words) if reference else as_sentence(counts),
        summary=(as_sentence(counts),) if reference else (),
        warnings=tuple(content.get("warnings", ())),
        sections=(
            *first,
            *section("Estimates", *_estimate_tables(content)),
            *section(
                "As the stream left it",
                *(_estimate_tables(methods["online"]) if "online" in methods else ()),
            ),
            *section(
                "In the frequency domain",
                *(
                    _estimate_tables(methods["frequency-domain"])
                    if "frequency-domain" in methods
                    else ()
                ),
            ),
            *section("Against the reference", differences_table(reference) if reference else None),
            *section("The bank of delays", _bank(content["bank"])),
            *section(
                "How it was made",
                fixed_table(
                    "Constants",
                    {key: (each["value"], each["unit"]) for key, each in content["fixed"].items()},
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


def _estimate_tables(content: Mapping[str, Any]) -> list[Block]:
    rows = [
        Row(name, each["unit"], each["estimate"], each["std"])
        for name, each in content["parameters"].items()
    ]
    derived = {name: (each["estimate"], each["std"]) for name, each in content["derived"].items()}
    return [
        estimates_table("Parameters", rows),
        *([derived_table("Derived quantities", derived)] if derived else []),
    ]


def differences_table(reference: Mapping[str, Any]) -> Table:
    """Each quantity of the reference, and how far the last estimate is from it."""
    columns = (
        Column("quantity"),
        Column("reference ± σ", BY_ROW),
        Column("difference", "σ"),
        Column("remark"),
    )
    rows: list[tuple[Cell, ...]] = []
    for each in reference["differences"]:
        reference_value = estimate(each["reference"], each["reference_std"])
        rows.append(
            (
                WORDS.get(each["name"], each["name"]),
                reference_value,
                Number(each["sigmas"], digits=1, signed=True),
                "outside" if each["outside"] else "",
            )
        )
    caption = f"The last estimate against {reference['study']}"
    return Table(
        caption,
        columns,
        tuple(rows),
        tuple(each["unit"] or PURE for each in reference["differences"]),
    )


def _bank(bank: Mapping[str, Any]) -> Table:
    rows = tuple(
        (Number(float(delay)), Number(float(weight), shown=f"{weight:.3g}"))
        for delay, weight in zip(bank["delays"], bank["weights"], strict=True)
    )
    return Table(
        "Likelihood of each delay by the plain filters",
        (Column("delay", "s"), Column("likelihood", PURE)),
        rows,
    )


# ---- What a watch leaves behind

FREQUENCY = "frequency.csv"  # beside the history of the bank
FILES = ("comparison.json", NAME, FREQUENCY, "record.csv", "record.json", CONTENT, PAGE)


@dataclass(frozen=True, eq=False)
class WatchOutcome:
    """Final results of a watch.

    ``record``: all rows. ``refinement``: identification from the whole record, or None.
    ``online``: last on-line estimate. ``delays``: of its bank, s. ``standings``: main results.
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
        """Weights of the declared delays, as in ``SoFar``, of the final estimate."""
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
) -> None:
    """Write the study; the history that grew until now becomes one of its files."""
    with study_folder(out, "comparison.json") as scratch:
        record_file, _ = write_record(scratch, end.record)
        history_note = history.finish()
        write_text(scratch / NAME, history_note)
        if session.spectral is not None and session.spectral.points:
            write_text(scratch / FREQUENCY, history_csv(session.spectral))
        digest = hashlib.sha256(record_file.read_bytes()).hexdigest()
        content = watch_content(session, reference, end)
        title = f"{content['vehicle']}: {name}"
        first = history_section(scratch, history_note, content, title)
        write_page(scratch, watch_page(content, name, digest, first, session.vehicle.identity))
        write_json(
            scratch / "comparison.json",
            {**content, "inputs": {"records": [name], "sha256": [digest]}},
        )


def watch_content(
    session: Session, reference: Reference | None, end: WatchOutcome
) -> dict[str, Any]:
    """Return the content of ``comparison.json``: the refined estimate as the main one where it was
    made, the on-line bank's under ``methods``.
    """
    bank, state = session.bank, session.state
    assert bank is not None and state is not None
    alone = first_pass_so_far(session)
    plain: dict[str, Any] = {**_content(session, alone), "method": "online"}
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
            "weights": alone.weights,
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
    """An estimate on line; quantities that depend on the start are named, without a number."""
    assert session.bank is not None and session.state is not None and session.system is not None
    estimate = online.estimate
    rows = rows_of(estimate.names, estimate.units, estimate.values.tolist(), estimate.std.tolist())
    fixed = {
        item.name: (item.value, item.unit)
        for item in session.system.parameters
        if not item.free and item.name not in estimate.names
    }
    if "delay" not in estimate.names:
        fixed["delay"] = (float(session.bank.delays[session.state.best]), DERIVED_UNITS["delay"])
    derived = {name: pair for name, pair in online.derived.items() if name not in online.hanging}
    content = estimate_content(
        estimate, tuple(row for row in rows if row.name not in online.hanging), derived, fixed, ()
    )
    if not online.hanging:
        return content
    names = sorted(online.hanging)
    warning = (
        f"with another start within its prior the result would differ: {', '.join(names)} depend "
        "on the start, and no number is shown"
    )
    return {**content, "start_dependent": names, "warnings": [warning]}


def rows_of(
    names: Sequence[str], units: Sequence[str], values: Sequence[float], std: Sequence[float]
) -> tuple[Row, ...]:
    """Return the rows of the estimated quantities; one without a deviation is not estimated."""
    return tuple(Row(*each) for each in zip(names, units, values, std, strict=True) if each[3] > 0)


def reference_content(reference: Reference, items: Sequence[CrossValidation]) -> dict[str, Any]:
    """Return the reference and the quantities that differ from it, for ``comparison.json``."""
    compared = [item for item in items if item.reference is not None and item.z is not None]
    return {
        "study": resolved(Path(reference.name)).name,
        "differences": [
            {
                "name": item.name,
                "unit": item.unit,
                "reference": item.reference[0],
                "reference_std": item.reference[1],
                "sigmas": item.z,
                "outside": item.beyond,
            }
            for item in compared
            if item.reference is not None
        ],
        "outside": [item.name for item in compared if item.beyond],
    }
