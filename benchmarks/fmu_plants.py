"""FMUs of a cart on a spring in C, compiled here: model exchange of FMI 2 and 3."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

FMI2 = """
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"
typedef struct { double t, v[N]; } Plant;
static Plant *P(fmi2Component c) { return (Plant *)c; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean b, size_t n, const fmi2String s[])
{ return fmi2OK; }
static void start(Plant *p) { double v[N] = {START}; memcpy(p->v, v, sizeof v); p->t = 0; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type k, fmi2String g, fmi2String r,
  const fmi2CallbackFunctions *f, fmi2Boolean a, fmi2Boolean b)
{ Plant *p = calloc(1, sizeof *p); start(p); return p; }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real t,
  fmi2Boolean d, fmi2Real e) { P(c)->t = t; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { start(P(c)); return fmi2OK; }
static void solve(Plant *p) { double *V = p->v, t = p->t; (void)t; LAW }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real x[])
{ solve(P(c)); for (size_t i = 0; i < n; i++) x[i] = P(c)->v[r[i]]; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real x[])
{ for (size_t i = 0; i < n; i++) P(c)->v[r[i]] = x[i]; return fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *e)
{ memset(e, 0, sizeof *e); return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean a, fmi2Boolean *b,
  fmi2Boolean *d) { *b = *d = 0; return fmi2OK; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { P(c)->t = t; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{ memcpy(P(c)->v, x, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{ memcpy(x, P(c)->v, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real x[], size_t n)
{ solve(P(c)); memcpy(x, P(c)->v + n, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real x[], size_t n) { return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{ for (size_t i = 0; i < n; i++) x[i] = 1; return fmi2OK; }
"""
FMI3 = """
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"
typedef struct { double t, v[N]; } Plant;
static Plant *P(fmi3Instance c) { return (Plant *)c; }
const char *fmi3GetVersion(void) { return "3.0"; }
static void start(Plant *p) { double v[N] = {START}; memcpy(p->v, v, sizeof v); p->t = 0; }
fmi3Instance fmi3InstantiateModelExchange(fmi3String n, fmi3String g, fmi3String r, fmi3Boolean a,
  fmi3Boolean b, fmi3InstanceEnvironment e, fmi3LogMessageCallback l)
{ Plant *p = calloc(1, sizeof *p); start(p); return p; }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t,
  fmi3Boolean d, fmi3Float64 e) { P(c)->t = t; return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { start(P(c)); return fmi3OK; }
static void solve(Plant *p) { double *V = p->v, t = p->t; (void)t; LAW }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 x[],
  size_t m) { solve(P(c)); for (size_t i = 0; i < n; i++) x[i] = P(c)->v[r[i]]; return fmi3OK; }
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
  const fmi3Float64 x[], size_t m)
{ for (size_t i = 0; i < n; i++) P(c)->v[r[i]] = x[i]; return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *d,
  fmi3Boolean *e, fmi3Boolean *f, fmi3Float64 *g)
{ *a = *b = *d = *e = *f = 0; *g = 0; return fmi3OK; }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { P(c)->t = t; return fmi3OK; }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n)
{ memcpy(P(c)->v, x, n * sizeof *x); return fmi3OK; }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n)
{ solve(P(c)); memcpy(x, P(c)->v + n, n * sizeof *x); return fmi3OK; }
"""
DIRECTIONAL = """
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference y[], size_t n,
  const fmi2ValueReference x[], size_t m, const fmi2Real d[], fmi2Real r[])
{ double *V = P(c)->v; for (size_t i = 0; i < n; i++) { r[i] = 0;
  for (size_t j = 0; j < m; j++) r[i] += d[j] * (y[i] == 2 ? x[j] == 1 : SLOPE); } return fmi2OK; }
"""
LAW = "V[2] = V[1]; V[3] = (V[4] - V[6]*V[1] - V[7]*V[0])/V[5];"
"""States q v, rates, input F, parameters m c k."""
START = "0.1, 0, 0, 0, 0, 2.0, 0.5, 8.0"
SLOPE = "(x[j] == 0 ? -V[7] : x[j] == 1 ? -V[6] : 1.0)/V[5]"
VARIABLES = (
    ("q", "local", "continuous", "exact", "m", ""),
    ("v", "local", "continuous", "exact", "m/s", ""),
    ("der(q)", "local", "continuous", "calculated", "m/s", "1"),
    ("der(v)", "local", "continuous", "calculated", "m/s2", "2"),
    ("F", "input", "continuous", "", "N", ""),
    ("m", "parameter", "tunable", "exact", "kg", ""),
    ("c", "parameter", "tunable", "exact", "N.s/m", ""),
    ("k", "parameter", "fixed", "exact", "N/m", ""),
)


def compiler() -> str | None:
    """Return the C compiler of this machine; None where there is none, or no Linux."""
    return shutil.which("gcc") if sys.platform == "linux" else None


def cart_fmu(
    folder: Path,
    law: str = LAW,
    version: int = 2,
    slope: str = "",
    name: str = "plant",
    starts: str = START,
) -> Path:
    """Compile a cart with a spring as an FMU for model exchange.

    Parameters
    ----------
    folder : Path
    law : str
        C that computes V[2] and V[3], the rates of q and v.
    version : int
        Of FMI, 2 or 3.
    slope : str
        C of d V[3] / d V[x[j]], for directional derivatives; empty for none.
    name : str
    starts : str
        Values of the variables to begin with, in their order.
    """
    import fmpy
    from fmpy import fmi2, fmi3

    headers = Path(fmpy.__file__).parent / "c-code"
    text = (FMI2 if version == 2 else FMI3).replace("LAW", law).replace("START", starts)
    if slope:
        text += DIRECTIONAL.replace("SLOPE", slope)
    # FMPy asks for every function of the standard; those that are not called need not do anything.
    needed = [n for n in dir(fmi2.FMU2Model if version == 2 else fmi3.FMU3Model) if n[:3] == "fmi"]
    rest = "\n".join(f"int {n}(void) {{ return 3; }}" for n in needed if f"{n}(" not in text)
    source, stubs, library = (folder / f"{name}{end}" for end in (".c", "_rest.c", ".so"))
    source.write_text("#include <math.h>\n" + text.replace("[N]", f"[{len(VARIABLES)}]"))
    stubs.write_text(rest)
    files = [str(source), str(stubs), "-lm", "-o", str(library)]
    command = ["gcc", "-shared", "-fPIC", "-O1", "-w", f"-I{headers}", *files]
    subprocess.run(command, check=True, capture_output=True)
    place = "linux64" if version == 2 else "x86_64-linux"
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        text = description(version, bool(slope), name, starts)
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{place}/{name}.so")
    return path


def description(version: int, directional: bool, name: str, starts: str = START) -> str:
    """Return the modelDescription.xml of the cart."""
    lines, whole = [], VARIABLES
    for i, (n, causality, variability, initial, unit, of) in enumerate(whole):
        start = "" if of else starts.split(", ")[i]
        first = f' initial="{initial}"' if initial else ""
        value = f' start="{start}"' if start else ""
        if version == 2:
            rate = f' derivative="{of}"' if of else ""
            lines.append(
                f'<ScalarVariable name="{n}" valueReference="{i}" causality="{causality}" '
                f'variability="{variability}"{first}><Real{value} unit="{unit}"{rate}/>'
                "</ScalarVariable>"
            )
        else:
            rate = f' derivative="{int(of) - 1}"' if of else ""
            lines.append(
                f'<Float64 name="{n}" valueReference="{i}" causality="{causality}" '
                f'variability="{variability}"{first}{value} unit="{unit}"{rate}/>'
            )
    units = "".join(f'<Unit name="{u}"/>' for u in dict.fromkeys(v[4] for v in whole))
    told = ' providesDirectionalDerivative="true"' if directional else ""
    if version == 2:
        return (
            f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" '
            f'modelName="{name}" guid="{{1}}" numberOfEventIndicators="0">'
            f'<ModelExchange modelIdentifier="{name}"{told}/>'
            f"<UnitDefinitions>{units}</UnitDefinitions>"
            f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure><Derivatives>"
            '<Unknown index="3"/><Unknown index="4"/></Derivatives></ModelStructure>'
            "</fmiModelDescription>"
        )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" '
        f'modelName="{name}" instantiationToken="{{1}}"><ModelExchange modelIdentifier="{name}"/>'
        f"<UnitDefinitions>{units}</UnitDefinitions>"
        f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>"
        '<ContinuousStateDerivative valueReference="2"/>'
        '<ContinuousStateDerivative valueReference="3"/></ModelStructure></fmiModelDescription>'
    )
