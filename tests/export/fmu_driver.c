/* Steps an FMU of FMI 2.0 with two joints as a co-simulation, then calls it at random, in all modes and with all numbers.
 *
 * Arguments: its token, and a file with inputs as doubles. It prints the bits of the torques, then the largest torque of
 * the random calls. Exit status 1 where one of them is not finite.
 */
#include "fmi2Functions.h"

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ROWS 60
#define PERIOD 1e-3
#define FIRST_INPUT 1
#define INPUTS 10
#define TORQUE 11
#define CALLS 200000

static void ignore(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
  (void)environment;
  (void)name;
  (void)status;
  (void)category;
  if (strchr(message, '%'))
    abort(); /* it is taken for a format */
}

static uint64_t random_state = 88172645463325252u;

static uint64_t random_number(void)
{
  random_state ^= random_state << 13;
  random_state ^= random_state >> 7;
  return random_state ^= random_state << 17;
}

static double any_double(void)
{
  static const double special[] = {0, 1e-3, -1e-3, 1, -1, 1e200, -1e200, INFINITY, -INFINITY, NAN, 1e-310, 2e-3};
  return random_number() % 4 ? special[random_number() % (sizeof special / sizeof *special)]
                             : (double)(int64_t)random_number() / 9e18;
}

static fmi2ValueReference torque_references[] = {TORQUE, TORQUE + 1};

static double largest_torque(fmi2Component fmu)
{
  double torque[2];
  if (fmi2GetReal(fmu, torque_references, 2, torque) != fmi2OK || !isfinite(torque[0]) || !isfinite(torque[1]))
    exit(1);
  return fmax(fabs(torque[0]), fabs(torque[1]));
}

/* One call out of all that a tool may make, with arguments that make sense now and then. */
static void call_at_random(fmi2Component fmu, fmi2FMUstate *state, double *time)
{
  const fmi2ValueReference reference = (fmi2ValueReference)(random_number() % 45);
  double value = any_double();
  int integer = 0, flag = 0;
  char bytes[64] = {0};
  size_t size;
  fmi2EventInfo info;
  switch (random_number() % 22) {
  case 0: fmi2SetReal(fmu, &reference, 1, &value); break;
  case 1: fmi2GetReal(fmu, &reference, 1, &value); break;
  case 2: fmi2GetInteger(fmu, &reference, 1, &integer); break;
  case 3: fmi2SetBoolean(fmu, &reference, 1, &flag); break;
  case 4: fmi2GetBoolean(fmu, &reference, 1, &flag); break;
  case 5: fmi2SetInteger(fmu, &reference, 1, &integer); break;
  case 6: fmi2GetFMUstate(fmu, state); break;
  case 7: if (*state) fmi2SetFMUstate(fmu, *state); break;
  case 8: fmi2FreeFMUstate(fmu, state); break;
  case 9: fmi2SerializedFMUstateSize(fmu, *state, &size); break;
  case 10: fmi2SerializeFMUstate(fmu, *state, bytes, sizeof bytes); break;
  case 11: fmi2DeSerializeFMUstate(fmu, bytes, sizeof bytes, state); break;
  case 12: fmi2EnterEventMode(fmu); break;
  case 13: fmi2NewDiscreteStates(fmu, &info); break;
  case 14: fmi2EnterContinuousTimeMode(fmu); break;
  case 15: fmi2SetTime(fmu, *time += random_number() % 3 ? PERIOD : value); break;
  case 16: fmi2DoStep(fmu, value, any_double(), fmi2True); break;
  case 17: fmi2SetupExperiment(fmu, fmi2False, 0, *time = value, fmi2False, 0); break;
  case 18: fmi2EnterInitializationMode(fmu); break;
  case 19: fmi2ExitInitializationMode(fmu); break;
  case 20: if (random_number() % 50 == 0) fmi2Terminate(fmu); break;
  default:
    if (fmi2DoStep(fmu, *time, PERIOD, fmi2True) == fmi2OK)
      *time += PERIOD;
    else if (random_number() % 20 == 0) {
      fmi2Reset(fmu);
      fmi2SetupExperiment(fmu, fmi2False, 0, *time = 0, fmi2False, 0);
      fmi2EnterInitializationMode(fmu);
      fmi2ExitInitializationMode(fmu);
    }
  }
}

int main(int count, char **arguments)
{
  const fmi2CallbackFunctions callbacks = {ignore, calloc, free, NULL, NULL};
  fmi2ValueReference references[INPUTS];
  double inputs[ROWS][INPUTS], torque[2], largest = 0;
  FILE *const file = count > 2 ? fopen(arguments[2], "rb") : NULL;
  if (!file || fread(inputs, sizeof inputs, 1, file) != 1)
    return 2;
  fclose(file);
  for (unsigned i = 0; i < INPUTS; ++i)
    references[i] = FIRST_INPUT + i;
  if (fmi2Instantiate("law", fmi2CoSimulation, "another", "", &callbacks, fmi2False, fmi2False))
    return 2;
  fmi2Component fmu = fmi2Instantiate("law", fmi2CoSimulation, arguments[1], "", &callbacks, fmi2False, fmi2True);
  if (!fmu || fmi2SetupExperiment(fmu, fmi2False, 0, 0, fmi2False, 0) || fmi2EnterInitializationMode(fmu) ||
      fmi2ExitInitializationMode(fmu))
    return 2;
  for (int k = 0; k < ROWS; ++k) {
    if (fmi2SetReal(fmu, references, INPUTS, inputs[k]) || fmi2DoStep(fmu, k * PERIOD, PERIOD, fmi2True) ||
        fmi2GetReal(fmu, torque_references, 2, torque))
      return 2;
    uint64_t bits[2];
    memcpy(bits, torque, sizeof bits);
    printf("%016" PRIx64 " %016" PRIx64 "\n", bits[0], bits[1]);
  }
  fmi2FreeInstance(fmu);
  for (int kind = fmi2ModelExchange; kind <= fmi2CoSimulation; ++kind) {
    fmi2FMUstate state = NULL;
    double time = 0;
    fmu = fmi2Instantiate("law", (fmi2Type)kind, arguments[1], "", &callbacks, fmi2False, kind == fmi2CoSimulation);
    for (long k = 0; k < CALLS; ++k) {
      call_at_random(fmu, &state, &time);
      largest = fmax(largest, largest_torque(fmu));
    }
    fmi2FreeFMUstate(fmu, &state);
    fmi2FreeInstance(fmu);
  }
  printf("%g\n", largest);
  return 0;
}
