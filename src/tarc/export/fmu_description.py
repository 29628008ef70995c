"""Model description of an FMU, by FMI 2.0 and 3.0."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from tarc.core.version import __version__
from tarc.export.fmu_platforms import OVERRIDE
from tarc.export.fmu_variables import Variable

HEADER = '<?xml version="1.0" encoding="UTF-8"?>'
CAUSALITY = {
    "INPUT": ("input", "continuous", ""),
    "OUTPUT": ("output", "discrete", "calculated"),
    "FIXED": ("parameter", "fixed", "exact"),
    "TUNABLE": ("parameter", "tunable", "exact"),
    "INDEPENDENT": ("independent", "continuous", ""),
}
"""Causality, variability and initial of each role."""
TYPES = {
    "2.0": {"REAL": "Real", "INTEGER": "Integer", "BOOLEAN": "Boolean"},
    "3.0": {"REAL": "Float64", "INTEGER": "Int32", "BOOLEAN": "Boolean"},
}
CATEGORIES = ("logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError")


@dataclass(frozen=True)
class FmuFacts:
    """What a model description says beside the variables.

    Attributes
    ----------
    identifier, title
        Name in C, and text.
    token
        GUID of FMI 2.0, instantiation token of FMI 3.0.
    period
        Control period [s].
    sources
        Files to compile.
    """

    identifier: str
    title: str
    token: str
    period: float
    sources: tuple[str, ...]


def description_2(facts: FmuFacts, variables: Sequence[Variable]) -> str:
    """Return ``modelDescription.xml`` of FMI 2.0, for co-simulation and model exchange."""
    elements = list(_elements(variables))
    outputs = [k + 1 for k, (variable, _) in enumerate(elements) if variable.role == "OUTPUT"]
    lines = [
        HEADER,
        _open(
            "fmiModelDescription",
            fmiVersion="2.0",
            modelName=facts.identifier,
            guid=facts.token,
            description=facts.title,
            generationTool=f"tarc-control {__version__}",
            variableNamingConvention="structured",
            numberOfEventIndicators="0",
        ),
    ]
    flags = {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
    flags |= {"canNotUseMemoryManagementFunctions": "true"}
    for kind, more in (
        ("ModelExchange", {"completedIntegratorStepNotNeeded": "true"}),
        ("CoSimulation", {"canHandleVariableCommunicationStepSize": "false"}),
    ):
        files = "".join(_tag("File", name=name) for name in facts.sources)
        lines.append(_open(kind, modelIdentifier=facts.identifier, **more, **flags))
        lines.append(f"<SourceFiles>{files}</SourceFiles></{kind}>")
    lines.append("<LogCategories>" + "".join(_tag("Category", name=name) for name in CATEGORIES) + "</LogCategories>")
    lines.append(_tag("DefaultExperiment", startTime="0", stepSize=repr(facts.period)))
    lines.append("<ModelVariables>")
    for variable, index in elements:
        attributes = _value_attributes(variable, [index])
        lines.append(
            _open(
                "ScalarVariable",
                name=variable.element_name(index),
                valueReference=str(variable.reference + index),
                description=variable.element_description(index),
                **_role_attributes(variable),
            )
            + _tag(TYPES["2.0"][variable.kind], **attributes)
            + "</ScalarVariable>"
        )
    lines.append("</ModelVariables><ModelStructure>")
    # what was sampled sets the outputs, which no input changes before the next sample
    lines.append("<Outputs>" + "".join(_tag("Unknown", index=str(k), dependencies="") for k in outputs) + "</Outputs>")
    initial = "".join(_tag("Unknown", index=str(k)) for k in outputs)
    lines.append(f"<InitialUnknowns>{initial}</InitialUnknowns>")
    return "\n".join([*lines, "</ModelStructure></fmiModelDescription>", ""])


def description_3(facts: FmuFacts, variables: Sequence[Variable]) -> str:
    """Return ``modelDescription.xml`` of FMI 3.0, for co-simulation and model exchange, with arrays."""
    lines = [
        HEADER,
        _open(
            "fmiModelDescription",
            fmiVersion="3.0",
            modelName=facts.identifier,
            instantiationToken=facts.token,
            description=facts.title,
            generationTool=f"tarc-control {__version__}",
            variableNamingConvention="structured",
        ),
    ]
    flags = {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
    lines.append(_tag("ModelExchange", modelIdentifier=facts.identifier, **flags))
    step = {"fixedInternalStepSize": repr(facts.period), "hasEventMode": "true"}
    lines.append(_tag("CoSimulation", modelIdentifier=facts.identifier, **flags, **step))
    lines.append("<LogCategories>" + "".join(_tag("Category", name=name) for name in CATEGORIES) + "</LogCategories>")
    lines.append(_tag("DefaultExperiment", startTime="0", stepSize=repr(facts.period)))
    lines.append("<ModelVariables>")
    for variable in variables:
        kind = TYPES["3.0"][variable.kind]
        attributes = {
            "name": variable.name,
            "valueReference": str(variable.reference),
            "description": _with_joints(variable),
            **_role_attributes(variable),
            **_value_attributes(variable, range(variable.count)),
        }
        if variable.size:
            dimension = _tag("Dimension", start=str(variable.size))
            lines.append(_open(kind, **attributes) + f"{dimension}</{kind}>")
        else:
            lines.append(_tag(kind, **attributes))
    lines.append("</ModelVariables><ModelStructure>")
    outputs = [variable.reference for variable in variables if variable.role == "OUTPUT"]
    lines += [_tag("Output", valueReference=str(reference), dependencies="") for reference in outputs]
    lines += [_tag("InitialUnknown", valueReference=str(reference)) for reference in outputs]
    return "\n".join([*lines, "</ModelStructure></fmiModelDescription>", ""])


def build_description(facts: FmuFacts) -> str:
    """Return ``sources/buildDescription.xml`` of FMI 3.0."""
    files = "".join(_tag("SourceFile", name=name) for name in facts.sources)
    files += _tag("PreprocessorDefinition", name=OVERRIDE, optional="true", description="for a shared library")
    options = _open("SourceFileSet", language="C99", compilerOptions="-ffp-contract=off")
    configuration = _open("BuildConfiguration", modelIdentifier=facts.identifier)
    return "\n".join(
        [
            HEADER,
            _open("fmiBuildDescription", fmiVersion="3.0"),
            f"{configuration}{options}{files}</SourceFileSet></BuildConfiguration>",
            "</fmiBuildDescription>",
            "",
        ]
    )


def _elements(variables: Sequence[Variable]) -> Iterator[tuple[Variable, int]]:
    for variable in variables:
        for index in range(variable.count):
            yield variable, index


def _with_joints(variable: Variable) -> str:
    return f"{variable.description}: {', '.join(variable.joints)}" if variable.joints else variable.description


def _role_attributes(variable: Variable) -> dict[str, str]:
    causality, variability, initial = CAUSALITY[variable.role]
    return {"causality": causality, "variability": variability, **({"initial": initial} if initial else {})}


def _value_attributes(variable: Variable, elements: Sequence[int]) -> dict[str, str]:
    """Return limits and start values; limits of an array only where all of its elements have the same ones."""
    attributes = {}
    for name, values in (("min", variable.least), ("max", variable.greatest)):
        own = {values[index] for index in elements} if values else set()
        if len(own) == 1:
            attributes[name] = repr(own.pop())
    if variable.start:
        attributes["start"] = " ".join(_number(variable, variable.start[index]) for index in elements)
    return attributes


def _number(variable: Variable, value: float) -> str:
    if variable.kind == "BOOLEAN":
        return "true" if value else "false"
    return repr(value) if variable.kind == "REAL" else str(int(value))


def _open(tag: str, /, **attributes: str) -> str:
    """Return a tag with attributes, without its end."""
    return f"<{tag}{_attributes(attributes)}>"


def _tag(tag: str, /, **attributes: str) -> str:
    """Return an element with attributes, without content."""
    return f"<{tag}{_attributes(attributes)}/>"


def _attributes(attributes: Mapping[str, str]) -> str:
    return "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items())
