/* Runs the law of ${name}.h on a robot over UDP: Linux, one thread, no heap.
 *
 *   loop HOST PORT [SECONDS [LOCAL_PORT [LOG.csv]]]
 *
 * It takes the torque over from the robot's brakes, holds the first position, follows a ramp to the reference, the
 * reference for SECONDS, and comes to rest; so it does after Ctrl-C. Lost samples, and an error or a speed beyond the
 * limits below, are a safe stop: the law's safe torque, and the brakes. The log has the last LOG_PERIODS periods, also
 * after a safe stop. Exit status 0 at the end, 3 after a safe stop, and 1 where it could not start or write the log.
 * Give other limits by -D, such as -DMAX_ERROR=0.1.
 */
#define _GNU_SOURCE /* mlockall, clock_nanosleep, getaddrinfo */
#include "$header"

#include <errno.h>
#include <math.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#ifndef MAX_ERROR
#define MAX_ERROR 0.3 /* distance from the reference [rad or m] */
#endif
#ifndef MAX_SPEED
#define MAX_SPEED HUGE_VAL /* velocity estimate [rad/s or m/s] */
#endif
#ifndef WATCHDOG
#define WATCHDOG 0.05 /* longest time without a sample [s] */
#endif
#ifndef HOLD_TIME
#define HOLD_TIME 0.2 /* at rest with the law, before the ramp [s] */
#endif
#ifndef RAMP_TIME
#define RAMP_TIME 2.0
#endif
#ifndef STOP_TIME
#define STOP_TIME 0.3
#endif
#ifndef BRAKE_TIME
#define BRAKE_TIME 0.1 /* the brakes take to open and to close [s] */
#endif
#ifndef PATIENCE
#define PATIENCE 5.0 /* time to wait for the robot [s] */
#endif
#ifndef PRIORITY
#define PRIORITY 80 /* of SCHED_FIFO; 0 for none */
#endif

#ifndef LOG_PERIODS
#define LOG_PERIODS 60000L /* kept in memory until the end */
#endif

#define JOINTS ${NAME}_JOINTS
#define PERIOD ((double)${NAME}_PERIOD)
#define MAX_MISSING $max_missing
#define TIMED (1L << 20) /* periods of which the time is kept */

typedef ${name}_real real;
typedef struct { double position[JOINTS], velocity[JOINTS], acceleration[JOINTS]; } point;

static const double max_torque[JOINTS] = {$limits};
static const char joint_names[] = "$names"; /* empty: any order */

/* ---- time ---- */

static double now(void)
{
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void sleep_until(double deadline)
{
  struct timespec t;
  t.tv_sec = (time_t)deadline;
  t.tv_nsec = (long)(1e9 * (deadline - (double)t.tv_sec));
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR)
    ;
}

/* ---- packets: magic, version, kind, joints, flags, sequence, time stamp, doubles, CRC-32; little-endian ---- */

enum { STATE = 1, COMMAND = 2, NAMES = 3, RELEASE = 1, STOP = 2, HELLO = 4, HEADER = 20, LARGEST = 2048 };

static struct {
  int socket;
  struct sockaddr_storage robot;
  socklen_t size;
  uint32_t sent, seen;
  int has_state, order; /* order: 0 unknown, 1 as here, -1 other */
  double stamp, position[JOINTS], torque[JOINTS];
  long malformed, strangers, stale;
} link_;

static uint32_t checksum(const unsigned char *data, size_t size)
{
  uint32_t crc = 0xffffffffu;
  for (size_t i = 0; i < size; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit)
      crc = crc & 1 ? crc >> 1 ^ 0xedb88320u : crc >> 1;
  }
  return ~crc;
}

static void send_command(int flags, const double *torque)
{
  unsigned char data[HEADER + 8 * JOINTS + 4] = {'T', 'A', 'R', 'C', 1, COMMAND, 0, 0};
  const double time = now();
  size_t size = HEADER;
  ++link_.sent;
  data[6] = torque ? JOINTS : 0;
  data[7] = (unsigned char)flags;
  memcpy(data + 8, &link_.sent, 4);
  memcpy(data + 12, &time, 8);
  if (torque) {
    memcpy(data + size, torque, 8 * JOINTS);
    size += 8 * JOINTS;
  }
  const uint32_t crc = checksum(data, size);
  memcpy(data + size, &crc, 4);
  (void)sendto(link_.socket, data, size + 4, 0, (const struct sockaddr *)&link_.robot, link_.size);
}

