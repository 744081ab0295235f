"""Small co-simulation FMUs written in C by a test, for FMI 2.0 and 3.0: well-behaved ones, and ones that are not.

Every value is a double in `all`, and a variable's name is a macro for its first element. The model is the body of

    int advance(double *all, double t, double h, double *reached)

which returns an FMI status. What else a test wants of the FMU is an argument of `build`.
"""

from __future__ import annotations

import re
import subprocess
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy

HEADERS = Path(fmpy.__file__).parent / "c-code"
PLATFORM = {2: fmpy.platform, 3: fmpy.platform_tuple}
TYPES = {
    "Real": "double", "Integer": "int", "Boolean": "int", "Float64": "double", "Float32": "float", "Int32": "int32_t",
    "Int64": "int64_t", "UInt8": "uint8_t",
}  # fmt: skip


@dataclass
class Var:
    name: str
    causality: str
    unit: str = ""
    start: str = ""
    type: str = ""  # left out: Real or Float64
    variability: str = ""
    size: int = 1  # FMI 3.0: an array
    length: str = ""  # FMI 3.0: name of the structural parameter that is its size, of `size` at most


CELL = (
    Var("current_A", "input", "A", "0"),
    Var("ambient_degC", "input", "degC", "25"),
    Var("voltage_V", "output", "V"),
    Var("temperature_degC", "output", "degC"),
    Var("soc", "output", "1"),
    Var("soc_initial", "parameter", "1", "0.5"),
)
# A resistance of 0.1 ohm and 1 Ah; soc counts what was drawn, in all[6].
CELL_STEP = """
    all[6] += current_A * h / 3600;
    soc = soc_initial - all[6];
    voltage_V = 3 + soc - 0.1 * current_A;
    temperature_degC = ambient_degC;
    return 0;
"""
CELL_START = "soc = soc_initial; voltage_V = 3 + soc; temperature_degC = ambient_degC;"

UNITS = {
    "A": 'A="1"', "mA": 'A="1" factor="0.001"', "V": 'kg="1" m="2" s="-3" A="-1"',
    "mV": 'kg="1" m="2" s="-3" A="-1" factor="0.001"', "W": 'kg="1" m="2" s="-3"',
    "kW": 'kg="1" m="2" s="-3" factor="1000"', "K": 'K="1"', "degC": 'K="1" offset="273.15"',
    "%": 'factor="0.01"', "1": "", "Ah": 'A="1" s="1" factor="3600"',
}  # fmt: skip


def description(
    variables: Sequence[Var], fmi: int = 2, *, capabilities: str = "", experiment: str = "", more: str = ""
) -> str:
    """A valid modelDescription.xml; `capabilities` are attributes of CoSimulation, `more` elements within it."""
    _, references = _places(variables)
    units = "".join(
        f'<Unit name="{unit}"><BaseUnit {base}/></Unit>'
        for unit, base in UNITS.items()
        if any(variable.unit == unit for variable in variables)
    )
    lines = []
    for variable in variables:
        kind = variable.type or ("Real" if fmi == 2 else "Float64")
        is_float = kind in ("Real", "Float64", "Float32")
        is_parameter = "arameter" in variable.causality
        variability = variable.variability or ("fixed" if is_parameter else "continuous" if is_float else "discrete")
        names = f'name="{variable.name}" valueReference="{references[variable.name]}" causality="{variable.causality}"'
        value = f'unit="{variable.unit}" ' if variable.unit else ""
        value += f'start="{variable.start}" ' if variable.start else ""
        if fmi == 2:
            lines.append(f'<ScalarVariable {names} variability="{variability}"><{kind} {value}/></ScalarVariable>')
        else:
            length = f'start="{variable.size}"'
            if variable.length:
                length = f'valueReference="{references[variable.length]}"'
            shape = f"<Dimension {length}/>" if variable.size > 1 else ""
            lines.append(f'<{kind} {names} variability="{variability}" {value}>{shape}</{kind}>')
    outputs = [k for k, variable in enumerate(variables, start=1) if variable.causality == "output"]
    if fmi == 2:
        unknowns = "".join(f'<Unknown index="{k}"/>' for k in outputs)
        structure = f"<Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns>" if outputs else ""
        identity = 'guid="{token}"'
    else:
        lines.append('<Float64 name="time" valueReference="9999" causality="independent" variability="continuous"/>')
        of = [f'valueReference="{references[variables[k - 1].name]}"' for k in outputs]
        structure = "".join(f"<Output {each}/>" for each in of) + "".join(f"<InitialUnknown {each}/>" for each in of)
        identity = 'instantiationToken="{token}"'
    steps = "" if "canHandleVariableCommunicationStepSize" in capabilities else "canHandleVariableCommunicationStepSize"
    steps = f'{steps}="true"' if steps else ""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="{fmi}.0" modelName="tiny" {identity}>'
        f'<CoSimulation modelIdentifier="tiny" {steps} {capabilities}>{more}</CoSimulation>'
        + (f"<UnitDefinitions>{units}</UnitDefinitions>" if units else "")
        + (f"<DefaultExperiment {experiment}/>" if experiment else "")
        + f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    )


