/* The law by FMI 3.0, for co-simulation and model exchange. */
#include "config.h"

#include "fmi3Functions.h"

#include "model.h"

static void pass_on(const model *self, int status, const char *message)
{
  static const char *const categories[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};
  fmi3LogMessageCallback log;
  if (!self->callbacks)
    return;
  memcpy(&log, self->callbacks, sizeof log);
  if (log)
    log(self->environment, (fmi3Status)status, categories[status], message);
}

const char *fmi3GetVersion(void)
{
  return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String categories[])
{
  (void)count;
  (void)categories;
  ((model *)c)->logs_all = on;
  return fmi3OK;
}

/* The function that takes messages lies behind the instance. */
static model *instantiate(const char *name, const char *token, void *environment, fmi3LogMessageCallback log, bool all)
{
  fmi3LogMessageCallback *const kept = malloc(sizeof *kept);
  if (!kept)
    return NULL;
  *kept = log;
  model *const self = new_model(name, token, environment, kept, all);
  if (!self)
    free(kept);
  return self;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logs, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
  (void)resources;
  (void)visible;
  model *const self = instantiate(name, token, environment, log, logs);
  if (self)
    self->is_model_exchange = 1;
  return self;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logs, fmi3Boolean uses_event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference required[], size_t n_required,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
  (void)resources;
  (void)visible;
  (void)early_return;
  (void)required;
  (void)n_required;
  (void)update;
  model *const self = instantiate(name, token, environment, log, logs);
  if (self)
    self->uses_event_mode = uses_event_mode;
  return self;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logs,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
  (void)name;
  (void)token;
  (void)resources;
  (void)visible;
  (void)logs;
  (void)update;
  (void)lock;
  (void)unlock;
  if (log)
    log(environment, fmi3Error, "logStatusError", "this FMU has no scheduled execution");
  return NULL;
}

void fmi3FreeInstance(fmi3Instance c)
{
  const model *const self = c;
  void *kept = NULL;
  if (self)
    memcpy(&kept, &self->callbacks, sizeof kept);
  free(kept);
  free_model(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop)
{
  (void)has_tolerance;
  (void)tolerance;
  (void)has_stop;
  (void)stop;
  return (fmi3Status)enter_initialization(c, "fmi3EnterInitializationMode", start);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
  return (fmi3Status)exit_initialization(c, "fmi3ExitInitializationMode");
}

fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
  const model *const self = c;
  const unsigned from = self->is_model_exchange ? 1u << CONTINUOUS : self->uses_event_mode ? 1u << STEPPING : 0;
  return (fmi3Status)change_mode(c, "fmi3EnterEventMode", from, EVENT);
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
                                    fmi3Boolean *has_next_event, fmi3Float64 *next_event)
{
  int needs_update = 0;
  const int status = update_discrete_states(c, "fmi3UpdateDiscreteStates", &needs_update, next_event);
  *again = needs_update != 0;
  *terminate = *nominals_changed = *values_changed = fmi3False;
  *has_next_event = fmi3True;
  return (fmi3Status)status;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c)
{
  const model *const self = c;
  return (fmi3Status)change_mode(c, "fmi3EnterContinuousTimeMode", self->is_model_exchange ? 1u << EVENT : 0,
                                 CONTINUOUS);
}

fmi3Status fmi3EnterStepMode(fmi3Instance c)
{
  const model *const self = c;
  return (fmi3Status)change_mode(c, "fmi3EnterStepMode", self->is_model_exchange ? 0 : 1u << EVENT, STEPPING);
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early_return, fmi3Float64 *last_time)
{
  const model *const self = c;
  (void)no_set;
  const int status = do_step(c, "fmi3DoStep", time, size);
  *event = self->uses_event_mode != 0;
  *terminate = *early_return = fmi3False;
  *last_time = self->state.time;
  return (fmi3Status)status;
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
  return (fmi3Status)change_mode(c, "fmi3Terminate", 1u << EVENT | 1u << CONTINUOUS | 1u << STEPPING, TERMINATED);
}

fmi3Status fmi3Reset(fmi3Instance c)
{
  set_defaults(c);
  return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
  return (fmi3Status)set_time(c, "fmi3SetTime", time);
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set, fmi3Boolean *enter_event_mode,
                                       fmi3Boolean *terminate)
{
  (void)no_set;
  *enter_event_mode = *terminate = fmi3False;
  return (fmi3Status)check_mode(c, "fmi3CompletedIntegratorStep", 1u << CONTINUOUS);
}

static fmi3Status wrong_size(const model *self, const char *function, size_t given, size_t needed)
{
  return (fmi3Status)report(self, STATUS_ERROR, "%s: got %zu values; these variables have %zu", function, given, needed);
}