/* Take a packet; return whether it was a new state. */
static int take(const unsigned char *data, size_t size)
{
  uint32_t crc, sequence;
  if (size < HEADER + 4 || size > LARGEST || memcmp(data, "TARC\1", 5) != 0) {
    ++link_.malformed;
    return 0;
  }
  memcpy(&crc, data + size - 4, 4);
  memcpy(&sequence, data + 8, 4);
  const size_t body = size - HEADER - 4;
  if (crc != checksum(data, size - 4) || data[6] != JOINTS ||
      !(data[5] == NAMES || (data[5] == STATE && body == 16 * JOINTS))) {
    ++link_.malformed;
    return 0;
  }
  if (data[5] == NAMES) {
    const size_t length = sizeof joint_names - 1;
    link_.order = !length || (length == body && memcmp(data + HEADER, joint_names, length) == 0) ? 1 : -1;
    return 0;
  }
  if (link_.has_state && sequence - link_.seen - 1 >= 0x7fffffffu) {
    ++link_.stale;
    return 0;
  }
  link_.seen = sequence;
  link_.has_state = 1;
  memcpy(&link_.stamp, data + 12, 8);
  memcpy(link_.position, data + HEADER, sizeof link_.position);
  memcpy(link_.torque, data + HEADER + 8 * JOINTS, sizeof link_.torque);
  return 1;
}

static int same_address(const struct sockaddr_storage *other)
{
  const struct sockaddr_in *const a = (const void *)other, *const b = (const void *)&link_.robot;
  const struct sockaddr_in6 *const c = (const void *)other, *const d = (const void *)&link_.robot;
  if (other->ss_family == AF_INET)
    return a->sin_port == b->sin_port && a->sin_addr.s_addr == b->sin_addr.s_addr;
  return c->sin6_port == d->sin6_port && memcmp(&c->sin6_addr, &d->sin6_addr, sizeof c->sin6_addr) == 0;
}

/* Take what came, 64 packets at most; return whether a new state is among it. */
static int receive(void)
{
  int is_new = 0;
  for (int count = 0; count < 64; ++count) {
    unsigned char data[LARGEST + 1];
    struct sockaddr_storage from;
    socklen_t size = sizeof from;
    const ssize_t got = recvfrom(link_.socket, data, sizeof data, MSG_DONTWAIT, (struct sockaddr *)&from, &size);
    if (got < 0)
      break;
    if (from.ss_family == link_.robot.ss_family && same_address(&from))
      is_new |= take(data, (size_t)got);
    else
      ++link_.strangers;
  }
  return is_new;
}

static int open_link(const char *host, const char *port, const char *local_port)
{
  struct addrinfo hints, *found, *local;
  memset(&hints, 0, sizeof hints);
  hints.ai_socktype = SOCK_DGRAM;
  if (getaddrinfo(host, port, &hints, &found) != 0) {
    fprintf(stderr, "no address for %s:%s\n", host, port);
    return 0;
  }
  memcpy(&link_.robot, found->ai_addr, found->ai_addrlen);
  link_.size = found->ai_addrlen;
  hints.ai_family = found->ai_family;
  freeaddrinfo(found);
  link_.socket = socket(hints.ai_family, SOCK_DGRAM, 0);
  hints.ai_flags = AI_PASSIVE;
  if (getaddrinfo(NULL, local_port, &hints, &local) != 0) {
    fprintf(stderr, "%s is no port\n", local_port);
    return 0;
  }
  const int bound = bind(link_.socket, local->ai_addr, local->ai_addrlen);
  if (bound != 0)
    fprintf(stderr, "cannot listen at port %s: %s\n", local_port, strerror(errno));
  freeaddrinfo(local);
  return bound == 0;
}

/* ---- Ctrl-C: the first one comes to rest, the second one stops at once ---- */

static volatile sig_atomic_t interrupted;

static void on_interrupt(int number)
{
  (void)number;
  ++interrupted;
}

/* ---- the motion ---- */

static void reference(double time, const double *rest, point *p)
{
$reference}

