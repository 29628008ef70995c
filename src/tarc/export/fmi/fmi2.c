/* The law by FMI 2.0, for co-simulation and model exchange. */
#include "fmi2Functions.h"

#include "model.h"

static void pass_on(const model *self, int status, const char *message)
{
  const fmi2CallbackFunctions *const functions = self->callbacks;
  static const char *const categories[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};
  if (functions && functions->logger)
    functions->logger(self->environment, self->name, (fmi2Status)status, categories[status], message); /* has no % */
}

const char *fmi2GetTypesPlatform(void)
{
  return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
  return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
  (void)count;
  (void)categories;
  ((model *)c)->logs_all = on;
  return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean log)
{
  (void)resources;
  (void)visible;
  model *const self = new_model(name, token, functions ? functions->componentEnvironment : NULL, functions, log);
  if (self)
    self->is_model_exchange = type == fmi2ModelExchange;
  return self;
}

void fmi2FreeInstance(fmi2Component c)
{
  free_model(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop)
{
  model *const self = c;
  (void)has_tolerance;
  (void)tolerance;
  (void)has_stop;
  (void)stop;
  if (check_mode(self, "fmi2SetupExperiment", 1u << INSTANTIATED))
    return fmi2Error;
  self->state.start_time = start;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
  model *const self = c;
  return (fmi2Status)enter_initialization(self, "fmi2EnterInitializationMode", self->state.start_time);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
  return (fmi2Status)exit_initialization(c, "fmi2ExitInitializationMode");
}

fmi2Status fmi2Terminate(fmi2Component c)
{
  return (fmi2Status)change_mode(c, "fmi2Terminate", 1u << EVENT | 1u << CONTINUOUS | 1u << STEPPING, TERMINATED);
}

fmi2Status fmi2Reset(fmi2Component c)
{
  set_defaults(c);
  return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi2GetReal", references[i], REAL, 0);
    if (!one)
      return fmi2Error;
    values[i] = get_real(c, one, references[i] - one->first);
  }
  return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Integer values[])
{
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi2GetInteger", references[i], INTEGER, 0);
    if (!one)
      return fmi2Error;
    values[i] = get_integer(c, one);
  }
  return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Boolean values[])
{
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi2GetBoolean", references[i], BOOLEAN, 0);
    if (!one)
      return fmi2Error;
    values[i] = get_integer(c, one) != 0;
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t count, const fmi2Real values[])
{
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi2SetReal", references[i], REAL, 0);
    if (!one || set_real(c, "fmi2SetReal", one, references[i] - one->first, values[i]))
      return fmi2Error;
  }
  return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference references[], size_t count,
                          const fmi2Integer values[])
{
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi2SetInteger", references[i], INTEGER, 0);
    if (!one || set_integer(c, "fmi2SetInteger", one, values[i]))
      return fmi2Error;
  }
  return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t count,
                          const fmi2Boolean values[])
{
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi2SetBoolean", references[i], BOOLEAN, 0);
    if (!one || set_integer(c, "fmi2SetBoolean", one, values[i] != 0))
      return fmi2Error;
  }
  return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
  return (fmi2Status)save_state(c, "fmi2GetFMUstate", state);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
  return (fmi2Status)restore_state(c, "fmi2SetFMUstate", state);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
  (void)c;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
  (void)c;
  (void)state;
  *size = sizeof(saved_state);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
  return (fmi2Status)serialize_state(c, "fmi2SerializeFMUstate", state, bytes, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
  return (fmi2Status)deserialize_state(c, "fmi2DeSerializeFMUstate", bytes, size, state);
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
  return (fmi2Status)change_mode(c, "fmi2EnterEventMode", 1u << EVENT | 1u << CONTINUOUS, EVENT);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
  memset(info, 0, sizeof *info);
  info->nextEventTimeDefined = fmi2True;
  return (fmi2Status)update_discrete_states(c, "fmi2NewDiscreteStates", &info->newDiscreteStatesNeeded,
                                            &info->nextEventTime);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
  return (fmi2Status)change_mode(c, "fmi2EnterContinuousTimeMode", 1u << EVENT, CONTINUOUS);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *enter_event_mode,
                                       fmi2Boolean *terminate)
{
  (void)no_set;
  *enter_event_mode = *terminate = fmi2False;
  return (fmi2Status)check_mode(c, "fmi2CompletedIntegratorStep", 1u << CONTINUOUS);
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
  return (fmi2Status)set_time(c, "fmi2SetTime", time);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set)
{
  (void)no_set;
  return (fmi2Status)do_step(c, "fmi2DoStep", time, size);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
  if (kind != fmi2LastSuccessfulTime)
    return fmi2Discard;
  *value = ((model *)c)->state.time;
  return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
  (void)c;
  *value = fmi2False;
  return kind == fmi2Terminated ? fmi2OK : fmi2Discard;
}

/* There are no continuous states and no event indicators. */
static fmi2Status none(fmi2Component c, const char *function, size_t count)
{
  return count == 0 ? fmi2OK : (fmi2Status)report(c, STATUS_ERROR, "%s: this FMU has none", function);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real values[], size_t count)
{
  (void)values;
  return none(c, "fmi2SetContinuousStates", count);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real values[], size_t count)
{
  (void)values;
  return none(c, "fmi2GetContinuousStates", count);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real values[], size_t count)
{
  (void)values;
  return none(c, "fmi2GetNominalsOfContinuousStates", count);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real values[], size_t count)
{
  (void)values;
  return none(c, "fmi2GetDerivatives", count);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real values[], size_t count)
{
  (void)values;
  return none(c, "fmi2GetEventIndicators", count);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2String values[])
{
  (void)references;
  (void)values;
  return none(c, "fmi2GetString", count);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference references[], size_t count,
                         const fmi2String values[])
{
  (void)references;
  (void)values;
  return none(c, "fmi2SetString", count);
}

/* What the model description says that this FMU cannot do. */
static fmi2Status cannot(fmi2Component c, const char *function)
{
  return (fmi2Status)report(c, STATUS_ERROR, "%s: this FMU does not provide it", function);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknowns,
                                        const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seed[],
                                        fmi2Real values[])
{
  (void)unknowns;
  (void)n_unknowns;
  (void)knowns;
  (void)n_knowns;
  (void)seed;
  (void)values;
  return cannot(c, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t count,
                                       const fmi2Integer orders[], const fmi2Real values[])
{
  (void)references;
  (void)count;
  (void)orders;
  (void)values;
  return cannot(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t count,
                                        const fmi2Integer orders[], fmi2Real values[])
{
  (void)references;
  (void)count;
  (void)orders;
  (void)values;
  return cannot(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
  return cannot(c, "fmi2CancelStep");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
  (void)c;
  (void)kind;
  *value = fmi2OK;
  return fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
  (void)c;
  (void)kind;
  *value = 0;
  return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
  (void)c;
  (void)kind;
  *value = "";
  return fmi2Discard;
}
