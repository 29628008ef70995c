/* The closed loop of a two-link arm under literal TARC by hand, as an engineer would write it for one study: quantised
 * encoders with noise from an array, ring buffers, two Runge-Kutta steps a period, measures added up on the way.
 * benchmarks/studies.py writes the sizes and weights into handwritten_loop.h and compares measures and time.
 */
#include "handwritten_loop.h"

#include <math.h>
#include <string.h>

typedef struct {
  double m11, m12, m22, a3, b1, b2, viscous[2];
} arm_t;

typedef struct {
  double squares, peak_error, changes, peak_torque, saturated, tde_squares, gain, peak_gain, over, under, count;
} sums_t;

static arm_t arm_of(const double *p)
{
  const double m1 = p[0], m2 = p[1], l1 = p[2], l2 = p[3], c1 = p[4], c2 = p[5], load = p[6], g = p[7];
  const double first = m1 * c1 * c1 + (m2 + load) * l1 * l1, second = m2 * c2 * c2 + load * l2 * l2;
  const arm_t arm = {first + second, second, second, (m2 * c2 + load * l2) * l1, (m1 * c1 + (m2 + load) * l1) * g,
                     (m2 * c2 + load * l2) * g, {p[8], p[9]}};
  return arm;
}

static void acceleration(const arm_t *arm, const double *q, const double *v, const double *torque, double *a)
{
  const double c = cos(q[1]), h = arm->a3 * sin(q[1]), both = arm->b2 * cos(q[0] + q[1]);
  const double m11 = arm->m11 + 2 * arm->a3 * c, m12 = arm->m12 + arm->a3 * c, m22 = arm->m22;
  const double r1 = torque[0] + h * v[1] * (2 * v[0] + v[1]) - arm->b1 * cos(q[0]) - both - arm->viscous[0] * v[0];
  const double r2 = torque[1] - h * v[0] * v[0] - both - arm->viscous[1] * v[1];
  const double d = 1 / (m11 * m22 - m12 * m12);
  a[0] = (m22 * r1 - m12 * r2) * d;
  a[1] = (m11 * r2 - m12 * r1) * d;
}

static void runge_kutta(const arm_t *arm, double *q, double *v, const double *torque, double dt, double *first)
{
  double a1[2], a2[2], a3[2], a4[2], v2[2], v3[2], v4[2], at[2];
  acceleration(arm, q, v, torque, a1);
  for (int i = 0; i < 2; ++i) {
    v2[i] = v[i] + dt / 2 * a1[i];
    at[i] = q[i] + dt / 2 * v[i];
  }
  acceleration(arm, at, v2, torque, a2);
  for (int i = 0; i < 2; ++i) {
    v3[i] = v[i] + dt / 2 * a2[i];
    at[i] = q[i] + dt / 2 * v2[i];
  }
  acceleration(arm, at, v3, torque, a3);
  for (int i = 0; i < 2; ++i) {
    v4[i] = v[i] + dt * a3[i];
    at[i] = q[i] + dt * v3[i];
  }
  acceleration(arm, at, v4, torque, a4);
  for (int i = 0; i < 2; ++i) {
    q[i] += dt / 6 * (v[i] + 2 * v2[i] + 2 * v3[i] + v4[i]);
    v[i] += dt / 6 * (a1[i] + 2 * a2[i] + 2 * a3[i] + a4[i]);
    first[i] = a1[i];
  }
}

static double quantised(double position)
{
  return STEP * floor(position / STEP + 0.5);
}

