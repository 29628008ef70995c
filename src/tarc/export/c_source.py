"""Header and source of a law in C99."""

from dataclasses import dataclass
from functools import cached_property
from string import Template

from tarc.core.c_constants import Constants
from tarc.core.c_emitter import Interface, definitions
from tarc.export.traced_law import Signal, TracedLaw

HEADER = Template("""/* $title
 *
 * Call ${name}_reset once with the first measured position, then ${name}_step once per period of $period s.
 * $units
 * Nothing is allocated; there are no global variables.
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${NAME}_JOINTS $n
#define ${NAME}_STATES $n_states
#define ${NAME}_PERIOD $period_literal

typedef $real ${name}_real;
$flags
/* Input of a step. A position or reference that is not finite counts as missing. applied_torque is what really acted in
 * answer to the step before; NAN where that is unknown. */
typedef struct {
  ${name}_real position[${NAME}_JOINTS];
  ${name}_real reference[${NAME}_JOINTS];
  ${name}_real velocity_reference[${NAME}_JOINTS];
  ${name}_real acceleration_reference[${NAME}_JOINTS];
  ${name}_real applied_torque[${NAME}_JOINTS];
$elapsed} ${name}_input;

/* Output of a step: the torque, whether samples are missing, and the signals of the law. */
typedef struct {
  ${name}_real torque[${NAME}_JOINTS];
  int missing; /* samples missing in a row */
  int fault;   /* 1 after too many: the safe torque is applied until the next reset */
$fields} ${name}_output;

/* The law's memory: plain data, which may be copied, and of which there may be several. */
typedef struct {
  ${name}_real x[2][${NAME}_STATES];
  int now;
  int ready;
} ${name}_t;

typedef enum { ${NAME}_OK, ${NAME}_NOT_READY, ${NAME}_BAD_INPUT, ${NAME}_FAULT } ${name}_status;

/* Start at rest at a measured position with a torque already applied, $null. ${NAME}_BAD_INPUT, and no change,
 * for numbers that are not finite. */
${name}_status ${name}_reset(${name}_t *self, const ${name}_real position[], const ${name}_real torque[]);

/* One control period. ${NAME}_NOT_READY before the first reset, with zero torque. ${NAME}_BAD_INPUT where this sample
 * was missing: the law bridges it, and the torque is to be applied. ${NAME}_FAULT where it has given up. */
${name}_status ${name}_step(${name}_t *self, const ${name}_input *in, ${name}_output *out);

/* Target torque of CiA 402, object 0x6071: thousandths of the rated torque, rounded and limited to 16 bits.
 * Zero for a torque that is not finite, and for a rated torque that is not above zero. */
short ${name}_cia402_torque(${name}_real torque, ${name}_real rated_torque);

#ifdef __cplusplus
}
#endif

#endif
""")

DIRECTIVES = """#include <math.h>
#include <stdbool.h>
#include <string.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "compile without -ffast-math and -ffinite-math-only: the law relies on comparisons with NAN"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__) /* also where a build system leaves the option out */
#pragma GCC optimize("fp-contract=off")
#endif
"""
"""Includes, and how the compiler must treat floating point."""

