"""C of the parts of a law, with places for what depends on the law."""

from string import Template

HEADER = Template("""/* Parts of $title, as functions of their own. They share no memory with ${name}_step. */
#ifndef ${NAME}_PARTS_H
#define ${NAME}_PARTS_H

#include "${name}.h"

#ifdef __cplusplus
extern "C" {
#endif

$declarations
#ifdef __cplusplus
}
#endif

#endif
""")

ESTIMATOR_HEADER = Template("""/* The law's estimator of velocity and acceleration: $kind,
 * one step per period of $period s. */
#define ${NAME}_ESTIMATOR_STATES $n_states

typedef struct {
  ${name}_real x[2][${NAME}_ESTIMATOR_STATES];
  int now;
  int ready;
} ${name}_estimator_t;

/* position is the measured one, or a prediction where it was missing, which valid says of each joint. */
typedef struct {
  ${name}_real position[${NAME}_JOINTS];
  ${name}_real velocity[${NAME}_JOINTS];
  ${name}_real acceleration[${NAME}_JOINTS];
  int valid[${NAME}_JOINTS];
} ${name}_estimate;

/* Start at rest at a measured position. ${NAME}_BAD_INPUT, and no change, for numbers that are not finite. */
${name}_status ${name}_estimator_reset(${name}_estimator_t *self, const ${name}_real position[]);

/* Take the sample of a period; NAN where it is missing. ${NAME}_NOT_READY before the first reset, with zeros. */
${name}_status ${name}_estimator_step(${name}_estimator_t *self, const ${name}_real position[], ${name}_estimate *out);

""")

INERTIA_HEADER = Template("""/* The law's nominal inertia at a position [kg m^2 or kg]; symmetric. */
void ${name}_inertia(const ${name}_real position[], ${name}_real inertia[${NAME}_JOINTS][${NAME}_JOINTS]);

""")

REFERENCE_HEADER = Template("""/* The reference at a time [s] and its two derivatives: $kind.
 * ${NAME}_BAD_INPUT, and NAN, for a time that is not finite. */
${name}_status ${name}_reference(${name}_real time, ${name}_real position[], ${name}_real velocity[],
                       ${name}_real acceleration[]);

""")

SOURCE = Template("""/* Parts of $title. Compile as ${name}.c. */
#include "${name}_parts.h"

$directives
$definitions""")

ESTIMATOR = Template("""$functions
${name}_status ${name}_estimator_reset(${name}_estimator_t *self, const ${name}_real position[])
{
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    if (!($fabs(position[i]) <= $huge)) {
      return ${NAME}_BAD_INPUT;
    }
  }
  estimator_start(position, self->x[0]);
  self->now = 0;
  self->ready = 1;
  return ${NAME}_OK;
}

${name}_status ${name}_estimator_step(${name}_estimator_t *self, const ${name}_real position[], ${name}_estimate *out)
{
  ${name}_status status = ${NAME}_OK;
  (void)memset(out, 0, sizeof *out);
  if (self->ready == 0) {
    return ${NAME}_NOT_READY;
  }
  estimator_step(self->x[self->now], position, self->x[1 - self->now], out);
  self->now = 1 - self->now;
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    if (out->valid[i] == 0) {
      status = ${NAME}_BAD_INPUT;
    }
  }
  return status;
}

""")

INERTIA = Template("""$functions
void ${name}_inertia(const ${name}_real position[], ${name}_real inertia[${NAME}_JOINTS][${NAME}_JOINTS])
{
  inertia_function(position, inertia);
}

""")

REFERENCE = Template("""$functions
${name}_status ${name}_reference(${name}_real time, ${name}_real position[], ${name}_real velocity[],
                       ${name}_real acceleration[])
{
  if (!($fabs(time) <= $huge)) {
    for (int i = 0; i < ${NAME}_JOINTS; ++i) {
      position[i] = NAN;
      velocity[i] = NAN;
      acceleration[i] = NAN;
    }
    return ${NAME}_BAD_INPUT;
  }
  reference_function(time, position, velocity, acceleration);
  return ${NAME}_OK;
}
""")