/* Returns the period in which the error was too large, or -1. */
long run(long periods, long measured, const double *reference, const double *noise, const double *start,
         const double *parameters, double *record, double *result)
{
  const arm_t arm = arm_of(parameters);
  double q[2] = {start[0], start[1]}, v[2] = {0, 0}, torque[2] = {start[2], start[3]};
  double window[SAMPLES][2], past_acceleration[2] = {0, 0}, past_torque[2] = {0, 0}, gain = START_GAIN, past_size = 0;
  double last_gain = 0, last_sliding = 0;
  sums_t sums = {0};
  int newest = 0;
  long ended = -1;
  for (int k = 0; k < SAMPLES; ++k)
    for (int i = 0; i < 2; ++i)
      window[k][i] = quantised(q[i] + noise[i]);
  for (long k = 0; k < periods; ++k, reference += 6, noise += 2) {
    double velocity[2] = {0, 0}, estimate[2] = {0, 0}, e[2], u[2], first[2], second[2];
    newest = newest == 0 ? SAMPLES - 1 : newest - 1;
    for (int i = 0; i < 2; ++i) {
      const double error = q[i] - reference[i];
      if (!(fabs(error) <= THRESHOLD))
        ended = k;
      window[newest][i] = quantised(q[i] + noise[i]);
      e[i] = window[newest][i] - reference[i];
    }
    if (ended >= 0)
      break;
    for (int n = 0, row = newest; n < SAMPLES; ++n, row = row + 1 == SAMPLES ? 0 : row + 1)
      for (int i = 0; i < 2; ++i) {
        velocity[i] += VELOCITY[n] * window[row][i];
        estimate[i] += ACCELERATION[n] * window[row][i];
      }
    const double size = sqrt(e[0] * e[0] + e[1] * e[1]);
    const double slope = gain / (size > LAYER ? size : LAYER);
    for (int i = 0; i < 2; ++i)
      u[i] = reference[4 + i] - VELOCITY_GAIN * (velocity[i] - reference[2 + i]) - POSITION_GAIN * e[i] - slope * e[i];
    for (int i = 0; i < 2; ++i)
      past_torque[i] = torque[i];
    for (int i = 0; i < 2; ++i)
      torque[i] = INERTIA[2 * i] * (u[0] - past_acceleration[0]) + INERTIA[2 * i + 1] * (u[1] - past_acceleration[1]) +
                  past_torque[i];
    memcpy(past_acceleration, estimate, sizeof estimate);

    const double true_error[2] = {q[0] - reference[0], q[1] - reference[1]};
    runge_kutta(&arm, q, v, torque, PERIOD / 2, first);
    runge_kutta(&arm, q, v, torque, PERIOD / 2, second);

    if (k == measured) {
      const sums_t none = {0};
      sums = none;
    }
    const double sliding = sqrt(true_error[0] * true_error[0] + true_error[1] * true_error[1]);
    for (int i = 0; i < 2; ++i) {
      const double tde_error = first[i] - u[i];
      sums.squares += true_error[i] * true_error[i];
      sums.peak_error = fmax(sums.peak_error, fabs(true_error[i]));
      sums.peak_torque = fmax(sums.peak_torque, fabs(torque[i]));
      sums.tde_squares += tde_error * tde_error;
      if (sums.count > 0)
        sums.changes += fabs(torque[i] - past_torque[i]);
      record[2 * k + i] = torque[i];
    }
    sums.gain += gain;
    sums.peak_gain = sums.count > 0 ? fmax(sums.peak_gain, gain) : gain;
    if (sums.count > 0) {
      sums.over += last_gain < gain && sliding < last_sliding;
      sums.under += gain < last_gain && last_sliding < sliding;
    }
    last_gain = gain;
    last_sliding = sliding;
    sums.count += 1;

    gain += PERIOD * (gain <= MIN_GAIN || size > past_size ? RISE_RATE : -FALL_RATE) * size;
    gain = gain < MIN_GAIN ? MIN_GAIN : gain > MAX_GAIN ? MAX_GAIN : gain;
    past_size = size;
  }
  result[0] = sqrt(sums.squares / (2 * sums.count));
  result[1] = sums.peak_error;
  result[2] = sums.changes / (PERIOD * (sums.count - 1));
  result[3] = sums.peak_torque;
  result[4] = sqrt(sums.tde_squares / (2 * sums.count));
  result[5] = sums.gain / sums.count;
  result[6] = sums.peak_gain;
  result[7] = sums.over / (sums.count - 1);
  result[8] = sums.under / (sums.count - 1);
  return ended;
}