def source(variables: Sequence[Var], step: str, start: str, fmi: int, instantiate: str, declare: str) -> str:
    offsets, _ = _places(variables)
    symbols = {re.sub(r"\W", "_", name): offset for name, offset in offsets.items()}
    macros = "".join(f"#define {name} all[{offset}]\n" for name, offset in symbols.items())
    places = ",".join(str(offsets[variable.name]) for variable in variables)
    lengths = ",".join(
        f"(int)m->all[{offsets[variable.length]}]" if variable.length else str(variable.size) for variable in variables
    )
    begin = "".join(
        f"m->all[{offsets[variable.name] + k}] = {value};"
        for variable in variables
        if variable.start
        for k, value in enumerate(_numbers(variable))
    )
    return (
        f"#define FMI {fmi}\n#include <fmi{fmi}Functions.h>\n{_HEAD}{declare}\n{macros}"
        f"static int advance(double *all, double t, double h, double *reached)"
        f" {{ (void)t; (void)h; (void)reached; {step} }}\n"
        f"static void start(double *all) {{ (void)all; {start} }}\n"
        + "".join(f"#undef {name}\n" for name in symbols)
        + f"static const int places[] = {{{places}}};\n"
        f"static int length(Model *m, int k) {{ (void)m; const int lengths[] = {{{lengths}}}; return lengths[k]; }}\n"
        f"static Model *make(void) {{ Model *m = calloc(1, sizeof *m); {begin} {instantiate} return m; }}\n"
        + (_FMI2 if fmi == 2 else _FMI3)
        + "".join(_access(fmi, kind, ctype) for kind, ctype in TYPES.items() if (kind in _OF[2]) == (fmi == 2))
        + (_access(3, "Boolean", "bool") if fmi == 3 else "")
    )


def build(
    path: Path,
    variables: Sequence[Var] = CELL,
    step: str = CELL_STEP,
    start: str = CELL_START,
    *,
    fmi: int = 2,
    instantiate: str = "",
    declare: str = "",
    capabilities: str = "",
    experiment: str = "",
    sources_only: bool = False,
    replace: tuple[str, str] | None = None,
    link: Sequence[str] = (),
) -> Path:
    """Writes the FMU; `replace` alters its model description, which is valid otherwise. `link`: more to link with."""
    code = source(variables, step, start, fmi, instantiate, declare)
    more = '<SourceFiles><File name="tiny.c"/></SourceFiles>' if sources_only and fmi == 2 else ""
    text = description(variables, fmi, capabilities=capabilities, experiment=experiment, more=more)
    if replace is not None:
        assert replace[0] in text
        text = text.replace(*replace)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("resources/here.txt", "here")
        if sources_only:
            archive.writestr("sources/tiny.c", code)
            if fmi == 3:
                archive.writestr("sources/buildDescription.xml", _BUILD)
        else:
            file = path.with_suffix(".c")
            file.write_text(code)
            library = path.with_suffix(".so")
            command = ["cc", "-O0", "-shared", "-fPIC", f"-I{HEADERS}", "-o", str(library), str(file), "-lm", *link]
            subprocess.run(command, check=True)
            archive.write(library, f"binaries/{PLATFORM[fmi]}/tiny.so")
    return path


def _places(variables: Sequence[Var]) -> tuple[dict[str, int], dict[str, int]]:
    """Index of each variable's first element in `all`, and its value reference."""
    offsets, references, place = {}, {}, 0
    for k, variable in enumerate(variables):
        offsets[variable.name], references[variable.name] = place, k
        place += variable.size
    return offsets, references