SOURCE = Template("""/* $title
 *
 * Compile with -ffp-contract=off, so that products and sums are rounded one by one, and without -ffast-math.
 */
#include "${name}.h"

$directives
$start
$step
/* Whether all of some numbers are finite. */
static bool are_finite(const ${name}_real *values, int count)
{
  bool result = true;
  for (int i = 0; i < count; ++i) {
    result = result && ($fabs(values[i]) <= $huge);
  }
  return result;
}

${name}_status ${name}_reset(${name}_t *self, const ${name}_real position[], const ${name}_real torque[])
{
  static const ${name}_real limits[${NAME}_JOINTS] = {$limits};
  ${name}_real applied[${NAME}_JOINTS];
  if (!are_finite(position, ${NAME}_JOINTS) || $torque_refused) {
    return ${NAME}_BAD_INPUT;
  }
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    const ${name}_real wanted = (torque != NULL) ? torque[i] : $zero;
    applied[i] = (wanted < -limits[i]) ? -limits[i] : ((wanted > limits[i]) ? limits[i] : wanted);
  }
  start_function(position, applied, self->x[0]);
  self->now = 0;
  self->ready = 1;
  return ${NAME}_OK;
}

${name}_status ${name}_step(${name}_t *self, const ${name}_input *in, ${name}_output *out)
{
  ${name}_status status;
  if (self->ready == 0) {
    (void)memset(out, 0, sizeof *out);
    return ${NAME}_NOT_READY;
  }
  ${name}_real *const state = self->x[self->now];
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    if ($fabs(in->applied_torque[i]) <= $huge) {
      state[$past_torque + i] = in->applied_torque[i];
    }
  }
  step_function(state, in, self->x[1 - self->now], out);
  self->now = 1 - self->now;
  if (out->fault != 0) {
    status = ${NAME}_FAULT;
  } else if (out->missing != 0) {
    status = ${NAME}_BAD_INPUT;
  } else {
    status = ${NAME}_OK;
  }
  return status;
}

short ${name}_cia402_torque(${name}_real torque, ${name}_real rated_torque)
{
  const ${name}_real share = $floor((($thousand * torque) / rated_torque) + $half);
  ${name}_real result = $zero;
  if ((rated_torque > $zero) && ($fabs(share) <= $huge)) {
    result = (share < $lowest) ? $lowest : ((share > $highest) ? $highest : share);
  }
  return (short)result;
}
""")


TORQUES = "Positions are in rad or m, torques in N m or N."

COMMANDS = """Positions are in rad or m. This law commands inner loops: what is called torque here is their set-point,
 * in {}. Zero is a set-point as well: apply none before the first reset,
 * and give the reset those that hold now."""

MAX_COUNT = 1e9
"""Largest count of missing samples that C reports."""

COUNTS = ("missing", "fault")
"""Signals that are counted: of the C type int."""

FLAG_COMMENTS = {"flags": " /* of this step, a sum of *_FLAG_* */", "flags_seen": " /* of all steps since the reset */"}
"""Signals that are sums of flags, of the C type unsigned, with what they are."""

INPUTS = ("position", "reference", "velocity_reference", "acceleration_reference")
"""Fields of the input that a step reads, in order."""


class _StartInterface(Interface):
    """Start: position and torque in, state out."""

    @property
    def parameters(self) -> str:
        return f"const {self.real} *position, const {self.real} *torque, {self.real} *state"

    def read(self, place: int, element: int) -> str:
        return f"{('position', 'torque')[place]}[{element}]"

    def written(self, place: int, element: int) -> str:
        return f"state[{element}]"


class _LawInterface(Interface):
    """Step: state and the input's fields in, next state and the output's fields out."""

    def __init__(self, constants: Constants, source: "CSource"):
        super().__init__(constants)
        self._source, self._constants = source, constants
        self._n_joints = source.traced.n_joints

    @property
    def parameters(self) -> str:
        name = self._source.name
        return f"const {self.real} *state, const {name}_input *in, {self.real} *next, {name}_output *out"

    def read(self, place: int, element: int) -> str:
        if place == 0:
            return f"state[{element}]"
        if element == len(INPUTS) * self._n_joints:
            return "in->elapsed"
        return f"in->{INPUTS[element // self._n_joints]}[{element % self._n_joints}]"

    def written(self, place: int, element: int) -> str:
        if place == 0:
            return f"next[{element}]"
        if element < self._n_joints:
            return f"out->torque[{element}]"
        signal = next(signal for signal in self._source.signals if signal.start <= element < signal.start + signal.size)
        index = "" if signal.size == 1 else f"[{element - signal.start}]"
        return f"out->{signal.name}{index}"

    def write(self, place: int, element: int, value: str) -> str:
        target = self.written(place, element)
        field = target.removeprefix("out->")
        if field == "missing":  # no int holds the count of weeks without a sample
            most = self._constants.number(MAX_COUNT)
            return f"  {target} = ({value} < {most}) ? (int){value} : {int(MAX_COUNT)};"
        cast = "(int)" if field in COUNTS else "(unsigned)" if field in FLAG_COMMENTS else ""
        return f"  {target} = {cast}{value};"

    def is_input_array(self, place: int) -> bool:
        return place == 0

    def has_copies(self, place: int) -> bool:
        return place == 0

    def is_output_array(self, place: int) -> bool:
        return place == 0


