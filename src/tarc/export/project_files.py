"""Files beside the C of a law: the replay of its vectors, build files and a README."""

from string import Template

from tarc.control.watch import WatchFlag
from tarc.core.version import __version__
from tarc.export.c_source import CSource
from tarc.export.fuzz_text import fuzz_text
from tarc.export.parts import Parts
from tarc.export.tolerances import TOLERANCES

REPLAY_HEADER = Template("""/* The recorded steps as the C takes them, and the comparison with what it gives. */
#ifndef REPLAY_H
#define REPLAY_H

#include "${name}.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

typedef ${name}_real real;

/* Numbers that differ; those of them that differ by more than rounding; largest distance in units of the last place. */
typedef struct {
  long different, wrong;
  bits largest;
} replay_result;

static real number(bits pattern)
{
  real value;
  memcpy(&value, &pattern, sizeof value);
  return value;
}

static bits pattern(real value)
{
  bits result;
  memcpy(&result, &value, sizeof result);
  return result;
}

/* Distance of two numbers in units of the last place. */
static bits distance(bits one, bits other)
{
  const bits sign = (bits)1 << (8 * sizeof(bits) - 1);
  const bits a = one & sign ? sign - (one & ~sign) : sign + one;
  const bits b = other & sign ? sign - (other & ~sign) : sign + other;
  return a > b ? a - b : b - a;
}

static void collect(const ${name}_output *out, real values[VECTOR_OUTPUTS])
{
$collect}

/* Input of a recorded step. */
static void fill(${name}_input *in, const bits row[VECTOR_INPUTS])
{
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    in->position[i] = number(row[i]);
    in->reference[i] = number(row[${NAME}_JOINTS + i]);
    in->velocity_reference[i] = number(row[2 * ${NAME}_JOINTS + i]);
    in->acceleration_reference[i] = number(row[3 * ${NAME}_JOINTS + i]);
    in->applied_torque[i] = number(row[4 * ${NAME}_JOINTS + i]);
  }
$fill_elapsed}

/* Start the law as recorded; NULL, or what went wrong. */
static const char *start(${name}_t *law)
{
  real position[${NAME}_JOINTS], torque[${NAME}_JOINTS];
  ${name}_input in;
  ${name}_output out;
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    position[i] = number(vector_start[0][i]);
    torque[i] = number(vector_start[0][${NAME}_JOINTS + i]);
  }
  memset(&in, 0, sizeof in);
  if (${name}_step(law, &in, &out) != ${NAME}_NOT_READY)
    return "a step before the first reset was not refused\\n";
  if (${name}_reset(law, position, torque) != ${NAME}_OK)
    return "the start was refused\\n";
  return NULL;
}

/* Compare an output with that of recorded step k. */
static void compare(const ${name}_output *out, int k, replay_result *result)
{
  real values[VECTOR_OUTPUTS];
  collect(out, values);
  for (int i = 0; i < VECTOR_OUTPUTS; ++i) {
    const bits found = pattern(values[i]), expected = vector_outputs[k][i];
    if (found == expected)
      continue;
    ++result->different;
    if (distance(found, expected) > result->largest)
      result->largest = distance(found, expected);
    if (!(fabs((double)values[i] - (double)number(expected)) <= $tolerance * (1.0 + fabs((double)number(expected)))))
      ++result->wrong;
  }
}

/* Whether the results are those of the law. */
static int is_right(const replay_result *result)
{
  return VECTORS_EXACT ? result->different == 0 : result->wrong == 0;
}

#endif
""")

REPLAY = Template("""/* Runs the recorded steps and compares every bit. Exit status 0 where all agree.
 *
 * With a number as argument it then times that many steps and prints the nanoseconds of one.
 */
#include "replay.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static ${name}_t law;

int main(int argc, char **argv)
{
  ${name}_input in;
  ${name}_output out;
  replay_result result = {0, 0, 0};
  const char *const fault = start(&law);
  if (fault) {
    printf("%s", fault);
    return 1;
  }
  for (int k = 0; k < VECTORS; ++k) {
    fill(&in, vector_inputs[k]);
    (void)${name}_step(&law, &in, &out);
    compare(&out, k, &result);
  }
  printf("%d steps, %ld of %ld numbers differ, by %.0f units of the last place at most; %ld by more than $tolerance\\n",
         VECTORS, result.different, (long)VECTORS * VECTOR_OUTPUTS, (double)result.largest, result.wrong);
  const long repeats = argc > 1 ? strtol(argv[1], NULL, 10) : 0;
  if (repeats > 0) {
    const clock_t begin = clock();
    for (long k = 0; k < repeats; ++k) {
      fill(&in, vector_inputs[k % VECTORS]);
      (void)${name}_step(&law, &in, &out);
    }
    const double seconds = (double)(clock() - begin) / CLOCKS_PER_SEC;
    printf("%.1f ns per step\\n", 1e9 * seconds / (double)repeats);
  }
  return !is_right(&result);
}
""")

