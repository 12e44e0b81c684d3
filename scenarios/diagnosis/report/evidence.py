"""What speaks for an effect where what remains is not noise, in words; and what remains,
condensed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Claim, Diagnosis, FittedRecord, Quantity
from scenarios.diagnosis.overflows import overflow_sentence
from scenarios.diagnosis.report.declared_only import nothing_stands
from scenarios.diagnosis.report.leftover import Leftover, left_over
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.user_models import is_of_aircraft
from scenarios.report.quantities import CHANNELS, displayed, shown_in, spaced

FEW = 2  # parameters whose values are worth comparing between records
FORMS = {
    "itself": "{}",
    "rate": "the rate of {}",
    "square": "the square of {}",
    "product": "the product of {} and the {control}",
}
# of both spreads together, from which a joint value and the mean of the records do not agree
APART = 2.0
LARGEST = 1e30
EVEN = 1.6  # times the rms, up to which no moment stands out


def evidence_sentences(claim: Claim) -> list[str]:
    """How the evidence for an effect is spread, and its values from each record; nothing where what
    remains is noise.
    """
    if claim.spread is None:
        return []
    told = (
        f"its log evidence is {claim.spread:.1f} times the scatter of that between blocks of a "
        "second"
        if math.isfinite(claim.spread)
        else ""
    )
    values, apart = by_record_text(claim.by_record), apart_text(claim)
    each = f"from each of {len(claim.by_record)} records: {values}" if values else ""
    return [part for part in (told, f"{each}, but {apart}" if each and apart else each) if part]


def apart_text(claim: Claim) -> str:
    """Where values of the records differ by more than their sigmas say; empty where they agree."""
    told = []
    for name in claim.by_record[0] if len(claim.by_record) > 1 else ():
        each = [found[name] for found in claim.by_record]
        values, sigmas = (
            np.array([q.value for q in each]),
            np.minimum([q.std for q in each], LARGEST),
        )
        weight = sigmas**-2
        mean = float(values @ weight / weight.sum())
        scatter = math.sqrt(float(np.sum(((values - mean) / sigmas) ** 2)) / (len(values) - 1))
        if scatter > APART:
            told.append(f"{name} differs between them by {scatter:.1f} of their sigmas")
    return "; ".join(told)


def by_record_text(by_record: Sequence[Mapping[str, Quantity]]) -> str:
    """Values from each record with their unit: ``"0.058, 0.063, 0.060 s"``; empty for a curve,
    whose numbers trade off.
    """
    names = list(by_record[0]) if by_record else []
    if not 0 < len(names) <= FEW:
        return ""
    told = []
    for name in names:
        shown = [displayed(each[name], name) for each in by_record if name in each]
        known = [std for _, std, _ in shown if 0.0 < std < math.inf]
        digits = max(0, -math.floor(math.log10(min(known)))) if known else 3
        unit = shown[0][2] if shown[0][2] not in ("", "1") else ""
        values = ", ".join(f"{value:.{min(digits, 6)}f}" for value, _, _ in shown)
        told.append(
            f"{f'{name} ' if len(names) > 1 or not unit else ''}{values}{f' {unit}' if unit else ''}"  # noqa: E501
        )
    return "; ".join(told)


def warnings_of(tracing: Tracing) -> list[str]:
    """The warnings with a description of what is left in each channel, in place of long lists of
    tests that failed.

    Where nothing stands, what the declared model leaves is described: what hints would leave is no
    result.
    """
    d = tracing.diagnosis
    if nothing_stands(d):
        told = [
            *(caution.sentence for caution in d.warnings if caution.test is None),
            *([overflow_sentence(tracing.overflows)] if tracing.overflows else []),
        ]
        declared = [replace(item, after=item.before) for item in d.fitted]
        open_channels = _channels([test for test in d.tests_before if not test.passed])
        return [
            *told,
            *(
                f"with the declared model, {line}"
                for line in _left(tracing, declared, open_channels)
            ),
        ]
    cautions = [caution for caution in d.warnings if caution.test is not None]
    failed = [caution.test for caution in cautions if caution.test is not None]
    lines = cautions if len(failed) > FEW else []
    told = [caution.sentence for caution in d.warnings if caution not in lines]
    told += [overflow_sentence(tracing.overflows)] if tracing.overflows else []
    if failed:
        share = (
            [
                f"{len(failed)} of {len(d.tests_after)} tests for whiteness fail in "
                f"{', '.join(_channels(failed))}"
            ]
            if lines
            else []
        )
        return [*told, *share, *_left(tracing, d.fitted, _channels(failed))]
    return told


def _channels(tests: Sequence[ResidualTest]) -> list[str]:
    return list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))


def _left(tracing: Tracing, fitted: Sequence[FittedRecord], channels: Sequence[str]) -> list[str]:
    found = [left_over(fitted, channel) for channel in channels]
    return [leftover_sentence(item, tracing) for item in found if item is not None]


def leftover_sentence(left: Leftover, tracing: Tracing) -> str:
    """What is left in one channel: size, colour, frequency, when, and what it goes with."""
    factor, unit = shown_in(left.unit, left.channel)
    parts = [
        f"left in the {_spoken(left.channel, tracing)}: rms {factor * left.rms:.3g}{spaced(unit)}, "
        f"neighbouring samples correlated by {left.correlation:.2f}",
        f"most power near {left.peak:.2g} Hz, four fifths of it below {left.below:.2g} Hz",
    ]
    if left.times > EVEN:
        record = tracing.diagnosis.fitted[left.record].record.name
        parts.append(
            f"largest in {record} from {left.begin:.1f} to {left.end:.1f} s, {left.times:.1f} "
            "times its rms"
        )
    else:
        parts.append("about alike everywhere")
    if left.company is None:
        return "; ".join(
            [*parts, "goes with no input and no channel, nor their rates, squares and products"]
        )
    company = left.company
    control = next(iter(tracing.records[0].input_names), "input")
    what = FORMS[company.form].format(f"the {_spoken(company.name, tracing)}", control=control)
    later = (
        f", {abs(company.later):.2g} s {'later' if company.later > 0 else 'earlier'}"
        if abs(company.later) > 1e-9
        else ""
    )
    return "; ".join([*parts, f"goes with {what} (correlation {company.correlation:+.2f}{later})"])


def scatter_text(d: Diagnosis, name: str) -> str:
    """``" (run-to-run scatter 0.8)"`` behind a derivative, empty where it is not known."""
    return f" (run-to-run scatter {d.scatter[name]:.2g})" if name in d.scatter else ""


def _spoken(name: str, tracing: Tracing) -> str:
    return CHANNELS.get(name, name.replace("_", " ")) if is_of_aircraft(tracing.model) else name


def _unit(quantity: Quantity) -> str:
    return quantity.unit if quantity.unit != "1" else ""