def _numbers(variable: Var) -> list[str]:
    return [{"true": "1", "false": "0"}.get(text, text) for text in variable.start.split()]


_OF = {2: ("Real", "Integer", "Boolean")}

_HEAD = """
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <signal.h>
typedef struct { double all[4096]; double reached; int ended; } Model;
"""

_FMI2 = """
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
    const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type; (void)visible; (void)logging;
    char file[4096];
    if (strcmp(guid, "{token}") || strncmp(place, "file:///", 8)) return NULL;
    snprintf(file, sizeof file, "%s/here.txt", place + 7);
    if (access(file, R_OK)) { f->logger(NULL, name, fmi2Error, "error", "no %s, %d", "here.txt", 42); return NULL; }
    f->freeMemory(f->allocateMemory(4, 8));
    return make();
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real t, fmi2Boolean d, fmi2Real e)
    { (void)c; (void)a; (void)b; (void)t; (void)d; (void)e; return 0; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return 0; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { start(((Model *)c)->all); return 0; }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return 0; }
fmi2Status fmi2Reset(fmi2Component c) { (void)c; return fmi2Error; }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String x[])
    { (void)c; (void)r; (void)n; (void)x; return fmi2Error; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String x[])
    { (void)c; (void)r; (void)n; (void)x; return fmi2Error; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean n) {
    (void)n; Model *m = c; m->reached = t + h; return advance(m->all, t, h, &m->reached);
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *x)
    { (void)k; *x = ((Model *)c)->reached; return 0; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *x)
    { (void)k; *x = ((Model *)c)->reached < 0; return 0; }
"""

# Event mode: `advance` says by a status of 100 or more that an event has to be handled, which adds 1 to all[4095];
# all[4094] is when the next one is due, if it is not 0.
_FMI3 = """
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String place, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
    fmi3InstanceEnvironment e, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback u) {
    (void)name; (void)visible; (void)logging; (void)r; (void)n; (void)u; (void)early; (void)events;
    char file[4096];
    snprintf(file, sizeof file, "%shere.txt", place);
    if (strcmp(token, "{token}") || access(file, R_OK)) { log(e, fmi3Error, "error", "no such place"); return NULL; }
    return make();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { (void)c; return 0; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { (void)c; return 0; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean d,
    fmi3Float64 e) { (void)c; (void)a; (void)b; (void)t; (void)d; (void)e; return 0; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { start(((Model *)c)->all); return 0; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { ((Model *)c)->all[4095] += 1; return 0; }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { (void)c; return 0; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *need, fmi3Boolean *end, fmi3Boolean *a, fmi3Boolean *b,
    fmi3Boolean *d, fmi3Float64 *t) {
    double next = ((Model *)c)->all[4094];
    *need = *end = *a = *b = false; *d = next > 0; *t = next; return 0;
}
fmi3Status fmi3Terminate(fmi3Instance c) { (void)c; return 0; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean n, fmi3Boolean *event, fmi3Boolean *end,
    fmi3Boolean *early, fmi3Float64 *last) {
    (void)n; Model *m = c; m->reached = t + h;
    int status = advance(m->all, t, h, &m->reached);
    *event = status >= 100; *end = m->reached < 0; *early = m->reached < t + h;
    *last = m->reached;
    return status % 100;
}
"""


def _access(fmi: int, kind: str, ctype: str) -> str:
    more = ", size_t size" if fmi == 3 else ""
    const = f"fmi{fmi}ValueReference"
    loop = "for (size_t i = 0, at = 0; i < n; i++) for (int k = 0; k < length(m, r[i]); k++, at++)"
    unused = "(void)size;" if fmi == 3 else ""
    return (
        f"fmi{fmi}Status fmi{fmi}Get{kind}(void *c, const {const} r[], size_t n, {ctype} x[]{more})"
        f" {{ Model *m = c; {unused} {loop} x[at] = ({ctype})m->all[places[r[i]] + k]; return 0; }}\n"
        f"fmi{fmi}Status fmi{fmi}Set{kind}(void *c, const {const} r[], size_t n, const {ctype} x[]{more})"
        f" {{ Model *m = c; {unused} {loop} m->all[places[r[i]] + k] = (double)x[at]; return 0; }}\n"
    )


_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="tiny"><SourceFileSet language="C99">
<SourceFile name="tiny.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>
"""