/* The number of values of all variables, which must be the given one. */
static fmi3Status check_size(const model *self, const char *function, const fmi3ValueReference references[],
                             size_t count, value_kind kind, size_t given)
{
  size_t needed = 0;
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(self, function, references[i], kind, 1);
    if (!one)
      return fmi3Error;
    needed += one->count;
  }
  return needed == given ? fmi3OK : wrong_size(self, function, given, needed);
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t count, fmi3Float64 values[],
                          size_t n_values)
{
  if (check_size(c, "fmi3GetFloat64", references, count, REAL, n_values))
    return fmi3Error;
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi3GetFloat64", references[i], REAL, 1);
    for (unsigned element = 0; element < one->count; ++element)
      *values++ = get_real(c, one, element);
  }
  return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t count,
                          const fmi3Float64 values[], size_t n_values)
{
  if (check_size(c, "fmi3SetFloat64", references, count, REAL, n_values))
    return fmi3Error;
  for (size_t i = 0; i < count; ++i) {
    const variable *const one = find(c, "fmi3SetFloat64", references[i], REAL, 1);
    for (unsigned element = 0; element < one->count; ++element)
      if (set_real(c, "fmi3SetFloat64", one, element, *values++))
        return fmi3Error;
  }
  return fmi3OK;
}

fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference references[], size_t count, fmi3Int32 values[],
                        size_t n_values)
{
  if (check_size(c, "fmi3GetInt32", references, count, INTEGER, n_values))
    return fmi3Error;
  for (size_t i = 0; i < count; ++i)
    values[i] = get_integer(c, find(c, "fmi3GetInt32", references[i], INTEGER, 1));
  return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference references[], size_t count, const fmi3Int32 values[],
                        size_t n_values)
{
  if (check_size(c, "fmi3SetInt32", references, count, INTEGER, n_values))
    return fmi3Error;
  for (size_t i = 0; i < count; ++i)
    if (set_integer(c, "fmi3SetInt32", find(c, "fmi3SetInt32", references[i], INTEGER, 1), values[i]))
      return fmi3Error;
  return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference references[], size_t count, fmi3Boolean values[],
                          size_t n_values)
{
  if (check_size(c, "fmi3GetBoolean", references, count, BOOLEAN, n_values))
    return fmi3Error;
  for (size_t i = 0; i < count; ++i)
    values[i] = get_integer(c, find(c, "fmi3GetBoolean", references[i], BOOLEAN, 1)) != 0;
  return fmi3OK;
}

fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference references[], size_t count,
                          const fmi3Boolean values[], size_t n_values)
{
  if (check_size(c, "fmi3SetBoolean", references, count, BOOLEAN, n_values))
    return fmi3Error;
  for (size_t i = 0; i < count; ++i)
    if (set_integer(c, "fmi3SetBoolean", find(c, "fmi3SetBoolean", references[i], BOOLEAN, 1), values[i]))
      return fmi3Error;
  return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
  return (fmi3Status)save_state(c, "fmi3GetFMUState", state);
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
  return (fmi3Status)restore_state(c, "fmi3SetFMUState", state);
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
  (void)c;
  free(*state);
  *state = NULL;
  return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
  (void)c;
  (void)state;
  *size = sizeof(saved_state);
  return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
  return (fmi3Status)serialize_state(c, "fmi3SerializeFMUState", state, bytes, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
  return (fmi3Status)deserialize_state(c, "fmi3DeserializeFMUState", bytes, size, state);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *count)
{
  (void)c;
  *count = 0;
  return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *count)
{
  (void)c;
  *count = 0;
  return fmi3OK;
}

/* There are no continuous states and no event indicators. */
static fmi3Status none(fmi3Instance c, const char *function, size_t count)
{
  return count == 0 ? fmi3OK : (fmi3Status)report(c, STATUS_ERROR, "%s: this FMU has none", function);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 values[], size_t count)
{
  (void)values;
  return none(c, "fmi3SetContinuousStates", count);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 values[], size_t count)
{
  (void)values;
  return none(c, "fmi3GetContinuousStates", count);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 values[], size_t count)
{
  (void)values;
  return none(c, "fmi3GetNominalsOfContinuousStates", count);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 values[], size_t count)
{
  (void)values;
  return none(c, "fmi3GetContinuousStateDerivatives", count);
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 values[], size_t count)
{
  (void)values;
  return none(c, "fmi3GetEventIndicators", count);
}

/* No variable has these types. */
#define NO_VARIABLES(name, type)                                                                                       \
  fmi3Status fmi3Get##name(fmi3Instance c, const fmi3ValueReference references[], size_t count, type values[],         \
                           size_t n_values)                                                                            \
  {                                                                                                                    \
    (void)references;                                                                                                  \
    (void)values;                                                                                                      \
    (void)n_values;                                                                                                    \
    return none(c, "fmi3Get" #name, count);                                                                            \
  }                                                                                                                    \
  fmi3Status fmi3Set##name(fmi3Instance c, const fmi3ValueReference references[], size_t count, const type values[],   \
                           size_t n_values)                                                                            \
  {                                                                                                                    \
    (void)references;                                                                                                  \
    (void)values;                                                                                                      \
    (void)n_values;                                                                                                    \
    return none(c, "fmi3Set" #name, count);                                                                            \
  }
NO_VARIABLES(Float32, fmi3Float32)
NO_VARIABLES(Int8, fmi3Int8)
NO_VARIABLES(UInt8, fmi3UInt8)
NO_VARIABLES(Int16, fmi3Int16)
NO_VARIABLES(UInt16, fmi3UInt16)
NO_VARIABLES(UInt32, fmi3UInt32)
NO_VARIABLES(Int64, fmi3Int64)
NO_VARIABLES(UInt64, fmi3UInt64)
NO_VARIABLES(String, fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference references[], size_t count, size_t sizes[],
                         fmi3Binary values[], size_t n_values)
{
  (void)references;
  (void)sizes;
  (void)values;
  (void)n_values;
  return none(c, "fmi3GetBinary", count);
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference references[], size_t count, const size_t sizes[],
                         const fmi3Binary values[], size_t n_values)
{
  (void)references;
  (void)sizes;
  (void)values;
  (void)n_values;
  return none(c, "fmi3SetBinary", count);
}

/* What the model description says that this FMU cannot do. Each is called with the instance first. */
static fmi3Status cannot(fmi3Instance c, const char *function)
{
  return (fmi3Status)report(c, STATUS_ERROR, "%s: this FMU does not provide it", function);
}

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference references[], size_t count, fmi3Clock values[])
{
  (void)references;
  (void)values;
  return none(c, "fmi3GetClock", count);
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference references[], size_t count, const fmi3Clock values[])
{
  (void)references;
  (void)values;
  return none(c, "fmi3SetClock", count);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference reference, size_t *count)
{
  (void)reference;
  *count = 0;
  return cannot(c, "fmi3GetNumberOfVariableDependencies");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t dependent_elements[],
                                       fmi3ValueReference independents[], size_t independent_elements[],
                                       fmi3DependencyKind kinds[], size_t count)
{
  (void)dependent;
  (void)dependent_elements;
  (void)independents;
  (void)independent_elements;
  (void)kinds;
  (void)count;
  return cannot(c, "fmi3GetVariableDependencies");
}

