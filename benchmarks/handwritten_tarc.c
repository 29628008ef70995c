/* A step of literal TARC by hand, as an engineer would write it for one robot: a ring buffer, loops over the joints, the
 * prediction only where a sample is missing. benchmarks/export.py writes parameters.h and compares it with the C of
 * `tarc export c`, whose input and output it takes.
 */
#include "handwritten_tarc.h"
#include "parameters.h"

#include <math.h>
#include <string.h>

static int is_finite(double value)
{
  return fabs(value) <= 1e100;
}

static int are_finite(const double *values)
{
  for (int i = 0; i < JOINTS; ++i)
    if (!is_finite(values[i]))
      return 0;
  return 1;
}

void hand_reset(hand_t *self, const double *position, const double *torque)
{
  memset(self, 0, sizeof *self);
  for (int k = 0; k < SAMPLES; ++k)
    memcpy(self->window[k], position, sizeof self->window[k]);
  memcpy(self->torque, torque, sizeof self->torque);
  memcpy(self->reference, position, sizeof self->reference);
  self->gain = START_GAIN;
}

/* Sum of the window with weights for the newest sample first. */
static double weighted(const hand_t *self, const double *weights, int joint)
{
  double sum = 0;
  for (int k = 0, row = self->newest; k < SAMPLES; ++k, row = row + 1 == SAMPLES ? 0 : row + 1)
    sum += weights[k] * self->window[row][joint];
  return sum;
}

void hand_step(hand_t *self, const arm_input *in, arm_output *out)
{
  double position[JOINTS], velocity[JOINTS] = {0}, acceleration[JOINTS] = {0}, error[JOINTS], torque[JOINTS];
  const int has_position = are_finite(in->position);
  const int has_reference = are_finite(in->reference) && are_finite(in->velocity_reference) &&
                            are_finite(in->acceleration_reference);
  for (int i = 0; i < JOINTS; ++i)
    position[i] = is_finite(in->position[i]) ? in->position[i] : weighted(self, PREDICTION, i);
  self->newest = self->newest == 0 ? SAMPLES - 1 : self->newest - 1;
  memcpy(self->window[self->newest], position, sizeof position);
  for (int k = 0, row = self->newest; k < SAMPLES; ++k, row = row + 1 == SAMPLES ? 0 : row + 1)
    for (int i = 0; i < JOINTS; ++i) {
      velocity[i] += VELOCITY[k] * self->window[row][i];
      acceleration[i] += ACCELERATION[k] * self->window[row][i];
    }

  self->missing = has_position && has_reference ? 0 : self->missing + 1;
  if (self->missing > MAX_MISSING)
    self->fault = 1;
  if (has_reference)
    memcpy(self->reference, in->reference, sizeof self->reference);

  double square = 0;
  for (int i = 0; i < JOINTS; ++i) {
    error[i] = position[i] - self->reference[i];
    square += error[i] * error[i];
  }
  const double size = sqrt(square);
  const double slope = self->gain / (size > LAYER ? size : LAYER);
  int torque_ok = !self->fault;
  for (int i = 0; i < JOINTS; ++i) {
    const double applied = is_finite(in->applied_torque[i]) ? in->applied_torque[i] : self->torque[i];
    const double wanted_velocity = has_reference ? in->velocity_reference[i] : 0;
    const double wanted_acceleration = has_reference ? in->acceleration_reference[i] : 0;
    const double u = wanted_acceleration - VELOCITY_GAIN * (velocity[i] - wanted_velocity) -
                     POSITION_GAIN * error[i] - slope * error[i];
    out->auxiliary[i] = u;
    torque[i] = INERTIA * (u - self->acceleration[i]) + applied;
    torque_ok = torque_ok && is_finite(torque[i]);
  }
  for (int i = 0; i < JOINTS; ++i) {
    const double one = torque_ok ? torque[i] : 0;
    self->torque[i] = one > TORQUE_LIMIT ? TORQUE_LIMIT : one < -TORQUE_LIMIT ? -TORQUE_LIMIT : one;
  }
  memcpy(out->torque, self->torque, sizeof out->torque);
  memcpy(out->velocity_estimate, velocity, sizeof velocity);
  memcpy(self->acceleration, acceleration, sizeof acceleration);

  const int rising = self->gain <= MIN_GAIN || size > self->size;
  out->gain = self->gain;
  out->rising = rising;
  out->missing = self->missing;
  out->fault = self->fault;
  if (!self->fault) {
    self->gain += PERIOD * (rising ? RISE_RATE : -FALL_RATE) * size;
    if (self->gain < MIN_GAIN)
      self->gain = MIN_GAIN;
  }
  self->size = size;
}