CMAKE = Template("""cmake_minimum_required(VERSION 3.10)
project($name C)

add_library($name src/$name.c$more_sources)
target_include_directories($name PUBLIC src)
set_target_properties($name PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF)
if(NOT MSVC)
  # products and sums are rounded one by one, as where the law was simulated
  target_compile_options($name PRIVATE -O2 -ffp-contract=off)
  target_link_libraries($name PUBLIC m)
endif()

enable_testing()
add_executable(${name}_replay test/replay.c)
target_link_libraries(${name}_replay $name)
add_test(NAME replay COMMAND ${name}_replay)
add_executable(${name}_fuzz test/fuzz.c)
target_link_libraries(${name}_fuzz $name)
add_test(NAME fuzz COMMAND ${name}_fuzz)
$test_parts""")

TEST_PARTS = Template("""add_executable(${name}_parts test/parts.c)
target_link_libraries(${name}_parts $name)
add_test(NAME parts COMMAND ${name}_parts)
""")

PLATFORMIO = Template("""{
  "name": "$name",
  "version": "$version",
  "description": "$title",
  "license": "$license",
  "frameworks": "*",
  "platforms": "*",
  "build": {"srcDir": "src", "includeDir": "src", "flags": ["-ffp-contract=off"]}
}
""")

ARDUINO = Template("""name=$name
version=$version
author=tarc-control
maintainer=tarc-control
sentence=$title
paragraph=Compile with -ffp-contract=off and without -ffast-math.
category=Device Control
url=https://github.com/tarc-control/tarc-control
architectures=*
includes=$name.h
""")

ZEPHYR_MODULE = """name: $name
build:
  cmake: zephyr
"""

ZEPHYR_CMAKE = """zephyr_include_directories(../src)
zephyr_library_named($name)
zephyr_library_sources(../src/$name.c$more_zephyr)
zephyr_library_compile_options(-ffp-contract=off)
"""

README = Template("""# $title

C99 of a control law, written by tarc-control $version. Its parameters, and what is certified of it, are in `law.yaml`.

## Use it

Compile `src/$name.c` with `-ffp-contract=off`, link `-lm`, and call it once per period of $period s:

```c
#include "$name.h"
#include <math.h>

static ${name}_t law;

void start(const ${name}_real position[${NAME}_JOINTS])
{
  ${name}_reset(&law, position, $present);
}

void period(const ${name}_real position[${NAME}_JOINTS], ${name}_real torque[${NAME}_JOINTS])
{
  ${name}_input in;
  ${name}_output out;
  for (int i = 0; i < ${NAME}_JOINTS; ++i) {
    in.position[i] = position[i];
    in.reference[i] = 0; /* where it is to be, with its two derivatives */
    in.velocity_reference[i] = in.acceleration_reference[i] = 0;
    in.applied_torque[i] = NAN; /* what your drive reports, if it does */
  }
$use_elapsed  ${name}_step(&law, &in, &out);
  for (int i = 0; i < ${NAME}_JOINTS; ++i)
    torque[i] = out.torque[i];
}
```

The joints, in order: $joints.
A sample that is not finite counts as missing, and is bridged for up to $max_missing periods in a row.
The C sets no deadline and checks no clock: call it at its period, with a sample of that period.

$watched$parts## Check it

```console
$$ cc -std=c99 -O2 -ffp-contract=off -Isrc -Itest src/$name.c test/replay.c -lm -o replay && ./replay
$$ tarc verify-export .
```

The first runs $count recorded steps and compares every bit.
`test/fuzz.c` gives the law absurd inputs: no torque may be NaN or beyond its limit.
The second also tries compilers and options, and compares many more steps with the law itself.
""")