/* From rest to the reference at time 0: the polynomial of fifth degree, s from 0 to 1. */
static void ramp(double s, const double *rest, point *p)
{
  point end;
  reference(0, rest, &end);
  for (int i = 0; i < JOINTS; ++i) {
    const double way = end.position[i] - rest[i], v = RAMP_TIME * end.velocity[i];
    const double a = RAMP_TIME * RAMP_TIME * end.acceleration[i];
    const double c3 = 10 * way - 4 * v + a / 2, c4 = -15 * way + 7 * v - a, c5 = 6 * way - 3 * v + a / 2;
    p->position[i] = rest[i] + s * s * s * (c3 + s * (c4 + s * c5));
    p->velocity[i] = s * s * (3 * c3 + s * (4 * c4 + s * 5 * c5)) / RAMP_TIME;
    p->acceleration[i] = s * (6 * c3 + s * (12 * c4 + s * 20 * c5)) / (RAMP_TIME * RAMP_TIME);
  }
}

/* From a point of the motion to rest, s from 0 to 1. */
static void stop(double s, const point *from, point *p)
{
  for (int i = 0; i < JOINTS; ++i) {
    const double v = from->velocity[i], b = STOP_TIME * from->acceleration[i], c2 = -3 * v - 2 * b, c3 = 2 * v + b;
    p->position[i] = from->position[i] + STOP_TIME * s * (v + s * (b / 2 + s * (c2 / 3 + s * c3 / 4)));
    p->velocity[i] = v + s * (b + s * (c2 + s * c3));
    p->acceleration[i] = (b + s * (2 * c2 + s * 3 * c3)) / STOP_TIME;
  }
}

/* ---- the law ---- */

static ${name}_t law;
static double position[JOINTS], torque[JOINTS], since_sample; /* from the sample before to the last one [s] */
static ${name}_output out;

/* Step the law; without a sample where is_new is 0. held: the torque of the period before stayed through it. */
static void step(int is_new, int held, const point *target)
{
  ${name}_input in;
  memset(&in, 0, sizeof in);
  for (int i = 0; i < JOINTS; ++i) {
    in.position[i] = is_new ? (real)position[i] : (real)NAN;
    in.reference[i] = (real)target->position[i];
    in.velocity_reference[i] = (real)target->velocity[i];
    in.acceleration_reference[i] = (real)target->acceleration[i];
    in.applied_torque[i] = held ? (real)torque[i] : (real)NAN;
  }
$elapsed  (void)${name}_step(&law, &in, &out);
}

/* Make the law give up: without samples for longer than it bridges it applies its safe torque. */
static void give_up(const point *target)
{
  for (int i = 0; i <= MAX_MISSING && !out.fault; ++i)
    step(0, 0, target);
}

/* Why the run must stop; NULL where nothing is wrong. */
static const char *fault(int is_new, double silence, const point *target)
{
  if (silence > WATCHDOG - PERIOD) /* the next period would be too late */
    return "no sample came for the time of the watchdog";
  if (out.fault)
    return "too many samples missing in a row";
  for (int i = 0; i < JOINTS; ++i) {
    if (is_new && fabs(position[i] - target->position[i]) > MAX_ERROR)
      return "the error is beyond its limit";
    if (fabs((double)out.velocity_estimate[i]) > MAX_SPEED)
      return "the speed is beyond its limit";
  }
  return interrupted > 1 ? "stopped twice on request" : NULL;
}

/* ---- the log ---- */

typedef struct { double time, late, position[JOINTS], velocity[JOINTS], torque[JOINTS], reference[JOINTS]; } row;

static row rows[LOG_PERIODS];
static long kept;

/* Keep a period: a sample that did not come is NaN. */
static void keep(double time, double late, int is_new, const point *target)
{
  row *const r = &rows[kept++ % LOG_PERIODS];
  r->time = time;
  r->late = late;
  for (int i = 0; i < JOINTS; ++i) {
    r->position[i] = is_new ? position[i] : (double)NAN;
    r->velocity[i] = (double)out.velocity_estimate[i];
    r->torque[i] = torque[i];
    r->reference[i] = target->position[i];
  }
}

static void write_group(FILE *file, const double *values)
{
  for (int i = 0; i < JOINTS; ++i)
    (void)fprintf(file, ",%.17g", values[i]);
}

