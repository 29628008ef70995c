/* Compares the exported step with that by hand over the recorded steps, then times both in turns. */
#define _POSIX_C_SOURCE 199309L
#include "handwritten_tarc.h"
#include "replay.h"

#include <stdio.h>
#include <time.h>

#define ROUNDS 60
#define STEPS 20000

static arm_input inputs[VECTORS];

static double seconds(void)
{
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(void)
{
  static arm_t exported;
  static hand_t by_hand;
  arm_output out, other;
  double position[ARM_JOINTS], torque[ARM_JOINTS], largest = 0, best[2] = {1e9, 1e9};
  int decisions = 0;
  for (int i = 0; i < ARM_JOINTS; ++i) {
    position[i] = number(vector_start[0][i]);
    torque[i] = number(vector_start[0][ARM_JOINTS + i]);
  }
  if (start(&exported))
    return 1;
  hand_reset(&by_hand, position, torque);
  replay_result result = {0, 0, 0};
  for (int k = 0; k < VECTORS; ++k) {
    fill(&inputs[k], vector_inputs[k]);
    (void)arm_step(&exported, &inputs[k], &out);
    hand_step(&by_hand, &inputs[k], &other);
    compare(&out, k, &result);
    for (int i = 0; i < ARM_JOINTS; ++i)
      largest = fmax(largest, fabs(out.torque[i] - other.torque[i]));
    decisions += out.missing != other.missing || out.fault != other.fault || out.rising != other.rising;
  }
  for (int round = 0; round < ROUNDS; ++round) {
    double begin = seconds();
    for (int k = 0; k < STEPS; ++k)
      (void)arm_step(&exported, &inputs[k % VECTORS], &out);
    best[0] = fmin(best[0], seconds() - begin);
    begin = seconds();
    for (int k = 0; k < STEPS; ++k)
      hand_step(&by_hand, &inputs[k % VECTORS], &other);
    best[1] = fmin(best[1], seconds() - begin);
  }
  printf("%ld %.3g %d %.1f %.1f\n", result.different, largest, decisions, 1e9 * best[0] / STEPS, 1e9 * best[1] / STEPS);
  return !is_right(&result);
}