@dataclass(frozen=True)
class CSource:
    """The C of a traced law.

    Attributes
    ----------
    traced
        The law.
    name
        Prefix of all names, and of the files.
    single
        Whether numbers are of single precision.
    title
        First line of the comment in both files.
    commands
        Unit of what the law returns per joint, where it commands positions or velocities of inner loops.
    """

    traced: TracedLaw
    name: str
    single: bool
    title: str
    commands: tuple[str, ...] = ()

    @property
    def real(self) -> str:
        """Return the C type of the numbers."""
        return "float" if self.single else "double"

    @cached_property
    def header(self) -> str:
        """Return the header."""
        law = self.traced.law
        fields = "".join(f"  {self.name}_real {_field(signal)};\n" for signal in self._reals)
        fields += "".join(f"  unsigned {signal.name};{FLAG_COMMENTS[signal.name]}\n" for signal in self._flags)
        elapsed = f"  {self.name}_real elapsed; /* time since the last sample [s]; 0 or NAN where unknown */\n"
        return HEADER.substitute(
            self._names,
            period=f"{law.period:g}",
            period_literal=self._constants.number(law.period),
            n=law.n_joints,
            n_states=self.traced.n_states,
            real=self.real,
            fields=fields,
            elapsed=elapsed if self.traced.watch else "",
            flags=self._flag_definitions,
            null="never NULL" if self.commands else "NULL for none",
            units=COMMANDS.format(", ".join(self.commands)) if self.commands else TORQUES,
        )

    @cached_property
    def source(self) -> str:
        """Return the source."""
        constants = self._constants
        traced, number = self.traced, self._constants.number
        refused = f"(torque == NULL) || !are_finite(torque, {self.name.upper()}_JOINTS)"
        return SOURCE.substitute(
            self._names,
            directives=DIRECTIVES,
            start=definitions(traced.start, "start_function", constants, _StartInterface(constants)),
            step=definitions(traced.step, "step_function", constants, _LawInterface(constants, self)),
            torque_refused=refused if self.commands else f"((torque != NULL) && {refused.partition(' || ')[2]})",
            fabs=constants.text("fabs(")[:-1],
            floor=constants.text("floor(")[:-1],
            huge=number(1e100),
            zero=number(0.0),
            half=number(0.5),
            thousand=number(1000.0),
            lowest=number(-32768.0),
            highest=number(32767.0),
            limits=", ".join(number(float(limit)) for limit in traced.start_limits),
            past_torque=traced.past_torque,
        )

    @property
    def uses_library(self) -> bool:
        """Whether the law calls functions that C libraries round differently, such as sin."""
        return calls_library(self.source, self.single)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Return the fields of the output after the torque."""
        return (*self._counts, *self._reals, *self._flags)

    @property
    def _counts(self) -> list[Signal]:
        return [signal for signal in self.traced.signals if signal.name in COUNTS]

    @property
    def _reals(self) -> list[Signal]:
        return [signal for signal in self.traced.signals if signal.name not in (*COUNTS, *FLAG_COMMENTS)]

    @property
    def _flags(self) -> list[Signal]:
        return [signal for signal in self.traced.signals if signal.name in FLAG_COMMENTS]

    @property
    def _flag_definitions(self) -> str:
        """Return the flags by name with what each means, for the header."""
        watch = self.traced.watch
        if watch is None:
            return ""
        lines = [f"#define {self.name.upper()}_FLAG_{flag.name} {flag.value}u" for flag in watch.watched]
        return "\n/* What left the range that was certified; law.yaml has the ranges. */\n" + "\n".join(lines) + "\n"

    @property
    def _constants(self) -> Constants:
        return Constants(in_array=False, single=self.single, type_name=f"{self.name}_real")

    @property
    def _names(self) -> dict[str, str]:
        return {"name": self.name, "NAME": self.name.upper(), "title": self.title}


def _field(signal: Signal) -> str:
    return signal.name if signal.size == 1 else f"{signal.name}[{signal.size}]"


def calls_library(code: str, single: bool) -> bool:
    """Whether C calls functions that C libraries round differently, such as sin."""
    words = ("sin", "cos", "tan", "exp", "log", "pow", "hypot")
    return any(f"{word}{'f' if single else ''}(" in code for word in words)