#define NO_DERIVATIVE(name)                                                                                            \
  fmi3Status name(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,                              \
                  const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,         \
                  fmi3Float64 sensitivity[], size_t n_sensitivity)                                                     \
  {                                                                                                                    \
    (void)unknowns;                                                                                                    \
    (void)n_unknowns;                                                                                                  \
    (void)knowns;                                                                                                      \
    (void)n_knowns;                                                                                                    \
    (void)seed;                                                                                                        \
    (void)n_seed;                                                                                                      \
    (void)sensitivity;                                                                                                 \
    (void)n_sensitivity;                                                                                               \
    return cannot(c, #name);                                                                                           \
  }
NO_DERIVATIVE(fmi3GetDirectionalDerivative)
NO_DERIVATIVE(fmi3GetAdjointDerivative)

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c)
{
  return cannot(c, "fmi3EnterConfigurationMode");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance c)
{
  return cannot(c, "fmi3ExitConfigurationMode");
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c)
{
  return cannot(c, "fmi3EvaluateDiscreteStates");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference references[], size_t count,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values)
{
  (void)references;
  (void)count;
  (void)orders;
  (void)values;
  (void)n_values;
  return cannot(c, "fmi3GetOutputDerivatives");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
  (void)clock;
  (void)time;
  return cannot(c, "fmi3ActivateModelPartition");
}

/* There are no clocks. */
#define NO_CLOCKS(name, ...)                                                                                           \
  fmi3Status name(fmi3Instance c, const fmi3ValueReference references[], size_t count, __VA_ARGS__)                    \
  {                                                                                                                    \
    (void)references;                                                                                                  \
    (void)first;                                                                                                       \
    (void)second;                                                                                                      \
    return none(c, #name, count);                                                                                      \
  }
NO_CLOCKS(fmi3GetIntervalDecimal, fmi3Float64 first[], fmi3IntervalQualifier second[])
NO_CLOCKS(fmi3GetShiftFraction, fmi3UInt64 first[], fmi3UInt64 second[])
NO_CLOCKS(fmi3SetIntervalFraction, const fmi3UInt64 first[], const fmi3UInt64 second[])
NO_CLOCKS(fmi3SetShiftFraction, const fmi3UInt64 first[], const fmi3UInt64 second[])

#define NO_CLOCK_TIMES(name, type)                                                                                     \
  fmi3Status name(fmi3Instance c, const fmi3ValueReference references[], size_t count, type times[])                   \
  {                                                                                                                    \
    (void)references;                                                                                                  \
    (void)times;                                                                                                       \
    return none(c, #name, count);                                                                                      \
  }
NO_CLOCK_TIMES(fmi3GetShiftDecimal, fmi3Float64)
NO_CLOCK_TIMES(fmi3SetIntervalDecimal, const fmi3Float64)
NO_CLOCK_TIMES(fmi3SetShiftDecimal, const fmi3Float64)

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference references[], size_t count,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
  (void)references;
  (void)counters;
  (void)resolutions;
  (void)qualifiers;
  return none(c, "fmi3GetIntervalFraction", count);
}