/* Write the rows as CSV, the oldest first; return whether it was written. */
static int write_log(const char *path)
{
  static const char *const quantities[] = {"q", "dq", "tau", "q_ref"};
  FILE *const file = fopen(path, "w");
  if (!file)
    return 0;
  (void)fprintf(file, "time,late");
  for (int quantity = 0; quantity < 4; ++quantity)
    for (int i = 0; i < JOINTS; ++i)
      (void)fprintf(file, ",%s%d", quantities[quantity], i + 1);
  for (long k = kept > LOG_PERIODS ? kept - LOG_PERIODS : 0; k < kept; ++k) {
    const row *const r = &rows[k % LOG_PERIODS];
    (void)fprintf(file, "\n%.9f,%.9f", r->time, r->late);
    write_group(file, r->position);
    write_group(file, r->velocity);
    write_group(file, r->torque);
    write_group(file, r->reference);
  }
  const int failed = fprintf(file, "\n") < 0 || ferror(file);
  return fclose(file) == 0 && !failed;
}

/* ---- the loop ---- */

static float lateness[TIMED];
static long timed, overruns;
static double start, begin, late, last_sample, first_offset;
static long period;
static int follows_clock;

/* Sleep until the next deadline; return how many periods were missed. */
static long wait_for_period(void)
{
  const double deadline = start + (double)period * PERIOD;
  sleep_until(deadline);
  begin = now();
  late = begin - deadline;
  const long missed = (long)(late / PERIOD);
  if (timed < TIMED)
    lateness[timed++] = (float)late;
  overruns += missed;
  period += missed + 1;
  return missed;
}

/* Move the deadlines by a hundredth of what the robot's clock moved against this one's, within a period. */
static void follow_clock(void)
{
  if (follows_clock && isfinite(link_.stamp))
    start += 0.01 * remainder(link_.stamp - start - (double)(period - 1) * PERIOD - first_offset, PERIOD);
}

static int read_position(void)
{
  if (!receive())
    return 0;
  for (int i = 0; i < JOINTS; ++i)
    if (!(fabs(link_.position[i]) <= 1e100))
      return 0;
  memcpy(position, link_.position, sizeof position);
  since_sample = begin - last_sample;
  last_sample = begin;
  follow_clock();
  return 1;
}

/* Let the periods begin half a period after the robot's samples come. */
static void align(void)
{
  const double end = now() + 5 * PERIOD;
  while (now() < end && !read_position())
    sleep_until(now() + PERIOD / 20);
  start = now() + PERIOD / 2;
  first_offset = link_.stamp - start;
  follows_clock = isfinite(link_.stamp) ? 1 : 0;
}

static int compare(const void *one, const void *other)
{
  const float a = *(const float *)one, b = *(const float *)other;
  return (a > b) - (a < b);
}

static void report(const char *ended)
{
  qsort(lateness, (size_t)timed, sizeof *lateness, compare);
  const long last = timed ? timed - 1 : 0;
  printf("%s\nlate [us]: 50 %% %.0f, 99 %% %.0f, 99.9 %% %.0f, 100 %% %.0f\n", ended,
         1e6 * (double)lateness[last / 2], 1e6 * (double)lateness[(long)(0.99 * (double)last)],
         1e6 * (double)lateness[(long)(0.999 * (double)last)], 1e6 * (double)lateness[last]);
  printf("%ld of %ld periods missed; %ld packets malformed, %ld from strangers, %ld stale\n", overruns, period,
         link_.malformed, link_.strangers, link_.stale);
$watched}

static void take_real_time(void)
{
  const struct sched_param parameter = {.sched_priority = PRIORITY};
  const int locked = mlockall(MCL_CURRENT | MCL_FUTURE);
  printf("memory: %s\n", locked == 0 ? "locked" : "not locked, allow it by ulimit -l");
  const int fifo = PRIORITY ? sched_setscheduler(0, SCHED_FIFO, &parameter) : -1;
  printf("scheduler: %s\n", fifo == 0 ? "SCHED_FIFO" : "ordinary, allow SCHED_FIFO by ulimit -r");
  (void)fflush(stdout); /* now, also where it is no terminal */
}

