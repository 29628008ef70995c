/* The law as a model of the Functional Mock-up Interface: its variables, its sampling, its saved state.
 *
 * One source file includes it, config.h ahead of it; that file says how messages are passed on.
 */
#ifndef MODEL_H
#define MODEL_H

#include "config.h"

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FINITE_BOUND 1e100
#define TIME_TOLERANCE (1e-3 * PERIOD) /* times that differ by less are the same instant [s] */

enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR };
enum { INSTANTIATED, INITIALIZATION, EVENT, CONTINUOUS, STEPPING, TERMINATED };
static const char *const mode_names[] = {"after instantiation", "in initialization mode", "in event mode",
                                         "in continuous-time mode", "between steps", "after termination"};

typedef enum { REAL, INTEGER, BOOLEAN } value_kind;
typedef enum { INPUT, OUTPUT, FIXED, TUNABLE, INDEPENDENT } variable_role;

/* Plain data: a copy of it saves the FMU. */
typedef struct {
  LAW(t) law, before; /* memory of the law now, and before the latest sample */
  LAW(input) in;
  LAW(output) out;
  double initial_torque[JOINTS], parameter[PARAMETERS + 1];
  int uses_applied_torque, status, mode;
  double start_time, time, sample_time, samples;
} model_state;

typedef struct {
  model_state state;
  int is_model_exchange, uses_event_mode, logs_all;
  char *name;
  void *environment;
  const void *callbacks;
} model;

typedef struct {
  unsigned first, count; /* value reference, of element i of FMI 2.0 the i-th after it */
  size_t place;
  value_kind kind;
  variable_role role;
  const char *name;
} variable;

#define VARIABLE(first, count, member, kind, role, name) {first, count, offsetof(model_state, member), kind, role, name},
static const variable variables[] = {VARIABLE_TABLE};
#undef VARIABLE

/* Pass a message on; the status is one of the above. */
static void pass_on(const model *self, int status, const char *message);

static int report(const model *self, int status, const char *format, ...)
{
  char message[400];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(message, sizeof message, format, arguments);
  va_end(arguments);
  if (status >= STATUS_ERROR || self->logs_all)
    pass_on(self, status, message);
  return status;
}

/* Whether a function may be called now; the mask has the bits of the allowed modes. */
static int check_mode(const model *self, const char *function, unsigned allowed)
{
  const int mode = self->state.mode;
  if (allowed >> mode & 1u)
    return STATUS_OK;
  return report(self, STATUS_ERROR, "%s must not be called %s", function, mode_names[mode]);
}

static void set_defaults(model *self)
{
  memset(&self->state, 0, sizeof self->state);
  memcpy(self->state.parameter, parameter_starts, sizeof parameter_starts);
}

/* The torque before the first sample: the initial one, within its limits. */
static void start_outputs(model_state *state)
{
  memset(&state->out, 0, sizeof state->out);
  for (int i = 0; i < JOINTS; ++i) {
    const double torque = state->initial_torque[i], limit = start_limits[i];
    state->out.torque[i] = torque < -limit ? -limit : torque > limit ? limit : torque;
  }
  state->status = LAW_NOT_READY;
}

/* The time of the next sample [s]. */
static double next_sample(const model_state *state)
{
  return state->start_time + state->samples * PERIOD;
}

/* One step of the law, from the memory it has. */
static void step_law(model *self)
{
  model_state *const state = &self->state;
  LAW(input) in = state->in;
  if (!state->uses_applied_torque)
    for (int i = 0; i < JOINTS; ++i)
      in.applied_torque[i] = NAN;
  if (!state->law.ready && LAW(reset)(&state->law, in.position, state->initial_torque) != LAW_OK) {
    report(self, STATUS_WARNING, "t = %.17g: no position yet that is finite; the law waits for one", state->time);
    if (COMMANDS_POSITIONS) { /* zero would be a place to go to */
      start_outputs(state);
      return;
    }
  }
#if PARAMETERS > 0
  memcpy(state->law.x[state->law.now] + FIRST_PARAMETER, state->parameter, PARAMETERS * sizeof(double));
#endif
  state->status = (int)LAW(step)(&state->law, &in, &state->out);
}

/* Sample the inputs at the present time for the first time. */
static void sample(model *self)
{
  self->state.before = self->state.law;
  self->state.sample_time = self->state.time;
  self->state.samples += 1;
  step_law(self);
}

