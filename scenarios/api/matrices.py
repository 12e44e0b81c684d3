"""The model of a study of simulated flights as matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ident.flying_qualities.modes import state_space, to_control
from scenarios.files.own_models import is_own
from scenarios.identification.state_space import linearised
from scenarios.studies.catalogue import IDENTIFICATION
from scenarios.studies.estimating import assumed_noise, compiled, declared_model, flight_constants
from scenarios.studies.study import Study

if TYPE_CHECKING:
    import control

    from scenarios.x29.study import LoopStudy


def matrices_of_study(study: Any, kind: str, pade: int) -> control.StateSpace:
    """The main method's model with what it estimated, linearised; of a closed loop its low-order equivalent."""
    return _of_estimators(study, pade) if kind == IDENTIFICATION else _of_loop(study, pade)


def _of_estimators(study: Study, pade: int) -> control.StateSpace:
    estimation = study.main.estimation
    model = declared_model(estimation, flight_constants(study.scenario.flight, estimation), assumed_noise(study.scenario, estimation))
    values = study.main.result.estimate.as_dict()
    return to_control(linearised(compiled(estimation, model), values, study.main.result.record, model if is_own(model) else None), pade)


def _of_loop(study: LoopStudy, pade: int) -> control.StateSpace:
    return to_control(state_space(study.result.setting.system, study.result.estimate.as_dict()), pade)