/* Say hello until a valid position and the names are there; return whether they came and fit. */
static int meet_robot(void)
{
  const double end = now() + PATIENCE;
  while (now() < end && !(link_.order && last_sample > 0)) {
    send_command(HELLO, NULL);
    sleep_until(now() + PERIOD);
    begin = now();
    (void)read_position();
  }
  if (!(last_sample > 0) || link_.order < 0) {
    fprintf(stderr, link_.order < 0 ? "the robot has other joints, or another order\n" : "the robot does not answer\n");
    return 0;
  }
  for (int i = 0; i < JOINTS; ++i) {
    torque[i] = fabs(link_.torque[i]) <= 1e100 ? link_.torque[i] : 0;
    torque[i] = fmin(fmax(torque[i], -max_torque[i]), max_torque[i]);
  }
  real first[JOINTS], held[JOINTS];
  for (int i = 0; i < JOINTS; ++i) {
    first[i] = (real)position[i];
    held[i] = (real)torque[i];
  }
  return ${name}_reset(&law, first, held) == ${NAME}_OK;
}

/* Where the motion is at a time since the brakes opened; returns 0 after its end. */
static int target_at(double time, double seconds, const double *rest, const point *stop_from, double stop_start,
                     point *p)
{
  if (stop_from) {
    stop(fmin((time - stop_start) / STOP_TIME, 1.0), stop_from, p);
    return time < stop_start + STOP_TIME;
  }
  if (time < HOLD_TIME) {
    memset(p, 0, sizeof *p);
    memcpy(p->position, rest, sizeof p->position);
  } else if (time < HOLD_TIME + RAMP_TIME) {
    ramp((time - HOLD_TIME) / RAMP_TIME, rest, p);
  } else {
    reference(time - HOLD_TIME - RAMP_TIME, rest, p);
  }
  return time < HOLD_TIME + RAMP_TIME + seconds;
}

/* Run one period with the law; return why the run must stop, or NULL. */
static const char *law_period(int flags, const point *target, long missed, int *is_new)
{
  for (long i = 0; i < missed && i <= MAX_MISSING; ++i)
    step(0, 1, target);
  *is_new = read_position();
  step(*is_new, missed > 0, target);
  const char *const reason = fault(*is_new, begin - last_sample, target);
  if (reason)
    give_up(target);
  for (int i = 0; i < JOINTS; ++i) {
    torque[i] = (double)out.torque[i];
    if (!(fabs(torque[i]) <= max_torque[i]))
      torque[i] = 0; /* never: the law keeps its limits */
  }
  send_command(reason ? STOP : flags, torque);
  return reason;
}

static void hold(double time, int flags)
{
  const long end = period + (long)(time / PERIOD);
  while (period < end) {
    (void)wait_for_period();
    (void)read_position();
    send_command(flags, torque);
  }
}

static const char *follow(double seconds)
{
  double rest[JOINTS], stop_start = 0;
  point target, stop_from;
  int is_stopping = 0;
  memcpy(rest, position, sizeof rest);
  const long first = period;
  for (;;) {
    const long missed = wait_for_period();
    const double time = (double)(period - 1 - first) * PERIOD;
    const int goes_on = target_at(time, seconds, rest, is_stopping ? &stop_from : NULL, stop_start, &target);
    int is_new;
    const char *const reason = law_period(RELEASE, &target, missed, &is_new);
    keep(time, late, is_new, &target);
    if (reason)
      return reason;
    if (is_stopping && !goes_on)
      return NULL;
    if (!is_stopping && (!goes_on || interrupted)) {
      is_stopping = 1;
      stop_start = time;
      stop_from = target;
    }
  }
}

int main(int argc, char **argv)
{
  if (argc < 3) {
    fprintf(stderr, "usage: %s HOST PORT [SECONDS [LOCAL_PORT [LOG.csv]]]\n", argv[0]);
    return 1;
  }
  for (int i = 0; i < JOINTS; ++i)
    if (max_torque[i] >= 1e100)
      return fprintf(stderr, "joint %d has no torque limit\n", i + 1), 1;
  if (!open_link(argv[1], argv[2], argc > 4 ? argv[4] : "0") || !meet_robot())
    return 1;
  signal(SIGINT, on_interrupt);
  take_real_time();
  align();
  last_sample = start;
  hold(BRAKE_TIME, 0);
  const char *const reason = follow(argc > 3 ? atof(argv[3]) : 10.0);
  hold(BRAKE_TIME, STOP);
  close(link_.socket);
  report(reason ? reason : interrupted ? "stopped on request" : "completed");
  if (argc > 5 && !write_log(argv[5]))
    return fprintf(stderr, "cannot write the log %s: %s\n", argv[5], strerror(errno)), reason ? 3 : 1;
  return reason ? 3 : 0;
}