/* Sample at the present instant if it is one of the law's, again where that was done before with other inputs.
 * `again` becomes 1 after the first time, so that the environment hands on what other models changed at this instant. */
static int update_discrete_states(model *self, const char *function, int *again, double *next_event_time)
{
  model_state *const state = &self->state;
  if (check_mode(self, function, 1u << EVENT))
    return STATUS_ERROR;
  *again = 0;
  if (state->time > next_sample(state) + TIME_TOLERANCE)
    return report(self, STATUS_ERROR, "t = %.17g: the time event at %.17g was left out; the law samples every %g s",
                  state->time, next_sample(state), PERIOD);
  if (state->time >= next_sample(state) - TIME_TOLERANCE) {
    sample(self);
    *again = 1;
  } else if (state->samples > 0 && fabs(state->time - state->sample_time) <= TIME_TOLERANCE) {
    state->law = state->before;
    step_law(self);
  }
  *next_event_time = next_sample(state);
  return STATUS_OK;
}

/* Go from a communication point to the next, one period later. Without event mode the inputs are sampled at the start. */
static int do_step(model *self, const char *function, double time, double size)
{
  model_state *const state = &self->state;
  if (check_mode(self, function, 1u << STEPPING))
    return STATUS_ERROR;
  if (!(fabs(size - PERIOD) <= TIME_TOLERANCE))
    return report(self, STATUS_ERROR,
                  "%s: got a communication step of %.17g s; it must be the law's period, %.17g s. Set the step of this "
                  "FMU to its period",
                  function, size, PERIOD);
  if (!(fabs(time - state->time) <= TIME_TOLERANCE))
    return report(self, STATUS_ERROR, "%s: got the communication point %.17g s; the last step ended at %.17g s",
                  function, time, state->time);
  state->time = time; /* so that roundings of the environment do not add up */
  if (!self->uses_event_mode)
    sample(self);
  else if (time >= next_sample(state) - TIME_TOLERANCE)
    return report(self, STATUS_ERROR, "%s: the sample at %.17g s was left out; enter event mode after every step",
                  function, time);
  state->time = time + size;
  return STATUS_OK;
}

static int enter_initialization(model *self, const char *function, double start_time)
{
  if (check_mode(self, function, 1u << INSTANTIATED))
    return STATUS_ERROR;
  if (!(fabs(start_time) <= FINITE_BOUND))
    return report(self, STATUS_ERROR, "%s: the start time %g is not finite", function, start_time);
  self->state.start_time = self->state.time = start_time;
  self->state.mode = INITIALIZATION;
  start_outputs(&self->state);
  return STATUS_OK;
}

static int exit_initialization(model *self, const char *function)
{
  if (check_mode(self, function, 1u << INITIALIZATION))
    return STATUS_ERROR;
  start_outputs(&self->state);
  self->state.mode = self->is_model_exchange || self->uses_event_mode ? EVENT : STEPPING;
  return STATUS_OK;
}

static int change_mode(model *self, const char *function, unsigned allowed, int mode)
{
  if (check_mode(self, function, allowed))
    return STATUS_ERROR;
  self->state.mode = mode;
  return STATUS_OK;
}

static int set_time(model *self, const char *function, double time)
{
  if (check_mode(self, function, 1u << EVENT | 1u << CONTINUOUS))
    return STATUS_ERROR;
  self->state.time = time;
  return STATUS_OK;
}

/* The variable with a value reference; `in_arrays` where only arrays as a whole have one. NULL, and a message, if none. */
static const variable *find(const model *self, const char *function, unsigned reference, value_kind kind, int in_arrays)
{
  for (size_t i = 0; i < sizeof variables / sizeof *variables; ++i) {
    const variable *const one = &variables[i];
    const unsigned last = in_arrays ? one->first : one->first + one->count - 1;
    if (one->kind == kind && reference >= one->first && reference <= last)
      return one;
  }
  report(self, STATUS_ERROR, "%s: there is no variable of this type with the value reference %u", function, reference);
  return NULL;
}

/* Whether a variable may be set now. */
static int check_settable(const model *self, const char *function, const variable *one)
{
  const unsigned before = 1u << INSTANTIATED | 1u << INITIALIZATION, always = (1u << TERMINATED) - 1;
  const unsigned allowed = one->role == FIXED     ? before
                           : one->role == TUNABLE ? always & ~(1u << CONTINUOUS)
                           : one->role == INPUT   ? always
                                                  : 0;
  if (allowed >> self->state.mode & 1u)
    return STATUS_OK;
  return report(self, STATUS_ERROR, "%s: %s must not be set %s", function, one->name, mode_names[self->state.mode]);
}

