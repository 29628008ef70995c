/* Steps of an exported law as a filter: start and inputs from standard input, outputs to standard output, as bits. */
#include "replay.h"

#include <stdio.h>

int main(void)
{
  static arm_t law;
  arm_input in;
  arm_output out;
  bits first[2 * ARM_JOINTS], row[VECTOR_INPUTS];
  real position[ARM_JOINTS], torque[ARM_JOINTS], values[VECTOR_OUTPUTS];
  if (fread(first, sizeof first, 1, stdin) != 1)
    return 1;
  for (int i = 0; i < ARM_JOINTS; ++i) {
    position[i] = number(first[i]);
    torque[i] = number(first[ARM_JOINTS + i]);
  }
  if (arm_reset(&law, position, torque) != ARM_OK)
    return 1;
  while (fread(row, sizeof row, 1, stdin) == 1) {
    fill(&in, row);
    (void)arm_step(&law, &in, &out);
    collect(&out, values);
    if (fwrite(values, sizeof values, 1, stdout) != 1)
      return 1;
  }
  return 0;
}