WATCHED = Template("""## What is watched

Each output has `flags`, which tell what left the range that was certified, and `flags_seen`, all since the reset.
The torque does not depend on them: what to do is the caller's.

| flag | set where |
| --- | --- |
$rows

""")

FLAG_MEANINGS = {
    WatchFlag.POSITION: "a joint is outside the range of positions",
    WatchFlag.ERROR: "a joint is farther from its reference than the tube is wide",
    WatchFlag.SPEED: "a velocity estimate is above the largest speed",
    WatchFlag.LOAD: "the mean torque of the last rest was above that of the largest load",
    WatchFlag.TIMING: "`elapsed` differs from the period",
}


def watched_text(source: CSource) -> str:
    """Return the README's section on what is watched; empty where nothing is."""
    watch = source.traced.watch
    if watch is None:
        return ""
    rows = [f"| `{source.name.upper()}_FLAG_{flag.name}` | {FLAG_MEANINGS[flag]} |" for flag in watch.watched]
    return WATCHED.substitute(rows="\n".join(rows))


PARTS = Template("""## Its parts

`src/${name}_parts.c` has parts of the law as functions of their own, which share no memory with `${name}_step`:

$rows

`test/parts.c` compares them with what Python computes, bit by bit.

""")

PART_MEANINGS = {
    "estimator": "`{name}_estimator_reset` and `{name}_estimator_step`: velocity and acceleration from positions",
    "inertia": "`{name}_inertia`: the nominal inertia of the law's model at a position",
    "reference": "`{name}_reference`: the reference and its two derivatives at a time",
}


def parts_text(parts: Parts) -> str:
    """Return the README's section on the parts."""
    name = parts.source.name
    rows = "\n".join(f"- {PART_MEANINGS[part].format(name=name)}" for part in parts.names)
    return PARTS.substitute(name=name, rows=rows)


def texts(
    source: CSource, joints: tuple[str, ...], count: int, licence: str, parts: Parts | None = None
) -> dict[str, str]:
    """Return the text of each file by its path, those of the C, its vectors and the law's parameters aside."""
    law = source.traced.law
    n, lines = law.n_joints, [f"  for (int i = 0; i < {law.n_joints}; ++i)", "    values[i] = out->torque[i];"]
    for signal in source.traced.signals:
        if signal.size == 1:
            lines.append(f"  values[{signal.start}] = (real)out->{signal.name};")
        else:
            lines.append(f"  memcpy(values + {signal.start}, out->{signal.name}, sizeof out->{signal.name});")
    values = {
        "name": source.name,
        "NAME": source.name.upper(),
        "title": source.title,
        "version": __version__,
        "license": licence,
        "period": f"{law.period:g}",
        "joints": ", ".join(joints) or f"joint1 to joint{n}",
        "max_missing": str(law.max_missing),
        "count": str(count),
        "collect": "\n".join(lines) + "\n",
        "tolerance": TOLERANCES[source.real],
        "watched": watched_text(source),
        "present": "position" if source.commands else "NULL",
        "fill_elapsed": "",
        "use_elapsed": "",
        "more_sources": "",
        "more_zephyr": "",
        "test_parts": "",
        "parts": "",
    }
    if parts is not None:
        values["more_sources"] = f" src/{source.name}_parts.c"
        values["more_zephyr"] = f" ../src/{source.name}_parts.c"
        values["test_parts"] = TEST_PARTS.substitute(name=source.name)
        values["parts"] = parts_text(parts)
    if source.traced.watch is not None:
        values["fill_elapsed"] = f"  in->elapsed = number(row[5 * {source.name.upper()}_JOINTS]);\n"
        values["use_elapsed"] = "  in.elapsed = 0; /* time since the last sample [s], where you have it */\n"
    return {
        "README.md": README.substitute(values),
        "test/replay.h": REPLAY_HEADER.substitute(values),
        "test/replay.c": REPLAY.substitute(values),
        "test/fuzz.c": fuzz_text(source),
        "CMakeLists.txt": CMAKE.substitute(values),
        "library.json": PLATFORMIO.substitute(values),
        "library.properties": ARDUINO.substitute(values),
        "zephyr/module.yml": Template(ZEPHYR_MODULE).substitute(values),
        "zephyr/CMakeLists.txt": Template(ZEPHYR_CMAKE).substitute(values),
    }
