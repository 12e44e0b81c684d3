"""A model as a functional mock-up unit: FMI 2.0 for co-simulation, C source and, where a compiler
is found, the compiled library [1]_.

The unit integrates with classical Runge-Kutta steps; inputs are constant over a communication step.

References
----------
.. [1] Modelica Association, Functional Mock-up Interface for Model Exchange and Co-Simulation,
   version 2.0.3, 2021.
"""

from __future__ import annotations

import io
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from scenarios.export.model import ExportedModel, Formulas, Operation, formulas_of, statements

MAX_STEP = 0.01  # s, longest integration step
_NAMESPACE = uuid.UUID("6ff2cb6d-0d0b-4d94-9d7a-33a3a5a8f1c4")
_CALLS = {"maximum": "fmax", "minimum": "fmin", "abs": "fabs", "power": "pow"}


class Variable(NamedTuple):
    """A variable of the unit; its place in the list is its value reference.

    Attributes
    ----------
    name, unit : name and unit.
    kind : ``state``, ``input``, ``parameter`` or ``output``.
    start : starting value; None for an output.
    """

    name: str
    unit: str
    kind: str
    start: float | None


def variables_of(model: ExportedModel) -> list[Variable]:
    """Return the variables: starting states (``NAME_start``), inputs, parameters, outputs.

    An output with the name of another variable is called ``NAME_measured``.
    """
    system = model.system
    starts = {item.name: item.value for item in system.initial}
    result = [Variable(f"{s.name}_start", s.unit, "state", starts[s.name]) for s in system.states]
    result += [Variable(s.name, s.unit, "input", 0.0) for s in system.inputs]
    result += [Variable(i.name, i.unit, "parameter", i.value) for i in system.parameters]
    taken = {variable.name for variable in result}
    for signal in system.outputs:
        name = signal.name if signal.name not in taken else f"{signal.name}_measured"
        result.append(Variable(name, signal.unit, "output", None))
    return result


def c_source(model: ExportedModel, guid: str) -> str:
    """Return the C source of the unit, one file: ``fmi2.c`` with constants and equations."""
    formulas = formulas_of(model.system)
    variables = variables_of(model)
    counts = Counter(variable.kind for variable in variables)
    starts = ", ".join(repr(variable.start or 0.0) for variable in variables)
    tables: list[str] = []
    rates = _function("rates", formulas, formulas.rates, tables)
    readings = _function("readings", formulas, formulas.outputs, tables)
    head = [
        f"#define GUID {_text(guid)}",
        f"#define NX {counts['state']}",
        f"#define NU {counts['input']}",
        f"#define NP {counts['parameter']}",
        f"#define NY {counts['output']}",
        "#define NV (NX + NU + NP + NY)",
        f"#define MAX_STEP {MAX_STEP!r}",
        f"static const double STARTS[NV] = {{{starts}}};",
    ]
    template = Path(__file__).with_name("fmi2.c").read_text(encoding="utf-8")
    template = template.replace("/*CONSTANTS*/", "\n".join(head))
    return template.replace("/*FUNCTIONS*/", "\n".join([*tables, rates, readings]))


