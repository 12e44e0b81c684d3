"""The effects that a diagnosis names, each with its sentence, its numbers and how probable its name is."""

from __future__ import annotations

from dataclasses import dataclass

from scenarios.api.shown import html
from scenarios.api.shown.parameters import Parameter, Parameters
from scenarios.diagnosis.report.text import effect_heading, wording_of
from scenarios.diagnosis.tracing import Tracing


@dataclass(frozen=True, eq=False, repr=False)
class Effect:
    """One effect of a diagnosis.

    Attributes
    ----------
    name : as ``flightid.effects()`` lists it. sentence : in words, with its numbers.
    parameters : its own, by local name. alternatives : effects that fit these data as well.
    probability : that it acts, or each that could take its place, by name.
    """

    name: str
    sentence: str
    parameters: Parameters
    alternatives: tuple[str, ...]
    probability: dict[str, float]

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[name]

    def __repr__(self) -> str:
        return f"<Effect {self.name}: {self.parameters!r:.400}>"

    def _repr_html_(self) -> str:
        others = [f"these data fit as well: {', '.join(self.alternatives)}"] if self.alternatives else []
        return html.page(f"{self.name}: {self.sentence}", self.parameters.html_table(), html.sentences(others))


def claimed_effects(tracing: Tracing, *, claimed: bool) -> tuple[Effect, ...]:
    """The effects of a diagnosis that are claimed, or those that are only hints."""
    wording = wording_of(tracing)
    return tuple(
        Effect(
            claim.name,
            effect_heading(claim, wording),
            Parameters(Parameter(name, each.value, each.std, each.unit) for name, each in claim.parameters.items()),
            claim.alternatives,
            dict(claim.probability),
        )
        for claim in tracing.diagnosis.effects
        if claim.claimed is claimed
    )