PIECES = Template("""#define PIECES $count

/* Position at rest before and after; between, polynomials in the time since the start of their piece. */
static void reference_function(${name}_real time, ${name}_real *position, ${name}_real *velocity,
                               ${name}_real *acceleration)
{
  static const ${name}_real starts[PIECES + 1] = {$starts};
  static const ${name}_real coefficients[PIECES][6][${NAME}_JOINTS] = {
$coefficients};
  static const ${name}_real end[${NAME}_JOINTS] = {$end};
  int first = 0;
  int last = PIECES;
  if ((time < starts[0]) || (time > starts[PIECES])) {
    for (int i = 0; i < ${NAME}_JOINTS; ++i) {
      position[i] = (time < starts[0]) ? coefficients[0][0][i] : end[i];
      velocity[i] = $zero;
      acceleration[i] = $zero;
    }
    return;
  }
  while ((last - first) > 1) {
    const int middle = (first + last) / 2;
    if (time < starts[middle]) {
      last = middle;
    } else {
      first = middle;
    }
  }
  const ${name}_real u = time - starts[first];
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    ${name}_real q = coefficients[first][5][i];
    ${name}_real v = $zero;
    ${name}_real a = $zero;
    for (int j = 4; j >= 0; --j) {
      a = (a * u) + v;
      v = (v * u) + q;
      q = (q * u) + coefficients[first][j][i];
    }
    position[i] = q;
    velocity[i] = v;
    acceleration[i] = $two * a;
  }
}

""")

TEST = Template("""/* Runs the parts and compares every bit with what Python computes. Exit status 0 where all agree. */
#include "${name}_parts.h"
#include "parts_vectors.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

typedef ${name}_real real;

static long different, wrong;

static real number(bits pattern)
{
  real value;
  memcpy(&value, &pattern, sizeof value);
  return value;
}

static void compare(real found, bits expected)
{
  bits pattern;
  memcpy(&pattern, &found, sizeof pattern);
  if (pattern == expected || (isnan(found) && isnan(number(expected))))
    return;
  ++different;
  if (!(fabs((double)found - (double)number(expected)) <= $tolerance * (1.0 + fabs((double)number(expected)))))
    ++wrong;
}

$functions
int main(void)
{
$calls  return PARTS_EXACT ? different != 0 : wrong != 0;
}
""")

ESTIMATOR_TEST = Template("""static void test_estimator(void)
{
  static ${name}_estimator_t self;
  ${name}_estimate out;
  real position[${NAME}_JOINTS];
  for (int i = 0; i < ${NAME}_JOINTS; ++i)
    position[i] = number(estimator_inputs[0][i]);
  if (${name}_estimator_step(&self, position, &out) != ${NAME}_NOT_READY ||
      ${name}_estimator_reset(&self, position) != ${NAME}_OK)
    ++wrong, ++different;
  for (int k = 0; k < ESTIMATOR_STEPS; ++k) {
    for (int i = 0; i < ${NAME}_JOINTS; ++i)
      position[i] = number(estimator_inputs[k][i]);
    (void)${name}_estimator_step(&self, position, &out);
    for (int i = 0; i < ${NAME}_JOINTS; ++i) {
      compare(out.position[i], estimator_outputs[k][i]);
      compare(out.velocity[i], estimator_outputs[k][${NAME}_JOINTS + i]);
      compare(out.acceleration[i], estimator_outputs[k][2 * ${NAME}_JOINTS + i]);
      compare((real)out.valid[i], estimator_outputs[k][3 * ${NAME}_JOINTS + i]);
    }
  }
}

""")

INERTIA_TEST = Template("""static void test_inertia(void)
{
  real position[${NAME}_JOINTS], inertia[${NAME}_JOINTS][${NAME}_JOINTS];
  for (int k = 0; k < INERTIA_STEPS; ++k) {
    for (int i = 0; i < ${NAME}_JOINTS; ++i)
      position[i] = number(inertia_inputs[k][i]);
    ${name}_inertia(position, inertia);
    for (int j = 0; j < ${NAME}_JOINTS; ++j)
      for (int i = 0; i < ${NAME}_JOINTS; ++i)
        compare(inertia[i][j], inertia_outputs[k][i + ${NAME}_JOINTS * j]);
  }
}

""")

REFERENCE_TEST = Template("""static void test_reference(void)
{
  real position[${NAME}_JOINTS], velocity[${NAME}_JOINTS], acceleration[${NAME}_JOINTS];
  for (int k = 0; k < REFERENCE_STEPS; ++k) {
    (void)${name}_reference(number(reference_inputs[k][0]), position, velocity, acceleration);
    for (int i = 0; i < ${NAME}_JOINTS; ++i) {
      compare(position[i], reference_outputs[k][i]);
      compare(velocity[i], reference_outputs[k][${NAME}_JOINTS + i]);
      compare(acceleration[i], reference_outputs[k][2 * ${NAME}_JOINTS + i]);
    }
  }
}

""")