def description(model: ExportedModel, guid: str) -> str:
    """Return the text of ``modelDescription.xml``, which names the variables of the unit."""
    variables = variables_of(model)
    causes = {
        "state": 'causality="parameter" variability="fixed" initial="exact"',
        "input": 'causality="input" variability="continuous"',
        "parameter": 'causality="parameter" variability="fixed" initial="exact"',
        "output": 'causality="output" variability="continuous" initial="calculated"',
    }
    units = sorted({variable.unit for variable in variables})
    lines = ['<?xml version="1.0" encoding="UTF-8"?>']
    about = " ".join((f"Model {model.model}, SI and radians.", *model.remarks))
    lines += [
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(model.name)} '
        f'guid="{guid}" description={quoteattr(about)} generationTool="flightid export" '
        'variableNamingConvention="flat">',
        f'  <CoSimulation modelIdentifier="{model.identifier}" '
        'canHandleVariableCommunicationStepSize="true">',
        '    <SourceFiles><File name="model.c"/></SourceFiles>',
        "  </CoSimulation>",
        "  <UnitDefinitions>",
        *(f"    <Unit name={quoteattr(unit)}/>" for unit in units),
        "  </UnitDefinitions>",
        "  <ModelVariables>",
    ]
    for place, variable in enumerate(variables):
        start = "" if variable.start is None else f' start="{variable.start!r}"'
        lines += [
            f'    <ScalarVariable name={quoteattr(variable.name)} valueReference="{place}" '
            f"{causes[variable.kind]}>",
            f"      <Real unit={quoteattr(variable.unit)}{start}/>",
            "    </ScalarVariable>",
        ]
    outputs = [i for i, variable in enumerate(variables, 1) if variable.kind == "output"]
    unknowns = "".join(f'      <Unknown index="{i}"/>\n' for i in outputs)
    lines += [
        "  </ModelVariables>",
        "  <ModelStructure>",
        f"    <Outputs>\n{unknowns}    </Outputs>",
        f"    <InitialUnknowns>\n{unknowns}    </InitialUnknowns>",
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def fmu(model: ExportedModel) -> tuple[bytes, str]:
    """Return the unit as a ZIP archive, and a sentence on its library.

    The archive has ``modelDescription.xml``, ``sources/model.c`` and, if a compiler is found, the
    library for this platform.
    """
    source = c_source(model, "GUID")
    guid = f"{{{uuid.uuid5(_NAMESPACE, source)}}}"
    source = c_source(model, guid)
    store = io.BytesIO()
    with zipfile.ZipFile(store, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description(model, guid))
        archive.writestr("sources/model.c", source)
        library, remark = _compiled(source, model.identifier)
        if library is not None:
            archive.writestr(f"binaries/{library[0]}", library[1])
    return store.getvalue(), remark


def _compiled(source: str, identifier: str) -> tuple[tuple[str, bytes] | None, str]:
    """Return the compiled library and a sentence on it.

    The library is its path inside ``binaries`` and its content; None without a compiler.
    """
    compiler = shutil.which(os.environ.get("CC") or "cc") or shutil.which("gcc")
    bits = "64" if sys.maxsize > 2**32 else "32"
    system = {"Linux": ("linux", ".so"), "Darwin": ("darwin", ".dylib")}.get(platform.system())
    if compiler is None or system is None:
        return None, "no C compiler was found: the unit has only its source"
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        path, library = Path(folder) / "model.c", Path(folder) / "model"
        path.write_text(source, encoding="utf-8", newline="\n")
        command = [compiler, "-O2", "-fPIC", "-shared", "-o", str(library), str(path), "-lm"]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        if process.returncode or not library.exists():
            first = (process.stderr.strip().splitlines() or ["no reason given"])[0]
            return None, f"the C compiler failed ({first}): the unit has only its source"
        name = f"{system[0]}{bits}/{identifier}{system[1]}"
        return (name, library.read_bytes()), f"with its library for {system[0]}{bits}"


def _function(name: str, formulas: Formulas, results: Sequence[int], tables: list[str]) -> str:
    """Return a C function that writes the results into ``out``.

    Tables of interpolations are appended to ``tables``.
    """
    system = formulas.system
    names = {"t": "t"}
    for kind, signals in (
        ("x", system.state_names),
        ("u", system.input_names),
        ("p", [item.name for item in system.parameters]),
    ):
        names |= {f"{kind}:{signal}": f"{kind}[{i}]" for i, signal in enumerate(signals)}

    def special(operation: Operation, arguments: Sequence[str]) -> str:
        if operation.name == "choose":
            return f"{arguments[0]} ? {arguments[1]} : {arguments[2]}"
        if operation.name == "interpolate":
            number = len(tables) // 2
            for label, row in zip(("KNOTS", "VALUES"), operation.value, strict=True):
                cells = ", ".join(map(repr, row))
                tables.append(f"static const double {label}{number}[{len(row)}] = {{{cells}}};")
            return (
                f"interpolate({arguments[0]}, KNOTS{number}, VALUES{number}, "
                f"{len(operation.value[0])})"
            )
        return f"{_CALLS.get(operation.name, operation.name)}({', '.join(arguments)})"

    assignments, texts = statements(formulas, results, names, special)
    lines = [
        f"static void {name}(double t, const double *x, const double *u, const double *p, "
        "double *out)",
        "{",
        *(f"    const double {variable} = {formula};" for variable, formula in assignments),
        *(f"    out[{i}] = {text};" for i, text in enumerate(texts)),
        "}",
    ]
    return "\n".join(lines)


def _text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
