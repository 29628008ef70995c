/* Literal TARC by hand, beside that of `tarc export c`. */
#ifndef HANDWRITTEN_TARC_H
#define HANDWRITTEN_TARC_H

#include "arm.h"

#define JOINTS 6
#define SAMPLES 17

typedef struct {
  double window[SAMPLES][JOINTS], acceleration[JOINTS], torque[JOINTS], reference[JOINTS], gain, size;
  int newest, missing, fault;
} hand_t;

void hand_reset(hand_t *self, const double *position, const double *torque);
void hand_step(hand_t *self, const arm_input *in, arm_output *out);

#endif