/* Whether a parameter may have a value: inputs may have any, which the law handles. */
static int check_value(const model *self, const char *function, const variable *one, unsigned element, double value)
{
  const size_t index = (one->place - offsetof(model_state, parameter)) / sizeof(double) + element;
  if (one->role == FIXED && !(fabs(value) <= FINITE_BOUND))
    return report(self, STATUS_ERROR, "%s: got %g for %s, which must be finite", function, value, one->name);
  if (one->role == TUNABLE && !(value >= parameter_least[index] && value <= parameter_greatest[index]))
    return report(self, STATUS_ERROR, "%s: got %g for %s, which must be from %g to %g", function, value, one->name,
                  parameter_least[index], parameter_greatest[index]);
  return STATUS_OK;
}

static int set_real(model *self, const char *function, const variable *one, unsigned element, double value)
{
  double *const place = (double *)(void *)((char *)&self->state + one->place) + element;
  if (check_settable(self, function, one) || check_value(self, function, one, element, value))
    return STATUS_ERROR;
  *place = value;
  return STATUS_OK;
}

static double get_real(const model *self, const variable *one, unsigned element)
{
  return ((const double *)(const void *)((const char *)&self->state + one->place))[element];
}

static int set_integer(model *self, const char *function, const variable *one, int value)
{
  if (check_settable(self, function, one))
    return STATUS_ERROR;
  *(int *)(void *)((char *)&self->state + one->place) = value;
  return STATUS_OK;
}

static int get_integer(const model *self, const variable *one)
{
  return *(const int *)(const void *)((const char *)&self->state + one->place);
}

/* A saved state, with the token of the model that it is of. */
typedef struct {
  char token[sizeof TOKEN];
  model_state state;
} saved_state;

static int save_state(const model *self, const char *function, void **saved)
{
  saved_state *const copy = *saved ? *saved : malloc(sizeof *copy);
  if (!copy)
    return report(self, STATUS_ERROR, "%s: out of memory", function);
  memcpy(copy->token, TOKEN, sizeof copy->token);
  copy->state = self->state;
  *saved = copy;
  return STATUS_OK;
}

static int restore_state(model *self, const char *function, const void *saved)
{
  if (!saved)
    return report(self, STATUS_ERROR, "%s: got no state", function);
  self->state = ((const saved_state *)saved)->state;
  return STATUS_OK;
}

static int serialize_state(const model *self, const char *function, const void *saved, void *bytes, size_t size)
{
  if (!saved || size < sizeof(saved_state))
    return report(self, STATUS_ERROR, "%s: got %zu bytes; needs a state and %zu", function, size, sizeof(saved_state));
  memcpy(bytes, saved, sizeof(saved_state));
  return STATUS_OK;
}

static int deserialize_state(const model *self, const char *function, const void *bytes, size_t size, void **saved)
{
  if (size != sizeof(saved_state) || memcmp(bytes, TOKEN, sizeof TOKEN) != 0)
    return report(self, STATUS_ERROR, "%s: these %zu bytes are no state of this FMU", function, size);
  saved_state *const copy = *saved ? *saved : malloc(sizeof *copy);
  if (!copy)
    return report(self, STATUS_ERROR, "%s: out of memory", function);
  memcpy(copy, bytes, sizeof *copy);
  *saved = copy;
  return STATUS_OK;
}

/* A new instance; NULL, and a message, for another FMU's token. */
static model *new_model(const char *name, const char *token, void *environment, const void *callbacks, int logs_all)
{
  model *const self = calloc(1, sizeof *self);
  if (!self)
    return NULL;
  self->environment = environment;
  self->callbacks = callbacks;
  self->logs_all = logs_all;
  const size_t size = strlen(name ? name : "") + 1;
  self->name = calloc(size, 1);
  if (self->name && name)
    memcpy(self->name, name, size);
  if (!self->name || !token || strcmp(token, TOKEN) != 0) {
    report(self, STATUS_ERROR, "the token or GUID is not that of this FMU: its model description and binary differ");
    free(self->name);
    free(self);
    return NULL;
  }
  set_defaults(self);
  return self;
}

static void free_model(model *self)
{
  if (self)
    free(self->name);
  free(self);
}

#endif
