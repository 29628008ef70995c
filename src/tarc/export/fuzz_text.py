"""Absurd inputs for exported C, written in C: no torque is NaN or beyond its limit."""

from string import Template

from tarc.core import array_ops as ops
from tarc.core.c_constants import Constants
from tarc.export.c_source import CSource

FUZZ = Template("""/* Absurd inputs: NaN, infinities, huge numbers, denormals, random bits, lost samples and references.
 *
 * Arguments: number of steps, by default 100000, and seed. Exit status 0 where no torque was NaN or beyond its limit.
 */
#include "${name}.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef ${name}_real real;
typedef $bits bits;

static const real limits[${NAME}_JOINTS] = {$limits};
static uint64_t random_state;

static uint64_t random_bits(void)
{
  random_state ^= random_state << 13;
  random_state ^= random_state >> 7;
  random_state ^= random_state << 17;
  return random_state * UINT64_C(2685821657736338717);
}

/* Uniform between -1 and 1. */
static real uniform(void)
{
  return (real)((double)(random_bits() >> 11) / 4503599627370496.0 - 1.0);
}

static real from_bits(bits pattern)
{
  real value;
  memcpy(&value, &pattern, sizeof value);
  return value;
}

static real absurd(void)
{
  switch (random_bits() % 10) {
  case 0: return (real)NAN;
  case 1: return (real)INFINITY;
  case 2: return -(real)INFINITY;
  case 3: return $huge;
  case 4: return -$huge;
  case 5: return from_bits(1); /* the smallest denormal */
  case 6: return -$zero;
  case 7: return $bound * uniform();
  default: return from_bits((bits)(random_bits() >> $shift));
  }
}

/* A number near another, or with a chance of one in some an absurd one. */
static real near(real middle, real width, unsigned chance)
{
  return random_bits() % chance == 0 ? absurd() : middle + width * uniform();
}

int main(int argc, char **argv)
{
  static ${name}_t law;
  ${name}_input in;
  ${name}_output out;
  real start[${NAME}_JOINTS], torque[${NAME}_JOINTS];
  const long steps = argc > 1 ? strtol(argv[1], NULL, 10) : 100000;
  long beyond = 0, not_finite = 0, statuses[4] = {0, 0, 0, 0}, refused = 0;
  int lost = 0;
  random_state = argc > 2 ? strtoull(argv[2], NULL, 10) * 2 + 1 : 88172645463325252u;
  memset(start, 0, sizeof start);
  for (long k = 0; k < steps; ++k) {
    static const unsigned chances[3] = {400, 60, 4}; /* mostly well to mostly absurd */
    const unsigned chance = chances[k / 1000 % 3];
    if (random_bits() % 60 == 0 || k == 0) {
      for (int i = 0; i < ${NAME}_JOINTS; ++i) {
        start[i] = near($zero, $one, 20);
        torque[i] = near($zero, $hundred, 20);
      }
      refused += ${name}_reset(&law, start, torque) == ${NAME}_BAD_INPUT;
    }
    if (random_bits() % 200 == 0)
      lost = (int)(random_bits() % 16);
    for (int i = 0; i < ${NAME}_JOINTS; ++i) {
      in.position[i] = near(start[i], $small, chance);
      in.reference[i] = near(start[i], $small, chance);
      in.velocity_reference[i] = near($zero, $one, chance);
      in.acceleration_reference[i] = near($zero, $one, chance);
      in.applied_torque[i] = random_bits() % 2 ? (real)NAN : near($zero, $hundred, chance);
      if (lost > 0 && lost % 2)
        in.position[i] = NAN;
      else if (lost > 0)
        in.reference[i] = NAN;
    }
    lost -= lost > 0;
$elapsed    const ${name}_status status = ${name}_step(&law, &in, &out);
    ++statuses[status];
    for (int i = 0; i < ${NAME}_JOINTS; ++i) {
      not_finite += !($fabs(out.torque[i]) <= $bound);
      beyond += $fabs(out.torque[i]) > limits[i];
    }
  }
  printf("%ld absurd steps: %ld torques not finite, %ld beyond their limit; %ld steps good, %ld with missing samples, "
         "%ld in a fault, %ld before a start; %ld starts refused\\n",
         steps, not_finite, beyond, statuses[${NAME}_OK], statuses[${NAME}_BAD_INPUT], statuses[${NAME}_FAULT],
         statuses[${NAME}_NOT_READY], refused);
  return not_finite != 0 || beyond != 0;
}
""")


def fuzz_text(source: CSource) -> str:
    """Return the program that gives a law absurd inputs."""
    constants = Constants(in_array=False, single=source.single, type_name=f"{source.name}_real")
    number = constants.number
    elapsed = f"    in.elapsed = near({number(source.traced.law.period)}, {number(1e-4)}, chance);\n"
    return FUZZ.substitute(
        name=source.name,
        NAME=source.name.upper(),
        bits="uint32_t" if source.single else "uint64_t",
        shift="32" if source.single else "0",
        limits=", ".join(number(float(limit)) for limit in source.traced.start_limits),
        huge="3e38f" if source.single else "1e200",
        bound=number(ops.HUGE),
        fabs=constants.text("fabs(")[:-1],
        elapsed=elapsed if source.traced.watch else "",
        **{name: number(value) for name, value in (("zero", 0.0), ("one", 1.0), ("small", 0.01), ("hundred", 100.0))},
    )
